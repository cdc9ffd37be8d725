"""What is refused of curves, laws and options, with file, line and column; codes of the command."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from helpers.processes import cli
from mpi4py import MPI

from dolfin_elastic import MooneyRivlin, NeoHookean, fit
from dolfin_elastic.case.tables import Material
from dolfin_elastic.cli.fit import _tables
from dolfin_elastic.cli.fit_case import constant_rows
from dolfin_elastic.core.errors import InputError, SolveError
from dolfin_elastic.core.si_text import percent
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.study.fit.constants import chosen, constants_of, guessed, table_with
from dolfin_elastic.study.fit.curves import TestCurve, read_curve
from dolfin_elastic.study.fit.written import material_toml
from dolfin_elastic.study.least_squares.fitted import FittedConstant, error_text

pytestmark = pytest.mark.skipif(
    MPI.COMM_WORLD.size > 1, reason="starts mpirun itself, which cannot be nested"
)
TRELOAR = ROOT / "demos" / "treloar"
GOOD = "stretch,stress\n1.1,0.1\n1.2,0.2\n1.3,0.3\n"
LAW = '[materials.rubber]\nlaw = "neo-hookean"\nmu = "1 MPa"\nnu = 0.5\n'


def read(tmp_path: Path, text: str, kind: str = "uniaxial", **keys: object):
    """The curve of a file."""
    (tmp_path / "a.csv").write_text(text)
    return read_curve(kind, tmp_path / "a.csv", **keys)


def test_headings_units_and_measures(tmp_path):
    assert read(tmp_path, GOOD, unit="MPa").stress == pytest.approx([1e5, 2e5, 3e5])
    # The unit of a heading wins, strains become stretches, columns may come in any order.
    curve = read(tmp_path, "Stress [kPa];Strain [%]\n100;10\n200;20\n", unit="MPa")
    assert curve.stress == pytest.approx([1e5, 2e5])
    assert curve.x == pytest.approx([1.1, 1.2])
    assert not curve.true
    assert read(tmp_path, "true stress (MPa),true strain\n1,0.1\n").true
    assert read(tmp_path, "1.1,0.1\n1.2,0.2\n").x == pytest.approx([1.1, 1.2])
    squeezed = read(tmp_path, "J,pressure [MPa]\n0.99,2\n", "volumetric")
    assert squeezed.stress == pytest.approx([-2e6])


@pytest.mark.parametrize(
    ("kind", "text", "words"),
    [
        ("uniaxial", GOOD.replace("stretch", "strech"), ("line 1", "stretch", "'stretch'?")),
        ("uniaxial", GOOD.replace("stress", "force"), ("line 1", "no column has the stress")),
        ("uniaxial", GOOD.replace("0.2", "abc"), ("line 3", "column 'stress'", "abc")),
        ("uniaxial", GOOD.replace("0.2", "nan"), ("line 3", "column 'stress'", "finite")),
        ("uniaxial", GOOD.replace("1.2", "-1.2"), ("line 3", "column 'stretch'", "-1.2")),
        ("uniaxial", GOOD.replace("0.2", ""), ("line 3", "empty")),
        ("uniaxial", GOOD.replace("stress", "stress [mm]"), ("column 'stress [mm]'", "mm")),
        ("uniaxial", "stretch,stress\n", ("column 'stretch'", "no numbers")),
        ("uniaxial", "# nothing\n", ("the table is empty",)),
        ("uniaxial", "# a test\nstretch\n1.1\n", ("line 2", "two columns")),
        ("uniaxial", "stretch stress\n1.1 0.2\n", ("line 1", "two columns", "not blanks")),
        ("uniaxial", "stretch,stress\n1,1,0,5\n", ("line 2 has 4 cells", "decimal points")),
        ("uniaxial", "stretch [mm],stress\n1.1,1\n", ("column 'stretch [mm]'", "pure number")),
        ("uniaxial", "stretch,stress [foo]\n1.1,1\n", ("column 'stress [foo]'", "unknown unit")),
        ("shear", "shear,stress\n0.1,-1\n0.2,-2\n", ("column 'shear'", "2 of 2", "sign")),
        ("volumetric", "J,pressure\n0.9,-1\n0.8,-2\n", ("column 'J'", "2 of 2", "above 0")),
        ("relaxation", "time,stress,stretch\n1,-2,1.1\n2,-1,1.1\n", ("'stretch'", "2 of 2")),
        ("relaxation", "time,stress\n1,2\n2,1\n", ("constant stretch",)),
        ("relaxation", "time,stress,stretch\n1,2,1.1\n0.5,1,1.1\n", ("line 3", "falls")),
        ("relaxation", "time,stress,stretch\n1,2,1.1\n2,1,1.2\n", ("not constant",)),
        ("volumetric", "J,pressure\n0,2\n", ("line 2", "column 'J'")),
        # Strains as stretches, stretches as strains, pressures as stresses.
        ("uniaxial", "stretch,stress\n0.1,1\n0.2,2\n0.4,3\n", ("'stretch'", "a strain?")),
        ("planar", "stretch,stress\n0.01,0.01\n2,3\n4,5\n", ("0.01", "a strain?")),
        ("equibiaxial", "strain,stress\n1,0\n1.2,2\n1.4,3\n", ("'strain'", "a stretch?")),
        ("uniaxial", "strain,stress\n1.1,1\n1.2,2\n1.4,3\n", ("about 1;", "a stretch?")),
        ("uniaxial", "strain,stress\n1,0\n0.9,-1\n0.8,-2\n", ("2 of 3", "a stretch?")),
        ("uniaxial", "stretch,stress\n1,0\n0.9,1\n0.8,2\n", ("2 of 3", "below 0")),
        ("uniaxial", "strain,stress\n0,0\n-0.1,1\n-0.2,2\n", ("2 of 3", "below 0")),
    ],
)
def test_files_that_cannot_be(kind, text, words, tmp_path):
    with pytest.raises(InputError) as caught:
        read(tmp_path, text, kind)
    assert "a.csv" in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_scatter_and_long_tests_are_no_faults(tmp_path):
    """A few stresses of the wrong sign at the rest, and stresses that begin at large strains."""
    read(tmp_path, "stretch,stress\n1,0.01\n1.01,-0.02\n1.02,-0.01\n1.1,1\n1.2,2\n1.3,3\n")
    read(tmp_path, "strain,stress\n0.0,0\n0.5,1\n1,2\n4,3\n")
    read(tmp_path, "strain,stress\n1,2\n2,3\n3,5\n")
    read(tmp_path, "stretch,stress\n0.3,-9\n0.5,-2\n0.8,-0.5\n0.95,-0.1\n")


CURVE = (np.array([1.1, 1.3, 1.6]), np.array([1e5, 2e5, 3e5]))


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"fix": ["m"]}, ("--fix", "'m'", "did you mean 'mu'?")),
        ({"fix": ["mu"]}, ("nothing is left to fit", "nu")),
        ({"bounds": {"mo": "1:2"}}, ("--bounds", "known: mu, nu")),
        ({"bounds": {"mu": "1"}}, ("--bounds", "mu")),
        ({"bounds": {"mu": "2 MPa:1 MPa"}}, ("--bounds", "mu")),
        ({"bounds": {"mu": "1 mm:2 mm"}}, ("--bounds", "mm")),
        ({"weights": {"planar": 1.0}}, ("planar",)),
        ({"weights": {"uniaxial": -1.0}}, ("--weight", "above 0")),
    ],
)
def test_options_that_cannot_be(keys, words):
    with pytest.raises(InputError) as caught:
        fit(NeoHookean(mu=1e5, nu=0.49), {"uniaxial": CURVE}, **keys)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("law", "fix"),
    [
        ({"law": "neo-hookean", "mu": "fit", "nu": 0.5}, "mu"),
        ({"law": "ogden", "mu": ["fit", "1 kPa"], "alpha": ["fit", -2], "nu": 0.5}, "mu"),
        ({"law": "ogden", "mu": ["fit", "1 kPa"], "alpha": ["fit", -2], "nu": 0.5}, "alpha[0]"),
        ({"law": "neo-hookean", "mu": "1 MPa", "lambda": "fit"}, "lmbda"),
    ],
)
def test_what_is_fixed_has_a_value(law, fix):
    """And is not held at a first guess."""
    with pytest.raises(InputError, match="is fixed but has no value") as caught:
        fit(law, {"uniaxial": CURVE}, fix=[fix])
    assert "--fix" in str(caught.value)


def test_first_guesses_are_in_the_range_of_each_law():
    """Of one constant beside the others of its example, in bodies as stiff as that."""
    s = np.array([1.001, 1.002, 1.003])
    for name, law in MATERIALS.items():
        E = 210e9 if name.startswith("j2") else 1e6
        curves = [TestCurve("uniaxial", s, E * (s - 1))]
        given = {"law": name, **law.example}
        for row in constants_of(Material.read(given).law):
            if row.name.partition("[")[0].partition(".")[0] in given:
                table = table_with(Material.read(given).law, {row.name: "fit"})
                assert Material.read(guessed(table, curves)).law.law == name


@pytest.mark.parametrize(("mu", "alpha"), [([2e5, 1e4], [2, 5]), ([-3e5], [-2])])
def test_moduli_have_the_signs_of_their_exponents(mu, alpha):
    """Ogden's moduli come back from his stress, Ogden (1984), section 7.2."""
    s = np.linspace(1.1, 2.0, 9)
    P = sum(m * (s ** (a - 1) - s ** (-a / 2 - 1)) for m, a in zip(mu, alpha, strict=True))
    law = {"law": "ogden", "mu": ["fit"] * len(mu), "alpha": alpha, "nu": 0.5}
    found = fit(law, {"uniaxial": (s, P)}, fix=["alpha"])
    assert found.law.mu == pytest.approx(mu, rel=1e-9)


