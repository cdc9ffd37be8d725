"""Say what other programs must find in exports of a run, read with h5py alone.

python3 foreign_expected.py RESULTS EXPECTED.npz

Of all states: times [s] and names, places at rest [m], displacements [m] and stresses [Pa] of all
nodes; numbers of the nodes of the surface, and their colours, matplotlib's in sRGB, by von Mises
stress.  Modes are states without stresses, 24 a second, and coloured by their displacement.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import h5py
import matplotlib as mpl
import numpy as np

FACES = [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]
"""Corners of the faces of a tetrahedron."""
SIDES = {(0, 1): 4, (1, 2): 5, (0, 2): 6, (0, 3): 7, (1, 3): 8, (2, 3): 9}
"""Corners to the node between them, if there is one."""


def main(folder: Path, target: Path) -> None:
    """Writes all of it as arrays."""
    modes = sorted(folder.glob("mode_*.xdmf"))
    grids = [grids_of(file)[0] for file in modes] or grids_of(folder / "results.xdmf")
    times = [float(grid.find("Time").get("Value")) for grid in grids]
    names = [f"Time_{round(t, 2)}_".replace(".", "_") for t in times]
    if modes:
        times = [k / 24 for k in range(len(grids))]
        names = [f"EigenMode_{k + 1}_" for k in range(len(grids))]
    cells = array(grids[0].find("Topology/DataItem"), folder).astype(int)
    rest = array(grids[0].find("Geometry/DataItem"), folder)
    of = {
        name: np.array(
            [array(g.find(f"Attribute[@Name='{name}']/DataItem"), folder) for g in grids]
        )
        for name in ("displacement", *(() if modes else ("von_mises", "cauchy_stress")))
    }
    nodes = surface(cells)
    shown = np.linalg.norm(of.get("von_mises", of["displacement"]), axis=2)[:, nodes]
    shades = mpl.colormaps["viridis"](np.linspace(0.2, 1.0, 256))
    among = np.interp(shown, [shown.min(), shown.max()], [0.0, 1.0])
    at = np.linspace(0.0, 1.0, len(shades))
    colours = np.stack([np.interp(among, at, shades[:, i]) for i in range(3)], axis=-1)
    np.savez(target, times=times, names=names, rest=rest, nodes=nodes, colours=colours, **of)


def grids_of(file: Path) -> Any:
    """The states of an .xdmf file."""
    return ElementTree.parse(file).getroot().findall(".//Grid/Grid")


def surface(cells: Any) -> Any:
    """Numbers of the nodes of faces that one cell alone has."""
    quadratic = cells.shape[1] > len(FACES)
    rows = []
    for face in FACES:
        pairs = [(face[0], face[1]), (face[1], face[2]), (face[0], face[2])]
        middles = [SIDES[pair] for pair in pairs] if quadratic else []
        rows.append(cells[:, [*face, *middles]])
    faces = np.concatenate(rows)
    _, back, counts = np.unique(
        np.sort(faces[:, :3], axis=1), axis=0, return_inverse=True, return_counts=True
    )
    return np.unique(faces[counts[back.ravel()] == 1])


def array(item: Any, folder: Path) -> Any:
    """The rows that a DataItem names."""
    file, _, name = item.text.strip().rpartition(":")
    with h5py.File(folder / file) as data:
        return np.asarray(data[name], dtype=float)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
