"""Sweeps: numbers of closed forms, what is kept, what fails, ranks, processes, and statistics."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.ranks import SIZES, on_ranks
from matplotlib.figure import Figure
from mpi4py import MPI

from dolfin_elastic import Case, sweep
from dolfin_elastic.case import case as case_module
from dolfin_elastic.core.errors import InputError, OutputError, SolveError
from dolfin_elastic.core.files.regular import read_regular
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.study.sweep import rows as rows_module
from dolfin_elastic.study.sweep import sweep as sweep_module
from dolfin_elastic.study.sweep.numbers import Known, known_of, may_have
from dolfin_elastic.study.sweep.rows import Contents, Row
from dolfin_elastic.study.sweep.settings import design, read_setting, worded
from dolfin_elastic.study.sweep.statistics import statistics
from dolfin_elastic.study.sweep.sweep import Sweep, planned
from dolfin_elastic.study.sweep.table import Results, TableAtTimes, write_table

WORLD = MPI.COMM_WORLD
STEEL = {"law": "linear-elastic", "E": "1 MPa", "nu": 0.3, "density": 1e3}


def bar(folder: Path, **tables: Any) -> Case:
    """A bar of 1 m that is pulled by 1 kPa: u = p L / E, free to contract."""
    whole: dict[str, Any] = {
        "mesh": {"rectangle": {"size": [1, 0.5], "cells": [2, 1]}},
        "materials": {"steel": STEEL},
        "support": [
            {"on": "left", "kind": "symmetry"},
            {"on": "bottom", "kind": "symmetry"},
        ],
        "load": [{"kind": "traction", "on": "right", "value": ["1 kPa", 0]}],
        "output": {"probes": {"end": [1, 0]}},
    }
    whole["mesh"]["geometry"] = "plane-stress"
    return Case.from_dict({**whole, **tables}, folder)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return on_root(WORLD, lambda: tmp_path)


def table(folder: Path) -> list[dict[str, str]]:
    text = on_root(WORLD, (folder / "sweep.csv").read_text)
    return list(csv.DictReader(text.splitlines()))


def test_numbers_are_those_of_the_closed_form(folder: Path) -> None:
    """Linear elements hold a uniform strain exactly: u = p L / E to the solver's tolerance."""
    values = {"materials.steel.E": "1 MPa,2 MPa", "load.right.value[0]": ["1 kPa", "3 kPa"]}
    found = sweep(bar(folder), values, output=folder / "out")
    exact = [p / E for E in (1e6, 2e6) for p in (1e3, 3e3)]
    assert found.columns()["end_x"] == pytest.approx(exact, rel=1e-10)
    assert list(found.frame()["end_x"]) == found.columns()["end_x"]  # with pandas or without
    rows = table(folder / "out")
    assert [float(row["end_x"]) for row in rows] == pytest.approx(exact, rel=1e-10)
    assert [row["materials.steel.E"] for row in rows] == ["1 MPa"] * 2 + ["2 MPa"] * 2
    summary = json.loads(on_root(WORLD, (folder / "out" / "sweep.json").read_text))
    assert summary["units"]["end_x"] == "m"
    assert on_root(WORLD, lambda: (folder / "out" / "sweep.png").stat().st_size) > 5000
    assert on_root(WORLD, (folder / "out" / "003" / "summary.json").is_file)


def test_what_is_told(folder: Path) -> None:
    """Fields on parts, reductions, reactions, columns; the unit follows."""
    tell = ["mean displacement_x on right", "reaction of left", "strain_energy", "max_displacement"]
    values = {"materials.steel.E": ["1 MPa", "4 MPa"]}
    found = sweep(bar(folder), values, output=folder / "out", tell=tell)
    for row, E in zip(found.rows, (1e6, 4e6), strict=True):
        u = 1e3 / E
        wanted = [u, 500.0, 0.5 * 500.0 * u, math.hypot(u, 0.3 * u / 2)]
        assert list(row.numbers.values()) == pytest.approx(wanted, rel=1e-10)
        assert list(row.numbers) == tell


