"""Constants from measured curves: published data, closed forms, known truth."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import ROOT

from dolfin_elastic import LinearElastic, MooneyRivlin, NeoHookean, Yeoh, fit
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.study.fit.curves import TestCurve
from dolfin_elastic.study.fit.homogeneous import HomogeneousTests
from dolfin_elastic.study.fit.stable import STABLE
from dolfin_elastic.study.fit.written import write_fit

pytestmark = pytest.mark.usefixtures("serial_only")
TRELOAR = ROOT / "demos" / "treloar"
"""L. R. G. Treloar, Trans. Faraday Soc. 40 (1944) 59: vulcanised natural rubber."""
OGDEN = {"law": "ogden", "mu": ["fit"] * 3, "alpha": ["fit"] * 3, "nu": 0.5}


def treloar(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Stretches and nominal stresses [Pa]."""
    table = np.loadtxt(TRELOAR / f"{kind}.csv", delimiter=",", skiprows=2)
    return table[:, 0], 1e6 * table[:, 1]


@pytest.mark.long
def test_ogden_with_three_terms_for_treloars_rubber():
    """Within 2 % of the largest stress of each test, in one law for all three."""
    kinds = ("uniaxial", "equibiaxial", "planar")
    found = fit(OGDEN, {kind: TRELOAR / f"{kind}.csv" for kind in kinds})
    assert found.ended
    assert all(curve.relative < 0.02 for curve in found.curves)
    assert found.same >= 3  # starts that have come to the same answer
    assert found.stability == (STABLE,)
    pairs = list(zip(found.law.mu, found.law.alpha, strict=True))
    for curve in found.curves:
        s = curve.measured.x
        # R. W. Ogden (1984), section 7.2: the other stretches of an incompressible solid.
        thin = {"uniaxial": -0.5, "equibiaxial": -2.0, "planar": -1.0}[curve.measured.kind]
        exact = sum(m * (s ** (a - 1) - s ** (thin * a - 1)) for m, a in pairs)
        assert curve.stress == pytest.approx(exact, rel=1e-9)


S, P = treloar("uniaxial")
NEAR = S < 4
"""Where laws of few constants follow rubber."""
MODES = {"uniaxial": -0.5, "equibiaxial": -2.0, "planar": -1.0}


def first_and_second(s: np.ndarray, thin: float) -> tuple[np.ndarray, np.ndarray]:
    """dI1/ds and dI2/ds along s, or half of it where two sides are pulled; all of one test."""
    t = s**thin
    # P = 2 (s - t^2/s) (dW/dI1 + r^2 dW/dI2), r the stretch of the side that is left.
    side = {-0.5: t, -2.0: s, -1.0: np.ones_like(s)}[thin]
    base = 2 * (s - t**2 / s)
    return base, base * side**2


@pytest.mark.parametrize("kind", MODES)
@pytest.mark.parametrize("name", ["neo-hookean", "mooney-rivlin", "yeoh"])
def test_linear_laws_reach_the_unique_least_squares(kind, name):
    """Of numpy, to five digits and more: both solve the same linear problem."""
    s, P = treloar(kind)
    s, P = s[s < 4], P[s < 4]
    first, second = first_and_second(s, MODES[kind])
    I1 = s**2 + s ** (2 * MODES[kind]) + (s ** (-2 - 2 * MODES[kind])) - 3
    columns, names, law = {
        "neo-hookean": ([first / 2], ["mu"], NeoHookean(mu=1e5, nu=0.5)),
        "mooney-rivlin": ([first, second], ["c10", "c01"], MooneyRivlin(c10=1e5, c01=1e3, nu=0.5)),
        "yeoh": (
            [first, 2 * I1 * first, 3 * I1**2 * first],
            ["c10", "c20", "c30"],
            Yeoh(c10=1e5, c20=-1e3, c30=10.0, nu=0.5),
        ),
    }[name]
    exact = np.linalg.lstsq(np.column_stack(columns), P, rcond=None)[0]
    found = fit(law, {kind: (s, P)})
    values = [found[one].value for one in names]
    if (name, kind) == ("mooney-rivlin", "planar"):  # I1 = I2
        assert not np.isfinite([found[one].half for one in names]).any()
        assert "c10 and c01 cannot be distinguished by these tests" in found.unknown[0]
        assert found.unknown[0].endswith("test would tell")
        assert sum(values) == pytest.approx(exact.sum(), rel=1e-7)
    elif exact.min() < 0 and name == "mooney-rivlin":
        assert found["c01"].bound
    else:
        assert values == pytest.approx(exact, rel=1e-7)


