"""Viscous laws at a point: relaxation, storage and loss, and a ramp, against closed forms.

The strains are given at all times at once: S of the law is evaluated for all of them, and the
branches follow step by step as they do in a body.
"""

from __future__ import annotations

import pathlib
from typing import Any

import numpy as np
import pytest
import ufl
from ufl.algorithms import expand_derivatives

from dolfin_elastic import Energy
from dolfin_elastic.case.material_report import write
from dolfin_elastic.case.tables import Material
from dolfin_elastic.cli.console_materials import report_table
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.kinematics import gradient_symbol, variables
from dolfin_elastic.model.materials.memory import SIX
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.model.materials.stepped import SteppedLaw, SteppedSplitLaw
from dolfin_elastic.model.materials.viscous import Viscous
from dolfin_elastic.model.point.report import material_report
from dolfin_elastic.model.point.ufl_to_numpy import NumpyProgram
from dolfin_elastic.model.point.viscous_curves import ViscousCurves, viscous_curves
from dolfin_elastic.report.laws import materials_of

RATIOS, TIMES = np.array([0.4, 0.25]), np.array([0.5, 0.05])
SERIES = [{"ratio": r, "time": f"{t} s"} for r, t in zip(RATIOS, TIMES, strict=True)]
FORMULA = {
    "energy": "mu/2*(I1 - 3) - mu*ln(J) + k/2*ln(J)^2",
    "parameters": {"mu": "3 MPa", "k": "7 MPa"},
}
HGO = {**MATERIALS["holzapfel-gasser-ogden"].example, "slack": False}
TABLES: dict[str, dict[str, Any]] = {
    "linear-elastic": {"law": "linear-elastic", "E": "1 MPa", "nu": 0.3},
    "neo-hookean": {"law": "neo-hookean", "E": "1 MPa", "nu": 0.3},
    "incompressible": {"law": "neo-hookean", "E": "1 MPa", "nu": 0.5},
    "ogden": {"law": "ogden", **MATERIALS["ogden"].example},
    "holzapfel-gasser-ogden": {"law": "holzapfel-gasser-ogden", **HGO},
    "a formula": FORMULA,
}


def viscous(name: str, **keys: Any) -> Viscous:
    law = Material.read({**TABLES[name], "viscous": SERIES, **keys}).law
    assert isinstance(law, Viscous)
    return law


class Path:
    """A law along a path of F with equal steps from the body at rest.

    Args:
        sudden: The first F is there at once.
    """

    def __init__(self, law: Viscous, F: FloatArray, dt: float, *, sudden: bool = False) -> None:
        memory = law.memory
        assert memory is not None
        self._law, self._memory, self._F, self._dt = law, memory, F, dt
        self._symbol = gradient_symbol()
        domain = self._symbol.ufl_domain()
        self._H = ufl.Constant(domain, (6,))
        past = {v.name: v.value(self._H) for v in memory.seen}
        step = {n: ufl.as_ufl(x) for n, x in memory.step(dt, passes=True).items()}
        self.over = memory.over_step(past, step)
        assert isinstance(self.over, SteppedLaw)
        at_end = self.over.at_end(self._symbol)
        found = {}
        for v in memory.found:
            tensor = self._program(at_end[v.name])(F)
            found[v.name] = np.stack([tensor[:, i, j] for i, j in SIX], axis=1)
        values = {v.name: np.zeros((1, v.size)) for v in memory.variables}
        self.before: list[FloatArray] = []
        for n in range(len(F)):
            length = 0.0 if sudden and n == 0 else dt
            self.before.append(memory.fold(values, length)["H"][0])
            now = {name: numbers[n : n + 1] for name, numbers in found.items()}
            values = dict(memory.follow(values, now, length))

    def _program(self, expression: Any) -> NumpyProgram:
        return NumpyProgram(expand_derivatives(expression), self._symbol, self._H)

    def stress(self, at: slice = slice(1, None)) -> FloatArray:
        """P, without the pressure where that is free, shape (n, 3, 3)."""
        over = self.over
        free = isinstance(over, SteppedSplitLaw) and getattr(self._law, "nu", 0.0) == 0.5
        P = over.shape_stress(self._symbol) if free else over.stress(self._symbol)
        return self._program(P)(self._F[at], np.array(self.before)[at])


