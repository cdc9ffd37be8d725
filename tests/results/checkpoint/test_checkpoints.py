"""Checkpoints on disk: written on some ranks, read on others, and never half of one."""

from __future__ import annotations

import json
import os
from collections import namedtuple
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from dolfinx import fem
from dolfinx.io import XDMFFile
from helpers.bodies import ball
from helpers.checkpoints import saved
from helpers.ranks import SIZES, WORLD, on_ranks
from helpers.reference_meshes import ring
from mpi4py import MPI

from dolfin_elastic import (
    NeoHookeanSplit,
    Periodic,
    Problem,
    box_body,
    read_body,
    rectangle_body,
)
from dolfin_elastic.core.errors import OutputError, RestartError
from dolfin_elastic.core.files.hdf5 import UnsafeHdf5Error
from dolfin_elastic.core.parallel import on_root, total
from dolfin_elastic.mesh import Body
from dolfin_elastic.problem.state import RestartState, State
from dolfin_elastic.results.checkpoint import checkpoints
from dolfin_elastic.results.checkpoint.checkpoints import (
    FOLDER,
    Checkpoints,
    CheckpointSettings,
    RunDescription,
    newest_checkpoint,
)
from dolfin_elastic.results.checkpoint.checksums import fingerprint
from dolfin_elastic.results.checkpoint.mesh_order import DofOrdering

MESHES = ["box", "rectangle", "geo", "msh", "xdmf"]


def write_mesh(kind: str, folder: Path) -> None:
    """The file of a mesh, on rank 0 alone."""
    if kind == "geo":
        (folder / "body.geo").write_text(ring(1.0, 2.0, (2, 4)))
    elif kind == "msh":
        ball(folder / "body.msh")
    elif kind == "xdmf":
        mesh = box_body(size=(1, 2, 1), cells=(2, 3, 2), comm=MPI.COMM_SELF).mesh
        with XDMFFile(MPI.COMM_SELF, str(folder / "body.xdmf"), "w") as file:
            file.write_mesh(mesh)


def make_body(kind: str, folder: Path, comm: MPI.Comm) -> Body:
    if kind == "box":
        return box_body(size=(1, 2, 1), cells=(2, 3, 2), comm=comm)
    if kind == "rectangle":
        return rectangle_body(size=(1, 2), cells=(3, 4), comm=comm)
    return read_body(folder / f"body.{kind}", comm=comm)


@pytest.mark.parametrize("kind", MESHES)
def test_a_mesh_has_one_fingerprint(kind: str, folder: Path) -> None:
    """On any number of ranks: cells keep their numbers, and corners their places in a cell."""
    on_root(WORLD, lambda: write_mesh(kind, folder))
    found = [on_ranks(n, lambda c: fingerprint(make_body(kind, folder, c))) for n in SIZES]
    assert all(one == found[0] for one in found)


def test_another_mesh_has_another_fingerprint() -> None:
    """Also where a place moves by one bit, and where two cells change their numbers."""
    body = box_body(size=(1, 2, 1), cells=(2, 3, 2))
    before, x = fingerprint(body), body.mesh.geometry.x
    x[np.all(x == [1, 2, 1], axis=1), 0] = np.nextafter(1, 2)
    after = fingerprint(body)
    assert after["geometry"] != before["geometry"]
    assert {**after, "geometry": before["geometry"]} == before
    other = fingerprint(box_body(size=(2, 1, 1), cells=(3, 2, 2)))
    assert other["cells"] == before["cells"]
    assert other["geometry"] != before["geometry"]


# --- fields ---


def shape(x: np.ndarray) -> np.ndarray:
    """A vector at places of shape (3, n), with no symmetry."""
    return np.stack([np.sin(x[0] + 2 * x[1]), x[0] * x[1] - x[2], np.cos(3 * x[2] + x[0])])


