"""Von Mises plasticity at small and large strains, against closed forms and other integrators.

Uniaxial stress needs one equation of the axial plastic strain, which is solved here in NumPy.
"""

from __future__ import annotations

import logging
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from helpers.checkpoints import saved, through_json
from helpers.ranks import SIZES, on_ranks
from mpi4py import MPI

from dolfin_elastic import (
    J2,
    Case,
    Dynamics,
    Growth,
    J2Logarithmic,
    LinearElastic,
    Problem,
    Statics,
    Support,
    Traction,
    box_body,
    rectangle_body,
    run,
)
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.case.check.plausibility import plausibility_notes
from dolfin_elastic.core.errors import ConvergenceError, InputError
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.checkpoint.checkpoints import newest_checkpoint
from dolfin_elastic.solvers.assembly.assembler import compiled, integral
from dolfin_elastic.solvers.dynamics.settings import DynamicsSettings, refuse_memory

E, NU, YIELD = 200e9, 0.3, 250e6
FREE = "free"
ROUND = [[0, 0], [1, 0.006], [2, -0.006], [3, 0.004]]
"""Axial strain over time: the sign of the stress turns around twice."""
TABLE = [[0.0, YIELD], [0.001, 270e6], [0.003, 290e6], [0.02, 300e6]]
VOCE = {"saturation": 350e6, "rate": 200, "slope": 1e9}

Flow = Callable[[float], float]


def voce(a: float) -> float:
    return YIELD + 1e9 * a + (350e6 - YIELD) * (1 - np.exp(-200 * a))


HARDENING: dict[str, tuple[dict[str, Any], Flow]] = {
    "ideal": ({"yield_stress": YIELD}, lambda a: YIELD),
    "linear": ({"yield_stress": YIELD, "hardening": 2e9}, lambda a: YIELD + 2e9 * a),
    "table": ({"hardening": TABLE}, lambda a: float(np.interp(a, *np.transpose(TABLE)))),
    "voce": ({"yield_stress": YIELD, "hardening": VOCE}, voce),
}


def pulled(law: Law, curve: Any, **keys: Any) -> Problem:
    """A cube whose right side is moved by what a curve says, free to become thinner."""
    rollers = [
        Support(on=on, displacement=[0 if i == j else FREE for j in range(3)])
        for i, on in enumerate(("left", "front", "bottom"))
    ]
    moved = Support(on="right", displacement=[1, FREE, FREE], curve=curve)
    body = box_body(size=(1, 1, 1), cells=(2, 1, 1))
    return Problem(body, law, supports=[*rollers, moved], **{"degree": 1, **keys})


def axial(state: State) -> float:
    return float(state.reactions["right"][0])


class Bar:
    """Uniaxial stress: the plastic strain p and its length a, by bisection of the condition.

    Args:
        viscosity: eta [Pa s].
    """

    def __init__(self, flow: Flow, kinematic: float = 0.0, viscosity: float = 0.0) -> None:
        self.flow, self.kinematic, self.viscosity = flow, kinematic, viscosity
        self.p = self.a = 0.0

    def stress(self, strain: float, dt: float = 1.0) -> float:
        trial = E * (strain - self.p) - self.kinematic * self.p
        q, M = abs(trial), E + self.kinematic + self.viscosity / dt
        if q > self.flow(self.a):
            low, high = 0.0, q / M
            for _ in range(200):
                d = (low + high) / 2
                low, high = (d, high) if q - M * d > self.flow(self.a + d) else (low, d)
            self.p += low * np.sign(trial)
            self.a += low
        return E * (strain - self.p)


@pytest.mark.long
@pytest.mark.parametrize("kinematic", [0.0, 5e9])
@pytest.mark.parametrize("name", HARDENING)
def test_a_bar_is_pulled_and_pressed(name: str, kinematic: float) -> None:
    """Bauschinger's effect and all hardening; each step is exact, so that round-off is left."""
    keys, flow = HARDENING[name]
    bar = Bar(flow, kinematic)
    solver = Statics(
        pulled(J2(E=E, nu=NU, kinematic=kinematic, **keys), ROUND), end=3, steps=12, rtol=1e-13
    )
    for state in solver.steps():
        strain = float(np.interp(state.t, *np.transpose(ROUND)))
        assert axial(state) == pytest.approx(bar.stress(strain), rel=1e-11, abs=1e-11 * YIELD)
        assert state.numbers["max_plastic_strain"] == pytest.approx(bar.a, rel=1e-10, abs=1e-15)
        assert state.numbers["yielded_fraction"] == pytest.approx(float(bar.a > 0), abs=1e-12)
    assert bar.a > 0.01


