"""Cases on which static solvers break: each ends with the right answer, or with the right cause."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
import ufl
from helpers.states import last

from dolfin_elastic import (
    Contact,
    Energy,
    FixedCorotated,
    Gent,
    Gravity,
    LinearElastic,
    NeoHookean,
    NeoHookeanSplit,
    Problem,
    Statics,
    StVenantKirchhoff,
    Support,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.errors import ConvergenceError, InputError
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.problem.state import State

E, NU = 1e6, 0.3
FREE = "free"
NH = NeoHookean(E=E, nu=NU)


def failure(
    problem: Problem, *causes: str, **settings: Any
) -> tuple[list[State], ConvergenceError]:
    """All states before the error, and the error, whose cause is one of those given."""
    states: list[State] = []
    with pytest.raises(ConvergenceError) as caught:
        states.extend(Statics(problem, **settings).steps())
    assert caught.value.diagnosis is not None
    assert caught.value.diagnosis.cause in causes, caught.value
    return states, caught.value


def square(law: Law, *supports: Support, loads: Any = (), n: int = 4, **more: Any) -> Problem:
    body = rectangle_body(size=(1, 1), cells=(n, n))
    return Problem(body, law, supports=supports, loads=loads, **{"degree": 1, **more})


def squeezed(law: Law, by: float, **more: Any) -> Problem:
    """Between two plates that hold its ends: the upper one comes down."""
    return square(law, Support(on="bottom"), Support(on="top", displacement=[0, -by]), **more)


def column(factor: float, side: float = 0.0) -> Problem:
    """Clamped below, free above, L/h = 10, under `factor` times Euler's load and a side load."""
    euler = np.pi**2 * E / (1 - NU**2) / 12 / 4 / 100
    body = rectangle_body(size=(1, 10), cells=(2, 20))
    return Problem(
        body,
        NH,
        degree=2,
        supports=[Support(on="bottom")],
        loads=[Traction(on="top", value=[side * euler, -factor * euler])],
    )


# --- steps that are too large ---


def test_stretched_to_four_times_its_length_at_once():
    make = lambda: square(NH, Support(on="left"), Support(on="right", displacement=[3, 0]))  # noqa: E731
    # The same equilibrium to Newton's tolerance, quadratically below 1e-8.
    assert last(make(), steps=1).energies["strain"] == pytest.approx(
        last(make(), steps=20).energies["strain"], rel=1e-8
    )


@pytest.mark.parametrize("law", [NH, FixedCorotated(E=E, nu=NU)])
def test_squeezed_to_a_third_at_once(law):
    """Also a law that has no barrier at J = 0 and would let cells turn inside out."""
    hasty, patient = last(squeezed(law, 0.7), steps=1), last(squeezed(law, 0.7), steps=20)
    assert hasty.energies["strain"] == pytest.approx(patient.energies["strain"], rel=1e-8)


def test_pressed_through_zero_volume():
    """A law that survives inversion goes on: uniaxial strain, P = (lmbda + 2 mu) (F22 - 1)."""
    supports = [
        Support(on="bottom", displacement=["free", 0]),
        Support(on=["left", "right"], displacement=[0, "free"]),
        Support(on="top", displacement=["free", -1.05]),
    ]
    state = last(square(FixedCorotated(E=E, nu=NU), *supports))
    stiffness = E * (1 - NU) / (1 + NU) / (1 - 2 * NU)
    assert state.reactions["top"][1] == pytest.approx(-1.05 * stiffness, rel=1e-8)
    assert state.audit.inverted == 32
    assert any(
        "32 of 32 elements inverted, smallest det F = -0.05" in r for r in state.audit.reasons
    )
    assert state.audit.verdict == "warn"


def test_a_sliver_is_named():
    """Cells of one to fifty that other laws do not let pass: their quality, and what to do."""
    body = rectangle_body(size=(1, 0.02), cells=(4, 4))
    supports = [Support(on="bottom"), Support(on="top", displacement=[0, -0.024])]
    problem = Problem(body, NH, supports=supports, degree=1)
    _, error = failure(problem, "inverted")
    assert re.search(r"it is a sliver: its quality is 0\.0\d", str(error))
    assert "mesh anew without such slivers" in error.advice
    assert "fixed-corotated" in error.advice


def test_twisted_by_150_degrees_at_once():
    """A full step finds an equilibrium with folded layers, of much more energy: not taken."""
    angle = "150/180*pi*t"
    turned = [
        f"(x - 0.5)*(cos({angle}) - 1) - (y - 0.5)*sin({angle})",
        f"(x - 0.5)*sin({angle}) + (y - 0.5)*(cos({angle}) - 1)",
        0,
    ]
    found = []
    for steps in (1, 15):
        body = box_body(size=(1, 1, 4), cells=(2, 2, 8))
        supports = [Support(on="bottom"), Support(on="top", displacement=turned)]
        found.append(
            last(Problem(body, NH, supports=supports, degree=1), steps=steps).energies["strain"]
        )
    assert found[0] == pytest.approx(found[1], rel=1e-8)


