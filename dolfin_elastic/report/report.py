"""`write_report`: the page of a finished run."""

from __future__ import annotations

import base64
import errno
import hashlib
import json
import logging
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from dolfin_elastic.case.toml import toml_text
from dolfin_elastic.core import __version__
from dolfin_elastic.core.errors import DrawingError
from dolfin_elastic.core.files.regular import irregular, read_regular
from dolfin_elastic.core.si_text import counted, listed, number, quantity, size, vector
from dolfin_elastic.report import balance, contents
from dolfin_elastic.report.charts import Axis, histogram
from dolfin_elastic.report.drawn import drawn_frames, mesh_quality, scene_of
from dolfin_elastic.report.laws import materials_of
from dolfin_elastic.report.page import json_text, render
from dolfin_elastic.report.scene import Viewed, packed
from dolfin_elastic.report.still import stills
from dolfin_elastic.report.words import analysis_of, what_was_computed
from dolfin_elastic.results.files import replace_text
from dolfin_elastic.results.finished import findings
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.finished.xdmf import Frame, damaged
from dolfin_elastic.results.verdict import Table, verdict_of

log = logging.getLogger("dolfin_elastic")

LARGEST = 10_000_000
"""Bytes of a page: what goes through every mail server."""
_PICTURES = 1_500_000
"""Bytes of the run's own pictures in it, where there is room for them."""
_REST = 1_500_000
"""Letters of a page without pictures: the viewer has 580 000, charts and case the others."""
_HASHED = 2_000_000_000
"""Bytes of a file up to which it gets a checksum."""
_CASE = 200_000
"""Letters of the case that are shown."""
_SUPPORTS = ("#1f6fb2", "#138a8a", "#5b5fc7", "#2a8f4f", "#6a7f95", "#7d4fb0")
_LOADS = ("#d1341f", "#d9822b", "#b8327f", "#a5691c", "#e0503f", "#8f2d56")


def write_report(folder: Path, output: Path) -> Path:
    """Writes the page of a finished run. Not collective.

    Args:
        folder: Of the results; nothing in it is changed unless `output` lies there.
        output: The HTML file.

    Returns:
        The file.

    Raises:
        InputError: It is no folder of results, or a file in it cannot be read.
        OutputError: The page cannot be written.
    """
    run = FinishedRun(folder)
    text = render(report_contents(run))
    replace_text(output, text)
    return output


def report_contents(run: FinishedRun) -> dict[str, object]:
    """All that the template shows.

    Raises:
        InputError: A file of the results cannot be read.
    """
    frames, viewed, told = told_of(run)
    pictures = pictures_of(viewed)
    return {
        **told,
        **pictures,
        "effort": _effort(run.summary),
        "charts": contents.history_charts(run),
        "newton": contents.newton_chart(run),
        "residuals": contents.residual_chart(run.summary),
        "steps": contents.steps_of(run),
        "materials": materials_of(run.case),
        "mesh": _mesh(run, frames, _extent(run, viewed)),
        "own_pictures": list(_own_pictures(run.folder, _room(pictures))),
        "case_text": _case_text(run.case),
        "checksums": list(_checksums(run.folder)),
        "timings": _timings(run.summary),
        "memory": memory_of(run.summary),
        "command": _command(run),
    }


def told_of(
    run: FinishedRun,
) -> tuple[list[tuple[str, Frame]], Viewed | None, dict[str, object]]:
    """What any page tells of a run: its frames, its scene, and what the templates show of it.

    Raises:
        InputError: A file of the results cannot be read.
    """
    frames = drawn_frames(run)
    viewed = scene_of(run, frames)
    status, kind = findings.status_of(run.summary)
    dim = frames[-1][1].dim if frames else (run.model.get("mesh") or {}).get("dim")
    told = {
        "title": str(run.case.get("title") or run.folder.resolve().name),
        "folder": run.folder.resolve().name,
        "analysis": analysis_of(run.case),
        "summary": run.summary,
        "status": status,
        "status_kind": kind,
        "reason": str(run.summary.get("reason") or ""),
        "diagnosis": contents.diagnosis_lines(run.summary),
        "sentences": what_was_computed(run, dim=dim),
        "key_figures": list(findings.key_figures(run).values()),
        "audit": contents.audit_of(run),
        "audited": _audited(run.summary),
        "mesh_badge": findings.mesh_badge(run.summary),
        "verdict": verdict_of(run.summary),
        "about": {key: str(run.case.get(key) or "") for key in ("part", "author", "conclusion")},
        "extremes": findings.extremes_of(run.summary),
        "last_values": contents.last_values(run),
        "supports": balance.supports_of(run),
        "loads": balance.loads_of(run),
        "balance": balance.balance_of(run),
        "modes": findings.modes_of(run),
        "warnings": [str(text) for text in run.model.get("warnings") or []],
        "version": __version__,
    }
    return frames, viewed, told