def test_the_mesh_is_read_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows of one mesh follow one another, whatever the order of the keys."""
    read = []
    before = case_module.Case.read_mesh

    def counted(self: Case, comm: MPI.Comm) -> Any:
        read.append(self.mesh)
        return before(self, comm)

    monkeypatch.setattr(case_module.Case, "read_mesh", counted)
    values = {"materials.steel.E": ["1 MPa", "2 MPa"], "mesh.rectangle.cells[0]": [2, 3, 4]}
    found = sweep(bar(folder), values, output=folder / "out")
    assert [row.status for row in found.rows] == ["solved"] * 6
    assert len(read) == 3


def test_nothing_is_computed_twice(folder: Path) -> None:
    """What a folder has is known, in another order and beside new values, too."""
    case, seen = bar(folder), list[int]()
    E = "materials.steel.E"

    def computed(values: list[str], **changes: Any) -> list[str]:
        plan = design([read_setting(E, values)])
        made = planned(case.changed(changes), plan, output=folder / "out")
        seen.append(sum(row.ended for row in made.rows))
        return [str(row.values[E]) for row in made.run()]

    assert computed(["1 MPa", "2 MPa"]) == ["1 MPa", "2 MPa"]
    assert computed(["3 MPa", "2 MPa", "1 MPa"]) == ["3 MPa"]
    assert computed(["1 MPa", "2 MPa"], **{"materials.steel.nu": 0.2}) == ["1 MPa", "2 MPa"]
    assert seen == [0, 2, 0]
    assert on_root(WORLD, lambda: len(list((folder / "out").glob("*/row.json")))) == 5


def test_a_mesh_file_that_has_changed(folder: Path) -> None:
    """Its content is part of what is known, its date is not."""
    script = 'Rectangle(1) = {{0, 0, 0, {}, 0.5}};\nPhysical Surface("plate") = {{1}};\n'

    def written(length: float) -> None:
        text = 'SetFactory("OpenCASCADE");\n' + script.format(length)
        text += 'Physical Curve("left") = {4}; Physical Curve("right") = {2};\n'
        text += 'Physical Curve("bottom") = {1};\nMesh.MeshSizeMax = 0.5;\n'
        on_root(WORLD, lambda: (folder / "plate.geo").write_text(text))

    def ends() -> list[float]:
        case = bar(folder, mesh={"file": "plate.geo", "geometry": "plane-stress"}, output={})
        values = {"materials.steel.E": ["1 MPa"]}
        return list(sweep(case, values, output=folder / "out").columns()["displacement"])

    written(1.0)
    (first,) = ends()
    written(2.0)
    (second,) = ends()
    assert second > 1.5 * first


def test_files_that_files_name(folder: Path) -> None:
    """Arrays of XDMF, what a script merges, and a folder of results count; other texts do not."""
    made = folder / "files"

    def digests() -> list[str]:
        contents = Contents()
        return [contents.of(made / name) for name in ("m.xdmf", "p.geo", "run", "left", "none")]

    def written(text: str) -> None:
        for name in ("run", "left"):
            (made / name).mkdir(parents=True, exist_ok=True)
        (made / "m.xdmf").write_text("<DataItem>m.h5:/mesh</DataItem>")
        (made / "p.geo").write_text('Merge "part.step";')
        for name in ("m.h5", "part.step", "run/summary.json", "left/x.txt"):
            (made / name).write_text(text)

    on_root(WORLD, lambda: written("1"))
    first = on_root(WORLD, digests)
    assert on_root(WORLD, digests) == first
    on_root(WORLD, lambda: written("2"))
    changed = [a != b for a, b in zip(first, on_root(WORLD, digests), strict=True)]
    assert changed == [True, True, True, False, False]


def test_a_peak_that_is_singular(folder: Path) -> None:
    """At the edge of a clamp: on that face it is called so, and has no error."""
    tables = {"support": [{"on": "left"}], "materials": {"steel": STEEL | {"allowable": 1e5}}}
    case = bar(folder, **tables)
    values = {"mesh.rectangle.cells": [[16, 8]]}
    (row,) = sweep(case, values, output=folder / "out", tell=["von_mises on left"]).rows
    assert "singular" in row.remarks["von_mises on left"]
    assert math.isnan(row.errors["von_mises on left"])
    (row,) = sweep(case, values, output=folder / "usual").rows
    assert "singular" in row.remarks["safety_factor"]


def test_a_row_that_fails_is_kept(folder: Path) -> None:
    """With its cause; the others are computed, and the table has all of them."""
    case = bar(folder)
    found = sweep(case, {"support[0].on": ["left", "lft"]}, output=folder / "out")
    assert [row.status for row in found.rows] == ["solved", "failed"]
    assert "lft" in found.rows[1].cause
    assert "did you mean 'left'" in table(folder / "out")[1]["cause"]


def test_what_has_failed_is_tried_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only if it is asked for, in its folder; what has been solved stays as it is."""
    values, out = {"materials.steel.E": ["1 MPa", "2 MPa"]}, folder / "out"
    numbers = known_of

    def full(folders: Sequence[Path]) -> Known:
        if folders[0].name == "002":
            raise SolveError("the disk is full")
        return numbers(folders)

    monkeypatch.setattr(sweep_module, "known_of", full)
    first = sweep(bar(folder), values, output=out)
    assert [row.status for row in first.rows] == ["solved", "failed"]
    monkeypatch.undo()
    assert sweep(bar(folder), values, output=out).rows == first.rows
    found = sweep(bar(folder), values, output=out, retry=True)
    assert [row.status for row in found.rows] == ["solved", "solved"]
    assert found.rows[0] == first.rows[0]
    assert (found.rows[1].folder, found.rows[1].cause) == ("002", "")
    assert found.columns()["end_x"] == pytest.approx([1e-3, 0.5e-3], rel=1e-10)
    assert sweep(bar(folder), values, output=out, retry=True).rows == found.rows


