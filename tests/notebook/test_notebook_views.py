"""What notebooks show of bodies, problems, runs and tests of materials."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import (
    FinishedRun,
    Force,
    NeoHookean,
    Problem,
    Spring,
    Statics,
    Summary,
    Support,
    Xdmf,
    box_body,
    material_report,
    rectangle_body,
)
from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.help.notebook import Shown

alone = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="notebooks show things on one rank")


class Text(HTMLParser):
    """The text of a page, and what it would load or run."""

    def __init__(self) -> None:
        super().__init__()
        self.words: list[str] = []
        self.loaded: list[str] = []
        self.tags: list[str] = []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        given = dict(attrs)
        self.loaded += [given[key] for key in ("src", "href", "data") if given.get(key)]

    def handle_data(self, data):
        self.words.append(data)


def shown(thing: Shown) -> Text:
    html = thing._repr_html_()
    assert html is not None
    page = Text()
    page.feed(html)
    assert all(url.startswith("data:image/png;base64,") for url in page.loaded)
    assert "script" not in page.tags
    return page


def make_body():
    body = box_body(size=[0.2, 0.1, 0.1], cells=[4, 2, 2])
    count = len(body.owned_cells())
    body.fields["mu <b>"] = np.linspace(1.0, 2.0, count)
    return body


def make_problem(body) -> Problem:
    return Problem(
        body,
        NeoHookean(E="1 MPa", nu=0.3),
        supports=[Support(on="left"), Spring(on="top", stiffness=[1e4, 1e4, 1e4])],
        loads=[Force(on="right", value=[0, 0, -2])],
        degree=1,
    )


@alone
def test_a_body_shows_its_parts():
    """Sides, sizes of parts, fields, and a picture; names are text, whatever is in them."""
    page = shown(make_body())
    text = "|".join(page.words)
    assert "0.2 x 0.1 x 0.1 m, 3D" in text
    assert "2000 cm³" in text or "0.002 m³" in text  # 0.2 x 0.1 x 0.1
    assert {"left", "right", "top", "bottom"} <= set(page.words)
    assert "mu <b>" in text and "b" not in page.tags[page.tags.index("table") :]
    assert page.tags.count("img") == 1


@alone
def test_a_plane_body_shows_itself():
    """With areas of regions and lengths of surfaces."""
    page = shown(rectangle_body(size=[0.2, 0.1], cells=[4, 2]))
    assert "2D" in "|".join(page.words) and page.tags.count("img") == 1


@alone
def test_a_problem_shows_what_acts_on_it():
    """Materials with their present constants; supports and loads in the words of `check`."""
    problem = make_problem(make_body())
    problem.parameters["materials.body.E"].value = 3e6
    text = "|".join(shown(problem).words)
    assert f"{problem.num_dofs} unknowns: displacement" in text
    assert "E = 3 MPa, nu = 0.3" in text
    assert "load[0]" in text and "support[1]" in text
    assert problem.loads[0].describe() in text and problem.supports[0].describe() in text


@alone
def test_a_run_shows_verdict_and_viewer(tmp_path: Path):
    """The sentence of the console, then the report in a sandbox."""
    problem = make_problem(box_body(size=[0.2, 0.1, 0.1], cells=[4, 2, 2]))
    writers = [output.open(problem, tmp_path) for output in (Xdmf(), Summary())]
    for state in Statics(problem).steps():
        for writer in writers:
            writer.write(state)
    for writer in writers:
        writer.close()
    page = FinishedRun(tmp_path)._repr_html_()
    assert re.match(r"<p>largest von Mises stress|<p>not known", page)
    assert '<iframe sandbox="allow-scripts"' in page and 'src="' not in page


@alone
def test_a_material_shows_its_tests():
    """Each check with its verdict, and the curves."""
    report = material_report(NeoHookean(E=1e6, nu=0.3), largest=1.5)
    page = shown(report)
    assert [f.text for f in report.findings if f.text not in page.words] == []
    assert page.tags.count("img") == 1


@pytest.mark.skipif(MPI.COMM_WORLD.size == 1, reason="with other ranks")
def test_other_ranks_are_not_waited_for():
    """A cell that runs on one of several ranks gets the text: nothing collective is begun."""
    body = make_body()
    problem = make_problem(body)
    if body.comm.rank == 0:
        assert body._repr_html_() is None
        assert problem._repr_html_() is None


def test_a_failed_cell_leaves_the_session_usable():
    """After an error of input, and a solution broken off at a step, the problem is as it was new.

    To round-off of Newton's method: the solution starts from where the first one ended.
    """
    body = make_body()
    problem = make_problem(body)
    with pytest.raises(MeshError, match="lft"):
        Problem(body, NeoHookean(E="1 MPa", nu=0.3), supports=[Support(on="lft")])
    with pytest.raises(ZeroDivisionError):
        for state in Statics(problem, steps=4).steps():
            _ = 1 / (state.step - 2)
    *_, again = Statics(problem, steps=2).steps()
    *_, fresh = Statics(make_problem(body), steps=2).steps()
    assert again.load_factor == fresh.load_factor == 1.0
    assert again.max_displacement == pytest.approx(fresh.max_displacement, rel=1e-7)
