"""Materials whose memory a user has written, against the built-in series and closed forms.

Mullins' effect: R. W. Ogden and D. G. Roxburgh, Proc. R. Soc. Lond. A 455 (1999) 2861.  The stress
of the virgin rubber, W'(stretch), is softened by eta = 1 - erf((Wm - W)/m)/r below the largest
energy Wm so far; here also with tanh in place of erf, which formulas have.
"""

from __future__ import annotations

from math import cosh, erf, log, tanh
from typing import Any

import numpy as np
import pytest
import ufl
from helpers.checkpoints import through_json

from dolfin_elastic import (
    Case,
    Dynamics,
    Energy,
    Problem,
    SplitEnergy,
    Statics,
    Support,
    box_body,
    rectangle_body,
)
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.case.check.materials import material_information
from dolfin_elastic.case.tables import Material
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.point.checks import check_energy
from dolfin_elastic.model.point.history import history
from dolfin_elastic.model.point.tested import LawUnderTest
from dolfin_elastic.problem.state import State
from dolfin_elastic.solvers.eigen.modal import Modal

FREE = "free"
MU, LMBDA, RATIO, TAU = 3.0, 5.0, 0.6, 0.4
THERE_AND_BACK = [[0, 0], [0.4, 1], [0.7, -0.4], [1, 0.2]]
CYCLES = [[0, 0], [1, 0.6], [2, 0.1], [3, 0.8], [4, 0]]
R, M = 1.6, 0.4


def law_of(table: dict[str, Any]) -> Any:
    return Material.read(table).law


def held(law: Any, **keys: Any) -> Problem:
    """A cube, one side fixed, the other one moved askew by what a curve says."""
    moved = Support(on="right", displacement=[0.3, 0.1, 0], curve=THERE_AND_BACK)
    body = box_body(size=(1, 1, 1), cells=(2, 1, 1))
    return Problem(body, law, supports=[Support(on="left"), moved], **{"degree": 1, **keys})


def pulled(law: Any, curve: Any = CYCLES, **keys: Any) -> Problem:
    """A cube in simple tension."""
    rollers = [
        Support(on=on, displacement=[0 if i == j else FREE for j in range(3)])
        for i, on in enumerate(("left", "front", "bottom"))
    ]
    moved = Support(on="right", displacement=[1, FREE, FREE], curve=curve)
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1))
    return Problem(body, law, supports=[*rollers, moved], **{"degree": 1, **keys})


def reactions(state: State) -> np.ndarray:
    return np.concatenate([state.reactions[n] for n in sorted(state.reactions)])


def judged(solver: Any) -> list[State]:
    states = list(solver.steps())
    for state in states:
        assert state.audit is not None
        assert state.audit.verdict == "pass", state.audit.reasons
    return states


# --- a branch of a Prony series ---


def neo(C: Any, J: Any, mu: Any, lmbda: Any) -> Any:
    return mu / 2 * (ufl.tr(C) - 3) - mu * ufl.ln(J) + lmbda / 2 * ufl.ln(J) ** 2


def share(dt: Any, tau: Any) -> Any:
    """(1 - exp(-x))/x with x = dt/tau: 1 of a sudden load."""
    return ufl.conditional(ufl.gt(dt, 0), (1 - ufl.exp(-dt / tau)) / (dt / tau), 1)


def relaxing(
    C: Any, J: Any, S0: Any, h: Any, dt: Any, mu: Any, lmbda: Any, g: Any, tau: Any
) -> Any:
    f = share(dt, tau)
    H = g * (ufl.exp(-dt / tau) * h - f * S0)
    return (1 + g * f) * neo(C, J, mu, lmbda) + ufl.inner(H, C - ufl.Identity(3)) / 2


def followed(C: Any, J: Any, S0: Any, h: Any, dt: Any, mu: Any, lmbda: Any, tau: Any) -> Any:
    S = mu * (ufl.Identity(3) - ufl.inv(C)) + lmbda * ufl.ln(J) * ufl.inv(C)
    return {"S0": S, "h": ufl.exp(-dt / tau) * h + share(dt, tau) * (S - S0)}