def test_a_slender_beam_bent_by_more_than_its_length():
    """L/h = 100 under ten times EI/L^2 and more: the tip points along the force."""
    body = rectangle_body(size=(100, 1), cells=(50, 1))
    load = Traction(on="right", value=[0, -1e-4 * E])
    beam = Problem(body, NH, degree=2, supports=[Support(on="left")], loads=[load])
    state = last(beam)
    assert state.load_factor == 1.0
    assert state.negative == 0
    force = state.reactions["left"]
    assert force == pytest.approx([0, 1e-4 * E], abs=1e-5)  # rtol 1e-8 of reactions of 1e2 N


# --- stability ---


def test_a_straight_column_buckles():
    """What an imperfection of a thousandth finds, the perfectly straight column finds, too."""
    straight, crooked = last(column(1.5)), last(column(1.5, 1e-5))
    assert straight.negative == crooked.negative == 0
    # The side load moves the energy by its share of the work, 1e-5.
    assert straight.energies["strain"] == pytest.approx(crooked.energies["strain"], rel=1e-3)
    assert straight.max_displacement > 5.0


def test_a_slender_column_buckles_once_and_for_all():
    """L/h = 100: small pushes come back to the straight, unstable column, which is not accepted.

    Under 1.5 times Euler's load the elastica's tip has gone by more than 0.7 of its length.
    """
    length, euler = 100.0, np.pi**2 * E / (1 - NU**2) / 12 / 4 / 100**2
    problem = Problem(
        rectangle_body(size=(1, length), cells=(1, 30)),
        NH,
        degree=2,
        supports=[Support(on="bottom")],
        loads=[Traction(on="top", value=[0, -1.5 * euler])],
    )
    states = list(Statics(problem).steps())
    assert {state.negative for state in states[1:]} == {0}
    straight = [state for state in states if state.max_displacement < 1e-3 * length]
    assert straight[-1].load_factor < 1.01 / 1.5
    (limit,), (error,) = states[-1].limit_points, states[-1].limit_errors
    assert limit == pytest.approx(1 / 1.5, rel=0.01, abs=error)
    assert straight[-1].limit_points == ()
    assert states[-1].max_displacement > 0.7 * length


def test_a_crooked_column_is_not_found_on_its_other_side():
    """Large steps would end on the branch that bends against its imperfection: unstable."""
    hasty, patient = last(column(1.5, 1e-3), steps=1), last(column(1.5, 1e-3), steps=40)
    assert hasty.energies["strain"] == pytest.approx(patient.energies["strain"], rel=1e-6)


def test_a_column_below_its_load_stays_straight():
    state = last(column(0.9))
    assert state.negative == 0
    assert state.max_displacement < 0.1


@pytest.mark.long
def test_a_material_that_gives_way_in_compression():
    """St. Venant-Kirchhoff bears no more than E s (s^2 - 1)/2 at s = 1/sqrt(3)."""
    limit = E / (1 - NU**2) / (3 * np.sqrt(3))
    free = square(
        StVenantKirchhoff(E=E, nu=NU),
        Support(on="left", displacement=[0, FREE]),
        Support(on="bottom", displacement=[FREE, 0]),
        loads=[Traction(on="right", value=[-2 * limit, 0])],
        n=2,
    )
    states, error = failure(free, "unstable")
    assert 0.49 <= states[-1].load_factor <= 0.5
    assert error.exit_code == 3


# --- beyond what a material can ---


@pytest.mark.long
@pytest.mark.parametrize("law", [NH, StVenantKirchhoff(E=E, nu=NU)])
def test_squeezed_through_itself(law):
    """A plate that goes below the other one: no equilibrium without inverted cells is found."""
    # Laws without a barrier give way before their cells are flat.
    states, _ = failure(squeezed(law, 1.2), "inverted" if law is NH else "unstable")
    assert states[-1].load_factor < 1 / 1.2


@pytest.mark.long
def test_squeezed_through_itself_by_a_law_that_survives():
    """It goes on, with cells that are inverted, and says so."""
    state = last(squeezed(FixedCorotated(E=E, nu=NU), 1.2))
    assert state.load_factor == 1.0
    assert state.audit.verdict == "warn"
    assert state.audit.inverted > 0
    assert any("elements inverted, smallest det F = -" in reason for reason in state.audit.reasons)


