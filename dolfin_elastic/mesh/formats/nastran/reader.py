"""`read_nastran`: from the bulk data of a Nastran file to its mesh.

Read here rather than through meshio 5.3, which takes all coordinates for rectangular ones, passes
over INCLUDE and whatever else it does not know, and mistakes continuations that begin with a blank
field.  What defines nodes, elements or coordinates and is not understood is an error here.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.nastran.bulk import Bulk, Elements, bulk_of
from dolfin_elastic.mesh.formats.nastran.elements import SOLIDS
from dolfin_elastic.mesh.formats.nastran.entries import read_entries
from dolfin_elastic.mesh.formats.nastran.groups import Groups
from dolfin_elastic.mesh.formats.raw import Block, MeshFile, find

_NO_NODES = np.empty((0, 0), dtype=np.int64)


def read_nastran(path: Path) -> MeshFile:
    """Reads bulk data and what they include. Local: one rank reads.

    Raises:
        MeshError: A line cannot be read, or would define something of the mesh that is not
            understood.
    """
    bulk = bulk_of(read_entries(path))
    if not bulk.grids or not bulk.elements:
        raise MeshError("there are no GRID or no elements", where=path.name)
    numbers, points = _points(bulk)
    _check_solids(bulk)
    blocks = [_block(kind, elements, numbers) for kind, elements in bulk.elements.items()]
    groups = Groups(bulk, strict=False).all
    sets = {g.name: find(numbers, np.array(sorted(g.nodes))) for g in groups if g.nodes}
    for group in groups:
        if group.facets:
            rows = find(numbers, np.array(group.facets))
            blocks.append(Block("triangle", rows, {group.name: np.arange(len(rows))}))
    return MeshFile(
        points, blocks, information=_information(bulk), point_sets=sets, numbers=numbers
    )


def _points(bulk: Bulk) -> tuple[IntArray, FloatArray]:
    """Numbers of the nodes in ascending order, and their basic coordinates, shape (n, 3)."""
    labels = sorted(bulk.grids)
    numbers, entries = np.array(labels, dtype=np.int64), [bulk.grids[label] for label in labels]
    x = np.array([[entry.real(i) for i in (2, 3, 4)] for entry in entries])
    of = np.array([bulk.system_of(entry) for entry in entries])
    systems, points = bulk.basic(), np.empty_like(x)
    for number in np.unique(of).tolist():
        rows = np.flatnonzero(of == number)
        points[rows] = systems.place(number, x[rows], entries[int(rows[0])])
    return numbers, points


def _dims(bulk: Bulk) -> dict[str, int]:
    """Dimension of each kind of elements."""
    return {kind: Block(kind, _NO_NODES).dim for kind in bulk.elements}


def _check_solids(bulk: Bulk) -> None:
    """Refuses bodies of hexahedra and the like, with the first of them."""
    dims = _dims(bulk)
    for kind, elements in bulk.elements.items():
        if dims[kind] == max(2, *dims.values()) and kind not in SOLIDS:
            raise elements.entries[0].error(
                f"this kind of element is not supported; there are {len(elements.nodes)} of "
                f"{len(elements.nodes[0])} nodes",
                "a mesh of CTETRA, or of CTRIA3 or CTRIA6",
            )


def _block(kind: str, elements: Elements, numbers: IntArray) -> Block:
    nodes, parts = np.array(elements.nodes, dtype=np.int64), np.array(elements.parts)
    rows = find(numbers, nodes)
    if (rows < 0).any():
        element, node = np.argwhere(rows < 0)[0].tolist()
        raise elements.entries[element].error(f"there is no GRID {nodes[element, node]}")
    named = {str(part): np.flatnonzero(parts == part) for part in np.unique(parts).tolist() if part}
    return Block(kind, rows, named)


def _information(bulk: Bulk) -> list[str]:
    """Elements without stiffness, and entries that are not read."""
    dims = _dims(bulk)
    fixed = sum(bulk.supports_at(grid) != "" for grid in bulk.grids.values())
    if fixed:
        bulk.others["GRID with supports (PS)"] = fixed
    low = Counter(
        entry.name
        for kind, elements in bulk.elements.items()
        if dims[kind] < max(dims.values())
        for entry in elements.entries
    )
    texts = {
        "elements that name parts only and have no stiffness": low,
        "for the case file, no part of the mesh": bulk.others,
        "unknown to the reader of meshes": bulk.unread,
    }
    result = [
        f"{text}: {', '.join(f'{count} {name}' for name, count in elements.items())}"
        for text, elements in texts.items()
        if elements
    ]
    if turned := sum(bulk.system_of(grid, 5) != 0 for grid in bulk.grids.values()):
        result.append(
            f"{turned} GRID with directions in a coordinate system of their own (CD): supports and "
            "loads of the case file are in basic directions"
        )
    return result
