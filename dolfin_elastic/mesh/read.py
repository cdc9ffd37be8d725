"""`read_body`: a mesh file of any kind, by its suffix."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from dolfinx import cpp
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError, nearest_file, not_shown, why_no_file
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.units import METRE, LengthUnit, to_si
from dolfin_elastic.mesh.body import Body, CadSource
from dolfin_elastic.mesh.distribute import CAD, Permutation, build_body, is_cad
from dolfin_elastic.mesh.formats.cad.process import Permission
from dolfin_elastic.mesh.formats.cleaning import straight
from dolfin_elastic.mesh.formats.midsides import in_order
from dolfin_elastic.mesh.formats.raw import MeshFile, RawMesh, assemble
from dolfin_elastic.mesh.formats.surfaces.options import SURFACES, SurfaceOptions, is_surface
from dolfin_elastic.mesh.geometry.checks import check_cells
from dolfin_elastic.mesh.images.read import is_image
from dolfin_elastic.mesh.local_size import NO_SIZES, CadSizes

SHAPES = (".step", ".stp", ".brep", ".iges", ".igs")
_IN_PARTS = (".pvtu", ".pvd", ".vtm", ".vtmb")
_POINTER = b"version https://git-lfs"
XDMF = (".xdmf", ".xmf")


def read_body(
    path: str | os.PathLike[str],
    *,
    comm: MPI.Comm = MPI.COMM_WORLD,
    scale: float | None = None,
    size: float | str | None = None,
    curved: bool | None = None,
    dim: int | None = None,
    join: bool | None = None,
    trust: bool = False,
    time_limit: float = 600.0,
    local: CadSizes = NO_SIZES,
    time: float | None = None,
    deviation: float | str | None = None,
    repair: bool | None = None,
    angle: float | None = None,
) -> Body:
    """Reads a mesh, or meshes a CAD file or what a surface encloses, with names of parts.

    Collective.  Gmsh physical groups, Abaqus sets, MED groups and integer references of other
    formats become named regions (cells) and surfaces (facets); other data of cells and points
    become fields.

    Args:
        path: .msh; .xdmf; .inp, .bdf, .feb, .unv, .exo, .vtu, .vtk, .med, .mesh and whatever else
            meshio reads; .geo, .step, .brep or .iges, which Gmsh meshes on the fly; .stl, .obj,
            .ply or .3mf, a closed surface that is filled.
        scale: Metres per unit of length of the file; None: the unit that the file states (STEP,
            IGES, .unv and .3mf), else 1; required for .stl, .obj and .ply.
        size: Size of the elements in the file's unit, or a text with a unit; only for CAD files
            and surfaces.
        curved: Quadratic cells that follow curved surfaces; None: where there are any, and the
            cells do not fold.  Finished meshes are as they are, but False reads their quadratic
            cells as straight ones.
        dim: 2 or 3 to choose the elements; by default the highest dimension in the file.
        join: Bodies of a STEP, IGES or BREP file that touch share the nodes there; True by default.
        trust: A .geo file may do all that its user may: run commands, write files and read others.
        time_limit: Time that Gmsh may take [s].
        local: Local element sizes, for CAD files; see `refine.local` for finished meshes.
        time: Of fields at several time steps, in .xdmf and .msh files, which one; None: the last.
        deviation: Distance between elements and a surface of triangles that does no harm, as
            `size`; sizes by curvature are not smaller than it needs.
        repair: Mends a surface of triangles, and notes what that has changed.
        angle: Between triangles of a surface, from which on their edge divides patches [degrees];
            None: 40.

    Raises:
        MeshError: The file cannot be read, or the mesh is not fit for use.
    """
    path = Path(path)
    on_root(comm, lambda: check_file(path, size, curved, join))
    suffix = path.suffix.lower()
    stated = on_root(comm, lambda: stated_unit_of(path))
    unit = stated or METRE if scale is None else LengthUnit.of(scale)
    options = SurfaceOptions(_in_unit(deviation, unit), repair, angle)
    on_root(comm, lambda: options.check(path, dim, known_unit=bool(scale or stated)))
    if suffix in XDMF:
        from dolfin_elastic.mesh.formats.xdmf import read_xdmf

        body = read_xdmf(
            path, comm=comm, unit=unit, dim=dim, straight_cells=curved is False, time=time
        )
        return check_cells(with_stated_unit(body, stated))
    if time is not None and suffix != ".msh":
        raise MeshError(
            f"a {suffix} file has one time step", where=path.name, expected="leave time out"
        )
    if (edge := _in_unit(size, unit)) is not None and not edge > 0:
        raise MeshError(
            f"the size of the elements must be positive, not {size}",
            where="mesh.size",
            expected='for example "2 mm"',
        )
    permission = Permission(trust, time_limit)
    if is_surface(path):
        from dolfin_elastic.mesh.formats.surfaces.body import mesh_surface

        mesh = partial(mesh_surface, path, options=options)
    else:
        from dolfin_elastic.mesh.formats.cad.read import mesh_cad

        mesh = partial(mesh_cad, path, dim=dim, join=join is not False, stated=stated, local=local)
    meshed = partial(mesh, size=edge, curved=curved, unit=unit, permission=permission)
    read, permutation = reader(path, meshed, permission, time)

    def raw() -> RawMesh:
        result = assemble(read(), source=path.name, dim=dim)
        return straight(result) if curved is False and suffix not in (*CAD, *SURFACES) else result

    body = build_body(raw, comm=comm, unit=unit, source=path.name, permutation=permutation)
    if suffix in CAD:
        from dolfin_elastic.mesh.formats.cad.read import model_unit

        scale = model_unit(stated, path) * unit.metres
        body = replace(body, cad=CadSource(path.absolute(), scale, permission))
    return check_cells(with_stated_unit(body, stated))


def _in_unit(length: float | str | None, unit: LengthUnit) -> float | None:
    """A length in the unit of a file."""
    return to_si(length, "m") / unit.metres if isinstance(length, str) else length


def stated_unit_of(path: Path) -> LengthUnit | None:
    """The unit that a CAD file, a .unv or .3mf file or a converted mesh states. Local."""
    suffix = path.suffix.lower()
    if suffix in XDMF:
        from dolfin_elastic.mesh.formats.xdmf_arrays import unit_of_xdmf

        return unit_of_xdmf(path)
    if suffix == ".unv":
        from dolfin_elastic.mesh.formats.unv import unit_of_unv

        return unit_of_unv(path)
    if suffix == ".3mf":
        from dolfin_elastic.mesh.formats.surfaces.readers.threemf import unit_of_3mf

        return unit_of_3mf(path)
    if suffix not in CAD:
        return None
    from dolfin_elastic.mesh.formats.cad.units import stated_unit

    return stated_unit(path)


def with_stated_unit(body: Body, stated: LengthUnit | None) -> Body:
    """The body with a note on its unit of length.

    Args:
        stated: The unit that its file states.
    """
    if stated is None:
        return body
    if stated.metres == body.unit.metres:
        text = f"lengths in {stated.name}, as the file says"
        return replace(body, unit=stated, information=(*body.information, text))
    note = (
        f"the file says that its lengths are in {stated.name}, mesh.unit that they are in "
        f"{body.unit.name}, which counts: is that meant?"
    )
    return replace(body, notes=(note, *body.notes))


def check_file(
    path: Path,
    size: float | str | None = None,
    curved: bool | None = None,
    join: bool | None = None,
) -> None:
    """Refuses a file that cannot be a mesh, or for which an option makes no sense. Local.

    Raises:
        MeshError: With what would be right.
    """
    _check_kind(path)
    cad = is_cad(path)
    meshed = cad or is_surface(path)
    if size is not None and not meshed:
        raise MeshError(
            "mesh.size is given, but this file is a finished mesh",
            where=path.name,
            expected=f"size is for {', '.join((*CAD, *SURFACES))}",
        )
    if curved and not meshed:
        raise MeshError(
            "mesh.curved is given, but this file is a finished mesh",
            where=path.name,
            expected=f"curved is for {', '.join((*CAD, *SURFACES))}; a mesh of quadratic elements "
            "is curved already",
        )
    if join is not None and path.suffix.lower() not in SHAPES:
        raise MeshError(
            "a .geo file joins its bodies itself"
            if cad
            else "bodies are to be joined or not, but this file is "
            + ("a surface" if meshed else "a finished mesh"),
            where=path.name,
            expected=f"join is for {', '.join(SHAPES)}"
            + ("; in a .geo file write Coherence; or BooleanFragments" if cad else ""),
        )


def _check_kind(path: Path) -> None:
    """Refuses what is not there, or cannot be a mesh."""
    if os.path.isdir(path):  # of a name that is too long Path raises
        raise MeshError(f"'{path}' is a folder, not a mesh file", expected="the file inside it")
    if fault := why_no_file(path, sys.maxsize):
        raise MeshError(fault, where=path.name)
    if not path.exists():
        if hint := not_shown(path):
            raise MeshError(f"there is no mesh file '{path}'", expected=hint)
        folder = path.parent if path.parent.is_dir() else Path()
        known = [p.name for p in folder.iterdir() if p.suffix.lower() == path.suffix.lower()]
        raise MeshError(
            f"there is no mesh file '{path}'",
            expected=nearest_file(path.name, known)
            if known
            else f"nor any other {path.suffix} file in '{folder}'",
        )
    with path.open("rb") as file:
        if file.read(len(_POINTER)) == _POINTER:
            raise MeshError(
                "this is a pointer of Git LFS, not the mesh",
                where=path.name,
                expected="git lfs pull",
            )
    if path.suffix.lower() in _IN_PARTS:
        from dolfin_elastic.mesh.formats.vtu import ONE_PIECE

        raise MeshError(
            f"a {path.suffix} file only names the files of its pieces",
            where=path.name,
            expected=ONE_PIECE,
        )
    if path.stat().st_size == 0:
        raise MeshError("the file is empty", where=path.name, expected="save the mesh anew")
    if is_image(path):
        raise MeshError(
            "this is an image of voxels, not a mesh",
            where=path.name,
            expected=f'[mesh] image = "{path.name}", with labels = {{NAME = 1}} or a threshold',
        )


def reader(
    path: Path, meshed: Callable[[], MeshFile], permission: Permission, time: float | None = None
) -> tuple[Callable[[], MeshFile], Permutation]:
    """How one rank reads a file, and the node order of its quadratic cells.

    Args:
        meshed: Meshes it, if it is a CAD file or a surface.
        time: See `read_body`.
    """
    suffix = path.suffix.lower()
    if suffix == ".msh":
        return lambda: _msh(path, permission, time), cpp.io.perm_gmsh
    if suffix in CAD:
        return meshed, cpp.io.perm_gmsh
    if suffix in SURFACES:
        return meshed, cpp.io.perm_vtk
    return lambda: in_order(_other_reader(path)(path)), cpp.io.perm_vtk


def _msh(path: Path, permission: Permission, time: float | None) -> MeshFile:
    from dolfin_elastic.mesh.formats.msh import OtherVersionError, read_msh

    try:
        return read_msh(path, time)
    except OtherVersionError:
        from dolfin_elastic.mesh.formats.cad.read import convert_msh

        return convert_msh(path, permission)


def _other_reader(path: Path) -> Callable[[Path], MeshFile]:
    """The reader of a format whose quadratic cells have their nodes in VTK's order."""
    suffix = path.suffix.lower()
    if suffix == ".dat" and _is_tecplot(path):
        suffix = ".tec"
    if suffix == ".inp" and not _is_ucd(path):
        from dolfin_elastic.mesh.formats.abaqus import read_abaqus

        return read_abaqus
    if suffix == ".vtu":
        from dolfin_elastic.mesh.formats.vtu import read_vtu

        return read_vtu
    if suffix == ".unv":
        from dolfin_elastic.mesh.formats.unv import read_unv

        return read_unv
    if suffix in (".bdf", ".nas", ".fem", ".dat"):
        from dolfin_elastic.mesh.formats.nastran import read_nastran

        return read_nastran
    return _rarer_reader(path, suffix)


