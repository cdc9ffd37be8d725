"""Gradients with contact against central differences of solutions, to what these leave."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers.barriers import usable_ipctk
from helpers.stacked import stacked
from mpi4py import MPI

from dolfin_elastic import Contact, Fixed, NeoHookean, Problem, Statics, Support, Traction
from dolfin_elastic.case.case import Case
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.nonlinear.adjoint import Adjoint
from dolfin_elastic.study.gradient.gradient import Asked, Gradients, gradient
from dolfin_elastic.study.gradient.spatial import nodes_moved

STEP = 1e-4
CLOSE = {"gap_tolerance": "1e-10 m"}
GEL = {"law": "neo-hookean", "E": "1 MPa", "nu": 0.3, "density": 1000}
ENDS = [{"on": "left"}, {"on": "right"}]
BLOCK = {"box": {"size": [2, 1, 1], "cells": [4, 2, 2]}}
SPHERE = {"center": [1, 0.5, 1.45], "radius": "0.45 m"}
PLATE = {"point": [0, 0, 1], "normal": [0, 0, -1]}
ROD = {"point": [1.2, 0, -0.6], "axis": [0, 1, 0], "radius": "0.5 m"}
PRESSED = [{"on": "top", "kind": "pressure", "value": "20 kPa"}]
DROPPED = {"on": "top", "plane": PLATE, "force": "30 kN", "direction": [0, 0, -1]}


def on_an_obstacle(degree: int, **more: Any) -> dict[str, Any]:
    return {
        "mesh": {**BLOCK, "degree": degree},
        "materials": {"gel": GEL},
        "statics": {"rtol": 1e-12},
        **more,
    }


def pressed_by_a_sphere(degree: int) -> dict[str, Any]:
    sphere = {"on": "top", "sphere": SPHERE, "motion": [0, 0, "-10 cm"], **CLOSE}
    return on_an_obstacle(degree, support=ENDS, contact=[sphere])


def on_a_rod(degree: int) -> dict[str, Any]:
    rod = {"on": "bottom", "cylinder": ROD, **CLOSE}
    return on_an_obstacle(degree, support=ENDS[:1], contact=[rod], load=PRESSED)


def on_a_floor(degree: int) -> dict[str, Any]:
    floor = {"on": "bottom", "plane": {"point": [0, 0, -0.01], "normal": [0, 0, 1]}, **CLOSE}
    sides = [{"on": "left", "displacement": [0, 0, "free"]}, ENDS[1]]
    return on_an_obstacle(degree, support=sides, contact=[floor], load=PRESSED)


def under_a_plate(degree: int) -> dict[str, Any]:
    held = [{"on": "bottom"}, {"on": "left", "displacement": [0, "free", "free"]}]
    return on_an_obstacle(degree, support=held, contact=[{**DROPPED, **CLOSE}])


FLOOR = ("mean displacement_z on top", "strain_energy")
CASES = {
    "sphere": (pressed_by_a_sphere, (*FLOOR, "reaction_z of left")),
    "rod": (on_a_rod, (*FLOOR, "mean von_mises on left")),
    "floor": (on_a_floor, FLOOR),
    "plate": (under_a_plate, (*FLOOR, "reaction_z of bottom")),
}
KEYS = {
    "sphere": ("materials.gel.nu", "contact[0].motion[2]", "contact[0].sphere.radius"),
    "rod": ("materials.gel.E", "load[0].value", "contact[0].cylinder.radius"),
    "floor": ("load[0].value",),
    "plate": ("materials.gel.nu", "contact[0].force"),
}


def compare(
    case: Case,
    of: tuple[str, ...],
    keys: tuple[str, ...],
    body: Any = None,
    step: float = STEP,
    rel: float = 1e-6,
) -> None:
    """Differences of fourth order, of solutions that are known to about 1e-10."""
    found = gradient(case, of, keys, body=body).gradients
    here = np.array([one.value for one in found])
    for number, key in enumerate(keys):
        at, unit = found[0].by[number].at, found[0].by[number].unit

        def values(k: int, key: str = key, at: float = at, unit: str = unit) -> np.ndarray:
            changed = case.changed({key: f"{at * (1 + k * step)!r} {unit}".strip()})
            return np.array([one.value for one in gradient(changed, of, body=body).gradients])

        slopes = (8 * (values(1) - values(-1)) - (values(2) - values(-2))) / (12 * step)
        told = np.array([one.by[number].at * one.by[number].value for one in found])
        error = np.abs(told - slopes)
        assert np.all(error <= rel * np.maximum(np.abs(slopes), 0.1 * np.abs(here))), key


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("name", CASES)
def test_obstacles(name: str, degree: int) -> None:
    """Curved ones have a stiffness by their curvature, and move; forces move a plate."""
    make, of = CASES[name]
    compare(Case.from_dict(make(degree)), of, KEYS[name])


FLAT = {"rectangle": {"size": [2, 1], "cells": [6, 3]}}
ROLLER = {"on": "top", "cylinder": {"axis": "z", "point": [1.1, 1.5], "radius": "0.5 m"}, **CLOSE}
PUSHED = {**ROLLER, "force": "40 kN", "direction": [0, -1]}


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
def test_an_obstacle_that_moves_more_than_the_body(degree: int) -> None:
    """Where it starts counts for nothing, for a force moves it: all of its way is a scalar."""
    contact = {**PUSHED, "name": "roller"}
    tables = on_an_obstacle(degree, support=[{"on": "bottom"}], contact=[contact])
    case = Case.from_dict({**tables, "mesh": {**FLAT, "degree": degree}})
    start, radius = "contact[0].cylinder.point[1]", "contact[0].cylinder.radius"
    compare(case, ("mean displacement_y on top", "strain_energy"), (start, radius), step=1e-5)


@pytest.mark.long
def test_vertices_about_to_open() -> None:
    """They stay in contact in differences, too: here one would open within their steps."""
    gel = {**GEL, "nu": 0.5}
    rolled = {**ROLLER, "motion": [0.02, -0.05]}
    tables = on_an_obstacle(1, support=[{"on": "bottom"}], contact=[rolled])
    mesh = {**FLAT, "degree": 1, "formulation": "mixed"}
    case = Case.from_dict({**tables, "mesh": mesh, "materials": {"gel": gel}})
    of = ("mean displacement_y on top", "reaction_x of bottom")
    compare(case, of, ("contact[0].cylinder.radius",), step=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
def test_reactions_where_supports_hold_what_presses(degree: int) -> None:
    """They have part of the pressures, which depend on materials, too."""
    corner = {**ROLLER["cylinder"], "point": [0.1, 1.5]}
    rolled = {**ROLLER, "cylinder": corner, "motion": [0, -0.08]}
    held = [{"on": "bottom"}, {"on": "left", "displacement": [0, "free"]}]
    tables = on_an_obstacle(degree, support=held, contact=[rolled])
    case = Case.from_dict({**tables, "mesh": {**FLAT, "degree": degree}})
    keys = "materials.gel.nu", "materials.gel.E", "contact[0].cylinder.radius"
    compare(case, ("reaction_x of left",), keys)


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
def test_rigid_surfaces_that_press(degree: int) -> None:
    """Pressures at a corner that contact and a rigid surface share are in its balance of forces."""
    corner = {**ROLLER["cylinder"], "point": [1.9, 1.5]}
    rolled = {**ROLLER, "cylinder": corner, "motion": [0, -0.06]}
    free = {"displacement": [0, "free"], "rotation": 0, "force": [0, "-5 kN"]}
    held = [{"on": "bottom"}, {"on": "right", "kind": "rigid", **free}]
    tables = on_an_obstacle(degree, support=held, contact=[rolled])
    case = Case.from_dict({**tables, "mesh": {**FLAT, "degree": degree}})
    of = "mean displacement_y on top", "reaction_x of bottom"
    compare(case, of, ("contact[0].cylinder.radius",))


SOFT, HARD = {**GEL, "E": "0.5 MPa", "on": "lower"}, {**GEL, "E": "2 MPa"}
ON_TOP = [{"on": "top", "displacement": [0, "free"]}]
TWO = {
    "mesh": {"rectangle": {"size": [1, 1], "cells": [2, 2]}, "degree": 1},
    "materials": {"lower": SOFT, "upper": HARD},
    "support": [{"on": "bottom"}, *ON_TOP],
    "load": [{"on": "top", "kind": "pressure", "value": "0.1 MPa"}],
    "contact": [{"between": ["above", "below"], **CLOSE}],
    "statics": {"rtol": 1e-12},
}
INSERTED = {
    "support": [{"on": "bottom"}, {"on": "top"}],
    "contact": [{"between": ["above", "below"], "interference": "2 cm", **CLOSE}],
    "load": [],
}
RIGID = {
    "support": [
        {"on": "bottom"},
        {
            "on": "top",
            "kind": "rigid",
            "displacement": [0, "free"],
            "rotation": 0,
            "force": [0, "-80 kN"],
        },
    ],
    "load": [],
}
BODIES: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    "pressed": ({}, ("materials.lower.E", "load[0].value")),
    "inserted": (INSERTED, ("materials.lower.nu", "contact[0].interference")),
    "rigid": (RIGID, ("materials.lower.E", "support[1].force[1]")),
    "quadratic": ({"mesh": {**TWO["mesh"], "degree": 2}}, ("materials.upper.nu",)),
}


@pytest.mark.long
@pytest.mark.parametrize(
    "name", ["pressed", *(pytest.param(one, marks=pytest.mark.long) for one in list(BODIES)[1:])]
)
def test_two_bodies(name: str) -> None:
    """Their faces are cut by each other anew where they move: the motion knows it."""
    more, keys = BODIES[name]
    body = stacked(size=(1.0, 0.6), lower=(4, 3), upper=(5, 3))
    of = ("mean displacement_x on above", "mean displacement_y on above", "strain_energy")
    compare(Case.from_dict({**TWO, **more}), of, keys, body)


IN_SPACE = {
    **TWO,
    "mesh": {"box": {"size": [1, 1, 1], "cells": [2, 2, 2]}, "degree": 1},
    "support": [{"on": "bottom"}, {"on": "top", "displacement": ["2 cm", 0, "-8 cm"]}],
    "load": [],
}


@pytest.mark.long
def test_two_bodies_in_space() -> None:
    """The same of faces that are triangles."""
    body = stacked(size=(1.0, 1.0, 0.8), lower=(2, 2, 1), upper=(3, 3, 1), shift=0.1, width=0.7)
    of = ("mean displacement_x on above", "reaction_z of bottom", "strain_energy")
    keys = ("materials.lower.E", "support[1].displacement[2]")
    compare(Case.from_dict(IN_SPACE), of, keys, body)


SKIN = {
    "support": [{"on": "bottom"}, {"on": "top", "displacement": [0, "-8 cm"]}],
    "contact": [{"all": True, "name": "skin"}],
    "load": [],
}


@pytest.mark.parametrize("degree", [1, pytest.param(2, marks=pytest.mark.long)])
def test_a_surface_that_touches_itself(degree: int) -> None:
    """Its tangent is not made semidefinite, and its barrier is as stiff as the softest material."""
    usable_ipctk()
    body = stacked(size=(1.0, 1.0), lower=(4, 3), upper=(5, 3), gap=0.02, shift=0.05, width=0.8)
    mesh = {"mesh": {**TWO["mesh"], "degree": degree}}
    of = ("strain_energy", "reaction_y of bottom", "mean von_mises on bottom")
    keys = ("materials.lower.E", "materials.upper.nu", "support[1].displacement[1]")
    case = Case.from_dict({**TWO, **mesh, **SKIN})
    compare(case, of, keys, body, rel=1e-8)
    with pytest.raises(InputError, match="by the shape"):
        gradient(case, of, offsets=["bottom"], body=body)


@pytest.mark.parametrize("make", [on_a_rod, under_a_plate])
def test_cells_beside_an_obstacle(make: Callable[[int], dict[str, Any]]) -> None:
    """Each by itself, and by its part in what is the stiffness of bulges: all are the constant."""
    key = "materials.gel.E"
    case = Case.from_dict(make(2))
    found = gradient(case, ["strain_energy"], [key], fields=[key]).gradients[0]
    whole = total(MPI.COMM_WORLD, float(found.cells[key].sum()))
    assert whole == pytest.approx(found.by[0].at * found.by[0].value, rel=1e-7)


MOST = {1: 8, 2: 6}
"""Solutions for eight digits.

