"""The JSON schema of case files, from the records that read them.

Editors complete and check by it (taplo, Even Better TOML).  It knows every key, its kind, and its
bounds; rules about keys beside each other, names and units are for `dolfin-elastic check`.
The SI unit of a number stands in "x-unit", which validators pass over.

Source: JSON Schema draft 7, https://json-schema.org/draft-07/json-schema-validation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from types import NoneType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.tables import Material
from dolfin_elastic.core.help.records import descriptions
from dolfin_elastic.core.schema import Record, field_keys
from dolfin_elastic.core.units import Quantity, members_of
from dolfin_elastic.mesh.selectors import Place, Selector
from dolfin_elastic.model.amplitude import Amplitude
from dolfin_elastic.model.axes import AXES, LocalAxes
from dolfin_elastic.model.loads import LOADS, Load
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.laws.linear_elastic import LinearElastic
from dolfin_elastic.model.materials.pages import summary
from dolfin_elastic.model.materials.plasticity import HardeningCurve
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.model.materials.user import FormulaEnergy, SplitFormulaEnergy
from dolfin_elastic.model.relaxation import InFile, SeriesFile
from dolfin_elastic.model.supports.displacement import Restraint
from dolfin_elastic.model.supports.springs import SUPPORTS
from dolfin_elastic.model.values import OrField
from dolfin_elastic.results.checkpoint.checkpoints import CheckpointSettings
from dolfin_elastic.results.probes import ProbePoint

Schema = dict[str, Any]

NUMBER: Schema = {"type": ["number", "string"]}
"""A bare number, or a text with a unit or a formula."""
TEXTS: Schema = {"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}]}
_TEXT: Schema = {"type": "string"}
_BESIDE: Mapping[str, Schema] = {
    "on": TEXTS,
    "source": {**_TEXT, "description": "Where the values are from."},
}
"""Keys of a material beside those of its law."""
FIELD: Schema = {
    "type": "object",
    "properties": {
        **{key: {"type": "string"} for key in ("field", "unit", "file", "mesh_unit")},
        **{key: {"type": "number"} for key in ("reference", "time")},
        "outside": {"enum": ["error", "nearest"]},
    },
    "required": ["field"],
    "additionalProperties": False,
    "description": "A field of the mesh or of another file, in a unit of its own.",
}
_ROWS: Schema = {
    "type": "array",
    "items": {"type": "array", "minItems": 2, "maxItems": 2, "items": NUMBER},
}
CURVE: Schema = {
    "description": 'Amplitude over time: a name ("ramp", "smooth", "constant", "load-unload"), a '
    "formula in t, rows of [t, value], or a file.",
    "anyOf": [
        {"type": "string"},
        _ROWS,
        {"type": "object", "properties": {"smooth": _ROWS}, "additionalProperties": False},
        {
            "type": "object",
            "properties": {key: {"type": "string"} for key in ("file", "time", "value")},
            "required": ["file"],
            "additionalProperties": False,
        },
    ],
}
_SHORT_FORMS: Mapping[type[Record], list[Schema]] = {
    ProbePoint: [{"type": "array", "items": NUMBER, "minItems": 2, "maxItems": 3}],
    CheckpointSettings: [{"type": "string"}, {"type": "boolean"}],
    HardeningCurve: [{"type": "array", "items": {"type": "array", "items": NUMBER}}],
}
"""What may stand in place of a table."""
_LIMITS: Mapping[type[object], str] = {
    Gt: "exclusiveMinimum",
    Ge: "minimum",
    Lt: "exclusiveMaximum",
    Le: "maximum",
    MinLen: "minItems",
    MaxLen: "maxItems",
}
_PLAIN: Mapping[object, Schema] = {
    str: {"type": "string"},
    bool: {"type": "boolean"},
    int: {"type": "integer"},
    float: {"type": "number"},
}


def case_schema() -> Schema:
    """The schema of a whole case file."""
    writer = _Writer()
    table = writer.table(Case)
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "Case file of dolfin_elastic",
        **table,
        "definitions": writer.definitions,
    }


class _Writer:
    """Collects the schemas of records that others refer to."""

    def __init__(self) -> None:
        self.definitions: dict[str, Schema] = {}
        self._special: Mapping[type[object], Callable[[], Schema]] = {
            Amplitude: self._curve,
            Material: self._material,
            Restraint: lambda: self._kinds(SUPPORTS, may_lack="displacement"),
            Load: lambda: self._kinds(LOADS),
            LocalAxes: lambda: self._kinds(AXES),
        }

    def table(self, kind: type[Record], *, plus: Mapping[str, Schema] | None = None) -> Schema:
        """The schema of a record's table.

        Args:
            plus: Further keys, or others in place of its own.
        """
        described, properties, needed = descriptions(kind), dict(plus or {}), []
        for name, field in kind.model_fields.items():
            keys = field_keys(name, field)
            if (issubclass(kind, Law) and name == "law") or set(keys) & set(properties):
                continue
            one = self._field(field, varies=issubclass(kind, Law))
            text = described.get(name, "")
            properties |= {key: {**one, "description": text} if text else one for key in keys}
            needed += keys if field.is_required() and len(keys) == 1 else []
        schema: Schema = {"type": "object", "description": summary(kind)}
        schema |= {"properties": properties, "additionalProperties": False}
        return {**schema, "required": needed} if needed else schema

    def _field(self, field: FieldInfo, *, varies: bool) -> Schema:
        schema = dict(self._value(field.annotation, field.metadata, varies=varies))
        default = field.default
        if default is not PydanticUndefined and isinstance(default, str | int | float):
            schema["default"] = default
        return schema

    def _value(
        self, kind: object, metadata: Iterable[object] = (), *, varies: bool = False
    ) -> Schema:
        """The schema of a value.

        Args:
            metadata: What pydantic knows beside the type: units and bounds.
            varies: A number may vary in space.
        """
        metadata = list(metadata)
        if any(isinstance(one, OrField) for one in metadata):
            rest = [one for one in metadata if not isinstance(one, OrField)]
            return {"anyOf": [self._value(kind, rest, varies=varies), FIELD]}
        kinds = [one for one in members_of(kind) if one is not NoneType]
        if any(isinstance(one, InFile) for one in metadata):
            rest = [one for one in metadata if not isinstance(one, InFile)]
            return {
                "anyOf": [self._value(kind, rest, varies=varies), _TEXT, self._class(SeriesFile)]
            }
        if get_origin(kind) is Annotated:
            inner, *more = get_args(kind)
            return self._value(inner, [*_flat(more), *metadata], varies=varies)
        if len(kinds) > 1 or kinds[0] is not kind:
            parts = [one for one in _union(kind) if one is not NoneType]
            variants = [self._value(one, metadata, varies=varies) for one in parts]
            return variants[0] if len(variants) == 1 else {"anyOf": variants}
        limits = {
            key: getattr(one, limit)
            for one in metadata
            for type_, key in _LIMITS.items()
            if isinstance(one, type_)
            for limit in [type_.__name__.lower().replace("len", "_length")]
        }
        quantity = next((one for one in metadata if isinstance(one, Quantity)), None)
        if quantity is not None:
            number = {**NUMBER, **limits, "x-unit": quantity.unit}
            others = [FIELD] if varies else []
            if isinstance(quantity.table, type) and issubclass(quantity.table, Record):
                others.append(self._class(quantity.table))
            return {"anyOf": [number, *others]} if others else number
        return {**self._bare(kind, varies=varies), **limits}

    def _bare(self, kind: object, *, varies: bool) -> Schema:
        origin, inside = get_origin(kind), get_args(kind)
        if origin is Literal:
            return {"enum": list(inside)}
        if kind in _PLAIN:
            return dict(_PLAIN[kind])
        if origin is dict:
            return {"type": "object", "additionalProperties": self._named(inside[1])}
        if origin in (list, tuple):
            return {"type": "array", "items": self._value(inside[0], varies=varies)}
        return self._class(kind) if isinstance(kind, type) else {}

    def _class(self, kind: type[object]) -> Schema:
        if kind in self._special:
            return self._special[kind]()
        if not issubclass(kind, Record):
            return {}
        table, short = self._reference(kind), _SHORT_FORMS.get(kind)
        return {"anyOf": [table, *short]} if short else table

    def _curve(self) -> Schema:
        self.definitions["Curve"] = CURVE
        return {"$ref": "#/definitions/Curve"}

    def _named(self, kind: object) -> Schema:
        """One of a table of tables; of selectors one or several."""
        inside = [member for one in get_args(kind) for member in members_of(one)]
        schema = self._value(kind)
        selects = inside and isinstance(inside[0], type) and issubclass(inside[0], Place)
        if not selects:
            return schema
        one = self._value(inside[0])
        if inside[0] is Selector:  # or the name of a part
            one = {"anyOf": [one, _TEXT]}
            schema = {"type": "array", "items": one}
        return {"anyOf": [one, schema]}

    def _reference(self, kind: type[Record]) -> Schema:
        if kind.__name__ not in self.definitions:
            self.definitions[kind.__name__] = {}  # a record may hold its own kind
            self.definitions[kind.__name__] = self.table(kind)
        return {"$ref": f"#/definitions/{kind.__name__}"}

    def _kinds(self, kinds: Mapping[str, type[Record]], *, may_lack: str = "") -> Schema:
        variants = []
        for name, kind in kinds.items():
            table = self.table(kind, plus={"kind": {"const": name}})
            if name != may_lack:
                table["required"] = ["kind", *table.get("required", [])]
            self.definitions[f"{kind.__name__}-{name}"] = table
            variants.append({"$ref": f"#/definitions/{kind.__name__}-{name}"})
        return {"anyOf": variants}

    def _material(self) -> Schema:
        variants = []
        for name, law in MATERIALS.items():
            table = self.table(law, plus={"law": {"const": name}, **_BESIDE})
            table["required"] = ["law", *table.get("required", [])]
            self.definitions[f"law-{name}"] = table
            variants.append({"$ref": f"#/definitions/law-{name}"})
        for own in (FormulaEnergy, SplitFormulaEnergy):
            table = self.table(own, plus=_BESIDE)
            self.definitions[own.__name__] = table
            variants.append({"$ref": f"#/definitions/{own.__name__}"})
        by_name = {"type": "string", "description": "Its name in the library."}
        table = self.table(LinearElastic, plus={"material": by_name, "law": _TEXT, **_BESIDE})
        self.definitions["MaterialByName"] = {
            **table,
            "description": "A material of a library; what stands beside its name wins.",
            "additionalProperties": True,
            "required": ["material"],
        }
        return {"anyOf": [*variants, {"$ref": "#/definitions/MaterialByName"}]}


def _union(kind: object) -> tuple[object, ...]:
    """Members of a union as they are annotated."""
    inside = get_args(kind)
    return inside if get_origin(kind) is Union or type(kind).__name__ == "UnionType" else (kind,)


def _flat(metadata: Iterable[object]) -> Iterable[object]:
    """Metadata of types, with those that stand in a `Field` among them."""
    for one in metadata:
        yield from one.metadata if isinstance(one, FieldInfo) else (one,)