@pytest.mark.parametrize("kinematic", [0.0, 5e9])
@pytest.mark.parametrize("name", HARDENING)
def test_a_bar_at_large_strains(name: str, kinematic: float) -> None:
    """The same law between Kirchhoff stress and logarithmic strain, 20 % out and 10 % in.

    P = tau over the stretch.  The logarithm's series ends at 1e-10 of the elastic strain.
    """
    keys, flow = HARDENING[name]
    bar, curve = Bar(flow, kinematic), [[0, 0], [1, 0.2], [2, -0.1]]
    problem = pulled(J2Logarithmic(E=E, nu=NU, kinematic=kinematic or None, **keys), curve)
    for state in Statics(problem, end=2, steps=20, rtol=1e-12).steps():
        stretch = 1 + float(np.interp(state.t, *np.transpose(curve)))
        expected = bar.stress(float(np.log(stretch))) / stretch
        assert axial(state) == pytest.approx(expected, rel=1e-8, abs=1e-8 * YIELD)
    assert bar.a > 0.4


@pytest.mark.long
@pytest.mark.parametrize("keys", [{"geometry": "plane-stress"}, {"formulation": "mixed"}])
def test_other_formulations(keys: dict[str, Any]) -> None:
    """The stretch out of the plane, or a pressure, is an unknown beside."""
    plane = keys.get("geometry") == "plane-stress"
    bar = Bar(HARDENING["linear"][1])
    law = J2(E=E, nu=NU, yield_stress=YIELD, hardening=2e9)
    if plane:
        body = rectangle_body(size=(1, 1), cells=(2, 1))
        supports = [
            Support(on="left", displacement=[0, FREE]),
            Support(on="bottom", displacement=[FREE, 0]),
            Support(on="right", displacement=[1, FREE], curve=ROUND),
        ]
        problem = Problem(body, law, supports=supports, degree=2, **keys)
    else:
        problem = pulled(law, ROUND, degree=2, **keys)
    for state in Statics(problem, end=3, steps=12, rtol=1e-12).steps():
        strain = float(np.interp(state.t, *np.transpose(ROUND)))
        assert axial(state) == pytest.approx(bar.stress(strain), rel=1e-9, abs=1e-9 * YIELD)


@pytest.mark.long
@pytest.mark.usefixtures("serial_only")
@pytest.mark.parametrize("kinematic", [0.0, 5e9])
@pytest.mark.parametrize("kind", [J2, J2Logarithmic])
@pytest.mark.parametrize("name", ["table", "voce"])
def test_the_tangent_is_symmetric_and_the_derivative(
    kind: type[Law], name: str, kinematic: float
) -> None:
    """From a yielded state: the stress is the derivative of what is stored and dissipated."""
    law = kind(E=E, nu=NU, kinematic=kinematic or None, **HARDENING[name][0])
    problem = pulled(law, [[0, 0], [1, 0.01]], degree=2)
    *_, _ = Statics(problem, steps=4).steps()
    energy, lost, force, tangent = compiled(
        problem,
        [
            problem.weak_form.strain_energy,
            problem.weak_form.of_steps(lambda law, F: law.lost(F)),
            problem.weak_form.internal,
            problem.weak_form.tangent,
        ],
    )
    rng = np.random.default_rng(0)
    u = problem.u.x.array.copy() + 0.002 * rng.standard_normal(len(problem.u.x.array))
    w, h = rng.standard_normal(len(u)), 1e-6

    def at(s: float) -> tuple[float, np.ndarray]:
        problem.u.x.array[:] = u + s * h * w
        return integral(problem, energy) + integral(problem, lost), fem.assemble_vector(force).array

    slope = (at(1)[0] - at(-1)[0]) / (2 * h)
    turn = (at(1)[1] - at(-1)[1]) / (2 * h)
    problem.u.x.array[:] = u
    K = fem.assemble_matrix(tangent).to_scipy()
    assert np.dot(fem.assemble_vector(force).array, w) == pytest.approx(slope, rel=1e-6)
    assert abs(K - K.T).max() <= 1e-12 * abs(K).max()
    # A few points pass a kink of the curve within h.
    assert np.abs(K @ w - turn).max() <= 1e-5 * np.abs(turn).max()


