"""`Case`: a whole case file, as frozen records whose fields are its keys.

    case = read_case("bracket.toml")        # from a file, one error message if it is wrong
    case = Case(mesh={"box": {"size": [2, 1, 1], "cells": [8, 4, 4]}},
                materials={"steel": {"law": "linear-elastic", "E": "210 GPa", "nu": 0.3}},
                support=[{"on": "left"}])   # the same in Python
    Path("copy.toml").write_text(case.to_toml())

Bare numbers of places and sizes beside the mesh, under [mesh], [surfaces], [regions], [edges] and
[points], of probes and of obstacles, are in the mesh's unit; all others are SI.  Any number may be
a text with a unit of its own ("2 mm").
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property, partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from mpi4py import MPI
from pydantic import PrivateAttr

from dolfin_elastic.case.analysis import ANALYSES, AnalysisTables
from dolfin_elastic.case.check.memory import check_elements
from dolfin_elastic.case.curve_files import (
    has_curve_files,
    has_series_files,
    with_curves,
    with_series,
)
from dolfin_elastic.case.field_files import with_fields
from dolfin_elastic.case.mesh_table import Source
from dolfin_elastic.case.model_tables import read_material_tables, with_library
from dolfin_elastic.case.tables import Material, table_of
from dolfin_elastic.case.toml import changed_tables, position, read_toml, toml_text, value_at
from dolfin_elastic.core.errors import InputError, RestartError, dotted, joined
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.petsc_options import PetscOptions
from dolfin_elastic.mesh import Body, name_parts
from dolfin_elastic.problem.obstacles import with_obstacles
from dolfin_elastic.problem.problem import Problem

if TYPE_CHECKING:
    from dolfin_elastic.case.analysis import Solver
    from dolfin_elastic.core.types import FloatArray
    from dolfin_elastic.solvers.dynamics.dynamics import Dynamics


class Case(AnalysisTables):
    """The tables of a case file.

    The keys are the attributes of `ModelTables` and `AnalysisTables`.
    """

    _file: str = PrivateAttr(default="")
    _folder: Path = PrivateAttr(default=Path())
    _trusted: bool = PrivateAttr(default=False)

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
        cls,
        tables: Mapping[str, Any],
        folder: str | PathLike[str] = ".",
        *,
        file: str = "",
        trust: bool = False,
    ) -> Case:
        """A case from nested dictionaries, as TOML gives them.

        Args:
            folder: Folder that paths are relative to.
            file: Name of the file, for messages.
            trust: A .geo script of its mesh may do all that its user may.

        Raises:
            InputError: With the file's name and the dotted key.
        """
        with locate_errors(file), in_order(lambda: tables):
            case = with_curves(cls(**_with_materials(tables, Path(folder))), Path(folder))
        return case._from(file, Path(folder), trust, tables)

    def _from(self, file: str, folder: Path, trust: bool, tables: Mapping[str, Any]) -> Case:
        self._file, self._folder, self._trusted = file, folder, trust
        self.__dict__["written"] = tables
        return self

    @cached_property
    def written(self) -> Mapping[str, object]:
        """The tables in the order in which they were written."""
        return self.to_dict()

    @property
    def trusted(self) -> bool:
        """A .geo script of its mesh may do all that its user may."""
        return self._trusted

    # --- back to text ---

    def to_dict(self) -> dict[str, Any]:
        """Nested dictionaries that `from_dict` reads back to an equal case."""
        tables = self.model_tables()
        for key in ("periodic", *ANALYSES, "solver", "output"):
            if key in self.model_fields_set and getattr(self, key) is not None:
                tables[key] = table_of(getattr(self, key))
        return {key: value for key, value in tables.items() if value or key in ANALYSES}

    def to_toml(self) -> str:
        """The case as the text of a case file that reads back to an equal case."""
        return toml_text(self.to_dict())

    def changed(self, values: Mapping[str, object]) -> Case:
        """The case with other values at dotted keys, see `changed_tables`.

            case.changed({"materials.rubber.E": "2 MPa", "mesh.size": "4 mm"})

        Raises:
            InputError: There is no such key, or the case is wrong with that value.
        """
        with locate_errors(self.file):
            tables = changed_tables(self.written, values, frozenset(Case.model_fields))
        return Case.from_dict(tables, self.folder, file=self.file, trust=self.trusted)

    def value_at(self, key: str) -> object:
        """What the case has at a dotted key, as it was written.

        Raises:
            InputError: It has nothing there.
        """
        with locate_errors(self.file):
            return value_at(self.written, key)

    # --- to the parts of a run ---

    def read_body(self, comm: MPI.Comm = MPI.COMM_WORLD) -> Body:
        """The mesh with all its names. Collective."""
        named = self.name_parts(self.read_mesh(comm))
        with locate_errors(self.file):
            finer = self.mesh.refined(named)
            finer = with_fields(finer, self.fields, self.model_tables(), self.folder)
            if self.contact:
                finer = with_obstacles(finer, self.contact, self.folder)
        with locate_errors(self.file, f"mesh.{self.mesh.kind}"):
            check_elements(comm, finer.num_cells, finer.dim, self.degree, made=True)
        return finer

    def read_mesh(self, comm: MPI.Comm) -> Body:
        """The mesh with the names of its files, without those of the case. Collective."""
        mesh, read = self.mesh, list[tuple[Source, Body]]()
        for table, source in mesh.sources.items():
            with locate_errors(self.file, f"{table}.{source.kind}"):
                if source.cells_made:
                    check_elements(comm, mesh.generated_cells, mesh.dim_made, self.degree)
        for table, source in mesh.sources.items():
            body = next((body for other, body in read if other == source), None)
            if body is None:
                with locate_errors(self.file, f"{table}.{source.kind}", exact=False):
                    body = source.body(
                        self.folder,
                        comm,
                        curved=source.curved if source.curved is not None else self.curved,
                        local=mesh.local_sizes(self.surfaces),
                        trust=self._trusted,
                    )
            read.append((source, body))
        with locate_errors(self.file, "mesh.parts"):
            return mesh.together([body for _, body in read])

    def name_parts(self, body: Body) -> Body:
        """A mesh with the names of the case. Collective."""
        with locate_errors(self.file):
            return name_parts(
                body,
                surfaces=self.surfaces,
                regions=self.regions,
                edges=self.edges,
                points=self.points,
                scale=body.unit.metres,
            )

    def make_problem(self, body: Body) -> Problem:
        """The boundary value problem. Collective.

        Raises:
            InputError: With the file's name and the dotted key.
        """
        with locate_errors(self.file):
            return self.problem_on(body, self.degree)

    def make_solver(self, problem: Problem, *, petsc: PetscOptions | None = None) -> Solver:
        """The solver of the case's analysis. Collective.

        Args:
            problem: From `make_problem`.
            petsc: PETSc options that win over the case's own.

        Raises:
            InputError: With the file's name and the dotted key.
        """
        with locate_errors(self.file):
            solver = self.solver_for(problem, petsc)
        if (start := self.start_of(problem)) is not None:
            cast("Dynamics", solver).start = start
        return solver

    def start_of(self, problem: Problem) -> Callable[[], tuple[FloatArray, FloatArray]] | None:
        """Reads the state from which a motion starts, see `read_start`; None: it is given none."""
        if self.dynamics is None or self.dynamics.start is None:
            return None
        from dolfin_elastic.case.motion_start import read_start

        return partial(read_start, self.dynamics.start, self.folder, problem)

    def listing(self, folder: Path) -> list[str]:
        """Names of the files that a run has written, for the list at its end. Not collective."""
        return sorted({name for file in self.files() for name in file.listing(folder)})

    def results_folder(self) -> Path:
        """Folder of the results, unless `run` is given another one."""
        if self.output.folder is not None:
            whole = self.folder / self.output.folder
        else:
            whole = Path(f"{self.name}_results")
        return whole if self.whole is self else whole / self.analysis

    def folder_beside(self, end: str) -> Path:
        """Folder of what a command other than `run` computes: with another end of the name.

        Args:
            end: Such as "sweep", in place of "results".
        """
        folder = self.whole.results_folder()
        return folder.with_name(f"{folder.name.removesuffix('_results')}_{end}")


def read_case(
    path: str | PathLike[str], *, comm: MPI.Comm = MPI.COMM_WORLD, trust: bool = False
) -> Case:
    """Reads a case file, and files that it names, on rank 0. Collective.

    Each rank makes its own case of what is in them: for that pydantic makes schemas, which every
    rank needs and which take longer than all the rest.

    Args:
        path: A TOML file.
        comm: The ranks that need the case.
        trust: A .geo script of its mesh may do all that its user may: run commands, write files.

    Raises:
        InputError: On every rank, with file, dotted key, and what is expected.
    """
    file, folder = str(path), Path(path).parent
    tables = written = on_root(comm, lambda: read_toml(file))
    with locate_errors(file), in_order(lambda: written):
        if "library" in tables or has_series_files(tables):
            tables = on_root(comm, lambda: _with_materials(written, folder))
        case = Case(**tables)
        if has_curve_files(case):
            case = on_root(comm, lambda: with_curves(case, folder))
    return case._from(file, folder, trust, written)


def _with_materials(tables: Mapping[str, object], folder: Path) -> dict[str, object]:
    """The tables with all that other files say of materials. Not collective.

    Errors of these files stand beside those of all tables but the materials.
    """
    try:
        return with_series(with_library(tables, folder), folder)
    except InputError as error:
        errors = [*error.each]
        try:
            Case(**{k: v for k, v in tables.items() if k not in ("library", "materials")})
        except InputError as others:  # always: without materials
            errors += [one for one in others.each if one.where != "materials"]
        raise joined(errors) from None


def read_materials(path: str | PathLike[str]) -> dict[str, Material]:
    """The materials of a case file; the rest of it may be missing or wrong. Not collective.

    Raises:
        InputError: With file, dotted key, and what is expected.
    """
    file = str(path)
    with locate_errors(file):
        folder = Path(file).parent
        tables = with_series(with_library(read_toml(file), folder), folder)
    with locate_errors(file, "materials"):
        return read_material_tables(tables.get("materials", {}))


@contextmanager
def locate_errors(file: str, key: str = "", *, exact: bool = True) -> Iterator[None]:
    """Prepends the file's name and a key to the location of an error that is raised inside.

    Args:
        file: Name of the case file, or nothing.
        exact: The error names a key inside the table `key`, and both are joined; otherwise `key`
            is only the origin of the error.
    """
    try:
        yield
    except RestartError:
        raise  # it is not about the case file
    except InputError as error:
        if file and error.where.startswith(file):
            raise

        def place(where: str) -> str:
            if exact or where in ("size", "cells", "origin"):
                parts = [file, dotted(key, where)]
            elif where == "mesh.size" or where.startswith("mesh.refine"):
                parts = [file, where.replace("mesh", key.rpartition(".")[0], 1)]
            else:
                parts = [file, key, where]
            return ": ".join(filter(None, parts))

        raise error.moved(place) from None


@contextmanager
def in_order(tables: Callable[[], Mapping[str, object]]) -> Iterator[None]:
    """Errors that are raised inside stand in the order of these tables of a case."""
    try:
        yield
    except InputError as error:
        raise joined(sorted(error.each, key=lambda one: position(tables(), one.where))) from None
