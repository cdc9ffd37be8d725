"""Statics: beams against the elastica, weights, several materials, curves, linear solvers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from conftest import displacement_at
from helpers.states import last
from mpi4py import MPI

from dolfin_elastic import (
    Body,
    BodyForce,
    Gravity,
    LinearElastic,
    NeoHookean,
    PointForce,
    Pressure,
    Problem,
    Selector,
    Statics,
    StVenantKirchhoff,
    Support,
    Textbook,
    Traction,
    box_body,
    name_parts,
    rectangle_body,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.solvers.statics.step_size import FEW_ITERATIONS, StepSizes

FREE = "free"
E, NU = 1e6, 0.3


# --- bending against beam theory and an independent code ---


@pytest.mark.parametrize(
    ("law", "w", "u"), [(NeoHookean, 0.716010, 0.388115), (StVenantKirchhoff, 0.715731, 0.389030)]
)
def test_elastica(law, w, u):
    """A cantilever, L/h = 20, under a dead tip force 5 E I/L^2 (plane strain).

    References: an independent high-order code on this very body, +- 2e-5.  Its thin limit is the
    elastica, w/L = 0.71379152, u/L = 0.38762836 (Bisshopp & Drucker 1945; Mattiasson 1981).
    """
    L, h = 20.0, 1.0
    force = 5 * E / (1 - NU**2) * h**3 / 12 / L**2
    body = rectangle_body(size=(L, h), cells=(40, 2))
    problem = Problem(
        body,
        law(E=E, nu=NU),
        degree=2,
        supports=[Support(on="left", displacement=[0, 0])],
        loads=[Traction(on="right", value=[0, force / h])],
    )
    state = last(problem, steps=2)
    tip = displacement_at(problem, (L, h / 2)) / L
    # Quadratic triangles of side h/2 are stiff by about 0.1 %.
    assert tip[1] == pytest.approx(w, rel=2e-3)
    assert -tip[0] == pytest.approx(u, rel=4e-3)
    # Elastica itself: its error is O((h/L)^2).
    assert tip[1] == pytest.approx(0.71379152, rel=2 * (h / L) ** 2)
    np.testing.assert_allclose(state.reactions["left"], [0, -force], rtol=0, atol=1e-6 * force)


def test_cooks_membrane():
    """Neo-Hookean, mu = 422.5 kPa, lmbda = 633.75 kPa, shear traction 62.5 kPa, plane strain.

    Tip of an independent high-order code: 14.522(2) mm at the middle of the right edge.  Eight
    quadratic elements an edge are too stiff by 0.6 % (measured there): the mesh's own error.
    """
    body = rectangle_body(size=(1.0, 1.0), cells=(8, 8))
    x = body.mesh.geometry.x
    s, r = x[:, 0].copy(), x[:, 1].copy()
    x[:, 0], x[:, 1] = 48 * s, 44 * s + r * (44 - 28 * s)
    problem = Problem(
        body,
        NeoHookean(mu=422.5e3, lmbda=633750.0),
        degree=2,
        supports=[Support(on="left", displacement=[0, 0])],
        loads=[Traction(on="right", value=[0, 62500.0])],
    )
    last(problem, steps=4)
    tip = displacement_at(problem, (48.0, 52.0))[1]
    assert 0.990 < tip / 14.522 < 0.998


def test_lateral_contraction_of_a_bar():
    """Hooke's bar in tension, exact on any mesh: u = t/E (x, -nu y, -nu z)."""
    body = box_body(size=(2.0, 0.5, 0.5), cells=(4, 2, 2))
    problem = Problem(
        body,
        LinearElastic(E=E, nu=NU),
        supports=[
            Support(on="left", displacement=[0, FREE, FREE]),
            Support(on="front", displacement=[FREE, 0, FREE]),
            Support(on="bottom", displacement=[FREE, FREE, 0]),
        ],
        loads=[Traction(on="right", value=["1 kPa", 0, 0])],
        degree=1,
    )
    state = last(problem)
    found = displacement_at(problem, (2.0, 0.5, 0.5))
    np.testing.assert_allclose(found, np.array([2.0, -0.5 * NU, -0.5 * NU]) * 1e3 / E, rtol=1e-11)
    np.testing.assert_allclose(state.reactions["left"], [-250.0, 0, 0], rtol=1e-11, atol=1e-9)
    assert state.energies["strain"] == pytest.approx(0.5 * 250.0 * 2e-3, rel=1e-11)
    assert state.max_displacement == pytest.approx(np.linalg.norm(found), rel=1e-12)