CONSTANTS = {"mu": MU, "lmbda": LMBDA}


def written(**keys: Any) -> Energy:
    keys = {**CONSTANTS, **keys}
    start = {"S0": "0", "h": np.zeros((3, 3))}
    more = {"history": start, "next": followed, "g": RATIO, "tau": TAU}
    return Energy(relaxing, **more, **keys)


def built_in(**keys: Any) -> Energy:
    return Energy(neo, viscous=[{"ratio": RATIO, "time": TAU}], **{**CONSTANTS, **keys})


PAIRS = [(i, j) for i in range(3) for j in range(i, 3)]


def in_components() -> tuple[Any, Any]:
    """The law of St. Venant and Kirchhoff with a branch: six formulas; and the built-in one."""
    f, e = "where(dt > 0, (1 - exp(-dt/tau))*tau/dt, 1)", "exp(-dt/tau)"
    trace = "(E11 + E22 + E33)"
    square = " + ".join(f"{1 if i == j else 2}*E{i + 1}{j + 1}^2" for i, j in PAIRS)
    past, start, after = [], {}, {}
    for i, j in PAIRS:
        ij = f"{i + 1}{j + 1}"
        S = f"(2*mu*E{ij}" + (f" + lmbda*{trace})" if i == j else ")")
        past.append(f"{1 if i == j else 2}*({e}*h{ij} - {f}*S{ij})*E{ij}")
        start |= {f"S{ij}": 0, f"h{ij}": 0}
        after |= {f"S{ij}": S, f"h{ij}": f"{e}*h{ij} + {f}*({S} - S{ij})"}
    table = {
        "energy": f"(1 + g*{f})*(lmbda/2*{trace}^2 + mu*({square})) + g*({' + '.join(past)})",
        "history": start,
        "next": after,
        "parameters": {**CONSTANTS, "g": RATIO, "tau": "400 ms"},
    }
    stiff = {"law": "st-venant-kirchhoff", "mu": MU, "nu": LMBDA / (2 * (LMBDA + MU))}
    return law_of(table), law_of({**stiff, "viscous": [{"ratio": RATIO, "time": TAU}]})


TWINS = {"a function": lambda: (written(), built_in()), "formulas": in_components}


@pytest.mark.long
@pytest.mark.parametrize("name", TWINS)
def test_a_branch_is_that_of_viscous(name: str) -> None:
    """Forces of a body that is pulled, let go and pressed; the work is that of the forces.

    (1 - exp(-x))/x loses two digits where the built-in one has none.
    """
    own, known = TWINS[name]()
    twins = [judged(Statics(held(law), steps=10, rtol=1e-13)) for law in (own, known)]
    size = max(float(np.abs(reactions(state)).max()) for state in twins[1])
    for ours, theirs in zip(*twins, strict=True):
        assert reactions(ours) == pytest.approx(reactions(theirs), rel=1e-12, abs=1e-12 * size)
    assert "relaxing" in twins[0][-1].energies


def drawn_out(law: Any, geometry: str) -> Problem:
    """A square, or a bar of revolution about y, drawn out."""
    supports = [
        Support(on="left", displacement=[0, FREE]),
        Support(on="bottom", displacement=[FREE, 0]),
        Support(on="top", displacement=[0.1, 0.3], curve=THERE_AND_BACK),
    ]
    body = rectangle_body(size=(1, 1), cells=(2, 2))
    return Problem(body, law, supports=supports, geometry=geometry)


ELSEWHERE: dict[str, tuple[Any, Any]] = {
    "quadratic": (held, {"degree": 2}),
    "in space": (held, {"mu": f"{MU}*(1 + x)"}),
    "plane stress": (drawn_out, {"geometry": "plane-stress"}),
    "plane strain": (drawn_out, {"geometry": "plane-strain"}),
    "axisymmetric": (drawn_out, {"geometry": "axisymmetric"}),
}