def test_a_result_that_only_some_runs_have(folder: Path) -> None:
    """An empty cell with the reason, whichever run comes first; what no run can have is refused."""
    some, out = [{"end": [1, 0]}, {"end": [1, 0], "mid": [0.5, 0]}], folder / "out"
    tell = ["mid_x", "end_x", "displacement_x of mid"]
    found = sweep(bar(folder), {"output.probes": some}, output=out, tell=tell)
    assert [row.status for row in found.rows] == ["solved"] * 2
    assert found.columns()["mid_x"] == pytest.approx([math.nan, 0.5e-3], nan_ok=True)
    assert found.columns()["end_x"] == pytest.approx([1e-3, 1e-3])
    assert [row["mid_x"] for row in table(out)] == ["", "0.0005"]
    assert found.columns()[tell[2]] == pytest.approx([math.nan, 0.5e-3], nan_ok=True)
    assert found.remarks() == [
        "mid_x: this run has no such result (run 1)",
        f"{tell[2]}: this run has no such result: there is no result 'mid_displacement_x' (run 1)",
    ]
    assert found.large == tell
    with pytest.raises(InputError, match="did you mean 'end_x'"):
        sweep(bar(folder), {"output.probes": some}, output=folder / "no", tell=["end_xx"])


def test_a_field_that_only_some_runs_have(folder: Path) -> None:
    """One material has no strength; where none has, the first run ends the sweep."""
    strong, case = {**STEEL, "allowable": "1 MPa"}, bar(folder)
    tell, out = ["safety_factor on right", "end_x"], folder / "out"
    found = sweep(case, {"materials.steel": [STEEL, strong]}, output=out, tell=tell).columns()
    assert found["status"] == ["solved"] * 2
    assert found[tell[0]] == pytest.approx([math.nan, 1e3], nan_ok=True, rel=1e-9)
    why = f"{tell[0]}: this run has no such result: '{tell[0]}' has no value in this run"
    assert found["remark"] == [why, ""]
    with pytest.raises(InputError, match=r"has no value in this run; .* finite somewhere"):
        sweep(case, {"materials.steel.E": ["1 MPa"]}, output=folder / "no", tell=tell)