def memory_of(summary: Table) -> str:
    """Peak memory of all ranks together."""
    return quantity(float((summary.get("peak_memory") or {}).get("sum") or 0), "byte")


def _audited(summary: Table) -> str:
    """Words beside the title; empty where nothing was audited."""
    verdict = (summary.get("audit") or {}).get("verdict")
    if not verdict or not summary.get("steps"):
        return ""
    what = "Audit" if summary.get("status") == "completed" else "Audit of the steps so far"
    return f"{what}: {verdict}"


# --- pictures ---


def _palette(viewed: Viewed | None) -> dict[str, str]:
    """Support or load to its colour."""
    result: dict[str, str] = {}
    for glyphs in viewed.scene.glyphs if viewed is not None else ():
        colours = _LOADS if glyphs.load else _SUPPORTS
        result[glyphs.key] = colours[int(glyphs.key.split()[-1]) % len(colours)]
    return result


def pictures_of(viewed: Viewed | None) -> dict[str, object]:
    """The data of the viewer, and fixed pictures."""
    palette = _palette(viewed)
    result: dict[str, object] = {"stills": [], "held": "", "palette": palette, "not_drawn": ""}
    if viewed is None:
        return {**result, "scene": None, "drawn": "", "left_out": ()}
    try:
        result["stills"], result["held"] = stills(viewed, palette)
    except DrawingError as error:
        result["not_drawn"] = str(error)
        log.warning("the page has no fixed pictures: %s", error)
    count, of = len(viewed.scene.triangles), viewed.of
    return {
        **result,
        "scene": packed(viewed, palette),
        "left_out": viewed.left_out,
        "drawn": f"drawn with {count} of {of} triangles of its surface" if count < of else "",
        "still_label": viewed.frame.label,
        "still_scale": _scale_text(viewed),
    }


def _scale_text(viewed: Viewed) -> str:
    if viewed.modes:
        return "the size of a mode has no meaning"
    times = f"{number(viewed.scale)} times" if viewed.scale != 1 else "in true scale"
    return f"deformation {times}"


