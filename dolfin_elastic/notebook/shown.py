"""HTML of bodies, problems, runs and tests of materials, for the cells of a notebook.

Nothing in it is loaded from elsewhere, and no script runs but the viewer of a run, in a sandbox.
"""

from __future__ import annotations

import base64
import logging
import tempfile
from collections.abc import Iterable, Sequence
from functools import singledispatch
from pathlib import Path

from markupsafe import Markup

from dolfin_elastic.case.check.sizes import PartSize
from dolfin_elastic.case.described import described_problem
from dolfin_elastic.case.look.listing import Look, listing
from dolfin_elastic.case.material_report import write
from dolfin_elastic.core.errors import DrawingError
from dolfin_elastic.core.help.notebook import Shown
from dolfin_elastic.core.si_text import counted, listed, quantity, size
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.materials.spatial import units_of
from dolfin_elastic.model.point.report import MaterialReport
from dolfin_elastic.notebook.report_view import ReportView
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.report.page import render
from dolfin_elastic.report.report import report_contents
from dolfin_elastic.report.still import data_url
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.scene.body import body_scene, patch_colour
from dolfin_elastic.results.scene.scene import Picture
from dolfin_elastic.results.verdict import verdict_of

log = logging.getLogger("dolfin_elastic")


@singledispatch
def html_of(thing: Shown) -> str | None:
    """HTML of a thing; None where another rank would have to help: a cell runs on one alone.

    Not collective.
    """
    raise NotImplementedError(type(thing).__name__)


@html_of.register
def _(body: Body) -> str | None:
    if body.comm.size > 1:
        return None
    look = listing(body, use=lambda _name, _kind: "", notes=body.notes)
    sides = " x ".join(f"{side / look.metres:.4g}" for side in look.extent)
    lines = [
        f"{sides} {look.unit}, {look.dim}D, {counted(look.cells, 'element')}",
        *look.information,
        *(f"field {name}: {body.fields[name].describe(body.comm)}" for name in body.fields),
        *(f"note: {note}" for note in look.notes),
    ]
    named = look.surfaces if body.dim == 3 else look.regions[1:]
    return _page(
        f"Body {look.source}".strip(),
        lines,
        _sizes("region", look.regions, look, look.dim),
        _sizes("surface", look.surfaces, look, look.dim - 1),
        _sizes("edge", look.edges, look, 1),
        _sizes("point", look.points, look, 0),
        _body_picture(body, [row.name for row in named]),
    )


def _sizes(kind: str, rows: Sequence[PartSize], look: Look, power: int) -> Markup:
    """A table of named parts.

    Args:
        power: Of the unit of length, in what is measured of them; 0: nothing is.
    """
    unit = LengthUnit.of(look.metres)
    measures = [size(row.measure, power) if power else "" for row in rows]
    return _table(
        (kind, "count", "size" if power else "", "centroid"),
        [
            (row.name, row.count, measure, unit.point(row.centroid) if row.centroid else "")
            for row, measure in zip(rows, measures, strict=True)
        ],
    )


def _body_picture(body: Body, names: Sequence[str]) -> Markup:
    """The body with its parts in colours; nothing where no picture can be drawn."""
    scene = body_scene(body, names)
    assert scene is not None  # on rank 0
    legend = tuple((name, "", patch_colour(i)) for i, name in enumerate(names))
    view = "z" if scene.plane else "isometric"
    try:
        return _image(data_url(Picture(scene, view, legend=legend)))
    except DrawingError as error:
        log.warning("the body is not drawn: %s", error)
        return Markup()


@html_of.register
def _(problem: Problem) -> str | None:
    if problem.body.comm.size > 1:
        return None
    kind = problem.geometry if problem.body.dim == 2 else "solid"
    unknowns = ["displacement", *(["pressure"] if problem.mixed else [])]
    elements = counted(problem.body.num_cells, "element")
    lines = [
        f"{kind}, {elements} of degree {problem.degree}",
        f"{problem.num_dofs} unknowns: {listed(unknowns)}",
    ]
    materials = []
    for region in problem.regions:
        units = units_of(type(region.typical))
        constants = [
            f"{name} = {quantity(float(constant.value), units.get(name, ''))}"
            for name, constant in region.constants.items()
        ]
        materials.append((region.name, region.law.name(), ", ".join(constants)))
    acting = [
        (row.key, row.label, row.text + (", follows the deformation" if row.follows else ""))
        for row in described_problem(problem)
    ]
    return _page(
        f"Problem on {problem.body.source}" if problem.body.source else "Problem",
        lines,
        _table(("material", "law", "constants"), materials),
        _table(("", "name", "supports and loads"), acting),
    )


@html_of.register
def _(run: FinishedRun) -> str:
    verdict = verdict_of(run.summary)
    head = Markup("<p>{}</p>").format(verdict.text) if verdict is not None else Markup()
    return head + Markup(ReportView(render(report_contents(run)))._repr_html_())


@html_of.register
def _(report: MaterialReport) -> str:
    with tempfile.TemporaryDirectory() as folder:
        files = write(report.law.name(), report, Path(folder))
        pictures = [_png(file) for file in files if file.suffix == ".png"]
    return _page(
        f"Tests of the law {report.law.name()} at a point",
        [f"note: {note}" for note in report.notes],
        _table(("check", "", "result"), [(f.check, f.verdict, f.text) for f in report.findings]),
        *pictures,
    )


# --- pieces of HTML ---


def _page(title: str, lines: Iterable[str], *parts: Markup) -> str:
    """A title, lines of text, and what stands below."""
    texts = Markup("<br>").join(lines)
    return str(Markup("<div><b>{}</b><br>{}{}</div>").format(title, texts, Markup().join(parts)))


def _table(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> Markup:
    """A table; nothing without rows."""
    if not rows:
        return Markup()
    lines = [
        Markup("<tr>{}</tr>").format(Markup().join(Markup(cell).format(one) for one in row))
        for cell, row in (
            ('<th style="text-align: left">{}</th>', heads),
            *(('<td style="text-align: left">{}</td>', row) for row in rows),
        )
    ]
    return Markup("<table>{}</table>").format(Markup().join(lines))


def _png(file: Path) -> Markup:
    return _image("data:image/png;base64," + base64.b64encode(file.read_bytes()).decode("ascii"))


def _image(url: str) -> Markup:
    return Markup('<img style="max-width: 100%" width="640" src="{}">').format(url)