def functions(body: Body, *, filled: bool) -> dict[str, fem.Function]:
    """Functions of all kinds of spaces that solvers have; of a place, or empty."""
    d = body.dim
    problem = Problem(
        body, NeoHookeanSplit(mu=1e5, nu=0.5), degree=2, formulation="mixed", supports=[]
    )
    spaces = {
        "linear": fem.functionspace(body.mesh, ("Lagrange", 1, (d,))),
        "quadratic": fem.functionspace(body.mesh, ("Lagrange", 2, (d,))),
        "cells": fem.functionspace(body.mesh, ("DG", 0)),
        "history": fem.functionspace(body.mesh, ("DG", 1, (6,))),
    }
    found = {name: fem.Function(V) for name, V in spaces.items()} | {"mixed": problem.w}
    if filled:
        for name, function in found.items():
            if name == "mixed":
                function.sub(0).interpolate(lambda x: shape(x)[:d])
                function.sub(1).interpolate(lambda x: shape(x)[0] + 7)
            elif name == "history":
                function.interpolate(lambda x: np.concatenate([shape(x), 2 * shape(x)]))
            else:
                function.interpolate(lambda x, name=name: shape(x)[: 1 if name == "cells" else d])
            function.x.scatter_forward()
    return found


@pytest.mark.parametrize("kind", MESHES)
def test_fields_on_other_ranks(kind: str, folder: Path) -> None:
    """The values at all nodes, ghosts too: written on n ranks, read on m.

    What is read is what was written, to the bit; but which cell gives a node its place, up to
    round-off, is another one on other ranks, and so is its value here.  Nodes differ by far more.
    """
    on_root(WORLD, lambda: write_mesh(kind, folder))

    def write(comm: MPI.Comm) -> None:
        fields = functions(make_body(kind, folder, comm), filled=True)
        saved(comm, folder, RestartState(fields, {"a": [1.1, None], "b": {"c": "d"}}))

    def read(comm: MPI.Comm) -> float:
        body = make_body(kind, folder, comm)
        empty, full = functions(body, filled=False), functions(body, filled=True)
        found = newest_checkpoint(comm, folder)
        assert found is not None
        found.fill(empty)
        assert found.numbers == {"a": [1.1, None], "b": {"c": "d"}}
        off = [np.abs(empty[name].x.array - full[name].x.array).max() for name in full]
        return float(comm.allreduce(max(off), op=MPI.MAX))

    for n in SIZES:
        on_ranks(n, write)
        assert max(on_ranks(m, read) for m in SIZES) < 1e-14


def test_merged_nodes(folder: Path) -> None:
    """A periodic body has unknowns that are owned by any rank with one of their nodes."""
    pairs = [["left", "right"], ["bottom", "top"]]

    def problem(comm: MPI.Comm) -> Problem:
        return Problem(
            rectangle_body(size=(1, 1), cells=(3, 4), comm=comm),
            NeoHookeanSplit(mu=1e5, nu=0.5),
            degree=2,
            formulation="mixed",
            periodic=Periodic(pairs=pairs, gradient=[[1.1, 0], [0, "free"]]),
        )

    def fill(problem: Problem) -> None:
        wave = np.array([[2 * np.pi], [4 * np.pi], [0]])
        problem.u.interpolate(lambda x: np.stack([np.sin(wave[0] * x[0]), np.cos(wave[1] * x[1])]))
        problem.unknowns.u_to_w()

    def write(comm: MPI.Comm) -> None:
        fill(whole := problem(comm))
        saved(comm, folder, RestartState({"w": whole.w}))

    def read(comm: MPI.Comm) -> float:
        fill(whole := problem(comm))
        known = whole.u.x.array.copy()
        whole.w.x.array[:] = 0
        found = newest_checkpoint(comm, folder)
        assert found is not None
        found.fill({"w": whole.w})
        whole.unknowns.w_to_u()
        return float(comm.allreduce(np.abs(whole.u.x.array - known).max(), op=MPI.MAX))

    for n in SIZES:
        on_ranks(n, write)
        # Images differ by the round-off of their places, whichever of them was taken last.
        assert max(on_ranks(m, read) for m in SIZES) < 1e-14


