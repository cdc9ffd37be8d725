"""Records over time: integrals to round-off, files with their units, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dolfin_elastic import Case, Support
from dolfin_elastic.case.check.plausibility import _record_notes
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.loads import LOADS
from dolfin_elastic.model.records import GRAVITY, RecordFormula
from dolfin_elastic.model.values import component, components

ROWS = [[0.1, 0.5], [0.3, 2.0], [0.35, -3.0], [1.1, 0.25]]
UNITS = ("m", "m/s", "m/s^2")


def integral(times: np.ndarray, order: int) -> np.ndarray:
    """Of the record from rest, by polynomials on each piece between rows."""
    starts, result = np.zeros(3), []
    pieces = []
    for (t0, a0), (t1, a1) in zip(ROWS, ROWS[1:], strict=False):
        line = np.polynomial.Polynomial([a0, (a1 - a0) / (t1 - t0)])
        both = [line, line.integ(k=starts[1]), line.integ(2, k=[starts[1], starts[2]])]
        pieces.append((t0, t1, both))
        starts = np.array([p(t1 - t0) for p in both])
    for t in times:
        here = [both[order](t - t0) for t0, t1, both in pieces if t0 <= t <= t1]
        beyond = [0.0, starts[1], starts[2] + starts[1] * (t - ROWS[-1][0])][order]
        result.append(here[0] if here else 0.0 if t < ROWS[0][0] else beyond)
    return np.array(result)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_integrals_are_exact(order: int) -> None:
    """Straight lines between rows have integrals that are polynomials of the second and third."""
    record = component({"table": ROWS}, UNITS[2 if order == 0 else order], integrals=order)
    times = np.linspace(0.0, 1.5, 211)
    assert isinstance(record, RecordFormula)
    found = record.evaluate(x=0.0, y=0.0, z=0.0, t=times)
    np.testing.assert_allclose(found, integral(times, order), rtol=1e-12, atol=1e-14)
    assert record.evaluate(t=0.3) == pytest.approx(integral(np.array([0.3]), order)[0], rel=1e-12)


def test_a_force_holds_outside_of_its_rows() -> None:
    record = component({"table": ROWS, "unit": "kN"}, "N")
    assert isinstance(record, RecordFormula)
    assert [record.evaluate(t=t) for t in (0.0, 0.2, 9.0)] == pytest.approx([500, 1250, 250])
    acceleration = component({"table": ROWS, "unit": "g"}, "m/s^2")
    assert isinstance(acceleration, RecordFormula)
    found = [acceleration.evaluate(t=t) for t in (0.0, 0.3, 9.0)]
    assert found == pytest.approx([0, 2 * GRAVITY, 0])


def case(folder: Path, *, load: Any = None, support: Any = None, dt: float = 0.01) -> Case:
    tables: dict[str, Any] = {
        "mesh": {"rectangle": {"size": [1, 1], "cells": [1, 1]}, "degree": 1},
        "materials": {"one": {"law": "linear-elastic", "E": "1 MPa", "nu": 0.3, "density": 1000.0}},
        "support": [support or {"on": "left"}],
        "load": [load or {"kind": "gravity", "value": [0, -9.81]}],
        "dynamics": {"end": 2.0, "dt": dt},
    }
    return Case.from_dict(tables, folder)


def test_files_are_read_with_the_case(folder: Path) -> None:
    """Each component from a column of its own; the case is written back as it was."""
    (folder / "quake.csv").write_text("t,ax,ay\n0,0,1\n0.5,2,3\n1.5,-1.0,0\n")
    ax, ay = ({"file": "quake.csv", "time": "t", "value": f"a{c}", "unit": "g"} for c in "xy")
    made = case(
        folder,
        load={"kind": "base-acceleration", "value": [ax, ay]},
        support={"on": "left", "acceleration": [ax, 0]},
    )
    (load,), (support,) = made.load, made.support
    assert [v.evaluate(t=0.5) for v in load.values] == pytest.approx([2 * GRAVITY, 3 * GRAVITY])
    assert isinstance(support, Support)
    assert support.values[0].evaluate(t=0.5) == pytest.approx(GRAVITY * 0.5**2 * 2 / 6)
    tables = made.to_dict()
    assert tables["load"][0]["value"] == [ax, ay]
    assert tables["support"][0]["acceleration"] == [ax, 0]
    assert "record 'quake.csv'" in str(load.values[0])


def test_a_force_on_an_edge_keeps_its_record(folder: Path) -> None:
    (folder / "cell.csv").write_text("0; 0\n1; 2\n")
    row = {"kind": "force", "on": "top", "value": [{"file": "cell.csv", "unit": "kN"}, 0]}
    (force,) = case(folder, load=row).load
    assert force.on_kind("edge").values[0].evaluate(t=0.5) == pytest.approx(1000)


def test_drift_and_long_steps_are_noted(folder: Path) -> None:
    (folder / "quake.csv").write_text("0,0\n0.1,1\n0.2,0\n")
    record = {"file": "quake.csv"}
    made = case(folder, support={"on": "left", "acceleration": [record, "free"]}, dt=0.2)
    notes = list(_record_notes(made))
    assert "ends with a velocity of 0.1 m/s along x, displaced by 0.01 m" in notes[0]
    assert "dynamics.dt is 0.2 s, but the rows of the record 'quake.csv' are 0.1 s" in notes[1]
    held = {"table": [[0, 0], [0.1, 1], [0.3, -1], [0.4, 0]], "unit": "g"}
    calm = case(folder, support={"on": "left", "acceleration": [held, 0]})
    assert list(_record_notes(calm)) == []


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"acceleration": [{"file": "none.csv"}, 0]}, r"acceleration\[0\]: none.csv: there is no"),
        ({"acceleration": [{"file": "a.csv", "value": "b"}, 0]}, "no headings"),
        ({"acceleration": [{"file": "a.csv", "unit": "m"}, 0]}, r"acceleration\[0\].*unit"),
        ({"acceleration": [{"file": "back.csv"}, 0]}, "must increase"),
        ({"acceleration": [{"table": [[-1, 0], [1, 2]]}, 0]}, "begins at -1 s"),
        ({"acceleration": [{"unit": "g"}, 0]}, "needs a file or a table"),
        ({"acceleration": [{"field": "p"}, 0]}, "cannot stand here"),
        ({"acceleration": [{"fiel": "p"}, 0]}, "fiel"),
        ({"acceleration": [1.0, 0]}, "is not a record over time"),
        ({"acceleration": ["t", 0]}, "is not a record over time"),
        ({"acceleration": [0, 0], "velocity": [0, 0]}, "given together"),
        ({"acceleration": [{"file": "a.csv"}, 0, 0]}, ""),
    ],
)
def test_what_is_no_record_is_refused(folder: Path, keys: dict[str, Any], said: str) -> None:
    (folder / "a.csv").write_text("0,0\n1,2\n")
    (folder / "back.csv").write_text("0,0\n1,2\n0.5,1\n")
    if not said:
        with pytest.raises(InputError, match="3 components given"):
            case(folder, support={"on": "left", **keys}).support[0].values_in(2)  # type: ignore[attr-defined]
        return
    with pytest.raises(InputError, match=said):
        case(folder, support={"on": "left", **keys})


def test_python_gives_tables() -> None:
    """A file is read with a case only; a base moves as one."""
    (value, _) = components([{"file": "a.csv"}, 0], "N")
    with pytest.raises(InputError, match="has not been read"):
        value.evaluate(t=0.0)  # type: ignore[union-attr]
    with pytest.raises(InputError, match="a base moves as one"):
        LOADS["base-acceleration"](value=["x", 0])
