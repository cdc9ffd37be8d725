"""Forces on the nodes of sets, as decks of CalculiX and FreeCAD have them, through whole runs."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import Case, run
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.types import FloatArray, IntArray

COMM = MPI.COMM_WORLD


def brick() -> tuple[FloatArray, IntArray]:
    """Six 10-node tetrahedra in the cube of 10 mm, about its diagonal."""
    x = np.array(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
    )
    rows = [[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]]
    cells = np.array(rows)
    pairs = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
    ends = np.sort(cells[:, pairs].reshape(-1, 2), axis=1)
    unique, where = np.unique(ends, axis=0, return_inverse=True)
    middles = len(x) + where.reshape(len(cells), 6)
    nodes = np.concatenate([x, x[unique].mean(axis=1)])
    return 10.0 * nodes, np.concatenate([cells, middles], axis=1)


def numbers(rows: IntArray) -> str:
    return ",\n".join(str(row + 1) for row in rows) + "\n"


def deck() -> str:
    """Sets as FreeCAD writes them: the fixed face, the corners and the midside nodes of the top."""
    x, cells = brick()
    top = np.flatnonzero(x[:, 2] == 10.0)
    corners, middles = top[top < 8], top[top >= 8]
    text = "*NODE, NSET=Nall\n"
    text += "".join(f"{i + 1}, {a:g}, {b:g}, {c:g}\n" for i, (a, b, c) in enumerate(x))
    text += "*ELEMENT, TYPE=C3D10, ELSET=Evolumes\n"
    text += "".join(f"{i + 1}, {', '.join(str(n + 1) for n in c)}\n" for i, c in enumerate(cells))
    text += "*NSET, NSET=FemConstraintFixed\n" + numbers(np.flatnonzero(x[:, 2] == 0.0))
    text += "*NSET, NSET=corners\n" + numbers(corners)
    text += "*NSET, NSET=middles\n" + numbers(middles)
    return text + "*NSET, NSET=oneCorner\n" + numbers(np.array([6]))


def test_consistent_loads_of_a_deck_are_a_traction(folder: Path) -> None:
    """On a face of 6-node triangles a uniform traction loads midside nodes only, by A/3 each side.

    Node by node it is then the traction itself; the reaction is that of both, and a force on one
    corner, through the whole of a run.
    """
    on_root(COMM, lambda: (folder / "part.inp").write_text(deck()))
    x, _ = brick()
    top = {tuple(node) for node in x[8:] if node[2] == 10.0}
    inside = [node for node in top if 0 < node[0] < 10 and 0 < node[1] < 10]
    assert len(top) == 5
    assert len(inside) == 1  # on the diagonal, where two triangles meet
    base = {
        "mesh": {"file": "part.inp", "unit": "mm", "degree": 2},
        "materials": {"steel": {"law": "linear-elastic", "E": "210 GPa", "nu": 0.3}},
        "support": [{"on": "FemConstraintFixed", "name": "fixed"}],
        "statics": {"steps": 1},
        "output": {"fields": [], "probes": {"tip": {"on": "oneCorner"}, "lid": {"on": "corners"}}},
    }
    traction = {"kind": "traction", "on": "top", "value": [0, 0, "6 MPa"]}
    nodal = [
        {"kind": "point-force", "on": "middles", "value": [0, 0, "100 N"]},
        {"kind": "point-force", "at": ["5 mm", "5 mm", "10 mm"], "value": [0, 0, "100 N"]},
    ]
    surfaces = {"top": {"plane": "z", "at": "max"}}
    found = []
    for name, load in (("traction", [traction]), ("nodal", nodal)):
        case = Case.from_dict({**base, "surfaces": surfaces, "load": load}, folder)
        list(run(case, output=folder / name))
        (line,) = on_root(COMM, lambda n=name: _last(folder / n / "history.csv"))
        found.append(line)
    for one, two in zip(*(sorted(line.items()) for line in found), strict=True):
        if one[0].startswith(("tip", "lid", "reaction")):
            assert float(one[1]) == pytest.approx(float(two[1]), rel=1e-9, abs=1e-13)
    assert float(found[1]["reaction_fixed_z"]) == pytest.approx(-600.0, rel=1e-9)
    assert float(found[1]["tip_z"]) > 0


def _last(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))[-1:]
