"""Singular places: exponents of wedges, and which edges of bodies have them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.ranks import SIZES, on_ranks
from mpi4py import MPI
from scipy.optimize import brentq

from dolfin_elastic import (
    Contact,
    LinearElastic,
    PointForce,
    Problem,
    Selector,
    Spring,
    Statics,
    Support,
    Traction,
    box_body,
    name_parts,
    rectangle_body,
)
from dolfin_elastic.mesh.selectors import PointSelector
from dolfin_elastic.results.recovery.error import ErrorEstimator
from dolfin_elastic.results.recovery.peaks import Peaks, find_peaks
from dolfin_elastic.results.recovery.singular import singular_places
from dolfin_elastic.results.recovery.wedge import Wedge, stress_exponent

FREE = "free"
RIGHT_ANGLE = np.pi / 2


def wedge(degrees: float, mu: float = 1.0, nu: float = 0.3) -> Wedge:
    """In plane strain."""
    return Wedge(np.deg2rad(degrees), mu, 3 - 4 * nu)


@pytest.mark.parametrize(
    ("opening", "face", "exact"),
    [
        (360, "free", 0.5),
        (270, "free", 0.544484),
        (225, "free", 0.673583),
        (360, "held", 0.5),
        (180, "free", 1.0),
        (90, "free", 1.0),
        (180, "roller", 1.0),
        (270, "roller", 1 / 3),
    ],
)
def test_one_material(opening: float, face: Any, exact: float) -> None:
    """sin(lambda beta) = -lambda sin(beta) of a free notch: Williams (1952), table 1; held along
    its normal beyond half a plane, lambda = 1 - pi/beta, that of its mirror image."""
    half = wedge(opening / 2)
    assert stress_exponent(half, half, face) == pytest.approx(exact, abs=2e-3)


def bogy(ratio: float, nu: tuple[float, float]) -> float:
    """The exponent of two quarter planes: D. B. Bogy, J. Appl. Mech. 35 (1968) 460, (31)."""
    k1, k2 = (3 - 4 * n for n in nu)
    sums = (k2 + 1) * ratio + (k1 + 1)
    a = ((k2 + 1) * ratio - (k1 + 1)) / sums
    b = ((k2 - 1) * ratio - (k1 - 1)) / sums

    def condition(power: float) -> float:
        c = np.sin(np.pi * power / 2) ** 2 - power**2
        whole = c**2 * b**2 + 2 * power**2 * c * a * b + power**2 * (power**2 - 1) * a**2
        return float(whole + np.sin(np.pi * power) ** 2 / 4)

    return brentq(condition, 0.3, 0.999) if a * (a - 2 * b) > 0 else 1.0


@pytest.mark.parametrize(
    ("ratio", "nu"), [(10, (0.3, 0.3)), (3, (0.3, 0.33)), (100, (0.3, 0.45)), (1.2, (0.2, 0.45))]
)
def test_two_quarter_planes(ratio: float, nu: tuple[float, float]) -> None:
    """Singular where alpha (alpha - 2 beta) > 0, of Dundurs' constants; not in the last case."""
    exact = bogy(ratio, nu)
    found = stress_exponent(wedge(90, ratio, nu[0]), wedge(90, 1.0, nu[1]))
    assert found == pytest.approx(exact, abs=2e-3)


def test_inside_the_body() -> None:
    """A flat interface has no singularity, the corner of an inclusion has one."""
    assert stress_exponent(wedge(180, 5.0), wedge(180), None) == 1.0
    assert 0.7 < stress_exponent(wedge(90), wedge(270, 5.0), None) < 0.8
    assert 0.8 < stress_exponent(wedge(90, 5.0), wedge(270), None) < 0.9
    assert stress_exponent(wedge(90), wedge(270), None) == 1.0


# --- bodies ---


def peaks_of(problem: Problem) -> Peaks:
    *_, state = Statics(problem).steps()
    return find_peaks(problem, ErrorEstimator(problem)(state))


