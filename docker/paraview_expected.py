"""Say what an .xdmf file holds, read with h5py alone: what ParaView's readers must find.

python3 paraview_expected.py RESULTS.xdmf > EXPECTED.json
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import h5py
import numpy as np


def main(path: Path) -> None:
    """Print the counts, times and fields of the file as JSON."""
    grids = ElementTree.parse(path).getroot().findall("Domain/Grid[@GridType='Collection']/Grid")
    steps = [fields(grid, path.parent) for grid in grids]
    first = grids[0]
    print(
        json.dumps(
            {
                "points": len(array(first.find("Geometry/DataItem"), path.parent)),
                "cells": len(array(first.find("Topology/DataItem"), path.parent)),
                "times": [float(grid.find("Time").get("Value")) for grid in grids],
                "steps": steps,
            },
            indent=1,
        )
    )


def fields(grid: Any, folder: Path) -> dict[str, Any]:
    """Centre, number of components, largest norm and sum of every field of one step."""
    found = {}
    for attribute in grid.findall("Attribute"):
        values = array(attribute.find("DataItem"), folder)
        found[attribute.get("Name")] = {
            "centre": {"Node": "point", "Cell": "cell"}[attribute.get("Center")],
            "components": values.shape[1],
            "max_norm": float(np.linalg.norm(values, axis=1).max()),
            "sum": values.sum(axis=0).tolist(),
        }
    return found


def array(item: Any, folder: Path) -> Any:
    """The rows that a DataItem names."""
    file, _, name = item.text.strip().rpartition(":")
    with h5py.File(folder / file) as data:
        values = np.asarray(data[name], dtype=float)
    return values.reshape(len(values), -1)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
