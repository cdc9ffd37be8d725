"""Hard scenes of contact: they converge to what a closed form says, or end with their cause."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers.barriers import usable_ipctk
from helpers.checkpoints import through_json
from helpers.scenes import Box, boxes
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
    rectangle_body,
)
from dolfin_elastic.core.errors import ConvergenceError, ElasticError, InputError
from dolfin_elastic.problem.state import State

FREE, G = "free", 9.81
ONE_RANK = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="minutes of small steps")
ALONE = pytest.mark.long, ONE_RANK
"""Thousands of steps of few unknowns: several ranks take longer, and do the same."""
FLOOR = {"axis": "y", "at": 0}


def rubber(E: float = 1e6) -> NeoHookean:
    return NeoHookean(E=E, nu=0.3, density=1000.0)


def means(state: State, problem: Problem) -> np.ndarray:
    """Mean displacement of the nodes of each region [m]."""
    body, V = problem.body, problem.V
    own = V.dofmap.index_map.size_local
    u, result = state.u.x.array.reshape(-1, body.dim), []
    for name in [*body.regions] or [None]:
        cells = np.arange(len(V.dofmap.list)) if name is None else body.owned_cells(name)
        nodes = np.unique(V.dofmap.list[cells])
        nodes = nodes[nodes < own]
        sums = body.comm.allreduce(np.append(u[nodes].sum(axis=0), len(nodes)), op=MPI.SUM)
        result.append(sums[:-1] / sums[-1])
    return np.array(result)


def energies(states: list[dict[str, float]]) -> np.ndarray:
    return np.array([one["total"] + one["potential"] for one in states])


# --- rest ---


def tower(gap: float, contacts: list[Any]) -> Problem:
    """Five blocks, each beside the one below."""
    blocks = {
        f"b{i}": Box((0.05 * (i % 2), i * (1 + gap)), (1.0, 1.0), (2 + i % 2, 2)) for i in range(5)
    }
    return Problem(
        boxes(**blocks),
        rubber(1e7),
        supports=[Fixed(on="b0_bottom")],
        loads=[Gravity(value=[0, -G])],
        contacts=contacts,
        degree=1,
    )


@pytest.mark.long
@pytest.mark.parametrize("steps", [30, pytest.param(1000, marks=ALONE)])
def test_a_tower_rests_on_its_barriers(steps):
    """Blocks sink to where barriers carry them, and stay: they move less than the distance d^."""
    usable_ipctk()
    problem = tower(0.045, [SelfContact(all=True, name="s", friction=0.3)])
    moves, stored = [], []
    for state in Dynamics(problem, end=5e-3 * steps, dt=5e-3).steps():
        moves.append(means(state, problem))
        stored.append(state.energies)
    assert np.abs(moves).max() < 0.05
    assert np.diff(energies(stored)).max() <= 1e-6 * np.ptp(energies(stored))
    if steps == 1000:  # they creep by no more than `slow`, 1e-3 of the size of five blocks a second
        assert np.ptp(moves[-21:], axis=0).max() < 5e-3 * 20 * 5e-3


@pytest.mark.long
@pytest.mark.parametrize("steps", [4, pytest.param(400, marks=ALONE)])
def test_a_tower_rests_on_its_contacts(steps):
    """From the equilibrium of statics nothing moves by more than round-off."""
    pairs = [
        Contact(between=[f"b{i}_top", f"b{i + 1}_bottom"], name=f"j{i}", friction=0.3)
        for i in range(4)
    ]
    problem = tower(0.0, pairs)
    moves = [
        means(state, problem)
        for state in Dynamics(problem, end=5e-3 * steps, dt=5e-3, preload=True).steps()
    ]
    # Of a sag of some millimetres statics has found 1e-8; over 1,000 steps it is 6e-11.
    assert np.ptp(moves, axis=0).max() < 1e-10


def incline(slope: float, steps: int, *, grows: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Times and mean displacements along the slope of a block with a coefficient of 0.3."""
    angle, t = np.arctan(slope), "min(1, 2*t)"
    along = f"{G * np.sin(angle)}*{t}^2*(3 - 2*{t})" if grows else G * np.sin(angle)
    problem = Problem(
        rectangle_body(size=(1, 0.5), cells=(2, 1)),
        rubber(1e7),
        loads=[Gravity(value=[along, -G * np.cos(angle)])],
        contacts=[Contact(on="bottom", plane=FLOOR, friction=0.3, name="floor")],
        degree=1,
    )
    t, x, lost = [], [], []
    for state in Dynamics(problem, end=2e-3 * steps, dt=2e-3, preload=True).steps():
        t.append(state.t)
        x.append(means(state, problem)[0, 0])
        lost.append(state.numbers["friction_dissipation_floor"])
    assert np.diff(lost).min() >= -1e-15 * max(1.0, lost[-1])
    return np.array(t), np.array(x)


