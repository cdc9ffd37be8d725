"""Gmsh as a mesher of CAD files, and as a converter of old .msh files."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.msh import read_msh
from dolfin_elastic.mesh.formats.raw import MeshFile

_SAVE_OPTIONS = {"Mesh.MshFileVersion": 4.1, "Mesh.Binary": 1, "Mesh.SaveAll": 1}
_OPTIONS = (*_SAVE_OPTIONS, "Mesh.MeshSizeMax", "Mesh.MeshSizeMin", "General.Terminal")


def mesh_cad(path: Path, *, size: float | None, curved: bool | None, dim: int | None) -> MeshFile:
    """Meshes a CAD file. Local: one rank meshes.

    Args:
        path: .geo, .step, .brep or .iges.
        size: Size of the elements, in the file's unit; where the file asks for finer ones, that
            holds.  None: as the file says, or a tenth of its diagonal.
        curved: Quadratic cells that follow curved surfaces; None: where there are any, and the
            cells do not fold.
        dim: 2 or 3; by default 3 where there are volumes.

    Raises:
        MeshError: Gmsh cannot read or mesh the file.
    """
    _check_last_line(path)
    with _gmsh(path) as gmsh:
        if size is not None:
            gmsh.model.mesh.clear()
            gmsh.option.setNumber("Mesh.MeshSizeMax", size)
            # Without a lower limit Gmsh makes no cells above a tenth of the diagonal.
            if not _has_sizes(gmsh):
                gmsh.option.setNumber("Mesh.MeshSizeMin", size)
        dim = dim or (3 if gmsh.model.getEntities(3) else 2)
        if not gmsh.model.getEntities(dim):
            raise MeshError(
                "the file has neither volumes nor surfaces to mesh"
                if dim == 2
                else "the file has no volumes to mesh",
                where=path.name,
            )
        if size is not None:
            _check_count(gmsh, size, dim, path.name)
        if not len(gmsh.model.mesh.getElements(dim)[0]):  # a .geo file may mesh by itself
            gmsh.model.mesh.generate(dim)
        how = "size as in the file" if size is None else f"size {size:g} (mesh.unit)"
        if curved is not False:
            how += _follow_curves(gmsh, dim, curved)
        found = _save_and_read(gmsh)
    return MeshFile(found.points, found.blocks, [*found.notes, f"meshed by Gmsh, {how}"])


_LEAST = 0.1
"""Smallest over largest determinant of the map of a curved cell; in straight ones it is 1."""


def _follow_curves(gmsh: Any, dim: int, curved: bool | None) -> str:
    """Makes the cells quadratic, with their boundary nodes on the CAD surfaces.

    Where cells would fold, in a thin wall or at a small fillet, Gmsh moves nodes inside the body as
    if it were elastic, and what still folds gets straight edges.  (Gmsh's other optimisation,
    "HighOrder", can end the process: it throws in a thread of OpenMP.)

    Args:
        gmsh: Gmsh with a mesh.
        dim: 2 or 3.
        curved: None: only if a face of the body is curved.

    Returns:
        What has been done, for the note.
    """
    flat = "Plane" if dim == 3 else "Line"
    properties = map(gmsh.model.mesh.getElementProperties, gmsh.model.mesh.getElementTypes(dim))
    if curved is None and (
        any(order > 1 for _, _, order, *_ in properties)  # as a .geo file says
        or all(gmsh.model.getType(*face) == flat for face in gmsh.model.getEntities(dim - 1))
    ):
        return ""
    gmsh.model.mesh.setOrder(2)
    if curved is None and not _is_curved(gmsh, dim):
        gmsh.model.mesh.setOrder(1)
        return ""
    if len(_folded(gmsh, dim)):
        gmsh.model.mesh.optimize("HighOrderElastic")
    count = _straighten_folded(gmsh, dim)
    return ", cells curved" + (f", but for {count} that would fold" if count else "")


_EDGES = {
    1: [(0, 1, 2)],
    2: [(0, 1, 3), (1, 2, 4), (2, 0, 5)],
    3: [(0, 1, 4), (1, 2, 5), (2, 0, 6), (3, 0, 7), (3, 2, 8), (3, 1, 9)],
}
"""Ends and middle of the edges of Gmsh's quadratic line, triangle and tetrahedron."""
_KINDS = {1: 8, 2: 9, 3: 11}
"""Their types."""