@pytest.mark.long
def test_stretched_beyond_the_limit_of_its_chains():
    """Gent's stress is finite, and wrong, beyond the limit; its energy is not."""
    body = square(
        Gent(mu=1e5, limit=0.5, nu=0.4),
        Support(on="left"),
        Support(on="right", displacement=[1.5, 0]),
    )
    states, _ = failure(body, "nan")
    assert all(np.isfinite(state.energies["strain"]) for state in states)
    assert states[-1].load_factor < 0.6


def test_paths_by_their_length_end_where_the_load_does():
    """Following the path by its length lets nothing pass that growing load does not."""
    chains = square(
        Gent(mu=1e5, limit=0.5, nu=0.4),
        Support(on="left"),
        Support(on="right", displacement=[1.5, 0]),
    )
    states, _ = failure(chains, "nan", method="arc-length")
    assert all(np.isfinite(state.energies["strain"]) for state in states)
    linear = squeezed(LinearElastic(E=E, nu=NU), 1.5)
    states, error = failure(linear, "inverted", method="arc-length")
    assert all(state.audit.min_jacobian > 0 for state in states)
    assert "arc-length" not in str(error)


def test_far_too_heavy():
    """Jelly of 1 Pa under its weight of 10 kPa/m: no smallest step helps, and it does not hang."""
    soft = NeoHookean(E=1.0, nu=NU, density=1000)
    states, _ = failure(square(soft, Support(on="bottom"), loads=[Gravity()]), "inverted")
    assert states[-1].load_factor == 0.0


def test_an_energy_with_a_logarithm_that_ends():
    """The energy of the user's own has no value beyond a stretch of 1.5."""
    law = Energy(
        lambda I1, J, mu: (
            mu / 2 * (I1 - 3 - 2 * ufl.ln(J) + ufl.ln(J) ** 2 - ufl.ln(1 - (I1 - 3) ** 2 / 4))
        ),
        mu=1e5,
    )
    pulled = square(law, Support(on="left"), Support(on="right", displacement=[2, 0]))
    states, _ = failure(pulled, "nan")
    assert states[-1].load_factor < 0.75


# --- numbers ---


@pytest.mark.parametrize("nu", [0.4999, 0.499999])
def test_hardly_compressible_in_displacements(nu):
    """Near nu = 1/2 as at it, to the compressibility left.

    With g = J - 1, the constraint at nu = 1/2: another g has another limit on a given mesh.
    """
    law = NeoHookeanSplit(mu=1e5, nu=nu, volumetric="quadratic")
    locked = last(squeezed(law, 0.2, degree=2, formulation="mixed"))
    exact = last(squeezed(NeoHookeanSplit(mu=1e5, nu=0.5), 0.2, degree=2))
    assert locked.energies["strain"] == pytest.approx(exact.energies["strain"], rel=20 * (0.5 - nu))


def test_stiffness_that_differs_by_a_hundred_million():
    """Steel beside jelly: the jelly takes up all of the motion, and Newton converges."""
    body = rectangle_body(size=(2, 1), cells=(8, 4))
    middle = body.mesh.geometry.x[body.mesh.geometry.dofmap].mean(axis=1)[:, 0]
    cells = np.arange(len(middle), dtype=np.int32)
    two = body.named(regions={"stiff": cells[middle < 1], "soft": cells[middle > 1]})
    laws = {"stiff": NeoHookean(E=1e8 * E, nu=NU), "soft": NH}
    supports = [Support(on="left"), Support(on="right", displacement=[0.3, 0])]
    state = last(Problem(two, laws, supports=supports, degree=1))
    alone = square(NH, Support(on="left"), Support(on="right", displacement=[0.3, 0]))
    # The stiff half moves by 1e-8 of the whole.
    assert state.energies["strain"] == pytest.approx(last(alone).energies["strain"], rel=1e-6)


def test_a_soft_part_is_not_excused_by_a_stiff_one():
    """Steel and gel, 2e9 to 1, pulled gently: the gel's forces balance as if it were alone."""
    body = rectangle_body(size=(2, 1), cells=(8, 4))
    middle = body.mesh.geometry.x[body.mesh.geometry.dofmap].mean(axis=1)[:, 0]
    cells = np.arange(len(middle), dtype=np.int32)
    two = body.named(regions={"stiff": cells[middle < 1], "soft": cells[middle > 1]})
    laws = {"stiff": NeoHookean(E=2e11, nu=NU), "soft": NeoHookean(E=1e2, nu=NU)}
    pull = Traction(on="right", value=[0, 5.0])
    state = last(
        Problem(two, laws, supports=[Support(on="left")], loads=[pull], degree=1), steps=10
    )
    gel = Problem(
        rectangle_body(size=(1, 1), cells=(4, 4)),
        NeoHookean(E=1e2, nu=NU),
        supports=[Support(on="left")],
        loads=[pull],
        degree=1,
    )
    # Round-off of the steel's rows, eps 2e11 N, is 1e-5 of the load; the steel moves by 1e-9.
    assert state.max_displacement == pytest.approx(last(gel).max_displacement, rel=2e-8)