def test_a_constant_of_a_table_by_its_own_name():
    law = Material.read({"law": "j2-logarithmic", **MATERIALS["j2-logarithmic"].example}).law
    for fix, held in {
        "slope": {"hardening.slope"},
        "hardening.slope": {"hardening.slope"},
        "hardening": {"hardening.saturation", "hardening.rate", "hardening.slope"},
    }.items():
        rows = chosen(law, [TestCurve("uniaxial", *CURVE)], [fix], {}, [])
        assert {row.name for row in rows if row.held == "fixed by --fix"} == held


@pytest.mark.parametrize("key", ["density", "fibre"])
def test_what_no_curve_tells_is_not_guessed(key):
    given = {"law": "guccione", **MATERIALS["guccione"].example, key: "fit"}
    if key == "fibre":
        given[key] = [1, 0, "fit"]
    with pytest.raises(InputError, match=f"there is no constant '{key}"):
        fit(given, {"uniaxial": CURVE})


def test_curves_without_points():
    none = np.zeros(0)
    for kind, data in {
        "uniaxial": ([], []),
        "shear": (none, none),
        "relaxation": (none, none, none),
    }.items():
        with pytest.raises(InputError, match=f"{kind}: there are no points"):
            fit(NeoHookean(mu=1e5, nu=0.5), {kind: data})
    with pytest.raises(InputError, match="there are no points"):
        TestCurve("uniaxial", none, none)


