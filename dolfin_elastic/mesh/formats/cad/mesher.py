"""Gmsh as a mesher of CAD files, and as a converter of old .msh files."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.units import METRE, LengthUnit
from dolfin_elastic.mesh.formats.cad.curved import follow_curves
from dolfin_elastic.mesh.formats.cad.script import check_script
from dolfin_elastic.mesh.formats.cad.shapes import (
    Lengths,
    Remarks,
    diagonal,
    import_shapes,
    load_shapes,
    touching,
)
from dolfin_elastic.mesh.formats.msh import read_msh
from dolfin_elastic.mesh.formats.raw import MeshFile

SCRIPTS = (".geo", ".geo_unrolled")
_SAVE_OPTIONS = {"Mesh.MshFileVersion": 4.1, "Mesh.Binary": 1, "Mesh.SaveAll": 1}
_OPTIONS = (
    *_SAVE_OPTIONS,
    "Mesh.MeshSizeMax",
    "Mesh.MeshSizeMin",
    "Mesh.MeshSizeFactor",
    "General.Terminal",
)
_UNIT_OPTION = "Geometry.OCCTargetUnit"
_OTHER_SIZES = 0.5, 0.25, 2.0
"""Factors on the default size that are tried where Gmsh fails with it."""


def mesh_cad(
    path: Path,
    *,
    size: float | None,
    curved: bool | None,
    dim: int | None,
    join: bool = True,
    stated: LengthUnit | None = None,
    unit: LengthUnit | None = None,
) -> MeshFile:
    """Meshes a CAD file. Local: one rank meshes.

    Args:
        path: .geo, .step, .brep or .iges.
        size: Size of the elements, in the file's unit; where the file asks for finer ones, that
            holds.  None: as the file says, or a tenth of its diagonal, or what Gmsh can mesh.
        curved: Quadratic cells that follow curved surfaces; None: where there are any, and the
            cells do not fold.
        dim: 2 or 3; by default 3 where there are volumes.
        join: Bodies that touch share the nodes there; a .geo file joins its bodies itself.
        stated: Unit that the file states.
        unit: Unit that is taken for it, for messages; by default the same, or m.

    Raises:
        MeshError: Gmsh cannot read or mesh the file, or it asks for more than a mesh.
    """
    is_script = _checked_script(path)
    lengths = Lengths((unit or stated or METRE).name, model_unit(stated, path))
    with _gmsh(path, read=is_script) as gmsh:
        if is_script:
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
            )
        how = _mesh(gmsh, size, dim, path.name, lengths)
        how += "" if curved is False else follow_curves(gmsh, dim, curved)
        found = _save_and_read(gmsh)
    return MeshFile(
        found.points * lengths.factor,
        found.blocks,
        [*found.notes, *remarks.notes],
        [*remarks.information, f"meshed by Gmsh, {how}"],
    )


@contextmanager
def open_model(path: Path) -> Iterator[ModuleType]:
    """Gmsh's model of a CAD file, which is not meshed. Local.

    Args:
        path: .geo, .step, .brep or .iges.

    Raises:
        MeshError: Gmsh cannot read it.
    """
    is_script = _checked_script(path)
    with _gmsh(path, read=is_script) as gmsh:
        if not is_script:
            load_shapes(gmsh, path)
        yield gmsh.model


def _checked_script(path: Path) -> bool:
    """Whether the file is a script; one that does more than describe a body is refused."""
    if path.suffix.lower() not in SCRIPTS:
        return False
    _check_last_line(path)
    check_script(path)
    return True


def model_unit(stated: LengthUnit | None, path: Path) -> float:
    """Units of the file per unit of Gmsh's model: OpenCASCADE converts STEP and IGES to mm.

    Args:
        stated: Unit that the file states.
        path: The file; a script's model is in the script's unit.
    """
    is_script = path.suffix.lower() in SCRIPTS
    return 1.0 if stated is None or is_script else 1e-3 / stated.metres


def _mesh(gmsh: ModuleType, size: float | None, dim: int, source: str, lengths: Lengths) -> str:
    """Meshes the current model; returns the size in words."""
    has_sizes = _has_sizes(gmsh)
    if size is not None:
        gmsh.model.mesh.clear()
        gmsh.option.setNumber("Mesh.MeshSizeMax", size / lengths.factor)
        # Without a lower limit Gmsh makes no cells above a tenth of the diagonal.
        if not has_sizes:
            gmsh.option.setNumber("Mesh.MeshSizeMin", size / lengths.factor)
        _check_count(gmsh, size, dim, source, lengths)
    if len(gmsh.model.mesh.getElements(dim)[0]):  # a .geo file may mesh by itself
        return "as the file says"
    factor = _generate(gmsh, dim, source, retry=size is None)
    if size is not None:
        return f"size {size:g} {lengths.name}"
    default = "sizes of the file"
    if not has_sizes:
        tenth = lengths.text(0.1 * diagonal(gmsh), 1)
        default = f"default size, a tenth of the diagonal ({tenth})"
    if factor == 1.0:
        return default
    return f"{factor:g} times the {default}, with which Gmsh finds no valid mesh"


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
    tried = " (nor with cells half, a quarter and twice as large)" if retry else ""
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
    text = _logged_errors(gmsh, start)
    return text or (f"{len(empty)} of its bodies have no cells" if empty else "")


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


def _check_last_line(path: Path) -> None:
    """Refuses a last line of several statements without line break: Gmsh 4.13 drops some."""
    last = path.read_bytes().rpartition(b"\n")[2] if path.suffix.lower() == ".geo" else b""
    if last.count(b";") > 1:
        raise MeshError(
            "the last line has no line break: Gmsh would leave a part of it out",
            where=path.name,
            expected="end the file with an empty line",
        )


def _has_sizes(gmsh: ModuleType) -> bool:
    """True where a .geo file asks for sizes of its own, which may be finer."""
    points = gmsh.model.getEntities(0)
    return len(gmsh.model.mesh.field.list()) > 0 or any(
        size > 0 for size in (gmsh.model.mesh.getSizes(points) if points else ())
    )


def convert_msh(path: Path) -> MeshFile:
    """Reads a .msh file of an old version. Local: one rank reads.

    Raises:
        MeshError: Gmsh cannot read it, or would take it for a script.
    """
    if not path.read_bytes().startswith((b"$NO", b"$MeshFormat", b"$Comments")):
        raise MeshError("this is not a Gmsh mesh (no $MeshFormat at the start)", where=path.name)
    with _gmsh(path) as gmsh:
        return _save_and_read(gmsh)


def _save_and_read(gmsh: ModuleType) -> MeshFile:
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "mesh.msh"
        for name, value in _SAVE_OPTIONS.items():
            gmsh.option.setNumber(name, value)
        gmsh.write(str(target))
        return read_msh(target)


@contextmanager
def _gmsh(path: Path, *, read: bool = True) -> Iterator[ModuleType]:
    """Gmsh without output; its errors are raised as `MeshError`.

    Args:
        path: The file.
        read: Open it; else there is an empty model.
    """
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
    unit_before = gmsh.option.getString(_UNIT_OPTION)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.logger.start()
    before = gmsh.model.list()
    try:
        # OpenCASCADE keeps the unit that it was given last in this process.
        gmsh.option.setString(_UNIT_OPTION, "MM")
        if read:
            gmsh.open(str(path))
        else:
            gmsh.model.add(path.stem)
        yield gmsh
    except Exception as error:
        if type(error) is not Exception:  # Gmsh raises this base class itself
            raise
        raise MeshError(
            f"Gmsh cannot read or mesh it: {_logged_errors(gmsh) or error}", where=path.name
        ) from None
    finally:
        gmsh.logger.stop()
        if own:
            gmsh.finalize()
        else:
            gmsh.option.setString(_UNIT_OPTION, unit_before)
            _restore_gmsh(gmsh, before, options)


def _logged_errors(gmsh: ModuleType, start: int = 0) -> str:
    """The first three error messages of Gmsh, from a line of its log on."""
    lines = [
        line.split(":", 1)[1].strip()
        for line in gmsh.logger.get()[start:]
        if line.startswith("Error:")
    ]
    return "; ".join(dict.fromkeys(lines[:3]))


def _restore_gmsh(gmsh: ModuleType, before: list[str], options: dict[str, float]) -> None:
    """Restores options and models of a Gmsh session that the caller had started."""
    for name, value in options.items():
        gmsh.option.setNumber(name, value)
    for name in gmsh.model.list():
        if name not in before:
            gmsh.model.setCurrent(name)
            gmsh.model.remove()
