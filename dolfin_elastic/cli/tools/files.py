"""Commands that make files: `schema`, `new`."""
# ruff: noqa: D301

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from dolfin_elastic.core.errors import CaseError, check_kept, nearest
from dolfin_elastic.core.files.regular import fresh
from dolfin_elastic.core.signals import launched_rank

TEMPLATES = Path(__file__).parent / "templates"


class Kind(StrEnum):
    """What a first case is about: the names of the files in `TEMPLATES`."""

    STATICS = "statics"
    STEEL = "steel"
    BRACKET = "bracket"
    PRINTED_PART = "printed-part"
    RUBBER = "rubber"
    SPRINGBACK = "springback"
    CREEP = "creep"
    CONTACT = "contact"
    FALLING_BODY = "falling-body"
    DYNAMICS = "dynamics"
    MODAL = "modal"
    AXISYMMETRIC = "axisymmetric"
    CELL = "cell"
    BONE = "bone"
    ARTERY = "artery"
    BRAIN = "brain"

    @property
    def about(self) -> str:
        """One line on the case: the first of its file."""
        return _read(f"{self}.toml").partition("\n")[0].removeprefix("# ")


def new(
    file: Annotated[Path, typer.Argument(metavar="[FILE]", hidden=True)] = Path("case.toml"),
    kind: Annotated[
        str,
        typer.Option(
            "--kind", "-k", help="Kind of case, see --list.", autocompletion=lambda: [*Kind]
        ),
    ] = Kind.STATICS,
    list_: Annotated[bool, typer.Option("--list", help="Print the kinds.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
) -> None:
    """Write a first case file that runs as it is.

    \b
      dolfin-elastic new                             a cantilever, in case.toml
      dolfin-elastic new --list                      all kinds, a line each
      dolfin-elastic new mount.toml --kind rubber
      dolfin-elastic new peg.toml --kind printed-part

    \f
    Raises:
        CaseError: There is no such kind, or a file exists, or cannot be written.
    """
    if list_:
        width = max(map(len, Kind))
        print("\n".join(f"{one:<{width}}  {one.about}" for one in Kind))
        return
    if kind not in [*Kind]:
        raise CaseError(
            f"there is no kind '{kind}'", where="--kind", expected=nearest(kind, [*Kind])
        )
    texts = template(Kind(kind), file)
    if launched_rank() == 0:
        check_kept(file.parent, str(file))
        for path in texts:
            if path.exists() and not force:
                raise CaseError(
                    "this file exists already",
                    where=str(path),
                    expected="choose another name, or --force to overwrite it",
                )
        for path, text in texts.items():
            _write(path, text)
    print(f"{' and '.join(map(str, texts))} written; compute it with: dolfin-elastic run {file}")


def _write(file: Path, text: str) -> None:
    draft = file.with_name(f".{file.name}.part")
    try:
        fresh(draft).write_text(text, encoding="utf-8")
        draft.replace(file)
    except OSError as error:
        raise CaseError(
            f"cannot be written: {error.strerror}",
            where=str(file),
            expected="a folder you may write to",
        ) from None


def template(kind: Kind, file: Path) -> dict[Path, str]:
    """The files of a first case and their texts: the case itself, and what it is meshed from.

    Args:
        file: That of the case; the others lie beside it under its name.
    """
    geometry = file.with_suffix(".geo")
    text = _read(f"{kind}.toml").replace("{name}", str(file))
    text = text.replace("{results}", str(file.with_name(f"{file.stem}_results")))
    if "{geometry}" not in text:
        return {file: text}
    written = json.dumps(geometry.name, ensure_ascii=False)  # as a string of TOML, too
    return {file: text.replace("{geometry}", written), geometry: _read(f"{kind}.geo")}


def _read(name: str) -> str:
    return (TEMPLATES / name).read_text(encoding="utf-8")


def schema() -> None:
    """Print the JSON schema of case files, by which editors complete and check.

    \b
      dolfin-elastic schema > dolfin-elastic.schema.json

    Then write `#:schema ./dolfin-elastic.schema.json` as the first line of a case, and open it in
    an editor with taplo or "Even Better TOML".
    """
    from dolfin_elastic.case.reference.json_schema import case_schema

    print(json.dumps(case_schema(), indent=1, ensure_ascii=False))
