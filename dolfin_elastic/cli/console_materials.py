"""What the command line shows of materials and of their tests at a material point."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from dolfin_elastic.cli.terminal import Screen
from dolfin_elastic.model.materials.library import in_words, library

if TYPE_CHECKING:
    from dolfin_elastic.model.point.cyclic_curve import CyclicCurve
    from dolfin_elastic.model.point.report import MaterialReport
    from dolfin_elastic.model.point.time_curves import TimeCurves
    from dolfin_elastic.model.point.viscous_curves import ViscousCurves

_MARKS = {"pass": "ok", "fail": "FAILED", "note": "note"}


def as_json(value: object) -> str:
    """JSON without nan and inf, which are null."""
    return json.dumps(_plain(value), indent=2, ensure_ascii=False)


def _plain(value: object) -> object:
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def report_table(report: MaterialReport) -> dict[str, object]:
    """The tests of a material as plain values, for scripts."""
    return {
        "passed": not report.failed,
        "findings": [asdict(f) for f in report.findings],
        "notes": list(report.notes),
        "curves": {
            name: {
                curve.mode.symbol: curve.values.tolist(),
                "P": curve.P[:, *curve.mode.shown].tolist(),
                "J": curve.J.tolist(),
                "energy": curve.energy.tolist(),
            }
            for name, curve in report.curves.items()
        },
        **({} if report.viscous is None else {"viscous": _viscous(report.viscous)}),
        **({} if report.over_time is None else {"over_time": _over_time(report.over_time)}),
        **({} if report.cyclic is None else {"cyclic": _cyclic(report.cyclic)}),
    }


def _viscous(curves: ViscousCurves) -> dict[str, object]:
    """Moduli over those of the constants."""
    return {
        "time": curves.t.tolist(),
        "relaxation": curves.relaxation.tolist(),
        "omega": curves.omega.tolist(),
        "storage": curves.storage.tolist(),
        "loss": curves.loss.tolist(),
        "mu": curves.mu,
    }


def _over_time(curves: TimeCurves) -> dict[str, object]:
    """Uniaxial tests over time."""
    return {
        "time": curves.t.tolist(),
        "relaxation": curves.relaxation.tolist(),
        "creep": curves.creep.tolist(),
        "loops": [
            {
                "frequency": loop.frequency,
                "stretch": loop.stretch.tolist(),
                "nominal_stress": loop.nominal.tolist(),
                "lost": loop.lost,
            }
            for loop in curves.loops
        ],
    }


def _cyclic(curve: CyclicCurve) -> dict[str, object]:
    """States of uniaxial stress, in their order."""
    return {
        "stretch": curve.stretch.tolist(),
        "strain": curve.strain.tolist(),
        "stress": curve.stress.tolist(),
        "plastic_strain": curve.plastic.tolist(),
    }


def show_report(screen: Screen, name: str, report: MaterialReport, files: Sequence[Path]) -> None:
    """Prints the tests of one material.

    Args:
        screen: Where to.
        files: What was written, all in one folder.
    """
    screen.print(name, style="bold")
    table = Table("check", "", "result", box=SIMPLE_HEAD, pad_edge=False)
    for finding in report.findings:
        table.add_row(finding.check, _MARKS[finding.verdict], finding.text)
    screen.print(table)
    if report.curves:
        screen.print(_curves(report))
    for note in report.notes:
        screen.tell(f"note: {note}")
    if files:
        screen.print(f"written: {files[0].parent}: {', '.join(f.name for f in files)}")


def _curves(report: MaterialReport) -> Table:
    """A table of the nominal stress at both ends of each curve."""
    table = Table("curve", box=SIMPLE_HEAD, pad_edge=False)
    for head in ("from", "stress [Pa]", "to", "stress [Pa]", "J there"):
        table.add_column(head, justify="right")
    for name, curve in report.curves.items():
        stress = curve.P[:, *curve.mode.shown]
        first, last = f"{curve.values[0]:.4g}", f"{curve.values[-1]:.4g}"
        ends = (f"{stress[0]:.4g}", f"{stress[-1]:.4g}")
        table.add_row(name, first, ends[0], last, ends[1], f"{curve.J[-1]:.4g}")
    return table


def show_laws(screen: Screen, laws: Sequence[Mapping[str, Any]]) -> None:
    """Prints the laws.

    Args:
        screen: Where to.
        laws: See `case.material_report.law_table`.
    """
    for law in laws:
        screen.print(law["law"], style="bold")
        screen.print(f"  {law['what']}")
        if law["formula"]:
            screen.print(f"  {law['formula']}")
        for name, text in law["parameters"].items():
            screen.print(f"    {name:<8} {text}")
        if law["source"]:
            screen.print(f"  source: {law['source']}")
        screen.print()


def show_library(screen: Screen, *names: str) -> None:
    """Prints materials of the library with their sources; all without a name."""
    rows = [in_words(name) for name in names or library()]
    screen.print('materials by name, as in material = "steel S235"', style="bold")
    heads = ("material", "elastic constants", "density", "expansion", "yield")
    table = Table(*heads, box=SIMPLE_HEAD, pad_edge=False)
    for *cells, _ in rows:
        table.add_row(*cells)
    screen.print(table)
    for name, *_, about in rows:
        screen.tell(f"  {name}: {about}")
