"""The command `import`: a deck of another program as a case file beside it."""
# ruff: noqa: D301

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dolfin_elastic.cli.run import Quiet, begin, compute_case
from dolfin_elastic.core.errors import CaseError, InputError, check_kept, joined
from dolfin_elastic.core.files.regular import fresh
from dolfin_elastic.core.signals import launched_rank
from dolfin_elastic.core.startup.libraries import start

if TYPE_CHECKING:
    from dolfin_elastic.case.decks.deck import Deck


def import_deck(
    deck: Annotated[Path, typer.Argument(metavar="DECK", hidden=True)],
    *,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="CASE", help="Name of the case file.")
    ] = None,
    units: Annotated[
        str, typer.Option("--units", metavar="UNITS", help="Units of the deck's numbers.")
    ] = "",
    run: Annotated[bool, typer.Option("--run", help="Compute it as well.")] = False,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Write it without what changes the answer.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing case files.")] = False,
    quiet: Quiet = False,
) -> None:
    """Make a case file of a deck of Abaqus, CalculiX, Nastran or FEBio.

    \b
      dolfin-elastic import bracket.inp --units mm-t-s        writes bracket.toml beside it
      dolfin-elastic import bracket.inp --units mm-t-s --run  and computes it

    UNITS is mm-t-s (mm, N, MPa, t/mm^3), m-kg-s (SI), mm-kg-ms (mm, kN, GPa) or in-lbf-s (psi).
    The mesh of the case is the deck itself.  Each table has the line of the deck that it is from;
    what is not carried over is listed in the file and here.  A deck of several analyses that do not
    go on from one another gives a case file for each.

    \f
    Raises:
        CaseError: A file exists or cannot be written, or something is not carried over that changes
            the answer.
        MeshError: The deck is damaged, or no deck.
    """
    target = output or deck.with_suffix(".toml")
    written = list[Path]()
    if launched_rank() == 0:
        written = _import(deck, target, units, anyway=anyway, force=force, quiet=quiet)
    if run:
        _run(written, quiet)


def _import(
    path: Path, target: Path, units: str, *, anyway: bool, force: bool, quiet: bool
) -> list[Path]:
    """Writes the case files and says what they lack; returns their paths. Not collective."""
    from dolfin_elastic.case.decks.reading import read_deck
    from dolfin_elastic.case.decks.writer import case_texts

    deck = read_deck(path)
    texts = case_texts(deck, target.stem, units)
    if deck.faults and not anyway:
        raise _faults(deck)
    check_kept(target.parent, str(target))
    if target.parent.resolve() != path.parent.resolve():
        raise CaseError(
            "the case file must be beside the deck, which is its mesh",
            where=str(target),
            expected=f"-o {path.with_name(target.name)}",
        )
    files = {target.with_name(f"{name}.toml"): text for name, text in texts.items()}
    _write(files, force=force)
    if not quiet:
        _say(deck, list(files))
    return list(files)


def _faults(deck: Deck) -> InputError:
    """What would make the answer another one, all of it in one error."""
    every = [
        CaseError(f"not carried over: {one.text}", where=str(one.place)) for one in deck.faults
    ]
    last = every[-1]
    every[-1] = CaseError(
        last.what,
        where=last.where,
        expected="the answer would be another one; --anyway writes the rest",
    )
    return joined(every)


def _write(files: dict[Path, str], *, force: bool) -> None:
    """All of the files or none.

    Raises:
        CaseError: One exists, or cannot be written.
    """
    for file in files:
        if file.exists() and not force:
            raise CaseError(
                "this file exists already",
                where=str(file),
                expected="choose another name with -o, or --force to overwrite it",
            )
    drafts = {file: file.with_name(f".{file.name}.part") for file in files}
    try:
        for file, text in files.items():
            fresh(drafts[file]).write_text(text, encoding="utf-8")
        for file, draft in drafts.items():
            draft.replace(file)
    except OSError as error:
        raise CaseError(
            f"cannot be written: {error.strerror}",
            where=str(error.filename or next(iter(files))),
            expected="a folder you may write to",
        ) from None


def _say(deck: Deck, files: list[Path]) -> None:
    for one in deck.left_out:
        label = "warning: not carried over" if one.severity != "note" else "note"
        print(f"{label}: {one.place}: {one.text}", file=sys.stderr)
    for file in files:
        print(f"{file} written; compute it with: dolfin-elastic run {file}")


def _run(written: list[Path], quiet: bool) -> None:
    """Computes the case files one after the other. Collective."""
    start()
    comm = begin(quiet)
    for file in comm.bcast(written):
        compute_case(file, comm, quiet=quiet)