def shears(amounts: FloatArray) -> FloatArray:
    F = np.tile(np.eye(3), (len(amounts), 1, 1))
    F[:, 0, 2] = amounts
    return F


def elastic(name: str, F: FloatArray, *, tangent: bool = False) -> FloatArray:
    """P of the law without its branches at one F; or at rest the stiffness of this shear."""
    law: Any = Material.read(TABLES[name]).law
    H, variable = variables(symbol := gradient_symbol())
    stress = law.shape_stress if getattr(law, "nu", 0.0) == 0.5 else law.stress
    if not tangent:
        return NumpyProgram(expand_derivatives(stress(symbol)), symbol)(F[None])[0]
    A = NumpyProgram(expand_derivatives(ufl.diff(stress(variable), H)), symbol)(F[None])[0]
    return A[0, 2, 0, 2]


# --- relaxation ---


@pytest.mark.parametrize(
    ("name", "on"),
    [
        (name, on)
        for name in TABLES
        for on in ("isochoric", "whole")
        if (name, on) != ("incompressible", "whole")  # which a body refuses
    ],
)
def test_a_held_shear_relaxes(name: str, on: str) -> None:
    """A sudden shear of 0.4: S stays, so that the steps are exact, however long."""
    F = shears(np.full(9, 0.4))
    t = 0.3 * np.arange(9)
    P = Path(viscous(name, viscous_on=on), F, 0.3, sudden=True).stress()[:, 0, 2]
    wanted = elastic(name, F[0])[0, 2] * (1 + np.exp(-t[1:, None] / TIMES) @ RATIOS)
    assert pytest.approx(wanted, rel=1e-11) == P


def test_the_whole_stress_relaxes_or_that_of_shape_alone() -> None:
    """A swelling relaxes where the whole stress does; instantaneous constants only fall."""
    F = np.tile(1.1 * np.eye(3), (5, 1, 1))
    t, plain = 0.3 * np.arange(1, 5), elastic("neo-hookean", F[0])[0, 0]
    for on, change in (("isochoric", 0.0 * t), ("whole", np.exp(-t[:, None] / TIMES) @ RATIOS)):
        P = Path(viscous("neo-hookean", viscous_on=on), F, 0.3, sudden=True).stress()
        assert P[:, 0, 0] == pytest.approx(plain * (1 + change), rel=1e-11)
        keys = {"viscous_on": on, "viscous_constants": "instantaneous"}
        P = Path(viscous("neo-hookean", **keys), F, 0.3, sudden=True).stress()
        lost = (on == "whole") * RATIOS.sum()
        assert P[:, 0, 0] == pytest.approx(plain * (1 - lost + change), rel=1e-11)


# --- storage and loss ---


def complex_modulus(name: str, omega: float, steps: int) -> tuple[float, float]:
    """Storage and loss over the modulus of the constants, from a shear of 1e-5 sin(omega t)."""
    periods, size = 2, 1e-5
    t = np.linspace(0, 2 * np.pi * periods / omega, periods * steps + 1)
    path = Path(viscous(name), shears(size * np.sin(omega * t)), t[1])
    P = path.stress()[:, 0, 2] / size
    fading = np.exp(-t[1:, None] / TIMES)
    parts = np.column_stack([np.sin(omega * t[1:]), np.cos(omega * t[1:]), fading])
    storage, loss = np.linalg.lstsq(parts, P, rcond=None)[0][:2]
    mu = elastic(name, np.eye(3), tangent=True)
    return float(storage / mu), float(loss / mu)


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("omega", [0.6, 6.0, 60.0])
def test_storage_and_loss(name: str, omega: float) -> None:
    """Three decades.  Chords of a sine are (omega dt)^2/12 too small: 3e-7 at 4000 steps."""
    x = omega * TIMES
    wanted = 1 + RATIOS @ (x**2 / (1 + x**2)), RATIOS @ (x / (1 + x**2))
    found = complex_modulus(name, omega, 4000)
    assert np.abs(np.subtract(found, wanted)).max() < 1e-6 * wanted[0]
    coarse = [np.abs(np.subtract(complex_modulus(name, omega, n), wanted)) for n in (50, 100)]
    slopes = np.log2(coarse[0] / coarse[1])
    assert slopes == pytest.approx([2, 2], abs=0.1)


