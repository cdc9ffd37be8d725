"""The command `convert`."""
# ruff: noqa: D301

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from dolfin_elastic.core.startup.libraries import start


def convert(
    mesh: Annotated[Path, typer.Argument(metavar="MESH", hidden=True)],
    target: Annotated[Path, typer.Argument(metavar="TARGET", hidden=True)],
    *,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the files.")] = False,
) -> None:
    """Write a mesh as XDMF, which all ranks read in shares.

    \b
      dolfin-elastic convert wing.msh wing.xdmf     writes wing.xdmf and wing.h5

    For large meshes: every other format is read by one rank, with the memory of one. Names of
    regions, surfaces, edges and points, fields and the unit of length are kept.

    \f
    Args:
        target: The .xdmf file.
        force: Overwrite it, and the .h5 file beside it.

    Raises:
        CaseError: docker/run would not keep the target.
        MeshError: The mesh cannot be read, or the target is no .xdmf file or exists.
        OutputError: The files cannot be written.
    """
    start()
    from mpi4py import MPI

    from dolfin_elastic.cli.run import collect_garbage
    from dolfin_elastic.core.errors import check_kept
    from dolfin_elastic.mesh.formats.convert import convert_mesh

    collect_garbage()
    check_kept(target.parent, str(target))
    found = convert_mesh(mesh, target, comm=MPI.COMM_WORLD, force=force)
    if MPI.COMM_WORLD.rank == 0:
        for note in found.notes:
            print(f"warning: {mesh.name}: {note}", file=sys.stderr)
        unit = f", in {found.unit}" if found.unit else ""
        size = f"{found.cells} cells, {found.points} points{unit}"
        print(f"{target} and {target.with_suffix('.h5').name} written: {size}")
        for kind, names in [*found.parts.items(), ("field", found.fields)]:
            if names:
                print(f"  {kind}s: {', '.join(names)}")
