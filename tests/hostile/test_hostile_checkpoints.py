"""Checkpoints with right digests and hostile content: one message and code 2, never a traceback."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers.cube import cube
from helpers.decks import COMM, made, shared_folder
from mpi4py import MPI

from dolfin_elastic import Case, run
from dolfin_elastic.cli.app import guarded
from dolfin_elastic.results.checkpoint.checkpoints import FOLDER, FORMAT, digest
from dolfin_elastic.results.checkpoint.checksums import array_checksum
from dolfin_elastic.results.hdf5 import Rows

NAN, INF = float("nan"), float("inf")
COMMON = f"""\
{cube("neo-hookean", traction=1e3, more="density = 1000")}
[output]
formats = ["xdmf", "csv"]
"""
ANALYSES = {
    "statics": "[statics]\nsteps = 4\n",
    "arc": '[statics]\nmethod = "arc-length"\nfirst_step = 0.2\n',
    "implicit": "[dynamics]\nend = 0.1\ndt = 0.01\n",
    "explicit": '[dynamics]\nend = 0.1\nscheme = "central-differences"\n',
}

Content = dict[str, Any]


@cache
def stopped(analysis: str, folder: Path) -> Path:
    """A run that was stopped after its second state."""
    tables = tomllib.loads(COMMON + ANALYSES[analysis])
    case, results = Case.from_dict(tables, folder), folder / analysis
    with closing(run(case, output=results)) as states:
        for _, state in zip(range(3), states, strict=False):
            assert state.done < 1
    return results


@pytest.fixture(scope="module")
def originals() -> Iterator[Path]:
    with shared_folder() as folder:
        yield folder
        stopped.cache_clear()


def manifest(results: Path) -> Path:
    return max((results / FOLDER).glob("step_*.json"))


def content_of(results: Path) -> Content:
    return dict(json.loads(json.loads(manifest(results).read_text())["text"]))


def put(results: Path, content: object, text: str = "") -> None:
    """Writes the content with its right digest."""
    text = text or json.dumps(content)
    outer = {"format": FORMAT, "digest": digest(text), "text": text}
    manifest(results).write_text(json.dumps(outer))


def at(*path: str | int) -> Callable[[Content], Any]:
    def find(content: Content) -> Any:
        for key in path:
            content = content[key]  # type: ignore[index]
        return content

    return find


def edit(*path: str | int, to: object) -> Callable[[Path], None]:
    """Sets an entry of the content."""

    def change(results: Path) -> None:
        content = content_of(results)
        at(*path[:-1])(content)[path[-1]] = to
        put(results, content)

    return change


def drop(*path: str | int) -> Callable[[Path], None]:
    """Removes an entry of the content."""

    def change(results: Path) -> None:
        content = content_of(results)
        del at(*path[:-1])(content)[path[-1]]
        put(results, content)

    return change


def whole(content: object, text: str = "") -> Callable[[Path], None]:
    """Another content as a whole."""
    return lambda results: put(results, content, text)


def fields(change: Callable[[h5py.File], None]) -> Callable[[Path], None]:
    """Changes the HDF5 file, with the right shapes and checksums in the content afterwards."""

    def edited(results: Path) -> None:
        path = manifest(results).with_suffix(".h5")
        with h5py.File(path, "r+") as file:
            change(file)
            arrays = {}
            for name in file:
                plain = isinstance(file.get(name, getlink=True), h5py.HardLink)
                found = file[name] if plain else None
                values = found[()] if isinstance(found, h5py.Dataset) else None
                if isinstance(values, np.ndarray) and values.ndim == 2 and values.dtype == "f8":
                    arrays[name] = {
                        "shape": list(values.shape),
                        "sum": array_checksum(MPI.COMM_SELF, Rows(values, 0, len(values))),
                    }
        content = content_of(results)
        content["arrays"] = {**content["arrays"], **arrays}
        put(results, content)

    return edited


def replaced(name: str, **how: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[name]
        file.create_dataset(name, **how)

    return change


def nan_in(name: str) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        file[name][1, 0] = NAN

    return change


def longer(name: str) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        values = np.vstack([file[name][()], file[name][()]])
        del file[name]
        file[name] = values

    return change


def big_attribute(file: h5py.File) -> None:
    """An attribute is nothing that is read, however large."""
    for i in range(200):
        file["unknowns"].attrs[f"a{i}"] = np.zeros(7000)


def group(file: h5py.File) -> None:
    del file["unknowns"]
    file.create_group("unknowns")


def link(file: h5py.File) -> None:
    del file["unknowns"]
    file["unknowns"] = h5py.ExternalLink("/etc/other.h5", "/unknowns")


def as_pipe(results: Path) -> None:
    manifest(results).unlink()
    os.mkfifo(results / FOLDER / "step_000002.json")


GENERAL: dict[str, Callable[[Path], None]] = {
    "a list": whole([1, 2]),
    "a number": whole(7),
    "null": whole(None),
    "empty": whole({}),
    "deep": whole(None, "[" * 100_000),
    "no JSON": whole(None, "{"),
    "step is text": edit("step", to="two"),
    "step is negative": edit("step", to=-3),
    "step is broken": edit("step", to=1.5),
    "step is true": edit("step", to=True),
    "step is huge": edit("step", to=10**400),
    "no step": drop("step"),
    "t is NaN": edit("t", to=NAN),
    "t is text": edit("t", to="0.5"),
    "t is infinite": edit("t", to=INF),
    "done is null": edit("done", to=None),
    "done is above 1": edit("done", to=7.0),
    "no done": drop("done"),
    "written is a number": edit("written", to=5),
    "file is a list": edit("file", to=["case.toml"]),
    "file with NUL": edit("file", to="a\0b"),
    "case is a number": edit("case", to=1),
    "case_text is a number": edit("case_text", to=3),
    "no mesh": drop("mesh"),
    "mesh is a list": edit("mesh", to=[]),
    "mesh of another body": edit("mesh", "cells", to=9),
    "petsc is a list": edit("petsc", to=["a"]),
    "petsc of lists": edit("petsc", to={"ksp_rtol": [1]}),
    "arrays is a list": edit("arrays", to=[]),
    "no arrays": drop("arrays"),
    "arrays of texts": edit("arrays", to={"unknowns": "x"}),
    "array without a shape": edit("arrays", to={"unknowns": {"sum": "0"}}),
    "negative shape": edit("arrays", to={"unknowns": {"shape": [-8, 3], "sum": "0"}}),
    "huge shape": edit("arrays", to={"unknowns": {"shape": [10**15, 3], "sum": "0"}}),
    "flat shape": edit("arrays", to={"unknowns": {"shape": [], "sum": "0"}}),
    "shape of texts": edit("arrays", to={"unknowns": {"shape": ["8", "3"], "sum": "0"}}),
    "numbers is a list": edit("numbers", to=[]),
    "numbers is null": edit("numbers", to=None),
    "no numbers": drop("numbers"),
    "outputs is null": edit("outputs", to=None),
    "outputs are too few": edit("outputs", to=[]),
    "outputs of numbers": edit("outputs", to=[1, 2, 3, 4, 5]),
    "output without frames": edit("outputs", 0, to={"taken": 1}),
    "output of negative frames": edit("outputs", 0, "frames", to=-2),
    "output of texts": edit("outputs", 0, "frames", to="many"),
    "output of NaN": edit("outputs", 0, "frames", to=NAN),
    "a pipe": as_pipe,
}
FIELDS: dict[str, Callable[[Path], None]] = {
    "missing": fields(lambda file: file.__delitem__("unknowns")),
    "a group": fields(group),
    "integers": fields(replaced("unknowns", data=np.zeros((8, 3), "i8"))),
    "single precision": fields(replaced("unknowns", data=np.zeros((8, 3), "f4"))),
    "complex": fields(replaced("unknowns", data=np.zeros((8, 3), "c16"))),
    "texts": fields(replaced("unknowns", data=np.full((8, 3), b"1.0"))),
    "texts of any length": fields(replaced("unknowns", data=np.full((8, 3), "1", dtype=object))),
    "references": fields(replaced("unknowns", shape=(8, 3), dtype=h5py.ref_dtype)),
    "pairs": fields(replaced("unknowns", shape=(8, 3), dtype=np.dtype([("a", "f8")]))),
    "three dimensions": fields(replaced("unknowns", data=np.zeros((8, 3, 2)))),
    "one dimension": fields(replaced("unknowns", data=np.zeros(24))),
    "a scalar": fields(replaced("unknowns", data=1.0)),
    "empty": fields(replaced("unknowns", data=h5py.Empty("f8"))),
    "no rows": fields(replaced("unknowns", data=np.zeros((0, 3)))),
    "more columns": fields(replaced("unknowns", data=np.zeros((8, 4)))),
    "twice as long": fields(longer("unknowns")),
    "NaN": fields(nan_in("unknowns")),
    "giant": fields(
        replaced("unknowns", shape=(1 << 30, 3), dtype="u1", chunks=(1 << 20, 3), compression=9)
    ),
    "external link": fields(link),
    "external storage": fields(
        replaced("unknowns", shape=(8, 3), dtype="f8", external=[("/etc/passwd", 0, 192)])
    ),
}


MAY_LACK = (
    *("before", "scalars", "remaining", "audit__resolution", "lookout__violations"),
    *("arc", "arc__newton"),
)
"""What has a default, or is not needed."""


def numbers(**keys: object) -> dict[str, Callable[[Path], None]]:
    """Each key, with dots between levels, set to a value or to several."""
    found = {}
    for name, values in keys.items():
        path = ("numbers", *name.split("__"))
        for value in values if isinstance(values, list) else [values]:
            found[f"{name} = {str(value)[:20]!r}"] = edit(*path, to=value)
        if name not in MAY_LACK:
            found[f"no {name}"] = drop(*path)
    return found


WRONG: list[object] = ["x", None, NAN, -1, {}, [[]]]
STATICS = numbers(
    t=["x", None, NAN, -1.0, {}, [1]],
    scalars=["x", None, {}, ["a"]],
    sizes__size=["x", None, NAN, -1.0, 0.0, {}],
    sizes__calm=["x", None, -5, 1.5],
    sizes=["x", None, []],
    jumps=["x", None, -1, 1.5, {}],
    limits=["x", None, 3, ["a"], [NAN], [0.5], [[1, 2, 3]]],
    newton__stiffest=["x", {}, [1], NAN],
    newton__linear=[3, None, {}],
    newton=[None, [], "x"],
    count=["x", None, -1, 1.5],
    audit__work=["x", None, {}],
    audit__warned=["x", None, 3, {"a": 3}, {"a": {"b": 1}}, {"a": {}}],
    audit__unbalanced=["x", 7, None],
    audit__far=[3, None],
    audit__energy=["x", None],
    audit=[None, [], 3],
    speed=["x", -1.0, {}],
    before=["x", 3, {}, {"t": 0.1}, {"t": "x", "scalars": []}],
)
ARC = numbers(
    arc__size=["x", None, NAN, -1.0],
    arc__lead=["x", None, [1.0] * 5],
    arc__limits=["x", None, 3, [1], [[1, 2, 3]], [["a", "b"]]],
    arc__slope=["x", None, [1.0]],
    arc__negative=["x", -1, 1.5, [1]],
    arc__newton=["x", None, []],
    arc=["x", 3, [1]],
)
IMPLICIT = numbers(
    t=WRONG,
    step=["x", None, -1, 1.5, {}],
    dt=["x", None, NAN, -1.0, 0.0],
    scale=["x", {}, NAN],
    ledger=["x", None, []],
    ledger__scale=["x", {}, [1]],
    ledger__initial=["x", {}, [1]],
    audit=["x", None, []],
    audit__worst=["x", None, 3, [1], ["a"]],
    audit__reasons=["x", None, 3, {"a": 1}],
    audit__chords=["x", None, 3, [], ["a", 1]],
    audit__resolution=["x", 3, []],
    newton=["x", None, []],
)
EXPLICIT = numbers(
    t=WRONG,
    step=["x", None, -1, 1.5, {}],
    remaining=["x", {}, NAN],
    every=["x", None, -1, 0, -0.5],
    work=["x", {}, NAN],
    lookout=["x", None, []],
    lookout__states=["x", None, -1],
    lookout__first=["x", None, 3, [1.0], ["a", "b"]],
    lookout__violations=["x", 3, {"a": 1}],
    lookout__most=["x", {}],
    lookout__place=["x", 3, ["a"]],
    square=["x", None, NAN, -1.0, 0.0],
    known_square=["x", None, NAN, -1.0],
    found_at=["x", None, -1],
    interval=["x", None, -1, 1.5],
    due=["x", None, -1],
)
HOSTILE: Mapping[str, Mapping[str, Callable[[Path], None]]] = {
    "statics": {**GENERAL, **{f"unknowns: {k}": v for k, v in FIELDS.items()}, **STATICS},
    "arc": ARC,
    "implicit": IMPLICIT,
    "explicit": EXPLICIT,
}
EVERY = [(analysis, kind) for analysis, kinds in HOSTILE.items() for kind in kinds]


def test_there_are_enough() -> None:
    assert len(GENERAL) + len(FIELDS) >= 60 and len(EVERY) >= 250


@pytest.mark.sample(12)
@pytest.mark.parametrize(("analysis", "kind"), EVERY)
def test_hostile_content(
    originals: Path,
    folder: Path,
    analysis: str,
    kind: str,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The older checkpoint is not gone back to: there is none."""
    original, results = stopped(analysis, originals), folder / "r"
    made(lambda: shutil.copytree(original, results))
    made(lambda: HOSTILE[analysis][kind](results))
    monkeypatch.setattr(sys, "argv", ["dolfin-elastic", "restart", str(results)])
    capfd.readouterr()
    signal.alarm(20)  # a hang is a fault, too
    code = guarded()
    signal.alarm(0)
    said = capfd.readouterr().err
    assert code == 2, said
    assert "Traceback" not in said and "HDF5-DIAG" not in said
    assert COMM.rank or (said.count("error:") == 1 and str(results) in said)


def test_what_does_no_harm(originals: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Further entries, further arrays and attributes: the run goes on to its end."""
    original, results = stopped("statics", originals), folder / "r"

    def change() -> None:
        shutil.copytree(original, results)
        with h5py.File(manifest(results).with_suffix(".h5"), "r+") as file:
            file["more"] = np.zeros((4, 4))
            big_attribute(file)
        edit("more", to={"a": [1]})(results)
        edit("numbers", "more", to="x")(results)

    made(change)
    monkeypatch.setattr(sys, "argv", ["dolfin-elastic", "restart", str(results)])
    assert guarded() == 0
    assert json.loads((results / "summary.json").read_text())["status"] == "completed"