@pytest.mark.parametrize("kind", [J2, J2Logarithmic])
def test_newton_is_quadratic(kind: type[Law]) -> None:
    """The last residuals of a step in which all of a bent beam's root yields."""
    body = box_body(size=(4, 1, 1), cells=(8, 2, 2))
    law = kind(E=E, nu=NU, yield_stress=YIELD, hardening=1e9)
    supports = [
        Support(on="left"),
        Support(on="right", displacement=[FREE, FREE, -0.06]),
    ]
    *_, state = Statics(Problem(body, law, supports=supports), steps=3, rtol=1e-13).steps()
    r = [x for x in state.residuals if x > 1e-12 * state.residuals[0]][-3:]
    assert np.log(r[-1] / r[-2]) / np.log(r[-2] / r[-3]) > 1.6


@pytest.mark.parametrize("rate", [0.01, 0.1, 1.0])
def test_perzyna_to_first_order(rate: float) -> None:
    """A bar pulled to 1 %: the recursion of backward Euler, whose error halves with the step.

    Ideal: sigma' = E (e' - (sigma - yield)/eta) beyond the yield strain, an exponential.
    """
    eta, end, off = 2e10, 0.01 / rate, []
    since, tau = (0.01 - YIELD / E) / rate, eta / E
    exact = YIELD + eta * rate * -np.expm1(-since / tau)
    for steps in (100, 200):
        bar = Bar(lambda a: YIELD, viscosity=eta)
        law = J2(E=E, nu=NU, yield_stress=YIELD, plastic_viscosity=eta)
        solver = Statics(pulled(law, [[0, 0], [end, 0.01]]), end=end, steps=steps, rtol=1e-12)
        for state in solver.steps():
            if state.t > 0:
                again = bar.stress(rate * state.t, end / steps)
        assert axial(state) == pytest.approx(again, rel=1e-10)
        off.append(axial(state) / exact - 1)
        assert state.timed
        assert {"relaxing", "remembered"}.isdisjoint(state.energies)  # nothing has branches
    # Measured: 3e-5, 2.5e-3 and 4e-4 with 100 steps.
    assert 1.85 < off[0] / off[1] < 2.2
    assert abs(2 * off[1] - off[0]) < 1e-5


def test_perzyna_to_second_order() -> None:
    """The same with the trapezoidal rule: 1e-6 in 240 steps, of which each doubling makes 1/4."""
    eta, rate, end, hard = 2e10, 0.1, 0.1, 2e9
    since, k = (0.01 - YIELD / E) / rate, (E + hard) / eta
    exact = E * (0.01 - E * rate / (E + hard) * (since + np.expm1(-k * since) / k))
    law = J2(
        E=E,
        nu=NU,
        yield_stress=YIELD,
        hardening=hard,
        plastic_viscosity=eta,
        rate_integration="trapezoidal",
    )
    problem = pulled(law, [[0, 0], [end, 0.01]])
    off = []
    for steps in (120, 240):
        *_, state = Statics(problem, end=end, steps=steps, rtol=1e-12).steps()
        off.append(axial(state) / exact - 1)
    assert abs(off[1]) < 1e-6
    assert off[0] / off[1] == pytest.approx(4, rel=0.02)


def test_unloading_leaves_residual_stress_and_set() -> None:
    """Pulled to 1 %, let go: the strain that is left is the plastic one, without stress."""
    law = J2(E=E, nu=NU, yield_stress=YIELD, hardening=2e9)
    bar = Bar(HARDENING["linear"][1])
    peak = bar.stress(0.01)
    curve = [[0, 0], [1, 0.01], [2, 0.01 - peak / E]]
    *_, state = Statics(pulled(law, curve), end=2, steps=8).steps()
    assert abs(axial(state)) < 1e-9 * YIELD


