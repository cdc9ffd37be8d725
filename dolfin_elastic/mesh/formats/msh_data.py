"""Data sections of Gmsh's .msh files: $ElementData and $NodeData, as text or in binary.

Format: https://gmsh.info/doc/texinfo/gmsh.html#MSH-file-format
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray, IntArray


@dataclass(frozen=True)
class View:
    """A post-processing view of Gmsh: values of elements or points, by their tags."""

    tags: IntArray
    values: FloatArray

    def rows(self, tags: IntArray) -> FloatArray | None:
        """Values of the given tags, NaN where there is none; None if there is none at all."""
        order = np.argsort(self.tags)
        at = np.minimum(np.searchsorted(self.tags, tags, sorter=order), len(order) - 1)
        hit = self.tags[order[at]] == tags
        if not hit.any():
            return None
        return np.where(hit[:, None], self.values[order[at]], np.nan)


def data_rows(views: Mapping[str, View], tags: IntArray) -> dict[str, FloatArray]:
    """Values of elements or points, of the views that have some.

    Args:
        tags: Tags of elements or points, shape (n,).

    Returns:
        Name to values, shape (n, columns).
    """
    found = {name: view.rows(tags) for name, view in views.items() if len(view.tags)}
    return {name: rows for name, rows in found.items() if rows is not None}


def views(sections: Sequence[bytes], kind: str, *, binary: bool, swap: bool) -> dict[str, View]:
    """Reads all sections of a kind; of several time steps of one name the last.

    Args:
        kind: "ElementData" or "NodeData".
        binary: The file is binary.

    Raises:
        MeshError: A section is damaged.
    """
    found = {}
    for data in sections:
        name, view = _view(data, kind, binary=binary, swap=swap)
        found[name] = view
    return found


def _view(data: bytes, kind: str, *, binary: bool, swap: bool) -> tuple[str, View]:
    name, columns, count, body = _head(data, kind)
    if binary:
        order = ">" if swap else "<"
        record = np.dtype([("tag", order + "i4"), ("values", order + "f8", (columns,))])
        if len(body) < count * record.itemsize:
            raise MeshError(f"section ${kind} of '{name}' ends too early or is damaged")
        rows = np.frombuffer(body, record, count)
        return name, View(rows["tag"].astype(np.int64), rows["values"].astype(np.float64))
    try:
        table = np.array(body.split(), dtype=np.float64).reshape(count, 1 + columns)
    except ValueError:
        raise MeshError(
            f"section ${kind} of '{name}' does not hold {count} rows of {columns} numbers"
        ) from None
    return name, View(np.nan_to_num(table[:, 0], nan=-1).astype(np.int64), table[:, 1:])


def _head(data: bytes, kind: str) -> tuple[str, int, int, bytes]:
    """Name, columns and rows of a view, and its data; the tags are text in binary files too."""
    tags: list[list[bytes]] = []
    try:
        for _ in range(3):  # texts, real numbers, whole numbers
            line, _, data = data.partition(b"\n")
            count = int(line)
            *lines, data = data.split(b"\n", count)
            tags.append(lines)
        (name, *_), _, (_, columns, rows, *_) = tags
        sizes = int(columns), int(rows)
        if sizes[0] < 1 or sizes[1] < 0:
            raise ValueError
    except ValueError:
        raise MeshError(f"section ${kind} is damaged (in its tags)") from None
    return name.strip().strip(b'"').decode("utf-8", "replace"), *sizes, data