def test_constants_that_cannot_be_told_apart_have_no_correlation(tmp_path):
    """In planar tension I1 = I2; the csv has empty cells, the sentence does not name them."""
    found = fit(MooneyRivlin(c10=1e5, c01=1e3, nu=0.5), {"planar": (S[NEAR], P[NEAR])})
    assert np.diag(found.correlation) == pytest.approx([1.0, 1.0], abs=0)
    assert np.isnan(found.correlation[[0, 1], [1, 0]]).all()
    assert not any("correlated" in line for line in found.notes)
    write_fit("rubber", found, tmp_path)
    rows = (tmp_path / "rubber_constants.csv").read_text().splitlines()[1:]
    assert [row.split(",")[-2:] for row in rows] == [["1", ""], ["", "1"]]


def test_several_curves_with_weights_are_one_linear_least_squares():
    """Each curve counts by its weight over its number of points and mean square."""
    rows, right, data = [], [], {}
    weights = {"uniaxial": 2.0, "planar": 0.5}
    for kind, thin in MODES.items():
        s, P = treloar(kind)
        s, P = s[s < 3.1], P[s < 3.1]
        data[kind] = (s, P)
        factor = np.sqrt(weights.get(kind, 1.0) / np.sum(P**2))
        rows.append(factor * np.column_stack(first_and_second(s, thin)))
        right.append(factor * P)
    exact = np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]
    found = fit(MooneyRivlin(c10=1e5, c01=1e3, nu=0.5), data, weights=weights)
    assert [found["c10"].value, found["c01"].value] == pytest.approx(exact, rel=1e-7)


def test_compressible_material_by_a_volumetric_test():
    """Free sides are found by Newton's method; the truth comes back from exact curves."""
    true = NeoHookean(mu=0.4e6, K=3e6)
    s, J = np.linspace(0.7, 2.0, 14), np.linspace(0.8, 1.1, 7)
    tests = HomogeneousTests(true, [])
    none = np.zeros((1, 0))
    pull = tests.predict(TestCurve("uniaxial", s, np.ones_like(s)), none)[0]
    squeeze = tests.predict(TestCurve("volumetric", J, np.ones_like(J)), none)[0]
    found = fit(NeoHookean(mu=1e5, K=1e6), {"uniaxial": (s, pull), "volumetric": (J, -squeeze)})
    assert found["mu"].value == pytest.approx(0.4e6, rel=1e-6)
    assert found["K"].value == pytest.approx(3e6, rel=1e-6)


@pytest.mark.long
def test_intervals_hold_the_truth():
    """In 90 to 98 of 100 noisy data sets, of each constant and on the whole: 95 are expected."""
    true, s = np.array([0.2e6, 0.05e6]), np.linspace(1.05, 2.5, 20)
    first, second = first_and_second(s, -0.5)
    stress = first * true[0] + second * true[1]
    draw, law, held = np.random.default_rng(3), MooneyRivlin(c10=1e5, c01=1e3, nu=0.5), []
    for _ in range(100):
        noisy = stress + draw.normal(0.0, 5e3, len(s))
        found = fit(law, {"uniaxial": (s, noisy)})
        ends = [found[name].interval for name in ("c10", "c01")]
        held.append([low <= x <= high for x, (low, high) in zip(true, ends, strict=True)])
    assert all(90 <= count <= 98 for count in np.sum(held, axis=0))


