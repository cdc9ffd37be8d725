"""What a sweep varies: lists, distributions, and what is wrong with them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm, qmc

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.units import number_and_unit
from dolfin_elastic.study.sweep.settings import (
    Setting,
    design,
    read_setting,
    short_names,
)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("1 MPa,2 MPa", ("1 MPa", "2 MPa")),
        ("0.1, 0.2", (0.1, 0.2)),
        ("1,2e3,true", (1, 2e3, True)),
        ("[0, 1],[1, 0]", ([0, 1], [1, 0])),
        ('"a, b",c', ("a, b", "c")),
        ("sin(2*t, 3)", ("sin(2*t, 3)",)),
        ("left", ("left",)),
    ],
)
def test_lists(text: str, values: tuple[object, ...]) -> None:
    """Values as TOML has them, and texts without quotes; commas inside brackets stay."""
    assert read_setting("a.b", text).values == values


def test_lists_of_python() -> None:
    """Numbers of NumPy are those of Python, which a record holds."""
    assert read_setting("a.b", np.array([1.5, 2.5])).values == (1.5, 2.5)
    assert read_setting("a.b", [[0, 1], [1, 0]]).values == ([0, 1], [1, 0])
    assert read_setting("a.b", 3).values == (3,)


def numbers(setting: Setting, given: object = None) -> np.ndarray:
    """10,000 values of a distribution, without their unit."""
    assert setting.spread is not None
    q = (np.arange(10_000) + 0.5) / 10_000
    read = [number_and_unit(value) for value in setting.spread.around(given, "a.b").at(q)]
    return np.array([one[0] for one in read if one is not None])


@pytest.mark.parametrize(
    ("text", "mean", "deviation"),
    [
        ("normal(210 GPa, 3 %)", 210, 6.3),
        ("normal(-2 kN, 10 %)", -2, 0.2),
        ("normal(210 GPa, 5 GPa)", 210, 5),
        ("lognormal(2, 0.5)", 2, 0.5),
        ("uniform(1 MPa, 3 MPa)", 2, 2 / 12**0.5),
        ("normal(10 %)", 5, 0.5),
        ("uniform(10 %)", 5, 1 / 12**0.5),
    ],
)
def test_distributions(text: str, mean: float, deviation: float) -> None:
    """Mean and deviation at 10,000 equal fractions, within what the tails lose (4e-3)."""
    x = numbers(read_setting("a.b", text), "5 GPa")
    assert x.mean() == pytest.approx(mean, rel=1e-3)
    assert x.std() == pytest.approx(deviation, rel=4e-3)


def test_units_stay() -> None:
    """A value is written as the case would have it."""
    spread = read_setting("a.b", "normal(5 %)").spread
    assert spread is not None
    (value,) = spread.around("210 GPa", "a.b").at(np.array([0.5]))
    assert value == "210 GPa"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nrmal(3 %)", "did you mean 'normal'"),
        ("1,", "a value is missing"),
        ("", "a value is missing"),
        ("normal(3 GPa)", "no percentage"),
        ("normal(1 GPa, 2 MPa)", "different units"),
        ("normal(1, 2, 3)", "no distribution"),
        ("normal(1, -2)", "not positive"),
        ("uniform(2, 1)", "empty"),
        ("lognormal(-1, 10 %)", "positive mean"),
        ("normal(0 mm, 3 %)", "percentage of 0"),
        ("gauss(3 %)", "no distribution 'gauss'"),
        ("normal(210 GPa", "bracket is not closed"),
    ],
)
def test_wrong_values(text: str, message: str) -> None:
    """Each with the key and an example."""
    with pytest.raises(InputError, match=message) as error:
        read_setting("materials.steel.E", text)
    assert error.value.where == "materials.steel.E"
    assert error.value.expected


def test_nothing_to_vary_around() -> None:
    """A vector, or a formula, has no mean."""
    spread = read_setting("load[0].value", "normal(5 %)").spread
    assert spread is not None
    with pytest.raises(InputError, match="no number to vary around"):
        spread.around([0, 1], "load[0].value")


def test_grid_and_zip() -> None:
    """The last key varies fastest, as in nested loops; or first with first."""
    settings = [read_setting("a", "1,2"), read_setting("b", "3,4")]
    grid = [(row["a"], row["b"]) for row in design(settings).rows]
    assert grid == [(1, 3), (1, 4), (2, 3), (2, 4)]
    zipped = [(row["a"], row["b"]) for row in design(settings, together=True).rows]
    assert zipped == [(1, 3), (2, 4)]


def test_a_latin_hypercube() -> None:
    """One sample in each stripe of each setting; the same with the same seed only."""
    settings = [read_setting(key, "uniform(0, 1)") for key in "ab"]
    rows = design(settings, samples=50, seed=3).rows
    for key in "ab":
        x = np.array([row[key] for row in rows], dtype=float)
        assert sorted(np.floor(50 * x).astype(int)) == list(range(50))
    assert rows == design(settings, samples=50, seed=3).rows
    assert rows != design(settings, samples=50, seed=4).rows


@pytest.mark.parametrize(("columns", "samples"), [(1, 2), (1, 40), (3, 501)])
def test_samples_are_those_of_scipy(columns: int, samples: int) -> None:
    """Its hypercube and its quantiles, to the digits of a case: seeds keep their samples."""
    cube = qmc.LatinHypercube(columns, rng=np.random.default_rng(7)).random(samples)
    settings = [read_setting(key, "normal(1, 0.5)") for key in "abc"[:columns]]
    rows = design(settings, samples=samples, seed=7).rows
    exact = [[float(f"{x:.7g}") for x in row] for row in norm(1, 0.5).ppf(cube)]
    assert [list(row.values()) for row in rows] == exact


def test_samples_at_the_ends_are_finite() -> None:
    """Fractions 0 and 1, which Sobol's points may have, as eight deviations."""
    spread = read_setting("a", "normal(0 K, 1 K)").spread
    assert spread is not None
    low, high = (float(str(x).split()[0]) for x in spread.at(np.array([0.0, 1.0])))
    assert low == pytest.approx(-high, rel=0.01)
    assert high == pytest.approx(8.2, abs=0.1)