Of linear faces the penalty is ten times as stiff as what presses, so each gains a digit, and more
as they are combined; of quadratic faces 300 times.  One is for the scalar unknown, and the last one
is exact where those before are as exact as they need be.
"""


@pytest.mark.parametrize("degree", [1, 2])
def test_an_adjoint_takes_a_few_solutions(degree: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """As many whatever the number of parameters."""
    counts, inverse = list[int](), Adjoint._inverse

    def counted(self: Adjoint, right: FloatArray) -> FloatArray:
        counts[-1] += 1
        return inverse(self, right)

    monkeypatch.setattr(Adjoint, "_inverse", counted)
    case = Case.from_dict(under_a_plate(degree))
    keys = "materials.gel.nu", "materials.gel.E", "contact[0].force"
    for some in (keys[:1], keys):
        counts.append(0)
        gradient(case, FLOOR[:1], some)
    assert 2 < counts[0] <= MOST[degree]
    assert counts[0] == counts[1]
    counts.append(0)  # nothing presses: one without contact
    above = [{"on": "top", "plane": {**PLATE, "point": [0, 0, 1.1]}}]
    loads = [{"on": "right", "kind": "traction", "value": [0, 0, -100]}]
    gradient(Case.from_dict({**case.written, "contact": above, "load": loads}), FLOOR[:1], keys[:2])
    assert counts[2] == 1


def test_what_has_no_adjoint() -> None:
    """The shape beside an obstacle, a plate that no force presses, and what depends on the way."""
    body = stacked(size=(1.0, 0.6), lower=(4, 3), upper=(5, 3))
    with pytest.raises(InputError, match="no gradient by the shape with contact of 'bottom'"):
        gradient(Case.from_dict(on_a_rod(2)), ["strain_energy"], offsets=["bottom"])
    with pytest.raises(InputError, match="by 'contact.0..friction': friction depends on all"):
        gradient(Case.from_dict(on_a_rod(1)), ["strain_energy"], ["contact[0].friction"])
    lifted = {**DROPPED, **CLOSE, "curve": [[0, 0], [0.5, 1], [1, 0]]}
    plate = {**under_a_plate(1), "contact": [lifted], "statics": {"rtol": 1e-12, "steps": 2}}
    with pytest.raises(InputError, match="what a force moves presses on nothing here"):
        gradient(Case.from_dict(plate), ["strain_energy"], ["materials.gel.E"])
    rubbing = {**TWO, "contact": [{"between": ["above", "below"], "friction": 0.3}]}
    with pytest.raises(InputError, match="with friction, which depends on all steps before"):
        gradient(Case.from_dict(rubbing), ["strain_energy"], ["materials.lower.E"], body=body)


@pytest.mark.parametrize(
    ("more", "degree"),
    [({}, 1), *(pytest.param(*one, marks=pytest.mark.long) for one in [({}, 2), (INSERTED, 2)])],
)
def test_the_shape_of_two_bodies(more: dict[str, Any], degree: int) -> None:
    """Gaps, the cut and reference areas change, and gaps at the start that count as none."""
    of = ("mean displacement_y on above", "strain_energy")
    case = Case.from_dict({**TWO, **more, "mesh": {**TWO["mesh"], "degree": degree}})
    # No ends of both sides coincide at the start, where their cut has a kink.
    mesh = {"size": (1.0, 0.6), "lower": (4, 3), "upper": (5, 3), "shift": 0.04, "width": 0.9}
    compare_shapes(case, of, ("left", "below"), mesh)


@pytest.mark.long
def test_the_shape_of_two_bodies_in_space() -> None:
    """The same of faces that are triangles."""
    mesh = {"size": (1.0, 1.0, 0.8), "lower": (2, 2, 1), "upper": (3, 3, 1)}
    mesh |= {"shift": 0.1, "width": 0.7}
    compare_shapes(
        Case.from_dict(IN_SPACE), ("reaction_z of bottom", "strain_energy"), ("above",), mesh
    )


def compare_shapes(
    case: Case, of: tuple[str, ...], offsets: tuple[str, ...], mesh: dict[str, Any]
) -> None:
    """See `compare`: surfaces of two bodies move along their normals."""
    found = gradient(case, of, offsets=offsets, body=stacked(**mesh)).gradients

    def values(surface: str, distance: float) -> np.ndarray:
        body = stacked(**mesh)
        body.mesh.geometry.x[:, : body.dim] += distance * nodes_moved(body, surface)
        return np.array([one.value for one in gradient(case, of, body=body).gradients])

    slopes = []
    for surface in offsets:
        first, second = (values(surface, k * STEP) - values(surface, -k * STEP) for k in (1, 2))
        slopes.append((8 * first - second) / (12 * STEP))
    told = np.array([[slope.value for slope in one.by] for one in found]).T
    here = np.array([one.value for one in found])
    error = np.abs(told - slopes)
    assert np.all(error <= 1e-6 * np.maximum(np.abs(slopes), 0.1 * np.abs(here)))


def test_a_cell_of_two_bodies() -> None:
    """A constant in one cell: the law has an array of values in its place."""
    of, where, found = "strain_energy", 3, []
    body = stacked(size=(1.0, 0.6), lower=(4, 3), upper=(5, 3))
    for factor in (1.0, 1 + STEP, 1 - STEP):
        values = np.full(len(body.owned_cells()), 1e6)
        if MPI.COMM_WORLD.rank == 0:
            values[where] *= factor
        problem = Problem(
            body,
            NeoHookean(E=values, nu=0.3),
            supports=[Fixed(on="bottom"), Support(on="top", displacement=[0, "free"])],
            loads=[Traction(on="top", value=[0.0, -1e5])],
            contacts=[Contact(between=["above", "below"], gap_tolerance=1e-10)],
            degree=1,
        )
        solver = Statics(problem, rtol=1e-12)
        every = Gradients(Asked([of], fields=["materials.body.E"] if not found else []), problem)

        def look(newton: Any, state: Any, every: Gradients = every) -> None:
            if state.done >= 1.0:
                found.extend(every.at(newton, state))

        solver.observer = look
        for _ in solver.steps():
            pass
    here, first, last = found
    told = MPI.COMM_WORLD.bcast(here.cells["materials.body.E"][where] if here.cells else None)
    assert told == pytest.approx((first.value - last.value) / (2 * STEP), rel=1e-6)
