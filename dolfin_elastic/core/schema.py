"""`Record`: the base of everything a user may write, in Python or in a case file.

The fields of a record ARE the keys of its TOML table.  Records are frozen, refuse unknown keys
with the nearest known one, and say what is wrong as an `InputError` with the dotted path.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Literal,
    Self,
    TypeVar,
    cast,
    get_args,
    get_origin,
)

from pydantic import (
    AliasChoices,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    GetCoreSchemaHandler,
    ModelWrapValidatorHandler,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, core_schema

from dolfin_elastic.core.errors import MOST_ERRORS, InputError, joined, nearest
from dolfin_elastic.core.help.records import help_text, signature
from dolfin_elastic.core.units import Quantity, members_of, metres

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)  # which pydantic does not name in public

# Pydantic 2.10 validates each schema that it makes, by a schema of schemas that takes 10 MB in
# every process.  That finds faults of pydantic's own; 2.11 no longer does so.
os.environ.setdefault("PYDANTIC_SKIP_VALIDATING_CORE_SCHEMAS", "1")


class _RecordType(ModelMetaclass):
    # Raises `InputError` in place of pydantic's error, at the outermost constructor only; and has
    # the help of records.  It has no docstring, whose name is that of a property.

    if not TYPE_CHECKING:  # editors then see the fields as keywords

        def __call__(self, /, *args: Any, **kwargs: Any) -> Any:
            try:
                return super().__call__(*args, **kwargs)
            except ValidationError as error:
                raise input_error(cast(type[BaseModel], self), error, kwargs) from None

        __signature__ = property(signature, lambda self, unreadable: None)  # pydantic sets its own
        __doc__ = property(help_text)


class Record(BaseModel, metaclass=_RecordType):
    """A frozen set of named values.

    Raises:
        InputError: A key is unknown or missing, or a value is of the wrong kind.
    """

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        defer_build=True,
        arbitrary_types_allowed=True,
        populate_by_name=True,
        validate_default=False,
        allow_inf_nan=False,
    )

    key_hints: ClassVar[Mapping[str, str]] = {}
    """Keys that belong elsewhere, and what to write instead."""
    keys_beside: ClassVar[tuple[str, ...]] = ()
    """Other keys of its table, which may be meant by one that is unknown."""
    lengths: ClassVar[tuple[str, ...]] = ()
    """Places and lengths beside a mesh: bare numbers in its unit, or texts with a unit."""
    angles: ClassVar[Mapping[str, str]] = {}
    """Key of an angle to the unit of its bare numbers: rad, or deg beside a mesh."""

    def in_metres(self, scale: float) -> Self:
        """The same record with all its `lengths` in metres; one that is so already stays itself.

        Args:
            scale: Metres per unit of length of the mesh.
        """
        if _METRIC in vars(self):
            return self
        result: dict[str, object] = {
            key: tuple(metres(x, scale) for x in value)
            if isinstance(value, tuple)
            else metres(value, scale)
            for key, value in self.given_lengths().items()
        }
        return self.converted(result) if result else self

    def converted(self, lengths: Mapping[str, object]) -> Self:
        """A copy with lengths in metres, which `in_metres` does not convert again."""
        result = self.model_copy(update=lengths)
        vars(result)[_METRIC] = True  # no field: it is not compared, nor written
        return result

    def given_lengths(self) -> dict[str, Any]:
        """Those of its `lengths` that are given, as they are written."""
        every = {key: getattr(self, key) for key in self.lengths}
        return {key: value for key, value in every.items() if value is not None}

    @model_validator(mode="wrap")
    @classmethod
    def _refuse_unknown_keys(cls, data: object, read: ModelWrapValidatorHandler[Self]) -> Self:
        if not isinstance(data, dict):
            return read(data)
        fields = {key: f for n, f in cls.model_fields.items() for key in field_keys(n, f)}
        good: dict[object, object] = {}
        errors: list[InputError] = []
        meant: dict[str, object] = {}
        for name, value in data.items():
            try:
                cls._check_key(name, value, fields)
                good[name] = value
            except InputError as error:
                errors.append(error)
                if match := _MEANT.fullmatch(error.expected):
                    meant[match[1]] = value
                if len(errors) == MOST_ERRORS:
                    break
        if errors:
            whole = len(meant) == len(errors) and not meant.keys() & data.keys()
            raise joined([*errors, *cls._others(good, meant if whole else {})])
        return read(data)

    @classmethod
    def _check_key(cls, name: object, value: object, fields: Mapping[str, FieldInfo]) -> None:
        if name not in fields:
            expected = cls.key_hints.get(str(name)) or nearest(
                str(name), [*fields, *cls.keys_beside]
            )
            raise InputError(f"unknown key '{name}'", expected=expected)
        field = fields[str(name)]
        _refuse_other_kind(cls.__name__, field.annotation, str(name), value)
        if not _validates_itself(field.metadata):
            _refuse_boolean([field.annotation], str(name), value)
        _refuse_non_boolean(field.annotation, str(name), value)

    @classmethod
    def _others(
        cls, good: Mapping[object, object], meant: Mapping[str, object]
    ) -> list[InputError]:
        """Errors beside those of unknown keys, without what may follow from these.

        Args:
            good: The part of the table that is left.
            meant: What was taken out, by the keys that it seems to mean; empty: it means none, and
                what is missing may be that.
        """
        try:
            cls.model_validate({**good, **meant})
        except ValidationError as error:
            found = [
                (re.split(r"[.\[]", one.where)[0], one)
                for one in input_error(cls, error, good).each
            ]
            if meant and any(first in meant for first, _ in found):
                return cls._others(good, {})  # what hides others may not be meant
            return [one for first, one in found if meant or first in good]
        return []


_MISSING = "this key is missing"
_MEANT = re.compile("did you mean '(.*)'\\?")
_METRIC = "in metres"
T = TypeVar("T")


class _IsInstance:
    """Asks of a value only whether it is of a type."""

    def __get_pydantic_core_schema__(
        self, kind: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        return core_schema.is_instance_schema(kind)


AlreadyRead = Annotated[T, _IsInstance()]
"""A record inside another one that a validator has made of its table before.

