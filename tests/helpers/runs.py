"""A small case that is killed and restarted, and the comparison of the files of two runs."""

from __future__ import annotations

import csv
import json
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import (
    Case,
    restart,
    run,
)
from dolfin_elastic.core.parallel import on_root

WORLD = MPI.COMM_WORLD
NEAR = 1e-9
"""Difference that rows of two runs may have, over the size of their numbers.

Both take the same Newton steps from the same state to 16 digits, but for forces that are summed in
another order; equilibria are found to 1e-8 of the forces or, by the last quadratic step, far below.
"""


def sizes(rows: list[dict[str, Any]]) -> dict[str, float]:
    """How large the numbers of each column are; components and shares of one thing together."""
    groups: dict[str, float] = {}
    for one in rows:
        for name, value in one.items():
            if isinstance(value, float) and np.isfinite(value):
                group = _group(name)
                groups[group] = max(groups.get(group, 0.0), abs(value))
    return groups | {"balance": 1.0, "jacobian": 1.0}


def _group(name: str) -> str:
    for part in ("balance", "jacobian", "reaction", "moment", "energy", "work"):
        if part in name:
            return {"work": "energy"}.get(part, part)
    return name.rstrip("xyz0123456789")


def check_same(
    found: list[dict[str, Any]],
    known: list[dict[str, Any]],
    near: float = NEAR,
    but: Sequence[str] = (),
) -> None:
    """Row by row and column by column; counts and words exactly, but for what is left out."""
    assert [list(one) for one in found] == [list(one) for one in known]
    scale = sizes(known)
    for one, other in zip(found, known, strict=True):
        for name, value in other.items():
            if isinstance(value, float) and name not in ("newton", "krylov"):
                off = abs(one[name] - value)
                assert off <= near * scale[_group(name)] or np.isnan(value), (one["step"], name)
            elif name not in but:
                assert one[name] == value, (one["step"], name, one[name], value)


class Killed(BaseException):
    """Ends a run abruptly, as a signal that cannot be caught."""


def case(**tables: Any) -> Case:
    """A strip of rubber, bent far in automatic steps, with a checkpoint of each."""
    whole: dict[str, Any] = {
        "title": "A strip",
        "mesh": {"rectangle": {"size": [1, 0.2], "cells": [5, 1]}, "degree": 2},
        "materials": {"rubber": {"law": "neo-hookean", "E": "1 MPa", "nu": 0.3}},
        "support": [{"on": "left"}],
        "load": [{"kind": "traction", "on": "right", "value": [0, "-8 kPa"]}],
        "statics": {"max_step": 0.2},
        "output": {"probes": {"tip": [1, 0.1]}, "checkpoint": {"every": 1}},
    }
    return Case.from_dict({**whole, **tables})


def begun(case: Case, folder: Path, steps: int, **keys: Any) -> None:
    """Computes some steps; the run is killed once it has yielded the last of them."""
    states = run(case, output=folder, **keys)
    while next(states).step < steps:
        pass
    kill(states)


def kill(states: Any) -> None:
    with pytest.raises(Killed):
        states.throw(Killed())


def finished(folder: Path) -> list[int]:
    """Restarts the run and completes it; numbers of the steps computed."""
    return [state.step for state in restart(folder)]


def history(folder: Path) -> list[dict[str, Any]]:
    """The rows of history.csv as numbers, on every rank."""

    def read() -> list[dict[str, Any]]:
        text = (folder / "history.csv").read_text()
        return [{k: _number(v) for k, v in one.items()} for one in csv.DictReader(text.split("\n"))]

    return on_root(WORLD, read)


def _number(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text


def summary(folder: Path) -> dict[str, Any]:
    return on_root(WORLD, lambda: json.loads((folder / "summary.json").read_text()))


def frames(folder: Path) -> list[tuple[str, str, np.ndarray]]:
    """Name, time and displacements of each step as ParaView reads them; rank 0 alone."""
    found = []
    for grid in ET.parse(folder / "results.xdmf").getroot().findall("./Domain/Grid/Grid"):
        points = _data(folder, grid.find("Geometry/DataItem"))
        field = _data(folder, grid.find("Attribute[@Name='displacement']/DataItem"))
        assert len(points) == len(field)
        order = np.lexsort(np.round(points.T, 9))
        found.append((grid.get("Name"), grid.find("Time").get("Value"), field[order]))
    return found


def _data(folder: Path, item: Any) -> np.ndarray:
    file, name = item.text.split(":")
    with h5py.File(folder / file, "r") as h5:
        assert h5[name].shape == tuple(map(int, item.get("Dimensions").split()))
        return h5[name][:]


def check_same_frames(folder: Path, known: Path) -> None:
    found, wanted = frames(folder), frames(known)
    assert [name for name, _, _ in found] == [name for name, _, _ in wanted]
    for (_, t, u), (_, s, v) in zip(found, wanted, strict=True):
        assert float(t) == pytest.approx(float(s), rel=1e-12)
        assert np.allclose(u, v, rtol=0, atol=NEAR)
    files = {p.name for p in (folder / "results_data").iterdir()}
    assert {p.name for p in (known / "results_data").iterdir()} <= files
