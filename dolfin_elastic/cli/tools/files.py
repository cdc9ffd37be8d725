"""Commands that make files: `schema`, `new`."""
# ruff: noqa: D301

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from dolfin_elastic.core.errors import CaseError, check_kept
from dolfin_elastic.core.files.regular import fresh
from dolfin_elastic.core.signals import launched_rank

TEMPLATES = Path(__file__).parent / "templates"


class Kind(StrEnum):
    """What a first case is about: the names of the files in `TEMPLATES`."""

    STATICS = "statics"
    STEEL = "steel"
    MODAL = "modal"
    DYNAMICS = "dynamics"
    RUBBER = "rubber"
    SPRINGBACK = "springback"
    CREEP = "creep"
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
      dolfin-elastic new arm.toml --kind creep       a polymer that creeps

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