def _room(pictures: Mapping[str, object]) -> int:
    """Bytes for the run's own pictures, which a page holds as text of 4 letters for 3 bytes.

    Args:
        pictures: From `pictures_of`.
    """
    stills = pictures["stills"]
    assert isinstance(stills, list)
    urls = [url for _, url in [*stills[:1], *stills]]  # the first one stands in a page twice
    used = sum(map(len, urls)) + len(str(pictures["held"])) + len(json_text(pictures["scene"]))
    return max(0, min(_PICTURES, (LARGEST - _REST - used) * 3 // 4))


def _own_pictures(folder: Path, room: int) -> Iterator[tuple[str, str]]:
    """Names and data URLs of PNG files of the folder that have room; of a series the last one."""
    last: dict[str, Path] = {}
    for path in sorted(folder.glob("*.png")):
        stem = path.stem.rstrip("0123456789")
        last[stem if stem.endswith("_") else path.stem] = path
    for path in last.values():
        try:
            data = read_regular(path, room)
        except OSError as error:
            if error.errno != errno.EFBIG:
                log.warning("%s is left out: %s", path, error.strerror)
            continue
        if data[:8] != b"\x89PNG\r\n\x1a\n":
            continue
        room -= len(data)
        yield path.name, "data:image/png;base64," + base64.b64encode(data).decode("ascii")


# --- numbers ---


def _extent(run: FinishedRun, viewed: Viewed | None) -> list[float]:
    """Sides of the body [m]."""
    if viewed is not None:
        sides = np.ptp(viewed.scene.points, axis=0)
        return [float(side) for side in (sides[:2] if viewed.scene.plane else sides)]
    return [float(x) for x in (run.model.get("mesh") or {}).get("extent") or []]


def _mesh(
    run: FinishedRun, frames: list[tuple[str, Frame]], sides: list[float]
) -> dict[str, object]:
    summary, noted = run.summary, run.model.get("mesh") or {}
    file = Path(str((run.case.get("mesh") or {}).get("file") or "")).name
    result: dict[str, object] = {
        "cells": summary.get("cells"),
        "dofs": summary.get("dofs"),
        "degree": summary.get("degree"),
        "source": str(noted.get("source") or file),
        "information": [str(text) for text in noted.get("information") or []],
        "sides": vector(sides, "m") if sides else "",
        "quality": None,
    }
    if not frames:
        return result
    quality, volumes = mesh_quality(run, frames)
    counts, edges = np.histogram(quality, bins=20, range=(0.0, max(1.0, float(quality.max()))))
    chart = histogram(
        edges, counts, Axis("quality"), Axis("elements", whole=True), "Quality of elements"
    )
    plane = frames[-1][1].dim == 2
    result["quality"] = {
        "chart": chart,
        "worst": findings.Value.of(float(quality.min())),
        "mean": findings.Value.of(float(quality.mean())),
        "poor": counted(int(np.count_nonzero(quality < 0.05)), "element"),
    }
    # Of older runs that of straight cells.
    volume = noted.get("volume")
    whole = float(volume if isinstance(volume, int | float) else volumes.sum())
    result["volume"] = size(whole, 2 if plane else 3)
    return result


def _timings(summary: Table) -> list[tuple[str, str]]:
    rows = summary.get("timings") or {}
    return [(str(k), f"{number(float(v), 3)} s") for k, v in rows.items() if v and v >= 0.005]


def _effort(summary: Table) -> str:
    """Steps and iterations in words."""
    if summary.get("modes") and not summary.get("steps"):
        solver = f": {summary['eigensolver']}" if summary.get("eigensolver") else ""
        return f"{counted(len(summary['modes']), 'mode')} of an eigenvalue problem{solver}."
    counts = {
        "step": summary.get("steps"),
        "Newton iteration": summary.get("newton_iterations"),
        "iteration of the linear solver": summary.get("krylov_iterations"),
        "restart": len(summary.get("restarts") or []),
    }
    counts_text = [counted(int(count), name) for name, count in counts.items() if count]
    return f"{listed(counts_text)}." if counts_text else "No step was completed."


# --- to repeat it ---


def _case_text(case: Table) -> str:
    if not case:
        return ""
    mesh = dict(case.get("mesh") or {})
    if "file" in mesh:  # where it lay is nobody's business
        mesh["file"] = Path(str(mesh["file"])).name
    output = dict(case.get("output") or {})
    if "folder" in output:
        output["folder"] = Path(str(output["folder"])).name
    try:
        text = toml_text({**case, "mesh": mesh, **({"output": output} if output else {})})
    except TypeError as error:
        raise damaged(f"no case file can hold this: {error}", "summary.json: case") from None
    return text if len(text) <= _CASE else f"{text[:_CASE]}\n# ... {len(text) - _CASE} letters more"


def _command(run: FinishedRun) -> str:
    file = run.model.get("file") or "case.toml"
    ranks = run.summary.get("ranks")
    words = ["dolfin-elastic", "run", str(file)]
    if (goal := _goal(run.folder)) is not None:
        words[1:] = ["converge", str(file), "--until", *goal]
    if isinstance(ranks, int) and ranks > 1:
        words = ["mpirun", "-n", str(ranks), *words]
    options = run.model.get("petsc") or {}
    words += ["--"] * bool(options)
    for key, value in options.items():
        words += [f"-{key}"] if value in (None, "", True) else [f"-{key}", str(value)]
    return shlex.join(words)


def _goal(folder: Path) -> list[str] | None:
    """Quantity and tolerance of `converge`; None of a single run."""
    try:
        content = json.loads((folder / "converge.json").read_text(encoding="utf-8"))
        return [str(content["quantity"]), f"{100 * float(content['tolerance']):g}%"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _checksums(folder: Path) -> Iterator[tuple[str, str, str]]:
    """Name, size and SHA-256 of the files that the numbers come from."""
    names = ["summary.json", "history.csv", "modes.csv", "results.xdmf"]
    paths = [folder / name for name in names]
    paths += sorted((folder / "results_data").glob("*.h5"))[-1:]
    paths += sorted((folder / "modes_data").glob("*.h5"))[:1]
    for path in paths:
        if irregular(path) or not path.is_file() or path.stat().st_size > _HASHED:
            continue
        digest = hashlib.sha256()
        with path.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
        length = quantity(float(path.stat().st_size), "byte")
        yield str(path.relative_to(folder)), length, digest.hexdigest()