@pytest.mark.long
def test_intervals_of_an_exponent_from_two_tests_of_different_scatter():
    """The same where the model is linearised, and each test has a scatter of its own."""
    mu, alpha, s = 0.3e6, 2.6, np.linspace(1.1, 2.5, 16)
    exact = {
        kind: mu * (s ** (alpha - 1) - s ** (MODES[kind] * alpha - 1))
        for kind in ("uniaxial", "planar")
    }
    law = {"law": "ogden", "mu": ["0.2 MPa"], "alpha": [2.0], "nu": 0.5}
    draw, held = np.random.default_rng(5), []
    for _ in range(100):
        noise = {"uniaxial": 4e3, "planar": 15e3}
        data = {kind: (s, P + draw.normal(0, noise[kind], len(s))) for kind, P in exact.items()}
        found = fit(law, data, starts=1)
        true = {"mu[0]": mu, "alpha[0]": alpha}
        ends = [(*found[name].interval, x) for name, x in true.items()]
        held.append([low <= x <= high for low, high, x in ends])
    assert all(90 <= count <= 98 for count in np.sum(held, axis=0))


def test_a_formula_of_ones_own():
    """Yeoh's energy typed in, hardly compressible, has the constants of the law."""
    s, P = treloar("uniaxial")
    s, P = s[s < 5], P[s < 5]
    yeoh = fit(Yeoh(c10=1e5, c20=-1e3, c30=10.0, nu=0.5), {"uniaxial": (s, P)})
    law = {"energy": "c1*(I1bar - 3) + c2*(I1bar - 3)^2 + c3*(I1bar - 3)^3"}
    law |= {"parameters": {"c1": "0.1 MPa", "c2": "-1 kPa", "c3": "10 Pa"}}
    law |= {"volumetric": "quadratic", "K": "50 GPa"}
    found = fit(law, {"uniaxial": (s, P)}, starts=1)
    values = [found[f"parameters.c{i}"].value for i in (1, 2, 3)]
    exact = [yeoh[name].value for name in ("c10", "c20", "c30")]
    assert values == pytest.approx(exact, rel=1e-3)  # mu/K at the largest stretch
    assert found["K"].held


def test_a_weak_bulk_modulus_wants_a_volumetric_test():
    s, P = treloar("uniaxial")
    found = fit({"law": "neo-hookean", "mu": "fit", "K": "fit"}, {"uniaxial": (s[:8], P[:8])})
    assert any("a volumetric test would tell" in line for line in found.unknown)


NECKS = np.linspace(1.1, 3.0, 20)
"""Stretches of a bar whose force falls from 1.93 on."""
FALLS = 1e6 * (NECKS - NECKS**-2) * np.exp(-0.4 * (NECKS - 1) ** 2)


@pytest.mark.long
def test_the_best_of_stable_laws():
    """The constants are those of the quadratic program, Yeoh's force being linear in them.

    At least sum ((P - P_measured)/s)^2 where the slope of P over the stretch is c s or more from
    point to point, s the r.m.s. stress and c = 1e-3: by SLSQP, to a penalty's distance.
    """
    from scipy.optimize import minimize

    def columns(s: np.ndarray) -> np.ndarray:
        base, I1 = 2 * (s - s**-2), s**2 + 2 / s - 3
        return np.column_stack([base, 2 * I1 * base, 3 * I1**2 * base]) * [1e5, 1e4, 1e3]

    size, x = np.sqrt(np.mean(FALLS**2)), np.linspace(1.0, 3.0, 16)
    A, b = columns(NECKS) / size, FALLS / size
    G = np.diff(columns(x), axis=0) / np.diff(x)[:, None] / size
    exact = minimize(
        lambda z: np.sum((A @ z - b) ** 2),
        [4.0, -2.0, 1.0],
        jac=lambda z: 2 * A.T @ (A @ z - b),
        constraints={"type": "ineq", "fun": lambda z: G @ z - 1e-3, "jac": lambda z: G},
        options={"ftol": 1e-14, "maxiter": 500},
    ).x * [1e5, 1e4, 1e3]
    law, data = Yeoh(c10=1e5, c20=-1e3, c30=1.0, nu=0.5), {"uniaxial": (NECKS, FALLS)}
    free, found = fit(law, data), fit(law, data, stable=True)
    assert "not stable over the whole uniaxial test" in free.stability[0]
    assert found.stability == (STABLE,)
    assert found.ended and found.same >= 3
    assert [found[c].value for c in ("c10", "c20", "c30")] == pytest.approx(exact, rel=1e-4)
    assert "without and with it: uniaxial 0.24 % and 19 %" in found.notes[0]
    assert found.notes[0].endswith("; the intervals are those without it")
    assert (free.condition, found.condition) == ("", "that of stability")
    assert free.curves[0].relative == pytest.approx(0.0024, abs=5e-5)
    assert found.curves[0].relative == pytest.approx(0.19, abs=5e-3)