# --- loads in sum ---


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", [LinearElastic, NeoHookean, Textbook])
def test_reactions_carry_the_weight(law, dim):
    size = (1.0, 0.5, 0.4)[:dim]
    body = box_body(size=size, cells=(3, 2, 2)[:dim])
    problem = Problem(
        body,
        law(E=E, nu=NU, density=1200.0),
        loads=[Gravity()],
        supports=[Support(on="left", displacement=[0] * dim)],
        degree=1,
    )
    state = last(problem, rtol=1e-12)
    weight = 1200.0 * 9.81 * np.prod(size)
    expected = np.eye(dim)[-1] * weight  # the support pushes up
    np.testing.assert_allclose(state.reactions["left"], expected, rtol=0, atol=1e-10 * weight)


def test_loads_add_up():
    """Reactions balance gravity, a body force, a formula's traction: the sum of all terms."""
    body = box_body(size=(1.0, 1.0, 1.0), cells=(3, 3, 3))
    body = name_parts(body, regions={"upper": Selector(box=((0, 0, 1 / 3), (1, 1, 1)))})
    loads = [
        Gravity(value=[0, 0, -10.0]),
        BodyForce(value=[30.0, 0, 0]),
        BodyForce(on="upper", value=["x", "6*z", 0]),
        Traction(on=["right", "top"], value=[0, "2*y", 0]),
        Gravity(on="upper", value=[0, 0, 1.0]),
    ]
    problem = Problem(
        body,
        LinearElastic(E=E, nu=NU, density=7.0),
        loads=loads,
        supports=[Support(on="bottom")],
        degree=1,
    )
    state = last(problem, rtol=1e-13)
    third = 2 / 3
    total = [30 + 0.5 * third, 3 * (1 - 1 / 9) + 2 * (0.5 + 0.5), -70 + 7 * third]
    np.testing.assert_allclose(state.reactions["bottom"], np.negative(total), rtol=1e-11)


def test_moment_of_a_formula_traction():
    """Pure bending of Hooke's bar by t = -c (y - 1/2): u_x = -c (y - 1/2) x/E', exact for P2."""
    body = rectangle_body(size=(2.0, 1.0), cells=(4, 2))
    c, stiff, nu = 100.0, E / (1 - NU**2), NU / (1 - NU)  # plane strain as plane stress
    left = [0, f"-({c}/{stiff})*(-({nu}/2)*(y - 1/2)^2)"]
    problem = Problem(
        body,
        LinearElastic(E=E, nu=NU),
        degree=2,
        supports=[Support(on="left", displacement=left)],
        loads=[Traction(on="right", value=[f"-{c}*(y - 1/2)", 0])],
    )
    last(problem, rtol=1e-13)
    for x, y in ((2.0, 0.0), (2.0, 1.0), (1.0, 0.5), (2.0, 0.5)):
        exact = c / stiff * np.array([-(y - 0.5) * x, x**2 / 2 + nu / 2 * (y - 0.5) ** 2])
        np.testing.assert_allclose(
            displacement_at(problem, (x, y)), exact, rtol=0, atol=1e-11 * c / stiff
        )


# --- several materials ---


@pytest.mark.parametrize("dim", [2, 3])
def test_two_materials_in_a_row(dim):
    """Two bars in series without lateral contraction: displacements add up as springs do."""
    size, cells = (3.0, 1.0, 1.0)[:dim], (6, 2, 2)[:dim]
    body = name_parts(
        box_body(size=size, cells=cells),
        regions={
            "soft": Selector(box=((0, 0, 0)[:dim], (1, 1, 1)[:dim])),
            "hard": Selector(box=((1, 0, 0)[:dim], (3, 1, 1)[:dim])),
        },
    )
    laws = {"soft": LinearElastic(E=2e5, nu=0.0), "hard": LinearElastic(E=8e5, nu=0.0)}
    problem = Problem(
        body,
        laws,
        supports=[Support(on="left", displacement=[0] * dim)],
        loads=[Traction(on="right", value=[100.0, 0, 0][:dim])],
        degree=1,
    )
    state = last(problem)
    middle, end = (displacement_at(problem, (x, 1.0, 1.0)[:dim])[0] for x in (1.0, 3.0))
    assert middle == pytest.approx(100 / 2e5, rel=1e-11)
    assert end == pytest.approx(100 / 2e5 + 200 / 8e5, rel=1e-11)
    assert state.energies["strain"] == pytest.approx(0.5 * 100 * end, rel=1e-11)


