"""What a check says of edges and points: sizes, forces, names, singular supports."""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.decks import box, inp_text, made, numbers

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.report import report
from dolfin_elastic.cli.console_check import show_check
from dolfin_elastic.core.errors import InputError

FREE = "free"


def case(**tables: Any) -> Case:
    """A block of 2 x 1 x 3 mm with an edge and two points, held at its bottom."""
    defaults: dict[str, Any] = {
        "mesh": {"box": {"size": [2, 1, 3], "cells": [2, 1, 3]}, "unit": "mm", "degree": 1},
        "edges": {"ridge": {"between": ["right", "top"]}},
        "points": {"tip": {"nearest": [2, 1, 3]}, "lid": {"of": "top"}},
        "materials": {"rubber": {"law": "linear-elastic", "E": 1e6, "nu": 0.3}},
        "support": [{"on": "bottom"}],
    }
    return Case(**{**defaults, **tables})


def test_sizes_and_forces() -> None:
    loads = [
        {"kind": "line-force", "on": "ridge", "value": [0, 0, "x"]},
        {"kind": "point-force", "on": "lid", "value": [1, 0, 0]},
        {"kind": "force", "on": ["tip", "lid"], "value": [0, "3 N", 0]},
    ]
    found = report(case(load=loads))
    (ridge,) = found.edges
    assert (ridge.name, ridge.count, ridge.use) == ("ridge", 1, "line-force")
    assert ridge.measure == pytest.approx(1e-3, rel=1e-12)
    np.testing.assert_allclose(ridge.centroid, [2e-3, 0.5e-3, 3e-3], rtol=1e-12)
    lid, tip = found.points
    assert (lid.name, lid.count, lid.use) == ("lid", 6, "point-force, force")
    assert (tip.name, tip.count, tip.use) == ("tip", 1, "force")
    forces = [load.force for load in found.loads]
    np.testing.assert_allclose(forces[0], [0, 0, 2e-6], rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(forces[1], [6, 0, 0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(forces[2], [0, 3, 0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.loads[0].moment, [1e-9, -4e-9, 0], rtol=1e-9, atol=1e-18)
    text = io.StringIO()
    with redirect_stdout(text):
        show_check(found)
    shown = [line.split() for line in text.getvalue().splitlines()]
    assert ["edge", "mesh", "edges", "[mm]", "centroid", "[mm]", "used", "by"] in shown
    assert any(row[:3] == ["ridge", "1", "1"] for row in shown)
    assert any(row[:2] == ["lid", "6"] for row in shown)


def test_supports_on_edges_and_points_are_singular_and_said_to_be() -> None:
    supports = [{"on": "bottom"}, {"on": ["ridge", "tip"], "displacement": [FREE, 0, FREE]}]
    notes = report(case(support=supports)).notes
    said = (
        "the edge 'ridge' (support[1]), the point 'tip' (support[1]) are fixed: the reaction there "
    )
    assert any(note.startswith(said) for note in notes)
    spring = [{"on": "bottom"}, {"on": "tip", "kind": "spring", "stiffness": [1, 1, 1]}]
    assert not any("singular" in note for note in report(case(support=spring)).notes)


def test_a_set_of_nodes_that_is_no_surface(folder: Path) -> None:
    """It can be held, and that is said; springs and tractions on it are refused with the key."""
    points, cells = box((4, 1, 1), (2, 1, 1))
    rows = np.flatnonzero((points[:, 0] == 0) | (points == [4, 0, 0]).all(axis=1))
    deck = inp_text(points, cells, f"*NSET, NSET=foot\n{numbers(rows)}\n")
    made(lambda: (folder / "part.inp").write_text(deck))

    def held(**keys: Any) -> Case:
        material = {"m": {"law": "linear-elastic", "E": 1e9, "nu": 0.3, "density": 1e3}}
        tables = {"mesh": {"file": "part.inp"}, "materials": material}
        support = {"support": [{"on": "Foot", **keys}], "load": [{"kind": "gravity"}]}
        return Case.from_dict({**tables, **support}, folder)

    notes = report(held()).notes
    assert any(note.startswith("the nodes 'Foot' (support[0]) are fixed: the") for note in notes)
    with pytest.raises(InputError, match=r"support\[0\]\.on: the set of nodes 'Foot' is no surf"):
        report(held(kind="spring", normal=1e9))


@pytest.mark.parametrize(
    ("tables", "says"),
    [
        (
            {"load": [{"kind": "traction", "on": "ridge", "value": [0, 0, 1]}]},
            "load[0].on: 'ridge' is an edge; a traction acts on surfaces; on an edge use kind = "
            '"line-force"',
        ),
        (
            {"load": [{"kind": "pressure", "on": "tip", "value": 1}]},
            "load[0].on: 'tip' is a point; a pressure acts on surfaces; on a point use kind = "
            '"point-force"',
        ),
        (
            {"load": [{"kind": "line-force", "on": "top", "value": [0, 0, 1]}]},
            "load[0].on: 'top' is a surface; a line-force acts on edges; on a surface use kind = "
            '"traction"',
        ),
        (
            {"support": [{"on": "ridge", "kind": "symmetry"}]},
            "support[0].on: 'ridge' is an edge; a symmetry holds surfaces",
        ),
        ({"support": [{"on": "rige"}]}, "support[0].on: there is no surface 'rige'; did you mean"),
        (  # a surface, edge or point of nearly this name would not be filled either
            {"materials": {"rubber": {"law": "linear-elastic", "E": 1, "nu": 0, "on": "ridges"}}},
            "materials.rubber.on: there is no region 'ridges'; the mesh has none",
        ),
        ({"edges": {"e": {"between": ["left", "tpo"]}}}, "edges.e: no surface 'tpo' in box"),
        ({"edges": {"e": {}}}, "edges.e: say where: between, line"),
        ({"points": {"e": {"at": 3}}}, "points.e: plane and at belong together"),
        ({"edges": {"e": {"near": 3}}}, "edges.e: unknown key 'near'"),
        (
            {
                "mesh": {"rectangle": {"size": [1, 1], "cells": [1, 1]}},
                "points": {},
                "edges": {"e": {"plane": "x", "at": 0}},
            },
            "edges.e: the edges of a plane body are its surfaces; select it in [surfaces]",
        ),
    ],
)
def test_what_is_refused(tables: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError) as caught:
        report(case(**tables))
    assert says in str(caught.value)


def test_the_tables_are_written_and_read_back() -> None:
    first = case()
    assert Case.from_dict(first.to_dict()) == first
    assert "[edges]" in first.to_toml()


@pytest.mark.parametrize(
    ("tables", "says"),
    [
        ({}, ()),
        (
            {"points": {"tip": {"nearest": [0.002, 0.001, 0.003]}}},
            ("points.tip.nearest: (0.002, 0.001, 0.003) mm is beside the origin: is it in m?",),
        ),
        (
            {"output": {"probes": {"mid": [0.001, 0, 0.0015]}}},
            ("output.probes.mid: (0.001, 0, 0.0015) mm is beside the origin: is it in m?",),
        ),
        (  # meant as they stand: with a unit, at a corner, or too far from it for metres
            {
                "points": {"a": {"nearest": ["0.002 mm", 0, 0]}, "b": {"nearest": [0, 0, 0]}},
                "output": {"probes": {"mid": [0.1, 0, 0]}},
            },
            (),
        ),
        (
            {"points": {"tip": {"nearest": [1, 0.4, 3]}}},
            ("points.tip: the nearest vertex is (1, 0, 3) mm, 0.4 mm from these coordinates",),
        ),
        ({"points": {"tip": {"nearest": [1, 0.4, 3], "tolerance": 0.5}}}, ()),
    ],
)
def test_places_that_mean_something_else(tables: dict[str, Any], says: tuple[str, ...]) -> None:
    """In metres they are read at the corner beside the origin, where the body is held."""
    push = {"kind": "traction", "on": "top", "value": [0, 0, 1]}
    notes = report(case(load=[push], **tables)).notes
    assert len(notes) == len(says)
    for note, start in zip(notes, says, strict=True):
        assert note.startswith(start)
