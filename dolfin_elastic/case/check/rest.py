"""What else is wrong in a case with errors: its other tables are checked against the mesh, too."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path

from mpi4py import MPI

from dolfin_elastic.case.analysis import ANALYSES
from dolfin_elastic.case.case import Case, in_order, locate_errors
from dolfin_elastic.case.case import read_case as read_alone
from dolfin_elastic.case.check.consistency import faults
from dolfin_elastic.case.field_files import with_fields
from dolfin_elastic.case.model_tables import READERS
from dolfin_elastic.case.toml import key_parts, read_toml
from dolfin_elastic.core.errors import MOST_ERRORS, InputError, joined
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.mesh import Body
from dolfin_elastic.problem.obstacles import with_obstacles

_PARTS = ("surfaces", "regions", "edges", "points")
_NAMED = (*_PARTS, "materials", "axes")
_ANY_MATERIAL = {"law": "linear-elastic", "E": 1.0, "nu": 0.3}
"""Where none is right, so that there is a case; no check that needs a material is made of it."""
_PATIENCE = 20.0
"""Seconds that Gmsh may take for a mesh of which only names are wanted."""
_MOST_CELLS = 2e5
"""Cells of a box or rectangle that are made for its names only."""
_ROW = re.compile(r"(\w+)\[(\d+)\]")


def with_the_rest(
    error: InputError,
    tables: Mapping[str, object],
    folder: Path,
    comm: MPI.Comm,
    *,
    trust: bool = False,
) -> InputError:
    """The errors of a case, and those of what remains of it without the wrong tables. Collective.

    What refers to a name that is wrong is left out with it, and so is each check that needs
    something wrong.  Where [mesh] is wrong, or the mesh takes long, nothing is added.

    Args:
        error: What is wrong; each key begins with that of its table.
        tables: The case as it was written.
        folder: Folder that paths are relative to.
        comm: The ranks that read the case; all of them have the error.
        trust: A .geo script may do all that its user may.
    """
    found = list(error.each)
    body: Body | None = None
    while (rest := _Rest.of(tables, found)) is not None:
        try:
            case = on_root(comm, partial(Case.from_dict, rest.tables, folder, trust=trust))
            if case.mesh.generated_cells > _MOST_CELLS:
                break
            body = case.read_mesh(comm) if body is None else body
            named = case.name_parts(body)
            named = with_fields(named, case.fields, case.model_tables(), case.folder)
            named = with_obstacles(named, case.contact, case.folder)
            more = faults(case, named, rest.wrong)
            found += [rest.as_written(one) for one in more]
            break
        except InputError as others:
            told = {one.text for one in found}
            new = [one for one in rest.as_written(others).each if one.text not in told]
            if not new or any("mesh.time_limit" in one.expected for one in new):
                break
            found += new
    return joined(found[:MOST_ERRORS])


def read_case(path: Path, *, comm: MPI.Comm = MPI.COMM_WORLD, trust: bool = False) -> Case:
    """See `case.read_case`; errors of keys have those of the rest beside them. Collective."""
    file = str(path)
    try:
        return read_alone(path, comm=comm, trust=trust)
    except InputError as error:
        bare, folder = _bare(error, file), path.parent
        written = on_root(comm, lambda: read_toml(file))  # else raises that it is no TOML
        with locate_errors(file), in_order(lambda: written):
            raise with_the_rest(bare, written, folder, comm, trust=trust) from None


def read_body(case: Case, comm: MPI.Comm) -> Body:
    """See `Case.read_body`; an error has all others of the case beside it. Collective."""
    try:
        return case.read_body(comm)
    except InputError as error:
        bare, trust = _bare(error, case.file), case.trusted
        with locate_errors(case.file), in_order(lambda: case.written):
            raise with_the_rest(bare, case.written, case.folder, comm, trust=trust) from None


def _bare(error: InputError, file: str) -> InputError:
    """Errors without the name of the case file."""
    return error.moved(lambda where: where.removeprefix(file).removeprefix(": "))


class _Rest:
    """A case without its wrong tables.

    Args:
        tables: The case's, without those that are wrong and what refers to their names.
        wrong: First parts of the keys that are wrong; "" for one that is unknown.
        kept: Key of a list to the indices of the rows that remain.
    """

    def __init__(
        self, tables: dict[str, object], wrong: frozenset[str], kept: Mapping[str, list[int]]
    ) -> None:
        self.tables, self.wrong, self._kept = tables, wrong, kept

    @classmethod
    def of(cls, tables: Mapping[str, object], found: Iterable[InputError]) -> _Rest | None:
        """What remains of the tables of a case; None without a mesh that is right."""
        keys = [key_parts(error.where) for error in found]
        wrong = {key[0] if key else "" for key in keys}
        unknown = tables.keys() - Case.model_fields.keys()
        wrong |= {""} if unknown else set()
        if "library" in tables:
            wrong.add("materials")
        mesh = tables.get("mesh")
        if "mesh" in wrong or not isinstance(mesh, Mapping):
            return None
        names = {key[1] for key in keys if len(key) > 1 and key[0] in _PARTS}
        names |= {n for k in unknown if isinstance(t := tables[k], Mapping) for n in t}
        _spread(names, tables)
        places = {tuple(key[:2]) for key in keys}
        rest: dict[str, object] = {}
        kept: dict[str, list[int]] = {}
        for key, value in tables.items():
            if key in READERS and isinstance(value, list):
                kept[key] = [
                    i
                    for i, row in enumerate(value)
                    if (key, str(i)) not in places and not _mentions(row, names)
                ]
                rest[key] = [value[i] for i in kept[key]]
            elif key in (*_NAMED, "output") and isinstance(value, Mapping):
                lost = names if key in _PARTS else set()
                bare = any(not isinstance(row, Mapping) for row in value.values())
                flat = key == "materials" and bare  # one table, whose keys are no materials
                rest[key] = {
                    name: row
                    for name, row in ({} if flat else value).items()
                    if (key, name) not in places and name not in lost and not _mentions(row, names)
                }
            elif key not in (*wrong, *unknown, *READERS, *_NAMED, "output", "library"):
                rest[key] = value
        if wrong & {"", *ANALYSES}:  # what is written depends on them
            rest.pop("output", None)
            wrong.add("output")
        if "library" in tables or not rest.get("materials"):
            rest["materials"] = {"any": _ANY_MATERIAL}
            wrong.add("materials")
        limit = {"time_limit": _PATIENCE} if mesh.keys() & {"file", "parts"} else {}
        rest["mesh"] = {**{k: v for k, v in mesh.items() if k != "refine"}, **limit}
        return cls(rest, frozenset(wrong), kept)

    def as_written(self, error: InputError) -> InputError:
        """Errors of what remains, with the indices of the whole case."""

        def index(match: re.Match[str]) -> str:
            rows = self._kept.get(match[1])
            return match[0] if rows is None else f"{match[1]}[{rows[int(match[2])]}]"

        def place(where: str) -> str:
            match = _ROW.match(where)
            return where if match is None else index(match) + where[match.end() :]

        return error.moved(place)


def _spread(names: set[str], tables: Mapping[str, object]) -> None:
    """Adds the names of parts that are made of parts with these names."""
    named = [t for key in _PARTS if isinstance(t := tables.get(key), Mapping)]
    while more := {
        name
        for table in named
        for name, row in table.items()
        if name not in names and _mentions(row, names)
    }:
        names |= more


def _mentions(value: object, names: set[str]) -> bool:
    """Whether a text in a table is one of the names, whatever its capitals."""
    if isinstance(value, str):
        return value.casefold() in {name.casefold() for name in names}
    if isinstance(value, Mapping):
        value = list(value.values())
    return isinstance(value, list | tuple) and any(_mentions(one, names) for one in value)
