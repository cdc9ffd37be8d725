"""Scenes in which contact may go wrong in silence: they converge, or end with their cause.

No accepted state has an edge or vertex deep in a face: `penetration_NAME` is that of the deepest of
all points, and a state that hides more than a quarter of a face is refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers.barriers import usable_ipctk
from helpers.scenes import Box, boxes
from helpers.stacked import grid
from mpi4py import MPI

from dolfin_elastic import (
    Contact,
    Dynamics,
    Fixed,
    Gravity,
    NeoHookean,
    Problem,
    SelfContact,
    Statics,
    Support,
    Traction,
)
from dolfin_elastic.core.errors import ElasticError
from dolfin_elastic.mesh import Body
from dolfin_elastic.mesh.distribute import make_mesh
from dolfin_elastic.mesh.geometry.simplices import boundary_facets, facet_corners
from dolfin_elastic.problem.terms.contact.depths import UNSEEN

FREE, G = "free", 9.81
FLOOR = {"axis": "y", "at": 0}


def rubber(E: float = 1e6, nu: float = 0.3) -> NeoHookean:
    return NeoHookean(E=E, nu=nu, density=1000.0)


def ball(n: int) -> Body:
    """Half a disc of radius 1 beside the axis, with surfaces "axis" and "skin"."""
    above, up = grid((1.0, 1.0), (n, n))  # no element has both its outer edges on the circle
    below = above * [1, -1]
    x, rows = np.unique(np.vstack([below, above]).round(12), axis=0, return_inverse=True)
    cells = rows.reshape(-1)[np.vstack([up, up + len(above)])]
    a, b = x[:, 0], x[:, 1]
    x = np.c_[a * np.sqrt(1 - b**2 / 2), b * np.sqrt(1 - a**2 / 2)]
    if MPI.COMM_WORLD.rank:
        x, cells = x[:0], cells[:0]
    body = Body(make_mesh(MPI.COMM_WORLD, cells.astype(np.int64), x, 1))
    facets = boundary_facets(body.mesh)
    outside = facet_corners(body.mesh, facets)[:, :, 0].mean(axis=1) > 1e-9
    return body.named(surfaces={"axis": facets[~outside], "skin": facets[outside]})


def through_a_hole(n: int, degree: int, jaw: dict[str, Any], **keys: Any) -> Problem:
    """A ball, held on its axis, and a ring with 60 % of its diameter that is drawn over it."""
    return Problem(
        ball(n),
        rubber(1e5),
        supports=[Support(on="axis", displacement=[0, 0])],
        contacts=[Contact(on="skin", name="c", motion=[0, "2.8*t"], **jaw, **keys)],
        geometry="axisymmetric" if "box" in jaw else "plane-strain",
        degree=degree,
    )


SHARP = {"box": {"center": [1.6, -1.4], "size": [2.0, 0.4]}}
ROUND = {"sphere": {"center": [1.0, -1.4], "radius": 0.4}}
"""Axisymmetric bodies meet no ring that is round: between two bars."""


def in_a_funnel(n: int, degree: int, *, lid: bool) -> Problem:
    """A ball whose equator is pressed to 60 % of its diameter by a cone that is drawn over it."""
    a = np.radians(15)
    tip, way = -1 / np.sin(a), 1 / np.sin(a) - 0.6 / np.tan(a)
    cone = {"tip": [0, tip], "axis": "y", "half_angle": 15, "inside": True}
    contacts = [Contact(on="skin", name="c", motion=[0, f"{way}*t"], cone=cone)]
    if lid:
        contacts.append(Contact(on="skin", name="lid", plane={"axis": "-y", "at": 1}))
    return Problem(
        ball(n),
        rubber(1e5, 0.4),
        supports=[Support(on="axis", displacement=[0, FREE if lid else 0])],
        contacts=contacts,
        geometry="axisymmetric",
        degree=degree,
    )


def block(n: int = 4, degree: int = 1, on: str = "a_bottom", **keys: Any) -> Problem:
    supports = keys.pop("supports", [Fixed(on="a_top")])
    contacts = [Contact(on=on, name="c", **keys.pop("contact"))]
    body = boxes(a=Box(keys.pop("at", (0, 0)), (1, 1), (n, n)))
    return Problem(body, rubber(), supports=supports, contacts=contacts, degree=degree, **keys)


def pair(lo: Box, up: Box, *, degree: int = 1, friction: float = 0.0, **keys: Any) -> Problem:
    names = keys.pop("between", ["lo_top", "up_bottom"])
    press = keys.pop("press", [0, -0.2])
    return Problem(
        boxes(lo=lo, up=up),
        rubber(),
        supports=[
            Fixed(on="lo_bottom"),
            Support(on="up_top", displacement=press),
        ],
        contacts=[Contact(between=names, friction=friction, name="c", **keys)],
        degree=degree,
    )


def tip(x: np.ndarray) -> np.ndarray:
    """A block whose lower half tapers to a point."""
    x = x.copy()
    x[:, 0] = 1 + (x[:, 0] - 1) * np.minimum(1, 0.02 + 1.6 * (x[:, 1] - 1))
    return x


def needle(x: np.ndarray) -> np.ndarray:
    """A rhombus that stands on its sharp corner, between two nodes of what is below."""
    a, b = x[:, 0], x[:, 1]
    return np.c_[1.1 + (a - b) * np.sin(0.3), 1 + (a + b) * np.cos(0.3)]


def still(problem: Problem, steps: int = 10, **keys: Any) -> Statics:
    return Statics(problem, steps=steps, **keys)


def moving(problem: Problem, end: float = 0.05, dt: float = 2.5e-3, **keys: Any) -> Dynamics:
    return Dynamics(problem, end=end, dt=dt, **keys)


LOWER = Box((0, 0), (2, 1), (8, 4))


SCENES: dict[str, tuple[Callable[[], Statics | Dynamics], str]] = {
    "a ball through a sharp hole": (
        lambda: still(through_a_hole(8, 1, SHARP), 20),
        r"the obstacle lies .* deep in 'c', between the vertices of a face",
    ),
    "a ball through a sharp hole, quadratic": (
        lambda: still(through_a_hole(6, 2, SHARP), 20),
        r"the obstacle lies .* deep in 'c'",
    ),
    "a ball through a round hole": (lambda: still(through_a_hole(8, 1, ROUND), 20), ""),
    "a ball through a round hole, quadratic": (
        lambda: still(through_a_hole(6, 2, ROUND), 20),
        "",
    ),
    "a ball through a round hole with friction": (
        lambda: still(through_a_hole(8, 1, ROUND, friction=0.1), 20),
        "",
    ),
    "a ball through a round hole in motion": (
        lambda: Dynamics(through_a_hole(8, 1, ROUND), end=1.0, dt=0.02, scheme="implicit-euler"),
        "",
    ),
    "a ball through a sharp hole in motion": (
        lambda: Dynamics(through_a_hole(8, 1, SHARP), end=1.0, dt=0.02, scheme="implicit-euler"),
        r"the obstacle lies .* deep in 'c'",
    ),
    "a ball in a funnel under a lid": (lambda: still(in_a_funnel(6, 1, lid=True), 20), ""),
    "a ball in a funnel, quadratic": (lambda: still(in_a_funnel(6, 2, lid=False), 20), ""),
    "a blade in a face": (
        lambda: still(
            block(
                contact={
                    "box": {"center": [0.6, -0.5], "size": [0.02, 1.0]},
                    "motion": [0, "0.4*t"],
                }
            )
        ),
        r"the obstacle lies .* deep in 'c'",
    ),
    "a wedge in a face": (
        lambda: still(
            block(
                contact={
                    "cone": {"tip": [0.6, 0], "axis": "-y", "half_angle": 30},
                    "motion": [0, "0.4*t"],
                },
                degree=2,
            )
        ),
        r"the obstacle lies .* deep in 'c'",
    ),
    "a block slides off an edge": (
        lambda: still(
            block(
                contact={"box": {"center": [-0.5, -0.45], "size": [2.0, 1.0]}, "friction": 0.2},
                supports=[Support(on="a_top", displacement=["1.6*t", 0])],
            ),
            20,
        ),
        "",
    ),
    "a block on a corner of a box in motion": (
        lambda: moving(
            block(
                contact={"box": {"center": [0.25, -0.55], "size": [0.5, 1.0], "x": [1, 0.2]}},
                supports=[],
                loads=[Gravity(value=[0, -G])],
                degree=2,
            ),
            0.2,
            5e-3,
        ),
        r"the obstacle lies .* deep in 'c'",
    ),
    "a tip on a body": (
        lambda: still(pair(LOWER, Box((0.5, 1), (1, 1), (4, 4), tip))),
        "",
    ),
    "a needle in a body": (
        lambda: still(
            pair(
                LOWER,
                Box((0, 0), (1, 1), (3, 3), needle),
                between=["lo_top", ["up_left", "up_bottom"]],
            )
        ),
        r"a vertex of the other side lies .* deep in 'c', between the vertices of a face",
    ),
    "a small block in a large face": (
        lambda: still(
            pair(
                Box((0, 0), (2, 1), (2, 2)),
                Box((0.9, 1), (0.2, 0.5), (2, 3)),
                press=[0, -0.1],
            )
        ),
        "",
    ),
    "bodies slide off each other": (
        lambda: still(pair(LOWER, Box((0.5, 1), (1, 0.5), (5, 3)), press=["2*t", "-0.05"]), 20),
        "",
    ),
    "a corner drags over a body with friction": (
        lambda: still(
            pair(LOWER, Box((0.5, 1), (0.5, 0.5), (3, 3)), press=["0.6*t", "-0.1"], friction=0.4),
            20,
        ),
        "",
    ),
    "a lid snaps into a gap": (
        lambda: still(
            Problem(
                boxes(
                    lo=Box((0, 0), (1, 1), (4, 4)),
                    up=Box(
                        (0.05, 1.3),
                        (2.4, 0.1),
                        (24, 1),
                        lambda x: np.c_[
                            x[:, 0], x[:, 1] + 0.15 * np.sin(np.pi * (x[:, 0] - 0.05) / 2.4)
                        ],
                    ),
                ),
                rubber(),
                supports=[Fixed(on="lo_bottom"), Fixed(on="up_left"), Fixed(on="up_right")],
                loads=[Traction(on="up_top", value=[0, -3e4])],
                contacts=[Contact(between=["lo_top", "up_bottom"], name="c")],
                degree=1,
            )
        ),
        "",
    ),
    "five blocks of unlike meshes in motion": (
        lambda: moving(
            Problem(
                boxes(
                    **{f"b{i}": Box((0.07 * (i % 2), i), (1, 1), (2 + i % 3, 2)) for i in range(5)}
                ),
                rubber(1e7),
                supports=[Fixed(on="b0_bottom")],
                loads=[Gravity(value=[0, -G])],
                contacts=[
                    Contact(between=[f"b{i}_top", f"b{i + 1}_bottom"], name=f"c{i}", friction=0.4)
                    for i in range(4)
                ],
                degree=1,
            ),
            0.05,
            5e-3,
        ),
        "",
    ),
    "a strip folds onto itself": (
        lambda: moving(
            Problem(
                boxes(
                    a=Box(
                        (0, 0),
                        (1, 0.05),
                        (20, 1),
                        lambda x: np.c_[
                            0.2 * np.sin(np.pi * x[:, 0]) * (1 + x[:, 1]),
                            0.2 * np.cos(np.pi * x[:, 0]) * (1 + x[:, 1]),
                        ],
                    )
                ),
                rubber(),
                supports=[
                    Fixed(on="a_right"),
                    Support(on="a_left", displacement=[0, "-0.6*(t/0.4)^2"]),
                ],
                contacts=[SelfContact(all=True, name="c")],
                degree=1,
            ),
            0.3,
            1e-2,
        ),
        "",
    ),
    "a hard hit on a corner": (
        lambda: moving(
            block(
                at=(0, 0.01),
                supports=[],
                contact={"box": {"center": [1.15, -0.5], "size": [1, 1]}},
            ),
            0.03,
            1e-3,
            initial_velocity=["0", "-20"],
        ),
        r"the obstacle lies .* deep in 'c'",
    ),
}


SLOW = {
    "a ball through a round hole",
    "a ball through a round hole, quadratic",
    "a ball through a round hole with friction",
    "a block on a corner of a box in motion",
    "a corner drags over a body with friction",
    "a lid snaps into a gap",
    "a small block in a large face",
    "a tip on a body",
    "a strip folds onto itself",
    "five blocks of unlike meshes in motion",
}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.long) if n in SLOW else n for n in SCENES]
)
def test_what_is_accepted_is_not_entered(name: str) -> None:
    """It ends as it says, and the column tells the deepest point of every state before."""
    make, cause = SCENES[name]
    if name == "a strip folds onto itself":
        usable_ipctk()
    ended = ""
    try:
        run = make()
        for state in run.steps():
            for one in run.problem.contact_pairs:
                found = one.deepest()
                assert found.unseen <= UNSEEN
                assert state.numbers[f"penetration_{one.label}"] >= found.depth
    except ElasticError as error:
        ended = str(error)
    assert re.search(cause, ended) if cause else not ended, ended
