"""MFEM meshes (.mesh that begins with "MFEM mesh v1"), of straight elements.

Source: mfem.org/mesh-format-v1.0, /mesh-formats (versions 1.0 to 1.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.raw import Block, MeshFile, find_all
from dolfin_elastic.mesh.formats.text.lines import Lines, by_number

_KINDS = {
    0: ("vertex", 1),
    1: ("line", 2),
    2: ("triangle", 3),
    3: ("quad", 4),
    4: ("tetra", 4),
    5: ("hexahedron", 8),
    6: ("wedge", 6),
    7: ("pyramid", 5),
}
"""Number of a geometry to the kind of its elements and their nodes."""
_VERSIONS = ("v1.0", "v1.1", "v1.2", "v1.3")


def is_mfem(path: Path) -> bool:
    """Whether a file begins as one of MFEM. Local."""
    with path.open("rb") as file:
        return file.read(4) == b"MFEM"


def read_mfem(path: Path) -> MeshFile:
    """Reads elements and boundary with their attributes as names. Local: one rank reads.

    Raises:
        MeshError: The file is damaged, or has elements that are curved or refined in part.
    """
    lines = Lines(path)
    head = lines.row()
    if head[:2] != ["MFEM", "mesh"] or head[2:3] not in [[version] for version in _VERSIONS]:
        raise lines.error(
            f"'{' '.join(head)[:60]}' is not read", f"MFEM mesh {', '.join(_VERSIONS)}"
        )
    blocks = list[tuple[Block, IntArray]]()
    points: FloatArray = np.empty((0, 0))
    for words in lines:
        if words[0] in ("elements", "boundary"):
            blocks += _elements(lines)
        elif words[0] == "vertices":
            points = _vertices(lines)
        elif words[0] == "dimension":
            lines.row()
        elif words[0].startswith("mfem_mesh_end"):
            break
        else:
            raise lines.error(
                f"the section '{words[0][:40]}' is not read",
                "a mesh of straight elements: dimension, elements, boundary, vertices",
            )
    if not len(points) or not blocks:
        raise MeshError("there are no vertices or no elements", where=path.name)
    if any(block.dim > points.shape[1] for block, _ in blocks):
        raise MeshError(
            f"elements in space, but vertices of {points.shape[1]} coordinates", where=path.name
        )
    rows = np.arange(len(points))
    return MeshFile(
        points,
        [by_number(b.kind, find_all(rows, b.nodes), attributes) for b, attributes in blocks],
    )


def _elements(lines: Lines) -> Sequence[tuple[Block, IntArray]]:
    """Elements of each kind, and their attributes."""
    found: dict[str, list[list[int]]] = {}
    (count,) = lines.integers(lines.row()[:1])
    for _ in range(count):
        words = lines.integers(lines.row())
        kind, nodes = _KINDS.get(words[1] if len(words) > 1 else -1, ("", 0))
        if len(words) != nodes + 2:
            raise lines.error(f"'{' '.join(map(str, words))[:60]}' is no element")
        found.setdefault(kind, []).append([words[0], *words[2:]])
    tables = {kind: np.array(rows, dtype=np.int64) for kind, rows in found.items()}
    return [(Block(kind, table[:, 1:]), table[:, 0]) for kind, table in tables.items()]


def _vertices(lines: Lines) -> FloatArray:
    (count,) = lines.integers(lines.row()[:1])
    width = lines.row()
    if width[0] == "nodes":
        raise lines.error("curved elements are not read", "a mesh of straight elements")
    table = lines.table(count)
    if lines.integers(width[:1]) != [table.shape[1]]:
        raise lines.error(f"vertices of {table.shape[1]} coordinates, not {width[0]}")
    return table
