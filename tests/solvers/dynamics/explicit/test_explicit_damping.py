"""Damping and added mass in explicit motion: closed forms, energy, shocks, thin elements."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from helpers.checkpoints import through_json
from helpers.motion import oscillator

from dolfin_elastic import (
    Dynamics,
    LinearElastic,
    NeoHookean,
    Problem,
    Support,
    Traction,
    box_body,
)
from dolfin_elastic.core.errors import InputError, StabilityError
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.mesh import Body
from dolfin_elastic.solvers.dynamics.explicit.explicit import Explicit, ExplicitOptions
from dolfin_elastic.solvers.dynamics.explicit.mass_scaling import _advice
from dolfin_elastic.solvers.dynamics.explicit.scheme import CentralDifferences
from dolfin_elastic.solvers.dynamics.settings import BulkViscosityFactors, DynamicsSettings

FREE, SCHEME = "free", "central-differences"
E, NU, RHO = 1e7, 0.3, 1000.0
STIFF = E * (1 - NU) / ((1 + NU) * (1 - 2 * NU))
SPEED = np.sqrt(STIFF / RHO)
OMEGA = np.sqrt(3) * SPEED
"""Of the oscillator: stiffness STIFF/2, lumped mass rho/6."""
START = 1e-3


def end_of(problem: Problem, steps: int, end: float, **damping: Any) -> float:
    """u_x at the free node at the end."""
    moves = {"initial_displacement": [f"{START}*x", 0], "dt": end / steps, "every": steps}
    *_, state = Dynamics(problem, scheme=SCHEME, end=end, **moves, **damping).steps()
    return largest(problem.body.comm, float(np.max(state.u.x.array, initial=-1.0)))


def exact(rate: float, t: float) -> float:
    damped = np.sqrt(OMEGA**2 - rate**2 / 4)
    swing = np.cos(damped * t) + rate / (2 * damped) * np.sin(damped * t)
    return float(START * np.exp(-rate * t / 2) * swing)


@pytest.mark.parametrize(
    ("damping", "rate", "order"),
    [
        ({"rayleigh": [0.2 * OMEGA, 0]}, 0.2 * OMEGA, 2),
        # s = b1 rho c L r of a cell of volume 1/2 and altitude 1/sqrt(2), on a mass of rho/6; the
        # velocity half a step before makes it of first order.
        ({"bulk_viscosity": {"linear": 0.06, "quadratic": 0}}, 3 * 0.06 * SPEED / 2**0.5, 1),
    ],
    ids=["mass", "bulk"],
)
def test_an_oscillator_follows_its_closed_form(damping: Any, rate: float, order: int) -> None:
    end = 3.2 * 2 * np.pi / OMEGA
    found = [abs(end_of(oscillator(), n, end, **damping) - exact(rate, end)) for n in (320, 1280)]
    assert found[0] < 0.05 * START
    assert np.log(found[0] / found[1]) / np.log(4) == pytest.approx(order, abs=0.1)


@pytest.mark.parametrize(
    "options",
    [
        ExplicitOptions(rate=300.0),
        ExplicitOptions(bulk=(0.06, 1.2)),
        ExplicitOptions(0.0, 50.0, (0.1, 1.0)),
    ],
    ids=["mass", "bulk", "both"],
)
def test_the_balance_of_a_linear_body_closes(options: ExplicitOptions) -> None:
    """What the scheme conserves falls by just what damping takes, to round-off."""
    body = box_body(size=(1, 1, 1), cells=(3, 3, 2))
    problem = Problem(body, LinearElastic(E=E, nu=NU, density=RHO), degree=1)
    v = fem.Function(problem.V)
    v.interpolate(lambda x: 0.1 * np.array([x[0] * x[1], -x[1] * x[2], x[2] ** 2]))
    march = Explicit(
        problem, v, CentralDifferences, end=0.02, dt=5e-5, safety=0.9, every=40, options=options
    )
    sums, lost = [], []
    for state in march.run():
        assert state.energies is not None
        excess = total(body.comm, march.scheme.conserved_excess(5e-5))
        lost.append(state.energies["damping"])
        sums.append(state.energies["total"] + excess + lost[-1])
    assert lost[0] == 0.0
    assert np.all(np.diff(lost) > 0.0)
    assert lost[-1] > 0.01 * sums[0]
    assert sums == pytest.approx([sums[0]] * len(sums), rel=1e-11)
    march.destroy()


def bar_in_motion(law: Any, bulk: tuple[float, float], **moved: Any) -> Explicit:
    """A bar whose halves fly at each other at `speed`, or whose left end is `pushed`."""
    body = box_body(size=(1, 0.1, 0.1), cells=(40, 4, 4))
    supports = (
        [Support(on="left", displacement=[moved["pushed"], 0, 0])] if "pushed" in moved else []
    )
    problem = Problem(body, law(E=E, nu=NU, density=RHO), supports=supports, degree=1)
    v = fem.Function(problem.V)
    speed = moved.get("speed", 0.0)
    v.interpolate(lambda x: speed * np.array([-np.sign(np.round(x[0] - 0.5, 6)), *(0 * x[1:])]))
    times = {"end": moved["end"], "dt": moved.get("dt"), "safety": 0.9, "every": 10}
    return Explicit(problem, v, CentralDifferences, options=ExplicitOptions(bulk=bulk), **times)


def gains(march: Explicit) -> list[float]:
    """Energy from nowhere at the states, over the largest so far."""
    found, most = [], 1e-300
    for state in march.run():
        assert state.energies is not None
        e = state.energies
        most = max(most, e["total"], abs(e["external"]))
        found.append((e["total"] + e["damping"] - e["external"]) / most)
    march.destroy()
    return found


def test_the_first_step_is_that_of_the_initial_velocity() -> None:
    """Halves of a bar collide: the quadratic term shortens the step from the start."""
    rest, march = (bar_in_motion(NeoHookean, (0.06, 1.2), speed=v, end=8e-4) for v in (0.0, 60.0))
    assert march.size.stable < 0.4 * rest.size.stable
    rest.destroy()
    found = gains(march)
    assert found == pytest.approx([1.0] * len(found), abs=2e-3)  # oscillates by O(dt^2)


@pytest.mark.parametrize("law", [LinearElastic, NeoHookean])
def test_the_step_follows_a_support_that_sets_off_later(law: Any) -> None:
    """Without a linear term there is no viscosity at rest, but there is in motion."""
    march = bar_in_motion(law, (0.0, 1.2), pushed="30*max(t - 0.02, 0)", end=0.024)
    rest = march.size.stable
    found = gains(march)
    assert march.size.stable < 0.95 * rest
    assert np.abs(found[-10:]).max() < 0.01


def test_a_step_that_viscosity_makes_too_long_is_named_so() -> None:
    march = bar_in_motion(
        NeoHookean, (0.0, 1.2), pushed="30*max(t - 0.001, 0)", end=0.01, dt=1.2e-4
    )
    with pytest.raises(StabilityError, match="because of the bulk viscosity"):
        gains(march)
    march.destroy()


def shock(**damping: Any) -> tuple[float, float, float]:
    """Largest velocity over the exact one while a wave is in a bar; what is lost, and given."""
    body, pressure = box_body(size=(1, 0.04, 0.04), cells=(50, 2, 2)), 1e3
    supports = [Support(on="right", displacement=[0, FREE, FREE])]
    supports += [Support(on=on, displacement=[FREE, 0, FREE]) for on in ("front", "back")]
    supports += [Support(on=on, displacement=[FREE, FREE, 0]) for on in ("bottom", "top")]
    law = LinearElastic(E=E, nu=0.0, density=RHO)
    push = Traction(on="left", value=[pressure, 0, 0])
    problem = Problem(body, law, supports=supports, loads=[push], degree=1)
    c = np.sqrt(E / RHO)
    *_, state = Dynamics(problem, scheme=SCHEME, end=0.7 / c, **damping).steps()
    assert state.v is not None
    assert state.energies is not None
    most = largest(body.comm, float(np.max(state.v.x.array, initial=0.0)))
    return most * RHO * c / pressure, state.energies.get("damping", 0.0), state.energies["external"]


def test_bulk_viscosity_smears_a_shock() -> None:
    """A wave in a bar that is pushed suddenly: v = p/(rho c) behind its front."""
    rings, _, _ = shock()
    smeared, lost, given = shock(bulk_viscosity={"linear": 0.3, "quadratic": 1.2})
    usual, _, _ = shock(bulk_viscosity=True)
    assert rings > 1.2
    assert usual - 1 < 0.9 * (rings - 1)
    assert smeared - 1 < 0.5 * (rings - 1)
    assert 0.0 < lost < 0.2 * given


def thin(altitude: float) -> Body:
    """A box with a vertex near the middle, over a face of a cell by a fraction of the mesh size."""
    body = box_body(size=(1, 1, 1), cells=(4, 4, 4))
    x = body.mesh.geometry.x
    near = np.linalg.norm(x - 0.5, axis=1) < 1e-9
    x[near] += (0.25 - 0.25 * altitude) * np.array([1.0, 0.0, 0.0])
    return body


def block(altitude: float, **keys: Any) -> Explicit:
    """A block that is set in motion."""
    law = NeoHookean(E=E, nu=NU, density=RHO)
    problem = Problem(thin(altitude), law, supports=[Support(on="left")], degree=1)
    v = fem.Function(problem.V)
    v.interpolate(lambda x: np.array([0 * x[0], x[0], 0 * x[0]]))
    options = ExplicitOptions(mass_scaling=keys.pop("mass_scaling", 0.0))
    return Explicit(
        problem,
        v,
        CentralDifferences,
        end=0.02,
        **{"dt": None, **keys},
        safety=0.9,
        options=options,
    )


def scaled(altitude: float, **keys: Any) -> tuple[Explicit, list[Any]]:
    """A block with the states of its motion."""
    march = block(altitude, **keys)
    states = [(s.t, s.energies, s.numbers, s.max_displacement) for s in march.run()]
    march.destroy()
    return march, states


def test_mass_of_a_thin_element() -> None:
    """Steps are as long as without it, with what is permitted; the motion hardly changes."""
    (regular, _), (plain, before) = scaled(1.0), scaled(0.02)
    march, states = scaled(0.02, mass_scaling=0.6)
    numbers = states[-1][2]
    assert 0.0 < numbers["added_mass_fraction"] <= 0.6 * (1 + 1e-6)
    place = [numbers[f"added_mass_{x}"] for x in "xyz"]
    assert np.linalg.norm(np.array(place) - [0.7, 0.5, 0.5]) < 0.4
    assert plain.size.stable < 0.4 * regular.size.stable
    assert march.size.stable > 0.7 * regular.size.stable
    comm = plain.problem.body.comm
    mass = [total(comm, float(one.mass[::3].sum())) for one in (plain, march)]
    assert mass[1] / mass[0] - 1 == pytest.approx(numbers["added_mass_fraction"], rel=1e-9)
    assert max(s[3] for s in states) == pytest.approx(max(s[3] for s in before), rel=0.1)
    sums = [s[1]["total"] - s[1]["external"] for s in states]
    assert sums == pytest.approx([sums[0]] * len(sums), rel=0.02)


def test_a_step_gets_the_mass_that_it_needs() -> None:
    """m r/s at nodes whose bound r is above s = (2 MARGIN/dt)^2, which then bounds omega^2."""
    plain = block(0.02)
    assert plain.size.bound is not None
    rates, mass, dt = plain.size.bound.evaluate(), plain.mass[::3].copy(), 1.5 * plain.size.stable
    plain.destroy()
    more = np.dot(mass, np.maximum(rates * (dt / 1.8) ** 2, 1.0) - 1)
    comm = plain.problem.body.comm
    expected = total(comm, float(more)) / total(comm, float(mass.sum()))
    assert 0.001 < expected < 0.2
    march = block(0.02, mass_scaling=1.0, dt=dt)
    assert march.size.stable > dt / 0.9 * (1 - 1e-9)
    march.destroy()
    added = total(comm, float(march.mass[::3].sum())) / total(comm, float(mass.sum())) - 1
    assert added == pytest.approx(expected, rel=1e-8)


def test_mass_above_the_limit_is_refused() -> None:
    """The advice is enough, and given where settings permit it, up to 1."""
    plain, _ = scaled(0.02)
    refused = r"% of the mass would have to be added at \d+ nodes"
    with pytest.raises(InputError, match=refused) as much:
        scaled(0.02, mass_scaling=1e-4, dt=20 * plain.size.stable)
    assert "mass_scaling = " not in str(much.value)
    with pytest.raises(InputError, match=refused) as little:
        scaled(0.02, mass_scaling=1e-4, dt=1.5 * plain.size.stable)
    enough = float(str(little.value).rpartition("mass_scaling = ")[2].split()[0])
    _, states = scaled(0.02, mass_scaling=enough, dt=1.5 * plain.size.stable)
    assert 0.9 * enough < states[-1][2]["added_mass_fraction"] <= enough
    assert [_advice(x).split(" = ")[1] for x in (0.0121, 0.12, 0.995)] == ["0.013", "0.12", "1"]
    assert "=" not in _advice(2.81)
    assert "leave mass_scaling out if dt is not much longer" in str(little.value)


def test_without_thin_elements_nothing_is_added() -> None:
    """A regular mesh gets no mass, nor does one whose step needs no more than round-off."""
    _, states = scaled(1.0, mass_scaling=0.01)
    assert states[-1][2] == {"added_mass_fraction": 0.0}
    regular = block(1.0)
    dt = 1.8 / np.sqrt(regular.size.cell_bound() * (1 - 1e-9))
    regular.destroy()
    march = block(1.0, mass_scaling=0.01, dt=dt)
    assert next(march.run()).numbers == {"added_mass_fraction": 0.0}
    march.destroy()


def lost(**damping: Any) -> dict[str, float]:
    """Energies at the end of a free block that spins and vibrates."""
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2))
    problem = Problem(body, LinearElastic(E=E, nu=NU, density=RHO), degree=1)
    start = {"initial_velocity": ["x^2", "y*x", 0]}
    *_, state = Dynamics(problem, scheme=SCHEME, end=0.05, **start, **damping).steps()
    return dict(state.energies)


def test_what_each_damping_takes() -> None:
    """All is bulk viscosity's without another damping, and nothing where its factors are zero."""
    bulk = lost(bulk_viscosity=True)
    assert bulk["damping"] == bulk["bulk_viscosity"] > 0.0
    mass = lost(rayleigh=[20.0, 0])
    assert "bulk_viscosity" not in mass
    both = lost(rayleigh=[20.0, 0], bulk_viscosity={"linear": 0.0, "quadratic": 0.0})
    assert both["bulk_viscosity"] == 0.0
    assert both["damping"] == pytest.approx(mass["damping"], rel=1e-9)  # their steps are the same


