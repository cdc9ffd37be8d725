"""The loop of explicit motion: a textbook's lines, what it allocates, continued runs."""

from __future__ import annotations

import resource
import tracemalloc
from typing import Any

import numpy as np
import pytest
from dolfinx import fem, la
from helpers.checkpoints import through_json
from helpers.tetrahedron import CORNERS, GRADIENTS, V0
from mpi4py import MPI

from dolfin_elastic import (
    BodyForce,
    Contact,
    Dashpot,
    Dynamics,
    Gravity,
    LinearElastic,
    NeoHookean,
    Normal,
    PointForce,
    Pressure,
    Problem,
    Spring,
    Support,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.jit import cell_integrals
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.signals import PythonStop
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh import Body
from dolfin_elastic.mesh.distribute import make_mesh
from dolfin_elastic.model.amplitude import Amplitude
from dolfin_elastic.problem.term import Term
from dolfin_elastic.solvers.assembly.assembler import compiled
from dolfin_elastic.solvers.dynamics.explicit import explicit
from dolfin_elastic.solvers.dynamics.explicit.explicit import Explicit
from dolfin_elastic.solvers.dynamics.schemes import SCHEMES, ExplicitRow

E, NU, RHO = 1e5, 0.3, 1000.0
EXPLICIT = [name for name, row in SCHEMES.items() if isinstance(row, ExplicitRow)]
BOTH = pytest.mark.parametrize("scheme", EXPLICIT)


def tetrahedron() -> Body:
    """The one of the textbook, on rank 0."""
    comm = MPI.COMM_WORLD
    root = comm.rank == 0
    cells = np.array([[0, 1, 2, 3]] if root else np.empty((0, 4)), dtype=np.int64)
    return Body(make_mesh(comm, cells, CORNERS if root else np.empty((0, 3)), 1))


def test_one_tetrahedron_as_in_a_textbook():
    """v += dt f/m, x += dt v at four corners, f_a = -V0 P grad(phi_a), m = rho V0/4.

    P of the neo-Hookean solid: mu (F - F^-T) + lmbda ln(J) F^-T.
    """
    law = NeoHookean(E=E, nu=NU, density=RHO)
    problem = Problem(tetrahedron(), law, loads=[Gravity()], degree=1)
    v0 = np.array([3.0, -1.0, 0.5])  # times the reference place: stretches and turns it
    x, v = CORNERS.copy(), np.outer(CORNERS[:, 1], v0) - np.outer(CORNERS[:, 2], v0[::-1])
    dt, g = 1e-3, np.array([0, 0, -9.81])
    velocity = [f"{v0[i]}*y - {v0[::-1][i]}*z" for i in range(3)]
    places = problem.V.tabulate_dof_coordinates()
    own = problem.V.dofmap.index_map.size_local
    corner = [int(np.argmin(np.linalg.norm(CORNERS - place, axis=1))) for place in places[:own]]
    for state in Dynamics(
        problem, scheme="symplectic-euler", end=0.2, dt=dt, every=1, initial_velocity=velocity
    ).steps():
        if state.step:
            F = x.T @ GRADIENTS
            T = np.linalg.inv(F).T
            P = law.mu * (F - T) + law.lmbda * np.log(np.linalg.det(F)) * T
            v = v + dt * (-V0 * GRADIENTS @ P.T / (RHO * V0 / 4) + g)
            x = x + dt * v
        u = state.u.x.array.reshape(-1, 3)[:own]
        off = np.abs(places[:own] + u - x[corner]).max(initial=0.0)
        off_v = np.abs(state.v.x.array.reshape(-1, 3)[:own] - v[corner]).max(initial=0.0)
        # Round-off: forces are 1e5 of numbers that cancel to a few units, over 200 steps.
        assert total(problem.body.comm, float(off)) < 1e-12 * np.abs(x).max()
        assert total(problem.body.comm, float(off_v)) < 1e-11 * np.abs(v).max()
    assert abs(np.linalg.det(x.T @ GRADIENTS) - 1) > 0.05


# --- what the loop costs ---


def block(cells: tuple[int, ...] = (6, 2, 2)) -> Body:
    return box_body(size=(0.6, 0.2, 0.2), cells=cells)


def loaded(body: Body | None = None, **more: Any) -> Problem:
    """A block with a dead load, its weight, a held end and a floor."""
    settings: dict[str, Any] = {
        "supports": [Support(on="left")],
        "loads": [Gravity(), Traction(on="right", value=[0, 0, -50.0])],
        "contacts": [Contact(on="bottom", plane={"axis": "z", "at": -0.01}, name="floor")],
    } | more
    return Problem(
        body or block(), NeoHookean(E=E, nu=NU, density=RHO), **{"degree": 1, **settings}
    )


@pytest.mark.long
@pytest.mark.parametrize("many", [cell_integrals.MANY_CELLS, 0], ids=["few", "many"])
@pytest.mark.parametrize("modulus", [E, "1e5*(1 + x)"])
def test_forces_are_those_of_statics(modulus, many, monkeypatch):
    """At each state of a motion with dead, following and growing loads, dashpots and a wall."""
    monkeypatch.setattr(cell_integrals, "MANY_CELLS", many)
    law = NeoHookean(E=modulus, nu=NU, density=RHO)
    problem = Problem(
        block(),
        law,
        loads=[
            Gravity(),
            BodyForce(value=["x*(1 + t)", 0.0, "y"]),
            Pressure(on="top", value="1e3*x*t"),
            Traction(on="right", value=[1e3, 0.0, 0.0]),
            PointForce(at=[0.6, 0.2, 0.2], value=[10.0, 0.0, 0.0]),
        ],
        supports=[Support(on="left"), Dashpot(on="right", viscosity=[1e3, 1e3, 1e3])],
        contacts=[Contact(on="bottom", plane={"axis": "z", "at": 0.01}, stiffness=1e4)],
        degree=1,
    )
    velocity = fem.Function(problem.V)
    scheme = SCHEMES["central-differences"].scheme
    march = Explicit(problem, velocity, scheme, end=1.0, dt=None, safety=0.5, every=10)
    residual, states = march.assembler.residual, 0
    for _ in march.run():
        march.scheme.assemble_forces()
        found = residual.vector.array.copy()
        residual.assemble()
        known = residual.vector.array[: march.assembler.size]
        whole = fem.assemble_vector(compiled(problem, [residual.work])[0])
        march.assembler.reactions.add_terms(whole.array, -1.0, restraining=False)
        whole.scatter_reverse(la.InsertMode.add)
        size = largest(problem.body.comm, float(np.abs(known).max(initial=0.0)))
        assert size > 10.0
        for other in (found, whole.array):
            off = np.abs(other[: march.assembler.size] - known)
            assert largest(problem.body.comm, float(off.max(initial=0.0))) < 1e-12 * size
        states += 1
        if states == 4:
            break
    assert states == 4
    march.assembler.destroy()


@BOTH
def test_steps_allocate_nothing(scheme):
    """Between two states, beside a few numbers: nothing that grows with the mesh or the steps."""
    problem = loaded(block((16, 4, 4)))
    march = Explicit(
        problem,
        fem.Function(problem.V),
        SCHEMES[scheme].scheme,
        end=1.0,
        dt=None,
        safety=0.5,
        every=100,
    )
    march.scheme.assemble_forces()
    march.work.begin()
    tracemalloc.start()
    try:
        for _ in range(100):  # Python keeps some views and numbers for later
            march.scheme.advance(march.size.dt)
        before, _ = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        for _ in range(200):
            march.scheme.advance(march.size.dt)
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # A vector of this mesh has 3400 bytes and more on each of three ranks; what remains are numpy's
    # views and Python's numbers.
    assert largest(problem.body.comm, after - before) < 1000
    assert largest(problem.body.comm, peak - before) < 3000
    assert not march.work.paths
    march.assembler.destroy()


def peak_memory() -> int:
    """Most memory that this process has had [byte]."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


@BOTH
def test_memory_and_energy_stay_over_ten_thousand_steps(scheme):
    """A free brick that turns and swings, D-3: momenta and energy, and no byte more in use."""
    problem = Problem(
        box_body(size=(1.0, 0.6, 0.3), cells=(2, 1, 1)),
        NeoHookean(E=1e5, nu=NU, density=1000),
        degree=1,
    )
    velocity = ["1 - 2*(z - 0.15) - 5*(y - 0.3)", "2 + 5*(x - 0.5) - 3*(z - 0.15)"]
    velocity.append("-0.5 + 3*(y - 0.3) + 2*(x - 0.5)")
    dt, rows, memory = 2e-3, [], 0
    for state in Dynamics(
        problem, scheme=scheme, end=1e4 * dt, dt=dt, every=250, initial_velocity=velocity
    ).steps():
        momenta = np.concatenate([state.momenta["linear"], state.momenta["angular"]])
        rows.append([*momenta, state.energies["total"]])
        if state.step == 1000:
            memory = peak_memory()
    assert state.step == 10_000
    # Pages of the allocator; a vector leaked at each step would be 4 MB and more.
    assert largest(problem.body.comm, peak_memory() - memory) < 1_000_000
    table = np.array(rows)
    np.testing.assert_allclose(table[0, :3], [180, 360, -90], rtol=1e-12)
    drift = np.abs(table - table[0]).max(axis=0)
    assert drift[:3].max() < 1e-12 * np.linalg.norm(table[0, :3])
    assert drift[3:6].max() < 1e-11 * np.linalg.norm(table[0, 3:6])
    # 1.7e-3 and 1.8e-5 found: to first and to second order in the step, without a trend.
    energy = table[:, 6] / table[0, 6]
    assert np.ptp(energy) < (5e-3 if scheme == "symplectic-euler" else 6e-5)
    halves = energy[1:21].mean() - energy[21:].mean()
    assert abs(halves) < 0.5 * np.ptp(energy)  # 20 samples each, at chance


# --- continued runs ---

PROBLEMS: dict[str, Any] = {
    "held": {},
    "all moves": {
        "supports": [
            Normal(on="left", displacement="0.01*sin(60*t)"),
            Spring(on="front", normal=1e5, displacement=[0, "0.005*sin(80*t)", 0]),
            Dashpot(on="right", normal=300.0, tangential=100.0),
        ],
        "loads": [
            Pressure(on="top", value="2000*t/0.05"),
            PointForce(at=[0.6, 0.1, 0.2], value=["5*sin(90*t)", 0, 3]),
        ],
        "contacts": [
            Contact(
                on="bottom",
                plane={"axis": "z", "at": -0.004},
                motion=[0, 0, "0.02*sin(50*t)"],
                name="floor",
            )
        ],
    },
    "springs at rest": {
        "supports": [Spring(on="left", normal=1e6, tangential=1e6)],
        "contacts": [],
    },
}


def followed(states: Any, stop: int | None = None) -> tuple[list[np.ndarray], Any]:
    """Numbers of states by their step, up to one of them."""
    rows = []
    for state in states:
        energies = [state.energies[key] for key in sorted(state.energies)]
        forces = [state.reactions[key] for key in sorted(state.reactions)]
        fields = [np.linalg.norm(f.x.array[: 3 * own(f)]) for f in (state.u, state.v, state.a)]
        squares = np.sqrt(total(MPI.COMM_WORLD, np.square(fields)))
        row = [state.step, state.t, *energies, *np.concatenate([np.zeros(0), *forces]), *squares]
        rows.append(np.array(row))
        if state.step == stop:
            break
    return rows, state


def own(field: fem.Function) -> int:
    return int(field.function_space.dofmap.index_map.size_local)


@pytest.mark.parametrize(
    ("kind", "scheme"),
    [
        ("held", "symplectic-euler"),
        ("all moves", "symplectic-euler"),
        ("all moves", "central-differences"),
        ("springs at rest", "central-differences"),
    ],
)
def test_a_continued_run_is_the_same(kind, scheme):
    """Stopped at a state and gone on with by another solver: to round-off as without a break."""
    settings = {"scheme": scheme, "end": 0.08, "every": 7, "safety": 0.8}
    body = block()  # one for all: two of them can be parted and numbered in two ways
    whole, _ = followed(Dynamics(loaded(body, **PROBLEMS[kind]), **settings).steps())
    first = Dynamics(loaded(body, **PROBLEMS[kind]), **settings)
    states = first.steps()
    head, state = followed(states, stop=7 * (len(whole) // 2))
    assert not state.done >= 1.0
    saved = through_json(first.restart_state())
    states.close()
    tail, last = followed(Dynamics(loaded(body, **PROBLEMS[kind]), **settings).steps(saved))
    assert last.done == pytest.approx(1.0, abs=1e-12)
    assert len(head) + len(tail) == len(whole)
    scale = np.maximum(np.abs(np.array(whole)).max(axis=0), 1e-300)
    for there, here in zip(whole, [*head, *tail], strict=True):
        # Velocities halfway are made of those at the state anew; the rest is bit by bit the same.
        assert np.abs(there - here).max(initial=0.0, where=scale == 0) == 0
        np.testing.assert_allclose(
            here / scale.clip(1e-300), there / scale.clip(1e-300), atol=1e-11
        )


@BOTH
def test_states_between_change_nothing(scheme, monkeypatch):
    """In a run that can be stopped: the motion is bit by bit the same, and goes on from them."""
    settings = {"scheme": scheme, "end": 0.08, "every": "0.03 s", "dt": 4e-4}
    body = block()

    def fields(states):
        return [np.array([s.u.x.array, s.v.x.array, s.a.x.array]) for s in states if not s.between]

    whole = fields(Dynamics(loaded(body, **PROBLEMS["all moves"]), **settings).steps())
    monkeypatch.setattr(explicit, "watched", lambda: True)
    monkeypatch.setattr(explicit, "BETWEEN", 0.0)
    # As under a command, which hears signals itself, and is given the states between.
    monkeypatch.setattr(PythonStop, "where_nobody_listens", lambda comm: None)
    first, asked, saved = Dynamics(loaded(body, **PROBLEMS["all moves"]), **settings), [], None
    for state in first.steps():
        asked += fields([state])
        if state.between and len(asked) == 2:
            assert 75 < state.step < 150
            assert state.step % explicit.STEPS_A_LOOK == 0
            saved = through_json(first.restart_state())
    assert len(asked) == len(whole) == 4
    assert saved is not None
    np.testing.assert_array_equal(asked, whole)
    monkeypatch.undo()
    tail = fields(Dynamics(loaded(body, **PROBLEMS["all moves"]), **settings).steps(saved))
    np.testing.assert_array_equal(tail, whole[2:])


@pytest.mark.long
def test_states_do_not_change_the_motion():
    """How often it is looked at only rounds differently."""
    ends = []
    for every in (1, 10):
        settings = {"scheme": "central-differences", "end": 0.05, "dt": 5e-4, "every": every}
        *_, state = Dynamics(loaded(**PROBLEMS["all moves"]), **settings).steps()
        ends.append((state.energies["external"], state.max_displacement, state.energies["total"]))
    np.testing.assert_allclose(ends[0], ends[1], rtol=1e-10)


def test_about_two_hundred_states_by_default():
    problem = Problem(
        rectangle_body(size=(1, 1), cells=(1, 1)), LinearElastic(E=E, nu=NU, density=RHO), degree=1
    )
    for scheme in EXPLICIT:
        steps = [s.step for s in Dynamics(problem, scheme=scheme, end=1.0, dt=2.5e-4).steps()]
        assert len(steps) == 201
        assert steps[1] == 20
        assert steps[-1] == 4000
    few = [s.step for s in Dynamics(problem, scheme=scheme, end=0.01, dt=2.5e-4).steps()]
    assert few == list(range(41))


# --- work ---


@pytest.mark.parametrize(
    ("scheme", "rate"), [("symplectic-euler", 0.6), ("central-differences", 0.3)]
)
def test_energy_balance_of_all_that_moves(scheme, rate):
    """Strain, kinetic and contact energy are the work of loads, springs, dashpots and supports.

    To the order of the scheme: 1 and 2, with the step halved.
    """
    off = []
    for dt in (4e-4, 2e-4):
        problem = loaded(**PROBLEMS["all moves"])
        worst, first = 0.0, None
        for state in Dynamics(problem, scheme=scheme, end=0.05, dt=dt, every=5).steps():
            first = state.energies["total"] if first is None else first
            gained = state.energies["total"] - first - state.energies["external"]
            worst = max(worst, abs(gained))
        off.append(worst / state.energies["total"])
    assert max(off) < 0.1
    assert off[1] < rate * off[0]


PUSHED = [1.0, 0.25]


class Push(Term):
    """A force of one's own on a node, [0, f(t)] N."""

    label, nodal = "push", True

    def __init__(self, problem: Problem, changes: bool) -> None:
        near = np.abs(problem.places[:, :2] - PUSHED).max(axis=1) < 1e-9
        owned = np.arange(len(near)) < problem.V.dofmap.index_map.size_local
        self._node, self.changes, self._t = np.flatnonzero(near & owned), changes, 0.0

    def set_time(self, t: float, default: Amplitude) -> None:
        self._t = t

    def add_forces(self, forces: FloatArray) -> None:
        forces.reshape(-1, 2)[self._node, 1] -= 5e4 * self._t if self.changes else 500.0


def pushed(terms: str, changes: bool) -> Problem:
    """A strip under a force on a node, as a load or as a term of one's own."""
    load = PointForce(at=PUSHED, value=[0, "-5e4*t" if changes else -500.0])
    problem = Problem(
        rectangle_body(size=(1.0, 0.5), cells=(4, 2)),
        NeoHookean(E=E, nu=NU, density=RHO),
        supports=[Support(on="left")],
        loads=[load] if terms == "load" else [],
        degree=1,
    )
    if terms != "load":
        problem.terms.append(Push(problem, changes))
    return problem


@BOTH
@pytest.mark.parametrize("changes", [False, True])
def test_a_load_of_ones_own_that_is_in_no_form(changes, scheme):
    """Forces and work are those of a point force, without any other load."""
    found = []
    for terms in ("load", "own"):
        *_, state = Dynamics(pushed(terms, changes), end=0.02, scheme=scheme).steps()
        found.append({"moved": state.max_displacement, **state.energies})
    assert found[1] == pytest.approx(found[0], rel=1e-9)
    assert found[0]["external"] > 0.1


@BOTH
def test_forces_of_ones_own_that_answer_to_the_motion_are_refused(scheme):
    problem = pushed("own", changes=False)
    problem.terms[-1].restrains = True
    with pytest.raises(InputError, match="have no UFL form, as those of 'push'"):
        next(Dynamics(problem, end=0.02, scheme=scheme).steps())
