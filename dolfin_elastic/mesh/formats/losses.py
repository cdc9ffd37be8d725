"""What meshio 5.3 would leave out of a mesh in silence, or tell where nobody reads it.

Nodes, elements and coordinates that are not understood are an error, whichever reader it is.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.files import hdf5

_HARMLESS = re.compile(
    r"Experimental file format|legacy format|deprecated|tag data|Appending zeros|Comment with #"
    r"|know (?:Gmf|keyword )(?:Corners|Ridges|Required\w+|Normals?\w*|Tangents?\w*|SubDomain\w+"
    r"|\w+OnGeometric\w+|Identifier|Geometry)\b"
)
"""Warnings of meshio about names, features and formats, not about nodes or elements."""


def check_warnings(text: str, path: Path) -> None:
    """Refuses a file of which meshio has left something out.

    Raises:
        MeshError: It is about nodes or elements.
    """
    for warning in re.split(r"Warning:", " ".join(text.split()))[1:]:
        if not _HARMLESS.search(warning):
            raise MeshError(
                f"meshio leaves a part of it out: {warning.strip()[:300]}",
                where=path.name,
                expected="save the mesh in another format, for example .msh or .vtu",
            )


def check_before(path: Path) -> None:
    """Looks for what meshio passes over in formats where it reads the first of several. Local.

    Raises:
        MeshError: There is such a thing.
    """
    check = _CHECKS.get(path.suffix.lower())
    if check is not None:
        check(path)


def check_cells(path: Path, cells: int) -> None:
    """Compares the number of cells with that which a legacy VTK file states. Local.

    Raises:
        MeshError: They differ.
    """
    if path.suffix.lower() != ".vtk":
        return
    stated = re.search(rb"^CELL_TYPES[ \t]+(\d+)", path.read_bytes(), re.MULTILINE | re.IGNORECASE)
    if stated and int(stated[1]) != cells:
        raise MeshError(f"{cells} cells are read, CELL_TYPES states {int(stated[1])}")


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Number and text of each line."""
    with path.open(encoding="latin-1") as file:
        for number, line in enumerate(file, start=1):
            yield number, line.strip()


def _check_med(path: Path) -> None:
    """Coordinates of MED are taken as rectangular ones, whatever the attribute REP says."""
    if not hdf5.is_hdf5(path):
        return
    with hdf5.opened(path) as file:
        for mesh in file.get("ENS_MAA", {}).values():
            system = int(mesh.attrs.get("REP", 0))
            if system:
                kind = {1: "cylindrical", 2: "spherical"}.get(system, f"of the kind {system}")
                raise MeshError(
                    f"its coordinates are {kind} (REP = {system})",
                    where=path.name,
                    expected="rectangular coordinates",
                )


def _check_cgns(path: Path) -> None:
    """Of CGNS the first zone of the first base is read."""
    if not hdf5.is_hdf5(path):
        return
    with hdf5.opened(path) as file:
        zones = [name for base in file.values() for name in _groups(base)]
        sections = _groups(file["Base/Zone1"]) if "Base/Zone1" in file else []
        elements = [name for name in sections if "ElementConnectivity" in file["Base/Zone1"][name]]
    if len(zones) > 1 or len(elements) > 1:
        raise MeshError(
            f"it has {len(zones)} zones with {len(elements)} sections of elements",
            where=path.name,
            expected="one zone with one section",
        )


def _groups(group: object) -> list[str]:
    import h5py

    if not isinstance(group, h5py.Group):
        return []
    return [name for name, one in group.items() if isinstance(one, h5py.Group)]


def _check_tecplot(path: Path) -> None:
    """Of Tecplot the first zone is read."""
    zones = [number for number, line in _lines(path) if line.upper().startswith("ZONE")]
    if len(zones) > 1:
        raise MeshError(
            "a second ZONE is not read", where=f"{path.name}:{zones[1]}", expected="one zone"
        )


def _check_su2(path: Path) -> None:
    """Of SU2 all zones are read as one with the numbers of each."""
    for number, line in _lines(path):
        key, _, value = line.partition("=")
        if key.strip().upper() == "NZONE" and value.strip() != "1":
            raise MeshError(
                "several zones are not read", where=f"{path.name}:{number}", expected="one zone"
            )


def _check_vtk(path: Path) -> None:
    """Of legacy VTK the last grid is read."""
    if path.read_bytes().upper().count(b"\nDATASET ") > 1:
        raise MeshError("it has several grids", where=path.name, expected="one DATASET")


_CHECKS: dict[str, Callable[[Path], None]] = {
    ".med": _check_med,
    ".cgns": _check_cgns,
    ".dat": _check_tecplot,
    ".tec": _check_tecplot,
    ".su2": _check_su2,
    ".vtk": _check_vtk,
}
