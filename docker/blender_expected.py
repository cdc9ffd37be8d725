"""Say what Blender must find in exports of a run, read with h5py and PyVista alone.

python3 blender_expected.py RESULTS STATE FIELD EXPECTED.npz

The surface is VTK's, in the order of the body's nodes; the colours are matplotlib's, in sRGB.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import h5py
import matplotlib as mpl
import numpy as np
import pyvista


def main(folder: Path, state: int, field: str, target: Path) -> None:
    """Writes places and colours of the surface in one state."""
    grids = ElementTree.parse(folder / "results.xdmf").getroot().findall(".//Grid/Grid")
    cells = array(grids[0].find("Topology/DataItem"), folder).astype(int)
    rest = array(grids[0].find("Geometry/DataItem"), folder)
    rows = np.insert(cells[:, :4], 0, 4, axis=1)
    body = pyvista.UnstructuredGrid(rows.ravel(), np.full(len(cells), 10, np.uint8), rest)
    nodes = np.sort(body.extract_surface()["vtkOriginalPointIds"])
    norms = [np.linalg.norm(values(grid, field, folder)[nodes], axis=1) for grid in grids]
    low, high = min(map(np.min, norms)), max(map(np.max, norms))
    shades = mpl.colormaps["viridis"](np.linspace(0.2, 1.0, 256))
    among = np.interp(norms[state], [low, high], [0.0, 1.0])
    at = np.linspace(0.0, 1.0, len(shades))
    np.savez(
        target,
        places=(rest + values(grids[state], "displacement", folder))[nodes],
        colours=np.stack([np.interp(among, at, shades[:, i]) for i in range(3)], axis=1),
        seconds=np.diff([float(grids[k].find("Time").get("Value")) for k in (0, state)]),
    )


def values(grid: Any, name: str, folder: Path) -> Any:
    """A field of a state."""
    return array(grid.find(f"Attribute[@Name='{name}']/DataItem"), folder)


def array(item: Any, folder: Path) -> Any:
    """The rows that a DataItem names."""
    file, _, name = item.text.strip().rpartition(":")
    with h5py.File(folder / file) as data:
        return np.asarray(data[name], dtype=float)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3], Path(sys.argv[4]))