def test_files_are_independent_of_the_number_of_ranks(folder: Path) -> None:
    """All unknowns stand once, in the same order on any ranks, and each rank keeps a share."""

    def rows(comm: MPI.Comm) -> tuple[np.ndarray, int]:
        V = fem.functionspace(make_body("box", folder, comm).mesh, ("Lagrange", 2, (3,)))
        u, order = fem.Function(V), DofOrdering(V)
        u.interpolate(shape)
        parts = comm.allgather(order.rows(u).values)
        return np.concatenate(parts), max(map(len, parts))

    whole, most = zip(*(on_ranks(n, rows) for n in SIZES), strict=True)
    assert all(np.allclose(one, whole[0], rtol=0, atol=1e-14) for one in whole)
    # Nodes are named by the first of their cells, which are shared evenly.
    assert all(m <= 1.6 * len(whole[0]) / n for m, n in zip(most, SIZES, strict=True))


# --- what is on disk ---


def a_field(value: float = 1.0) -> fem.Function:
    body = rectangle_body(size=(1, 1), cells=(3, 3))
    u = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1, (2,))))
    u.x.array[:] = value
    return u


def names(folder: Path) -> list[str]:
    return on_root(WORLD, lambda: sorted(p.name for p in (folder / FOLDER).iterdir()))


def several(folder: Path, *steps: int, **keys: Any) -> tuple[Checkpoints, fem.Function]:
    """Checkpoints whose field has the step as its value."""
    u = a_field()
    run = RunDescription("x = 1", "", lambda: {"cells": 18}, {})
    to = Checkpoints(WORLD, folder, CheckpointSettings(**keys), run)
    for step in steps:
        u.x.array[:] = step
        to.save(
            State(step, step / 10, u, done=step / 10), RestartState({"u": u}, {"step": step}), []
        )
    return to, u


def test_the_mesh_has_its_fingerprint_from_the_first_checkpoint_on(folder: Path) -> None:
    """Making it takes time: a run without checkpoints has none, another one a single one."""
    made: list[int] = []

    def fingerprint() -> dict[str, int]:
        made.append(1)
        return {"cells": 18}

    u = a_field()
    run = RunDescription("x = 1", "", fingerprint, {})
    to = Checkpoints(WORLD, folder, CheckpointSettings(), run)
    assert not to.due(State(1, 0.1, u, done=0.1))
    assert not made
    for step in (1, 2):
        to.save(State(step, 0.1 * step, u, done=0.1 * step), RestartState({"u": u}, {}), [])
    assert len(made) == 1
    found = newest_checkpoint(WORLD, folder)
    assert found is not None
    assert found.content["mesh"] == {"cells": 18}


def step_found(folder: Path, u: fem.Function) -> int | None:
    """Step of the newest whole checkpoint, whose field and numbers belong together."""
    found = newest_checkpoint(WORLD, folder)
    if found is None:
        return None
    u.x.array[:] = np.nan
    found.fill({"u": u})
    numbers = found.numbers
    assert np.all(u.x.array == numbers["step"])
    return int(numbers["step"])


def test_the_newest_two_remain(folder: Path) -> None:
    to, u = several(folder, 1, 2, 3, 5)
    stems = ("step_000003", "step_000005")
    whole = [f"{stem}.{end}" for stem in stems for end in ("h5", "json")]
    assert names(folder) == ["case.toml", *whole]
    assert step_found(folder, u) == 5
    assert to.clear() == 2
    assert on_root(WORLD, lambda: list(folder.iterdir())) == []


def test_the_newest_one_remains(folder: Path) -> None:
    _, u = several(folder, 1, 2, keep=1)
    assert names(folder) == ["case.toml", "step_000002.h5", "step_000002.json"]
    assert step_found(folder, u) == 2