def _nodes(gmsh: Any, dim: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Tags, nodes of shape (n, k) and their places (n, k, 3) of the quadratic cells of a kind."""
    cells, nodes = gmsh.model.mesh.getElementsByType(_KINDS[dim])
    tags, places, _ = gmsh.model.mesh.getNodes()
    order = np.argsort(tags)
    nodes = np.asarray(nodes).reshape(len(cells), -1)
    at = order[np.searchsorted(tags, nodes, sorter=order)]
    return np.asarray(cells), nodes, np.asarray(places).reshape(-1, 3)[at]


def _is_curved(gmsh: Any, dim: int) -> bool:
    """Whether a quadratic facet of the boundary has a middle node off its straight edge."""
    _, _, x = _nodes(gmsh, dim - 1)
    return any(
        np.any(
            np.linalg.norm(x[:, c] - (x[:, a] + x[:, b]) / 2, axis=1)
            > 1e-6 * np.linalg.norm(x[:, b] - x[:, a], axis=1)
        )
        for a, b, c in _EDGES[dim - 1]
    )


def _folded(gmsh: Any, dim: int) -> IntArray:
    """Positions of the cells whose map is singular, or almost, somewhere in them."""
    tags = gmsh.model.mesh.getElementsByType(_KINDS[dim])[0].tolist()
    low, high = (
        np.asarray(gmsh.model.mesh.getElementQualities(tags, name))
        for name in ("minDetJac", "maxDetJac")
    )
    # Cells that run the other way round have negative determinants throughout.
    side = np.sign(low + high)
    smallest, largest = np.minimum(low * side, high * side), np.maximum(np.abs(low), np.abs(high))
    return np.flatnonzero(smallest < _LEAST * largest)


def _straighten_folded(gmsh: Any, dim: int) -> int:
    """Makes the edges of folded cells straight, and of those that then fold; their number."""
    straight: set[int] = set()
    while new := set(_folded(gmsh, dim).tolist()) - straight:
        straight |= new
        _, nodes, x = _nodes(gmsh, dim)
        at = sorted(new)
        for a, b, c in _EDGES[dim]:
            for tag, place in zip(nodes[at, c], (x[at, a] + x[at, b]) / 2, strict=True):
                gmsh.model.mesh.setNode(int(tag), place.tolist(), [])
    return len(straight)


MAX_CELLS = 5e7
"""Cells that one rank can mesh."""


def _check_count(gmsh: Any, size: float, dim: int, name: str) -> None:
    """Refuses sizes that give too many cells, such as a size in mm for a body in m.

    A cell of edge h fills about h^3/8 (a tetrahedron) or h^2/2 (a triangle).
    """
    amount = (
        sum(gmsh.model.occ.getMass(*e) for e in _occ_entities(gmsh, dim))
        if _occ_entities(gmsh, dim)
        else None
    )
    if amount is None:
        return
    count = amount / size**dim * (8 if dim == 3 else 2)
    if count > MAX_CELLS:
        box = gmsh.model.getBoundingBox(-1, -1)
        extent = " x ".join(f"{box[i + 3] - box[i]:.4g}" for i in range(3))
        raise MeshError(
            f"elements of size {size:g} in a body of {extent} would be about {count:.1g}",
            where=name,
            expected=f"at most {MAX_CELLS:.0g}: is mesh.unit right?",
        )


def _occ_entities(gmsh: Any, dim: int) -> list[tuple[int, int]]:
    """Solids (surfaces in 2D) of the OpenCASCADE kernel, which computes their volume."""
    return [
        entity
        for entity in gmsh.model.getEntities(dim)
        if entity in gmsh.model.occ.getEntities(dim)
    ]


def _check_last_line(path: Path) -> None:
    """Refuses a last line of several statements without line break: Gmsh 4.13 drops some."""
    last = path.read_bytes().rpartition(b"\n")[2] if path.suffix.lower() == ".geo" else b""
    if last.count(b";") > 1:
        raise MeshError(
            "the last line has no line break: Gmsh would leave a part of it out",
            where=path.name,
            expected="end the file with an empty line",
        )


def _has_sizes(gmsh: Any) -> bool:
    """True where a .geo file asks for sizes of its own, which may be finer."""
    points = gmsh.model.getEntities(0)
    return len(gmsh.model.mesh.field.list()) > 0 or any(
        size > 0 for size in (gmsh.model.mesh.getSizes(points) if points else ())
    )


@contextmanager
def open_model(path: Path) -> Iterator[Any]:
    """Gmsh's model of a CAD file, which is not meshed. Local.

    Args:
        path: .geo, .step, .brep or .iges.

    Raises:
        MeshError: Gmsh cannot read it.
    """
    with _gmsh(path) as gmsh:
        yield gmsh.model


def convert_msh(path: Path) -> MeshFile:
    """Reads a .msh file of an old version. Local: one rank reads."""
    with _gmsh(path) as gmsh:
        return _save_and_read(gmsh)


def _save_and_read(gmsh: Any) -> MeshFile:
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "mesh.msh"
        for name, value in _SAVE_OPTIONS.items():
            gmsh.option.setNumber(name, value)
        gmsh.write(str(target))
        return read_msh(target)


@contextmanager
def _gmsh(path: Path) -> Iterator[Any]:
    """Gmsh with a file open and without output; its errors are raised as `MeshError`."""
    try:
        import gmsh
    except ImportError:
        raise MeshError(
            "Gmsh is needed for this file but its Python module is not installed",
            where=path.name,
            expected="install python3-gmsh",
        ) from None
    own = not gmsh.isInitialized()
    if own:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    options = {name: gmsh.option.getNumber(name) for name in _OPTIONS}
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.logger.start()
    before = gmsh.model.list()
    try:
        gmsh.open(str(path))
        yield gmsh
    except Exception as error:
        if type(error) is not Exception:  # Gmsh raises this base class itself
            raise
        raise MeshError(
            f"Gmsh cannot read or mesh it: {_errors(gmsh, error)}", where=path.name
        ) from None
    finally:
        gmsh.logger.stop()
        if own:
            gmsh.finalize()
        else:
            _restore_gmsh(gmsh, before, options)


def _errors(gmsh: Any, error: Exception) -> str:
    """The first three error messages of Gmsh."""
    lines = [
        line.split(":", 1)[1].strip() for line in gmsh.logger.get() if line.startswith("Error:")
    ]
    return "; ".join(dict.fromkeys(lines[:3])) or str(error)


def _restore_gmsh(gmsh: Any, before: list[str], options: dict[str, float]) -> None:
    """Restores options and models of a Gmsh session that the caller had started."""
    for name, value in options.items():
        gmsh.option.setNumber(name, value)
    for name in gmsh.model.list():
        if name not in before:
            gmsh.model.setCurrent(name)
            gmsh.model.remove()