@pytest.mark.parametrize("kind", [J2, J2Logarithmic])
def test_energy_balances(kind: type[Law]) -> None:
    """Work of the forces = stored + dissipated, to 4e-6 in 800 steps, and heat never falls.

    The work is that of the trapezoidal rule in each step, whose error falls with the square.
    """
    curve = [[0, 0], [1, 0.02], [2, 0.01]]
    problem = pulled(kind(E=E, nu=NU, yield_stress=YIELD, hardening=2e9), curve)
    work = last = moved = 0.0
    heat = [0.0]
    for state in Statics(problem, end=2, steps=800).steps():
        now, x = axial(state), float(np.interp(state.t, *np.transpose(curve)))
        work += (now + last) / 2 * (x - moved)
        last, moved = now, x
        heat.append(state.energies["dissipated"])
    assert state.energies["strain"] == pytest.approx(work, rel=4e-6)
    assert min(np.diff(heat)) >= -1e-12 * heat[-1]


@pytest.mark.parametrize(
    ("kind", "keys"),
    [
        (J2, {"kinematic": 5e9}),
        (J2, {"plastic_viscosity": 1e9, "rate_integration": "trapezoidal"}),
        (
            J2Logarithmic,
            {"plastic_viscosity": 1e9, "rate_integration": "trapezoidal", "kinematic": 5e9},
        ),
    ],
)
def test_a_run_goes_on(kind: type[Law], keys: dict[str, Any], comm: MPI.Comm) -> None:
    """Restarted amid loading, the rest of a run is the same to 1e-12."""

    def solver() -> Statics:
        law = kind(E=E, nu=NU, yield_stress=YIELD, hardening=2e9, **keys)
        return Statics(pulled(law, ROUND), end=3, steps=12, rtol=1e-13)

    whole = [axial(state) for state in solver().steps()]
    first, saved = solver(), None
    for state in first.steps():
        if state.step == 5:
            saved = through_json(first.restart_state())
            break
    assert saved is not None
    rest = [axial(state) for state in solver().steps(saved)]
    np.testing.assert_allclose(rest[-6:], whole[-6:], rtol=1e-12, atol=1e-12 * YIELD)


@pytest.mark.parametrize("scheme", ["newmark", "generalized-alpha"])
def test_motion(scheme: str) -> None:
    """A bar shaken slowly has the stress of statics.

    Without inertia to speak of, what is across alternates about equilibrium for some steps of the
    generalized-alpha scheme: 0.8 % are left.
    """
    law = J2(E=E, nu=NU, yield_stress=YIELD, hardening=2e9, density=1e-3)
    curve, bar = [[0, 0], [1, 0.006], [2, -0.006]], Bar(HARDENING["linear"][1])
    solver = Dynamics(pulled(law, curve), scheme=scheme, end=2, dt=0.05, adaptive=False)
    *_, final = solver.steps()
    bar.stress(0.006)
    within = 1e-3 if scheme == "newmark" else 1e-2
    assert axial(final) == pytest.approx(bar.stress(-0.006), rel=within)


@pytest.mark.parametrize("kind", [J2, J2Logarithmic])
def test_a_motion_begins_where_the_problem_is(kind: type[Law]) -> None:
    """Displaced as statics has left it, and with the plastic strain of that."""
    problem = pulled(kind(E=E, nu=NU, yield_stress=YIELD, density=1e-3), [[0, 0.006], [1, 0.006]])
    *_, held = Statics(problem, steps=2, rtol=1e-12).steps()
    first = next(iter(Dynamics(problem, end=1, dt=0.25).steps()))
    assert first.numbers["max_plastic_strain"] == pytest.approx(
        held.numbers["max_plastic_strain"], rel=1e-9
    )
    assert first.max_displacement == pytest.approx(held.max_displacement, rel=1e-12)
    with pytest.raises(InputError, match="dynamics.start: results do not hold"):
        refuse_memory(DynamicsSettings(end=1, dt=1, start={"file": "there"}), timed=False)


