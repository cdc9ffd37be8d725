"""Meshing with Gmsh, in the process that may do nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.formats.cad.curved import exact_normals, follow_curves
from dolfin_elastic.mesh.formats.cad.script import SCRIPTS
from dolfin_elastic.mesh.formats.cad.shapes import (
    Lengths,
    Remarks,
    diagonal,
    import_shapes,
    load_shapes,
    touching,
)
from dolfin_elastic.mesh.formats.cad.sizes import (
    DefaultSize,
    LocalField,
    set_default_size,
    set_sizes,
)

RESULT = "mesh.msh"
"""The file that is saved."""
NORMALS = "normals.bin"
"""The file of the normals of its faces, see `save_normals`."""
_SAVE_OPTIONS = {"Mesh.MshFileVersion": 4.1, "Mesh.Binary": 1, "Mesh.SaveAll": 1}
_NO_SIZES = {"MeshSizeMin": 0.0, "MeshSizeMax": 1e22, "MeshSizeFromCurvature": 0.0}
"""Options of sizes, with the values that they have where nobody sets them."""
_OTHER_SIZES = 0.5, 0.25, 2.0
"""Factors on the default size that are tried where Gmsh fails with it."""


def load_file(
    gmsh: ModuleType, path: Path, *, dim: int | None, join: bool, lengths: Lengths
) -> tuple[Remarks, int]:
    """Loads a CAD file with the names of its bodies into Gmsh's current model. Local.

    Args:
        gmsh: Gmsh with an empty model.
        dim: 2 or 3; None: 3 where there are volumes.
        join: Bodies that touch share the nodes there.

    Returns:
        Remarks, and the dimension of the body.

    Raises:
        MeshError: There is nothing to mesh.
    """
    if path.suffix.lower() in SCRIPTS:
        gmsh.open(str(path))
        remarks = Remarks(notes=touching(gmsh, lengths, "end the .geo file with Coherence;"))
    else:
        remarks = import_shapes(gmsh, path, join=join, lengths=lengths)
    dim = dim or (3 if gmsh.model.getEntities(3) else 2)
    if not gmsh.model.getEntities(dim):
        raise MeshError(
            "the file has neither volumes nor surfaces to mesh"
            if dim == 2
            else "the file has no volumes to mesh",
            where=path.name,
            expected="save the solid as STEP" if dim == 3 else "save the body, not curves alone",
        )
    return remarks, dim


def mesh_model(
    gmsh: ModuleType,
    name: str,
    *,
    size: float | None,
    local: Sequence[LocalField],
    curved: bool | None,
    dim: int,
    lengths: Lengths,
) -> Remarks:
    """Meshes the current model. Local.

    Args:
        size: Size of the elements, see `read.mesh_cad`.
        local: Smaller sizes in places, see `sizes.set_sizes`.
        curved: Whether cells follow curved surfaces.

    Raises:
        MeshError: It cannot be meshed.
    """
    nothing = size is None and not _has_sizes(gmsh) and not _has_options(gmsh)
    default = set_default_size(gmsh, dim) if nothing else None
    how = _mesh(gmsh, size, dim, name, lengths, local, default)
    curves, notes = "", list[str]()
    if curved is not False:
        curves, notes = follow_curves(gmsh, dim, curved, lengths, sized=not nothing)
    return Remarks(
        [f"meshed by Gmsh, {how}{curves}"], [*(default.notes(lengths) if default else ()), *notes]
    )


def load(gmsh: ModuleType, path: Path) -> None:
    """Loads a CAD file, which is not meshed. Local.

    Args:
        gmsh: Gmsh with an empty model.
    """
    if path.suffix.lower() in SCRIPTS:
        gmsh.open(str(path))
    else:
        load_shapes(gmsh, path)


def save(gmsh: ModuleType, folder: Path) -> None:
    """Saves the mesh as `msh.read_msh` reads it.

    Args:
        folder: In which it becomes the file `RESULT`.
    """
    for name, value in _SAVE_OPTIONS.items():
        gmsh.option.setNumber(name, value)
    gmsh.write(str(folder / RESULT))


def save_normals(gmsh: ModuleType, dim: int, folder: Path) -> list[tuple[int, int]]:
    """Saves the normals of faces at the vertices of their elements; see `exact_normals`.

    Args:
        folder: In which they become the file `NORMALS`, numbers of 8 byte one after the other.

    Returns:
        The faces, with the number of their elements.
    """
    result = exact_normals(gmsh, dim)
    np.concatenate([n.reshape(-1) for _, n in result]).astype("<f8").tofile(folder / NORMALS)
    return [(tag, len(normals)) for tag, normals in result]


def read_normals(
    folder: Path, counts: Sequence[tuple[int, int]], dim: int
) -> dict[int, FloatArray]:
    """What `save_normals` has saved: number of a face to normals of shape (elements, dim, 3).

    Args:
        folder: In which the file is.
        counts: Faces, with the number of their elements.

    Raises:
        MeshError: The file has another size.
    """
    values = np.fromfile(folder / NORMALS, dtype="<f8")
    ends = np.cumsum([0, *(int(count) for _, count in counts)])
    if len(values) != ends[-1] * dim * 3:
        raise MeshError("Gmsh has not written the normals of the faces")
    rows = values.reshape(-1, dim, 3)
    return {int(counts[i][0]): rows[ends[i] : ends[i + 1]] for i in range(len(counts))}


def _mesh(
    gmsh: ModuleType,
    size: float | None,
    dim: int,
    source: str,
    lengths: Lengths,
    local: Sequence[LocalField],
    default: DefaultSize | None,
) -> str:
    """Meshes the current model; returns the size in words."""
    if size is not None:
        gmsh.model.mesh.clear()
        gmsh.option.setNumber("Mesh.MeshSizeMax", size / lengths.factor)
        # Without a lower limit Gmsh makes no cells above a tenth of the diagonal.
        if not _has_sizes(gmsh):
            gmsh.option.setNumber("Mesh.MeshSizeMin", size / lengths.factor)
        _check_count(gmsh, size, dim, source, lengths)
    if local:
        gmsh.model.mesh.clear()
        whole = size / lengths.factor if size is not None else 0.1 * diagonal(gmsh)
        set_sizes(gmsh, dim, local, whole=whole, name=source)
    if len(gmsh.model.mesh.getElements(dim)[0]):  # a .geo file may mesh by itself
        return "as the file says"
    factor = _generate(gmsh, dim, source, retry=size is None)
    if size is not None:
        return f"size {size:g} {lengths.name}"
    text = default.text(lengths) if default else "sizes of the file"
    if factor == 1.0:
        return text
    return f"{factor:g} times the {text}, with which Gmsh finds no valid mesh"


def _generate(gmsh: ModuleType, dim: int, source: str, *, retry: bool) -> float:
    """Makes the cells; the factor on the default size with which that succeeded."""
    before = gmsh.option.getNumber("Mesh.MeshSizeFactor")
    errors = []
    for factor in (1.0, *_OTHER_SIZES) if retry else (1.0,):
        gmsh.option.setNumber("Mesh.MeshSizeFactor", factor * before)
        errors.append(_errors_of_meshing(gmsh, dim))
        if not errors[-1]:
            return factor
        gmsh.model.mesh.clear()
    tried = " (nor with elements half, a quarter and twice as large)" if retry else ""
    raise MeshError(
        f"Gmsh cannot mesh it{tried}: {errors[0]}",
        where=source,
        expected="another mesh.size, about the thickness of thin walls; or mend the faces there",
    )


def _errors_of_meshing(gmsh: ModuleType, dim: int) -> str:
    """Makes the cells; what Gmsh reports if it cannot."""
    start = len(gmsh.logger.get())
    before = gmsh.option.getNumber("General.AbortOnError")
    # By default Gmsh raises an exception, and would not mesh anything after that.
    gmsh.option.setNumber("General.AbortOnError", 1)
    try:
        gmsh.model.mesh.generate(dim)
    finally:
        gmsh.option.setNumber("General.AbortOnError", before)
    empty = [e for e in gmsh.model.getEntities(dim) if not len(gmsh.model.mesh.getElements(*e)[0])]
    text = logged_errors(gmsh, start)
    return text or (f"{len(empty)} of its bodies have no elements" if empty else "")


MAX_CELLS = 5e7
"""Cells that one rank can mesh."""


def _check_count(gmsh: ModuleType, size: float, dim: int, name: str, lengths: Lengths) -> None:
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
    count = amount * (lengths.factor / size) ** dim * (8 if dim == 3 else 2)
    if count > MAX_CELLS:
        box = gmsh.model.getBoundingBox(-1, -1)
        extent = " x ".join(f"{(box[i + 3] - box[i]) * lengths.factor:.4g}" for i in range(3))
        raise MeshError(
            f"elements of size {size:g} in a body of {extent} {lengths.name} would be about "
            f"{count:.1g}",
            where=name,
            expected=f"at most {MAX_CELLS:.0g}: is mesh.unit right?",
        )


def _occ_entities(gmsh: ModuleType, dim: int) -> list[tuple[int, int]]:
    """Solids (surfaces in 2D) of the OpenCASCADE kernel, which computes their volume."""
    return [
        entity
        for entity in gmsh.model.getEntities(dim)
        if entity in gmsh.model.occ.getEntities(dim)
    ]


def _has_sizes(gmsh: ModuleType) -> bool:
    """True where a .geo file asks for sizes of its own, which may be finer."""
    points = gmsh.model.getEntities(0)
    return len(gmsh.model.mesh.field.list()) > 0 or any(
        size > 0 for size in (gmsh.model.mesh.getSizes(points) if points else ())
    )


def _has_options(gmsh: ModuleType) -> bool:
    """True where a .geo file has set bounds of sizes, or what they follow."""
    get = gmsh.option.getNumber
    return any(get(f"Mesh.{name}") != usual for name, usual in _NO_SIZES.items())


def logged_errors(gmsh: ModuleType, start: int = 0) -> str:
    """The first three error messages of Gmsh.

    Args:
        start: Line of its log to begin with.
    """
    lines = [
        line.split(":", 1)[1].strip()
        for line in gmsh.logger.get()[start:]
        if line.startswith("Error:")
    ]
    return "; ".join(dict.fromkeys(lines[:3]))