def test_names_that_runs_may_have(folder: Path) -> None:
    """All columns of a run are among them, and those of other cases; misspelt ones are not."""
    case = bar(folder, modal={"count": 2}, statics={})
    found = sweep(case, {"materials.steel.E": [1e6]}, output=folder / "out")
    names = on_root(WORLD, lambda: [*known_of([folder / "out" / "001" / "statics"]).numbers])
    counted = {"step", "t", "load_factor", "newton", "krylov"}  # every run has these
    assert [name for name in names if not may_have(case, name)] == [
        n for n in names if n in counted
    ]
    assert found.rows[0].status == "solved"
    for name in ("reaction_left_y", "friction_energy", "frequency_7", "end_von_mises", "end_x"):
        assert may_have(case, name), name
    for name in (
        "reaction_lft_y",
        "frictoin_energy",
        "load_factor_1",
        "end_xx",
        "left",
        "nonsense",
    ):
        assert not may_have(case, name), name


def test_records_are_read_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The table after each row knows those before it: the reads grow as the rows do."""
    reads = [0]

    def counted(path: Path, most: int) -> bytes:
        reads[0] += path.name == "row.json"
        return read_regular(path, most)

    def solved(self: Sweep, row: Row, case: Case) -> Row:
        return replace(row, status="solved", numbers={"end_x": row.number * 1e-3})

    monkeypatch.setattr(rows_module, "read_regular", counted)
    monkeypatch.setattr(Sweep, "_solve", solved)
    n = 60
    plan = design([read_setting("materials.steel.E", [f"{k} MPa" for k in range(1, n + 1)])])
    made = planned(bar(folder), plan, output=folder / "out")
    for row in made.run():
        assert sum(one.ended for one in made.so_far().rows) == row.number
    assert on_root(WORLD, lambda: reads[0]) == n  # that nobody else has ended it
    assert made.results() == made.so_far()
    writer = TableAtTimes()
    for _ in range(3):
        on_root(WORLD, lambda: writer.write(made.so_far))
    assert len(table(folder / "out")) == n


def clamped(folder: Path, **tables: Any) -> Case:
    """A short bar in plane strain that is held at its left end: it is not homogeneous."""
    whole = {
        "mesh": {"rectangle": {"size": [2, 1], "cells": [4, 2]}, "degree": 2},
        "support": [{"on": "left"}],
        "output": {"probes": {"end": [2, 1]}},
    }
    return bar(folder, **{**whole, **tables})


NU = "materials.steel.nu"


@pytest.mark.long
def test_runs_with_and_without_a_pressure_are_told_apart(folder: Path) -> None:
    """Across nu = 0.45 a result jumps; with one formulation it goes on as before."""
    values = {NU: [0.4497, 0.4499, 0.4501]}
    found = sweep(clamped(folder), values, output=folder / "out")
    assert [row.formulation for row in found.rows] == ["displacement", "displacement", "mixed"]
    (remark,) = [text for text in found.remarks() if text.startswith("formulation: ")]
    assert remark.startswith("formulation: displacement (run 1, 2), mixed (run 3): a pressure is")
    assert remark.endswith('mesh.formulation = "mixed" makes all runs alike')
    assert found.texts()["formulation"] == found.columns()["formulation"]
    assert [row["formulation"] for row in table(folder / "out")] == found.columns()["formulation"]
    written = json.loads(on_root(WORLD, (folder / "out" / "sweep.json").read_text))
    assert written["remarks"] == found.remarks()

    def changes(result: Results) -> np.ndarray:
        return np.diff(np.array(result.columns()["end_y"], dtype=float))

    before, jump = changes(found)
    assert abs(jump - before) > 10 * abs(before)
    for one in ("mixed", "displacement"):
        case = clamped(folder).changed({"mesh.formulation": one})
        alike = sweep(case, values, output=folder / one)
        assert not any("formulation" in text for text in alike.remarks())
        assert "formulation" not in alike.texts()
        before, after = changes(alike)
        assert after == pytest.approx(before, rel=0.02)  # the second difference of a smooth result


def test_one_formulation_of_several_materials(folder: Path) -> None:
    """`mixed` gives all a pressure where none needs it: displacements alone make runs alike."""
    halves = {"left_half": {"box": [[0, 0], [1, 1]]}, "right_half": {"box": [[1, 0], [2, 1]]}}
    materials = {"steel": {**STEEL, "on": "left_half"}, "foam": {**STEEL, "on": "right_half"}}
    case = clamped(folder, regions=halves, materials=materials)
    found = sweep(case, {NU: [0.44, 0.46]}, output=folder / "out")
    assert [row.formulation for row in found.rows] == ["displacement", "mixed in steel"]
    assert found.remarks()[0].endswith('mesh.formulation = "displacement" makes all runs alike')
    mixed = case.changed({"mesh.formulation": "mixed"})
    found = sweep(mixed, {NU: [0.44, 0.46]}, output=folder / "mixed")
    assert [row.formulation for row in found.rows] == ["mixed", "mixed in steel"]
    assert found.remarks()[0].endswith('mesh.formulation = "displacement" makes all runs alike')


def test_a_formulation_that_varies_is_no_surprise(folder: Path) -> None:
    """Its runs are told in the table, without a remark."""
    values = {"mesh.formulation": ["displacement", "mixed"]}
    found = sweep(clamped(folder), values, output=folder / "out")
    assert [row.formulation for row in found.rows] == ["displacement", "mixed"]
    assert not any("formulation" in text for text in found.remarks())


@pytest.mark.long
def test_all_rows_fail(folder: Path) -> None:
    """Rubber that is pressed beyond any strain: code 3 and the first cause; nothing is lost."""
    rubber = {"rubber": {"law": "neo-hookean", "E": "1 MPa", "nu": 0.3}}
    case = bar(folder, materials=rubber, statics={"steps": 1})
    with pytest.raises(SolveError, match="no run of the sweep has a solution") as error:
        sweep(case, {"load.right.value[0]": ["-1 GPa", "-2 GPa"]}, output=folder / "out")
    assert error.value.exit_code == 3
    assert [row["status"] for row in table(folder / "out")] == ["failed", "failed"]


@pytest.mark.parametrize(
    ("values", "tell", "message"),
    [
        ({"materials.stel.E": [1]}, [], "did you mean 'steel'"),
        ({"materials.steel.EE": [1]}, [], "did you mean 'E'"),
        ({"titel": ["a"]}, [], "unknown key 'titel'"),
        ({"mesh": [1, 2]}, [], "mesh"),
        ({"load.rigt.value": [[1, 0]]}, [], "did you mean 'right'"),
        ({"load[3].value": [[1, 0]]}, [], "no row '3'"),
        ({"materials.steel.E.x": [1]}, [], "no table"),
        ({"materials.steel.E": ["1 MPa", "-1 MPa"]}, [], "must be positive"),
        ({"materials.steel.E": ["1 MPa"]}, ["von_mises on fillet"], "no part and no probe"),
        ({"materials.steel.E": ["1 MPa"]}, ["reaction of lft"], "did you mean 'left'"),
        ({"support[0].on": ["lft"]}, [], "did you mean 'left'"),
    ],
)
def test_bad_input_writes_nothing(
    folder: Path, values: dict[str, Any], tell: list[str], message: str
) -> None:
    """One message with the nearest name."""
    with pytest.raises(InputError, match=message):
        sweep(bar(folder), values, output=folder / "out", tell=tell)
    assert not on_root(WORLD, (folder / "out").exists)


def test_a_result_that_is_not_there(folder: Path) -> None:
    """The run has no such column; the nearest one is named."""
    with pytest.raises(InputError, match="did you mean 'end_x'") as error:
        sweep(bar(folder), {"materials.steel.E": [1e6]}, output=folder / "out", tell=["end_xx"])
    assert error.value.where == "--tell"


@pytest.mark.long
def test_frequencies_and_several_analyses(folder: Path) -> None:
    """Modes scale as the root of E; statics of the same case is told beside them."""
    case = bar(folder, statics={}, modal={"count": 4})
    values = {"materials.steel.E": ["1 MPa", "4 MPa"]}
    found = sweep(case, values, output=folder / "out").columns()
    assert found["end_x"] == pytest.approx([1e-3, 0.25e-3], rel=1e-9)
    assert found["frequency_1"][1] / found["frequency_1"][0] == pytest.approx(2.0, rel=1e-8)
    assert "frequency_4" not in found
    again = sweep(case, values, output=folder / "again", tell=["frequency_4"]).columns()
    assert again["frequency_4"][0] > found["frequency_3"][0]


@pytest.mark.skipif(WORLD.size == 1, reason="compares numbers of ranks")
def test_ranks_agree(folder: Path) -> None:
    """The same table, but for seconds, to the solver's tolerance."""

    def numbers(comm: MPI.Comm) -> list[float]:
        values = {"materials.steel.E": ["1 MPa", "2 MPa"]}
        found = sweep(bar(folder), values, output=folder / f"on_{comm.size}", comm=comm)
        return [value for row in found.rows for value in row.numbers.values()]

    first, *others = [on_ranks(size, numbers) for size in SIZES]
    for other in others:
        assert np.allclose(other, first, rtol=1e-9, atol=1e-15)