@pytest.mark.long
@pytest.mark.parametrize("steps", [50, pytest.param(10000, marks=ALONE)])
def test_what_sticks_does_not_creep(steps):
    """At 0.98 of the limit: by round-off only."""
    _, x = incline(0.98 * 0.3, steps)
    assert np.ptp(x) < 1e-12


@pytest.mark.long
def test_what_slides_does_so_as_fast_as_it_should():
    t, x = incline(1.5 * 0.3, 350, grows=True)
    angle, late = np.arctan(0.45), t > 0.55
    found = 2 * np.polyfit(t[late], x[late], 2)[0]
    assert found == pytest.approx(G * (np.sin(angle) - 0.3 * np.cos(angle)), rel=1e-3)


def test_a_spinning_block_falls_on_its_corners():
    """What the energy loses is what friction takes; it never rises."""
    problem = Problem(
        rectangle_body(size=(1, 1), cells=(3, 3), origin=(-0.5, 0.25)),
        rubber(),
        loads=[Gravity(value=[0, -G])],
        contacts=[
            Contact(on=["bottom", "left", "right", "top"], plane=FLOOR, friction=0.3, name="floor")
        ],
        degree=1,
    )
    spin = ["-20*(y - 0.75)", "20*x"]
    found = [
        s.energies for s in Dynamics(problem, end=0.12, dt=2e-3, initial_velocity=spin).steps()
    ]
    total = energies(found)
    assert np.diff(total).max() <= 1e-9 * total[0]
    assert found[-1]["friction"] > 0.01 * total[0]
    assert total[-1] + found[-1]["friction"] == pytest.approx(total[0], rel=1e-9)


# --- closed forms ---


@pytest.mark.long
@pytest.mark.parametrize("friction", [0.2, 0.6])
def test_a_wedge(friction):
    """Pushed between two planes and let go: it stays where mu is above the tangent of its angle.

    While it slides in, the normal force of each side is P/2/(sin a + mu cos a).
    """
    a, half = np.radians(20), 0.2

    def bent(x: np.ndarray) -> np.ndarray:
        return np.c_[(x[:, 0] - 0.5) * 2 * (half + np.tan(a) * x[:, 1]), x[:, 1]]

    sides = {"left": 1.0, "right": -1.0}
    problem = Problem(
        boxes(a=Box((0, 0), (1, 1), (3, 3), bent)),
        rubber(),
        loads=[Traction(on="a_top", value=[0, "-2e4*(1 - abs(1 - 2*t))"])],
        contacts=[
            Contact(
                on=f"a_{side}",
                plane={"point": [-way * half, 0], "normal": [way * np.cos(a), np.sin(a)]},
                friction=friction,
                name=side,
            )
            for side, way in sides.items()
        ],
        degree=1,
    )
    states = [
        (state.load_factor, state.reactions["left"].copy())
        for state in Statics(problem, steps=10).steps()
    ]
    (push,) = (force for t, force in states if t == pytest.approx(0.5))
    P = 2e4 * 2 * (half + np.tan(a))
    N = P / 2 / (np.sin(a) + friction * np.cos(a))
    assert push[1] == pytest.approx(P / 2, rel=1e-6)
    if friction < np.tan(a):
        assert push[0] == pytest.approx(N * (np.cos(a) - friction * np.sin(a)), rel=1e-3)
        assert np.abs(states[-1][1]).max() < 1e-6 * P
    else:
        assert states[-1][1][0] > 0.05 * P