# --- a ramp of large strains ---


def ramped(name: str, steps: int, **keys: Any) -> FloatArray:
    """P after a stretch and shear that grow as t up to t = 1."""
    t = np.linspace(0, 1, steps + 1)
    F = np.eye(3) + t[:, None, None] * GOAL
    return Path(viscous(name, **keys), F, 1 / steps).stress(slice(-1, None))[0]


GOAL = np.array([[0.3, 0.1, 0.6], [0.0, -0.1, 0.0], [0.0, 0.0, 0.05]])


@pytest.mark.parametrize("on", ["isochoric", "whole"])
@pytest.mark.parametrize("name", ["neo-hookean", "ogden", "holzapfel-gasser-ogden", "a formula"])
def test_a_ramp_of_large_strains(name: str, on: str) -> None:
    """h' = S' - h/tau by scipy; with Richardson's extrapolation the order-2 steps meet it."""
    from scipy.integrate import solve_ivp

    law: Any = Material.read(TABLES[name]).law
    symbol = gradient_symbol()
    program = NumpyProgram(expand_derivatives(law.stress(symbol)), symbol)
    iso = on == "isochoric"

    def second(t: float) -> FloatArray:
        """S of what relaxes."""
        F = np.eye(3) + t * GOAL
        J = np.linalg.det(F)
        if not iso:
            return np.linalg.solve(F, program(F[None])[0])
        bar = J ** (-1 / 3) * F  # the volumetric stress is spherical and drops out
        S = np.linalg.solve(bar, program(bar[None])[0])
        C = bar.T @ bar
        return S - np.sum(S * C) / 3 * np.linalg.inv(C)

    def rate(t: float, h: FloatArray) -> FloatArray:
        # complex steps are not at hand: differences of order 8
        d, c = 2e-2, np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])
        slope = sum(w * (second(t + k * d) - second(t - k * d)) for k, w in enumerate(c, start=1))
        parts = h.reshape(2, 9)
        return np.concatenate(
            [slope.ravel() / d - q / tau for q, tau in zip(parts, TIMES, strict=True)]
        )

    ends = solve_ivp(rate, (0, 1), np.zeros(18), method="DOP853", rtol=1e-11, atol=1e-3).y[:, -1]
    h = np.tensordot(RATIOS, ends.reshape(2, 3, 3), axes=1)
    F = np.eye(3) + GOAL
    if iso:
        C, J = F.T @ F, np.linalg.det(F)
        h = J ** (-2 / 3) * (h - np.sum(h * C) / 3 * np.linalg.inv(C))
    wanted = program(F[None])[0] + F @ h
    coarse, middle, fine = (ramped(name, n, viscous_on=on) for n in (1000, 2000, 4000))
    size = np.abs(wanted).max()
    errors = [np.abs(P - wanted).max() / size for P in (coarse, middle, fine)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.1)
    assert errors[2] < 1e-6
    assert np.abs(fine + (fine - middle) / 3 - wanted).max() < 1e-10 * size


# --- the law over a step ---

KINDS = [name for name in MATERIALS if name != "textbook" and not name.startswith("j2")]


