"""Several analyses of one case: what each of them is, where it goes, and when one fails."""

from __future__ import annotations

import json
import sys
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from mpi4py import MPI

from dolfin_elastic import Case, restart, run
from dolfin_elastic.case.check.report import report
from dolfin_elastic.cli.app import guarded
from dolfin_elastic.core.errors import ConvergenceError, InputError, RestartError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.problem.state import Mode, State
from dolfin_elastic.results.finished.run import FinishedRun

TABLES: dict[str, Any] = {
    "mesh": {"rectangle": {"size": [4, 1], "cells": [4, 1]}, "degree": 2},
    "materials": {
        "steel": {"law": "st-venant-kirchhoff", "E": "2 GPa", "nu": 0.3, "density": 1000}
    },
    "support": [{"on": "left"}],
    "load": [{"kind": "traction", "on": "right", "value": ["-1 MPa", 0]}],
}
ALL: dict[str, Any] = {
    "statics": {"steps": 3},
    "modal": {"count": 1, "preload": True},
    "buckling": {"count": 1},
    "dynamics": {"dt": "1 ms", "end": "2 ms"},
}


def case(**tables: Any) -> Case:
    return Case.from_dict({**TABLES, **tables}, file="case.toml")


def summary(folder: Path, comm: MPI.Comm) -> dict[str, Any]:
    return dict(on_root(comm, lambda: json.loads((folder / "summary.json").read_text())))