# --- statistics, of rows whose numbers are given ---


def rows_of(made: Any, function: Any, error: float = math.nan) -> list[Row]:
    return [
        Row(n, values, "", "", "solved", numbers={"y": function(**values)}, errors={"y": error})
        for n, values in enumerate(made.rows, 1)
    ]


def test_a_linear_result_has_the_deviation_of_its_settings() -> None:
    """y = 3 a + 4 b: the deviation is 5, by a hypercube of 400 to 2 %, and the mean to 0.1 %."""
    made = design([read_setting(key, "normal(10, 1)") for key in "ab"], samples=400)
    rows = rows_of(made, lambda a, b: 3 * a + 4 * b, 0.01)
    of = statistics(made, rows)["y"]
    assert of.mean == pytest.approx(70, rel=1e-3)
    assert of.deviation == pytest.approx(5, rel=0.02)
    assert of.percentiles[95] - of.percentiles[5] == pytest.approx(2 * 1.645 * 5, rel=0.05)
    assert of.mesh == pytest.approx(0.7, rel=1e-3)


def of_stress(error: float, **keys: Any) -> Results:
    """Twenty samples of a stress around 1 MPa, and of a displacement, which has no error."""
    made = design([read_setting("E", "normal(1 MPa, 3 %)")])
    rows = tuple(
        Row(
            n,
            values,
            "",
            "",
            "solved",
            numbers={
                "von_mises": 1e6 * float(values["E"].split()[0]),
                "displacement": 1e-3 + n * 1e-6,
            },
            errors={"von_mises": error},
            **keys,
        )
        for n, values in enumerate(made.rows, 1)
    )
    return Results("case", Path(), made, rows)