@pytest.mark.parametrize("constants", ["long-term", "instantaneous"])
@pytest.mark.parametrize("on", ["isochoric", "whole"])
@pytest.mark.parametrize("name", KINDS)
def test_every_law_over_a_step(name: str, on: str, constants: str) -> None:
    """The tangent is symmetric, and the stress is that of the energy and that of the branches."""
    series = [{"ratio": 0.4, "time": 1}]
    keys: Any = {"viscous": series, "viscous_on": on, "viscous_constants": constants}
    law: Any = MATERIALS[name](**MATERIALS[name].example, **keys)
    random = np.random.default_rng(3)
    H = random.normal(size=(3, 3))
    past = {"H": ufl.as_matrix((1e4 * (H + H.T)).tolist())}
    steps = {n: ufl.as_ufl(x) for n, x in law.memory.step(0.7, passes=True).items()}
    over = law.memory.over_step(past, steps)
    symbol = gradient_symbol()
    variable, F = variables(symbol)
    at = np.eye(3) + 0.1 * random.normal(size=(4, 3, 3))

    def value(expression: Any) -> FloatArray:
        return NumpyProgram(expand_derivatives(expression), symbol)(at)

    A = value(ufl.diff(over.stress(F), variable))
    assert np.abs(A - A.transpose(0, 3, 4, 1, 2)).max() < 1e-12 * np.abs(A).max()
    P, of_energy = value(over.stress(symbol)), value(ufl.diff(over.energy(F), variable))
    branches = value(over.branch_stress(symbol))
    assert np.abs(P - branches - of_energy).max() < 1e-11 * np.abs(P).max()


# --- input ---


def test_what_relaxes_by_default() -> None:
    """The stress of shape, where the law has a volumetric part of its own."""
    whole = {
        name
        for name in KINDS
        if MATERIALS[name](**MATERIALS[name].example, viscous=SERIES).relaxes_whole  # type: ignore[attr-defined]
    }
    assert whole == {
        "orthotropic",
        "st-venant-kirchhoff",
        "corotated",
        "fixed-corotated",
        "blatz-ko",
    }
    assert viscous("a formula").relaxes_whole
    split = Material.read({**FORMULA, "volumetric": "log", "K": "1 GPa", "viscous": SERIES}).law
    assert isinstance(split, Viscous)
    assert not split.relaxes_whole


def test_a_python_energy_relaxes() -> None:
    law = Energy(lambda I1, J, mu: mu / 2 * (I1 - 3 - 2 * ufl.ln(J)), mu=1e6, viscous=SERIES)
    assert law.memory is not None
    assert [term.ratio for term in law.viscous] == list(RATIOS)


def test_both_names_are_one() -> None:
    """`prony` has instantaneous constants; with long-term ones in their place all is equal."""
    prony = [{"g": 0.3, "tau": 2.0}, {"g": 0.2, "tau": 1.0}]
    one: Any = MATERIALS["yeoh"](c10=1.0, nu=0.3, prony=prony)
    series = [{"ratio": 0.6, "time": 2.0}, {"ratio": 0.4, "time": 1.0}]
    other: Any = MATERIALS["yeoh"](c10=0.5, nu=0.3, viscous=series)
    again: Any = MATERIALS["yeoh"](
        c10=1.0, nu=0.3, viscous=prony, viscous_constants="instantaneous"
    )
    assert one == again
    with pytest.raises(InputError, match="`g` is a ratio to the stress of a sudden strain"):
        MATERIALS["yeoh"](c10=1.0, nu=0.3, viscous=prony)
    assert one.sudden * one.c10 == pytest.approx(other.sudden * other.c10)
    assert one.lasting * one.c10 == pytest.approx(other.lasting * other.c10)