def bar(moduli: tuple[float, float], comm: MPI.Comm = MPI.COMM_WORLD, **more: Any) -> Problem:
    """Pulled across the interface of two materials; both ends may become thinner."""
    body = rectangle_body(comm=comm, size=(4.0, 1.0), cells=(16, 4))
    halves = {"soft": Selector(box=[[0, 0], [2, 1]]), "hard": Selector(box=[[2, 0], [4, 1]])}
    laws = {
        name: LinearElastic(E=E, nu=0.3, allowable=limit)
        for name, E, limit in zip(halves, moduli, (1.0, 5.0), strict=True)
    }
    return Problem(
        name_parts(body, regions=halves),
        laws,
        degree=2,
        supports=[
            Support(on="left", displacement=[0, FREE]),
            Support(on="bottom", displacement=[FREE, 0]),
        ],
        loads=[Traction(on="right", value=[1.0, 0.0])],
        **more,
    )


def test_an_interface_that_ends_at_a_free_surface() -> None:
    """And the safety factor there is told with the smallest elsewhere, which is the bar's own.

    In plane strain the bar's von Mises stress is sqrt(1 - nu + nu^2) times the traction.
    """
    peaks = peaks_of(bar((1e3, 1e4)))
    assert peaks.largest.singular == "an edge where materials meet"
    assert peaks.largest.place == pytest.approx((2, 1))
    assert peaks.safety is not None
    assert peaks.safety.singular == "an edge where materials meet"
    assert peaks.safety.part == "soft"
    assert peaks.safety_elsewhere is not None
    assert peaks.safety.value < peaks.safety_elsewhere.value
    assert peaks.safety_elsewhere.value == pytest.approx(1 / np.sqrt(0.79), rel=0.06)
    lines = peaks.lines(0.1)
    assert lines[-3].endswith("falls with every refinement")
    assert lines[-2].startswith("  smallest elsewhere      1.")


def test_one_material_under_two_names() -> None:
    peaks = peaks_of(bar((1e3, 1e3)))
    assert peaks.largest.singular == ""
    assert peaks.safety is not None
    assert (peaks.safety.singular, peaks.safety_elsewhere) == ("", None)


@pytest.mark.parametrize(("slope", "singular"), [(0.0, False), (0.1, False), (0.6, True)])
def test_an_interface_that_ends_at_a_plane_of_symmetry(slope: float, singular: bool) -> None:
    """With its mirror image it is bent by 0, 11 and 62 degrees; a round one's elements are, too."""
    problem = bar((1e3, 1e4))
    x = problem.body.mesh.geometry.x
    x[:, 0] += slope * x[:, 1] * (1 - np.abs(x[:, 0] - 2) / 2)
    places = singular_places(problem)
    near = places.near[:, places.reasons.index("an edge where materials meet")]
    y = problem.V.tabulate_dof_coordinates()[: len(near), 1][near]
    assert problem.body.comm.allreduce(bool((y < 0.1).any()), op=MPI.LOR) == singular


def interface_on(comm: MPI.Comm) -> Any:
    problem = bar((1e3, 1e4), comm)
    places = singular_places(problem)
    x = problem.V.tabulate_dof_coordinates()[: len(places.near), :2]
    near = x[places.near[:, places.reasons.index("an edge where materials meet")]]
    found = np.concatenate(comm.allgather(near))
    return [len(found), *found.min(axis=0), *found.max(axis=0)]


def test_the_same_on_any_ranks() -> None:
    found = [on_ranks(count, interface_on) for count in SIZES]
    assert found[0] == pytest.approx([found[0][0], 1.75, 0.75, 2.25, 1.0])
    for other in found[1:]:
        assert other == pytest.approx(found[0])


def stack_on(comm: MPI.Comm) -> Any:
    """Two materials one on the other, held below: singular nodes, and what they span."""
    body = name_parts(
        box_body(comm=comm, size=(1.0, 1.0, 1.0), cells=(4, 4, 4)),
        regions={
            "low": Selector(box=[[0, 0, 0], [1, 1, 0.5]]),
            "high": Selector(box=[[0, 0, 0.5], [1, 1, 1]]),
        },
    )
    laws = {name: LinearElastic(E=E, nu=0.3) for name, E in (("low", 1e3), ("high", 1e4))}
    problem = Problem(body, laws, degree=2, supports=[Support(on="bottom")])
    places = singular_places(problem)
    x = problem.places[: len(places.near)]
    found = []
    for reason in ("an edge where materials meet", "the edge of the support 'bottom'"):
        near = np.concatenate(comm.allgather(x[places.near[:, places.reasons.index(reason)]]))
        found += [len(near), *near.min(axis=0), *near.max(axis=0), *np.abs(near - 0.5).sum(axis=0)]
    return found


