"""From a format that one rank reads to XDMF, which all ranks read in shares."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.mesh.distribute import is_cad
from dolfin_elastic.mesh.formats.cad.process import Permission
from dolfin_elastic.mesh.formats.cleaning import clean
from dolfin_elastic.mesh.formats.raw import MeshFile, RawMesh, assemble
from dolfin_elastic.mesh.read import XDMF, check_file, reader, stated_unit_of


@dataclass(frozen=True)
class Conversion:
    """What was written.

    Attributes:
        cells: Number of cells.
        points: Number of points.
        parts: Kind of part to the names, of those that there are.
        fields: Names of the fields.
        notes: Faults of the old file that are corrected in the new one, and what is doubtful.
        unit: Unit of length that the old file stated; empty: none.
    """

    cells: int
    points: int
    parts: dict[str, list[str]]
    fields: list[str]
    notes: tuple[str, ...]
    unit: str


def convert_mesh(
    path: str | os.PathLike[str],
    target: str | os.PathLike[str],
    *,
    comm: MPI.Comm = MPI.COMM_WORLD,
    force: bool = False,
) -> Conversion:
    """Writes a mesh as XDMF that all ranks read in shares, with names, fields and unit.

    Rank 0 reads and writes, the others wait.  Collective.  What is corrected when a mesh is read
    is corrected in the new file; numbers stay in the unit of the old one.

    Args:
        path: A finished mesh of any format of `read_body`.
        target: The .xdmf file; its arrays go into a .h5 file beside it.
        comm: The ranks.

    Raises:
        MeshError: It is no finished mesh, cannot be read, or is not fit for use; or the target
            exists, or is no .xdmf file.
        OutputError: The new files cannot be written.
    """
    return on_root(comm, lambda: _converted(Path(path), Path(target), force=force))


def _converted(path: Path, target: Path, *, force: bool) -> Conversion:
    from dolfin_elastic.mesh.formats.xdmf_named import write_named

    check_file(path)
    _check_target(path, target, force=force)
    read, permutation = reader(path, _no_cad, Permission())
    try:
        found = clean(assemble(read(), source=path.name))
    except MeshError as error:
        raise error if error.where else error.at(path.name) from None
    # What is still doubtful in the corrected mesh is said whenever that is read.
    lasting = clean(replace(found, notes=(), information=()))
    unit = stated_unit_of(path)
    write_named(lasting, target, unit, permutation)
    return _conversion(found, unit.name if unit else "")


def _conversion(raw: RawMesh, unit: str) -> Conversion:
    kinds = {"region": raw.regions, "surface": raw.surfaces, "edge": raw.edges, "point": raw.nodes}
    return Conversion(
        len(raw.cells),
        len(raw.points),
        {kind: list(parts) for kind, parts in kinds.items() if parts},
        [*raw.cell_data, *raw.point_data],
        (*raw.notes, *raw.information),
        unit,
    )


def _no_cad() -> MeshFile:
    raise AssertionError("no CAD file gets here")


def _check_target(path: Path, target: Path, *, force: bool) -> None:
    """Refuses what is no finished mesh, or need not be converted, and files that exist.

    Args:
        target: The new file.
        force: It may exist.
    """
    if is_cad(path):
        raise MeshError(
            "a CAD file has no mesh yet",
            where=str(path),
            expected=f"mesh it first, for example: gmsh -3 {path.name} -o {path.stem}.msh",
        )
    if target.suffix.lower() not in XDMF:
        raise MeshError(
            f"'{target}' is no .xdmf file",
            where="TARGET",
            expected=f"for example '{target.with_suffix('.xdmf').name}': the format that all ranks "
            "read in shares",
        )
    if not target.parent.is_dir():
        raise MeshError(
            f"there is no folder '{target.parent}'", where="TARGET", expected="make it first"
        )
    files = (target, target.with_suffix(".h5"))
    if path.resolve() in [one.resolve() for one in files]:
        raise MeshError("this is the mesh itself", where=str(target), expected="another name")
    if path.suffix.lower() in XDMF:
        from dolfin_elastic.mesh.formats.xdmf import is_shared

        if is_shared(path, None):
            raise MeshError(
                "all ranks read this file in shares as it is", where=str(path), expected="use it"
            )
    there = [str(one) for one in files if one.exists()]
    if there and not force:
        raise MeshError(
            "this file exists already",
            where=there[0],
            expected="choose another name, or --force to overwrite it",
        )
