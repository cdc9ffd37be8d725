"""A whole case: what a case file says, as frozen records whose fields ARE the keys.

    case = read_case("bracket.toml")        # from a file, one error message if it is wrong
    case = Case(mesh={"box": {"size": [2, 1, 1], "cells": [8, 4, 4]}},
                materials={"steel": {"law": "linear-elastic", "E": "210 GPa", "nu": 0.3}},
                support=[{"on": "left"}])   # the same in Python
    Path("copy.toml").write_text(case.to_toml())

Bare numbers under [mesh], [surfaces] and [regions] are in the mesh's unit; all others are SI.
Any number may be a text with a unit of its own ("2 mm").
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any, Self

import numpy as np
from mpi4py import MPI
from pydantic import Field, PrivateAttr, ValidationInfo, field_validator, model_validator

from dolfin_elastic.case.analysis import (
    ANALYSES,
    Analysis,
    Solver,
    check_analyses,
    refuse_both,
    solver_of,
)
from dolfin_elastic.case.curve_files import with_curves
from dolfin_elastic.case.tables import (
    Material,
    MeshTable,
    Output,
    as_table,
    listed,
    named,
    pick,
    selectors,
    written,
)
from dolfin_elastic.case.toml import read_toml, toml_text
from dolfin_elastic.core.errors import InputError, RestartError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.schema import Record, within
from dolfin_elastic.mesh import Body, Selector, name_parts
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.model.loads import LOADS, Load
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.periodic import Periodic
from dolfin_elastic.model.supports.displacement import Restraint
from dolfin_elastic.model.supports.springs import SUPPORTS
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.results.outputs import Output as File
from dolfin_elastic.solvers.dynamics.dynamics import DynamicsSettings
from dolfin_elastic.solvers.eigen.buckling import BucklingSettings
from dolfin_elastic.solvers.eigen.modal import ModalSettings
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.statics.statics import StaticsSettings


class Case(Record):
    """Everything a run needs to know.

    Attributes:
        title: For people.
        mesh: The body's mesh.
        surfaces: Name to selector, or to a list of selectors that are joined.
        regions: The same for cells.
        materials: Name to law and place; together they fill the body exactly once.
        support: What holds surfaces; where displacements are prescribed twice the later one holds.
        load: External forces.
        contact: Rigid obstacles that surfaces may touch.
        periodic: Opposite faces that are one, and the macroscopic deformation of the cell.
        statics: Equilibrium under growing load (what is done if nothing is said).
        dynamics: Motion in time.
        modal: Natural frequencies and modes; with a preload [statics] says how that is found.
        buckling: Load factors at which it buckles; as above.
        solver: How linear systems are solved.
        output: What is written.
    """

    title: str = ""
    mesh: MeshTable
    surfaces: dict[str, list[Selector]] = Field(default={})
    regions: dict[str, list[Selector]] = Field(default={})
    materials: dict[str, Material]
    support: list[Restraint] = Field(default=[])
    load: list[Load] = Field(default=[])
    contact: list[Contact] = Field(default=[])
    periodic: Periodic | None = None
    statics: StaticsSettings | None = None
    dynamics: DynamicsSettings | None = None
    modal: ModalSettings | None = None
    buckling: BucklingSettings | None = None
    solver: LinearSettings = LinearSettings()
    output: Output = Output()

    _file: str = PrivateAttr(default="")
    _folder: Path = PrivateAttr(default=Path())

    @field_validator("surfaces", "regions", mode="before")
    @classmethod
    def _selectors(cls, tables: Any) -> dict[str, list[Selector]]:
        return named(tables, selectors)

    @field_validator("materials", mode="before")
    @classmethod
    def _materials(cls, tables: Any) -> dict[str, Material]:
        read = named(tables, Material.read)
        if not read:
            raise InputError("there is no material", expected="write [materials.NAME]")
        return read

    @field_validator("support", "load", "contact", mode="before")
    @classmethod
    def _rows(cls, rows: Any, info: ValidationInfo) -> list[Record]:
        key = str(info.field_name)
        if not isinstance(rows, list | tuple):
            raise InputError(
                f"a single table cannot be a {key}",
                expected=f"write [[{key}]] with double brackets",
            )
        return listed(rows, {"support": _support, "load": _load, "contact": _contact}[key])

    @model_validator(mode="before")
    @classmethod
    def _not_both(cls, tables: Any) -> Any:
        refuse_both(tables)
        return tables

    @model_validator(mode="after")
    def _one_analysis(self) -> Self:
        check_analyses(self)
        return self

    @property
    def analysis(self) -> Analysis:
        """What is done: "statics", "dynamics", "modal" or "buckling"."""
        others: tuple[Analysis, ...] = ("dynamics", "modal", "buckling")
        return next((key for key in others if getattr(self, key) is not None), "statics")

    @property
    def full(self) -> float:
        """Load parameter at which statics ends; 1 is the full load."""
        return self.statics.end if self.statics is not None and self.analysis == "statics" else 1.0

    @property
    def preloaded(self) -> bool:
        """An equilibrium comes before the modes."""
        settings = self.modal or self.buckling
        return settings is not None and bool(settings.preload)

    # --- where it came from ---

    @property
    def file(self) -> str:
        """The case file as it was named; empty for a case made in Python."""
        return self._file

    @property
    def name(self) -> str:
        """Name of the case file without folder and suffix."""
        return Path(self._file).stem if self._file else "case"

    @property
    def folder(self) -> Path:
        """Folder that paths in the case are relative to."""
        return self._folder

    @classmethod
    def from_dict(
        cls, tables: Mapping[str, Any], folder: str | PathLike[str] = ".", *, file: str = ""
    ) -> Case:
        """A case from nested dictionaries, as TOML gives them.

        Args:
            tables: The top-level tables.
            folder: Folder that paths are relative to.
            file: Name of the file, for messages.

        Raises:
            InputError: With the file's name and the dotted key.
        """
        with located(file):
            case = with_curves(cls(**dict(tables)), Path(folder))
        case._file, case._folder = file, Path(folder)
        return case

    # --- back to text ---

    def to_dict(self) -> dict[str, Any]:
        """Nested dictionaries that `from_dict` reads back to an equal case."""
        tables: dict[str, Any] = {"title": self.title} if self.title else {}
        tables["mesh"] = written(self.mesh)
        for key in ("surfaces", "regions"):
            named = {n: [written(s) for s in rows] for n, rows in getattr(self, key).items()}
            tables[key] = {n: rows[0] if len(rows) == 1 else rows for n, rows in named.items()}
        tables["materials"] = {name: item.table() for name, item in self.materials.items()}
        tables["support"] = [_support_table(item) for item in self.support]
        tables["load"] = [{"kind": item.kind, **written(item)} for item in self.load]
        tables["contact"] = [written(item) for item in self.contact]
        for key in ("periodic", *ANALYSES, "solver", "output"):
            if key in self.model_fields_set and getattr(self, key) is not None:
                tables[key] = written(getattr(self, key))
        return {key: value for key, value in tables.items() if value or key in ANALYSES}

    def to_toml(self) -> str:
        """The case as the text of a case file that reads back to an equal case."""
        return toml_text(self.to_dict())

    # --- to the parts of a run ---

    def read_body(self, comm: MPI.Comm = MPI.COMM_WORLD) -> Body:
        """The mesh with all its names. Collective."""
        key = next(k for k in ("file", "box", "rectangle") if getattr(self.mesh, k) is not None)
        with located(self.file, f"mesh.{key}", exact=False):
            body = self.mesh.body(self.folder, comm)
        with located(self.file):
            return name_parts(
                body, surfaces=self.surfaces, regions=self.regions, scale=self.mesh.scale
            )

    def make_problem(self, body: Body) -> Problem:
        """The boundary value problem. Collective."""
        with located(self.file):
            body, laws = _fill(body, self.materials)
            return Problem(
                body,
                laws,
                supports=self.support,
                loads=self.load,
                contacts=self.contact,
                degree=self.mesh.degree,
                quadrature_degree=self.mesh.quadrature_degree,
                formulation=self.mesh.formulation,
                geometry=self.mesh.geometry,
                thickness=self.mesh.metres_thick,
                periodic=self.periodic,
            )

    def make_solver(self, problem: Problem, *, petsc: Mapping[str, Any] | None = None) -> Solver:
        """The solver of the case's analysis.

        Args:
            problem: From `make_problem`.
            petsc: PETSc options that win over the case's own.
        """
        with located(self.file):
            return solver_of(self, problem, petsc)

    @property
    def frames(self) -> int | None:
        """States whose fields are written unless the case says: explicit schemes take too many."""
        return 200 if self.dynamics is not None and not self.dynamics.implicit else None

    def files(self) -> list[File]:
        """Everything that is written."""
        modes = self.analysis in ("modal", "buckling")
        states = not modes or self.preloaded
        return self.output.files(self.frames, self.title, states=states, modes=modes)

    def listing(self, folder: Path) -> list[str]:
        """What a run has written to its folder, as a user reads it. Not collective."""
        return sorted({name for file in self.files() for name in file.listing(folder)})

    def results_folder(self) -> Path:
        """Where results go if nothing else is said."""
        if self.output.folder is not None:
            return self.folder / self.output.folder
        return Path(f"{self.name}_results")


def read_case(path: str | PathLike[str], *, comm: MPI.Comm = MPI.COMM_WORLD) -> Case:
    """Reads a case file on rank 0 and gives it to all ranks.

    Collective.

    Args:
        path: A TOML file.
        comm: The ranks that need the case.

    Raises:
        InputError: On every rank, with file, dotted key, and what is expected.
    """
    file = str(path)
    return on_root(comm, lambda: Case.from_dict(read_toml(file), Path(file).parent, file=file))


def read_materials(path: str | PathLike[str]) -> dict[str, Material]:
    """The materials of a case file, whatever else is in it or is not yet. Not collective.

    Raises:
        InputError: With file, dotted key, and what is expected.
    """
    file = str(path)
    tables = read_toml(file)
    with located(file, "materials"):
        found = named(tables.get("materials", {}), Material.read)
        if not found:
            raise InputError("there is no material", expected="write [materials.NAME]")
    return found


@contextmanager
def located(file: str, key: str = "", *, exact: bool = True) -> Iterator[None]:
    """Puts the file's name and a key in front of where an error inside points.

    Args:
        file: Name of the case file, or nothing.
        key: Dotted key.
        exact: The error points into that key; otherwise it only comes from it.
    """
    try:
        yield
    except RestartError:
        raise  # it is not about the case file
    except InputError as error:
        if file and error.where.startswith(file):
            raise
        if exact or error.where in ("size", "cells", "origin"):
            where = [file, within(key, error).where]
        else:
            where = [file, key, error.where]
        raise type(error)(
            error.what, where=": ".join(filter(None, where)), expected=error.expected
        ) from None


# --- rows of lists ---


def _support(row: Any) -> Restraint:
    if isinstance(row, Restraint):
        return row
    table = {"kind": "displacement", **as_table(row)}
    with _vector("displacement"):
        return pick(SUPPORTS, table, "kind")(**table)


def _support_table(support: Restraint) -> dict[str, Any]:
    table = written(support)
    return table if support.kind == "displacement" else {"kind": support.kind, **table}


def _load(row: Any) -> Load:
    if isinstance(row, Load):
        return row
    with _vector("value"):
        return pick(LOADS, row, "kind")(**row)


def _contact(row: Any) -> Contact:
    if isinstance(row, Contact):
        return row
    with _vector("motion"):
        return Contact(**as_table(row))


@contextmanager
def _vector(key: str) -> Iterator[None]:
    """Says of a vector that is no list how one is written."""
    try:
        yield
    except InputError as error:
        if error.where == key and error.expected == "expected a list":
            wanted = "expected a list of one number a component, for example [0, 0, 1]"
            raise type(error)(error.what, where=key, expected=wanted) from None
        raise


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
        key = f"{name} (material)" if taken else name
        regions[key], laws[key] = cells, material.law
    return body.named(regions=regions), laws