def test_laws_of_different_kinds_side_by_side():
    """Each region obeys its own law: equal tractions, unequal stretches, from closed forms."""
    body = name_parts(
        rectangle_body(size=(2.0, 1.0), cells=(4, 2)),
        regions={"a": Selector(box=((0, 0), (1, 1))), "b": Selector(box=((1, 0), (2, 1)))},
    )
    laws = {"a": NeoHookean(E=E, nu=0.0), "b": StVenantKirchhoff(E=E, nu=0.0)}
    problem = Problem(
        body,
        laws,
        supports=[
            Support(on="left", displacement=[0, FREE]),
            Support(on="bottom", displacement=[FREE, 0]),
        ],
        loads=[Traction(on="right", value=[0.2 * E, 0])],
        degree=1,
    )
    last(problem, rtol=1e-12)
    middle, end = (1 + displacement_at(problem, (x, 0.0))[0] / x for x in (1.0, 2.0))
    stretch = 2 * end - middle
    # nu = 0: P = E/2 (s - 1/s) and P = E/2 (s^3 - s), no lateral strain in either.
    assert (middle - 1 / middle) / 2 == pytest.approx(0.2, rel=1e-10)
    assert (stretch**3 - stretch) / 2 == pytest.approx(0.2, rel=1e-10)


# --- growth of loads ---


def bar(*, loads: tuple[Any, ...] = (), right: Support | None = None) -> Problem:
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    supports = [
        Support(on="left", displacement=[0, FREE]),
        Support(on="bottom", displacement=[FREE, 0]),
    ]
    return Problem(
        body,
        LinearElastic(E=E, nu=0.0),
        loads=loads,
        supports=supports + ([right] if right else []),
        degree=1,
    )


@pytest.mark.parametrize(
    ("curve", "expected"),
    [
        (None, [0, 0.25, 0.5, 0.75, 1.0]),
        ("ramp", [0, 0.25, 0.5, 0.75, 1.0]),
        ("constant", [None, 1, 1, 1, 1]),
        ("t^2", [0, 1 / 16, 1 / 4, 9 / 16, 1]),
        ([[0, 0], [0.5, 2], [1, 1]], [0, 1, 2, 1.5, 1]),
    ],
)
def test_curves_of_loads(curve, expected):
    problem = bar(loads=(Traction(on="right", value=[1e3, 0], curve=curve),))
    found = []
    for state in Statics(problem, steps=4).steps():
        found.append(displacement_at(problem, (1.0, 0.0))[0] * E / 1e3)
        assert state.t == state.load_factor
    if expected[0] is None:  # the initial state is not an equilibrium
        found, expected = found[1:], expected[1:]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("curve", "expected"), [(None, [0, 1, 2]), ("ramp", [0, 1, 1])])
def test_beyond_the_full_load(curve, expected):
    """What names no curve goes on in proportion, as along an arc length: a load factor is one."""
    push = Support(on="right", displacement=[FREE, 0.1], curve=curve)
    problem = bar(loads=(Traction(on="right", value=[1e3, 0], curve=curve),), right=push)
    found = []
    for _ in Statics(problem, steps=2, end=2.0).steps():
        found.append(displacement_at(problem, (1.0, 0.0)) * (E / 1e3, 10))
    assert np.array(found)[:, 1] == pytest.approx(expected, abs=1e-14)
    stretched = [row[0] for row in found]
    assert stretched[2] - stretched[0] == pytest.approx(expected[2] * stretched[1], rel=1e-9)


def test_curves_and_formulas_of_supports():
    curved = Support(on="right", displacement=[0.1, FREE], curve=[[0, 0], [0.5, -1], [1, 1]])
    timed = Support(on="right", displacement=["0.1*t^2", FREE])
    plain = Support(on="right", displacement=["0.1*(1 + y)", FREE])
    for support, expected in (
        (curved, [0, -0.1, 0.1]),
        (timed, [0, 0.025, 0.1]),
        (plain, [0, 0.1, 0.2]),
    ):
        problem, found = bar(right=support), []
        for _ in Statics(problem, steps=2).steps():
            found.append(displacement_at(problem, (1.0, 1.0))[0])
        np.testing.assert_allclose(found, expected, rtol=1e-14, atol=1e-16)


