"""Bare numbers of positions are in the unit of the mesh, and with a unit they are what they say."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.report import report
from dolfin_elastic.case.described import described_problem
from dolfin_elastic.case.glyphs import glyphs_of

Writing = Callable[..., list[float | str]]

SIDES = ["left", "right", "front", "back"]
TABLES: dict[str, Callable[[Writing], dict[str, Any]]] = {
    # A point in a cell and a line of which a part of 1 mm lies beside the body.
    "points": lambda at: {
        "support": [{"on": "left"}],
        "load": [
            {"kind": "point-force", "at": at(13, 4, 7), "value": [3, 0, -5]},
            {
                "kind": "line-force",
                "start": at(2, 5, 10),
                "end": at(21, 5, 10),
                "tolerance": at(1.5)[0],
                "value": [0, 90, 0],
            },
        ],
    },
    "remote": lambda at: {
        "support": [{"on": "left"}],
        "load": [
            {"kind": "remote-force", "on": "top", "point": at(30, 0, 25), "force": [1, 4, 2]},
            {
                "kind": "remote-force",
                "on": "right",
                "coupling": "rigid",
                "point": at(60, 20, 5),
                "force": [2, 0, 3],
            },
        ],
    },
    "turned": lambda at: {
        "support": [
            {"on": "left", "kind": "rotation", "point": at(0, 3, 9), "axis": "x", "angle": 0.1},
            {"on": "right", "kind": "rigid", "point": at(25, 1, 2), "rotation": [0, 0.1, 0]},
        ],
        "load": [{"kind": "centrifugal", "value": "9000 rpm", "axis": "x", "point": at(0, 30, 7)}],
    },
    # The volume is that of a cone with its tip at the origin.
    "cavity": lambda at: {
        "support": [{"on": SIDES}],
        "load": [{"kind": "cavity", "on": "bottom", "origin": at(9, 4, -2), "volume_ratio": 1.05}],
    },
}


def read(name: str, scale: float, write: Callable[[float], float | str]) -> Case:
    """A case on a body of 20 x 10 x 10 mm.

    Args:
        name: Of its supports and loads.
        scale: Metres per unit of length of the mesh.
        write: Writes a coordinate, given in mm.
    """
    size = [x * 1e-3 / scale for x in (20, 10, 10)]
    return Case.from_dict(
        {
            "mesh": {
                "box": {"size": size, "cells": [4, 2, 2]},
                "unit": "mm" if scale == 1e-3 else "m",
                "degree": 1,
            },
            "materials": {"body": {"law": "neo-hookean", "E": 1e6, "nu": 0.3, "density": 1000}},
            "statics": {},
            **TABLES[name](lambda *x: [write(one) for one in x]),
        }
    )


def found(case: Case) -> tuple[list[str], list[np.ndarray]]:
    """What supports and loads say; displacement in the end [m], resultants, drawn places [m]."""
    body = case.read_body()
    problem = case.make_problem(body)
    *_, state = case.make_solver(problem).steps()
    told = report(case)
    texts = [row.text for row in told.described]
    assert {*texts} <= {row.text for row in described_problem(problem)}  # and a rigid plate
    sums = [[*row.force, *row.moment] for row in told.loads if row.force and row.moment]
    drawn = [glyphs.places for glyphs in glyphs_of(case, body, told.loads)]
    own = state.u.function_space.dofmap.index_map.size_local * 3
    numbers = [state.u.x.array[:own].copy(), np.array(sums), np.concatenate(drawn)]
    return texts, numbers


@pytest.mark.parametrize("name", TABLES)
def test_a_body_in_mm_and_in_m_moves_alike(name: str) -> None:
    """To the tolerance of the solver; and with the same text for each support and load."""
    texts, wanted = found(read(name, 1.0, lambda x: 1e-3 * x))
    for scale, write in ((1e-3, float), (1e-3, "{} mm".format), (1.0, "{} mm".format)):
        same, numbers = found(read(name, scale, write))
        assert same == texts
        for value, reference in zip(numbers, wanted, strict=True):
            size = np.abs(reference).max(initial=0.0)
            np.testing.assert_allclose(value, reference, rtol=0, atol=1e-9 * size)
