"""Gmsh as a mesher of CAD files, and as a converter of old .msh files."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.mesh.formats.msh import read_msh
from dolfin_elastic.mesh.formats.raw import MeshFile

_SAVE_OPTIONS = {"Mesh.MshFileVersion": 4.1, "Mesh.Binary": 1, "Mesh.SaveAll": 1}
_OPTIONS = (*_SAVE_OPTIONS, "Mesh.MeshSizeMax", "Mesh.MeshSizeMin", "General.Terminal")


def mesh_cad(path: Path, *, size: float | None, curved: bool, dim: int | None) -> MeshFile:
    """Meshes a CAD file. Local: one rank meshes.

    Args:
        path: .geo, .step, .brep or .iges.
        size: Size of the elements, in the file's unit; where the file asks for finer ones, that
            holds.  None: as the file says, or a tenth of its diagonal.
        curved: Quadratic cells that follow curved surfaces.
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
        if curved:
            _make_quadratic(gmsh, dim)
        found = _save_and_read(gmsh)
    how = "size as in the file" if size is None else f"size {size:g} (mesh.unit)"
    how += ", cells curved" if curved else ""
    return MeshFile(found.points, found.blocks, [*found.notes, f"meshed by Gmsh, {how}"])


def _make_quadratic(gmsh: Any, dim: int) -> None:
    """Makes the cells quadratic, with their boundary nodes on the CAD surfaces.

    Where a cell would have a negative Jacobian, in a thin wall or at a small fillet, Gmsh moves its
    nodes and, if that fails, makes its edges straight.
    """
    gmsh.model.mesh.setOrder(2)
    _, tags, _ = gmsh.model.mesh.getElements(dim)
    cells = [tag for some in tags for tag in some]
    if min(gmsh.model.mesh.getElementQualities(cells, "minSJ"), default=1.0) <= 0.0:
        gmsh.model.mesh.optimize("HighOrder")


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