@pytest.mark.long
@pytest.mark.parametrize("name", ELSEWHERE)
def test_a_branch_elsewhere(name: str) -> None:
    """Unknowns beside the displacement, bodies in the plane, constants in space; to round-off."""
    make, keys = ELSEWHERE[name]
    mu = {"mu": keys.pop("mu")} if "mu" in keys else {}
    last = []
    for law in (written(**mu), built_in(**mu)):
        *_, state = judged(Statics(make(law, **keys), steps=5, rtol=1e-13))
        last.append(reactions(state))
    assert last[0] == pytest.approx(last[1], rel=1e-11, abs=1e-11 * np.abs(last[1]).max())


def test_modes_are_those_of_a_sudden_load() -> None:
    """A mode after a preload has no past either."""
    found = []
    for law in (written(density=1.0), built_in(density=1.0)):
        modes = Modal(held(law), count=2, preload=True).modes()
        found.append([mode.frequency for mode in modes])
    assert found[0] == pytest.approx(found[1], rel=1e-9)


@pytest.mark.parametrize("scheme", ["generalized-alpha", "central-differences"])
def test_a_branch_in_motion(scheme: str) -> None:
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1))
    bottom, moved = Support(on="bottom"), []
    for law in (written(density=0.5), built_in(density=0.5)):
        problem = Problem(body, law, supports=[bottom], degree=1)
        step = {} if scheme == "central-differences" else {"dt": 0.02, "rtol": 1e-12}
        motion = Dynamics(problem, end=0.2, scheme=scheme, initial_velocity=["z", 0, 0], **step)
        *_, state = motion.steps()
        moved.append(state.u.x.array.copy())
    assert np.abs(moved[0]).max() > 0.05
    assert moved[0] == pytest.approx(moved[1], abs=1e-8 * np.abs(moved[1]).max())


def test_a_run_goes_on() -> None:
    """From a state between, through JSON: to round-off."""
    first, known, middle = Statics(held(written()), steps=10, rtol=1e-13), [], None
    for state in first.steps():
        known.append((reactions(state), state.energies))
        if state.step == 5:
            middle = through_json(first.restart_state())
    again = list(Statics(held(written()), steps=10, rtol=1e-13).steps(middle))
    assert len(again) == 5
    size = float(np.abs(known[-1][0]).max())
    for state, (force, energies) in zip(again, known[-5:], strict=True):
        assert reactions(state) == pytest.approx(force, rel=1e-12, abs=1e-12 * size)
        assert state.energies == pytest.approx(energies, rel=1e-12)


# --- Mullins' effect ---

SOFT = "mu/2*(I1 - 3) - mu*ln(J)"
RUBBER = {
    "energy": f"{SOFT} + m/r*ln(cosh(max(Wm - ({SOFT}), 0)/m))",
    "history": {"Wm": 0},
    "next": {"Wm": f"max(Wm, {SOFT})"},
    "parameters": {"mu": MU, "r": R, "m": M},
}


def curve(t: float) -> float:
    return 1 + float(np.interp(t, *np.transpose(CYCLES)))


@pytest.mark.long
def test_mullins_by_formula() -> None:
    """P = eta mu (l - 1/l) in tension of a rubber without a second constant, which stays as wide.

    dpsi/dF = W' - tanh((Wm - W)/m)/r W': the largest energy before the step, or none is larger.
    """
    largest = 0.0
    solver = Statics(pulled(law_of(RUBBER)), end=4, steps=40, rtol=1e-13)
    softened = 0
    for state in solver.steps():
        stretch = curve(state.t)
        W = MU / 2 * (stretch**2 - 1) - MU * log(stretch)
        eta = 1 - tanh(max(largest - W, 0) / M) / R
        softened += eta < 0.9
        largest = max(largest, W)
        expected = eta * MU * (stretch - 1 / stretch)
        assert "remembered" in state.energies
        assert state.reactions["right"][0] == pytest.approx(expected, rel=1e-11, abs=1e-11)
    assert softened > 10
    assert cosh(largest / M) > 2


