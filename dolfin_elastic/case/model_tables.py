"""The tables of a case file that describe the body: mesh, names, materials, supports, loads.

`AnalysisTables` (case/analysis.py) adds what is computed of it, `Case` (case/case.py) the file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from dolfin_elastic.case.mesh_table import MeshTable
from dolfin_elastic.case.tables import (
    Material,
    as_table,
    class_named,
    read_list,
    read_named,
    selectors,
    table_of,
)
from dolfin_elastic.case.toml import key_text, read_toml
from dolfin_elastic.core.errors import OF_MATERIAL, InputError, all_errors, joined, keyed
from dolfin_elastic.core.schema import AlreadyRead, Record, WhenGiven, quoted
from dolfin_elastic.core.units import metres
from dolfin_elastic.mesh import Body, EdgeSelector, PointSelector, Selector
from dolfin_elastic.mesh.images.field import ImageField
from dolfin_elastic.model.axes import AXES, LocalAxes, check_name
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.model.loads import LOAD_WORDS, LOADS, Load
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.library import check_library, completed
from dolfin_elastic.model.periodic import Periodic
from dolfin_elastic.model.point_mass import PointMass
from dolfin_elastic.model.self_contact import SelfContact
from dolfin_elastic.model.supports.displacement import Restraint
from dolfin_elastic.model.supports.springs import SUPPORTS
from dolfin_elastic.model.tie import Tie
from dolfin_elastic.problem.problem import Problem


class ModelTables(Record):
    """The body and what acts on it, as a case file describes them.

    Attributes:
        title: For people, as the next three, which the report shows.
        part: Number or name of the part.
        author: Who is responsible.
        conclusion: What follows from the results.
        mesh: The body's mesh.
        surfaces: Name to selector, or to a list of selectors that are joined.
        regions: The same for cells.
        edges: The same for edges of solids.
        points: The same for nodes.
        fields: Name to image; formulas and `{field = "NAME"}` then take its values in elements.
        library: A TOML file of materials of the user's own, relative to the case file.
        materials: Name to law and place; together they fill the body exactly once.
        support: What holds surfaces; where displacements are prescribed twice the later one holds.
        load: External forces.
        contact: Rigid obstacles that surfaces may touch.
        tie: Surfaces with different meshes that move together.
        mass: What is mounted on surfaces and has a mass, but no stiffness.
        periodic: Opposite faces that are one, and the macroscopic deformation of the cell.
        axes: Name to local axes, in which components of fields are asked for.
    """

    key_hints: ClassVar[Mapping[str, str]] = {
        "material": "did you mean 'materials'? As in [materials.frame], with "
        'material = "steel S235" of the library'
    }
    title: str = ""
    part: str = ""
    author: str = ""
    conclusion: str = ""
    mesh: MeshTable
    surfaces: dict[str, list[AlreadyRead[Selector]]] = Field(default={})
    regions: dict[str, list[AlreadyRead[Selector]]] = Field(default={})
    edges: dict[str, list[AlreadyRead[EdgeSelector]]] = Field(default={})
    points: dict[str, list[AlreadyRead[PointSelector]]] = Field(default={})
    fields: dict[str, ImageField] = Field(default={})
    library: str | None = None
    materials: dict[str, AlreadyRead[Material]]
    support: list[AlreadyRead[Restraint]] = Field(default=[])
    load: list[AlreadyRead[Load]] = Field(default=[])
    contact: list[AlreadyRead[Contact] | AlreadyRead[SelfContact]] = Field(default=[])
    tie: list[AlreadyRead[Tie]] = Field(default=[])
    mass: list[AlreadyRead[PointMass]] = Field(default=[])
    periodic: WhenGiven[Periodic] | None = None
    axes: dict[str, AlreadyRead[LocalAxes]] = Field(default={})

    @field_validator("surfaces", "regions", mode="before")
    @classmethod
    def _selectors(cls, tables: object) -> dict[str, list[Selector]]:
        return read_named(tables, selectors(Selector))

    @field_validator("edges", mode="before")
    @classmethod
    def _edges(cls, tables: object) -> dict[str, list[EdgeSelector]]:
        return read_named(tables, selectors(EdgeSelector))

    @field_validator("points", mode="before")
    @classmethod
    def _points(cls, tables: object) -> dict[str, list[PointSelector]]:
        return read_named(tables, selectors(PointSelector))

    @field_validator("materials", mode="before")
    @classmethod
    def _materials(cls, tables: object) -> dict[str, Material]:
        return read_material_tables(tables)

    @field_validator("axes", mode="before")
    @classmethod
    def _axes(cls, tables: object) -> dict[str, LocalAxes]:
        for name in as_table(tables):
            with keyed(key_text(name)):
                check_name(name)
        return read_named(tables, _local_axes)

    @field_validator("support", "load", "contact", "tie", "mass", mode="before")
    @classmethod
    def _rows(cls, rows: object, info: ValidationInfo) -> list[Record]:
        key = str(info.field_name)
        if not isinstance(rows, list | tuple):
            raise InputError(
                f"[{key}] is one table, and a list of tables is needed",
                expected=f"write [[{key}]] with double brackets",
            )
        return read_list(rows, READERS[key])

    def model_tables(self) -> dict[str, Any]:
        """Nested dictionaries that are read back to equal tables; without [periodic]."""
        about = ("title", "part", "author", "conclusion")
        tables: dict[str, Any] = {key: text for key in about if (text := getattr(self, key))}
        tables["mesh"] = table_of(self.mesh)
        for key in ("surfaces", "regions", "edges", "points"):
            named = {n: [table_of(s) for s in rows] for n, rows in getattr(self, key).items()}
            tables[key] = {n: rows[0] if len(rows) == 1 else rows for n, rows in named.items()}
        tables["fields"] = {name: table_of(one) for name, one in self.fields.items()}
        tables["materials"] = {name: item.table() for name, item in self.materials.items()}
        tables["support"] = [_support_table(item) for item in self.support]
        tables["load"] = [{"kind": item.kind, **table_of(item)} for item in self.load]
        tables["contact"] = [table_of(item) for item in self.contact]
        tables["tie"] = [table_of(item) for item in self.tie]
        tables["mass"] = [table_of(item) for item in self.mass]
        tables["axes"] = {n: {"kind": one.kind, **table_of(one)} for n, one in self.axes.items()}
        return tables

    @property
    def pairs(self) -> dict[str, Contact]:
        """Contacts with obstacles and between two surfaces, by their keys."""
        every = enumerate(self.contact)
        return {f"contact[{i}]": one for i, one in every if isinstance(one, Contact)}

    def metres_thick(self, body: Body) -> float:
        """Thickness of a plane body [m]."""
        thickness = self.mesh.thickness
        return 1.0 if thickness is None else metres(thickness, body.unit.metres)

    def problem_on(self, body: Body, degree: int) -> Problem:
        """The boundary value problem on a body. Collective.

        Raises:
            InputError: The tables do not fit the body.
        """
        body, laws = _fill(body, self.materials)
        return Problem(
            body,
            laws,
            supports=self.support,
            loads=self.load,
            contacts=self.contact,
            ties=self.tie,
            masses=self.mass,
            degree=degree,
            quadrature_degree=self.mesh.quadrature_degree,
            formulation=self.mesh.formulation,
            geometry=self.mesh.geometry,
            thickness=self.metres_thick(body),
            periodic=self.periodic,
            axes=self.axes,
        )


def read_material_tables(tables: object) -> dict[str, Material]:
    """The table [materials]: name to material.

    Raises:
        InputError: It is empty, or a material is wrong.
    """
    for key, value in as_table(tables).items():
        if not isinstance(value, Mapping | Material | Law):
            raise InputError(
                f"{quoted(value)} is no material",
                where=key_text(key),
                expected="write its table as [materials.NAME]",
            )
    read = read_named(tables, Material.read)
    if not read:
        raise InputError("there is no material", expected="write [materials.NAME]")
    return read


def with_library(tables: Mapping[str, object], folder: Path) -> dict[str, object]:
    """The tables of a case, its materials completed from the file that `library` names.

    Not collective.

    Args:
        folder: Folder that the file is relative to.

    Raises:
        InputError: The file cannot be read, an entry has a wrong key, or there is no such material.
    """
    result, file = dict(tables), tables.get("library")
    if isinstance(file, str):
        try:
            own = read_toml(str(folder / file))
        except InputError as error:
            raise error.moved(lambda where: f"library: {where}") from None
        try:
            check_library(own)
        except InputError as error:
            raise error.moved(lambda where: f"{file}: {where}") from None
        del result["library"]
        rows = tables.get("materials")
        if isinstance(rows, Mapping):
            result["materials"] = materials = {**rows}
            with all_errors() as attempt:
                for name, row in rows.items():
                    if isinstance(row, Mapping) and "material" in row:
                        with attempt(), keyed(f"materials.{key_text(name)}"):
                            materials[name] = completed(row, own)
    return result


# --- rows of lists ---


def _support(row: object) -> Restraint:
    if isinstance(row, Restraint):
        return row
    table = {"kind": "displacement", **as_table(row)}
    with _vector("displacement"):
        return class_named(SUPPORTS, table, "kind", {})(**table)


def _support_table(support: Restraint) -> dict[str, Any]:
    table = table_of(support)
    return table if support.kind == "displacement" else {"kind": support.kind, **table}


def _total_force(table: Mapping[str, object]) -> Mapping[str, object]:
    """A load's table with earlier spellings of `kind = "force"` in its own.

    They are `force` in place of `value` in a traction, and `total = true` beside `on` in a
    point-force or line-force.
    """
    kind, rest = table.get("kind"), dict(table)
    if kind == "traction" and "force" in rest and "value" not in rest:
        value = rest.pop("force")
        return {**rest, "kind": "force", "value": value}
    if kind in ("point-force", "line-force") and "on" in rest and rest.get("total") is True:
        del rest["total"]
        return {**rest, "kind": "force"}
    return table


def _load(row: object) -> Load:
    if isinstance(row, Load):
        return row
    table = _total_force(as_table(row))
    examples = {"growth": "[1.1, 1, 1]", "force": '[0, 0, "-2 kN"]'}
    with _vector("value", examples.get(str(table.get("kind")), "[0, 0, 1]")):
        return class_named(LOADS, table, "kind", LOAD_WORDS)(**table)


def _contact(row: object) -> Contact | SelfContact:
    if isinstance(row, Contact | SelfContact):
        return row
    table = as_table(row)
    if "self" in table or "all" in table:
        return SelfContact(**table)
    with _vector("motion"):
        return Contact(**table)


def _tie(row: object) -> Tie:
    return row if isinstance(row, Tie) else Tie(**as_table(row))


def _mass(row: object) -> PointMass:
    return row if isinstance(row, PointMass) else PointMass(**as_table(row))


def _local_axes(table: object) -> LocalAxes:
    if isinstance(table, LocalAxes):
        return table
    return class_named(AXES, table, "kind")(**as_table(table))


READERS: Mapping[
    str, Callable[[object], Restraint | Load | Contact | SelfContact | Tie | PointMass]
] = {
    "support": _support,
    "load": _load,
    "contact": _contact,
    "tie": _tie,
    "mass": _mass,
}
"""Key of a list of tables to what reads one of it."""


@contextmanager
def _vector(key: str, example: str = "[0, 0, 1]") -> Iterator[None]:
    """Adds an example of a vector to the error where one was written as a single number."""
    wanted = f"expected a list of one number a component, for example {example}"
    try:
        yield
    except InputError as error:
        raise joined(
            InputError(one.what, where=key, expected=wanted)
            if (one.where, one.expected) == (key, "expected a list")
            else one
            for one in error.each
        ) from None


# --- materials on the body ---


def _fill(body: Body, materials: Mapping[str, Material]) -> tuple[Body, dict[str, Law]]:
    """One region a material, so that a problem can be made of them."""
    index_map = body.mesh.topology.index_map(body.mesh.topology.dim)
    bare = np.ones(index_map.size_local + index_map.num_ghosts, dtype=bool)
    regions, laws = {}, {}
    for name, material in sorted(materials.items(), key=lambda item: item[1].on is None):
        cells = np.flatnonzero(bare).astype(np.int32)
        if material.regions:
            cells = np.unique(np.concatenate([body.region(n) for n in material.regions]))
        bare[cells] = False
        taken = name in body.regions and material.regions != (name,)
        key = name + OF_MATERIAL if taken else name
        regions[key], laws[key] = cells, material.law
    return body.named(regions=regions), laws