def test_a_stiff_block_with_the_finer_faces_on_a_soft_one():
    """Moduli differ by 1e6: each load step has many short solves, none of which shortens steps."""
    body = boxes(lo=Box((0, 0), (2, 0.5), (8, 2)), up=Box((0.5, 0.5), (1, 0.5), (7, 3)))
    problem = Problem(
        body,
        {"lo": rubber(1e5), "up": rubber(1e11)},
        supports=[Fixed(on="lo_bottom"), Support(on="up_left", displacement=[0, FREE])],
        loads=[Traction(on="up_top", value=[0, -1e4])],
        contacts=[Contact(between=["lo_top", "up_bottom"], name="joint")],
        degree=2,
    )
    states = list(Statics(problem).steps())
    assert len(states) <= 6
    assert states[-1].reactions["lo_bottom"][1] == pytest.approx(1e4, rel=1e-6)


# --- causes ---


def block(**keys: Any) -> Problem:
    contact = keys.pop("contact")
    return Problem(
        rectangle_body(size=(1, 1), cells=(4, 4), origin=keys.pop("origin", (0, 0))),
        rubber(1e7),
        contacts=[Contact.model_validate({"on": "bottom", "name": "it", **contact})],
        degree=1,
        **keys,
    )


HELD = [Support(on="left", displacement=[0, FREE])]
TOP = [Fixed(on="top")]


def at_rest(problem: Problem) -> Any:
    return Statics(problem, steps=5).steps()


def in_motion(problem: Problem) -> Any:
    return Dynamics(problem, end=0.04, dt=2e-3, initial_velocity=["0", "-100"]).steps()


SCENES: dict[str, tuple[Callable[[Problem], Any], dict[str, Any], type[ElasticError], str]] = {
    "it is lifted off": (
        at_rest,
        {"supports": HELD, "loads": [Traction(on="top", value=[0, "-1e4*(1 - 2*t)"])]},
        ConvergenceError,
        r"beyond load factor 0\.5: the load pulls it off its obstacles(.|\n)*try: a support",
    ),
    "a gap": (
        at_rest,
        {"supports": HELD, "contact": {"plane": {"axis": "y", "at": -0.01}}},
        InputError,
        r"no obstacle holds the body yet \('it' is 0.01 m away\)",
    ),
    "its plane is turned": (
        at_rest,
        {"supports": TOP, "contact": {"plane": {"axis": "-y", "at": 0}, "motion": [0, "0.1*t"]}},
        InputError,
        r"contact\[0\]\.plane: the body lies inside the obstacle that 'it' touches",
    ),
    "it lies inside of a ball": (
        at_rest,
        {"supports": TOP, "contact": {"cylinder": {"point": [0.5, 40], "radius": 40}}},
        InputError,
        r"contact\[0\]\.cylinder: the body lies inside the obstacle that 'it' touches",
    ),
    "it begins deep inside": (
        at_rest,
        {"supports": TOP, "contact": {"plane": {"axis": "y", "at": 0.3}}},
        InputError,
        r"contact\[0\]\.plane: at the start 'it' lies 0.3 m deep",
    ),
    "it flies through a plate": (
        in_motion,
        {"origin": (0, 0.31), "contact": {"box": {"center": [0.5, -0.1], "size": [2, 0.2]}}},
        ConvergenceError,
        r"nodes of 'it' pass through its obstacle within one time step(.|\n)*try: a dt 4",
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("name", SCENES)
def test_the_cause_is_named(name):
    solve, keys, kind, words = SCENES[name]
    with pytest.raises(kind, match=words):
        list(solve(block(**{"contact": {"plane": FLOOR}, **keys})))


@pytest.mark.parametrize("kind", [Statics, Dynamics])
def test_a_run_goes_on_from_where_its_obstacle_has_gone(kind):
    """The unloaded body would lie more than an element deep in it: only the start is judged."""
    deep = {"plane": FLOOR, "motion": ["0", "0.3"]}

    def make() -> Statics | Dynamics:
        problem = block(contact=deep, supports=TOP)
        if kind is Statics:
            return Statics(problem, steps=2)
        return Dynamics(problem, end=2e-3, dt=1e-3, preload=True)

    run, whole, middle = make(), [], None
    for state in run.steps():
        whole.append(state.reactions["it"].copy())
        middle = through_json(run.restart_state()) if state.step == 1 else middle
    again = [state.reactions["it"].copy() for state in make().steps(middle)]
    np.testing.assert_allclose(again[-1], whole[-1], rtol=1e-6, atol=1e-6 * abs(whole[-1][1]))