def test_tests_that_a_law_has_no_answer_to():
    solid = NeoHookean(mu=1e5, nu=0.5)
    with pytest.raises(InputError, match="change of volume"):
        fit(solid, {"uniaxial": CURVE, "volumetric": ([0.9, 0.8], [1e6, 2e6])})
    with pytest.raises(InputError, match="does not relax"):
        fit(solid, {"relaxation": ([1.0, 2.0], [2e5, 1e5], [1.1, 1.1])})
    with pytest.raises(InputError, match="2 points cannot tell 2 constants"):
        fit(MooneyRivlin(c10=1e5, c01=1e3, nu=0.5), {"uniaxial": ([1.1, 1.2], [1e5, 2e5])})
    with pytest.raises(InputError, match="^uniaxial: 1 point cannot tell 1 constant;"):
        fit(solid, {"uniaxial": ([1.1], [1e5])})
    for table, words in (
        ({"law": "neo-hookean", "mu": "fitt", "nu": 0.5}, "mu: 'fitt' is .* did you mean 'fit'"),
        ({"law": "ogden", "mu": ["fit", "Fit"], "alpha": [2, 3], "nu": 0.5}, r"mu\[1\]: 'Fit' is"),
        ({"law": "ogden", "mu": ["fit"], "alpha": [2]}, "neither K nor nu is given; .*nu = 0.5"),
    ):
        with pytest.raises(InputError, match=words):
            fit(table, {"uniaxial": CURVE})
    with pytest.raises(InputError, match="no kind of test; did you mean 'uniaxial'"):
        fit(solid, {"uniaxal": CURVE})