def test_samples_of_sobol() -> None:
    """A, B, and A with one column of B."""
    settings = [read_setting(key, "uniform(0, 1)") for key in "abc"]
    rows = design(settings, sobol=8).rows
    assert len(rows) == 8 * 5
    A, B, *mixed = (rows[i : i + 8] for i in range(0, 40, 8))
    for key, own in zip("abc", mixed, strict=True):
        for a, b, row in zip(A, B, own, strict=True):
            assert row == {**a, key: b[key]}


@pytest.mark.parametrize(
    ("texts", "options", "message"),
    [
        ({}, {}, "nothing varies"),
        ({"a": "1,2", "b": "1,2,3"}, {"together": True}, "different lengths"),
        ({"a": "1,2", "b": "normal(1, 2)"}, {"together": True}, "nothing to go together with"),
        ({"a": "1,2"}, {"samples": 5}, "nothing scatters"),
        ({"a": "normal(1, 2)"}, {"sobol": 6}, "no power of 2"),
        ({"a": "normal(1, 2)", "b": "1,2"}, {"sobol": 4}, "list of values"),
        ({"a": "normal(1, 2)"}, {"samples": 1_000_000}, "too many"),
    ],
)
def test_wrong_designs(texts: dict[str, str], options: dict[str, int], message: str) -> None:
    """Before anything is computed."""
    with pytest.raises(InputError, match=message):
        design([read_setting(key, text) for key, text in texts.items()], **options)


def test_a_key_that_varies_twice() -> None:
    """One of the lists would be lost."""
    with pytest.raises(InputError, match="twice"):
        design([read_setting("a", "1,2"), read_setting("a", "3")])


def test_short_names() -> None:
    """As many parts as tell keys apart, indices with what they are of."""
    keys = ["materials.a.E", "materials.b.E", "mesh.size", "load[0].value[2]", "load[1].value[2]"]
    names = ["a.E", "b.E", "size", "load[0].value[2]", "load[1].value[2]"]
    assert list(short_names(keys).values()) == names
    assert short_names(["load[0].value[2]"]) == {"load[0].value[2]": "value[2]"}