def test_edges_in_space_the_same_on_any_ranks() -> None:
    """Those of the interface and of the support, along the four sides of the block: nodes of the
    cells that touch them, of one layer below and one above, or of one above."""
    found = [on_ranks(count, stack_on) for count in SIZES]
    assert found[0][1:7] == pytest.approx([0, 0, 0.25, 1, 1, 0.75])
    assert found[0][11:17] == pytest.approx([0, 0, 0, 1, 1, 0.25])
    for other in found[1:]:
        assert other == pytest.approx(found[0])


def pulled_at_a_vertex(comm: MPI.Comm) -> Any:
    """A force at the corner of a block, a vertex of several cells: nodes near it."""
    body = box_body(comm=comm, size=(0.01, 0.002, 0.002), cells=(6, 2, 2))
    force = PointForce(at=[0.01, 0.002, 0.002], value=[0, 0, 4])
    problem = Problem(body, LinearElastic(E=1e3, nu=0.3), degree=1, loads=[force])
    problem.set_time(1.0)
    places = singular_places(problem)
    near = places.near[:, places.reasons.index("a force at a point or along a line")]
    x = np.concatenate(comm.allgather(problem.places[: len(near)][near]))
    return [len(x), *x.min(axis=0)]


def test_a_force_at_a_vertex_does_not_reach_its_cells_other_nodes() -> None:
    """But for round-off: singular are the nodes of the cells at this vertex, on any ranks."""
    for count in SIZES:
        _, *low = on_ranks(count, pulled_at_a_vertex)
        assert low == pytest.approx([0.05 / 6, 0.001, 0.001])


def block(**more: Any) -> Problem:
    """A square, the left half of its top named."""
    body = name_parts(
        rectangle_body(size=(1.0, 1.0), cells=(8, 8)),
        surfaces={"half": Selector(plane="y", at="max", box=((0, 0), (0.5, 1)))},
        points={"corner": PointSelector(nearest=(0, 0))},
    )
    law = LinearElastic(E=1e3, nu=0.0)
    return Problem(body, law, degree=2, **more)


ROLLERS = [
    Support(on="left", displacement=[0, FREE]),
    Support(on="bottom", displacement=[FREE, 0]),
]


@pytest.mark.parametrize(("stiffness", "singular"), [(1e6, True), (1.0, False)])
def test_the_end_of_a_bed_of_springs(stiffness: float, singular: bool) -> None:
    """As stiff as a support on this mesh, or a bed that gives way with a traction that jumps."""
    bed = Spring(on="half", normal=stiffness, tangential=stiffness)
    places = singular_places(block(supports=[bed]))
    near = places.near[:, places.reasons.index("the edge of the support 'half'")]
    assert bool(MPI.COMM_WORLD.allreduce(int(near.sum()))) is singular


def test_springs_of_a_whole_surface_and_at_a_point() -> None:
    """Their total over the area; and a spring at a point is a force at a point."""
    bed = Spring(on="half", normal=1e6, tangential=1e6, total=True)
    pin = Spring(on="corner", stiffness=[1.0, 1.0])
    places = singular_places(block(supports=[bed, pin]))
    rims = [
        places.reasons.index(f"the edge of the support '{name}'") for name in ("half", "corner")
    ]
    found = MPI.COMM_WORLD.allreduce(places.near[:, rims].sum(axis=0))
    assert found.min() > 0


@pytest.mark.parametrize(("on", "reason"), [("half", "the edge of the contact"), ("top", "")])
def test_the_edge_of_a_punch(on: str, reason: str) -> None:
    """A plane that presses a part of a flat face ends like a punch: r^(-1/2).  One that presses the
    whole face ends at its right angles, where the stress is bounded."""
    punch = Contact(on=on, plane={"axis": "-y", "at": 1.0}, motion=[0, -0.01])
    problem = block(supports=ROLLERS, contacts=[punch])
    singular = peaks_of(problem).largest.singular
    assert singular.startswith(reason)
    assert bool(singular) is bool(reason)


def test_fewer_cells_than_ranks() -> None:
    """A rank without cells had no array to shape, and ended the run after its last step."""
    body = rectangle_body(size=(1, 1), cells=(1, 1))
    problem = Problem(
        body,
        LinearElastic(E=1.0, nu=0.3),
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[1, 0])],
    )
    *_, state = Statics(problem).steps()
    peaks = find_peaks(problem, ErrorEstimator(problem)(state))
    assert peaks.largest.value > 0
