"""Commands that make and read files: `convert`, `schema`, `new`."""
# ruff: noqa: D301

from __future__ import annotations

import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from dolfin_elastic.core.errors import CaseError, check_kept
from dolfin_elastic.core.files.regular import fresh
from dolfin_elastic.core.signals import launched_rank
from dolfin_elastic.core.startup.libraries import start

TEMPLATES = Path(__file__).parent / "templates"


class Kind(StrEnum):
    """What a first case is about: the names of the files in `TEMPLATES`."""

    STATICS = "statics"
    STEEL = "steel"
    MODAL = "modal"
    DYNAMICS = "dynamics"
    RUBBER = "rubber"
    CONTACT = "contact"
    CELL = "cell"
    AXISYMMETRIC = "axisymmetric"


def new(
    file: Annotated[Path, typer.Argument(metavar="[FILE]", hidden=True)] = Path("case.toml"),
    kind: Annotated[Kind, typer.Option("--kind", "-k", help="Kind of case.")] = Kind.STATICS,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
) -> None:
    """Write a first case file that runs as it is.

    \b
      dolfin-elastic new                             a cantilever, in case.toml
      dolfin-elastic new mount.toml --kind rubber
      dolfin-elastic new reed.toml --kind modal      natural frequencies

    \f
    Raises:
        CaseError: It exists, or cannot be written.
    """
    if launched_rank() == 0:
        check_kept(file.parent, str(file))
        if file.exists() and not force:
            raise CaseError(
                "this file exists already",
                where=str(file),
                expected="choose another name, or --force to overwrite it",
            )
        draft = file.with_name(f".{file.name}.part")
        try:
            fresh(draft).write_text(template(kind, str(file)), encoding="utf-8")
            draft.replace(file)
        except OSError as error:
            raise CaseError(
                f"cannot be written: {error.strerror}",
                where=str(file),
                expected="a folder you may write to",
            ) from None
    print(f"{file} written; compute it with: dolfin-elastic run {file}")


def template(kind: Kind, name: str) -> str:
    """The text of a first case file.

    Args:
        name: What the file will be called.
    """
    text = (TEMPLATES / f"{kind}.toml").read_text(encoding="utf-8")
    return text.replace("{name}", name)


def schema() -> None:
    """Print the JSON schema of case files, by which editors complete and check.

    \b
      dolfin-elastic schema > dolfin-elastic.schema.json

    Then write `#:schema ./dolfin-elastic.schema.json` as the first line of a case, and open it in
    an editor with taplo or "Even Better TOML".
    """
    from dolfin_elastic.case.reference.json_schema import case_schema

    print(json.dumps(case_schema(), indent=1, ensure_ascii=False))


def convert(
    mesh: Annotated[Path, typer.Argument(metavar="MESH", hidden=True)],
    target: Annotated[Path, typer.Argument(metavar="TARGET", hidden=True)],
    *,
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing files.")] = False,
) -> None:
    """Write a mesh as XDMF, which all ranks read in parallel.

    \b
      dolfin-elastic convert wing.msh wing.xdmf     writes wing.xdmf and wing.h5

    For large meshes: every other format is read by one rank, with the memory of one. Names of
    regions, surfaces, edges and points, fields and the unit of length stay.

    \f
    Raises:
        CaseError: docker/run would not keep the target.
        MeshError: The mesh cannot be read, or the target is no .xdmf file or exists.
        OutputError: The files cannot be written.
    """
    start()
    from mpi4py import MPI

    from dolfin_elastic.cli.run import collect_garbage
    from dolfin_elastic.mesh.formats.convert import convert_mesh

    collect_garbage()
    check_kept(target.parent, str(target))
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