def test_stability_costs_nothing_where_it_is_there():
    """The answer and its errors are those without the condition."""
    law, data = MooneyRivlin(c10=1e5, c01=1e4, nu=0.5), {"uniaxial": (S[NEAR], P[NEAR])}
    free, found = fit(law, data), fit(law, data, stable=True)
    assert [c.value for c in found.constants] == [c.value for c in free.constants]
    assert found.notes == free.notes
    assert found.condition == ""


def test_the_best_of_laws_with_a_positive_shear_modulus():
    """Least squares where 2 (c10 + c01) = c s, to a penalty's distance; without, it is below 0.

    s is the r.m.s. stress and c = 1e-3.
    """
    s = np.linspace(1.1, 2.5, 12)
    first, second = first_and_second(s, -0.5)
    P = -0.3e6 * first + 0.28e6 * second
    data = {"uniaxial": TestCurve("uniaxial", s, P)}  # it pushes, which files may not have
    found = fit(MooneyRivlin(c10=1e5, c01=1e4, nu=0.5), data)
    mu = 1e-3 * np.sqrt(np.mean(P**2))
    c01 = (second - first) @ (P - mu / 2 * first) / np.sum((second - first) ** 2)
    assert found["c01"].value == pytest.approx(c01, rel=1e-5)
    assert found.law.shear() == pytest.approx(mu, rel=1e-2)
    assert found.ended and found.same >= 2
    assert found.condition == "that of a positive shear modulus"
    assert found.notes[0].startswith("without a condition the shear modulus at small strains is")


def test_ogdens_constants_have_a_positive_shear_modulus():
    """Stresses that fall below 0: the law accepts the constants, and what they cost is told."""
    s, falling = np.linspace(1.05, 3.0, 12), np.linspace(1e5, -3e5, 12)
    law = {"law": "ogden", "mu": ["fit"], "alpha": ["fit"], "nu": 0.5}
    found = fit(law, {"uniaxial": TestCurve("uniaxial", s, falling)}, starts=2)
    assert found.ended
    assert found.law.shear() > 0
    assert "r.m.s. errors over the largest stress without and with it: uniaxial" in found.notes[0]


@pytest.mark.long
@pytest.mark.parametrize(
    "law",
    [
        {"law": "ogden", "mu": ["0.6 MPa"], "alpha": [2], "nu": 0.5},
        {"law": "yeoh", "c10": "0.4 MPa", "c20": "-30 kPa", "c30": "1 kPa", "nu": 0.45},
    ],
    ids=["not linear in its constants", "compressible"],
)
def test_other_stable_laws(law):
    """Stability costs accuracy, and the law has it."""
    data, fix = {"uniaxial": (NECKS, FALLS)}, ["c30"] if "c30" in law else []
    free, found = fit(law, data, fix=fix), fit(law, data, fix=fix, stable=True)
    assert "not stable" in free.stability[0]
    assert found.stability == (STABLE,) and found.ended
    errors = [sum(c.relative**2 for c in one.curves) for one in (free, found)]
    assert errors[0] < errors[1]


