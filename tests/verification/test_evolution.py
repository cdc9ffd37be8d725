"""Materials whose memory evolves by a rate or by equations that a user has written.

A Maxwell branch of large strains, dCv/dt = (Cbar - tr(Cbar Cv^-1)/3 Cv)/time (J. Lubliner, Mech.
Res. Commun. 12 (1985) 93), whose step of backward Euler with the projection to det Cv = 1 has the
closed form X = unimodular(Cv + dt/time Cbar) (A. V. Shutov, R. Landgraf and J. Ihlemann, Comput.
Methods Appl. Mech. Eng. 265 (2013) 213); Zener's solid; and J2 plasticity as equations of a step.
"""

from __future__ import annotations

from math import exp, log2
from typing import Any

import numpy as np
import pytest
import ufl
from helpers.checkpoints import through_json
from mpi4py import MPI

from dolfin_elastic import (
    Dynamics,
    Energy,
    Problem,
    Statics,
    Support,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.case.tables import Material
from dolfin_elastic.core.errors import ConvergenceError, InputError
from dolfin_elastic.model.kinematics import variables
from dolfin_elastic.model.materials.stepped import SteppedSplitLaw
from dolfin_elastic.model.point.checks import check_energy
from dolfin_elastic.model.point.history import error_of_rates, history
from dolfin_elastic.model.point.steps import PointOverSteps
from dolfin_elastic.model.point.tested import LawUnderTest
from dolfin_elastic.model.point.ufl_to_numpy import LawAtPoints
from dolfin_elastic.problem.state import State
from dolfin_elastic.solvers.eigen.modal import Modal

FREE = "free"
THERE_AND_BACK = [[0, 0], [0.4, 1], [0.7, -0.4], [1, 0.2]]
TAU = 0.5
MAXWELL: dict[str, Any] = {
    "energy": "mu0/2*(I1bar - 3) + K/2*(J - 1)^2 + mu1/2*(tr(Cbar*inv(Cv)) - 3)",
    "history": {"Cv": {"start": "I", "determinant": 1}},
    "rate": {"Cv": "(Cbar - tr(Cbar*inv(Cv))/3*Cv)/tau"},
    "parameters": {"mu0": 1.0, "mu1": 2.0, "K": 20.0, "tau": TAU},
}
# The same in closed form: Cv of the energy is that at the start, and X that at the end.
X = "(Cv + dt/tau*Cbar)/det(Cv + dt/tau*Cbar)^(1/3)"
CLOSED = {**MAXWELL, "next": {"Cv": X}, "history": {"Cv": "I"}}
del CLOSED["rate"]

TRIAL = "2*mu*(dev(eps) - ep_old)"
MISES = f"(sqrt(1.5)*norm({TRIAL}))"
J2: dict[str, Any] = {
    "energy": "K/2*tr(eps)^2 + mu*inner(dev(eps) - ep, dev(eps) - ep) + H/2*a^2",
    "history": {"ep": "0", "a": 0},
    "residual": {
        "a": f"a - a_old - max({MISES} - sy - H*a_old, 0)/(3*mu + H)",
        "ep": f"ep - ep_old - 1.5*(a - a_old)/max({MISES}, 1e-9)*{TRIAL}",
    },
    "parameters": {"mu": "80 GPa", "K": "160 GPa", "sy": "250 MPa", "H": "2 GPa"},
}
BUILT_IN = {"law": "j2", "E": 9 * 160e9 / 7, "nu": 2 / 7, "yield": 250e6, "hardening": 2e9}


def law_of(table: dict[str, Any]) -> Any:
    return Material.read(table).law


def held(law: Any, size: float = 1.0, **keys: Any) -> Problem:
    """A cube, one side fixed, the other one moved askew by what a curve says."""
    goal = [0.3 * size, 0.1 * size, 0]
    moved = Support(on="right", displacement=goal, curve=THERE_AND_BACK)
    body = box_body(size=(1, 1, 1), cells=(2, 1, 1))
    return Problem(body, law, supports=[Support(on="left"), moved], **{"degree": 1, **keys})


def reactions(state: State) -> np.ndarray:
    return np.concatenate([state.reactions[n] for n in sorted(state.reactions)])


def judged(solver: Any) -> list[State]:
    states = list(solver.steps())
    for state in states:
        assert state.audit is not None
        assert state.audit.verdict == "pass", state.audit.reasons
    return states


def forces(problem: Problem, **keys: Any) -> np.ndarray:
    solver = Statics(problem, **{"steps": 10, "rtol": 1e-13, **keys})
    return np.array([reactions(state) for state in judged(solver)])


# --- at a point ---

GOAL = np.array([[0.3, 0.1, 0.6], [0.0, -0.1, 0.0], [0.0, 0.0, 0.05]])


def along(law: Any, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of Cv, and the tangent at the end of a ramp within a second."""
    point, dt = PointOverSteps(law), 1 / steps
    H, variable = variables(point.F)
    tangent = point.quantity(ufl.diff(point.law.stress(variable), H))
    for k in range(steps):
        F = (np.eye(3) + (k + 1) * dt * GOAL)[None]
        assert point.found(F, dt=dt).all()
        last = tangent(F, dt=dt)[0] if k == steps - 1 else None
        point.commit(F, dt=dt)
    assert last is not None
    return point.values["Cv"][0], last


@pytest.mark.long
def test_a_ramp_of_large_strains() -> None:
    """Against scipy's solution: order one; and the closed form of the step, to round-off."""
    from scipy.integrate import solve_ivp

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        Cv, F = y.reshape(3, 3), np.eye(3) + t * GOAL
        C = F.T @ F / np.linalg.det(F) ** (2 / 3)
        return np.ravel(C - np.trace(np.linalg.solve(Cv, C)) / 3 * Cv) / TAU

    end = solve_ivp(rate, (0, 1), np.eye(3).ravel(), method="DOP853", rtol=1e-12, atol=1e-12)
    wanted = end.y[:, -1].reshape(3, 3)[[0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
    law, errors = law_of(MAXWELL), []
    for steps in (50, 100, 200):
        Cv, A = along(law, steps)
        errors.append(np.abs(Cv - wanted).max())
        # symmetric, for the step has a potential
        assert np.abs(A - A.transpose(2, 3, 0, 1)).max() < 1e-14 * np.abs(A).max()
    assert log2(errors[0] / errors[1]) == pytest.approx(1, abs=0.02)
    assert log2(errors[1] / errors[2]) == pytest.approx(1, abs=0.01)
    assert errors[2] < 1e-3
    assert Cv == pytest.approx(along(law_of(CLOSED), 200)[0], rel=1e-12, abs=1e-12)
    # The trapezoidal rule, also with the projection: order two.
    law, errors = law_of({**MAXWELL, "rate_integration": "trapezoidal"}), []
    for steps in (25, 50, 100):
        errors.append(np.abs(along(law, steps)[0] - wanted).max())
    assert log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.05)
    assert log2(errors[1] / errors[2]) == pytest.approx(2, abs=0.03)
    assert errors[2] < 1e-4


@pytest.mark.parametrize("law", [MAXWELL, J2], ids=["rate", "residual"])
def test_the_tangent_is_that_of_differences(law: dict[str, Any]) -> None:
    """dP/dF of the implicit function theorem, of bodies that were strained before."""
    point = PointOverSteps(law_of(law))
    H, variable = variables(point.F)
    stress = point.quantity(point.law.stress(point.F))
    tangent = point.quantity(ufl.diff(point.law.stress(variable), H))
    size = 0.3 if law is MAXWELL else 0.005
    draw = np.random.default_rng(2)
    before, F = (np.eye(3) + size * draw.uniform(-1, 1, (6, 3, 3)) for _ in range(2))
    point.commit(before, dt=0.2)
    assert point.found(F, dt=0.2).all()
    A = tangent(F, dt=0.2)
    h, found = 1e-4 * size, np.zeros_like(A)
    for i, j in np.ndindex(3, 3):
        D = np.zeros((3, 3))
        D[i, j] = h
        coarse, fine = (stress(F + k * D, dt=0.2) - stress(F - k * D, dt=0.2) for k in (2, 1))
        found[..., i, j] = (8 * fine - coarse) / (12 * h)
    # of differences of order four with a step of 1e-4 of the strains: round-off of 1e-12 over that
    assert np.abs(A - found).max() < 1e-8 * np.abs(A).max()


@pytest.mark.long
def test_what_a_step_gives_at_a_point() -> None:
    findings = {f.check: f for f in history(LawUnderTest(law_of(MAXWELL)))}
    assert all(f.verdict != "fail" for f in findings.values())
    assert findings["dissipation"].values["fraction"] == 0
    assert findings["tangent of a step"].values["symmetric"]
    turned = {**MAXWELL, "rate": {"Cv": f"-({MAXWELL['rate']['Cv']})"}}
    with pytest.raises(InputError, match="rate: dissipation: energy is won on") as caught:
        check_energy(law_of(turned))
    assert "has `rate` a wrong sign, or a tensor no determinant = 1?" in str(caught.value)
    skew = {**MAXWELL, "rate": {"Cv": "(Cbar*Cv - tr(Cbar*inv(Cv))/3*Cv)/tau"}}
    found = {f.check: f for f in history(LawUnderTest(law_of(skew)))}
    assert found["symmetric history"].verdict == "fail"
    # without the projection the determinant drifts, and the step has no potential
    plain = {f.check: f for f in history(LawUnderTest(law_of({**MAXWELL, "history": {"Cv": "I"}})))}
    assert not plain["tangent of a step"].values["symmetric"]
    rootless = {**MAXWELL, "residual": {"Cv": "Cv*Cv + tau*Cbar"}}
    del rootless["rate"]
    with pytest.raises(InputError, match="residual: finite history: its equations have no root"):
        check_energy(law_of(rootless))


# --- in bodies ---


@pytest.mark.long
def test_equations_of_j2_are_those_of_the_law() -> None:
    """Forces of a body that yields, is unloaded and yields again, to round-off.

    No step ends where the load turns: the trial stress of the next one would begin exactly at
    yield, where round-off decides which points have the tangent of plastic flow, and with it
    whether Newton's method finds that step whole.
    """
    laws = [law_of(table) for table in (J2, BUILT_IN)]
    own, known = (forces(held(law, 0.02, degree=2), steps=12) for law in laws)
    assert own == pytest.approx(known, rel=1e-12, abs=1e-12 * np.abs(known).max())
    problem = held(law_of(J2), 0.02, degree=2)
    assert problem.symmetric
    *_, state = judged(Statics(problem, steps=12, rtol=1e-13))
    assert state.energies["dissipated"] > 0


@pytest.mark.long
def test_newton_is_quadratic() -> None:
    """The tangent is consistent: the last but one residual squares."""
    law = law_of(MAXWELL)
    for state in judged(Statics(held(law), steps=5, rtol=1e-12))[1:]:
        first, *_, before, last = [r for r in state.residuals if r > 1e-13]
        if before < 1e-3 * first:
            assert last < 1e3 * before**2 / first


def zener(C: Any, J: Any, Cv: Any, mu: Any, lmbda: Any, g: Any) -> Any:
    elastic = mu / 2 * (ufl.tr(C) - 3) - mu * ufl.ln(J) + lmbda / 2 * ufl.ln(J) ** 2
    return elastic + g * mu / 2 * (ufl.tr(C * ufl.inv(Cv)) - 3 - ufl.ln(ufl.det(C * ufl.inv(Cv))))


UNUSED = "the energy does not use the history; a term of Cv; or `next`, where it only counts"


def flows(C: Any, Cv: Any, tau: Any) -> Any:
    return {"Cv": (C - Cv) / tau}


ELSEWHERE: dict[str, dict[str, Any]] = {
    "quadratic": {"degree": 2},
    "plane stress": {"geometry": "plane-stress"},
    "plane strain": {"geometry": "plane-strain"},
    "axisymmetric": {"geometry": "axisymmetric"},
}


@pytest.mark.long
@pytest.mark.parametrize("name", ELSEWHERE)
def test_a_rate_in_python(name: str) -> None:
    """C - Cv - ... has the closed form Cv = (Cv_old + x C)/(1 + x), x = dt/tau, in any body."""
    keys = ELSEWHERE[name]
    constants = {"mu": 1.0, "lmbda": 2.0, "g": 1.5, "tau": TAU}
    start = {"Cv": np.eye(3)}
    own = Energy(zener, history=start, rate=flows, **constants)
    written = Energy(
        zener,
        history=start,
        residual=lambda C, Cv, Cv_old, dt, tau: {"Cv": (1 + dt / tau) * Cv - Cv_old - dt / tau * C},
        **constants,
    )

    def body(law: Any) -> Problem:
        if "geometry" not in keys:
            return held(law, **keys)
        supports = [
            Support(on="left", displacement=[0, FREE]),
            Support(on="bottom", displacement=[FREE, 0]),
            Support(on="top", displacement=[0.1, 0.3], curve=THERE_AND_BACK),
        ]
        plane = rectangle_body(size=(1, 1), cells=(2, 2))
        return Problem(plane, law, supports=supports, **keys)

    first, second = (forces(body(law), steps=5) for law in (own, written))
    assert first == pytest.approx(second, rel=1e-11, abs=1e-11 * np.abs(second).max())
    # a state at rest relaxes towards that without the branch
    del constants["tau"]
    elastic = forces(body(Energy(zener, history=start, next=lambda Cv: {"Cv": Cv}, **constants)))
    assert np.abs(first[1]).max() < np.abs(elastic[2]).max()


@pytest.mark.long
def test_a_stretch_that_is_held_relaxes() -> None:
    """Small strains: the force is that of dx/dt = -x/tau by backward Euler, 1/(1 + dt/tau)^n."""
    table = {
        "energy": "k/2*tr(eps)^2 + g*k/2*(tr(eps) - h)^2 + k*inner(dev(eps), dev(eps))",
        "history": {"h": 0},
        "rate": {"h": "(tr(eps) - h)/tau"},
        "parameters": {"k": "3 MPa", "g": 2, "tau": TAU},
    }
    sides = [Support(on=on, displacement=[FREE, 0, 0]) for on in ("front", "back")]
    moved = Support(on="right", displacement=[0.01, 0, 0], curve=[[0, 0], [0.1, 1], [1.1, 1]])
    law = law_of(table)
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1))
    everything = [Support(on=on, displacement=[FREE, 0, FREE]) for on in ("bottom", "top")]
    supports = [Support(on="left"), moved, *sides, *everything]
    problem = Problem(body, law, supports=supports, degree=1)
    found = [
        state.reactions["right"][0]
        for state in judged(Statics(problem, end=1.1, steps=11, rtol=1e-13))
    ]
    lasting = found[-1] - (found[-2] - found[-1]) * TAU / 0.1
    x = [(f - lasting) / (found[1] - lasting) for f in found[1:]]
    assert x == pytest.approx([(1 + 0.1 / TAU) ** -n for n in range(len(x))], rel=1e-8)
    assert x[-1] == pytest.approx(exp(-1 / TAU), rel=0.25)


SHEARED = {**MAXWELL["parameters"], "K": 1e-3}
"""Nearly without a stress of the volume."""
NORTON: dict[str, Any] = {
    "energy": "K/2*tr(eps)^2 + mu*inner(dev(eps) - ep, dev(eps) - ep)",
    "history": {"ep": "0"},
    "rate": {"ep": "3*mu*A/s0*(sqrt(6)*mu*norm(dev(eps) - ep)/s0)^(n - 1)*(dev(eps) - ep)"},
    "parameters": {"mu": 60e9, "K": 130e9, "A": "1e-9 1/s", "s0": "100 MPa", "n": 5},
}


@pytest.mark.long
def test_long_steps_of_a_rate_are_noted() -> None:
    """The estimate is the error of the branch in the second step of a ramp.

    After the first one, of backward Euler, the branch has y = x/(1 + x) of the strain of a step.
    """
    for x in (0.01, 0.1):
        y, rules = x / (1 + x), {"backward-euler": 0.1, "trapezoidal": 0.2}
        for rule, tolerance in rules.items():
            euler = rule == "backward-euler"
            # The strain grows by x in units of its rate times tau: dy/ds = 1 - y over s = x.
            branch = (y + x) / (1 + x) if euler else (y * (1 - x / 2) + x) / (1 + x / 2)
            whole = 2 * x + 2 * (y * exp(-x) + 1 - exp(-x))
            law = law_of({**MAXWELL, "parameters": SHEARED, "rate_integration": rule})
            exact = y * exp(-x) + 1 - exp(-x)
            found = error_of_rates(law)(x * TAU)
            assert found == pytest.approx(2 * abs(branch - exact) / whole, rel=tolerance)
    # The bulk modulus makes no difference, and steps much longer than the time are no better.
    stiff = error_of_rates(law_of({**MAXWELL, "parameters": {**SHEARED, "K": 1e4}}))
    loose = error_of_rates(law_of({**MAXWELL, "parameters": SHEARED}))
    assert stiff(0.5 * TAU) == pytest.approx(loose(0.5 * TAU), rel=1e-3)
    assert stiff(100 * TAU) > 0.9 * stiff(0.5 * TAU) > 0.02
    assert error_of_rates(law_of(J2))(1.0) == 0.0
    assert error_of_rates(law_of(NORTON))(900.0) < 1e-5


@pytest.mark.long
@pytest.mark.parametrize("rule", ["backward-euler", "trapezoidal"])
def test_creep_of_a_bar(rule: str) -> None:
    """Norton's law at a constant stress s, from rest at once: s/E + A (s/s0)^n t, at any step."""
    stress, young = 80e6, 9 * 60e9 * 130e9 / (3 * 130e9 + 60e9)
    rollers = [
        Support(on=on, displacement=[0 if i == j else FREE for j in range(3)])
        for i, on in enumerate(("left", "front", "bottom"))
    ]
    pulled = Traction(on="right", value=[stress, 0, 0], curve=[[0, 1], [3600, 1]])
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1))
    law = law_of({**NORTON, "rate_integration": rule})
    problem = Problem(body, law, supports=rollers, loads=[pulled], degree=1)
    for state in Statics(problem, end=3600, steps=4, rtol=1e-13).steps():
        if not state.step:
            continue
        expected = stress / young + 1e-9 * 0.8**5 * state.t
        moved = float(state.u.x.array.reshape(-1, 3)[:, 0].max(initial=0.0))
        found = MPI.COMM_WORLD.allreduce(moved, op=MPI.MAX)
        assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.long