@pytest.mark.parametrize(
    ("name", "keys", "text"),
    [
        ("linear-elastic", {"viscous": []}, "^viscous: a series without terms"),
        ("linear-elastic", {"viscous": SERIES, "prony": SERIES}, "two names of one key"),
        ("linear-elastic", {"viscous_on": "whole"}, "nothing relaxes without `viscous`"),
        ("linear-elastic", {"viscous": [{"ratio": 0, "time": 1}]}, r"^viscous\[0\].ratio"),
        ("linear-elastic", {"viscous": SERIES, "viscous_on": "shape"}, "isochoric, whole"),
        ("textbook", {"viscous": SERIES}, "the law 'textbook' cannot relax"),
        ("j2", {"viscous": SERIES}, "the law 'j2' cannot relax"),
    ],
)
def test_refused(name: str, keys: dict[str, Any], text: str) -> None:
    with pytest.raises(InputError, match=text):
        MATERIALS[name](**MATERIALS[name].example, **keys)


def test_the_report_says_what_relaxes() -> None:
    (row,) = (f for f in material_report(viscous("a formula")).findings if f.check == "relaxation")
    assert row.text == (
        "of the whole stress: after a long time 61 % of that of a sudden load; "
        "relaxation times 50 ms, 500 ms; loss factor up to 0.19, at 0.28 Hz"
    )


# --- curves ---


def test_curves_are_those_of_the_law() -> None:
    """As a shear of sines finds them, see above; and of one branch the largest loss factor."""
    law = viscous("neo-hookean")
    curves = ViscousCurves(law, TIMES, np.array([6.0]), None)
    found = complex_modulus("neo-hookean", 6.0, 4000)
    assert [curves.storage[0], curves.loss[0]] == pytest.approx(found, rel=1e-6)
    wanted = 1 + np.exp(-TIMES[:, None] / TIMES) @ RATIOS
    assert curves.relaxation == pytest.approx(wanted, rel=1e-14)
    one = viscous_curves(viscous("neo-hookean", viscous=[{"ratio": 3.0, "time": 2.0}]))
    assert one is not None
    most, omega = one.most_damped  # r/(2 sqrt(1 + r)) at 1/(tau sqrt(1 + r)); 20 points a decade
    assert most == pytest.approx(0.75, rel=2e-3)
    assert omega == pytest.approx(0.25, rel=0.06)
    assert viscous_curves(MATERIALS["yeoh"](**MATERIALS["yeoh"].example)) is None


@pytest.mark.long
def test_curves_are_written(tmp_path: pathlib.Path) -> None:
    """Where there is a shear modulus, in Pa as well; ends are those of the law."""
    for name, heads in (("a formula", 0), ("linear-elastic", 1)):
        law = viscous(name)
        report = material_report(law, largest=1.1)
        files = write(name, report, tmp_path)
        assert [f.name.rpartition("_")[2] for f in files[-6:]] == [
            "relaxation.csv",
            "oscillation.csv",
            "relaxation.png",
            "creep.csv",
            "loops.csv",
            "loops.png",
        ]
        assert files[-4].stat().st_size > 10_000
        tables = [np.genfromtxt(f, delimiter=",", names=True) for f in files[-6:-4]]
        assert ("mu" in tables[0].dtype.names) == bool(heads)
        assert tables[0]["relative"][[0, -1]] == pytest.approx([law.sudden, 1], rel=0.02)
        assert tables[1]["storage"][[0, -1]] == pytest.approx([1, law.sudden], rel=1e-3)
        assert "viscous" in report_table(report)
        if heads:
            mu = 1e6 / 2.6
            assert tables[0]["mu"] == pytest.approx(mu * tables[0]["relative"], rel=1e-10)
            assert tables[1]["loss_mu"] == pytest.approx(mu * tables[1]["loss"], rel=1e-10)


@pytest.mark.long
def test_the_report_draws_what_relaxes() -> None:
    plain = {"law": "linear-elastic", "E": "1 MPa", "nu": 0.3}
    (one,) = materials_of({"materials": {"gel": plain}})
    (other,) = materials_of({"materials": {"gel": {**plain, "viscous": SERIES}}})
    assert len(other.charts) == len(one.charts) + 4  # creep and loops, too
    assert "frequency [Hz]" in other.charts[-3]