def _rarer_reader(path: Path, suffix: str) -> Callable[[Path], MeshFile]:
    if suffix in (".e", ".exo", ".ex2", ".g", ".gen"):
        from dolfin_elastic.mesh.formats.exodus import read_exodus

        return read_exodus
    if suffix == ".feb":
        from dolfin_elastic.mesh.formats.febio import read_febio

        return read_febio
    if suffix in (".node", ".ele"):
        from dolfin_elastic.mesh.formats.text.tetgen import read_tetgen

        return read_tetgen
    if suffix == ".mesh":
        from dolfin_elastic.mesh.formats.text.mfem import is_mfem, read_mfem

        if is_mfem(path):
            return read_mfem
    from dolfin_elastic.mesh.formats.meshio import read_meshio

    return partial(read_meshio, kind="avsucd") if suffix == ".inp" else read_meshio


def _is_tecplot(path: Path) -> bool:
    """Whether a .dat file is one of Tecplot: it begins with a title, variables or a zone."""
    first = _first_line(path, "#$")
    return first.upper().startswith(("TITLE", "VARIABLES", "ZONE", "FILETYPE")) and "=" in first


def _is_ucd(path: Path) -> bool:
    """Whether an .inp file is one of AVS: its first line has the five numbers of UCD."""
    words = _first_line(path, "#").split()
    return len(words) == 5 and all(word.isdecimal() for word in words)


def _first_line(path: Path, comments: str) -> str:
    """The first line that is neither blank nor a comment."""
    with path.open(encoding="latin-1") as file:
        lines = (line.strip() for line in file)
        return next((line for line in lines if line and line[0] not in comments), "")