def test_load_formulas_in_time_are_taken_as_they_are():
    problem = bar(loads=(Traction(on="right", value=["1e3*t*(2 - t)", 0]),))
    found = [displacement_at(problem, (1.0, 0.0))[0] for _ in Statics(problem, steps=2).steps()]
    np.testing.assert_allclose(np.array(found) * E / 1e3, [0, 0.75, 1.0], rtol=1e-9, atol=1e-12)


def test_a_formula_of_one_value_is_taken_as_it_is():
    """A pressure, not times the load factor; a curve beside it is."""
    for curve, shares in ((None, [0, 0.75, 1.0]), ([[0, 0], [0.5, 2], [1, 3]], [0, 1.5, 3.0])):
        push = Pressure(on="right", value="1e3*t*(2 - t)", curve=curve)
        problem = bar(loads=(push,))
        found = [displacement_at(problem, (1.0, 0.0))[0] for _ in Statics(problem, steps=2).steps()]
        np.testing.assert_allclose(-np.array(found) * E / 1e3, shares, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("loads", "said"),
    [
        (
            (
                Traction(on="right", value=[1.0, 0]),
                Traction(on="right", value=["sqrt(y - 0.5 - t)", 0]),
            ),
            r"load[1].value[0]: 'sqrt(y - 0.5 - t)' has no finite value at (1, ",
        ),
        (
            (Pressure(on="right", value="ln(x - 1)"),),
            "load[0].value: 'ln(x - 1)' has no finite value at (1, ",
        ),
        (
            (BodyForce(value=[0, "1e3*sqrt(0.3 - t)"]),),
            "load[0].value[1]: '1e3*sqrt(0.3 - t)' has no finite value at t = 0.5;",
        ),
        (
            (PointForce(at=[1.0, 0.0], value=["ln(y)", 0]),),
            "load[0].value[0]: 'ln(y)' has no finite value at (1, 0) m;",
        ),
    ],
)
def test_a_load_that_is_not_finite_is_named(loads, said):
    """Its key, formula and place, the same on every rank."""
    with pytest.raises(InputError) as caught:
        _ = [*Statics(bar(loads=loads), steps=2).steps()]
    assert str(caught.value).startswith(said)
    assert len(set(MPI.COMM_WORLD.allgather(str(caught.value)))) == 1


def test_a_support_that_is_not_finite_is_refused_everywhere():
    problem = bar(right=Support(on="right", displacement=["sqrt(y - 2)", FREE]))
    with pytest.raises(InputError, match="not finite"):
        _ = [*Statics(problem).steps()]


@pytest.mark.parametrize(
    ("curve", "times"),
    [
        ("load-unload", [0.0, 0.5, 1.0]),
        ([[0, 0], [0.1, 1], [0.2, 0], [1, 0]], [0.0, 0.1, 0.2, 1.0]),
        ("4*t*(1 - t)", [0.0, 0.25, 0.5, 0.75, 1.0]),
    ],
)
def test_no_step_passes_over_what_a_curve_does(curve, times):
    pull = Traction(on="right", value=[1e4, 0], curve=curve)
    body = rectangle_body(size=(1, 1), cells=(1, 1))
    problem = Problem(
        body, LinearElastic(E=E, nu=NU), supports=[Support(on="left")], loads=[pull], degree=1
    )
    assert [state.t for state in Statics(problem).steps()] == pytest.approx(times)


def test_settings_are_checked():
    problem = bar()
    for wrong in ({"steps": 0}, {"rtol": 0.0}, {"rtol": 2.0}, {"step": 3}, {"max_iterations": 0}):
        with pytest.raises(InputError):
            Statics(problem, **wrong)


def test_the_first_step_may_be_as_large_as_any():
    assert len([*Statics(bar(), first_step=0.5, max_step=0.5).steps()]) == 3
    with pytest.raises(InputError, match="0.6 is more than any step may be"):
        Statics(bar(), first_step=0.6, max_step=0.5)