@pytest.mark.parametrize("kind", [J2, J2Logarithmic])
def test_growth_is_no_plastic_strain(kind: type[Law]) -> None:
    """A body that grows freely does not yield; one that is held does, and the heat is told.

    Uniaxial stress at a growth of 2 % against rollers on all sides but one direction.
    """
    law = kind(E=E, nu=NU, yield_stress=YIELD)
    grown = [Growth(value=[1.02, 1.0, 1.0])]
    rollers = [
        Support(on=on, displacement=[0 if i == j else FREE for j in range(3)])
        for i, on in enumerate(("left", "front", "bottom"))
    ]
    held = Support(on="right", displacement=[0, FREE, FREE])
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1))
    *_, free = Statics(Problem(body, law, supports=rollers, loads=grown), steps=2).steps()
    assert free.numbers["yielded_fraction"] == free.numbers["max_plastic_strain"] == 0.0
    *_, stopped = Statics(
        Problem(body, law, supports=[*rollers, held], loads=grown), steps=2
    ).steps()
    assert stopped.numbers["yielded_fraction"] == pytest.approx(1.0, rel=1e-12)
    strain = (0.02 if kind is J2 else np.log(1.02)) - YIELD / E
    assert stopped.numbers["max_plastic_strain"] == pytest.approx(strain, rel=1e-6)
    heat = YIELD * strain * (1.0 if kind is J2 else 1.02)  # of the grown volume
    assert stopped.energies["dissipated"] == pytest.approx(heat, rel=1e-6)


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"yield": -1}, "yield"),
        ({}, "yield: the key is missing"),
        ({"yield": YIELD, "hardening": -1.0}, "hardening: .* soften"),
        ({"yield": YIELD, "hardening": TABLE}, "beside a table"),
        ({"hardening": [[0.1, YIELD]]}, "begins at a plastic strain of 0.1"),
        ({"hardening": [[0, YIELD], [0.1, 3e8], [0.1, 4e8]]}, "plastic strain 0.1 follows 0.1"),
        ({"hardening": [[0, YIELD], [0.1, 2e8]]}, "falls at a plastic strain of 0.1"),
        ({"hardening": [[0, 0], [0.1, 2e8]]}, "not positive"),
        ({"yield": YIELD, "hardening": {"saturation": 2e8, "rate": 10}}, "fall to its saturation"),
        ({"yield": YIELD, "hardening": {"saturation": 3e8}}, "both saturation and rate"),
        ({"yield": YIELD, "hardening": {"saturation": 3e8, "rate": 2e5}}, "43.3 times as fast"),
        ({"yield": "2e8+0*x", "hardening": {"saturation": 3e8, "rate": 2}}, "vary in space"),
        ({"yield": YIELD, "hardening": {"table": TABLE, "rate": 1}}, "table beside the constants"),
        ({"yield": YIELD, "plastic_viscosity": 0}, "plastic_viscosity"),
        ({"yield": YIELD, "viscous": [{"ratio": 0.1, "time": 1}]}, "viscous: .* cannot relax"),
    ],
)
def test_constants_are_checked(keys: dict[str, Any], text: str) -> None:
    for kind in (J2, J2Logarithmic):
        with pytest.raises(InputError, match=text):
            kind(E=E, nu=NU, **keys)


def test_a_yield_stress_without_its_unit_is_noted() -> None:
    """235 of a data sheet in MPa."""
    steel = {"law": "j2", "E": "210 GPa", "nu": 0.3, "yield": 235}
    box = {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}}
    case = Case.from_dict({"mesh": box, "materials": {"steel": steel}, "support": [{"on": "left"}]})
    (note,) = (n for n in plausibility_notes(case, case.read_body()) if "yield" in n)
    assert note.startswith("materials.steel.yield: 235 Pa beside a Young's modulus of 210 GPa")
    assert 'did you mean "235 MPa"?' in note