def test_stability_that_no_constants_have():
    """The exponent is fixed: the best so far is told, with why it has not ended."""
    law, data = Yeoh(c10=1e5, c20=-2e4, c30=0.0, nu=0.5), {"uniaxial": (NECKS, FALLS)}
    found = fit(law, data, fix=["c20", "c30"], bounds={"c10": (1e5, 3e5)}, stable=True)
    assert not found.ended
    assert found.why == "no constants were found with which the law is stable over the tests"
    assert "not stable" in found.stability[0]
    with pytest.raises(InputError, match="the stability of this law in these tests is not known"):
        fit(LinearElastic(E=1e6, nu=0.3), data, stable=True)


def test_true_strain_in_percent_with_true_stress(tmp_path):
    """Cauchy's stress s P over ln s, the heads say so: the modulus comes back."""
    s = np.linspace(1.1, 2.0, 10)
    table = np.column_stack([100 * np.log(s), 0.3 * (s**2 - 1 / s)])
    head = "true strain [%],true stress [MPa]"
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header=head, comments="")
    found = fit(NeoHookean(mu=1e5, nu=0.5), {"uniaxial": tmp_path / "a.csv"})
    assert found["mu"].value == pytest.approx(0.3e6, rel=1e-9)
    assert found.curves[0].relative < 1e-9


def test_a_constant_stays_within_its_bounds():
    """At the nearest end if the least squares lie beyond it; the others are best for that."""
    s = np.linspace(1.1, 2.5, 12)
    first, second = first_and_second(s, -0.5)
    P, law = 0.2e6 * first + 0.05e6 * second, MooneyRivlin(c10=1e5, c01=1e4, nu=0.5)
    wide = fit(law, {"uniaxial": (s, P)}, bounds={"c10": "0.1 MPa:1 MPa"})
    assert wide["c10"].value == pytest.approx(0.2e6, rel=1e-7)
    assert not wide["c10"].bound
    tight = fit(law, {"uniaxial": (s, P)}, bounds={"c10": (None, 0.15e6)})
    assert tight["c10"].value == pytest.approx(0.15e6, rel=1e-9)
    assert tight["c10"].bound
    assert "the tests want more than 150 kPa, which --bounds leaves out" in " ".join(tight.notes)
    rest = second @ (P - 0.15e6 * first) / (second @ second)
    assert tight["c01"].value == pytest.approx(rest, rel=1e-7)


def test_simple_shear():
    """P = mu g of neo-Hookean bodies and 2 (c10 + c01) g of Mooney-Rivlin: Ogden (1984), 4.4."""
    g = np.linspace(-0.5, 1.0, 8)
    data = {"shear": (g, 0.4e6 * g)}
    assert fit(NeoHookean(mu=1e5, nu=0.5), data)["mu"].value == pytest.approx(0.4e6, rel=1e-9)
    two = fit(MooneyRivlin(c10=1e5, c01=1e4, nu=0.5), data)
    assert two["c10"].value + two["c01"].value == pytest.approx(0.2e6, rel=1e-9)
    assert not np.isfinite([two["c10"].half, two["c01"].half]).any()


def test_where_stability_ends():
    """Yeoh's law with c20 < 0 fixed: at the largest force, to a point of those looked at.

    P = 2 (s - s^-2)(c10 + 2 c20 (I1 - 3)); shear bands need more: W' + 2 W'' (s - s^-1/2)^2 < 0.
    """
    c10, c20, s = 2e5, -2e4, np.linspace(1.05, 2.6, 20)

    def force(x: np.ndarray) -> np.ndarray:
        return 2 * (x - x**-2) * (c10 + 2 * c20 * (x**2 + 2 / x - 3))

    law = Yeoh(c10=1e5, c20=c20, c30=0.0, nu=0.5)
    found = fit(law, {"uniaxial": (s, force(s))}, fix=["c20", "c30"])
    assert found["c10"].value == pytest.approx(c10, rel=1e-9)
    (line,) = found.stability
    assert "not stable over the whole uniaxial test" in line
    x = np.linspace(1.0, 2.6, 4000)
    top = x[np.argmax(force(x))]
    assert 1.5 < top < 2.4
    assert float(line.rpartition(" ")[2]) == pytest.approx(top, abs=1.6 / 15)
