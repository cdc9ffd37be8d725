"""The elastic constants: every pair gives the same solid, and impossible ones are refused."""

from __future__ import annotations

from itertools import combinations

import pytest

from dolfin_elastic import NeoHookean
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.materials.isochoric import Isochoric
from dolfin_elastic.model.materials.moduli import NAMES, complete
from dolfin_elastic.model.materials.plasticity import Plastic
from dolfin_elastic.model.materials.registry import MATERIALS, Isotropic

PAIRS = list(combinations(NAMES, 2))


def solid(E: float, nu: float) -> dict[str, float]:
    """All five constants by Landau & Lifshitz (5.9)."""
    return {
        "E": E,
        "nu": nu,
        "K": E / (3 * (1 - 2 * nu)),
        "lmbda": E * nu / ((1 + nu) * (1 - 2 * nu)),
        "mu": E / (2 * (1 + nu)),
    }


def test_there_are_ten_pairs():
    assert len(PAIRS) == 10


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
@pytest.mark.parametrize(
    ("E", "nu"), [(1.0, 0.25), (1e7, 0.3), (210e9, 0.31), (3.7e-2, 0.45), (5e5, -0.3), (2.0, 0.02)]
)
def test_any_pair_gives_all_five(E, nu, pair):
    expected = solid(E, nu)
    found = complete(**{name: expected[name] for name in pair})
    for name in NAMES:
        # A small nu is a difference of larger numbers: it is judged on the scale of 1.
        absolute = 1e-14 if name == "nu" else 1e-14 * E
        assert getattr(found, name) == pytest.approx(expected[name], rel=1e-13, abs=absolute)


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_nearly_incompressible(pair):
    expected = solid(1e7, 0.4999)
    found = complete(**{name: expected[name] for name in pair})
    for name in NAMES:
        # Round-off is amplified by 1/(1 - 2 nu) = 5000.
        assert getattr(found, name) == pytest.approx(expected[name], rel=5000 * 1e-15)


@pytest.mark.parametrize("pair", [p for p in PAIRS if p != ("nu", "lmbda")], ids="-".join)
def test_a_solid_that_does_not_contract_sideways(pair):
    expected = solid(8.0, 0.0)
    found = complete(**{name: expected[name] for name in pair})
    for name in NAMES:
        assert getattr(found, name) == pytest.approx(expected[name], rel=1e-14, abs=1e-14)


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_given_constants_stay_as_given(pair):
    given = {name: solid(1.1, 0.37)[name] for name in pair}
    found = complete(**given)
    assert {name: getattr(found, name) for name in pair} == given


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({}, "two elastic constants are needed, 0 given"),
        ({"E": 1.0}, "1 given (E)"),
        ({"E": 1.0, "nu": 0.3, "mu": 1.0}, "3 given (E, nu, mu)"),
        ({"E": -1.0, "nu": 0.3}, "-1 is not a possible E"),
        ({"E": 0.0, "nu": 0.3}, "0 is not a possible E"),
        ({"E": float("nan"), "nu": 0.3}, "nan is not a possible E"),
        ({"E": 1.0, "nu": 0.51}, "not above 0.5"),
        ({"K": 1.0, "nu": 0.5}, "no finite bulk modulus"),
        ({"E": 1.0, "nu": -1.0}, "above -1"),
        ({"E": 1.0, "nu": float("nan")}, "Poisson"),
        ({"E": 1.0, "mu": 0.3}, "no stable elastic solid has E = 1, mu = 0.3"),  # nu = 2/3
        ({"E": 9.0, "K": 1.0}, "no stable elastic solid"),  # infinite mu
        ({"E": 3.0, "mu": 1.0}, "no stable elastic solid"),  # infinite K
        ({"K": 1.0, "lmbda": 2.0}, "no stable elastic solid has K = 1, lmbda = 2"),
        ({"lmbda": -1.0, "mu": 1.0}, "no stable elastic solid"),  # infinite E
        ({"nu": 0.0, "lmbda": 1.0}, "no stable elastic solid"),
        ({"nu": -0.2, "lmbda": 1.0}, "no stable elastic solid"),
        ({"E": float("inf"), "nu": 0.3}, "no stable elastic solid"),
    ],
)
def test_impossible_constants_are_refused(given, says):
    with pytest.raises(InputError) as caught:
        complete(**given)
    assert says in str(caught.value)


@pytest.mark.parametrize(
    "name", [name for name, kind in MATERIALS.items() if issubclass(kind, Isotropic)]
)
def test_laws_take_any_pair(name):
    more = {"yield": "1 MPa"} if issubclass(MATERIALS[name], Plastic) else {}
    law = MATERIALS[name](K=5e6, mu=1e6, **more)
    assert law.lmbda == pytest.approx(5e6 - 2e6 / 3, rel=1e-14)
    assert {n: x for n, x in law.constants().items() if n in NAMES} == {"K": 5e6, "mu": 1e6}
    assert {name: getattr(law, name) for name in NAMES} == pytest.approx(
        solid(9 * 5e6 * 1e6 / (3 * 5e6 + 1e6), (15e6 - 2e6) / (2 * (15e6 + 1e6))), rel=1e-13
    )


@pytest.mark.parametrize("nu", [-0.2, 0.0, 0.3, 0.49])
@pytest.mark.parametrize(
    "name", [name for name, kind in MATERIALS.items() if issubclass(kind, Isochoric)]
)
def test_constants_of_the_shape_and_one_of_the_volume(name, nu):
    """K from nu and nu from K, of numbers and where constants vary: Landau & Lifshitz (5.9)."""
    kind = MATERIALS[name]
    shape = {key: value for key, value in kind.example.items() if key not in ("K", "nu")}
    mu = kind(**shape, K=1e9).shear()
    K = solid(2 * mu * (1 + nu), nu)["K"]
    one, other = kind(**shape, nu=nu), kind(**shape, K=K)
    assert (one.K, one.nu) == pytest.approx((K, nu), rel=1e-13)
    assert other.nu == pytest.approx(nu, rel=1e-12, abs=1e-14)
    by_nu, by_K = kind(**shape, nu=f"{nu!r} + 0*x"), kind(**shape, K=f"{K!r} + 0*x")
    assert pytest.approx(K, rel=1e-13) == by_nu.with_values({"nu": nu}).K
    assert by_K.with_values({"K": K}).nu == pytest.approx(nu, rel=1e-12, abs=1e-14)


def test_laws_read_units_and_the_name_lambda():
    law = NeoHookean(**{"lambda": "2 MPa", "mu": "500 kPa"})
    assert (law.lmbda, law.mu) == (2e6, 5e5)
    with pytest.raises(InputError, match="two elastic constants"):
        NeoHookean(E=1e6)
    with pytest.raises(InputError, match="not a possible Poisson"):
        NeoHookean(E=1e6, nu=0.6)


@pytest.mark.parametrize("given", [{"E": 3e6}, {"mu": 1e6}])
def test_incompressible_solid(given):
    """nu = 0.5: E = 3 mu, and a volume that cannot change."""
    found = complete(**given, nu=0.5)
    assert (found.E, found.mu, found.nu) == (3e6, 1e6, 0.5)
    assert found.K == found.lmbda == float("inf")