@pytest.mark.long
@pytest.mark.parametrize("K", [1e3, 1e8])
def test_mullins_of_an_incompressible_rubber(K: float) -> None:
    """P = eta mu (l - 1/l^2), but for mu/K; with a large K the pressure is an unknown.

    The integral of erf(x) is x erf(x) + exp(-x^2)/sqrt(pi).
    """

    def energy(I1bar: Any, Wm: Any, mu: Any, r: Any, m: Any) -> Any:
        W = mu / 2 * (I1bar - 3)
        x = ufl.max_value(Wm - W, 0) / m
        return W + m / r * (x * ufl.erf(x) + (ufl.exp(-(x**2)) - 1) / np.sqrt(np.pi))

    def largest_so_far(I1bar: Any, Wm: Any, mu: Any) -> Any:
        return {"Wm": ufl.max_value(Wm, mu / 2 * (I1bar - 3))}

    law = SplitEnergy(
        energy, history={"Wm": 0}, next=largest_so_far, mu=MU, r=R, m=M, K=K * MU, volumetric="log"
    )
    keys = {"degree": 2, "formulation": "mixed"} if K > 1e4 else {"degree": 1}
    largest = 0.0
    for state in Statics(pulled(law, **keys), end=4, steps=20, rtol=1e-12).steps():
        stretch = curve(state.t)
        W = MU / 2 * (stretch**2 + 2 / stretch - 3)
        eta = 1 - erf(max(largest - W, 0) / M) / R
        largest = max(largest, W)
        expected = eta * MU * (stretch - stretch**-2)
        error = 10 / K + 1e-9
        found = state.reactions["right"][0]
        assert found == pytest.approx(expected, rel=error, abs=error * MU)


@pytest.mark.long
def test_a_count_of_steps_and_time() -> None:
    """Every accepted step counts once, and the time is that of the run; the body ages at rest."""
    table = {
        "energy": "mu/2*(I1 - 3) - mu*ln(J) + 0*age",
        "history": {"age": 0, "steps": 2},
        "next": {"age": "age + dt", "steps": "steps + 1"},
        "parameters": {"mu": MU},
    }
    problem = pulled(law_of(table))
    for state in Statics(problem, end=4, steps=8).steps():
        assert problem.history is not None
        for part in problem.history._regions.values():
            assert part.values["age"] == pytest.approx(state.t, rel=1e-13)
            assert part.values["steps"] == pytest.approx(2 + state.step, rel=1e-13)
    found = {f.check: f for f in history(LawUnderTest(law_of(table)))}
    assert found["history at rest"].verdict == "note"
    assert "steps changes at rest, from 2 to 3" in found["history at rest"].text
    assert found["history frame indifference"].verdict == "pass"
    rubber = {f.check: f.verdict for f in history(LawUnderTest(law_of(RUBBER)))}
    assert rubber["history at rest"] == "pass"


# --- in cases ---


def case_of(material: dict[str, Any], **tables: Any) -> Case:
    return Case.from_dict(
        {
            "mesh": {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}, "degree": 1},
            "materials": {"gel": material},
            "support": [{"on": "left"}, {"on": "right", "displacement": [0.1, 0, 0]}],
            **tables,
        }
    )


def test_a_case_is_read_and_written_back() -> None:
    case = case_of(RUBBER)
    table = case.materials["gel"].table()
    assert table["history"] == {"Wm": 0.0}
    assert table["next"] == RUBBER["next"]
    assert law_of(table) == case.materials["gel"].law
    check(case, case.read_body())
    ages = {**RUBBER, "next": {"Wm": "Wm + 1"}}
    assert any("Wm changes at rest" in note for note in material_information(case_of(ages)))