def test_a_run_goes_on() -> None:
    """From a state between, through JSON: to round-off; dissipation never falls."""
    first, known, middle = Statics(held(law_of(MAXWELL)), steps=10, rtol=1e-13), [], None
    lost = 0.0
    for state in first.steps():
        known.append((reactions(state), state.energies))
        assert state.energies["dissipated"] >= lost
        lost = state.energies["dissipated"]
        if state.step == 5:
            middle = through_json(first.restart_state())
    again = list(Statics(held(law_of(MAXWELL)), steps=10, rtol=1e-13).steps(middle))
    assert len(again) == 5
    size = float(np.abs(known[-1][0]).max())
    for state, (force, energies) in zip(again, known[-5:], strict=True):
        assert reactions(state) == pytest.approx(force, rel=1e-12, abs=1e-12 * size)
        assert state.energies == pytest.approx(energies, rel=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("scheme", ["generalized-alpha", "central-differences"])
def test_in_motion(scheme: str) -> None:
    """The rate, and the same as equations, move alike."""
    body, bottom, moved = box_body(size=(1, 1, 1), cells=(1, 1, 1)), Support(on="bottom"), []
    equations = {**MAXWELL, "residual": {"Cv": f"Cv - Cv_old - dt*{MAXWELL['rate']['Cv']}"}}
    del equations["rate"]
    for table in (MAXWELL, equations):
        law = law_of({**table, "density": 0.5})
        problem = Problem(body, law, supports=[bottom], degree=1)
        step = {} if scheme == "central-differences" else {"dt": 0.02, "rtol": 1e-12}
        motion = Dynamics(problem, end=0.2, scheme=scheme, initial_velocity=["z", 0, 0], **step)
        *_, state = motion.steps()
        moved.append(state.u.x.array.copy())
    assert np.abs(moved[0]).max() > 0.05
    assert moved[0] == pytest.approx(moved[1], abs=1e-9 * np.abs(moved[1]).max())


@pytest.mark.long
def test_regions_of_unlike_memories() -> None:
    """A rate, equations, and an elastic region: ranks that lack one give the force of one rank."""
    soft = {**J2, "parameters": {"mu": 1.0, "K": 2.0, "sy": 0.05, "H": 0.1}}
    plain = {"law": "linear-elastic", "E": 1.0, "nu": 0.3}
    laws = {name: law_of(t) for name, t in zip("abc", (MAXWELL, soft, plain), strict=True)}
    moved = Support(on="right", displacement=[0.2, 0, 0], curve=THERE_AND_BACK)
    found = []
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        body = box_body(size=(3, 1, 1), cells=(3, 1, 1), comm=comm)
        x = body.mesh.geometry.x[body.mesh.geometry.dofmap].mean(axis=1)[:, 0]
        cells = [np.flatnonzero((x > i) & (x < i + 1)).astype(np.int32) for i in range(3)]
        body = body.named(regions=dict(zip("abc", cells, strict=True)))
        found.append(forces(Problem(body, laws, supports=[Support(on="left"), moved], degree=1)))
    assert np.abs(found[0]).max() > 0.01
    assert found[1] == pytest.approx(found[0], rel=1e-10, abs=1e-11)


@pytest.mark.long
def test_an_elastic_preload_has_not_yielded() -> None:
    """Forces on the history are not zero there, the history is."""
    problem = held(law_of({**J2, "density": 7800.0}), 1e-4)
    assert len(list(Modal(problem, count=1, preload=True).modes())) == 1


@pytest.mark.long
def test_a_point_without_a_root_is_named() -> None:
    """dh/dt = c exp(h) (J - 1)^2 with J - 1 = t/2 has no solution beyond c t^3/12 = 1, t = 0.84."""
    table = {
        "energy": "mu/2*(I1 - 3) - mu*ln(J) + k/2*ln(J)^2*exp(-h)",
        "history": {"h": 0},
        "rate": {"h": "c*exp(h)*(J - 1)^2"},
        "parameters": {"mu": 1.0, "k": 1.0, "c": 20},
    }
    rollers = [Support(on="left", displacement=[0, FREE, FREE])]
    rollers += [Support(on=on, displacement=[FREE, 0, FREE]) for on in ("front", "back")]
    rollers += [Support(on=on, displacement=[FREE, FREE, 0]) for on in ("bottom", "top")]
    pulled = Support(on="right", displacement=[0.5, FREE, FREE])
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1))
    problem = Problem(body, law_of(table), supports=[*rollers, pulled], degree=1)
    with pytest.raises(ConvergenceError) as caught:
        list(Statics(problem, steps=5).steps())
    text = str(caught.value)
    assert "the equations of its history have no root that Newton's method finds" in text
    assert "in 6 elements near (" in text
    # backward Euler, which takes the rate of a step's end, ends before
    assert 0.7 < float(text.split("beyond load factor ")[1].split(":", maxsplit=1)[0]) < 0.84


