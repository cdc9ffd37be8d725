"""The command `import`: a deck of another program as a case file beside it."""
# ruff: noqa: D301

from __future__ import annotations

import sys
from dataclasses import dataclass
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
    from dolfin_elastic.case.decks.references import Reference


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
    compare: Annotated[
        Path | None,
        typer.Option("--compare", metavar="FILE", help="Compute it, and compare with results."),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Make a case file of a deck of Abaqus, CalculiX, Nastran or FEBio.

    \b
      dolfin-elastic import bracket.inp --units mm-t-s        writes bracket.toml beside it
      dolfin-elastic import bracket.inp --units mm-t-s --run  and computes it
      dolfin-elastic import bracket.inp --units mm-t-s --compare bracket.frd

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
    if deck.is_dir():
        raise CaseError("this is a folder", where=str(deck), expected="the deck inside it")
    target = output or deck.with_suffix(".toml")
    if not (run or compare):
        if launched_rank() == 0:
            _import(deck, target, units, anyway=anyway, force=force, quiet=quiet)
        return
    start()
    comm = begin(quiet)

    def written() -> _Imported:
        reference = read_reference(compare) if compare else None
        return _import(deck, target, units, reference, anyway=anyway, force=force, quiet=quiet)

    from dolfin_elastic.case.decks.references import read_reference
    from dolfin_elastic.core.parallel import on_root

    imported = on_root(comm, written)
    for file in imported.files:
        compute_case(file, comm, quiet=quiet)
    if imported.reference is not None and comm.rank == 0:
        _show_comparison(imported, imported.reference, units)


@dataclass
class _Imported:
    """What was written.

    Attributes:
        deck: The deck.
        path: Where it is.
        files: The case files.
        reference: Results of another program.
    """

    deck: Deck
    path: Path
    files: list[Path]
    reference: Reference | None


def _import(
    path: Path,
    target: Path,
    units: str,
    reference: Reference | None = None,
    *,
    anyway: bool,
    force: bool,
    quiet: bool,
) -> _Imported:
    """Writes the case files and says what they lack. Not collective."""
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
    return _Imported(deck, path, list(files), reference)


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
    finally:
        for draft in drafts.values():
            draft.unlink(missing_ok=True)


def _say(deck: Deck, files: list[Path]) -> None:
    for one in deck.left_out:
        label = "warning: not carried over" if one.severity != "note" else "note"
        print(f"{label}: {one.place}: {one.text}", file=sys.stderr)
    for file in files:
        print(f"{file} written; compute it with: dolfin-elastic run {file}")


def _show_comparison(imported: _Imported, reference: Reference, units: str) -> None:
    """Prints the runs beside the results of another program. Not collective."""
    from dolfin_elastic.case.case import read_case
    from dolfin_elastic.case.decks.compare import compare, reasons
    from dolfin_elastic.case.decks.reading import nodes_of
    from dolfin_elastic.case.decks.units import SYSTEMS

    folders = [
        case.results_folder() for file in imported.files for case in read_case(file).analyses()
    ]
    known = SYSTEMS[units or imported.deck.units]
    rows = compare(folders, reference, imported.deck, nodes_of(imported.path), known)
    width = max(len(row.what) for row in rows)
    print(f"\n {'':<{width}}  {'here':>12}  {'there':>12}  difference")
    for row in rows:
        numbers = f"{row.ours:>12.6g}  {row.theirs:>12.6g}  {row.difference:>10.1e}"
        print(f" {row.what:<{width}}  {numbers}  {row.remark}".rstrip())
    print("in units of the deck; differences are the largest ones, over the largest number there")
    for reason in reasons(imported.deck, rows):
        print(f"may differ by: {reason}")