@pytest.mark.parametrize("degree", [1, 2])
def test_linear_elements_are_noted(degree: int) -> None:
    """They lock where the material yields; quadratic ones, the default, do not."""
    text = f"""
        [mesh]
        box = {{ size = [1, 1, 1], cells = [1, 1, 1] }}
        degree = {degree}

        [materials.steel]
        law = "j2"
        E = {E}
        nu = {NU}
        yield = {YIELD}

        [[support]]
        on = "left"
        """
    case = Case.from_dict(tomllib.loads(text))
    notes = check(case, case.read_body())
    assert any("linear elements lock" in note for note in notes) == (degree == 1)


def test_a_formula_that_softens_is_refused() -> None:
    """As a number is: on the mesh, where its values are known."""
    law = J2(E=E, nu=NU, yield_stress=YIELD, hardening="-1e9 + 0*x")
    with pytest.raises(InputError, match="hardening"):
        pulled(law, [[0, 0], [1, 0.01]])


def test_plane_stress_at_large_strains_is_refused() -> None:
    body = rectangle_body(size=(1, 1), cells=(2, 1))
    law = J2Logarithmic(E=E, nu=NU, yield_stress=YIELD)
    with pytest.raises(InputError, match="mesh.geometry: the law 'j2-logarithmic'"):
        Problem(body, law, geometry="plane-stress")


def test_large_steps_of_a_bent_beam_are_no_jump() -> None:
    """The audit allows for the path within a step, which backward Euler does not know."""
    body = rectangle_body(size=(6, 1), cells=(12, 2))
    law = J2Logarithmic(E=E, nu=NU, yield_stress=YIELD, hardening=1e9)
    supports = [Support(on="left"), Support(on="right", displacement=[FREE, -1.5])]
    states = list(Statics(Problem(body, law, supports=supports), steps=8).steps())
    assert all(state.audit is None or not state.audit.reasons for state in states)


@pytest.mark.long
def test_a_limit_load_is_told() -> None:
    """A cantilever under twice the force of its plastic hinge: why it ends, and what to do."""
    body = rectangle_body(size=(8, 1), cells=(16, 4))
    down = Traction(on="right", value=[0, -2 * 2 / 3**0.5 * YIELD / 4 / 8])
    problem = Problem(
        body, J2(E=E, nu=NU, yield_stress=YIELD), supports=[Support(on="left")], loads=[down]
    )
    with pytest.raises(ConvergenceError, match="of the volume yields") as caught:
        list(Statics(problem, steps=4).steps())
    found = re.search(r"beyond load factor ([0-9.]+)", str(caught.value))
    assert found
    # Forces alone would make 0.5; the wall holds the corners, and elements across are four.
    assert 0.5 < float(found[1]) < 0.6


@pytest.mark.long
def test_a_plateau_has_no_limit_points(caplog: pytest.LogCaptureFixture) -> None:
    """An ideally plastic bar by arc length: the load stays, to round-off, and nothing branches."""
    rollers = [
        Support(on=on, displacement=[0 if i == j else FREE for j in range(3)])
        for i, on in enumerate(("left", "front", "bottom"))
    ]
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1))
    pull = Traction(on="right", value=[1.5 * YIELD, 0, 0])
    law = J2(E=E, nu=NU, yield_stress=YIELD)
    problem = Problem(body, law, supports=rollers, loads=[pull])
    solver = Statics(problem, method="arc-length", max_displacement=0.05)
    with caplog.at_level(logging.WARNING):
        *_, state = solver.steps()
    assert state.load_factor == pytest.approx(1 / 1.5, rel=1e-6)
    assert state.max_displacement > 0.04
    assert "bifurcation" not in caplog.text


@pytest.mark.parametrize("law", ["j2", "j2-logarithmic"])
def test_a_run_with_all_that_it_tells(law: str, tmp_path: Path, comm: MPI.Comm) -> None:
    """Recovered stress and its error compile in seconds: all have one F, not equal ones."""
    text = f"""
        [mesh]
        box = {{ size = [4, 1, 0.5], cells = [4, 1, 1] }}

        [materials.steel]
        law = "{law}"
        E = {E}
        nu = {NU}
        yield = {YIELD}
        hardening = 1e9
        allowable = {YIELD}

        [[support]]
        on = "left"

        [[support]]
        on = "right"
        displacement = ["free", 0, -0.1]

        [statics]
        steps = 2

        [output]
        fields = ["displacement", "von_mises", "plastic_strain"]
        """
    folder = comm.bcast(tmp_path / "results")
    *_, state = run(Case.from_dict(tomllib.loads(text)), output=folder)
    assert state.numbers["yielded_fraction"] > 0.1
    assert state.audit is not None
    assert state.audit.verdict == "pass"


