"""Materials that relax by a Prony series, against closed forms.

G = mu, two terms; in simple shear the stress is what all branches make of it, and the volume takes
no part.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.checkpoints import saved, through_json
from mpi4py import MPI

from dolfin_elastic import (
    Case,
    Dynamics,
    LinearElastic,
    MooneyRivlin,
    NeoHookeanSplit,
    Problem,
    Statics,
    Support,
    Thermal,
    Traction,
    box_body,
    rectangle_body,
    run,
)
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.case.check.materials import error_of_steps, material_information
from dolfin_elastic.case.tables import Material
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.model.point.report import material_report
from dolfin_elastic.problem.state import State
from dolfin_elastic.report.drawn import _label
from dolfin_elastic.report.laws import materials_of
from dolfin_elastic.results.checkpoint.checkpoints import newest_checkpoint
from dolfin_elastic.results.finished.curves import history_curves
from dolfin_elastic.results.finished.draw import _headline as headline_again
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.scene.appearance import DEFAULT
from dolfin_elastic.results.scene.pictures import _headline
from dolfin_elastic.solvers.eigen.modal import Modal

MU = 3.0
G, TAU = np.array([0.3, 0.2]), np.array([0.5, 0.05])
PRONY = [{"g": float(g), "tau": f"{tau} s"} for g, tau in zip(G, TAU, strict=True)]
FREE = "free"
SIDES = ["left", "right", "front", "back", "bottom", "top"]


def small(**keys: Any) -> LinearElastic:
    return LinearElastic(mu=MU, nu=0.3, prony=PRONY, **keys)


def large(**keys: Any) -> NeoHookeanSplit:
    return NeoHookeanSplit(mu=MU, nu=0.3, prony=PRONY, **keys)


def sheared(law: Any, amount: float, curve: Any, **keys: Any) -> Problem:
    """A cube in simple shear by an amount: x moves by z."""
    moved = Support(on=SIDES, displacement=[f"{amount}*z", 0, 0], curve=curve)
    top = Support(on="top", displacement=[amount, 0, 0], curve=curve)  # for its reaction alone
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2))
    return Problem(body, law, supports=[moved, top], **{"degree": 1, **keys})


def shear_stress(state: State) -> float:
    return float(state.reactions["top"][0])


def judged(solver: Statics) -> list[State]:
    states = list(solver.steps())
    for state in states:
        assert state.audit is not None
        assert state.audit.verdict == "pass", state.audit.reasons
    return states


# --- relaxation ---


def ramp(t: float) -> float:
    """Stress over mu of a strain that grows as t."""
    return float((1 - G.sum()) * t + G @ (TAU * -np.expm1(-t / TAU)))


@pytest.mark.parametrize("degree", [1, 2])
def test_a_ramp_and_a_hold_are_exact(degree: int) -> None:
    """Where the strain is piecewise linear, whatever the step: here four times the shorter tau."""
    states = judged(
        Statics(sheared(small(), 0.01, [[0, 0], [0.4, 1], [1, 1]], degree=degree), steps=5)
    )
    for state in states[1:]:
        t, rate = state.t, MU * 0.01 / 0.4
        wanted = rate * (ramp(t) - ramp(max(t - 0.4, 0.0)))
        assert shear_stress(state) == pytest.approx(wanted, rel=1e-12)


def errors(stress: Callable[[int], float], wanted: float, steps: tuple[int, ...]) -> list[float]:
    return [abs(stress(n) / wanted - 1) for n in steps]


def slope(found: list[float]) -> float:
    return float(np.log2(found[-2] / found[-1]))


def test_small_shear_to_second_order() -> None:
    """gamma = 0.01 sin 3t up to t = 1."""
    x = 3 * TAU
    branches = (x**2 * np.sin(3) + x * np.cos(3) - x * np.exp(-1 / TAU)) / (1 + x**2)
    wanted = MU * 0.01 * ((1 - G.sum()) * np.sin(3) + G @ branches)
    found = errors(
        lambda n: shear_stress(judged(Statics(sheared(small(), 0.01, "sin(3*t)"), steps=n))[-1]),
        float(wanted),
        (10, 20, 40),
    )
    assert slope(found) == pytest.approx(2, abs=0.1)
    assert found[-1] < 2e-3


def large_shear(amount: float) -> float:
    """P13 of a large shear amount sin 3t at t = 1, by the convolution with fine steps."""
    s = np.linspace(0, 1, 200_001)
    gamma = amount * np.sin(3 * s)
    F = np.tile(np.eye(3), (len(s), 1, 1))
    F[:, 0, 2] = gamma
    C = np.swapaxes(F, 1, 2) @ F
    inverse = np.linalg.inv(C)
    S = MU * (np.eye(3) - np.trace(C, axis1=1, axis2=2)[:, None, None] / 3 * inverse)
    now = np.zeros((3, 3))
    for g, tau in zip(G, TAU, strict=True):
        fading = np.exp(-(1 - (s[1:] + s[:-1]) / 2) / tau)
        now += g * np.einsum("k,kij->ij", fading, np.diff(S, axis=0))
    now -= np.sum(now * C[-1]) / 3 * inverse[-1]
    return float((F[-1] @ ((1 - G.sum()) * S[-1] + now))[0, 2])


@pytest.mark.parametrize(
    "make", [large, lambda: MooneyRivlin(c10=MU / 2, c01=0, nu=0.3, prony=PRONY)]
)
def test_large_shear_to_second_order(make: Callable[[], Any]) -> None:
    found = errors(
        lambda n: shear_stress(judged(Statics(sheared(make(), 0.5, "sin(3*t)"), steps=n))[-1]),
        large_shear(0.5),
        (10, 20, 40),
    )
    assert slope(found) == pytest.approx(2, abs=0.1)
    assert found[-1] < 3e-3


# --- creep ---


def test_creep_to_second_order() -> None:
    """Under a shear traction that grows in 0.1 s and stays, y and z held."""
    rest, tau = 0.7, 0.5 / 0.7
    law = LinearElastic(mu=MU, nu=0.3, prony=[{"g": 0.3, "tau": 0.5}])

    def under_ramp(t: float) -> float:
        return float(t / rest + (1 - 1 / rest) * tau * -np.expm1(-t / tau))

    def shear(n: int) -> float:
        supports = [
            Support(on=SIDES, displacement=[FREE, 0, 0]),
            Support(on="bottom", displacement=[0, 0, 0]),
        ]
        load = Traction(on="top", value=[0.01, 0, 0], curve=[[0, 0], [0.1, 1], [1, 1]])
        body = box_body(size=(1, 1, 1), cells=(2, 2, 2))
        problem = Problem(body, law, supports=supports, loads=[load], degree=1)
        return judged(Statics(problem, steps=n))[-1].max_displacement

    wanted = 0.01 / MU / 0.1 * (under_ramp(1.0) - under_ramp(0.9))
    found = errors(shear, wanted, (10, 20, 40))
    assert slope(found) == pytest.approx(2, abs=0.1)
    assert found[-1] < 1e-3


LARGE = 0.5


def stretched(n: int, law: Any) -> float:
    """Stretch of an incompressible cube under a dead traction of 0.5 mu, after 1 s."""
    sides = {"left": 0, "front": 1, "bottom": 2}
    supports = [
        Support(on=side, displacement=[0 if i == axis else FREE for i in range(3)])
        for side, axis in sides.items()
    ]
    load = Traction(on="right", value=[LARGE * MU, 0, 0], curve=[[0, 0], [0.2, 1], [1, 1]])
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1))
    problem = Problem(body, law, supports=supports, loads=[load])
    state = judged(Statics(problem, steps=n))[-1]
    along = state.u.x.array[::3]
    return 1 + float(MPI.COMM_WORLD.allreduce(along.max(initial=0.0), MPI.MAX))


def creeping() -> float:
    """The same by scipy: y = (stretch, h11 and h22 of each branch), P11 = l X11 - X22/l^2."""
    from scipy.integrate import solve_ivp

    b, tau = np.array([0.6, 0.4]), np.array([0.5, 0.05])

    def second(s: float) -> np.ndarray:
        """S11 and S22 over mu, and their slopes."""
        trace, slope = s**2 + 2 / s, 2 * s - 2 / s**2
        S = np.array([1 - trace / (3 * s**2), 1 - trace * s / 3])
        return np.array(
            [S, [2 * trace / (3 * s**3) - slope / (3 * s**2), -trace / 3 - slope * s / 3]]
        )

    def rate(t: float, y: np.ndarray, growth: float) -> np.ndarray:
        s, h = y[0], y[1:].reshape(2, 2)
        (S, slope), to = second(s), np.array([s, -1 / s**2])
        X, dX = S + b @ h, (1 + b.sum()) * slope
        stiff = to @ dX + X[0] + 2 * X[1] / s**3
        speed = (growth + to @ (b / tau @ h)) / stiff
        return np.concatenate([[speed], (slope * speed - h / tau[:, None]).ravel()])

    y = np.array([1.0, 0, 0, 0, 0])
    for start, end, growth in ((0, 0.2, LARGE / 0.2), (0.2, 1, 0.0)):
        y = solve_ivp(rate, (start, end), y, args=(growth,), rtol=1e-11, atol=1e-13).y[:, -1]
    return float(y[0])


@pytest.mark.parametrize("law", ["neo-hookean", "neo-hookean-split"])
def test_creep_at_large_strains_to_second_order(law: str) -> None:
    """At nu = 0.5 the two are one material."""
    wanted = creeping()
    found = [abs(stretched(n, viscous(law, nu=0.5)) / wanted - 1) for n in (10, 20, 40)]
    assert slope(found) == pytest.approx(2, abs=0.1)
    assert found[-1] < 1e-3


def test_creep_of_the_whole_stress_to_second_order() -> None:
    """A bar under a tension that grows in 0.2 s and stays: J = 1/1.6 + 0.375 (1 - exp(-t/T))."""
    law = viscous("linear-elastic", viscous=[{"ratio": 0.6, "time": 0.5}], viscous_on="whole")
    T = 0.5 * 1.6

    def under_ramp(t: float) -> float:
        return t - 0.375 * T * -np.expm1(-t / T)

    wanted = LARGE * MU / law.E / 0.2 * (under_ramp(1.0) - under_ramp(0.8))
    found = [abs((stretched(n, law) - 1) / wanted - 1) for n in (10, 20, 40)]
    assert slope(found) == pytest.approx(2, abs=0.1)
    assert found[-1] < 1e-3


@pytest.mark.parametrize("law", ["orthotropic", "blatz-ko", "hencky", "holzapfel-gasser-ogden"])
def test_a_held_shear_relaxes_in_a_body(law: str) -> None:
    """Sheared in one step and held: each branch fades from what that step has left of it."""
    curve = [[0, 0], [0.1, 1], [1, 1]]
    given = {} if law in ANISOTROPIC else {"viscous_on": "whole"}
    states = judged(Statics(sheared(viscous(law, **given), 0.2, curve), steps=10))
    given = MATERIALS[law].example if law in ANISOTROPIC else {"mu": MU, "nu": 0.3}
    lasting = sheared(MATERIALS[law](**given), 0.2, None)
    (elastic,) = judged(Statics(lasting, steps=1))[1:]
    b, tau = np.array([0.6, 0.4]), np.array([0.5, 0.05])
    first = -np.expm1(-0.1 / tau) * tau / 0.1
    for state in states[1:]:
        factor = 1 + (b * first) @ np.exp(-(state.t - 0.1) / tau)
        assert shear_stress(state) == pytest.approx(shear_stress(elastic) * factor, rel=1e-9)


# --- with what else a problem has ---


def pulled(law: Any, **keys: Any) -> Problem:
    """A bar that is pulled by 10 % in 0.2 s, half of it of a material that does not relax."""
    body = keys.pop("body", None) or box_body(size=(2, 1, 1), cells=(2, 1, 1))
    dim = body.dim
    supports = [
        Support(on="left", displacement=[0] * dim),
        Support(
            on="right", displacement=[0.2, *[FREE] * (dim - 1)], curve=[[0, 0], [0.2, 1], [1, 1]]
        ),
    ]
    return Problem(body, law, supports=supports, **keys)


def axisymmetric() -> Problem:
    """A bar of revolution about y, drawn out."""
    supports = [
        Support(on="left", displacement=[0, FREE]),
        Support(on="bottom", displacement=[FREE, 0]),
        Support(on="top", displacement=[FREE, 0.1], curve=[[0, 0], [0.2, 1], [1, 1]]),
    ]
    body = rectangle_body(size=(1, 1), cells=(2, 2))
    return Problem(body, large(), supports=supports, geometry="axisymmetric")


def two_materials() -> Problem:
    body = box_body(size=(2, 1, 1), cells=(2, 1, 1))
    middle = body.mesh.geometry.x[body.mesh.geometry.dofmap].mean(axis=1)[:, 0]
    regions = {"soft": np.flatnonzero(middle < 1), "hard": np.flatnonzero(middle > 1)}
    body = body.named(regions={n: cells.astype(np.int32) for n, cells in regions.items()})
    return pulled({"soft": large(), "hard": NeoHookeanSplit(mu=30, nu=0.3)}, body=body)


def warmed(law: Any = None) -> Problem:
    """Held between two planes and warmed: the growth strains up to 0.2 s, as the pull does."""
    law = large(expansion=1e-3) if law is None else law
    return pulled(law, loads=[Thermal(value=20, curve=[[0, 0], [0.2, 1], [1, 1]])])


VISCOUS = [{"ratio": 0.6, "time": 0.5}, {"ratio": 0.4, "time": 0.05}]


def viscous(law: str, **keys: Any) -> Any:
    """A law with other branches, whose constants are those after a long time."""
    if law == "formula":
        formula = "mu/2*(I1 - 3) - mu*ln(J)"
        table = {"energy": formula, "parameters": {"mu": MU}, "viscous": VISCOUS}
        return Material.read({**table, **keys}).law
    given = MATERIALS[law].example if law in ANISOTROPIC else {"mu": MU, "nu": 0.3}
    return MATERIALS[law](**{**given, "viscous": VISCOUS, **keys})


ANISOTROPIC = ("holzapfel-gasser-ogden", "guccione", "orthotropic")

PROBLEMS: dict[str, Callable[[], Problem]] = {
    "quadratic": lambda: pulled(large()),
    "mixed": lambda: pulled(NeoHookeanSplit(mu=MU, nu=0.4999, prony=PRONY)),
    "incompressible": lambda: pulled(NeoHookeanSplit(mu=MU, nu=0.5, prony=PRONY)),
    "linear, mixed": lambda: pulled(LinearElastic(mu=MU, nu=0.4999, prony=PRONY)),
    "plane stress": lambda: pulled(
        large(), body=rectangle_body(size=(2, 1), cells=(2, 1)), geometry="plane-stress"
    ),
    "axisymmetric": axisymmetric,
    "varying": lambda: pulled(NeoHookeanSplit(mu="3 + x", nu=0.3, prony=PRONY)),
    "two materials": two_materials,
    "warmed": warmed,
    "whole": lambda: pulled(viscous("neo-hookean", viscous_on="whole")),
    "whole, warmed": lambda: warmed(viscous("st-venant-kirchhoff", expansion=1e-3)),
    "whole, orthotropic": lambda: pulled(viscous("orthotropic")),
    "corotated": lambda: pulled(viscous("corotated")),
    "hencky, mixed": lambda: pulled(viscous("hencky", nu=0.4999)),
    "neo-hookean, incompressible": lambda: pulled(viscous("neo-hookean", nu=0.5)),
    "artery": lambda: pulled(viscous("holzapfel-gasser-ogden")),
    "heart": lambda: pulled(viscous("guccione")),
    "formula": lambda: pulled(
        viscous("formula", energy="mu/2*(I1 - 3) - mu*ln(J) + mu*ln(J)^2"), degree=1
    ),
    "formula and volume": lambda: pulled(viscous("formula", volumetric="log", K=300 * MU)),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_relaxes_and_goes_on(name: str, folder: Path) -> None:
    """The force falls while the strain stays, the energy balances, and a restart finds the same."""
    make = PROBLEMS[name]
    solver, states, forces = Statics(make(), steps=5), [], []
    for state in solver.steps():
        states.append(state)
        assert state.audit is not None
        assert state.audit.verdict == "pass", state.audit.reasons
        forces.append(np.concatenate([state.reactions[n] for n in sorted(state.reactions)]))
        saved(MPI.COMM_WORLD, folder / str(state.step), solver.restart_state(), max(state.step, 1))
    sizes = [float(np.linalg.norm(force)) for force in forces]
    assert sizes[1] > 1.02 * sizes[2] > 1.02**2 * sizes[3]
    found = newest_checkpoint(MPI.COMM_WORLD, folder / "2")
    assert found is not None
    again = list(Statics(make(), steps=5).steps(found))
    assert len(again) == len(states) - 3
    for state, force, first in zip(again, forces[3:], states[3:], strict=True):
        here = np.concatenate([state.reactions[n] for n in sorted(state.reactions)])
        assert here == pytest.approx(force, rel=1e-9, abs=1e-9 * sizes[1])
        assert state.energies == pytest.approx(first.energies, rel=1e-9)


def test_a_trial_leaves_no_trace() -> None:
    """The stress depends on the accepted states alone: the residual is the same to the bit."""
    problem = pulled(large())
    solver = Statics(problem, steps=5)
    states = solver.steps()
    for _ in range(3):
        next(states)
    assert solver._stepping is not None
    residual = solver._stepping._assembler.residual
    problem.set_time(0.6)
    residual.assemble()
    before, w = residual.vector.array.copy(), problem.w.x.array.copy()
    problem.w.x.array[:] *= 1.3
    problem.set_time(0.9)
    residual.assemble()
    assert np.abs(residual.vector.array - before).max() > 1e-3
    problem.w.x.array[:] = w
    problem.set_time(0.6)
    residual.assemble()
    assert np.array_equal(residual.vector.array, before)
    states.close()


def test_a_smaller_step_follows_a_failed_one(caplog: pytest.LogCaptureFixture) -> None:
    """A step that takes too many iterations is halved; the energy balances all the same."""
    hard = pulled(NeoHookeanSplit(mu=MU, nu=0.3, prony=PRONY))
    with caplog.at_level("INFO"):
        states = judged(Statics(hard, max_step=0.2, first_step=0.2, max_iterations=2))
    assert len(states) > 7


# --- motion ---


def swinging(n: int, **keys: Any) -> list[State]:
    """A cube whose top is thrown sideways, n steps up to 1 s."""
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1))
    held = Support(on="bottom", displacement=[0, 0, 0])
    problem = Problem(body, large(density=0.5), supports=[held], degree=1)
    velocity = ["z", 0, 0]
    motion = Dynamics(problem, end=1, dt=1 / n, initial_velocity=velocity, **keys)
    return list(motion.steps())


@pytest.mark.long
@pytest.mark.parametrize("scheme", ["generalized-alpha", "energy-momentum", "newmark"])
def test_motion_to_second_order(scheme: str) -> None:
    """Of the energy, and of the balance of energy with the work on the branches."""
    ends, off = [], []
    for n in (40, 80, 160):
        state = swinging(n, scheme=scheme)[-1]
        ends.append(state.energies["strain"])
        off.append(abs(state.energies["balance"]) / state.energies["relaxing"])
        assert state.audit is not None
        assert state.audit.verdict_so_far == "pass", state.audit.so_far
    changes = np.abs(np.diff(ends))
    assert np.log2(changes[0] / changes[1]) == pytest.approx(2, abs=0.3)
    assert off[2] < 0.35 * off[1] or off[2] < 1e-4
    assert off[2] < 2e-3


@pytest.mark.long
def test_an_initial_displacement_is_sudden() -> None:
    """What is strained at the start relaxes from there, to second order: not over a first step."""
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1))
    held = Support(on="bottom", displacement=[0, 0, 0])
    ends = []
    for n in (20, 40, 80):
        problem = Problem(body, large(density=0.5), supports=[held], degree=1)
        motion = Dynamics(problem, end=0.2, dt=0.2 / n, initial_displacement=["0.1*z", 0, 0])
        state = list(motion.steps())[-1]
        ends.append(state.energies["strain"])
        assert state.audit is not None
        assert state.audit.verdict_so_far == "pass", state.audit.so_far
    changes = np.abs(np.diff(ends))
    assert np.log2(changes[0] / changes[1]) == pytest.approx(2, abs=0.2)


def test_a_motion_goes_on() -> None:
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1))
    held = Support(on="bottom", displacement=[0, 0, 0])

    def motion() -> Dynamics:
        problem = Problem(body, large(density=0.5), supports=[held], degree=1)
        return Dynamics(problem, end=0.2, dt=0.02, initial_velocity=["z", 0, 0])

    first, known, middle = motion(), [], None
    for state in first.steps():
        known.append((state.max_displacement, state.energies))
        if state.step == 5:
            middle = through_json(first.restart_state())
    for state, (moved, energies) in zip(motion().steps(middle), known[6:], strict=True):
        assert state.max_displacement == pytest.approx(moved, rel=1e-10)
        assert state.energies == pytest.approx(energies, rel=1e-9, abs=1e-12)


# --- where no time passes ---


@pytest.mark.long
def test_modes_are_those_of_a_sudden_load() -> None:
    def frequencies(law: Any) -> list[float]:
        body = box_body(size=(2, 1, 1), cells=(2, 1, 1))
        problem = Problem(body, law, supports=[Support(on="left", displacement=[0, 0, 0])])
        return [mode.frequency for mode in Modal(problem, count=2).modes()]

    plain = NeoHookeanSplit(mu=MU, nu=0.3, density=1)
    assert frequencies(large(density=1)) == pytest.approx(frequencies(plain), rel=1e-10)


def test_modes_of_long_term_constants() -> None:
    """The branches of `VISCOUS` double the whole stress of a sudden load."""

    def frequencies(law: Any, **keys: Any) -> np.ndarray:
        body = box_body(size=(2, 1, 1), cells=(2, 1, 1))
        problem = Problem(body, law, supports=[Support(on="left", displacement=[0, 0, 0])])
        return np.array([mode.frequency for mode in Modal(problem, count=2, **keys).modes()])

    law = viscous("neo-hookean", viscous_on="whole", density=1)
    plain = frequencies(MATERIALS["neo-hookean"](mu=MU, nu=0.3, density=1))
    assert frequencies(law) == pytest.approx(np.sqrt(2) * plain, rel=1e-9)
    assert frequencies(law, stiffness="long-term") == pytest.approx(plain, rel=1e-9)


@pytest.mark.long
def test_the_stable_step_is_that_of_a_sudden_load() -> None:
    """Explicit motion takes sqrt(2) times as many steps as without branches that double all."""

    def steps(law: Any) -> int:
        body = box_body(size=(1, 1, 1), cells=(2, 2, 2))
        held = Support(on="bottom", displacement=[0, 0, 0])
        problem = Problem(body, law, supports=[held], degree=1)
        motion = Dynamics(
            problem, scheme="symplectic-euler", end=2, initial_velocity=["1e-3*z", 0, 0]
        )
        return list(motion.steps())[-1].step

    plain = steps(MATERIALS["neo-hookean"](mu=MU, nu=0.3, density=1))
    found = steps(viscous("neo-hookean", viscous_on="whole", density=1))
    assert found / plain == pytest.approx(np.sqrt(2), rel=0.03)


def test_a_preload_stores_what_a_sudden_load_does(caplog: pytest.LogCaptureFixture) -> None:
    """Its energy was that after a long time, and the audit told of a jump."""
    supports = [
        Support(on="left", displacement=[0, 0, 0]),
        Support(on="right", displacement=[0.3, 0, 0]),
    ]
    body = box_body(size=(2, 1, 1), cells=(2, 1, 1))
    law = NeoHookeanSplit(mu=MU, nu=0.3, density=1, prony=[{"g": 0.5, "tau": 0.2}])
    modes = Modal(Problem(body, law, supports=supports, degree=1), count=1, preload=True)
    with caplog.at_level("WARNING"):
        list(modes.modes())
    assert not caplog.records


@pytest.mark.parametrize("preload", [False, True])
def test_modes_know_nothing_of_an_earlier_run(preload: bool) -> None:
    """What a run on the same problem has left, stress in a body at rest, changed frequencies."""
    used, fresh = pulled(large(density=1), degree=1), pulled(large(density=1), degree=1)
    list(Statics(used, steps=2).steps())
    one, other = (
        [m.frequency for m in Modal(p, count=2, preload=preload).modes()] for p in (used, fresh)
    )
    assert one == pytest.approx(other, rel=1e-9)


@pytest.mark.parametrize(
    ("keys", "where"),
    [({}, "statics.steps"), ({"method": "arc-length"}, "statics.method")],
)
def test_statics_refuses(keys: dict[str, Any], where: str) -> None:
    with pytest.raises(InputError) as error:
        list(Statics(pulled(large()), **keys).steps())
    assert error.value.where == where


def test_motion_refuses() -> None:
    with pytest.raises(InputError, match="materials that remember"):
        Dynamics(pulled(large(density=1), degree=1), scheme="alpha2", end=1, dt=0.1)


@pytest.mark.parametrize(
    ("prony", "text"),
    [
        ([{"g": 0.6, "tau": 1}, {"g": 0.4, "tau": 2}], "sum up to 1"),
        ([{"g": 0.6, "tau": 0}], "tau"),
        ([{"g": 1.2, "tau": 1}], "g"),
        ([{"g": 0.2}], "time"),
        ([], "^prony: a series without terms"),
    ],
)
def test_a_series_is_checked(prony: Any, text: str) -> None:
    with pytest.raises(InputError, match=text):
        LinearElastic(E=1, nu=0.3, prony=prony)


def test_the_whole_stress_of_an_incompressible_material_is_refused() -> None:
    with pytest.raises(InputError, match="the whole stress relaxes, but the pressure") as error:
        pulled(viscous("neo-hookean", nu=0.5, viscous_on="whole"))
    assert error.value.where.endswith(".viscous_on")


# --- in a case file ---

CASE: dict[str, Any] = {
    "mesh": {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}},
    "materials": {"gel": {"law": "yeoh", "c10": "1 MPa", "nu": 0.3, "rho": 1000, "prony": PRONY}},
    "support": [{"on": "left", "displacement": [0, 0, 0]}],
    "load": [{"kind": "traction", "on": "right", "value": [0, 0, 1000]}],
}


def test_a_series_is_read_and_written_back() -> None:
    case = Case(**CASE)
    (law,) = (material.law for material in case.materials.values())
    assert [(term.ratio, term.time) for term in law.viscous] == list(zip(G, TAU, strict=True))
    assert Case(**tomllib.loads(case.to_toml())).materials == case.materials


@pytest.mark.long
def test_moduli_of_a_sudden_load_and_after_a_long_time() -> None:
    """The bulk modulus stays: E falls less than mu."""
    table = {"law": "linear-elastic", "K": 5.0, "mu": MU, "prony": PRONY}
    law = LinearElastic(K=5, mu=MU, prony=PRONY)
    (row,) = (f for f in material_report(law).findings if f.check == "relaxation")
    assert row.values["E_long"] == pytest.approx(LinearElastic(K=5, mu=0.5 * MU).E, rel=1e-12)
    text = "sudden E = 7.5 Pa, mu = 3 Pa; after a long time E = 4.091 Pa, mu = 1.5 Pa (50 %)"
    damped = "loss factor up to 0.26, at 0.28 Hz"
    assert row.text == f"of the isochoric stress: {text}; relaxation times 50 ms, 500 ms; {damped}"
    assert ("relaxation", row.text) in materials_of({"materials": {"gel": table}})[0].constants
    assert "relaxation" not in [f.check for f in material_report(LinearElastic(E=1, nu=0)).findings]


@pytest.mark.long
def test_statics_show_their_time(folder: Path) -> None:
    """In pictures, curves and the report: no load of 2000 %; a preload has a load."""
    *_, last = run(Case(**CASE, statics={"end": 20, "steps": 2}), output=folder / "a")
    assert _headline(last, DEFAULT).startswith("t = 20 s ")
    first = next(Statics(pulled(large()), steps=2, preload=True).steps())
    assert _headline(first, DEFAULT).startswith("load 0 % ")

    def look() -> None:
        found = FinishedRun(folder / "a")
        over = history_curves(found, "t", ["max_displacement"]).over
        assert (over.name, over.unit) == ("time", "s")
        assert headline_again(found, DEFAULT, 20.0).startswith("t = 20 s ")
        assert _label(found, 20.0) == "t = 20 s"

    on_root(MPI.COMM_WORLD, look)


@pytest.mark.parametrize(
    ("tables", "text"),
    [
        ({}, "the steps in time are not given"),
        ({"statics": {"method": "arc-length"}}, "along a path no time passes"),
        ({"dynamics": {"scheme": "alpha2", "end": 1, "dt": 0.1}}, "materials that remember"),
    ],
)
def test_check_refuses(tables: dict[str, Any], text: str) -> None:
    case = Case(**CASE, **tables)
    with pytest.raises(InputError, match=text):
        check(case, case.read_body())


def test_check_notes() -> None:
    case = Case(**CASE, modal={"count": 2})
    notes = check(case, case.read_body())
    assert any("nothing relaxes in [modal]" in note for note in notes)
    case = Case(**CASE, statics={"steps": 10})
    assert not any("relax" in note for note in check(case, case.read_body()))


def test_check_says_what_relaxes() -> None:
    case = Case(**CASE, statics={"steps": 40})
    text = "materials.gel.viscous: the isochoric stress relaxes to 50 % of that of a sudden load"
    assert text in material_information(case)


def test_coarse_steps_are_told() -> None:
    """With the error of a sine as fast as the branch."""

    def notes(**tables: Any) -> list[str]:
        case = Case(**CASE, **tables)
        return [note for note in check(case, case.read_body()) if "steps of" in note]

    assert notes(statics={"steps": 40}) == []
    (note,) = notes(statics={"steps": 5})
    assert note == (
        "materials.gel.viscous: steps of 200 ms beside a time of 50 ms: where the strain changes "
        "as fast, the stress is off by about 20 %; steps of 25 ms keep it below 1 %"
    )
    assert len(notes(statics={"max_step": 0.2})) == 1
    assert len(notes(dynamics={"end": 1, "dt": 0.2})) == 1
    assert notes(modal={"count": 2}) == notes(dynamics={"end": 1, "dt": 0.02}) == []


def test_the_error_of_steps_is_that_of_a_sine() -> None:
    """sin(t/tau) of one branch, over a period: the largest error of its stress, over the stress."""
    law = LinearElastic(mu=MU, nu=0.3, viscous=[{"ratio": 2.0, "time": 0.1}])
    period, n = 0.1 * 2 * np.pi, 20
    states = judged(Statics(sheared(law, 0.01, "sin(10*t)"), end=period, steps=n))
    t = np.array([state.t for state in states]) / 0.1
    wanted = MU * 0.01 * (np.sin(t) + (np.sin(t) + np.cos(t) - np.exp(-t)))
    off = np.abs([shear_stress(state) for state in states] - wanted).max()
    expected = error_of_steps(law, period / n) * np.abs(wanted).max()
    assert 0.5 * expected < off < 1.5 * expected


def test_what_grows_for_many_seconds_is_told() -> None:
    """Without a curve, to as many times what is written; 1 s, a curve or a formula in t is fine."""

    def notes(end: float, curve: Any = None, **tables: Any) -> list[str]:
        pull = {"on": "right", "displacement": ["1 mm", 0, 0]} | ({"curve": curve} if curve else {})
        supports = [*CASE["support"], pull, {"on": "top", "displacement": [FREE, FREE, "1e-4*t"]}]
        given = {"support": supports, "load": [], "statics": {"end": end, "steps": 9}, **tables}
        case = Case(**{**CASE, **given})
        return [note for note in check(case, case.read_body()) if "without a curve" in note]

    assert notes(1) == notes(100, curve=[[0, 0], [1, 1]]) == []
    plate = {"on": "front", "plane": {"axis": "y", "at": -1}, "motion": [0, "1 mm", 0]}
    still = {"on": "back", "plane": {"axis": "-y", "at": 2}}
    (note,) = notes(100, load=CASE["load"], contact=[plate, still])
    assert note.startswith(
        "support[1], load[0] and contact[0]: numbers without a curve are multiplied by"
    )
    assert note.endswith("at the end by 100: was that meant?")
    steel = {"law": "linear-elastic", "E": "1 MPa", "nu": 0.3}
    assert notes(100, materials={"steel": steel}) == []