def test_one_unit_in_a_sentence_and_why_an_error_is_not_known() -> None:
    """Mean, deviation, percentiles and error of a stress around 1 MPa are in MPa."""
    stress, displacement = of_stress(0.01).lines()
    assert stress.count(" MPa") == 5
    assert "kPa" not in stress
    assert stress.endswith("from the mesh ± 0.01 MPa")
    assert "µm" not in displacement
    why = "it is estimated of stresses and the safety factor only"
    assert displacement.endswith(f"from the mesh not known: {why}")
    unknown = of_stress(math.nan, remarks={"von_mises": "its error is not known: one element"})
    assert unknown.lines()[0].endswith("from the mesh not known: one element")


def test_values_that_are_drawn_have_four_digits() -> None:
    """In the lines of the runs and in the table; those of a list stay as they were written."""
    results = of_stress(0.01)
    (drawn,) = results.design.settings
    assert worded("1.0592861 MPa", drawn) == "1.059 MPa"
    assert worded(-0.21209719, drawn) == "-0.2121"
    assert worded("1.0592861 MPa", read_setting("E", "1 MPa,2 MPa")) == "1.0592861 MPa"
    assert all(len(cell.replace(".", "").lstrip("0")) <= 4 for cell in results.texts()["E [MPa]"])


