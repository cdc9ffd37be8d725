"""MED files, of which meshio 5.3 needs more than they must have: what it lacks is filled in.

Layout of the HDF5 file: /ENS_MAA/mesh/[step/]NOE/COO and MAI/type/NOD, families in /FAS, fields in
/CHA.  Version 2, until 2007 and in Salome until 6, has neither steps nor the attribute ESP, the
names of groups as one text, and another layout of fields.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.files import hdf5
from dolfin_elastic.core.types import AnyArray

if TYPE_CHECKING:
    import h5py

_ELEMENTS = frozenset(
    [
        "PO1",
        "SE2",
        "SE3",
        "TR3",
        "TR6",
        "QU4",
        "QU8",
        "TE4",
        "T10",
        "HE8",
        "H20",
        "PY5",
        "PE6",
        "P15",
    ]
)
_NAME = 80  # letters of the name of a group
_ALL = "MED_NO_PROFILE_INTERNAL"

Change = Callable[["h5py.File"], None]


def check(path: Path) -> None:
    """Refuses coordinates and elements that meshio takes for others, or does not know. Local.

    Raises:
        MeshError: With what would be right.
    """
    if not hdf5.is_hdf5(path):
        return
    with hdf5.opened(path) as file:
        for mesh in file.get("ENS_MAA", {}).values():
            step = _step(mesh)
            places = step.get("NOE/COO")
            system = int(mesh.attrs.get("REP", places.attrs.get("REP", 0) if places else 0))
            if system:
                kind = {1: "cylindrical", 2: "spherical"}.get(system, f"of the kind {system}")
                raise MeshError(
                    f"its coordinates are {kind} (REP = {system})",
                    where=path.name,
                    expected="rectangular coordinates",
                )
            if others := sorted(set(step.get("MAI", {})) - _ELEMENTS):
                raise MeshError(
                    f"its elements {', '.join(others)} are not read",
                    where=path.name,
                    expected="TE4 or T10 (tetrahedra), or TR3 or TR6 (triangles)",
                )


def left_out(path: Path) -> list[str]:
    """Notes on what is not read of a file that is."""
    with hdf5.opened(path) as file:
        if file.get("CHA") and _is_old(file):
            return ["fields of MED 2 are not read: save the file anew, as MED 3 or 4"]
    return []


def completed(path: Path) -> io.BytesIO | None:
    """A copy of a MED file in memory with all that meshio needs; None: the file has it."""
    import h5py

    with hdf5.opened(path) as file:
        changes = [change for mesh in file["ENS_MAA"].values() for change in _gaps(file, mesh)]
    if not changes:
        return None
    copy = io.BytesIO(path.read_bytes())
    with h5py.File(copy, "r+") as file:
        for change in changes:
            change(file)
    copy.seek(0)
    return copy


def _step(mesh: h5py.Group) -> h5py.Group:
    """The nodes and elements of a mesh, at its only or first step."""
    return mesh if "NOE" in mesh else next(iter(mesh.values()), mesh)


def _is_old(file: h5py.File) -> bool:
    return any("ESP" not in mesh.attrs for mesh in file["ENS_MAA"].values())


def _gaps(file: h5py.File, mesh: h5py.Group) -> list[Change]:
    changes = list[Change]()
    step = _step(mesh)
    families = mesh.get("FAS", file.get(f"FAS/{mesh.name.split('/')[-1]}"))
    if families is None:
        changes.append(_group(f"FAS/{mesh.name.split('/')[-1]}/ELEME"))
    for kind in ("NOEUD", "ELEME"):
        for family in (families or {}).get(kind, {}).values():
            if "GRO" not in family:
                changes += [_group(f"{family.name}/GRO", NBR=0)]
                changes += [_array(f"{family.name}/GRO/NOM", np.zeros((0, _NAME), np.int8))]
            elif (names := family["GRO/NOM"]).dtype.kind == "S":
                changes.append(_array(names.name, _names(names, family["GRO"].attrs["NBR"])))
    elements = dict(step["MAI"])
    counts = {kind: int(one["NOD"].attrs["NBR"]) for kind, one in elements.items()}
    if any("FAM" in one for one in elements.values()):
        for kind, one in elements.items():
            if "FAM" not in one:
                changes.append(_array(f"{one.name}/FAM", np.zeros(counts[kind], np.int64)))
    if "ESP" not in mesh.attrs:
        places = step["NOE/COO"]
        dim = len(places) // int(places.attrs["NBR"])
        return [*changes, _group(mesh.name, ESP=dim), _without_fields]
    return changes + _fields(file, counts)


def _fields(file: h5py.File, counts: dict[str, int]) -> list[Change]:
    """Not a number, for elements of each kind that a field of other elements is not on."""
    changes = list[Change]()
    for field in file.get("CHA", {}).values():
        for step in field.values():
            on = {support.partition(".")[2]: support for support in step if "." in support}
            for kind in sorted(set(counts) - set(on)) if on else ():
                like = next(iter(step[next(iter(on.values()))].values())).attrs["NGA"]
                name = f"{step.name}/MAI.{kind}"
                values = np.full(counts[kind] * int(like) * int(field.attrs["NCO"]), np.nan)
                changes += [
                    _group(name, PFL=np.bytes_(_ALL)),
                    _group(f"{name}/{_ALL}", NBR=counts[kind], NGA=like),
                    _array(f"{name}/{_ALL}/CO", values),
                ]
    return changes


def _names(names: h5py.Dataset, count: int) -> AnyArray:
    """Names of groups as rows of letters, up to the first zero; shape (count, 80)."""
    rows = np.frombuffer(names[()].tobytes(), np.uint8)[: count * _NAME].reshape(count, _NAME)
    return np.where(np.logical_and.accumulate(rows > 0, axis=1), rows, 0)


def _group(name: str, **attributes: object) -> Change:
    def change(file: h5py.File) -> None:
        file.require_group(name).attrs.update(attributes)

    return change


def _array(name: str, values: AnyArray) -> Change:
    def change(file: h5py.File) -> None:
        if name in file:
            del file[name]
        file[name] = values

    return change


def _without_fields(file: h5py.File) -> None:
    file.pop("CHA", None)