Of a plain one pydantic would make a schema inside that of the outer one, whether a case has such a
record or not: for a whole case that takes longer than all that is read.
"""


class _Apart:
    """Reads a record by the schema of its own class, which pydantic makes at its first use."""

    def __get_pydantic_core_schema__(
        self, kind: type[BaseModel], handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        # Faults of the inner record become faults of the outer one, each with its own place.
        return core_schema.no_info_plain_validator_function(
            kind.model_validate,
            serialization=core_schema.wrap_serializer_function_ser_schema(self._written),
        )

    @staticmethod
    def _written(record: BaseModel, write: SerializerFunctionWrapHandler) -> object:
        type(record).model_rebuild()  # a default may be the first one of its class
        return write(record)


WhenGiven = Annotated[T, _Apart()]
"""A record inside another one of which few have one, such as an optional table of a case.

Its schema is made when one is given, not together with that of the outer record.
"""


def _refuse_other_kind(record: str, kind: object, where: str, value: object) -> None:
    """Names the class for the kind of a support or load, or the law, that another class is of."""
    if where not in ("kind", "law") or get_origin(kind) is not Literal or value in get_args(kind):
        return
    classes = {one.casefold(): one for one in sys.modules["dolfin_elastic"].__all__}
    name = classes.get(str(value).replace("-", ""))
    if name is not None:
        raise InputError(
            f"{record} is of another {where} than {quoted(value)}",
            where=where,
            expected=f"write {name}(...) in Python",
        )


def _refuse_boolean(kinds: Sequence[object], where: str, value: object) -> None:
    """Refuses booleans where numbers are expected: pydantic would read `steps = true` as 1."""
    members = [member for kind in kinds for member in members_of(kind)]
    if isinstance(value, list | tuple):
        inside = [get_args(kind)[0] for kind in members if get_origin(kind) in (list, tuple)]
        for index, one in enumerate(value):
            _refuse_boolean(inside, f"{where}[{index}]", one)
    if not isinstance(value, bool) or any(_validates_itself(get_args(kind)[1:]) for kind in kinds):
        return
    numbers = {int: "a whole number", float: "a number"}
    wanted = [numbers[kind] for kind in members if kind in numbers]
    if wanted and bool not in members and Any not in members:
        expected = "expected " + " or ".join(wanted)
        raise InputError(f"{quoted(value)} is wrong", where=where, expected=expected)


def _refuse_non_boolean(kind: object, where: str, value: object) -> None:
    """Refuses "no", "off" and 0 for false, which pydantic would take."""
    if (
        members_of(kind) == [bool]
        and not isinstance(value, bool)
        and isinstance(value, str | int | float)
    ):
        raise InputError(
            f"{quoted(value)} is wrong", where=where, expected="expected true or false"
        )


def _validates_itself(metadata: Iterable[object]) -> bool:
    """The type validates its own input and reports its own errors."""
    return any(isinstance(one, Quantity | BeforeValidator) for one in metadata)


def input_error(record: type[BaseModel], error: ValidationError, given: object) -> InputError:
    """The faults of a pydantic error, each as one message: dotted key, what, expected.

    Args:
        error: Why it could not be.
        given: Of what, as the user wrote it.
    """
    keys: dict[str, list[tuple[str, ErrorDetails]]] = {}
    faults = error.errors()
    around = {fault["loc"][:n] for fault in faults for n in range(len(fault["loc"]))}
    for fault in faults:
        if fault["type"] == "too_short" and fault["loc"] in around:
            continue  # pydantic counts only the items that are right
        path, key = dotted_path(record, fault["loc"])
        keys.setdefault(key, []).append((path, fault))
    return joined(_one_error(rows, given) for rows in keys.values())


def _one_error(faults: Sequence[tuple[str, ErrorDetails]], given: object) -> InputError:
    """The message about faults of one key, of which members of a union have one or more each."""
    path, fault = min(faults, key=_rank)
    # Of the members of a union the one that has read furthest was meant.
    inside = [one for one in faults if path and one[0].startswith((f"{path}.", f"{path}["))]
    path, fault = min(inside, key=_rank, default=(path, fault))
    same = [other for place, other in faults if place == path]
    ours = next((e for f in same if isinstance(e := _inner(f), InputError)), None)
    told = sum(isinstance(_inner(one), InputError) for one in same)
    # A table was meant for the one member of a union that has keys, as in "one table or a list".
    if ours is not None and (len(same) == 1 or (told == 1 and isinstance(fault["input"], dict))):
        return ours.at(path)
    if fault["type"] == "missing":
        return InputError(_MISSING, where=path)
    if fault["type"] == "value_error" and ours is None:
        return InputError(str(_inner(fault)), where=path)
    names_input = ours is not None and isinstance(fault["input"], str)
    if ours is not None and names_input:
        return InputError(ours.what, where=path, expected=_accepted(same))
    what = f"{quoted(_written(given, fault))} is wrong"
    return InputError(what, where=path, expected=_accepted(same))


def _written(given: object, fault: ErrorDetails) -> object:
    """The value of a fault as the user wrote it, with its unit: "-2 kPa" and not -2000.

    Pydantic's location has names of union members and of validators, too, which are no keys.
    """
    if not isinstance(fault["input"], float):
        return fault["input"]
    result = given
    for part in fault["loc"]:
        if isinstance(result, list | tuple):
            result = dict(enumerate(result))
        if isinstance(result, Mapping):
            result = result.get(part, result)
    return result if isinstance(result, str) else fault["input"]


def _inner(fault: ErrorDetails) -> object:
    return fault.get("ctx", {}).get("error")


def _rank(error: tuple[str, ErrorDetails]) -> int:
    # What was written and is wrong comes before what is only missing.
    return int(error[1]["type"] == "missing")


LONGEST_QUOTED = 60


def quoted(value: object) -> str:
    """A value as it stands in a case file, shortened."""
    try:
        text = json.dumps(value, ensure_ascii=False)
    except (TypeError, ValueError):
        text = repr(value)
    return text if len(text) <= LONGEST_QUOTED else text[: LONGEST_QUOTED - 3] + "..."


_TYPE_NAMES = {
    "string_type": "a text",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "greater_than": "a number above {gt:g}",
    "less_than": "a number below {lt:g}",
    "greater_than_equal": "a number of at least {ge:g}",
    "less_than_equal": "a number of at most {le:g}",
    "too_short": "a list of {min_length}",
    "too_long": "a list of {max_length}",
}


def _accepted(faults: Sequence[ErrorDetails]) -> str:
    """What would have been accepted, over all members of a union."""
    for fault in faults:
        choices = re.findall(r"'([^']*)'", str(fault.get("ctx", {}).get("expected", "")))
        if fault["type"] == "literal_error" and choices and isinstance(fault["input"], str):
            near = nearest(fault["input"], choices)
            # "y-" is "-y" and no "y".
            turned = next((one for one in choices if sorted(one) == sorted(fault["input"])), "")
            if turned and f"'{turned}'" not in near:
                return f"did you mean '{turned}'? known: {', '.join(choices)}"
            return near
    wanted = dict.fromkeys(_phrase(fault) for fault in faults)
    return "expected " + " or ".join(wanted)


def _phrase(fault: ErrorDetails) -> str:
    context = fault.get("ctx", {})
    if fault["type"] == "literal_error":
        return str(context["expected"])
    if fault["type"] in _TYPE_NAMES:
        return _TYPE_NAMES[fault["type"]].format(**context)
    if isinstance(ours := _inner(fault), InputError):
        return ours.expected.removeprefix("expected ") or ours.what
    return str(fault["msg"]).removeprefix("Input should be ")


def dotted_path(record: type[BaseModel], path: Iterable[str | int]) -> tuple[str, str]:
    """``("support", 0, "on")`` as ``support[0].on``; and the key up to the first union in it.

    Pydantic adds names of union members and of validators to a location; they are no keys of the
    record and are left out.

    Args:
        record: Type of the record that was validated.
        path: Location of the fault as pydantic gives it.
    """
    text, key = "", None
    kinds: list[object] = [record]
    for part in path:
        below = [kind for one in kinds for kind in _part_types(one, part)]
        if isinstance(part, int):
            text += f"[{part}]"
        elif below:
            text += f".{part}" if text else part
        elif key is None:
            key = text
        kinds = below or kinds
    return text, text if key is None else key


def _part_types(kind: object, part: str | int) -> list[object]:
    """Types of the values that a type holds under a key or index; empty if it has no such part."""
    origin, inside = get_origin(kind), get_args(kind)
    if isinstance(kind, type) and origin is None and issubclass(kind, BaseModel):
        field = next((f for n, f in kind.model_fields.items() if part in field_keys(n, f)), None)
        return [] if field is None else members_of(field.annotation)
    if isinstance(origin, type) and issubclass(origin, Mapping) and isinstance(part, str):
        return [] if part.startswith("[") else members_of(inside[1])
    if isinstance(origin, type) and issubclass(origin, list | tuple) and isinstance(part, int):
        return members_of(inside[0])
    return []


def known_keys(model: type[BaseModel]) -> list[str]:
    """Keys that a record's table may have, other spellings included."""
    return [key for name, field in model.model_fields.items() for key in field_keys(name, field)]


