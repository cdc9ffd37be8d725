"""`write_sweep_page`: the runs of a sweep on one page: table, plot, and what samples say."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path

from dolfin_elastic.core import __version__
from dolfin_elastic.report.page import render
from dolfin_elastic.results.files import replace_text


def write_sweep_page(
    output: Path,
    title: str,
    heads: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    lines: Sequence[str] = (),
    causes: Sequence[str] = (),
    picture: Path | None = None,
) -> Path:
    """Writes the page. Not collective.

    Args:
        output: The HTML file.
        heads: Of the columns, with units.
        rows: Texts of the table, a cell for each of `heads`.
        lines: What samples say of each result.
        causes: Why runs have failed, by their numbers.
        picture: A PNG; none where nothing was drawn.

    Raises:
        OutputError: The page cannot be written.
    """
    image = b"" if picture is None else picture.read_bytes()
    contents = {
        "title": title,
        "heads": heads,
        "rows": rows,
        "lines": lines,
        "causes": causes,
        "picture": base64.b64encode(image).decode(),
        "version": __version__,
    }
    replace_text(output, render(contents, "sweep.html"))
    return output