def test_the_legend_of_a_plot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It stands above the panels; bars are thinner than lines."""
    made = design([read_setting("a", "1,2,3"), read_setting("b", "1,2")])
    rows = [
        replace(row, numbers={"von_mises": row.numbers["y"]}, errors={"von_mises": 0.1})
        for row in rows_of(made, lambda a, b: 1e6 * (a + b))
    ]
    figures: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda self, *_, **__: figures.append(self))
    with suppress(OutputError, FileNotFoundError):  # of the file that is not written
        Results("case", tmp_path, made, tuple(rows)).plot(tmp_path / "sweep.png")
    (figure,), (panel,) = figures, figures[0].axes
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts == ["b = 1", "b = 2", "estimated error of the mesh"]
    figure.canvas.draw()
    top = panel.get_window_extent().y1
    assert figure.legends[0].get_window_extent().y0 > top
    widths = [bars.get_linewidths()[0] for bars in panel.collections]
    assert max(widths) < min(line.get_linewidth() for line in panel.lines)


@pytest.mark.long
def test_indices_of_ishigami() -> None:
    """T. Ishigami & T. Homma (1990): 0.3139, 0.4424, 0 alone; 0.5576, 0.4424, 0.2437 in total.

    4096 base samples are within 0.02, four times what the bootstrap says.
    """
    made = design(
        [read_setting(key, f"uniform({-math.pi}, {math.pi})") for key in "abc"], sobol=4096
    )
    rows = rows_of(
        made, lambda a, b, c: math.sin(a) + 7 * math.sin(b) ** 2 + 0.1 * c**4 * math.sin(a)
    )
    of = statistics(made, rows)["y"].sobol
    assert [of[key].first for key in "abc"] == pytest.approx([0.3139, 0.4424, 0.0], abs=0.02)
    assert [of[key].total for key in "abc"] == pytest.approx([0.5576, 0.4424, 0.2437], abs=0.02)
    assert all(0.0 < of[key].error < 0.05 for key in "abc")


def test_indices_of_what_hardly_varies_are_written(folder: Path) -> None:
    """Of two values some resampled sets have no variance: no number, and no traceback."""
    made = design([read_setting(key, "uniform(0, 1)") for key in "ab"], sobol=4)
    rows = rows_of(made, lambda a, b: float(a > 0.8))
    results = Results("case", folder, made, tuple(rows))
    on_root(WORLD, lambda: write_table(results, plot=False))
    summary = json.loads(on_root(WORLD, (folder / "sweep.json").read_text))
    assert len(summary["rows"]) == 16


def test_no_statistics_of_lists_and_no_indices_without_a_row() -> None:
    """A mean over listed values says nothing; an estimate with a gap would be wrong."""
    listed = design([read_setting("a", "1,2,3,4")])
    assert statistics(listed, rows_of(listed, lambda a: a)) == {}
    made = design([read_setting(key, "normal(10, 1)") for key in "ab"], sobol=4)
    rows = rows_of(made, lambda a, b: a + b)
    rows[5] = Row(6, made.rows[5], "", "", "failed", "cause")
    assert statistics(made, rows)["y"].sobol == {}
