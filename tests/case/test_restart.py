"""Runs that go on from a checkpoint: as if they had never ended."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.arch import FULL, RISE, arch
from helpers.checkpoints import saved
from helpers.ranks import SIZES, on_ranks
from helpers.runs import (
    NEAR,
    WORLD,
    begun,
    case,
    check_same,
    check_same_frames,
    finished,
    history,
    kill,
    summary,
)
from mpi4py import MPI

from dolfin_elastic import (
    Body,
    Case,
    Cavity,
    Contact,
    Dynamics,
    Energy,
    Gravity,
    LinearElastic,
    NeoHookean,
    NeoHookeanSplit,
    Periodic,
    Problem,
    Rigid,
    Spring,
    Statics,
    Support,
    Traction,
    box_body,
    read_case,
    rectangle_body,
    restart,
    run,
)
from dolfin_elastic.case.restart import portable, written_tables
from dolfin_elastic.core.errors import RestartError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.model.records import GRAVITY
from dolfin_elastic.problem.state import State, StateCopy
from dolfin_elastic.results.checkpoint.checkpoints import FOLDER, newest_checkpoint
from dolfin_elastic.results.writers.history import row
from dolfin_elastic.solvers.linear.choice import LinearSettings

FREE = "free"
E = 1e6

ALONE = pytest.mark.skipif(WORLD.size > 1, reason="ranks have no part of their own in it")
PAIR = pytest.mark.skipif(WORLD.size > 2, reason="two ranks show what three do")


# --- solvers ---


def bent(comm: MPI.Comm = WORLD, **more: Any) -> Problem:
    """A strip of rubber that a load on its end bends far."""
    keys: dict[str, Any] = {
        "supports": [Support(on="left")],
        "loads": [Traction(on="right", value=[0, -8e3])],
    } | more
    body = rectangle_body(size=(1, 0.2), cells=(5, 1), comm=comm)
    return Problem(body, NeoHookean(E=E, nu=0.3), degree=2, **keys)


def mixed() -> Problem:
    """Wholly incompressible, with a pressure."""
    return Problem(
        rectangle_body(size=(1, 0.5), cells=(4, 2)),
        NeoHookeanSplit(mu=E / 3, nu=0.5),
        degree=2,
        supports=[Support(on="left"), Spring(on="bottom", stiffness=[0, 1e5])],
        loads=[Traction(on="right", value=[2e5, 5e4])],
    )


def pressed() -> Problem:
    """A block that lies on a floor and is pressed by a ball: multipliers of two contacts."""
    return Problem(
        rectangle_body(size=(1, 0.5), cells=(6, 3)),
        NeoHookean(E=E, nu=0.3),
        supports=[Support(on="left", displacement=[0, FREE])],
        contacts=[
            Contact(on="bottom", plane={"axis": "y", "at": 0}, name="floor"),
            Contact(
                on="top",
                cylinder={"axis": "z", "point": [0, 1], "radius": 0.5},
                motion=[0, -0.1],
                name="ball",
            ),
        ],
        degree=1,
    )


def cell() -> Problem:
    """A periodic cell with strains that are unknown."""
    return Problem(
        rectangle_body(size=(1, 1), cells=(3, 3)),
        NeoHookeanSplit(mu=E / 3, nu=0.49),
        degree=2,
        formulation="mixed",
        periodic=Periodic(
            pairs=[["left", "right"], ["bottom", "top"]],
            gradient=[[1.3, 0.2], [0, FREE]],
            stress=[[FREE, FREE], [FREE, 5e4]],
        ),
    )


def rolled() -> Problem:
    """A strip whose end is rigid, under a moment: three unknown numbers."""
    return bent(
        supports=[Support(on="left"), Rigid(on="right", force=[0, 0], moment=600.0)], loads=[]
    )


def blown() -> Problem:
    """A quarter of a tube whose volume is given: the pressure is unknown."""
    body = rectangle_body(size=(1, 1), cells=(4, 4))
    r, phi = 1 + 0.3 * body.mesh.geometry.x[:, 0], np.pi / 2 * body.mesh.geometry.x[:, 1]
    body.mesh.geometry.x[:, 0], body.mesh.geometry.x[:, 1] = r * np.cos(phi), r * np.sin(phi)
    return Problem(
        body,
        NeoHookean(E=E, nu=0.3),
        supports=[
            Support(on="bottom", displacement=[FREE, 0]),
            Support(on="top", displacement=[0, FREE]),
        ],
        loads=[Cavity(on="left", volume_ratio=2.0, name="bore")],
        degree=1,
    )


def snapping() -> Problem:
    """A shallow arch whose load passes two limit points."""
    return arch(RISE, FULL, (10, 1))


def bulky() -> Problem:
    """A block whose tangents are solved with by iteration."""
    body = box_body(size=(1, 1, 1), cells=(3, 3, 3))
    loads = [Traction(on="top", value=[2e5, 0, -1e5])]
    return Problem(
        body, NeoHookean(E=E, nu=0.3), supports=[Support(on="bottom")], loads=loads, degree=1
    )


def linear() -> Problem:
    """One solve, one tangent for all steps."""
    body = box_body(size=(2, 1, 1), cells=(3, 2, 2))
    law = LinearElastic(E=E, nu=0.3, density=1e3)
    return Problem(body, law, supports=[Support(on="left")], loads=[Gravity()], degree=1)


SOLVES: dict[str, tuple[Callable[[], Problem], dict[str, Any]]] = {
    "bent": (bent, {"max_step": 0.2}),
    "mixed": (mixed, {"steps": 4}),
    "contact": (pressed, {"steps": 5}),
    "cell": (cell, {"steps": 4}),
    "rigid": (rolled, {"max_step": 0.2}),
    "cavity": (blown, {"steps": 4}),
    "arc-length": (snapping, {"method": "arc-length", "first_step": 0.1}),
    "linear": (linear, {"steps": 3}),
    "iterative": (bulky, {"steps": 4, "linear": LinearSettings(method="iterative")}),
}


def numbers(states: list[State]) -> list[dict[str, Any]]:
    """Rows of history, as they were yielded."""
    return [dict(state) if isinstance(state, dict) else row(state) for state in states]


@pytest.mark.sample(2)
@pytest.mark.parametrize("name", SOLVES)
def test_a_solver_goes_on(name: str, folder: Path) -> None:
    """From each of its steps, through a file, in a problem of its own."""
    make, keys = SOLVES[name]
    solver, known, limits = Statics(make(), **keys), [], []
    for state in solver.steps():
        known.append(row(state))
        limits.append(state.limit_points)
        saved(WORLD, folder / str(state.step), solver.restart_state(), max(state.step, 1))
    assert len(known) > 3
    first = 0 if name == "arc-length" else 1
    # Along a path where the first limit point is still to be noticed.
    later = next((i - 1 for i, found in enumerate(limits) if found), len(known) // 2)
    for step in (first, later):
        found = newest_checkpoint(WORLD, folder / str(step))
        assert found is not None
        again = list(Statics(make(), **keys).steps(found))
        # A preconditioner that is kept across load steps is set up anew by a restart.  The linear
        # solves of inexact Newton then end at other residuals below the same tolerance, and where
        # one of them ends near Newton's own, a step more or less is taken (seen on 3 ranks: 5 for
        # 4).  The two are balanced to 1e-8 each, and that is what can be compared.
        iterative = name == "iterative"
        near, but = (1e-8, ["krylov", "newton"]) if iterative else (NEAR, [])
        check_same([row(state) for state in again], known[step + 1 :], near, but)
        assert [state.limit_points for state in again] == pytest.approx(limits[step + 1 :])
    if name == "arc-length":
        assert len(limits[-1]) == 2


@pytest.mark.long
@ALONE
def test_a_solver_goes_on_after_failures(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Steps were made smaller, and an equilibrium beyond the snap, found early, is come back to."""
    solver, known = Statics(snapping(), max_step=0.5), []
    with caplog.at_level(logging.INFO):
        for state in solver.steps():
            known.append(row(state))
            saved(WORLD, folder / str(state.step), solver.restart_state(), max(state.step, 1))
    assert on_root(WORLD, lambda: "a smaller step" in caplog.text and "snapped" in caplog.text)
    for step in (1, len(known) // 2):
        found = newest_checkpoint(WORLD, folder / str(step))
        assert found is not None
        again = Statics(snapping(), max_step=0.5).steps(found)
        check_same([row(state) for state in again], known[step + 1 :])


def test_from_two_ranks_to_three_to_one(folder: Path) -> None:
    """Half of a run on each, as far as there are so many; the path stays the same."""
    keys = {"max_step": 0.2, "rtol": 1e-10}
    known = on_ranks(1, lambda c: [row(s) for s in Statics(bent(c), **keys).steps()])

    def part(comm: MPI.Comm) -> list[dict[str, Any]]:
        solver, rows = Statics(bent(comm), **keys), []
        found = newest_checkpoint(comm, folder)
        states = solver.steps() if found is None else solver.steps(found)
        for state in states:
            rows.append(row(state))
            if len(rows) == 2:
                saved(comm, folder, solver.restart_state(), state.step)
                break
        states.close()
        return rows

    order = [SIZES[-1 if len(SIZES) < 3 else 1], SIZES[-1], 1]
    rows = [one for count in order for one in on_ranks(count, part)]
    check_same(rows, known[: len(rows)], near=1e-8)
    assert len(rows) == 6


# --- runs ---


@pytest.fixture
def whole(folder: Path) -> Path:
    """Results of the case without an interruption."""
    for _ in run(case(), output=folder / "whole"):
        pass
    return folder / "whole"


def check_same_results(folder: Path, known: Path) -> None:
    """History, summary and fields of two folders."""
    check_same(history(folder), history(known))
    here, there = summary(folder), summary(known)
    assert here["status"] == there["status"] == "completed"
    for key in ("steps", "t", "newton_iterations", "cells", "dofs"):
        assert here[key] == there[key], key
    assert here["max_displacement"] == pytest.approx(there["max_displacement"], rel=NEAR)
    work = there["audit"].get("external_work")  # explicit motion has no audit
    assert here["audit"].get("external_work") == pytest.approx(work, rel=NEAR)
    on_root(WORLD, lambda: check_same_frames(folder, known))


@PAIR
def test_a_run_goes_on(folder: Path, whole: Path) -> None:
    """Killed after the third step, and again after the fourth: one series in all files."""
    begun(case(), folder / "a", 3)
    states = restart(folder / "a")
    assert next(states).step == 4
    kill(states)
    assert finished(folder / "a") == list(range(5, len(history(whole))))
    check_same_results(folder / "a", whole)
    written = summary(folder / "a")
    assert [(one["step"], one["ranks"]) for one in written["restarts"]] == [
        (3, WORLD.size),
        (4, WORLD.size),
    ]
    assert summary(whole)["restarts"] == []
    # What is not needed any more is gone; the mesh is written once, for it is the same.
    assert on_root(WORLD, lambda: not (folder / "a" / FOLDER).exists())
    assert on_root(WORLD, lambda: [p.name for p in (folder / "a").rglob("mesh*")]) == ["mesh.h5"]


MOTIONS: dict[str, dict[str, Any]] = {
    "implicit": {"end": "0.2 s", "dt": "20 ms"},
    "adaptive": {"end": "0.2 s", "dt": "2 ms", "adaptive": True, "tolerance": 0.1},
    "conserving": {"end": "0.2 s", "dt": "20 ms", "spectral_radius": 1.0},
    "explicit": {"scheme": "symplectic-euler", "end": "150 ms", "every": 3},
    "stretched": {
        "scheme": "central-differences",
        "end": "60 ms",
        "every": 2,
        "initial_displacement": ["0.1*x", 0],
    },
}


@pytest.mark.sample(2)
@pytest.mark.parametrize("name", MOTIONS)
def test_a_motion_goes_on(name: str, folder: Path) -> None:
    """Velocities, step sizes and work so far, too; fields thinned as in one run."""
    rubber = {"law": "neo-hookean", "E": "1 MPa", "nu": 0.3, "density": 1000}
    moving = case(
        mesh={"rectangle": {"size": [1, 0.2], "cells": [5, 1]}, "degree": 1},
        materials={"rubber": rubber},
        statics=None,
        dynamics=MOTIONS[name],
    )
    for _ in run(moving, output=folder / "whole"):
        pass
    rows = history(folder / "whole")
    assert len(rows) > 8
    begun(moving, folder / "a", int(rows[4]["step"]))
    assert finished(folder / "a") == [one["step"] for one in rows[5:]]
    check_same_results(folder / "a", folder / "whole")


def moved(body: Body, scheme: str, petsc: dict[str, Any]) -> Dynamics:
    """A square stretched so far that a law for small strains says so at once."""
    problem = Problem(body, LinearElastic(E=E, nu=0.3, density=1e3), degree=1)
    keys: dict[str, Any] = {"end": 1e-3, "dt": 1e-4, "initial_displacement": ["0.2*x", 0]}
    return Dynamics(problem, scheme=scheme, petsc=petsc, **keys)


@pytest.mark.parametrize(
    ("scheme", "petsc", "forgotten"),
    [
        ("alpha2", {}, "'alpha2' keeps its acceleration for itself"),
        ("generalized-alpha", {"ts_adapt_type": "dsp"}, "'-ts_adapt_type dsp' keeps the errors"),
        ("generalized-alpha", {}, None),
        ("central-differences", {}, None),
    ],
)
def test_a_motion_that_goes_on_says_what_is_new(
    scheme: str, petsc: dict[str, Any], forgotten: str | None, caplog: pytest.LogCaptureFixture
) -> None:
    """What PETSc does not give away is warned of, but not a second time."""
    body = rectangle_body(size=(1, 1), cells=(2, 2))
    motion = moved(body, scheme, petsc)
    states = motion.steps()
    next(states), next(states)
    saved = StateCopy(motion.restart_state())
    states.close()
    assert on_root(WORLD, lambda: "is for small strains" in caplog.text)
    caplog.clear()

    states = moved(body, scheme, petsc).steps(saved)
    next(states)
    states.close()
    warnings = on_root(
        WORLD, lambda: [one.getMessage() for one in caplog.records if one.levelno > 20]
    )
    assert len(warnings) == (forgotten is not None), warnings
    assert all(forgotten in one for one in warnings)


@PAIR
def test_what_came_after_the_checkpoint_is_cut_off(folder: Path, whole: Path) -> None:
    """Rows, frames and pictures of steps that were computed but not kept; half a row, too."""
    output = {"probes": {"tip": [1, 0.1]}, "checkpoint": {"every": 3}}
    begun(case(output=output), folder / "a", 5)

    def half_written() -> None:
        with (folder / "a/history.csv").open("a") as file:
            file.write("6,0.9,0.")
        (folder / "a/results_data/000006.h5").write_bytes(b"half")

    on_root(WORLD, half_written)
    assert finished(folder / "a")[0] == 4
    check_same_results(folder / "a", whole)


@ALONE
def test_thinned_fields_go_on(folder: Path) -> None:
    """Every second step is shown, and the last; a run that ended on request had shown another."""
    output = {"every": 2, "checkpoint": {}}
    for _ in run(case(output=output), output=folder / "whole"):
        pass
    states = run(case(output=output), output=folder / "a")
    while next(states).step < 3:
        pass
    states.close()
    assert summary(folder / "a")["status"] == "stopped"
    assert finished(folder / "a")[0] == 4
    check_same_results(folder / "a", folder / "whole")


def test_other_ranks_go_on(folder: Path) -> None:
    """The points stand in another order then, and the files say so to ParaView."""

    def whole(comm: MPI.Comm) -> None:
        for _ in run(case(), output=folder / "whole", comm=comm):
            pass

    def first(comm: MPI.Comm) -> None:
        begun(case(), folder / "a", 2, comm=comm)

    def second(comm: MPI.Comm) -> None:
        for _ in restart(folder / "a", comm=comm):
            pass

    on_ranks(1, whole)
    on_ranks(SIZES[-1], first)
    on_ranks(SIZES[len(SIZES) // 2], second)
    check_same_results(folder / "a", folder / "whole")
    assert summary(folder / "a")["restarts"][0]["ranks"] == SIZES[len(SIZES) // 2]


@PAIR
def test_closing_leaves_a_checkpoint(folder: Path, whole: Path) -> None:
    """Whoever stops looking can go on; so can who asks for a checkpoint and is killed later."""
    output = {"probes": {"tip": [1, 0.1]}, "checkpoint": "1 h"}
    states = run(case(output=output), output=folder / "a")
    next(states), next(states), next(states)
    states.close()
    wishes = iter([False, True, False])
    states = restart(folder / "a", asked=lambda: next(wishes))
    assert [next(states).step for _ in range(3)] == [3, 4, 5]
    kill(states)
    assert finished(folder / "a")[0] == 5
    check_same_results(folder / "a", whole)


@ALONE
def test_a_new_run_forgets_the_old_one(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    begun(case(), folder / "a", 2)
    output = {"checkpoint": False}
    for _ in run(case(output=output), output=folder / "a"):
        assert on_root(WORLD, lambda: not (folder / "a" / FOLDER).exists())
    assert on_root(WORLD, lambda: "a run that had not ended are removed" in caplog.text)


# --- what cannot go on ---


def refused(folder: Path, match: str, **keys: Any) -> None:
    with pytest.raises(RestartError, match=match):
        next(restart(folder, **keys))


@PAIR
def test_nothing_to_go_on_from(folder: Path, whole: Path) -> None:
    refused(whole, "whole: this run is complete; nothing is left to compute")
    refused(folder / "none", "none: there is no such folder")
    on_root(WORLD, (folder / "mine").mkdir)
    refused(folder / "mine", "mine: this is no folder of results")
    refused(whole / "history.csv", "history.csv: this is a file; expected the folder of")
    states = run(case(output={"checkpoint": False}), output=folder / "off")
    next(states), next(states)
    states.close()
    refused(folder / "off", "off: the run has ended before its first checkpoint")


@PAIR
def test_changed_results_are_refused(folder: Path) -> None:
    """What is lost cannot be made up."""
    begun(case(), folder / "a", 3)
    on_root(WORLD, lambda: os.truncate(folder / "a/history.csv", 40))
    refused(folder / "a", r"history.csv: rows that the checkpoint knows of are not there")
    begun(case(), folder / "b", 3)
    on_root(WORLD, (folder / "b/results_data/000001.h5").unlink)
    refused(folder / "b", r"results.xdmf: steps that the checkpoint knows of")


@PAIR
def test_a_changed_case_is_refused(folder: Path) -> None:
    begun(case(), folder / "a", 2)
    harder = [{"kind": "traction", "on": "right", "value": [0, "-9 kPa"]}]
    refused(
        folder / "a",
        r"the case is not that of the checkpoint: load\[0\].value\[1\]",
        case=case(load=harder),
    )
    copy = folder / "a" / FOLDER / "case.toml"
    on_root(WORLD, lambda: [copy.write_text(copy.read_text().replace("0.3", "0.4")), None][1])
    refused(folder / "a", r"case.toml: this is not the case of the checkpoint any more")


@pytest.mark.parametrize("damage", ["cut", "gone", "noise", "empty"])
def test_a_damaged_copy_of_the_case(
    damage: str, folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """It gives way to the copy in the checkpoint; with one that is another case this is refused."""
    begun(case(), folder / "a", 2)
    copy = folder / "a" / FOLDER / "case.toml"

    def spoil() -> bytes:
        whole = copy.read_bytes()
        lines = whole.splitlines(keepends=True)
        kept = {"cut": b"".join(lines[:-2]), "noise": b"\xff\x00[", "empty": b""}
        copy.unlink()
        if damage in kept:
            copy.write_bytes(kept[damage])
        return whole

    whole = on_root(WORLD, spoil)
    assert finished(folder / "a")[0] == 3
    if WORLD.rank == 0:
        assert "case.toml is damaged: its copy in the checkpoint takes its place" in caplog.text
    assert summary(folder / "a")["status"] == "completed"
    assert whole


@PAIR
def test_a_changed_case_file_is_told_of_each_time(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Also by a restart of a restart, and where the file is no case any more."""
    file, text = folder / "strip.toml", case(statics={"max_step": 0.1}).to_toml()

    def write(change: tuple[str, str]) -> None:
        assert change[0] in text
        file.write_text(text.replace(*change))

    def warnings_at(step: int) -> list[str]:
        caplog.clear()
        states = restart(folder / "a")
        while next(states).step < step:
            pass
        kill(states)
        messages = [
            record.getMessage() for record in caplog.records if record.levelname == "WARNING"
        ]
        return [one for one in WORLD.bcast(messages) if "case" in one]

    on_root(WORLD, lambda: write(("", "")))
    begun(read_case(file), folder / "a", 2)
    assert warnings_at(3) == []
    on_root(WORLD, lambda: write(("nu = 0.3", "nu = 0.4")))
    changed = f"{file.resolve()} has been changed (materials.rubber.nu); the run goes on with"
    for step in (4, 5):
        (message,) = warnings_at(step)
        assert message.startswith(changed)
    on_root(WORLD, lambda: write(("nu = 0.3", "nu = 0.7")))
    (message,) = warnings_at(6)
    assert message.startswith("the case file cannot be compared with the case as it was")
    assert f"{file.resolve()}: materials.rubber.nu: 0.7 is not a possible" in message
    on_root(WORLD, file.unlink)
    assert warnings_at(7) == []


@PAIR
def test_a_changed_mesh_is_refused(folder: Path) -> None:
    """The file that the case names is another one now."""

    def write(size: float) -> None:
        text = 'SetFactory("OpenCASCADE");\nRectangle(1) = {0, 0, 0, 1, 0.2};\n'
        text += f"MeshSize {{:}} = {size};\n"
        (folder / "body.geo").write_text(text)

    def on_file() -> Case:
        surfaces = {"left": {"plane": "x", "at": "min"}, "right": {"plane": "x", "at": "max"}}
        return case(mesh={"file": str(folder / "body.geo"), "degree": 2}, surfaces=surfaces)

    on_root(WORLD, lambda: write(0.2))
    begun(on_file(), folder / "a", 2)
    on_root(WORLD, lambda: write(0.1))
    refused(folder / "a", "the mesh is not that of the checkpoint: its number of elements differ")
    on_root(WORLD, lambda: write(0.2))
    states = restart(folder / "a")
    assert next(states).step == 3
    kill(states)


@pytest.mark.long
@ALONE
def test_a_case_of_functions(folder: Path) -> None:
    """What cannot be written down must be given again."""
    law = Energy(lambda I1, J, mu: mu / 2 * (I1 - 3) - mu * (J - 1) + mu * (J - 1) ** 2, mu=1e6)
    begun(case(materials={"own": law}), folder / "a", 2)
    refused(folder / "a", "the case was made in Python and cannot be written down")
    states = restart(folder / "a", case=case(materials={"own": law}))
    assert next(states).step == 3
    kill(states)


@ALONE
def test_the_copy_of_a_case_stands_alone(folder: Path) -> None:
    """Tables of curves are in it, and the mesh is found from everywhere."""

    def write() -> None:
        (folder / "rise.csv").write_text("t,f\n0,0\n0.5,2\n1,1\n")
        (folder / "case.toml").write_text("")

    on_root(WORLD, write)
    tables = case().to_dict()
    tables["load"][0]["curve"] = {"file": "rise.csv"}
    floor = {"axis": "y", "at": -1}
    tables["contact"] = [{"on": "bottom", "plane": floor, "curve": {"file": "rise.csv"}}]
    record = {"file": "rise.csv", "unit": "g"}
    tables["load"] += [{"kind": "base-acceleration", "value": [record, 0]}]
    del tables["mesh"]["rectangle"]
    tables["mesh"]["file"] = "sub/../body.msh"
    first = Case.from_dict(tables, folder)
    copy = Case.from_dict(portable(first), "/elsewhere")
    assert copy.mesh.file == str(folder.resolve() / "body.msh")
    assert copy.load[0].curve.at(0.25) == copy.contact[0].curve.at(0.25) == 1.0
    assert copy.load[-1].values[0].evaluate(t=0.25) == GRAVITY
    assert portable(copy) == portable(first)
    tables["output"] = {**tables.get("output", {}), "folder": "/some/where/out"}
    given_away = written_tables(Case.from_dict(tables, folder))
    assert given_away["mesh"]["file"] == "body.msh"
    assert given_away["output"]["folder"] == "out"
    assert str(folder.resolve()) not in repr(given_away)