@pytest.mark.long
def test_the_command(tmp_path):
    """Its table is a material of a case file, and the same on two ranks."""
    (tmp_path / "law.toml").write_text(LAW)
    (tmp_path / "a.csv").write_text(GOOD)
    words = ("fit", "law.toml", "--uniaxial", "a.csv", "--unit", "MPa")
    code, out, err = cli(*words, "--json", folder=tmp_path)
    assert code == 0, err
    mu = json.loads(out)["constants"]["mu"]
    assert mu["interval"][0] < mu["value"] < mu["interval"][1]
    written = tomllib.loads((tmp_path / "law_fitted/rubber.toml").read_text())
    number, unit = written["materials"]["rubber"]["mu"].split()
    assert float(number) == pytest.approx(mu["value"] / {"kPa": 1e3, "MPa": 1e6}[unit], rel=1e-6)
    names = {path.name for path in (tmp_path / "law_fitted").iterdir()}
    assert names == {"rubber.toml", "rubber.png", "rubber_constants.csv", "rubber_curves.csv"}
    code, out, err = cli(*words, "--force", "--stable", folder=tmp_path, ranks=2)
    assert code == 0, err
    assert out.count("[materials.rubber]") == 1


def test_the_table_is_written_as_the_user_wrote_it():
    """Units, names and what was not fitted; a modulus of "fit" has a unit that suits it."""
    table = {"law": "neo-hookean-split", "mu": "0.5 N/mm^2", "lambda": "1 GPa"}
    table |= {"prony": [{"g": 0.2, "tau": "1 min"}], "density": "1.1 g/cm^3", "on": "seal"}
    time, stress = np.array([1.0, 10, 60, 100, 300]), np.array([96, 87, 72, 67, 61]) * 1e3
    found = fit(table, {"relaxation": (time, stress, np.full(5, 1.1))})
    written = tomllib.loads(material_toml("seal", found))["materials"]["seal"]
    assert [*written] == [*table, "source"]
    assert {key: written[key] for key in ("lambda", "density", "on")} == {
        "lambda": "1 GPa",
        "density": "1.1 g/cm^3",
        "on": "seal",
    }
    values = {"N/mm^2": (written["mu"], "mu", 1e6)}
    values["min"] = (written["prony"][0]["tau"], "viscous[0].time", 60.0)
    for unit, (text, name, size) in values.items():
        assert text == f"{found[name].value / size:.7g} {unit}"
    assert written["prony"][0]["g"] == pytest.approx(found["viscous[0].ratio"].value, rel=1e-6)
    energy = {"energy": "c/2*(I1 - 3) - c*ln(J) + K/2*ln(J)^2"}
    energy |= {"parameters": {"c": "1 bar", "K": 1e9}}
    for given, keys, pattern in (
        ({"law": "neo-hookean", "mu": "fit", "nu": 0.5}, ["mu"], r"\d+\.\d+ kPa"),
        (energy, ["parameters", "c"], r"\d\.\d+ bar"),
    ):
        found = fit(given, {"uniaxial": CURVE}, fix=["K"] if given is energy else [])
        text = tomllib.loads(material_toml("gum", found))["materials"]["gum"]
        for key in keys:
            text = text[key]
        assert re.fullmatch(pattern, text)
    bare = fit(NeoHookean(mu=1e5, nu=0.5), {"uniaxial": CURVE})
    written = tomllib.loads(material_toml("gum", bare))["materials"]["gum"]
    assert written["mu"] == pytest.approx(bare["mu"].value, rel=1e-6)


