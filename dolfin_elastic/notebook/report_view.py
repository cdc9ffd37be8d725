"""Reports of finished runs in a notebook."""

from __future__ import annotations

import html
import os
from dataclasses import dataclass
from pathlib import Path

from dolfin_elastic.report.page import render
from dolfin_elastic.report.report import report_contents
from dolfin_elastic.results.finished.run import FinishedRun


@dataclass(frozen=True)
class ReportView:
    """A report, which a notebook shows where it is the value of a cell.

    Attributes:
        page: The whole page as `report` writes it; it loads nothing.
        height: In the notebook [pixels].
    """

    page: str
    height: int = 800

    def _repr_html_(self) -> str:
        # In a sandbox, so that nothing of the page reaches the notebook around it.
        return (
            f'<iframe sandbox="allow-scripts" style="width: 100%; border: 0" '
            f'height="{self.height:d}" srcdoc="{html.escape(self.page)}"></iframe>'
        )


def show_report(folder: str | os.PathLike[str], *, height: int = 800) -> ReportView:
    """The report of a finished run with its viewer, for a cell of a notebook. Not collective.

    Args:
        height: In the notebook [pixels].

    Raises:
        InputError: It is no folder of results, or a file in it cannot be read.

    Example:
        show_report("block_results")
    """
    return ReportView(render(report_contents(FinishedRun(Path(folder)))), height)