def test_nothing_to_do():
    state = last(square(NH, Support(on="left")))
    assert state.max_displacement == 0.0


def test_loaded_and_unloaded():
    """Forth and back: nothing is left of an elastic deformation."""
    there = Traction(on="right", value=[0.3 * E, 0.1 * E], curve=[[0, 0], [0.5, 1], [1, 0]])
    state = last(square(NH, Support(on="left"), loads=[there]), times=[0.5])
    assert state.max_displacement < 1e-8  # rtol of the residual over the stiffness


# --- what cannot be ---


def test_nothing_holds_it():
    with pytest.raises(InputError, match="as a rigid body it can move and turn freely"):
        last(square(NH, loads=[Traction(on="right", value=[1, 0])]))


def test_a_load_that_is_not_a_number():
    bad = Traction(on="right", value=["1e5/(0.6 - t)*heaviside(0.5 - t)/heaviside(0.55 - t)", 0])
    with pytest.raises(InputError, match="load"):
        last(square(NH, Support(on="left"), loads=[bad]), steps=4)


def test_linear_elasticity_pushed_through_itself():
    states, error = failure(squeezed(LinearElastic(E=E, nu=NU), 1.2), "inverted")
    assert "inside out" in str(error)
    assert states[-1].load_factor < 1 / 1.2


def test_incompatible_supports():
    """One face is pushed past the fixed points of the next: the corner's cells cannot follow."""
    torn = square(
        NH, Support(on="left", displacement=[0, 0]), Support(on="bottom", displacement=[0, 0.9])
    )
    states, _ = failure(torn, "inverted")
    assert states[-1].load_factor < 1.0


# --- unstable equilibria ---


def square_column() -> Problem:
    return Problem(
        box_body(size=(0.01, 0.01, 0.1), cells=(2, 2, 10)),
        NeoHookean(E=1e6, nu=0.45),
        supports=[Support(on="bottom")],
        loads=[Traction(on="top", value=[0, 0, -4e3])],
    )


@pytest.mark.long
@pytest.mark.parametrize("steps", [1, 2, 4])
def test_a_square_column_finds_its_bent_shape(steps):
    """Just above the critical load the flow from a small perturbation takes for ever.

    The two modes of a square section have nearly the same load, so that the bent body turns into
    the other one through a flat valley.  It stopped there with "unstable", whatever the steps.
    """
    *states, state = Statics(square_column(), steps=steps, max_displacement=0.02).steps()
    assert state.max_displacement > 0.02
    assert {s.stability.negative for s in states[1:]} == {0}
    assert state.load_factor < 0.6


@pytest.mark.long
def test_an_unstable_equilibrium_is_told_as_such():
    """It was "no equilibrium beyond ...: the equilibrium that was found is unstable"."""
    _, error = failure(square_column(), "unstable", steps=2, snap=False)
    text = str(error)
    assert re.search(r"^no stable equilibrium beyond load factor 0\.53\d*: ", text)
    told = (
        r"the equilibrium at load factor 0\.53\d* is unstable, so that the body leaves it at the "
        r"slightest push: its tangent has 1 negative eigenvalue; it buckles, sideways to the load"
    )
    assert re.search(told, text), text
    assert "that was found" not in text
    assert error.advice.startswith("a small imperfection")
    assert "arc-length" in error.advice
    assert error.advice.endswith("[dynamics] to see where the body goes")


def test_a_failure_repeats_the_suspicion_of_a_missing_unit():
    """The load factor of the failure is small: what counts is where the obstacle is to go."""
    press = Contact(on="top", plane={"point": [0, 0.1], "normal": [0, -1]}, motion=[0, "-50*t"])
    problem = Problem(
        rectangle_body(size=(0.1, 0.1), cells=(2, 2)),
        NeoHookean(E=1e6, nu=0.3),
        supports=[Support(on="bottom"), Support(on=["left", "right"], displacement=[0, "free"])],
        contacts=[press],
        degree=1,
    )
    with pytest.raises(ConvergenceError) as caught:
        list(Statics(problem).steps())
    told = "' is to move by 50 m, and the body is 0.1 m long: is a unit missing? Bare numbers and"
    assert told in caught.value.advice
    assert "; else " in caught.value.advice
    assert caught.value.state.t < 0.01