def test_an_earlier_fit_stays(tmp_path):
    """What a case may use is not overwritten, and refused before the search."""
    (tmp_path / "law.toml").write_text(LAW)
    (tmp_path / "a.csv").write_text(GOOD)
    (tmp_path / "law_fitted").mkdir()
    (tmp_path / "law_fitted/rubber.toml").write_text("mine")
    words = ("fit", "law.toml", "--uniaxial", "a.csv", "--unit", "MPa")
    code, out, err = cli(*words, folder=tmp_path)
    assert (code, out) == (2, "")
    assert err == (
        "error: law_fitted/rubber.toml: this file exists already; --output with another folder, "
        "or --force to overwrite the earlier fit\n"
    )
    assert [path.name for path in (tmp_path / "law_fitted").iterdir()] == ["rubber.toml"]
    assert (tmp_path / "law_fitted/rubber.toml").read_text() == "mine"


@pytest.mark.long
def test_codes_of_the_command(tmp_path):
    """2 for what is wrong, with one message; 3 and the best so far where the search has no end."""
    (tmp_path / "law.toml").write_text(LAW)
    (tmp_path / "a.csv").write_text(GOOD.replace("1.2", "0"))
    code, _, err = cli("fit", "law.toml", "--uniaxial", "a.csv", folder=tmp_path, ranks=2)
    assert code == 2
    assert err.count("a.csv: column 'stretch': line 3") == 1
    (tmp_path / "law.toml").write_text(LAW.replace("mu", "mo"))
    (tmp_path / "a.csv").write_text(GOOD)
    code, _, err = cli("fit", "law.toml", "--uniaxial", "a.csv", folder=tmp_path)
    assert code == 2
    assert "law.toml: materials.rubber: unknown key 'mo'" in err
    law = '[materials.rubber]\nlaw = "ogden"\nmu = ["fit", "fit"]\nalpha = ["fit", "fit"]\nnu = 0.5'
    (tmp_path / "law.toml").write_text(law)
    file = str(TRELOAR / "uniaxial.csv")
    words = ("fit", "law.toml", "--uniaxial", file, "--steps", "2", "--starts", "1")
    code, out, err = cli(*words, folder=tmp_path)
    assert code == 3
    assert "[materials.rubber]" in out
    assert "has not ended: 2 steps are done" in err


def test_intervals_have_two_digits():
    """Half an interval is an estimate itself; of a constant of 0 there is no share."""
    rows = [
        FittedConstant("mu", "Pa", 307.4237e3, 83.9512e3),
        FittedConstant("alpha", "", 0.0, 0.27412),
        FittedConstant("nu", "", 0.5, np.nan, held="fixed by --fix"),
        FittedConstant("K", "Pa", 1e9, np.nan, bound=True),
        FittedConstant("c10", "MPa", 0.7, 1e-5),
        FittedConstant("c01", "MPa", 0.7, 1e-17),
    ]
    assert [row[2] for row in constant_rows(rows)] == [
        "+- 84 kPa (27 %)",
        "+- 0.27",
        "fixed by --fix",
        "at its bound",
        "+- < 0.01 %",
        "+- < 0.01 %",
    ]


def test_intervals_beside_a_condition_say_that_they_do_not_count_it(capsys):
    """In the heading of the table; of a fit without a condition there is no such word."""
    s = np.linspace(1.1, 2.5, 12)
    law, heads = MooneyRivlin(c10=1e5, c01=1e4, nu=0.5), []
    for c10, c01 in (2e5, 0.0), (-3e5, 2.8e5):
        stress = 2 * (s - s**-2) * (c10 + c01 / s)
        _tables(fit(law, {"uniaxial": TestCurve("uniaxial", s, stress)}))
        heads.append(capsys.readouterr().out)
    assert ["interval, without the condition" in head for head in heads] == [False, True]