def test_short_forms() -> None:
    given = {"scheme": SCHEME, "bulk_viscosity": 0.1, "mass_scaling": "1 %", "end": 1.0}
    settings = DynamicsSettings.model_validate(given)
    assert settings.bulk_viscosity == BulkViscosityFactors(linear=0.1, quadratic=1.2)
    assert settings.mass_scaling == 0.01
    again = {**given, "bulk_viscosity": "10 %", "mass_scaling": 0.01}
    assert DynamicsSettings.model_validate(again) == settings
    with pytest.raises(InputError, match="bulk_viscosity"):
        Dynamics(oscillator(), **{**given, "bulk_viscosity": False})


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"scheme": SCHEME, "rayleigh": [1, 1e-5]}, "explicit schemes damp by the mass alone"),
        ({"scheme": "symplectic-euler", "bulk_viscosity": True}, "has no bulk viscosity"),
        ({"dt": 0.1, "bulk_viscosity": True}, "has no bulk viscosity"),
        ({"dt": 0.1, "mass_scaling": 0.1}, "does not use the stable step"),
    ],
)
def test_keys_of_other_schemes_are_refused(keys: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Dynamics(oscillator(), end=1.0, **keys)


@pytest.mark.long
@pytest.mark.parametrize("every", [1, 4])
def test_a_continued_run_is_the_same(every: int) -> None:
    """With all dampings, added mass, and a material that remembers beside one that does not."""
    keys: dict[str, Any] = {"scheme": SCHEME, "end": 0.02, "every": every, "mass_scaling": 0.5}
    keys |= {"rayleigh": [20.0, 0], "bulk_viscosity": True, "initial_velocity": [0, "x", 0]}
    body = thin(0.1)
    law = NeoHookean(E=E, nu=NU, density=RHO, viscous=[{"ratio": 0.5, "time": 1e-3}])

    def motion() -> Dynamics:
        return Dynamics(Problem(body, law, supports=[Support(on="left")], degree=1), **keys)

    def told(state: Any) -> tuple[Any, ...]:
        return state.u.x.array.copy(), state.v.x.array.copy(), dict(state.energies), state.numbers

    whole = [told(state) for state in motion().steps()]
    first = motion()
    states = first.steps()
    for state in states:
        if state.step >= every * (len(whole) // 2):
            break
    saved = through_json(first.restart_state())
    states.close()
    tail = [told(state) for state in motion().steps(saved)]
    assert 1 < len(tail) < len(whole)
    for there, here in zip(whole[-len(tail) :], tail, strict=True):
        for one, other in zip(there[:2], here[:2], strict=True):
            assert other == pytest.approx(one, rel=1e-11, abs=1e-11 * np.abs(one).max(initial=1e-9))
        assert here[2] == pytest.approx(there[2], rel=1e-11)
        assert here[3] == there[3]
