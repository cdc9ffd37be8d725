"""The command `look`: what a mesh, a CAD file or the body of a case holds."""
# ruff: noqa: D301

from __future__ import annotations

import logging
from pathlib import Path
from typing import Annotated

import typer

from dolfin_elastic.cli.run import Trust, collect_garbage, log_to_screen
from dolfin_elastic.core.errors import CaseError
from dolfin_elastic.core.signals import interrupt_on_request
from dolfin_elastic.core.startup.libraries import start


def look(
    what: Annotated[Path, typer.Argument(metavar="FILE|CASE", hidden=True)],
    *,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="PNG", help="Draw the body into this file."),
    ] = None,
    series: Annotated[
        str, typer.Option("--series", metavar="NAME", help="Of several in a folder of DICOM files.")
    ] = "",
    json: Annotated[bool, typer.Option("--json", help="Print JSON, for scripts.")] = False,
    trust: Trust = False,
) -> None:
    """See a body and its names: faces, surfaces, regions, and a picture.

    \b
      dolfin-elastic look bracket.step --output look.png
      dolfin-elastic look bracket.toml -o look.png     with supports, loads and contacts
      dolfin-elastic look mesh.msh --json | jq .surfaces
      dolfin-elastic look labels.nii.gz                values of an image, with their volumes
      dolfin-elastic look scan/ --series 3             of a folder of DICOM files

    Faces of CAD files have numbers; [surfaces] of a case names them: holes = {faces = [7, 8]}.

    \f
    Raises:
        CaseError: The picture cannot have that name.
    """
    start()
    from mpi4py import MPI

    from dolfin_elastic.case.look.image import ImageLook, look_at_image
    from dolfin_elastic.case.look.listing import Look
    from dolfin_elastic.case.look.look import look_at
    from dolfin_elastic.core.parallel import on_root
    from dolfin_elastic.mesh.images.read import is_image, is_slice

    comm = MPI.COMM_WORLD
    collect_garbage()
    interrupt_on_request()
    log_to_screen(comm.rank, logging.ERROR)
    if output is not None and output.suffix.lower() != ".png":
        raise CaseError(f"the picture '{output}' is no .png", where="--output", expected="look.png")
    annotated: Look | ImageLook
    if is_image(what) or is_slice(what) or what.is_dir():
        if output is not None:
            raise CaseError(
                "an image of voxels is not drawn",
                where="--output",
                expected="leave it out, or look at a case with this image in [mesh]",
            )
        annotated = on_root(comm, lambda: look_at_image(what, series=series))
    elif series:
        raise CaseError(
            "a file has one series", where="--series", expected="leave it out, or name a folder"
        )
    else:
        annotated = look_at(what, picture=output, trust=trust, comm=comm)
    if comm.rank == 0 and json:
        from dataclasses import asdict
        from json import dumps

        print(dumps(asdict(annotated), indent=2))
    elif comm.rank == 0:
        from dolfin_elastic.cli.look.show import show_image, show_look

        if isinstance(annotated, Look):
            show_look(annotated)
        else:
            show_image(annotated)