def test_errors_that_are_too_small_to_be_shown(tmp_path):
    """A law that made the curve itself: in words, in the table, the title and the source."""
    s = np.linspace(1.1, 2.0, 10)
    found = fit(
        {"law": "neo-hookean", "mu": "1 MPa", "nu": 0.5}, {"uniaxial": (s, 4e5 * (s - s**-2))}
    )
    (curve,) = found.curves
    assert 0 < curve.relative < 1e-12
    assert error_text(curve.rms, curve.relative, "Pa") == "round-off"
    assert error_text(5.0, 1e-4, "Pa") == "5 Pa"
    assert "uniaxial: < 0.01 % r.m.s." in str(found)
    assert "fitted to uniaxial (< 0.01 %);" in material_toml("gum", found)
    assert [percent(x) for x in (0.0, 1e-17, 9e-5, 2e-4)] == [
        "0 %",
        "< 0.01 %",
        "< 0.01 %",
        "0.02 %",
    ]


FALLING = (np.array([1.1, 1.2, 1.5, 2.0, 2.5, 3.0]), np.array([1, 1.2, -3, -20, -30, -40]) * 1e5)


@pytest.mark.parametrize(
    ("law", "name"),
    [
        ({"law": "neo-hookean", "mu": "fit", "nu": 0.5}, "mu"),
        ({"law": "neo-hookean", "mu": "fit", "nu": 0.45}, "mu"),
        ({"law": "yeoh", "c10": "fit", "c20": "fit", "c30": "fit", "nu": 0.5}, "c10"),
        ({"law": "linear-elastic", "E": "fit", "nu": 0.3}, "E"),
    ],
)
def test_what_the_law_cannot_give(law, name):
    """Stresses that push where the bar is longer: the modulus stays above 0, and a note says so."""
    curve = TestCurve("uniaxial", *FALLING)  # which files and arrays may not have
    found = fit(law, {"uniaxial": curve})
    assert found[name].bound
    assert 0 < found[name].value < 1e-6 * np.abs(FALLING[1]).max()
    note = f"{name} is at a bound of its range: the tests want less than 0 Pa, which the law"
    assert any(line.startswith(note) for line in found.notes)


@pytest.mark.long
def test_a_search_that_comes_to_constants_without_stress():
    """Free sides have no state there: an error of the search, none of the program."""
    law = {"law": "yeoh", "c10": "fit", "c20": "fit", "c30": "fit", "nu": 0.45}
    with pytest.raises(SolveError, match="no stress at some of the points, whatever the start"):
        fit(law, {"uniaxial": TestCurve("uniaxial", *FALLING)})


def test_a_relaxation_that_grows():
    """The least squares of branches that fade are without any: the mean stress, 3e5 Pa."""
    law = {"law": "neo-hookean-split", "mu": "1 MPa", "nu": 0.5}
    law["viscous"] = [{"ratio": "fit", "time": "fit"}]
    stress = 1e5 * np.arange(1.0, 6.0)
    curve = TestCurve("relaxation", np.full(5, 1.1), stress, np.array([1, 10, 30, 100, 300.0]))
    found = fit(law, {"relaxation": curve})
    assert found.curves[0].stress == pytest.approx(np.full(5, 3e5), rel=1e-6)


@pytest.mark.long
def test_what_to_doubt_of_an_answer(tmp_path):
    """Stresses without a unit, a modulus of a few Pa, and a law that is far from the test."""
    file = tmp_path / "a.csv"
    file.write_text(GOOD)
    data, law = {"uniaxial": file}, NeoHookean(mu=1.0, nu=0.5)
    bare, soft = fit(law, data).notes
    assert f"the stresses of {file} have no unit and were read in Pa" in bare
    assert "was --unit forgotten?" in soft
    energy = "mu/2*(I1 - 3) - mu*ln(J) + lmbda/2*ln(J)^2"
    own = {"energy": energy, "parameters": {"mu": 1.0, "lmbda": 1.0}}
    assert any("was --unit forgotten?" in line for line in fit(own, data).notes)
    assert not fit(law, data, unit="Pa").notes
    file.write_text(GOOD.replace("stress", "stress [Pa]"))
    assert not fit(law, data).notes
    file.write_text("stretch,stress\n1,0\n1.5,0\n2,0\n2.1,1 MPa\n")
    (line,) = fit(NeoHookean(mu=1e5, nu=0.5), data).notes[:1]
    assert f"the law does not describe the uniaxial test {file}: its r.m.s. error is" in line