def test_checkpoints_cost_a_twentieth_at_most(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first after 10 s, then each 30 s; one that takes 4 s each 80 s, whatever the date."""
    clock = [1000.0]
    monkeypatch.setattr(checkpoints.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(checkpoints.time, "time", lambda: -1e9)  # set back
    monkeypatch.setattr(checkpoints, "sync", lambda path: clock.__setitem__(0, clock[0] + cost))
    cost, to, u = 0.0, *several(folder)
    times: list[float] = []
    for step in range(1, 60):
        clock[0] += 5.0
        cost = 4.0 if step > 20 else 0.0
        if to.due(State(step, step / 100, u, done=step / 100)):
            times.append(clock[0] - 1000.0)
            to.save(State(step, 0.0, u), RestartState({"u": u}, {}), [])
    gaps = np.diff([0.0, *times])
    assert gaps[0] == 10.0
    assert set(gaps[1:4]) == {30.0}
    paid = WORLD.bcast(gaps[-1])
    assert paid >= 80.0
    fixed, u = several(folder / "fixed", time=900.0)
    clock[0] += 890.0
    assert not fixed.due(State(1, 0.0, u))
    clock[0] += 20.0
    assert fixed.due(State(2, 0.0, u))


def flip(file: Path) -> None:
    """One bit in the midst of the field's values."""
    with h5py.File(file, "r+") as h5:
        h5["u"][7, 1] = np.nextafter(h5["u"][7, 1], 0)


def rewrite(file: Path, change: Callable[[str], str]) -> None:
    file.write_text(change(file.read_text()))


def of_another_format(text: str) -> str:
    return json.dumps({**json.loads(text), "format": 99})


STEP = "step_000005"
DAMAGES: dict[str, Callable[[Path], object]] = {
    "bit": lambda p: flip(p / f"{STEP}.h5"),
    "fields-cut": lambda p: os.truncate(p / f"{STEP}.h5", 99),
    "fields-gone": lambda p: (p / f"{STEP}.h5").unlink(),
    "numbers-cut": lambda p: os.truncate(p / f"{STEP}.json", 200),
    "numbers-changed": lambda p: rewrite(p / f"{STEP}.json", lambda t: t.replace(": 5,", ": 4,")),
    "numbers-empty": lambda p: (p / f"{STEP}.json").write_text(""),
    "other-format": lambda p: rewrite(p / f"{STEP}.json", of_another_format),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_checkpoint_is_passed_over(
    folder: Path, damage: str, caplog: pytest.LogCaptureFixture
) -> None:
    """And it is said; it never is taken for whole."""
    _, u = several(folder, 4, 5)
    on_root(WORLD, lambda: [DAMAGES[damage](folder / FOLDER), None][1])
    assert step_found(folder, u) == 4
    said = on_root(WORLD, lambda: caplog.text)
    assert "the checkpoint of step 5 is damaged" in said
    on_root(WORLD, (folder / FOLDER / "step_000004.h5").unlink)
    assert step_found(folder, u) is None


def test_the_damage_that_one_rank_sees_is_told_by_all(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each rank reads its own rows: those of the last one alone are unsafe here."""
    several(folder, 5)
    said: list[str] = []
    monkeypatch.setattr(checkpoints.log, "warning", lambda text, *of: said.append(text % of))
    if WORLD.rank == WORLD.size - 1:

        def refuse(*_: object) -> None:
            raise UnsafeHdf5Error("its array leads out of the file")

        monkeypatch.setattr(checkpoints.hdf5, "read", refuse)
    assert newest_checkpoint(WORLD, folder) is None
    assert len(said) == 1
    assert said[0].endswith(
        "(step_000005.h5 is not as it was written: its array leads out of the "
        "file): going back further"
    )
    assert WORLD.allgather(said) == [said] * WORLD.size


@pytest.mark.parametrize(("number", "which"), [(3, "an older"), (99, "a newer")])
def test_checkpoints_of_another_version_are_refused(folder: Path, number: int, which: str) -> None:
    """Format 3 had linear elements by default: it ended in "no field 'unknowns' of 81 values"."""

    def other(text: str) -> str:
        return json.dumps({**json.loads(text), "format": number})

    _, u = several(folder, 4, 5)
    on_root(WORLD, lambda: [rewrite(f, other) for f in (folder / FOLDER).glob("*.json")] and None)
    with pytest.raises(
        RestartError,
        match=rf"checkpoints: {which} version .* \(format {number}, this one knows \d+\).*; "
        "go on with that version, or compute the case anew",
    ):
        step_found(folder, u)


@pytest.fixture
def dying(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[int], None]]:
    """Makes the n-th change of the file system's names the last thing that a run does."""
    left = [10**9]

    def limited(self: Path, *args: Any, real: Any) -> Any:
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        return real(self, *args)

    for name in ("replace", "unlink"):
        real = getattr(Path, name)
        monkeypatch.setattr(Path, name, lambda s, *a, real=real, **k: limited(s, *a, real=real))

    def after(changes: int) -> None:
        left[0] = changes

    yield after
    left[0] = 10**9


@pytest.mark.parametrize("changes", range(6))
def test_killed_between_any_two_changes(
    folder: Path, dying: Callable[[int], None], changes: int
) -> None:
    """Fields and numbers of the newest are of one step, and the two last are never both gone."""
    if WORLD.size > 1:
        pytest.skip("one rank makes all changes")
    to, u = several(folder, 1, 2)
    dying(changes)
    died = False
    try:
        u.x.array[:] = 3
        to.save(State(3, 0.3, u, done=0.3), RestartState({"u": u}, {"step": 3}), [])
    except KeyboardInterrupt:
        died = True
    dying(10**9)
    # Two files get their names; then the two files of step 1 go.
    assert died == (changes < 4)
    assert step_found(folder, u) == (2 if changes < 2 else 3)


def test_a_full_disk_leaves_the_checkpoint_before(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run ends with an error, and can go on when there is room again."""
    to, u = several(folder, 1)
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr("shutil.disk_usage", lambda path: usage(1, 1, 10))
    with pytest.raises(OutputError, match=r"cannot write .*: no space left on device; make room"):
        to.save(State(2, 0.2, u, done=0.2), RestartState({"u": u}, {"step": 2}), [])
    assert step_found(folder, u) == 1


def test_another_solver_is_refused(folder: Path) -> None:
    _, u = several(folder, 1)
    found = newest_checkpoint(WORLD, folder)
    assert found is not None
    with pytest.raises(RestartError, match=r"it has no field 'velocity' of 16 values"):
        found.fill({"velocity": u})
    with pytest.raises(RestartError, match=r"it has no field 'u' of 18 values"):
        found.fill({"u": fem.Function(fem.functionspace(u.function_space.mesh, ("DG", 0)))})


def test_when_checkpoints_are_due(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By steps, by wall time on the clock of rank 0, when asked, and never at the end."""
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0] + 1e9 * WORLD.rank)
    u = a_field()

    def due(to: Checkpoints, step: int, asked: bool = False) -> bool:
        return to.due(State(step, 0.0, u, done=step / 10), asked=asked)

    def make(step: int = 0, **keys: Any) -> Checkpoints:
        return Checkpoints(
            WORLD, folder, CheckpointSettings(**keys), RunDescription("", "", dict, {}), step=step
        )

    by_step = make(every=3)
    assert [due(by_step, step) for step in range(11)] == [
        *(False, False, False, True, False, False, True, False, False, True, False)
    ]
    assert not due(make(every=3, step=4), 5)
    by_time = make(time="10 min")
    now[0] = 599.0
    assert not due(by_time, 1)
    now[0] = 600.0
    assert due(by_time, 2)
    assert not due(by_time, 10)
    assert due(make(), 1, asked=WORLD.rank == WORLD.size - 1)
    assert not due(make(off=True), 1, asked=True)
    assert total(WORLD, 0) == 0
