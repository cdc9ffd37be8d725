"""`write_pages`: one page about several runs, a table of them and a section for each."""

from __future__ import annotations

import logging
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from dolfin_elastic.core import __version__
from dolfin_elastic.core.si_text import counted, given, number
from dolfin_elastic.report.page import render
from dolfin_elastic.report.report import LARGEST, memory_of, pictures_of, told_of, write_report
from dolfin_elastic.report.safety import Excitation, safety_of
from dolfin_elastic.results.files import replace_text
from dolfin_elastic.results.finished import findings
from dolfin_elastic.results.finished.findings import Value
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.verdict import Table, verdict_of

log = logging.getLogger("dolfin_elastic")

_TITLES = {
    "safety_factor": "smallest safety factor",
    "von_mises": "largest von Mises stress",
    "displacement": "largest displacement",
}
"""Key of a figure to its row; those of modes have a row for each of their quantities."""
_ABOUT = ("title", "part", "author", "conclusion", "output")
"""Tables and keys of a case that change no number."""
_MOST = 40
"""Keys of the cases that differ and are shown."""
_KINDS = {"holds": "good", "fails": "bad", "not known": "warn"}
_NO_ROOM = {"stills": [], "held": "", "not_drawn": "the page would be too large for a mail"}


@dataclass(frozen=True)
class Line:
    """A line of a cell of the table.

    Attributes:
        value: A number of the summary, or a text.
        remark: What is known of its error.
        kind: "good", "warn", "bad" or empty.
    """

    value: Value | str
    remark: str = ""
    kind: str = ""


Rows = dict[str, list[Sequence[Line]]]
"""Title of a row of the table to its cells, one a run."""


def write_pages(
    folders: Sequence[Path], output: Path, excitation: Excitation | None = None
) -> Path:
    """Writes one page about finished runs: of a single one its report. Not collective.

    Runs that are not of one part get a warning, and no verdict on all of them.

    Args:
        folders: Of their results; nothing in them is changed unless `output` lies there.
        output: The HTML file.
        excitation: What shakes the part; with it a single run, too, gets the page of several.

    Returns:
        The file.

    Raises:
        InputError: One is no folder of results, or a file in it cannot be read.
        OutputError: The page cannot be written.
    """
    if len(folders) == 1 and excitation is None:
        return write_report(folders[0], output)
    runs = [FinishedRun(folder) for folder in folders]
    short = [folder.resolve().name for folder in folders]
    names = [str(f) if short.count(s) > 1 else s for f, s in zip(folders, short, strict=True)]
    titles = dict.fromkeys(str(run.case.get("title") or "") for run in runs)
    safety = safety_of(runs, names, excitation)
    for difference in safety.differences:
        log.warning("not of one part: %s", difference)
    contents = {
        "title": ", ".join(filter(None, titles)) or "Several runs",
        "names": names,
        "safety": safety,
        "about": {key: _once(runs, key) for key in ("part", "author", "conclusion")},
        "found": rows_of_findings(runs),
        "cases": rows_of_cases([run.case for run in runs]),
        "sections": list(_sections(runs, names)),
        "version": __version__,
    }
    replace_text(output, render(contents, "several.html"))
    return output


def _once(runs: Sequence[FinishedRun], key: str) -> list[str]:
    """What the cases say under a key, each text once."""
    return list(dict.fromkeys(filter(None, (str(run.case.get(key) or "") for run in runs))))


def _sections(runs: Sequence[FinishedRun], names: Sequence[str]) -> Iterator[Markup]:
    """What the page tells of each run, with pictures while there is room."""
    room = LARGEST
    for count, (run, name) in enumerate(zip(runs, names, strict=True), 1):
        _, viewed, told = told_of(run)
        command = shlex.join(["dolfin-elastic", "report", str(run.folder)])
        told |= {**pictures_of(viewed), "scene": None, "anchor": f"run-{count}", "name": name}
        text = render({**told, "command": command}, "section.html")
        if len(text) > room:
            text = render({**told, "command": command, **_NO_ROOM}, "section.html")
        room -= len(text)
        yield Markup(text)


def rows_of_findings(runs: Sequence[FinishedRun]) -> Rows:
    """What the runs have found and taken."""
    columns = [dict(_findings(run)) for run in runs]
    heads = dict.fromkeys(head for column in columns for head in column)
    first = [*(head for head in heads if head not in _LAST), *_LAST]
    return {head: [column.get(head, ()) for column in columns] for head in first if head in heads}


_LAST = ("mesh", "time", "memory")
"""Rows at the end, which all runs have."""


def _findings(run: FinishedRun) -> Iterator[tuple[str, list[Line]]]:
    """Rows of one run."""
    summary, verdict = run.summary, verdict_of(run.summary)
    lines = (
        [Line(f"{verdict.text[:1].upper()}{verdict.text[1:]}", kind=_KINDS.get(verdict.kind, ""))]
        if verdict
        else []
    )
    status, kind = findings.status_of(summary)
    if summary.get("status") != "completed":
        lines.append(Line(status, kind=kind))
    yield "verdict", lines
    figures: dict[str, list[Line]] = {}
    for key, figure in findings.key_figures(run).items():
        head = _TITLES.get(key) or f"{key.rpartition(' ')[0]}, first modes"
        figures.setdefault(head, []).append(Line(figure.value, figure.trust, figure.kind))
    yield from figures.items()
    text, kind = findings.mesh_badge(summary)
    size = f"{counted(int(summary.get('cells') or 0), 'element')} of degree {summary.get('degree')}"
    badge = [Line(text.removeprefix("Mesh: "), kind=kind)] if summary.get("error") else []
    yield "mesh", [*badge, Line(size), Line(counted(int(summary.get("dofs") or 0), "unknown"))]
    seconds = float((summary.get("timings") or {}).get("total") or 0.0)
    ranks = counted(int(summary.get("ranks") or 1), "rank")
    yield "time", [Line(f"{number(seconds, 3)} s on {ranks}")]
    yield "memory", [Line(memory_of(summary))]


# --- cases side by side ---


def rows_of_cases(cases: Sequence[Table]) -> Rows:
    """Dotted keys of the values that are not the same in all cases."""
    flat = [dict(_leaves({k: v for k, v in case.items() if k not in _ABOUT})) for case in cases]
    keys = dict.fromkeys(key for one in flat for key in one)
    differ = [k for k in keys if any(k not in one or one[k] != flat[0].get(k) for one in flat)]
    rows: Rows = {
        key: [[Line(_given(key, one[key]))] if key in one else () for one in flat]
        for key in differ[:_MOST]
    }
    if len(differ) > _MOST:
        rows[f"and {len(differ) - _MOST} more"] = [()] * len(flat)
    return rows


def _given(key: str, value: object) -> str:
    """A value of a case; of the file of a mesh the name: where it lay is nobody's business."""
    if key.startswith("mesh.") and key.endswith(".file"):
        return Path(str(value)).name
    if value in ("", []):
        return "empty"
    return given(value) or "yes"


def _leaves(value: object, key: str = "") -> Iterator[tuple[str, object]]:
    """Dotted keys and values of nested tables; an empty table is a value."""
    if isinstance(value, Mapping) and value:
        for name, item in value.items():
            yield from _leaves(item, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list) and any(isinstance(item, Mapping) for item in value):
        for i, item in enumerate(value):
            yield from _leaves(item, f"{key}[{i}]")
    elif key:
        yield key, value
