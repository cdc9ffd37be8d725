"""Midside nodes that a program wrote in another order than the format asks for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.formats.raw import MIDSIDES, Block, MeshFile

_SAMPLE = 10_000
_MOST = 0.9
"""Fraction of the cells that must show the same order."""
_CORNERS = {"tetra10": 4, "triangle6": 3}


def in_order(file: MeshFile) -> MeshFile:
    """A mesh whose quadratic cells have each midside node on its own edge. Local.

    Only an order that nearly all cells of a kind share is corrected; it is told from the edge whose
    middle is nearest.
    """
    blocks, notes = list(file.blocks), list(file.notes)
    for kind, corners in _CORNERS.items():
        own = [b for b in blocks if b.kind == kind]
        order = _order(own, file.points, corners)
        if order == sorted(order):
            continue
        columns = [*range(corners), *(corners + k for k in order)]
        blocks = [replace(b, nodes=b.nodes[:, columns]) if b.kind == kind else b for b in blocks]
        count, text = sum(len(b.nodes) for b in own), ", ".join(str(k + 1) for k in columns)
        notes.append(
            f"midside nodes of {count} elements are not on the edges of this format: "
            f"their nodes are read in the order {text}"
        )
    return replace(file, blocks=blocks, notes=notes)


def _order(blocks: Sequence[Block], points: FloatArray, corners: int) -> list[int]:
    """For each edge, which of the midside nodes is on it; in ascending order if in doubt."""
    edges = np.array(MIDSIDES[: corners * (corners - 1) // 2])
    same = list(range(len(edges)))
    if not blocks:
        return same
    nodes = np.concatenate([b.nodes[:: max(len(b.nodes) // _SAMPLE, 1)] for b in blocks])
    nodes = nodes[(nodes >= 0).all(axis=1) & (nodes < len(points)).all(axis=1)]
    if not len(nodes):
        return same
    x = points[nodes]
    middles = x[:, edges].mean(axis=2)
    apart = np.linalg.norm(x[:, corners:, None] - middles[:, None], axis=3)
    found, counts = np.unique(apart.argmin(axis=2), axis=0, return_counts=True)
    edge_of = found[counts.argmax()]
    sure = counts.max() >= _MOST * len(nodes) and len(set(edge_of)) == len(edges)
    return [int(k) for k in np.argsort(edge_of)] if sure else same