@pytest.mark.long
def test_three_materials_side_by_side() -> None:
    """One elastic, one viscous, one plastic, sheared together and held: stresses add up.

    Steps of constant rate are exact in all of them.
    """
    body = box_body(size=(1, 3, 1), cells=(1, 3, 1))
    middle = body.mesh.geometry.x[body.mesh.geometry.dofmap].mean(axis=1)[:, 1]
    names = ("elastic", "viscous", "plastic")
    cells = [np.flatnonzero(middle.astype(int) == i).astype(np.int32) for i in range(3)]
    mu, rate = E / 2 / (1 + NU), 0.004
    laws = {
        "elastic": LinearElastic(E=E, nu=NU),
        "viscous": LinearElastic(E=E, nu=NU, viscous=[{"ratio": 0.5, "time": 1.0}]),
        "plastic": J2(E=E, nu=NU, yield_stress=YIELD),
    }
    curve = [[0, 0], [1, 1], [2, 1]]
    sides = ["left", "right", "front", "back", "bottom", "top"]
    supports = [
        Support(on=sides, displacement=[f"{rate}*z", 0, 0], curve=curve),
        Support(on="top", displacement=[rate, 0, 0], curve=curve),
    ]
    named = body.named(regions=dict(zip(names, cells, strict=True)))
    problem = Problem(named, laws, supports=supports, degree=1)
    for state in Statics(problem, end=2, steps=10, rtol=1e-13).steps():
        strain = rate * min(state.t, 1.0)
        fading = 1 - np.exp(-state.t) if state.t < 1 else np.exp(-state.t) * (np.e - 1)
        viscous = mu * (strain + 0.5 * rate * fading)
        expected = mu * strain + viscous + min(mu * strain, YIELD / 3**0.5)
        found = float(state.reactions["top"][0])
        assert found == pytest.approx(expected, rel=1e-10, abs=1e-10 * YIELD)
    assert state.numbers["yielded_fraction"] == pytest.approx(1 / 3, rel=1e-12)


@pytest.mark.parametrize("kind", [J2, J2Logarithmic])
def test_from_two_ranks_to_three_to_one(kind: type[Law], tmp_path: Path, comm: MPI.Comm) -> None:
    """A third of a bent bar's way out and back on each, as far as there are so many."""
    folder = comm.bcast(tmp_path)

    def solver(part: MPI.Comm) -> Statics:
        body = rectangle_body(size=(4, 1), cells=(6, 2), comm=part)
        down = [[0, 0], [1, -0.04], [2, 0.02]]  # small steps: none is cut where Newton fails
        supports = [Support(on="left"), Support(on="right", displacement=[FREE, 1], curve=down)]
        law = kind(E=E, nu=NU, yield_stress=YIELD, hardening=2e9)
        return Statics(Problem(body, law, supports=supports), end=2, steps=12, rtol=1e-12)

    def force(state: State) -> float:
        return float(state.reactions["right"][1])

    def third(part: MPI.Comm) -> list[float]:
        solving, found = solver(part), newest_checkpoint(part, folder)
        forces: list[float] = []
        states = solving.steps() if found is None else solving.steps(found)
        for state in states:
            if state.step:
                forces.append(force(state))
            if len(forces) == 4 and state.step < 12:
                saved(part, folder, solving.restart_state(), state.step)
                break
        states.close()
        return forces

    known = on_ranks(1, lambda part: [force(s) for s in solver(part).steps() if s.step])
    order = [SIZES[-1 if len(SIZES) < 3 else 1], SIZES[-1], 1]
    found = [one for count in order for one in on_ranks(count, third)]
    # Newton's tolerance of each step is 1e-12 of its forces.
    np.testing.assert_allclose(found, known, rtol=0, atol=1e-9 * np.abs(known).max())
