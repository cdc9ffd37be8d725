"""What is refused of measured files, keys and options; the command, its files and its codes."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from helpers.processes import cli
from matplotlib.figure import Figure
from mpi4py import MPI

from dolfin_elastic import Case, identify, read_case
from dolfin_elastic.core.errors import InputError, SolveError
from dolfin_elastic.study.identify.measured import (
    MeasuredCurve,
    MeasuredField,
    Number,
    as_measured,
    read_measured,
)
from dolfin_elastic.study.identify.unknowns import read_unknowns
from dolfin_elastic.study.identify.written import case_text, points_panel

pytestmark = pytest.mark.skipif(
    MPI.COMM_WORLD.size > 1, reason="starts mpirun itself, which cannot be nested"
)
CASE = """
[mesh]
rectangle = {size = [20, 10], cells = [2, 1]}
unit = "mm"

[materials.steel]
law = "linear-elastic"
E = "1 MPa"
nu = 0.3

[[support]]
on = "left"
name = "left"

[[support]]
on = "right"
displacement = ["1 mm", 0]
"""
CURVE = "t,reaction_x of left [N]\n0.5,-300\n1,-600\n"
FIELD = "x [mm],y [mm],ux [mm],uy [mm]\n5,5,0.25,0\n15,5,0.75,0\n"


def read(tmp_path: Path, text: str, of: str | None = None) -> list[MeasuredCurve | MeasuredField]:
    """What a file has."""
    (tmp_path / "a.csv").write_text(text)
    return read_measured(tmp_path / "a.csv", iter([of]))


def test_headings_name_numbers_and_units(tmp_path: Path) -> None:
    (curve,) = read(tmp_path, "tip_x [mm];-2*reaction_left_x [kN]\n1;2\n2;3\n")
    assert isinstance(curve, MeasuredCurve)
    assert curve.at == pytest.approx([1e-3, 2e-3])
    assert curve.values == pytest.approx([2e3, 3e3])
    assert (curve.y.factor, curve.y.wanted.name, curve.x.factor) == (-2.0, "reaction_left_x", 1.0)
    (named,) = read(tmp_path, "1 mm,2 kN\n2 mm,3 kN\n", "tip_x:-reaction_x of left")
    assert isinstance(named, MeasuredCurve)
    assert named.values == pytest.approx([2e3, 3e3])
    assert named.bare == ()
    both = read(tmp_path, "time [ms],reaction_left_x,reaction_left_y\n1,2,3\n2,3,4\n")
    assert [one.values[0] for one in both] == [2.0, 3.0]
    assert both[0].bare == ("reaction_left_x",)
    (field,) = read(tmp_path, "t,X [mm],Y [mm],u_x [um]\n0.5,1,2,3\n")
    assert isinstance(field, MeasuredField)
    assert field.components == (0,)
    assert (field.times[0], field.points[0, 1]) == (0.5, pytest.approx(2e-3))
    (field,) = read(tmp_path, "x,y,z,uy [mm]\n1,2,3,4\n")
    assert isinstance(field, MeasuredField)
    assert field.in_mesh_unit
    percentile = "t:percentile:95 von_mises on left"
    (curve,) = read(tmp_path, "0.5,1\n1,2\n", percentile)
    assert isinstance(curve, MeasuredCurve)
    assert curve.y.wanted.reduction == "percentile:95"


@pytest.mark.parametrize(
    ("text", "of", "words"),
    [
        ("1,2\n2,3\n", None, ("no headings", "--of")),
        (CURVE, "t:", ("--of", "a name is missing")),
        (CURVE, "t:1.2.3*reaction_left_x", ("--of", "'1.2.3' is no factor")),
        (CURVE, "t:wrong words here", ("--of", "no result 'wrong words here'")),
        (CURVE.replace("[N]", "[mm]"), None, ("column 'reaction_x of left [mm]'", "wrong unit")),
        (CURVE.replace("-300", "abc"), None, ("line 2", "abc")),
        (CURVE.replace("-300", "nan"), None, ("line 2", "not a finite number")),
        (CURVE.replace("-300", ""), None, ("line 2", "empty")),
        (CURVE.replace(",-300", ""), None, ("line 2 ends too early",)),
        (CURVE.replace("-300", "-300,1"), None, ("line 2 has 3 cells below 2 headings",)),
        ("", None, ("the table is empty",)),
        ("t\n1\n", None, ("line 1", "two columns")),
        (CURVE.replace("-300", "0").replace("-600", "0"), None, ("all numbers are 0",)),
        ("t,reaction_left_x\n", None, ("no numbers",)),
        (FIELD.replace("y [mm]", "q"), None, ("line 1", "no column has the y")),
        (FIELD.replace("y [mm],u", "y,u"), None, ("some places have a unit",)),
        (FIELD.replace("uy", "uz"), None, ("uz has no z",)),
        (FIELD.replace("uy [mm]", "v"), None, ("no column 'v'", "known")),
    ],
)
def test_files_that_cannot_be(
    text: str, of: str | None, words: tuple[str, ...], tmp_path: Path
) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, text, of)
    assert "a.csv" in str(caught.value) or "--of" in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_files_and_pairs_of_names(tmp_path: Path) -> None:
    for name, text in (("a", CURVE), ("b", CURVE), ("c", FIELD)):
        (tmp_path / f"{name}.csv").write_text(text)
    files = [tmp_path / f"{name}.csv" for name in "acb"]
    sets = as_measured(files, ["t:reaction_left_x", "t:reaction_left_y"], {"b": 2.0})
    assert [one.weight for one in sets] == [1.0, 1.0, 2.0]
    for of in (["t:E"] * 3, ["t:E"] * 4):
        with pytest.raises(InputError, match="times, which is not the number of files"):
            as_measured(files, of)
    with pytest.raises(InputError, match=r"no file 'd' to weigh.*"):
        as_measured(files, weights={"d": 1.0})
    with pytest.raises(InputError, match="is no weight"):
        as_measured(files, weights={"a": -1.0})
    with pytest.raises(InputError, match="nothing was measured"):
        as_measured([])
    with pytest.raises(InputError, match="there is no such file"):
        as_measured(tmp_path / "e.csv")


@pytest.mark.parametrize(
    ("vary", "bounds", "words"),
    [
        ([], {}, ("nothing varies", "--vary")),
        (["materials.steal.E"], {}, ("'steal'", "did you mean 'steel'?")),
        (["materials.steel.F"], {}, ("'F'", "E")),
        (["materials.steel.law"], {}, ("'linear-elastic'", "no number")),
        (["mesh.rectangle.size[0]"], {}, ("decides on the mesh",)),
        (["materials.steel.E"] * 2, {}, ("given twice",)),
        (["materials.steel.E"], {"nu": "0.1:0.2"}, ("'nu' does not vary", "--bounds")),
        (["materials.steel.E"], {"E": "1 mm:2 mm"}, ("mm", "--bounds")),
        (["materials.steel.E"], {"E": "2 MPa:1 MPa"}, ("least and a largest",)),
        (["materials.steel.E"], {"E": "a:b"}, ("least and a largest",)),
    ],
)
def test_keys_that_cannot_vary(
    vary: list[str], bounds: dict[str, str], words: tuple[str, ...], tmp_path: Path
) -> None:
    (tmp_path / "case.toml").write_text(CASE)
    with pytest.raises(InputError) as caught:
        read_unknowns(read_case(tmp_path / "case.toml"), vary, bounds)
    for word in words:
        assert word in str(caught.value)


def test_ranges_are_those_of_the_law_and_of_the_user(tmp_path: Path) -> None:
    (tmp_path / "case.toml").write_text(CASE)
    case = read_case(tmp_path / "case.toml")
    keys = ["materials.steel.E", "materials.steel.nu", "support[1].displacement[0]"]
    E, nu, shift = read_unknowns(case, keys, {"E": ":2e6", "displacement[0]": (0.0005, "3 mm")})
    assert (E.constant.low, E.constant.high) == (pytest.approx(0, abs=1e-8), pytest.approx(2.0))
    assert -1 <= nu.constant.low < 0
    assert nu.constant.high == pytest.approx(0.5)
    assert (shift.constant.low, shift.constant.high) == (pytest.approx(0.5), pytest.approx(3.0))
    assert (E.written(1.5), nu.written(1 / 3, 3)) == ("1.5 MPa", 0.333)


@pytest.mark.parametrize(
    ("sets", "words"),
    [
        (("t", "reaction_x of lift"), ("no support 'lift'", "left")),
        (("t", "tip_x"), ("no result 'tip_x'",)),
        (("t", "von_mises on lift"), ("no part and no probe 'lift'",)),
    ],
)
def test_numbers_that_the_case_has_not(
    sets: tuple[str, str], words: tuple[str, ...], tmp_path: Path
) -> None:
    (tmp_path / "case.toml").write_text(CASE)
    x, y = map(Number.read, sets)
    curve = MeasuredCurve(x, y, np.array([0.5, 1.0]), np.array([1.0, 2.0]))
    with pytest.raises(InputError) as caught:
        identify(read_case(tmp_path / "case.toml"), curve, ["materials.steel.E"])
    for word in words:
        assert word in str(caught.value)


def test_what_was_measured_beyond_the_run_and_beside_states(tmp_path: Path) -> None:
    (tmp_path / "case.toml").write_text(CASE)
    case = read_case(tmp_path / "case.toml")
    curve = MeasuredCurve(
        Number.read("t"), Number.read("reaction_x of left"), np.array([1.0, 2.0]), np.ones(2)
    )
    with pytest.raises(InputError, match="t = 2, beyond the end of the run"):
        identify(case, curve, ["materials.steel.E"])
    file = tmp_path / "a.csv"
    for text, place in (
        (CURVE.replace("\n1,", "\n1.5,"), "column 't': line 3: something was measured at t = 1.5"),
        (
            CURVE.replace("0.5", "-1"),
            "column 't': line 2: something was measured at t = -1, before",
        ),
        ("t [s]," + FIELD.replace("\n", "\n2,", 2), "column 't [s]': line 2: something was"),
    ):
        file.write_text(text)
        with pytest.raises(InputError) as caught:
            identify(case, file, ["materials.steel.E"])
        assert str(caught.value).startswith(f"{file}: {place}")
    file.write_text("displacement of right [mm],reaction_x of left [N]\n0.5,-300\n3,-600\n")
    with pytest.raises(SolveError) as failed:
        identify(case, file, ["materials.steel.E"])
    assert f"{file}: column 'displacement of right [mm]': line 3: measured at 3 mm" in str(
        failed.value
    )
    file.write_text("t,b_beyond\n0.5,-300\n1,-600\n")
    with pytest.raises(InputError, match=r"a\.csv: line 1: there is no result 'b_beyond'"):
        identify(case, file, ["materials.steel.E"])
    modes = Case.from_dict({**case.to_dict(), "modal": {}}).changed(
        {"materials.steel.density": 1e3}
    )
    with pytest.raises(InputError, match="modes alone"):
        identify(modes, curve, ["materials.steel.E"])
    field = MeasuredField(np.ones((1, 3)), np.ones((1, 1)), (0,), np.full(1, np.nan), (2,))
    with pytest.raises(InputError, match="its points have 3 coordinates, the body has 2"):
        identify(case, field, ["materials.steel.E"])
    alone = MeasuredCurve(curve.x, curve.y, np.ones(1), np.ones(1))
    with pytest.raises(InputError, match="1 point cannot tell 1 constant"):
        identify(case, alone, ["materials.steel.E"])


def test_the_case_is_written_as_the_user_wrote_it(tmp_path: Path) -> None:
    """Values, names and order; files are named from the folder in which it is."""
    library = '["my steel"]\nE = "210 GPa"\nnu = 0.3\n'
    ramp = '[[load]]\nkind = "gravity"\ncurve = {file = "ramp.csv"}\n'
    mine = 'material = "my steel"\nE = "1 N/mm^2"\ndensity = "7.8 g/cm^3"'
    text = CASE.replace('law = "linear-elastic"\nE = "1 MPa"\nnu = 0.3', mine)
    for name, content in {
        "lib.toml": library,
        "ramp.csv": "0,0\n1,1\n",
        "case.toml": f'library = "lib.toml"\n{text}\n{ramp}',
    }.items():
        (tmp_path / name).write_text(content)
    case, folder = read_case(tmp_path / "case.toml"), tmp_path / "a" / "b"
    written = case_text(case, {"materials.steel.E": "2.5 N/mm^2"}, folder)
    expected = tomllib.loads((tmp_path / "case.toml").read_text())
    expected["materials"]["steel"]["E"] = "2.5 N/mm^2"
    expected["library"] = "../../lib.toml"
    expected["load"][0]["curve"]["file"] = "../../ramp.csv"
    assert json.dumps(tomllib.loads(written)) == json.dumps(expected)
    assert "[materials.steel]" in written
    folder.mkdir(parents=True)
    (folder / "case.toml").write_text(written)
    same = case.changed({"materials.steel.E": 2.5e6}).materials
    assert read_case(folder / "case.toml").materials == same
    made = Case.from_dict(tomllib.loads(CASE), tmp_path)
    assert tomllib.loads(case_text(made, {}, folder))["materials"]["steel"]["E"] == 1e6


def test_places_in_a_picture_are_in_a_unit_that_suits_them() -> None:
    """Of a body of 20 mm in mm, on both axes."""
    figure = Figure()
    axis = figure.subplots()
    points_panel(figure, axis, np.array([[0.0, 0.0], [0.02, 0.01]]), np.ones(2), "off [µm]")
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("x [mm]", "y [mm]")
    assert axis.collections[0].get_offsets().tolist() == [[0.0, 0.0], [20.0, 10.0]]


@pytest.mark.long
def test_the_command_and_its_files(tmp_path: Path) -> None:
    """The case that is written runs, and has the value that was found."""
    (tmp_path / "case.toml").write_text(CASE)
    (tmp_path / "curve.csv").write_text(CURVE)
    (tmp_path / "field.csv").write_text(FIELD)
    keys = ("--vary", "materials.steel.E", "--bounds", "E=0.1 MPa:10 MPa")
    files = ("--measured", "curve.csv", "--measured", "field.csv", "--weight", "field=0.5")
    code, out, err = cli("fit", "case.toml", *files, *keys, folder=tmp_path)
    assert code == 0, err
    assert "materials.steel.E" in out
    assert "95 % interval" in out
    folder = tmp_path / "case_fitted"
    names = {"case.toml", "case_constants.csv", "case_curves.csv", "case_points.csv", "case.png"}
    assert {path.name for path in folder.iterdir()} == names
    fitted = read_case(folder / "case.toml")
    row = (folder / "case_constants.csv").read_text().splitlines()[1].split(",")
    value = str(fitted.value_at("materials.steel.E"))
    assert value.endswith(" MPa")
    assert float(value.split(maxsplit=1)[0]) == pytest.approx(float(row[2]), rel=1e-6)
    assert len((folder / "case_points.csv").read_text().splitlines()) == 5
    again = ("fit", "case.toml", *files, *keys, "--json", "--steps", "1")
    assert cli(*again, folder=tmp_path) == (
        2,
        "",
        "error: case_fitted/case.toml: this file exists already; --output with another folder, or "
        "--force to overwrite the earlier fit\n",
    )
    code, out, err = cli(*again, "--force", folder=tmp_path)
    assert code == 3
    assert "has not ended" in err
    assert json.loads(out)["values"]["materials.steel.E"]["unit"] == "MPa"
    code, out, err = cli("fit", "case.toml", *files, "--uniaxial", "a.csv", folder=tmp_path)
    assert (code, "--uniaxial" in err) == (2, True)
    code, out, err = cli("fit", "case.toml", *files, "--stable", folder=tmp_path)
    assert (code, "--stable" in err) == (2, True)
    code, out, err = cli("fit", "case.toml", *keys, folder=tmp_path)
    assert (code, "nothing was measured" in err) == (2, True)