def field_keys(name: str, field: FieldInfo) -> list[str]:
    """The key of a field, and its other spellings."""
    alias = field.validation_alias
    if isinstance(alias, str):  # the attribute has another name, which is no key
        return [alias]
    others = alias.choices if isinstance(alias, AliasChoices) else ()
    return [name, *(str(other) for other in others if other != name)]


# --- keys beside each other ---


@dataclass(frozen=True)
class UnusedKeys:
    """Keys without effect as long as another key has its present value.

    Attributes:
        keys: The keys; a user who writes one expects something that would not happen.
        what: The reason, for the message.
        expected: What to do instead.
    """

    keys: Sequence[str]
    what: str
    expected: str = "leave it out"


def is_given(record: Record, key: str) -> bool:
    """Whether the user has written a key, and not an empty value."""
    value = getattr(record, key)
    empty = value is None or (isinstance(value, list | dict) and not value)
    return key in record.model_fields_set and not empty


def refuse_times_beyond(times: Sequence[float], end: float, key: str, unit: str = "") -> None:
    """Refuses output times after the end.

    Args:
        times: Times or load factors that are to be met exactly.
        end: Where the run ends.
        unit: Of all of them, for the message.

    Raises:
        InputError: The first one beyond the end.
    """
    unit = f" {unit}" if unit else ""
    for index, time in enumerate(times):
        if time > end:
            raise InputError(
                f"{time:g}{unit} lies beyond the end",
                where=f"times[{index}]",
                expected=f"at most {key} = {end:g}{unit}",
            )


def refuse_unused_keys(record: Record, rules: Iterable[UnusedKeys], table: str = "") -> None:
    """Refuses keys that were written but have no effect beside others.

    Args:
        rules: Keys without effect, with the reasons.
        table: Dotted key of the record, if the message must name it.

    Raises:
        InputError: The first one.
    """
    for rule in rules:
        for key in rule.keys:
            if is_given(record, key):
                where = f"{table}.{key}" if table else key
                raise InputError(rule.what, where=where, expected=rule.expected)


R = TypeVar("R", bound=Record)


def settings_from(kind: type[R], record: R | None, fields: Mapping[str, Any]) -> R:
    """Settings given as a record or as keywords.

    Args:
        record: The settings, or None.
        fields: The settings as keywords: fields of `kind`.

    Raises:
        TypeError: Both are given.
    """
    if record is not None and fields:
        raise TypeError(f"give settings or keywords, not both: {', '.join(fields)}")
    return kind(**fields) if record is None else record
