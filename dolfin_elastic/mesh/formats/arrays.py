"""A mesh of plain arrays, as a program makes it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.fields import as_columns
from dolfin_elastic.mesh.formats.raw import Block, MeshFile, RawMesh, assemble

_KINDS = {(2, 3): "triangle", (2, 6): "triangle6", (3, 4): "tetra", (3, 10): "tetra10"}
"""Dimension of the points and nodes of a cell to its kind."""


def raw_mesh(
    points: npt.ArrayLike,
    cells: npt.ArrayLike,
    regions: Mapping[str, npt.ArrayLike],
    nodes: Mapping[str, npt.ArrayLike],
    fields: Mapping[str, npt.ArrayLike],
) -> RawMesh:
    """The arrays of `mesh_body` as a mesh. Local.

    Raises:
        MeshError: A shape or a number is wrong.
    """
    places = _numbers(points)
    kind = _KINDS.get((places.shape[1], np.shape(cells)[1] if np.ndim(cells) == 2 else 0))
    if kind is None:
        raise MeshError(
            f"points of shape {places.shape} and cells of shape {np.shape(cells)} are no mesh",
            expected="points (N, 2) and cells (M, 3) or (M, 6), or (N, 3) and (M, 4) or (M, 10)",
        )
    rows = _rows(cells, len(places), "cells")
    parts = {name: _rows(part, len(rows), f"regions.{name}") for name, part in regions.items()}
    sets = {name: _rows(part, len(places), f"nodes.{name}") for name, part in nodes.items()}
    of_cells, of_points = dict[str, FloatArray](), dict[str, FloatArray]()
    if fields and len(places) == len(rows):
        raise MeshError(
            f"there are {len(rows)} points and as many cells: fields may be of either",
            where="fields",
            expected='body.fields[name] = MeshField("cell", values) afterwards',
        )
    for name, values in fields.items():
        at_points = np.shape(values)[:1] == (len(places),)
        table = as_columns(values, len(places) if at_points else len(rows), name)
        (of_points if at_points else of_cells)[name] = table
    block = Block(kind, rows, parts, of_cells)
    return assemble(MeshFile(places, [block], point_sets=sets, point_data=of_points), source="")


def _numbers(points: npt.ArrayLike) -> FloatArray:
    try:
        result = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError):
        result = np.empty(0)
    return result if result.ndim == 2 else result.reshape(-1, 1)


def _rows(given: npt.ArrayLike, count: int, where: str) -> IntArray:
    rows = np.asarray(given)
    if rows.size and (rows.dtype.kind not in "iu" or rows.min() < 0 or rows.max() >= count):
        raise MeshError(
            "these are no rows of an array",
            where=where,
            expected=f"whole numbers from 0 to {count - 1}",
        )
    return rows.astype(np.int64)
