"""Where energy goes in motion, and when the audit says that it came from nowhere."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.algorithms.analysis import extract_constants

from dolfin_elastic import (
    Buckling,
    Case,
    Contact,
    Dashpot,
    Dynamics,
    Gravity,
    LinearElastic,
    NeoHookean,
    Problem,
    Rigid,
    Rotation,
    Spring,
    StVenantKirchhoff,
    Support,
    Traction,
    rectangle_body,
)
from dolfin_elastic.case.check.report import report
from dolfin_elastic.core.compat import integration_entities
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.problem.state import State

FREE = "free"
SOFT = {"E": 1e6, "nu": 0.3, "density": 1000.0}


def strip(comm: MPI.Comm, cells: tuple[int, int] = (8, 2), **keys: Any) -> Problem:
    body = rectangle_body(size=(1, 0.2), cells=cells, comm=comm)
    return Problem(body, NeoHookean(**SOFT), **{"degree": 1, **keys})


def warned(problem: Problem, **settings: Any) -> tuple[list[str], State]:
    """What the audits of all states say, and the last state."""
    found: list[str] = []
    state: Any = None
    for state in Dynamics(problem, **settings).steps():
        found += state.audit.reasons
    return found, state


# --- work ---


@pytest.mark.long
@pytest.mark.parametrize("radius", [0.9, 0.5])
@pytest.mark.parametrize("scheme", ["alpha2", "generalized-alpha"])
def test_work_of_a_spring_and_a_dashpot(scheme: str, radius: float, comm: MPI.Comm) -> None:
    """A rigid block of 2000 kg at 0.7 m/s on 400 kN/m and 2 kN s/m, over 2 s.

    It loses 490 J but for what is left of u'' + 2 d u' + w^2 u = 0, d = 1/2 per second, and of what
    is lost the dashpot takes all; the spring keeps the rest.  Schemes of second order, 141 steps
    of 0.63 rad in all: to 1 %.
    """
    body = rectangle_body(size=(1, 1), cells=(1, 1), comm=comm)
    holders = [
        Spring(kind="spring", on="bottom", stiffness=[4e5, 4e5], total=True),
        Dashpot(kind="dashpot", on="bottom", viscosity=[2e3, 2e3], total=True),
    ]
    law = LinearElastic(E=1e11, nu=0.3, density=1000)
    problem = Problem(body, law, thickness=2.0, supports=holders, degree=1)
    settings = {"end": 2.0, "dt": 5e-3, "spectral_radius": radius, "scheme": scheme}
    worst = 0.0
    for state in Dynamics(problem, initial_velocity=[0, 0.7], **settings).steps():
        worst = max(worst, abs(state.energies["balance"]))
        if state.step == 0:  # the dashpot pulls at once: c v/m
            assert state.a is not None
            mean = fem.assemble_scalar(fem.form(state.a[1] * ufl.dx))
            assert comm.allreduce(mean) == pytest.approx(-0.7, rel=1e-9)
    d, w = 0.5, np.sqrt(4e5 / 2e3)
    own = np.sqrt(w**2 - d**2)
    t = 2.0
    v = 0.7 * np.exp(-d * t) * (np.cos(own * t) - d / own * np.sin(own * t))
    assert state.energies["kinetic"] == pytest.approx(1e3 * v**2, rel=0.1, abs=0.01 * 490)
    assert state.energies["external"] == pytest.approx(1e3 * v**2 - 490, rel=1e-2)
    assert worst < 3e-3 * 490


def test_a_support_that_is_set_going_at_once(comm: MPI.Comm) -> None:
    """Work is there when the speed is: at the corner of a curve, whatever the step.

    What was judged by the force and the way of a step was off by all of it there.
    """
    curve = [[0, 0], [0.1, 0], [0.2, 0.1], [0.3, 0.1]]
    push = Support(on="bottom", displacement=[1, 0], curve=curve)
    for dt in (2e-3, 1e-3):
        problem = strip(comm, supports=[push])
        off = 0.0
        for state in Dynamics(problem, end=0.12, dt=dt).steps():
            energies = state.energies
            off = max(off, abs(energies["balance"]) / max(energies["kinetic"], 1e-3))
            assert state.audit is not None
            assert state.audit.verdict == "pass"
        assert off < 0.15


def test_a_body_that_is_carried(comm: MPI.Comm) -> None:
    """Every node held, from rest to 1 m/s by a corner: the work is the kinetic energy, exactly.

    PETSc's scheme lets velocities of supports follow from their places, and they ring.
    """
    body = rectangle_body(size=(1, 1), cells=(1, 1), comm=comm)
    push = Support(on=["left", "right"], displacement=[1, 0], curve=[[0, 0], [0.1, 0], [1, 0.9]])
    for scheme in ("generalized-alpha", "newmark", "alpha2"):
        problem = Problem(body, NeoHookean(**SOFT), supports=[push], degree=1)
        *_, state = Dynamics(problem, end=0.2, dt=1e-2, scheme=scheme).steps()
        energies = state.energies
        assert energies["external"] == pytest.approx(energies["kinetic"], rel=1e-9, abs=1e-6)
        if scheme != "alpha2":
            assert energies["kinetic"] == pytest.approx(500.0, rel=1e-9)


# --- the verdict ---


def test_sound_motions_pass(comm: MPI.Comm) -> None:
    """The first steps have little energy, of which a scheme damps a part."""
    load = Traction(on="right", value=[0, "-2e3*sin(8*t)"])
    problem = strip(comm, supports=[Support(on="left")], loads=[load])
    for radius in (0.5, 0.0):
        found, _ = warned(problem, end=0.2, dt=5e-3, spectral_radius=radius)
        assert not found
    lid = Contact(on="top", plane={"axis": "-y", "at": 0.2}, motion=[0, "-0.1*sin(10*t)^2"])
    problem = strip(comm, supports=[Support(on="bottom")], contacts=[lid])
    assert not warned(problem, end=0.05, dt=1e-3)[0]


def test_newmark_with_a_limit(comm: MPI.Comm, caplog: pytest.LogCaptureFixture) -> None:
    """Below gamma/2 a beta has a stable step, here 2.58/omega: said, and seen."""
    body = rectangle_body(size=(1, 0.2), cells=(8, 2), comm=comm)
    load = Traction(on="right", value=[0, -1.0])
    law = LinearElastic(**SOFT)
    problem = Problem(body, law, supports=[Support(on="left")], loads=[load], degree=1)
    found, _ = warned(problem, scheme="newmark", beta=0.1, end=0.1, dt=5e-3)
    assert any("come from nowhere" in reason for reason in found)
    said = comm.bcast(list(caplog.messages))
    assert any("stable for omega dt up to 2.58 only" in line for line in said)
    with pytest.raises(InputError, match="adaptive: with beta below gamma/2"):
        Dynamics(problem, scheme="newmark", beta=0.1, end=1, dt=0.1, adaptive=True)
    tables = {
        "mesh": {"rectangle": {"size": [1, 1], "cells": [2, 2]}, "degree": 1},
        "materials": {"rubber": {"law": "neo-hookean", "E": 1e6, "nu": 0.3, "density": 1000}},
        "dynamics": {"scheme": "newmark", "beta": 0.1, "end": 1.0, "dt": 0.1},
    }
    notes = report(Case.from_dict(tables), comm=comm).notes
    assert any("with beta below gamma/2" in note for note in notes)


# --- what changes with time ---


@pytest.mark.parametrize(
    "support",
    [
        Support(on="left", displacement=["t^2", 0]),
        Rotation(on="left", point=[0, 0], angle="t^2"),
        Rotation(on="left", point=[0, 0], angle=0.0, displacement=["t^2", 0]),
        Rigid(on="left", displacement=["t^2", 0]),
        Rigid(on="left", rotation="t^2"),
        Rigid(on="left", displacement=[FREE, 0], force=["t^2", 0]),
        Rigid(on="left", moment="t^2"),
        Spring(kind="spring", on="left", stiffness=[1, 1], displacement=["t^2", 0]),
    ],
    ids=lambda s: s.kind,
)
def test_supports_that_wind(support: Any, comm: MPI.Comm) -> None:
    """Steps are short where a formula in t may turn around; buckling has no load factor there."""
    assert strip(comm, supports=[support]).driven_by_formula
    body = rectangle_body(size=(1, 0.2), cells=(8, 2), comm=comm)
    problem = Problem(
        body, StVenantKirchhoff(**SOFT), supports=[support, Support(on="right")], degree=1
    )
    with pytest.raises(InputError, match="formula in t|rigid surface|scalar|free"):
        Buckling(problem)


def test_buckling_without_a_load(comm: MPI.Comm) -> None:
    body = rectangle_body(size=(1, 0.2), cells=(8, 2), comm=comm)
    with pytest.raises(InputError, match="load: no load deforms the body"):
        Buckling(Problem(body, StVenantKirchhoff(**SOFT), supports=[Support(on="left")], degree=1))


# --- rigid surfaces and cavities ---


@pytest.mark.parametrize("scheme", ["generalized-alpha", "central-differences", "alpha2"])
def test_first_reactions(scheme: str, comm: MPI.Comm) -> None:
    """Of a body that is held all round and pushed at 1 m/s^2: its mass times that."""
    body = rectangle_body(size=(1, 1), cells=(1, 1), comm=comm)
    push = Support(on=["left", "right"], displacement=["0.5*t^2", 0], name="hand")
    problem = Problem(body, NeoHookean(**SOFT), supports=[push], degree=1)
    dt = {} if scheme == "central-differences" else {"dt": 1e-2}
    states = Dynamics(problem, end=0.1, scheme=scheme, **dt).steps()
    assert next(states).reactions["hand"][0] == pytest.approx(1000.0, rel=1e-6)
    states.close()


@pytest.mark.parametrize("scheme", ["generalized-alpha", "central-differences"])
def test_cavities_are_told_of(scheme: str, comm: MPI.Comm) -> None:
    """A lid under a pressure that grows: the same columns as in statics."""
    tables: dict[str, Any] = {
        "mesh": {
            "rectangle": {"size": [1, 0.2], "cells": [4, 1]},
            "geometry": "axisymmetric",
            "degree": 1,
        },
        "materials": {"rubber": {"law": "neo-hookean", "E": 1e6, "nu": 0.3, "density": 1000}},
        "support": [{"on": "right"}],
        "load": [
            {"kind": "cavity", "on": "top", "name": "bell", "origin": [0, 1], "pressure": "1e4*t"}
        ],
        "dynamics": {"end": "10 ms", "scheme": scheme},
    }
    tables["load"][0]["origin"] = [0, 1]
    if scheme == "generalized-alpha":
        tables["dynamics"]["dt"] = "1 ms"
    case = Case.from_dict(tables)
    *_, state = case.make_solver(case.make_problem(case.read_body(comm))).steps()
    assert state.numbers["pressure_bell"] == pytest.approx(100.0, rel=1e-9)
    still = Case.from_dict({k: v for k, v in tables.items() if k != "dynamics"})
    *_, rest = still.make_solver(still.make_problem(still.read_body(comm))).steps()
    assert state.numbers.keys() == rest.numbers.keys()


@pytest.mark.parametrize("scheme", ["generalized-alpha", "central-differences", "alpha2"])
def test_rigid_surfaces_are_told_of(scheme: str, comm: MPI.Comm) -> None:
    """A stiff strip turned by 0.5 t^2: the moment is that of its inertia, m (a^2 + b^2)/12 + m r^2.

    To 2 % of vibrations that the start leaves; lumped masses of the explicit scheme are 4 % more.
    """
    body = rectangle_body(size=(1, 0.2), cells=(8, 2), comm=comm)
    turn = Rigid(on="left", point=[0, 0.1], rotation="0.5*t^2", name="hinge")
    law = NeoHookean(E=1e8, nu=0.3, density=1000.0)
    problem = Problem(body, law, supports=[turn], degree=1)
    every = {"every": 1} if scheme != "central-differences" else {"every": 5}
    dt = {} if scheme == "central-differences" else {"dt": 1e-3}
    moments, last = [], None
    for state in Dynamics(problem, end=0.1, scheme=scheme, **every, **dt).steps():
        moments.append(state.numbers["moment_hinge_z"])
        last = state
    assert last is not None
    assert last.numbers["hinge_rz"] == pytest.approx(0.005, rel=1e-9)
    inertia = 200 * (1 + 0.04) / 12 + 200 * 0.25
    assert np.mean(moments) == pytest.approx(inertia, rel=0.08)


SCHEMES = [("generalized-alpha", {}), ("alpha2", {}), ("newmark", {})]


@pytest.mark.parametrize(("scheme", "keys"), SCHEMES, ids=[name for name, _ in SCHEMES])
def test_a_load_that_a_program_changes(scheme: str, keys: dict[str, Any], comm: MPI.Comm) -> None:
    """Ten times the load from one state on: its work begins with the new force, and is balanced.

    With the mean of both forces over the step of the change, 10 % of the energy are missing.
    """
    problem = strip(
        comm, supports=[Support(on="left")], loads=[Traction(on="right", value=[0, -100.0])]
    )
    (load,) = (
        constant
        for constant in extract_constants(problem.weak_form.residual)
        if constant.ufl_shape == (2,) and constant.value[1] == -100.0
    )
    state: Any = None
    for state in Dynamics(problem, end=0.6, dt=0.01, scheme=scheme, **keys).steps():
        if state.step == 20:
            load.value[1] *= 10.0
    assert state.audit.verdict_so_far == "pass", state.audit.so_far
    assert abs(state.energies["balance"]) < 2e-2 * state.energies["total"]
    tip = -10.0 * 100.0 * 0.2 * mean_at_the_end(problem)
    assert state.energies["potential"] == pytest.approx(-tip, rel=1e-9)


EXPLICIT = ["symplectic-euler", "central-differences"]


@pytest.mark.parametrize("every", [1, 10])
@pytest.mark.parametrize("scheme", EXPLICIT)
def test_a_weight_that_a_program_changes_in_explicit_motion(
    scheme: str, every: int, comm: MPI.Comm
) -> None:
    """A free body whose weight is minus three times as large from t = 0.1 s on, of 0.3 s.

    u = g T^2/2 + g T (0.2 s) - 3 g (0.2 s)^2/2, T = 0.1 s, and all work becomes kinetic energy.
    Central differences are exact.  Symplectic Euler moves on with the velocity at the end of each
    step: in n steps with the acceleration a it goes n a dt^2/2 further.
    """
    problem = strip(comm, loads=[Gravity(value=[0, -2.0])])
    (weight,) = constants_of(problem, [0, -2.0])
    state: Any = None
    settings = {"scheme": scheme, "end": 0.3, "dt": 2e-4, "every": every}
    for state in Dynamics(problem, **settings).steps():
        if state.step == 500:
            weight.value[1] *= -3.0
    u = -2.0 * (0.1**2 / 2 + 0.1 * 0.2 - 3 * 0.2**2 / 2)
    v = -2.0 * (0.1 - 3 * 0.2)
    further = [0.0, 0.0]
    if scheme == "symplectic-euler":
        further = [0.1 * -2.0 * 2e-4 / 2, 0.2 * 6.0 * 2e-4 / 2]
    assert state.max_displacement == pytest.approx(u + sum(further), rel=1e-9)
    assert state.energies["kinetic"] == pytest.approx(0.5 * 200 * v**2, rel=1e-9)
    work = 100 * v**2 + 200 * (-2.0 * further[0] + 6.0 * further[1])
    assert state.energies["external"] == pytest.approx(work, rel=1e-9)
    assert state.failure == ""


@pytest.mark.long
@pytest.mark.parametrize("changes", [False, True], ids=["constant", "in time"])
@pytest.mark.parametrize("scheme", EXPLICIT)
def test_a_load_that_a_program_changes_in_explicit_motion(
    scheme: str, changes: bool, comm: MPI.Comm, caplog: pytest.LogCaptureFixture
) -> None:
    """Ten times the load from t = 0.2 s on: the motion and the work of the implicit scheme."""
    curve = {"curve": [[0, 1], [0.6, 1.2]]} if changes else {}
    found = []
    for settings in ({"scheme": scheme, "every": "0.1 s"}, {"dt": 2e-3, "every": 50}):
        load = Traction(on="right", value=[0, -100.0], **curve)
        problem = strip(comm, supports=[Support(on="left")], loads=[load])
        (pull,) = constants_of(problem, [0, -100.0])
        state: Any = None
        for state in Dynamics(problem, end=0.6, **settings).steps():
            if 0.2 <= state.t < 0.21:
                pull.value[1] *= 10.0
        gained = state.energies["total"] - state.energies["external"]
        assert abs(gained) < 2e-2 * state.energies["total"]
        assert state.failure == ""
        found.append((mean_at_the_end(problem), state.energies["external"]))
    np.testing.assert_allclose(found[0], found[1], rtol=3e-2)
    assert not any("nowhere" in line for line in caplog.messages)


def test_a_material_that_a_program_changes_in_explicit_motion(comm: MPI.Comm) -> None:
    """A modulus ten times as large from the start on moves as the body of that modulus does."""
    found = []
    for factor in (1.0, 10.0):
        law = LinearElastic(E=factor * 1e6, nu=0.0, density=1000.0)
        body = rectangle_body(size=(1, 0.2), cells=(8, 2), comm=comm)
        loads = [Traction(on="right", value=[100.0, 0])]
        problem = Problem(body, law, degree=1, supports=[Support(on="left")], loads=loads)
        settings = {"scheme": "central-differences", "end": 0.02, "dt": 1e-5, "every": 100}
        for state in Dynamics(problem, **settings).steps():
            if state.step == 0 and factor == 1.0:
                problem.parameters["materials.body.E"].value *= 10.0
        found.append(mean_at_the_end(problem, 0))
    assert found[0] == pytest.approx(found[1], rel=1e-9)


def constants_of(problem: Problem, value: list[float]) -> list[fem.Constant]:
    """Constants of the virtual work that have this value."""
    vectors = [c for c in extract_constants(problem.weak_form.residual) if c.ufl_shape == (2,)]
    return [c for c in vectors if list(c.value) == value]


def mean_at_the_end(problem: Problem, component: int = 1) -> float:
    """Mean displacement of the loaded end [m], by default along y."""
    ds = ufl.Measure("ds", problem.body.mesh, subdomain_data=[(1, ends(problem))])(1)
    own = fem.assemble_scalar(fem.form(problem.u[component] * ds))
    return float(problem.body.comm.allreduce(own)) / 0.2


def ends(problem: Problem) -> np.ndarray:
    return integration_entities(problem.body.mesh, problem.body.owned_facets("right"))
