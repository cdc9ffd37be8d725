"""`convert`: a mesh as XDMF, or results for other programs."""
# ruff: noqa: D301

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from dolfin_elastic.core.errors import InputError, check_kept
from dolfin_elastic.core.startup.libraries import start


def convert(
    source: Annotated[Path, typer.Argument(metavar="MESH|DIR", hidden=True)],
    target: Annotated[Path, typer.Argument(metavar="TARGET", hidden=True)],
    *,
    field: Annotated[
        str | None, typer.Option("--field", "-f", help="Field that colours the surface.")
    ] = None,
    frames: Annotated[
        int | None, typer.Option("--frames", min=1, help="Number of states (default: all).")
    ] = None,
    scale: Annotated[float, typer.Option("--scale", help="Magnification of displacements.")] = 1.0,
    fps: Annotated[
        float | None, typer.Option("--fps", help="States a second (default: motion as it was).")
    ] = None,
    ends: Annotated[str | None, typer.Option("--range", help="Range of the colours: 0:2e8.")] = (
        None
    ),
    skin: Annotated[
        Path | None, typer.Option("--skin", help="Surface that follows the body: .obj, .ply, .stl.")
    ] = None,
    mode: Annotated[
        int | None, typer.Option("--mode", min=0, help="One period of this mode; 0: all modes.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing files.")] = False,
) -> None:
    """Write results for other programs, or a mesh as XDMF.

    \b
      dolfin-elastic convert fall_results fall.glb    Blender, browsers: moves, with colours
      dolfin-elastic convert fall_results fall.usdc   USD (needs usd-core)
      dolfin-elastic convert fall_results fall.ply    fall_0000.ply ..., also .obj
      dolfin-elastic convert fall_results fall.frd    CalculiX GraphiX, FreeCAD
      dolfin-elastic convert fall_results fall.csv    nodes with their fields
      dolfin-elastic convert fall_results fall.vtkhdf ParaView, in one file
      dolfin-elastic convert fork_results a.glb --mode 3
      dolfin-elastic convert fall_results skin.glb --skin character.obj
      dolfin-elastic convert wing.msh wing.xdmf       writes wing.xdmf and wing.h5

    A mesh as XDMF is for large ones: every other format is read by one rank, with the memory of
    one. Names of regions, surfaces, edges and points, fields and the unit of length stay.

    \f
    Raises:
        CaseError: docker/run would not keep the target.
        InputError: What is to be written is not there.
        MeshError: The mesh cannot be read, or the target is no .xdmf file or exists.
        OutputError: The files cannot be written.
    """
    start()
    from dolfin_elastic.results.exports.export import SUFFIXES

    check_kept(target.parent, str(target))
    if source.is_dir() or target.suffix in SUFFIXES or not (source.exists() or source.suffix):
        _convert_results(source, target, field, frames, scale, fps, ends, skin, mode, force=force)
        return
    given: dict[str, object] = {"field": field, "frames": frames, "fps": fps, "range": ends}
    given |= {"skin": skin, "mode": mode}
    given["scale"] = None if scale == 1.0 else scale
    if unused := [name for name, value in given.items() if value is not None]:
        raise InputError(
            f"{source} is no folder of results, of which --{unused[0]} is",
            where=f"--{unused[0]}",
            expected="leave it out, or name the folder of the results of a run",
        )
    _convert_mesh(source, target, force=force)


def _convert_results(
    folder: Path,
    target: Path,
    field: str | None,
    frames: int | None,
    scale: float,
    fps: float | None,
    ends: str | None,
    skin: Path | None,
    mode: int | None,
    *,
    force: bool,
) -> None:
    from mpi4py import MPI

    from dolfin_elastic.cli.tools.plot import check_positive, fixed_limits
    from dolfin_elastic.core.parallel import on_root
    from dolfin_elastic.results.exports.export import Exported, export
    from dolfin_elastic.results.exports.settings import ExportSettings
    from dolfin_elastic.results.finished.run import FinishedRun

    check_positive("--scale", scale, "--scale 20", zero=True)
    if fps is not None:
        check_positive("--fps", fps, "--fps 25")
    limits = None if ends is None else fixed_limits(ends)
    settings = ExportSettings(field, frames, scale, fps, limits, skin, mode)

    def work() -> Exported:
        if target.exists() and not force:
            raise InputError(
                "this file exists already",
                where=str(target),
                expected="choose another name, or --force to overwrite it",
            )
        return export(FinishedRun(folder), target, settings)

    done = on_root(MPI.COMM_WORLD, work)
    if MPI.COMM_WORLD.rank == 0:
        for note in done.notes:
            print(f"warning: {note}", file=sys.stderr)
        names = str(done.files[0]) + (f" ... {done.files[-1].name}" if done.files[1:] else "")
        print(f"{names} written: {done.content}")


def _convert_mesh(mesh: Path, target: Path, *, force: bool) -> None:
    from mpi4py import MPI

    from dolfin_elastic.cli.run import collect_garbage
    from dolfin_elastic.mesh.formats.convert import convert_mesh

    collect_garbage()
    conversion = convert_mesh(mesh, target, comm=MPI.COMM_WORLD, force=force)
    if MPI.COMM_WORLD.rank == 0:
        for note in conversion.notes:
            print(f"warning: {mesh.name}: {note}", file=sys.stderr)
        unit = f", in {conversion.unit}" if conversion.unit else ""
        size = f"{conversion.cells} cells, {conversion.points} points{unit}"
        print(f"{target} and {target.with_suffix('.h5').name} written: {size}")
        for kind, names in [*conversion.parts.items(), ("field", conversion.fields)]:
            if names:
                print(f"  {kind}s: {', '.join(names)}")
