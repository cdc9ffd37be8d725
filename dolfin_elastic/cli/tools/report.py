"""The command `report`."""
# ruff: noqa: D301

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from dolfin_elastic.core.startup.libraries import start


def report(
    folders: Annotated[list[Path], typer.Argument(metavar="DIR...", hidden=True)],
    *,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="The page (DIR/report.html)."),
    ] = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Also print a PDF; needs Chromium.")] = False,
    excitation: Annotated[
        tuple[str, str] | None,
        typer.Option(
            "--excitation",
            metavar="FROM TO",
            help="Frequencies that shake the part: no mode may lie among them.",
        ),
    ] = None,
) -> None:
    """Make a page of finished runs that can be mailed.

    \b
      dolfin-elastic report bracket_results
      dolfin-elastic report bracket_results --output bracket.html --pdf
      dolfin-elastic report stress_results modes_results    both on one page
      dolfin-elastic report mast_results --excitation "2 Hz" "5 Hz"

    One HTML file that every browser opens, without network: what was computed, pictures that can be
    turned, largest values, curves, audit, materials, and how to repeat it.  The page of several
    runs stands beside the first folder: verdicts on strength, stability, frequencies and motion of
    the part, a table of the runs, and a section each.  Of several analyses of one case, each gets a
    page in its folder, too.

    \f
    Raises:
        CaseError: The output is no HTML file, or the excitation is no range of frequencies.
        InputError: It is no folder of results.
        OutputError: Something cannot be written, or there is no Chromium for the PDF.
    """
    start()
    from mpi4py import MPI

    from dolfin_elastic.core.errors import CaseError
    from dolfin_elastic.core.parallel import on_root
    from dolfin_elastic.report.several import write_pages
    from dolfin_elastic.results.finished.run import folders_of_analyses

    comm, shaken = MPI.COMM_WORLD, _range(excitation)
    runs = on_root(comm, lambda: [r for one in folders for r in folders_of_analyses(one) or [one]])
    if len(runs) > len(folders) == 1 and output is None:
        for run in runs:
            report([run], pdf=pdf)
    beside = folders[0] / ".." if folders[0].name in ("", "..") else folders[0].parent
    page = output or (beside if len(folders) > 1 else folders[0]) / "report.html"
    if page.suffix.lower() not in (".html", ".htm"):
        raise CaseError(
            f"'{page}' is no page", where="--output", expected='for example "report.html"'
        )
    on_root(comm, lambda: _write(write_pages(runs, page, shaken), pdf=pdf))


def _range(words: tuple[str, str] | None) -> tuple[float, float] | None:
    """Two frequencies in ascending order [Hz]."""
    from dolfin_elastic.core.errors import CaseError, InputError
    from dolfin_elastic.core.units import to_si

    if words is None:
        return None
    example = 'for example --excitation "2 Hz" "5 Hz"'
    try:
        low, high = (to_si(word, "Hz") for word in words)
    except InputError as error:
        raise CaseError(str(error), where="--excitation", expected=example) from None
    if not 0 <= low < high:
        text = f"'{words[0]}' to '{words[1]}' is no range of frequencies"
        raise CaseError(text, where="--excitation", expected=example)
    return low, high


def _write(page: Path, *, pdf: bool) -> None:
    """Says what was written, and prints the page. On rank 0."""
    size = page.stat().st_size
    print(f"{page} written ({size / 1e6:.1f} MB)", flush=True)
    if size > 10_000_000:
        print("warning: it is larger than many mail servers take (10 MB)", file=sys.stderr)
    if pdf:
        from dolfin_elastic.report.pdf import print_pdf

        print(f"{print_pdf(page, page.with_suffix('.pdf'))} written")