WRONG = {
    "no next": (
        {"next": None},
        "materials.gel.history: a history, and nothing says how it follows; next, values",
    ),
    "next and rate": ({"rate": {"Wm": "0"}}, "materials.gel.rate: `next` beside `rate`"),
    "no history": ({"history": None}, "materials.gel.history: `next` without a history"),
    "unknown": (
        {"next": {"Wn": "Wm"}},
        "materials.gel.next.Wn: there is no history 'Wn'; known: Wm",
    ),
    "missing": (
        {"history": {"Wm": 0, "k": 1}},
        "materials.gel.next: nothing says what 'k' is at the end of a step",
    ),
    "name in next": ({"next": {"Wm": "max(Vm, I1)"}}, "materials.gel.next.Wm: unknown name 'Vm'"),
    "name in energy": ({"energy": f"{SOFT} + r*m*Wn"}, "materials.gel.energy: unknown name 'Wn'"),
    "tensor": (
        {"history": {"Wm": "I"}, "energy": f"{SOFT} + r*m*tr(Wm)", "next": {"Wm": "I1"}},
        "materials.gel.next.Wm: a number; a tensor, as Wm is in history",
    ),
    "start": ({"history": {"Wm": "1 MPa"}}, "materials.gel.history.Wm: '1 MPa' is no start"),
    "taken": ({"history": {"J": 0}, "next": {"J": "0"}}, "history.J: the name 'J' is in use"),
    "empty": ({"history": {}}, "materials.gel.history: {} is wrong"),
    "viscous": (
        {"viscous": [{"ratio": 0.3, "time": 1}]},
        "materials.gel.viscous: `viscous` beside a history of your own",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_input_is_refused(name: str) -> None:
    keys, text = WRONG[name]
    table = {key: value for key, value in {**RUBBER, **keys}.items() if value is not None}
    with pytest.raises(InputError) as caught:
        case_of(table)
    message = str(caught.value).replace('"', "'")
    assert text in message


CHECKED = {
    "stress at rest": ({"energy": f"{SOFT} + r*m*(Wm + 1)*(J - 1)"}, "energy: no stress at rest"),
    "turned": ({"next": {"Wm": "F11"}}, "next: history frame indifference"),
    "turned later": (
        {"energy": f"{SOFT} + Wm*F12^2*m*r", "next": {"Wm": "max(Wm, J)"}},
        "energy: second step: the stress does not turn with the body",
    ),
    "not finite later": (
        {"energy": f"({SOFT})*(1 + m*r*where(Wm > 1, ln(-Wm), 0))", "next": {"Wm": "Wm + 2"}},
        "energy: second step: the stress after a step of 1 s is not finite",
    ),
    "not finite": ({"next": {"Wm": "Wm + 1/ln(J)"}}, "next: finite history"),
    "no time": ({"energy": f"({SOFT})*(1 + r*m*Wm/dt)"}, "with dt = 0 as in a sudden load"),
}


@pytest.mark.parametrize("name", CHECKED)
def test_checks_at_a_point(name: str) -> None:
    keys, text = CHECKED[name]
    with pytest.raises(InputError) as caught:
        check_energy(law_of({**RUBBER, **keys}))
    assert text in str(caught.value)


def grows(I1: Any, J: Any, Cv: Any, mu: Any) -> Any:
    return mu / 2 * (I1 - 3) - mu * ufl.ln(J) + 0 * ufl.tr(Cv)


IN_PYTHON: dict[str, tuple[dict[str, Any], str]] = {
    "no next": ({"next": None}, "history: a history, and nothing says how it follows"),
    "no table": ({"next": lambda C: C}, "next: the function returned no table of values"),
    "shape": ({"next": lambda J: {"Cv": J}}, "next.Cv: a value of shape ()"),
    "unknown": ({"next": lambda C: {"Cw": C}}, "next.Cw: there is no history 'Cw'"),
    "skew": (
        {"next": lambda C, Cv: {"Cv": C * ufl.diag(C) * C * ufl.diag(C)}},
        "next: symmetric history",
    ),
    "start": ({"history": {"Cv": np.diag([1, 2, 1])}}, "is no start of a history"),
    "parameter": ({"next": lambda C, tau: {"Cv": C / tau}}, "'tau' has no value"),
}


@pytest.mark.parametrize("name", IN_PYTHON)
def test_wrong_functions_are_refused(name: str) -> None:
    keys, text = IN_PYTHON[name]
    given = {"history": {"Cv": np.eye(3)}, "next": lambda C: {"Cv": C}, **keys}
    with pytest.raises(InputError) as caught:
        check_energy(Energy(grows, mu=MU, **given))
    assert text in str(caught.value)
