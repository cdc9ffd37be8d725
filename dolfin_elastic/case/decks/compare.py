"""`compare`: finished runs of a deck beside the results of another program."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dolfin_elastic.case.decks.deck import Deck
from dolfin_elastic.case.decks.reading import Nodes
from dolfin_elastic.case.decks.references import Reference, Table
from dolfin_elastic.case.decks.units import System
from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import to_si

_SAME_PLACE = 1e-4
"""Distance over the size of the body up to which nodes are the same: `.frd` has six digits."""


@dataclass(frozen=True)
class Row:
    """One line of the comparison, in units of the deck.

    Attributes:
        what: What is compared.
        ours: Number of this program.
        theirs: That of the other one.
        difference: Largest difference, over the largest number of theirs.
        remark: How many values, or where.
    """

    what: str
    ours: float
    theirs: float
    difference: float
    remark: str = ""


def compare(
    folders: list[Path], reference: Reference, deck: Deck, nodes: Nodes, system: System
) -> list[Row]:
    """Compares runs, in the order of their steps. Not collective.

    Args:
        folders: Of the results of each analysis.
        deck: Whose supports the reactions are those of.
        nodes: Its nodes by their numbers, as results name them.
        system: Units of the deck.

    Raises:
        MeshError: Nothing fits.
    """
    metres, rows = to_si(f"1 {system.units['length']}", "m"), list[Row]()
    states = [folder for folder in folders if (folder / "results.xdmf").is_file()]
    for folder, table in zip(states, _last(reference.displacements, len(states)), strict=False):
        rows += _displacements(folder, table, reference.points or nodes.places, metres)
    newton = to_si(f"1 {system.units['force']}", "N")
    for folder, table in zip(states, _last(reference.forces, len(states)), strict=False):
        rows += _reactions(folder, table, _supported(deck, nodes), newton)
    modal = [folder for folder in folders if (folder / "modes.csv").is_file()]
    hertz = to_si(f"1 {system.units['frequency']}", "Hz")
    for folder, theirs in zip(modal, reference.modes, strict=False):
        rows += _modes(folder, theirs, hertz)
    if not rows:
        raise MeshError("the results have nothing of what the runs have", where="--compare")
    return rows


def _last(tables: list[Table], count: int) -> list[Table]:
    """A table for each run: the last one of one run, else as many as there are."""
    if len(tables) < count or not count:
        return tables
    return tables[-1:] if count == 1 else tables[:: max(len(tables) // count, 1)][:count]


def _displacements(
    folder: Path,
    table: Table,
    places: Mapping[int, Sequence[float] | FloatArray],
    metres: float,
) -> Iterator[Row]:
    from scipy.spatial import cKDTree

    from dolfin_elastic.results.exports.moving import mesh_of, nodal
    from dolfin_elastic.results.finished.run import FinishedRun

    run = FinishedRun(folder)
    x, u = mesh_of(run)[0] / metres, nodal(run, -1, "displacement") / metres
    pairs = [
        (places[node], vector)
        for node, vector in zip(table.nodes, table.vectors, strict=True)
        if node in places
    ]
    if not pairs:
        return
    at, theirs = np.array([p for p, _ in pairs]), np.array([v for _, v in pairs])
    width = x.shape[1]
    distance, nearest = cKDTree(x).query(at[:, :width])
    there = distance <= _SAME_PLACE * float(np.ptp(x, axis=0).max())
    if not there.any():
        return
    theirs = theirs[there, : u.shape[1]]
    known = ~np.isnan(theirs).any(axis=0)
    if not known.any():
        return
    ours, theirs = u[nearest[there]][:, known], theirs[:, known]
    largest = float(np.linalg.norm(theirs, axis=1).max())
    gap = np.linalg.norm(ours - theirs, axis=1)
    remark = f"{int(there.sum())} nodes of {len(table.nodes)}"
    if not known.all():
        names = [f"u{axis}" for axis, given in zip("xyz", known, strict=False) if given]
        remark += f", {' and '.join(names)} alone"
    mine = float(np.linalg.norm(ours, axis=1).max())
    yield Row("largest displacement", mine, largest, float(gap.max()) / (largest or 1.0), remark)


def _supported(deck: Deck, nodes: Nodes) -> set[int]:
    """Numbers of the nodes of all supports."""
    names = {str(entry.keys.get("on")) for step in deck.steps for entry in step.supports}
    return {number for name in names for number in nodes.sets.get(name, ())}


def _reactions(folder: Path, table: Table, held: set[int], newton: float) -> Iterator[Row]:
    """Sums over the supported nodes: the tables have the forces of loads as well."""
    from json import loads

    summary = loads((folder / "summary.json").read_text(encoding="utf-8"))
    forces = [value for value in summary.get("reactions", {}).values() if value]
    rows = [v for n, v in zip(table.nodes, table.vectors, strict=True) if n in held]
    if not forces or not rows:
        return
    ours = np.sum(np.array(forces, dtype=np.float64), axis=0) / newton
    theirs = np.sum(np.array(rows), axis=0)[: len(ours)]
    size = float(max(np.abs(theirs).max(), np.abs(ours).max())) or 1.0
    for i, axis in enumerate("xyz"[: len(ours)]):
        difference = abs(float(ours[i] - theirs[i])) / size
        remark = f"sum over {len(rows)} supported nodes"
        yield Row(f"reactions along {axis}", float(ours[i]), float(theirs[i]), difference, remark)


def _modes(folder: Path, theirs: list[float], hertz: float) -> Iterator[Row]:
    with (folder / "modes.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    column = "frequency" if rows and "frequency" in rows[0] else "load_factor"
    scale = hertz if column == "frequency" else 1.0
    ours = [float(row[column]) / scale for row in rows]
    for i, (mine, other) in enumerate(zip(ours, theirs, strict=False), start=1):
        largest = max(abs(other), 1e-6 * max(map(abs, theirs)), 1e-300)
        yield Row(f"{column.replace('_', ' ')} {i}", mine, other, abs(mine - other) / largest)


def reasons(deck: Deck, rows: list[Row]) -> list[str]:
    """Why numbers differ, as far as it is known.

    Args:
        rows: From `compare`.
    """
    if all(row.difference < 1e-4 for row in rows):
        return []
    result = []
    if deck.mesh.get("degree") == 1:
        result.append(
            "linear tetrahedra: other programs average their volume change over nodes or elements "
            "(C3D4 of Abaqus 2020 on, ut4 of FEBio); those of CalculiX and of Nastran do not"
        )
    if deck.mesh.get("formulation") == "mixed":
        result.append("elements with a pressure: other programs interpolate the pressure otherwise")
    if any(step.nonlinear for step in deck.steps):
        result.append(
            "large displacements: elastic constants are of another law in other programs, and "
            "programs stop their iterations at 0.5 % of the forces"
        )
    loads = [entry for step in deck.steps for entry in step.loads]
    spins = any(entry.keys.get("kind") == "centrifugal" for entry in loads)
    if deck.mesh.get("degree") == 2 and (spins or any(s.kind == "modal" for s in deck.steps)):
        result.append(
            "CalculiX integrates the mass of C3D10 and its forces of rotation by four points, "
            "which is not exact"
        )
    if any(entry.keys.get("kind") in ("pressure", "traction") for entry in loads):
        result.append(
            "pressures on curved faces: programs integrate them with points of their own, or on "
            "the straight faces"
        )
    if deck.left_out:
        result.append(f"what is not carried over, see the {len(deck.left_out)} lines above")
    return result