def test_steps_return_to_their_first_size():
    """After a failure, though each step takes more than the few iterations that lengthen it."""
    sizes = StepSizes(1.0, first=0.1, largest=0.5, smallest=1e-4)
    assert sizes.failed(0.0, 0.1, inverted=True)
    t, taken = 0.0, []
    while not sizes.done(t):
        goal = sizes.goal(t)
        taken.append(goal - t)
        sizes.succeeded(t, goal, newton=FEW_ITERATIONS + 1)
        t = goal
    assert taken[:5] == pytest.approx([0.025] * 4 + [0.05])
    assert max(taken[:-1]) == pytest.approx(0.1)  # not beyond it
    assert len(taken) == 4 + 4 + 7


def test_states_describe_the_run():
    states = [*Statics(bar(loads=(Traction(on="right", value=[1e3, 0]),)), steps=3).steps()]
    assert [s.step for s in states] == [0, 1, 2, 3]
    np.testing.assert_allclose([s.done for s in states], [0, 1 / 3, 2 / 3, 1], rtol=1e-12)
    assert states[0].energies["strain"] == 0.0
    assert states[0].max_displacement == 0.0
    energies = [s.energies["strain"] for s in states]
    np.testing.assert_allclose(energies, np.array([0, 1 / 9, 4 / 9, 1]) * energies[-1], rtol=1e-9)


# --- linear solvers agree ---


def beam(dim: int) -> Body:
    if dim == 3:
        return box_body(size=(4.0, 1.0, 1.0), cells=(8, 2, 2))
    return box_body(size=(6.0, 1.0), cells=(24, 4))


def solved(method: str, body: Body, degree: int, law: Any) -> tuple[np.ndarray, Any]:
    dim = body.dim
    push = -4e-3 * E if dim == 3 else -2e-3 * E
    problem = Problem(
        body,
        law,
        degree=degree,
        supports=[Support(on="left")] if dim == 3 else [Support(on="left", displacement=[0, 0])],
        loads=[Traction(on="right", value=[0, push, push][:dim])],
    )
    state = last(problem, rtol=1e-11, linear=LinearSettings(method=method))
    return problem.u.x.array.copy(), state


@pytest.mark.parametrize(
    "law",
    [LinearElastic(E=E, nu=NU), NeoHookean(E=E, nu=0.4), Textbook(E=E, nu=NU)],
    ids=lambda law: law.name(),
)
@pytest.mark.parametrize(("dim", "degree"), [(3, 1), (3, 2), (2, 2)])
def test_iterative_and_direct_solvers_agree(comm, dim, degree, law):
    """CG or GMRES with GAMG; for quadratic elements with the step to linear ones above it."""
    if dim == 2 and law.linear:
        return
    body = beam(dim)  # one body: two of them can be parted and numbered in two ways
    direct, first = solved("direct", body, degree, law)
    iterative, second = solved("iterative", body, degree, law)
    assert first.krylov == 0
    assert second.krylov > 0
    size = comm.allreduce(float(np.abs(direct).max(initial=0.0)), op=MPI.MAX)
    off = comm.allreduce(float(np.abs(direct - iterative).max(initial=0.0)), op=MPI.MAX)
    assert size > 1e-2
    # Newton's 1e-11 in force, softened by a beam's condition of 1e3.
    assert off < 1e-8 * size
    np.testing.assert_allclose(
        second.reactions["left"],
        first.reactions["left"],
        rtol=0,
        atol=1e-8 * np.abs(first.reactions["left"]).max(),
    )
    if law.has_energy:
        assert second.energies["strain"] == pytest.approx(first.energies["strain"], rel=1e-8)
    # A preconditioner that works: tens of iterations a solve, not hundreds.
    assert second.krylov <= 40 * second.newton


# --- memory ---


def test_the_solver_is_freed_before_the_last_state(monkeypatch: pytest.MonkeyPatch) -> None:
    """Outputs need the room of tangent and multigrid; what a restart needs is still known."""
    freed: list[int] = []
    destroy = Newton.destroy

    def noted(self: Newton) -> None:
        freed.append(1)
        destroy(self)

    monkeypatch.setattr(Newton, "destroy", noted)
    body = box_body(size=(2, 1, 1), cells=(2, 1, 1))
    problem = Problem(
        body,
        NeoHookean(E=E, nu=NU),
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[0, 0, -1e3])],
    )
    statics = Statics(problem, steps=2)
    found = [(state.done, len(freed), statics.restart_state()) for state in statics.steps()]
    assert [(done, count) for done, count, _ in found] == [(0.0, 0), (0.5, 0), (1.0, 1)]
    assert found[-1][2].numbers["t"] == 1.0
    assert found[-1][2].fields["unknowns"] is problem.w