@pytest.mark.long
def test_all_in_turn(
    folder: Path,
    comm: MPI.Comm,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The results of each are those of a case of its own; the mesh is read once, and the preload
    is not sought again, nor is its stress told again."""
    caplog.set_level("INFO", "dolfin_elastic")
    read = []
    body = Case.read_body
    monkeypatch.setattr(Case, "read_body", lambda *given: read.append(1) or body(*given))
    output = {"frames": 4, "fields": ["displacement", "velocity", "residual"]}
    several = case(**ALL, output=output)
    results = list(run(several, output=folder, comm=comm))
    assert len(read) == 1
    kinds = [type(one) for one in results]
    assert kinds == 4 * [State] + [State, Mode] + [Mode] + 3 * [State]
    assert results[4].newton == 0
    assert comm.bcast(caplog.text.count("estimated error")) == 1
    assert on_root(comm, lambda: {one.name for one in folder.iterdir()}) == set(ALL)
    for analysis in ALL:
        assert summary(folder / analysis, comm)["status"] == "completed"
    loaded, at_rest = (m for m in results if isinstance(m, Mode))
    *_, known = run(case(modal=ALL["modal"]), output=folder / "a", comm=comm)
    assert loaded.frequency == pytest.approx(known.frequency, rel=1e-9)
    (known,) = run(case(buckling=ALL["buckling"]), output=folder / "b", comm=comm)
    assert at_rest.load_factor == pytest.approx(known.load_factor, rel=1e-9)
    *_, known = run(case(dynamics=ALL["dynamics"]), output=folder / "c", comm=comm)
    assert results[-1].max_displacement == pytest.approx(known.max_displacement, rel=1e-9)


def test_each_is_a_case() -> None:
    """Its own folder and part of [output]; settings of statics only for the way to a preload."""
    film = {"file": "grow.mp4"}
    picture = {"file": "a.png", "field": "von_mises"}
    output = {"fields": ["displacement", "velocity", "residual"], "pictures": [film, picture]}
    several = case(**(ALL | {"statics": {"end": 1.5, "times": [1.2]}}), output=output)
    statics, modal, buckling, motion = several.analyses()
    assert [one.results_folder().name for one in several.analyses()] == list(ALL)
    assert statics.output.fields == ("displacement", "residual")
    assert motion.output.fields == ("displacement", "velocity")
    assert [p.file for p in modal.output.pictures] == ["a.png"]
    assert modal.statics is not None
    assert modal.statics.end == 1.5
    assert buckling.statics is None
    assert motion.statics is None
    (same,) = modal.analyses()
    assert same is modal
    assert modal.whole is several
    preloaded = case(statics={"end": 1.5, "times": [1.2]}, buckling={"preload": 0.5})
    way = preloaded.analyses()[1].statics
    assert way is not None
    assert (way.end, way.times) == (1.0, [])


def test_check_of_all(comm: MPI.Comm) -> None:
    found = report(case(**ALL), comm=comm)
    assert found.analysis == "statics, modal, buckling, dynamics"
    assert found.scheme == "generalized-alpha"
    assert len(found.loads) == 1
    assert "54 unknowns" in found.linear_solver
    assert len(found.notes) == len(set(found.notes))
    with pytest.raises(InputError, match="there is no support"):  # of one of them is the case's
        report(case(support=[], modal={}, buckling={}), comm=comm)


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"statics": {}, "dynamics": ALL["dynamics"], "output": {"frames": 3}}, "no modes in stat"),
        ({"modal": {}, "buckling": {}, "output": {"every": 3}}, "output.every: modes without a pr"),
        ({"modal": {}, "buckling": {}, "output": {"checkpoint": "1 min"}}, r"\[modal\] and \[buck"),
    ],
)
def test_what_none_of_them_gives(tables: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        case(**tables)


def test_one_that_fails(folder: Path, comm: MPI.Comm, caplog: pytest.LogCaptureFixture) -> None:
    """Those that need it are left out, the others run; the error comes at the end."""
    fails = {"steps": 1, "max_iterations": 1, "min_step": 1.0, "snap": False}
    load = [{"kind": "traction", "on": "right", "value": ["0 MPa", "90 MPa"]}]
    buckling = {"count": 1, "preload": 0.5}
    assert not case(statics={}, buckling=buckling).analyses()[1].preload_of_statics
    assert case(statics={"end": 0.5}, buckling=buckling).analyses()[1].preload_of_statics
    several = case(**(ALL | {"statics": fails}), load=load)
    results = []
    with pytest.raises(ConvergenceError):
        for one in run(several, output=folder, comm=comm):
            results.append(one)
    assert [type(one) for one in results] == [State, Mode] + 3 * [State]
    assert "[modal] is left out: its preload was not found" in comm.bcast(caplog.text)
    assert summary(folder / "statics", comm)["status"] == "failed"
    assert not (folder / "modal").exists()
    assert summary(folder / "dynamics", comm)["status"] == "completed"


def test_what_one_lacks_is_found_before_any_is_computed(folder: Path, comm: MPI.Comm) -> None:
    """A law that knows no buckling, and a material without density, beside statics that run."""
    soft = {"law": "linear-elastic", "E": "2 GPa", "nu": 0.3, "density": 1000}
    light = {"law": "st-venant-kirchhoff", "E": "2 GPa", "nu": 0.3}
    for kind, keys, steel, said in (
        ("buckling", {"preload": 0.5}, soft, "materials.steel.law: .* its stiffness does not"),
        ("modal", {}, light, "materials.steel: weight and motion need a density"),
    ):
        several = case(statics={}, materials={"steel": steel}, **{kind: {"count": 1, **keys}})
        with pytest.raises(InputError, match=said):
            list(run(several, output=folder / kind, comm=comm))
        assert on_root(comm, lambda kind=kind: not (folder / kind / "statics").exists())


def test_what_failed_is_not_gone_on_with(folder: Path, comm: MPI.Comm) -> None:
    """The one after it was stopped: its checkpoint would be removed if the first began again."""
    fails = {"steps": 2, "max_iterations": 1, "min_step": 1.0, "snap": False}
    curve = [[0, 0], [0.5, 0], [1, 1]]
    several = case(
        statics=fails,
        dynamics=ALL["dynamics"],
        load=[{"kind": "traction", "on": "right", "value": [0, "90 MPa"], "curve": curve}],
        output={"checkpoint": {"every": 1}},
    )
    states = run(several, output=folder, comm=comm)
    while (state := next(states)).v is None or state.step < 1:
        pass
    states.close()
    assert on_root(comm, lambda: [*(folder / "statics/checkpoints").glob("step_*.json")])
    assert [one.step for one in restart(folder, comm=comm)] == [2]


def test_stop_and_restart(folder: Path, comm: MPI.Comm) -> None:
    """The common folder goes on with the analysis that was stopped, and then with the rest."""
    several = case(**{key: ALL[key] for key in ("statics", "modal")})
    states = run(several, output=folder, comm=comm)
    list(islice(states, 2))
    states.close()
    assert summary(folder / "statics", comm)["status"] == "stopped"
    with pytest.raises(InputError, match="several analyses; the folder of one: .*statics"):
        FinishedRun(folder)
    results = list(restart(folder, comm=comm))
    assert [type(one) for one in results] == [State, State, State, Mode]
    assert results[0].step == 2
    with pytest.raises(RestartError, match="no analysis .* statics completed, modal completed"):
        restart(folder, comm=comm).send(None)


def typed_run(several: Case, folder: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    """Exit code of the command that runs a case, with its results in a folder."""
    monkeypatch.chdir(folder)  # docker/run refuses an output that it would not keep
    file = folder / "bar.toml"
    file.write_text(several.to_toml())
    monkeypatch.setattr("sys.argv", ["dolfin-elastic", "run", str(file), "-o", str(folder)])
    return guarded()


def test_numbers_count_what_is_left_out(
    folder: Path,
    comm: MPI.Comm,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Of three of which the second is left out the last one is the third."""
    if comm.size > 1:
        pytest.skip("prints on rank 0 only")
    fails = {"steps": 1, "max_iterations": 1, "min_step": 1.0, "snap": False}
    load = [{"kind": "traction", "on": "right", "value": ["0 MPa", "90 MPa"]}]
    assert typed_run(case(**(ALL | {"statics": fails}), load=load), folder, monkeypatch) == 3
    heads = [line for line in capsys.readouterr().out.splitlines() if " of 4)" in line]
    assert heads == ["statics (1 of 4)", "buckling (3 of 4)", "dynamics (4 of 4)"]


@pytest.mark.long
def test_commands(
    folder: Path,
    comm: MPI.Comm,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A heading and the folder of each; files of an older run go."""
    if comm.size > 1:
        pytest.skip("prints on rank 0 only")
    list(run(case(statics={}), output=folder))
    several = case(modal={"count": 1}, buckling={"count": 1})
    assert typed_run(several, folder, monkeypatch) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "modal (1 of 2)" in lines
    assert "buckling (2 of 2)" in lines
    assert [line.split(":")[0] for line in lines if line.startswith("results in")] == [
        f"results in {folder / 'modal'}",
        f"results in {folder / 'buckling'}",
    ]
    assert {one.name for one in folder.iterdir()} == {"bar.toml", "modal", "buckling"}
    assert [line for line in lines if "bending in y" in line]
    monkeypatch.setattr("sys.argv", [*sys.argv, "--json"])
    assert guarded() == 0
    found = json.loads(capsys.readouterr().out)
    assert {name: one["verdict"]["kind"] for name, one in found.items()} == {
        "modal": "result",
        "buckling": "result",
    }
    monkeypatch.setattr("sys.argv", ["dolfin-elastic", "report", str(folder)])
    assert guarded() == 0
    assert (folder / "buckling/report.html").exists()


def test_the_mesh_is_one() -> None:
    """Linear elements of an explicit motion lie beside quadratic ones of statics."""
    tables = {**TABLES, "mesh": {"rectangle": {"size": [4, 1], "cells": [4, 1]}}}
    motion = {"scheme": "symplectic-euler", "end": "1 ms"}
    several = Case.from_dict({**tables, "statics": {}, "dynamics": motion})
    assert [one.degree for one in several.analyses()] == [2, 1]