WRONG = {
    "a number": ({"rate": {"Cv": "J/tau"}}, "rate.Cv: a number; a tensor, as Cv is in history"),
    "sum": ({"rate": {"Cv": "(Cbar - J)/tau"}}, "rate.Cv: '-' between a tensor and a number"),
    "power": ({"rate": {"Cv": "Cbar^2/tau"}}, "rate.Cv: a power with a tensor; A*A is a product"),
    "root": ({"rate": {"Cv": "sqrt(Cbar)/tau"}}, "rate.Cv: 'sqrt' with a tensor"),
    "trace": ({"rate": {"Cv": "tr(J)*Cv/tau"}}, "rate.Cv: tr of a number; a tensor, as in tr(C)"),
    "unknown": ({"rate": {"Cw": "Cbar"}}, "rate.Cw: there is no history 'Cw'; known: Cv"),
    "name": ({"rate": {"Cv": "Cbar*Cw/tau"}}, "rate.Cv: unknown name 'Cw'"),
    "energy": ({"energy": "mu0*Cv*K*mu1*tau"}, "energy: a tensor; a number, for example tr(C)"),
    "unused": ({"energy": "mu0*(I1 - 3)*K*mu1*tau"}, f"energy: {UNUSED}"),
    "old": ({"parameters": {"Cv_old": 1.0}}, "parameters.Cv_old: the name 'Cv_old' is in use"),
    "both": ({"next": {"Cv": "Cv"}}, "rate: `next` beside `rate`"),
    "no history": ({"history": None}, "history: `rate` without a history"),
    "integration": (
        {**CLOSED, "rate": None, "rate_integration": "trapezoidal"},
        "rate_integration: `rate_integration` without a rate",
    ),
    "rule": ({"rate_integration": "midpoint"}, "rate_integration: 'midpoint' is wrong"),
    "slip": (
        {"energy": None, "energi": "J"},
        "energi: unknown key 'energi'; did you mean 'energy'?",
    ),
    "determinant": (
        {"history": {"Cv": {"start": "0", "determinant": 1}}},
        "history.Cv: {'start': '0', 'determinant': 1} is no start of a history",
    ),
    "small": (
        {"energy": "mu0*tr(eps)^2*K*mu1*tau", "history": None, "rate": None},
        "energy: a formula of eps without a history",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_input_is_refused(name: str) -> None:
    keys, text = WRONG[name]
    table = {key: value for key, value in {**MAXWELL, **keys}.items() if value is not None}
    with pytest.raises(InputError) as caught:
        law_of(table)
    assert text in str(caught.value).replace('"', "'")


# --- a branch far from equilibrium, built in ---

LARGE = {"viscous_deviation": "large", "viscous": [{"ratio": 2.0, "time": TAU}]}
RUBBER = {"law": "neo-hookean-split", "mu": 1.0, "K": 20.0, "volumetric": "quadratic"}


@pytest.mark.long
def test_the_built_in_branch_is_the_written_one() -> None:
    """Forces with the isochoric neo-Hookean law are those of `MAXWELL`, to round-off."""
    own, written = (forces(held(law_of(table))) for table in ({**RUBBER, **LARGE}, MAXWELL))
    assert own == pytest.approx(written, rel=1e-10, abs=1e-11 * np.abs(written).max())


@pytest.mark.long
def test_the_branch_beside_a_pressure() -> None:
    """nu = 0.5 and a pressure as an unknown: a square in plane strain, stretched and held."""
    law = law_of({"law": "neo-hookean-split", "mu": 1.0, "nu": 0.5, **LARGE})
    supports = [
        Support(on="left", displacement=[0, FREE]),
        Support(on="bottom", displacement=[FREE, 0]),
        Support(on="right", displacement=[0.5, FREE], curve=[[0, 0], [0.4, 1], [1, 1]]),
    ]
    body = rectangle_body(size=(1, 1), cells=(1, 1))
    problem = Problem(body, law, supports=supports, degree=2, geometry="plane-strain")
    assert problem.unknowns.has("pressure")
    point = PointOverSteps(law)
    assert isinstance(point.law, SteppedSplitLaw)
    shape = point.quantity(point.law.shape_stress(point.F))
    for state in judged(Statics(problem, steps=5, rtol=1e-13))[1:]:
        stretch = 1 + 0.5 * min(state.t / 0.4, 1)
        F = np.diag([stretch, 1 / stretch, 1])[None]
        P = shape(F, dt=0.2)[0]
        point.commit(F, dt=0.2)
        # no stress across; the pressure's part of P is p/stretch along and p stretch across
        expected = P[0, 0] - P[1, 1] / stretch**2
        assert state.reactions["right"][0] == pytest.approx(expected, rel=1e-10)


DEVIATING: dict[str, dict[str, Any]] = {
    "neo-hookean": {"law": "neo-hookean", "E": "1 MPa", "nu": 0.4},
    "ogden": {"law": "ogden", "mu": [5e5, -1e5], "alpha": [2.5, -3], "K": "20 MPa"},
    "gent": {"law": "gent", "mu": "0.3 MPa", "limit": 30, "K": "20 MPa"},
}


@pytest.mark.parametrize("name", DEVIATING)
def test_small_deviations_fade_as_those_of_a_series(name: str) -> None:
    """At strains of 1e-4 the stress is that of small deviations, but for the order of the step."""
    stresses = []
    for deviation in ("large", "small"):
        keys = {**DEVIATING[name], **LARGE, "viscous_deviation": deviation}
        point = PointOverSteps(law_of({**keys, "viscous_on": "isochoric"}))
        stress, F = point.quantity(point.law.stress(point.F)), (np.eye(3) + 1e-4 * GOAL)[None]
        found = []
        for dt in (1e-9, 0.1, 0.1):  # nearly at once, and held
            found.append(stress(F, dt=dt)[0])
            point.commit(F, dt=dt)
        stresses.append(found)
    (sudden, first, second), small = stresses
    size = np.abs(sudden).max()
    assert np.abs(sudden - small[0]).max() < 1e-3 * size
    # of backward Euler what is left of the branch is 1/(1 + x) in each step, x = dt/time
    x, left = 0.1 / TAU, sudden - first
    branch = left * (1 + x) / x
    assert second == pytest.approx(sudden - branch * (1 - (1 + x) ** -2), abs=1e-3 * size)
    assert np.abs(branch - (small[0] - small[1]) / (1 - exp(-x))).max() < 1e-3 * size


@pytest.mark.parametrize("name", DEVIATING)
def test_no_energy_is_won(name: str) -> None:
    """Of 200 bodies on random paths; the tangent is symmetric."""
    point, draw = PointOverSteps(law_of({**DEVIATING[name], **LARGE})), np.random.default_rng(4)
    H, variable = variables(point.F)
    tangent = point.quantity(ufl.diff(point.law.stress(variable), H))
    point.values = {n: np.repeat(v, 200, axis=0) for n, v in point.values.items()}
    for dt in (0.1, 0.003, 2.0, 0.5):
        F = np.eye(3) + 0.2 * draw.uniform(-1, 1, (200, 3, 3))
        assert point.found(F, dt=dt).all()
        A = tangent(F, dt=dt)
        assert np.abs(A - A.transpose(0, 3, 4, 1, 2)).max() < 1e-10 * np.abs(A).max()
        before = point.values["dissipated_density"]
        point.commit(F, dt=dt)
        assert (point.values["dissipated_density"] >= before).all()


def test_steps_much_longer_than_the_time_of_the_branch() -> None:
    """Creep over years with a branch of milliseconds: the stress is that without the branch."""
    law = law_of({**RUBBER, **LARGE, "viscous": [{"ratio": 2.0, "time": 1e-3}]})
    point, draw = PointOverSteps(law), np.random.default_rng(1)
    F = np.eye(3) + 0.2 * draw.uniform(-1, 1, (50, 3, 3))
    assert point.found(F, dt=3e7).all()
    P = point.quantity(point.law.stress(point.F))(F, dt=3e7)
    still = LawAtPoints(law_of(RUBBER)).stress(F)
    assert pytest.approx(still, abs=1e-8 * np.abs(still).max()) == P


REFUSED = {
    "two": ({"viscous": [{"ratio": 1, "time": 1}] * 2}, "viscous: 2 branches; one; several have"),
    "whole": ({"viscous_on": "whole"}, "viscous_on: the whole stress beside viscous_deviation"),
    "linear": (
        {"law": "linear-elastic", "mu": None, "K": None, "volumetric": None, "E": 1, "nu": 0.3},
        "viscous_deviation: the law 'linear-elastic' has no branch far from equilibrium",
    ),
    "alone": ({"viscous": None}, "viscous_deviation: nothing relaxes without `viscous`"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_deviate_is_refused(name: str) -> None:
    keys, text = REFUSED[name]
    table = {k: v for k, v in {**RUBBER, **LARGE, **keys}.items() if v is not None}
    with pytest.raises(InputError) as caught:
        law_of(table)
    assert text in str(caught.value)
