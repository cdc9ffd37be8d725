"""Materials of a case: constants, stress-stretch curves, and where the law comes from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from dolfin_elastic.case.material_report import law_table, usual_stretch
from dolfin_elastic.case.model_tables import read_material_tables
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.si_text import given, scaled_unit
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.model.materials.spatial import units_of
from dolfin_elastic.model.materials.user import SplitFormulaEnergy
from dolfin_elastic.model.point.cyclic_curve import CyclicCurve
from dolfin_elastic.model.point.homogeneous_tests import ResponseCurve
from dolfin_elastic.model.point.report import material_report
from dolfin_elastic.model.point.time_curves import TimeCurves
from dolfin_elastic.model.point.viscous_curves import ViscousCurves
from dolfin_elastic.report.charts import Axis, Line, line_chart
from dolfin_elastic.report.words import names, part_names
from dolfin_elastic.results.verdict import Table

_DRAWN = 8
"""Materials whose curves are computed: a second each."""


@dataclass(frozen=True)
class MaterialText:
    """A material, for the page.

    Attributes:
        name: In the case.
        law: Name of its law.
        where: The parts that it fills.
        constants: Name and value as they were given, and what follows of relaxation and yield.
        what: One sentence about the law.
        formula: Its energy or stress.
        source: Where it was published.
        charts: Stress over stretch and over shear, and over cycles; moduli over time and frequency.
        notes: What its tests at a point have found, or why there are no curves.
    """

    name: str
    law: str
    where: str
    constants: tuple[tuple[str, str], ...]
    what: str
    formula: str
    source: str
    charts: tuple[Markup, ...]
    notes: tuple[str, ...]


def materials_of(case: Table) -> list[MaterialText]:
    """The materials of a case."""
    known = {str(row["law"]): row for row in law_table()}
    tables = case.get("materials", {})
    tables = tables if isinstance(tables, Mapping) else {}
    result = []
    for k, (name, row) in enumerate(tables.items()):
        table = row if isinstance(row, Mapping) else {}
        law = str(table.get("law", "energy" if "energy" in table else ""))
        page = known.get(law, {})
        charts, notes, inelastic = _tested(name, table) if k < _DRAWN else ((), (), ())
        result.append(
            MaterialText(
                name=str(name),
                law=law,
                where=names(part_names(table)),
                constants=(*_constants(table, law), *inelastic),
                what=str(page.get("what", "")),
                formula=str(page.get("formula", "")),
                source=str(page.get("source", "")),
                charts=charts,
                notes=notes,
            )
        )
    return result


def _constants(table: Table, law: str) -> list[tuple[str, str]]:
    """Key and value, a bare number in the SI unit in which the law reads it."""
    units = units_of(MATERIALS.get(law, SplitFormulaEnergy))
    result = []
    for key, value in table.items():
        if key == "parameters":
            result.append((str(key), _parameters(value)))
        elif key not in ("law", "on"):
            result.append((str(key), _constant(value, units.get(str(key), "").replace("*", " "))))
    return result


def _constant(value: object, unit: str) -> str:
    """A constant, which may be a field of the mesh."""
    if isinstance(value, Mapping) and unit and not value.get("unit"):
        return f"{given(value)} [{unit}]"
    return given(value, unit)


def _parameters(table: object) -> str:
    """Parameters of an energy that a user wrote, whose units follow from the formula alone."""
    text = given(table)
    values = table.values() if isinstance(table, Mapping) else ()
    bare = any(isinstance(value, int | float) for value in values)
    return f"{text} (bare numbers: SI units)" if bare else text


def _tested(
    name: str, table: Table
) -> tuple[tuple[Markup, ...], tuple[str, ...], tuple[tuple[str, str], ...]]:
    """Curves and notes of a material; its relaxation and its cycles as constants."""
    try:
        law = read_material_tables({name: dict(table)})[name].law
        report = material_report(law, largest=usual_stretch(law))
    except InputError as error:
        return (), (f"No curves: {error}",), ()
    except (ArithmeticError, ValueError, KeyError, TypeError) as error:
        return (), (f"No curves: the material cannot be tried at a point ({error})",), ()
    failed = tuple(f"{row.check}: {row.text}" for row in report.failed)
    wanted = ("relaxation", "creep", "loops", "cycles")
    inelastic = tuple((f.check, f.text) for f in report.findings if f.check in wanted)
    if not report.curves:
        return (), (*failed, *report.notes), inelastic
    modes = ("uniaxial", "equibiaxial", "planar")
    stretched = [c for c in report.curves.values() if c.mode.name in modes]
    sheared = [c for c in report.curves.values() if c.mode.rest == 0]
    charts = [_chart(part) for part in (stretched, sheared) if part]
    if report.viscous is not None:
        charts += _viscous_charts(report.viscous)
    if report.over_time is not None:
        charts += _charts_over_time(report.over_time)
    if report.cyclic is not None:
        charts.append(_cyclic_chart(report.cyclic))
    return tuple(charts), (*failed, *([law.warning] if law.warning else [])), inelastic


def _viscous_charts(curves: ViscousCurves) -> list[Markup]:
    """Relaxation over time; storage and loss over frequency."""
    factor, unit = scaled_unit((curves.mu or 1.0) * curves.law.sudden, "Pa")
    scale, up = (curves.mu or 1.0) / factor, Axis(f"shear modulus [{unit}]")
    if curves.mu is None:
        scale, up = 1.0, Axis("modulus over that of the constants")
    time, hertz = (Axis(label, logarithmic=True) for label in ("time [s]", "frequency [Hz]"))
    f = np.asarray(curves.omega / (2 * np.pi), dtype=np.float64)
    over_time = [Line("relaxation", curves.t, scale * curves.relaxation)]
    parts = (("storage", curves.storage), ("loss", curves.loss))
    over_frequency = [Line(name, f, scale * values) for name, values in parts]
    return [
        line_chart(over_time, time, up, title=f"{up.label} over time"),
        line_chart(over_frequency, hertz, up, title=f"{up.label} over frequency"),
    ]


def _charts_over_time(curves: TimeCurves) -> list[Markup]:
    """Strain under a held stress over time; stress over strain in cycles."""
    factor, unit = scaled_unit(curves.largest, "Pa")
    up, strain = Axis(f"nominal stress [{unit}]"), Axis("strain [%]")
    lines = [
        Line(loop.name, _percent(loop.stretch), _over(loop.nominal, factor))
        for loop in curves.loops
    ]
    loops = line_chart(lines, strain, up, title=f"{up.label} over strain, in cycles")
    if not len(curves.t):
        return [loops]
    time, load = Axis("time [s]", logarithmic=True), f"{curves.relaxation[0] / factor:.3g} {unit}"
    creep = [Line("creep", curves.t[1:], _percent(curves.creep[1:]))]
    title = f"strain under a nominal stress of {load}"
    return [line_chart(creep, time, strain, title=title), loops]


def _percent(stretch: FloatArray) -> FloatArray:
    """Strain [%] at a stretch, shape (n,)."""
    return _over(stretch - 1, 0.01)


def _over(values: FloatArray, unit: float) -> FloatArray:
    return np.asarray(values / unit, dtype=np.float64)


def _cyclic_chart(curve: CyclicCurve) -> Markup:
    """Stress of a metal over some cycles of strain."""
    factor, unit = scaled_unit(float(np.abs(curve.stress).max()), "Pa")
    across, up = curve.measures
    percent = np.asarray(100 * curve.strain, dtype=np.float64)
    lines = [Line("uniaxial", percent, np.asarray(curve.stress / factor, dtype=np.float64))]
    title = f"{up} over {across}, in cycles"
    return line_chart(lines, Axis(f"{across} [%]"), Axis(f"{up} [{unit}]"), title=title)


def _chart(curves: list[ResponseCurve]) -> Markup:
    """Nominal stress of some tests."""
    lines, most = [], 0.0
    for curve in curves:
        i, j = curve.mode.shown
        most = max(most, float(np.nanmax(np.abs(curve.P[:, i, j]), initial=0.0)))
    factor, unit = scaled_unit(most, "Pa")
    for curve in curves:
        i, j = curve.mode.shown
        lines.append(Line(curve.mode.name, curve.values, curve.P[:, i, j] / factor))
    across = "stretch" if curves[0].mode.rest else "amount of shear"
    up = f"nominal stress [{unit}]"
    return line_chart(lines, Axis(across), Axis(up), title=f"{up} over {across}")
