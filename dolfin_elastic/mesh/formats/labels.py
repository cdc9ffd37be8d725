"""Numbers that files give their nodes and elements, and sets that refer to them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import IntArray


def joined(parts: Sequence[IntArray]) -> IntArray:
    """The numbers of several arrays, of none too, one after the other."""
    return np.concatenate([np.empty(0, dtype=np.int64), *parts])


def find(labels: IntArray, wanted: IntArray) -> IntArray:
    """Index of each number in a table, -1 where it is not in it.

    Args:
        labels: The table: different numbers in ascending order, shape (n,).
        wanted: Numbers of any shape.
    """
    if not len(labels):
        return np.full(wanted.shape, -1, dtype=np.int64)
    rows = np.minimum(np.searchsorted(labels, wanted), len(labels) - 1)
    return np.where(labels[rows] == wanted, rows, -1)


def find_all(labels: IntArray, wanted: IntArray) -> IntArray:
    """Rows of the nodes of elements in a table of nodes.

    Args:
        labels: Numbers of all nodes in ascending order, shape (n,).
        wanted: Numbers of the elements' nodes, of any shape.

    Returns:
        Shape of `wanted`.

    Raises:
        MeshError: A node does not exist.
    """
    rows = find(labels, wanted)
    lost = np.unique(wanted[rows < 0])
    if len(lost):
        raise MeshError(
            f"elements refer to {len(lost)} points that do not exist, for example {lost[0]}"
        )
    return rows


def missing(lost: IntArray, count: int, what: str) -> str:
    """The reason why a set is not whole, or nothing.

    Args:
        lost: Members that do not exist.
        count: Number of all members.
    """
    if not len(lost):
        return ""
    return f"{len(lost)} of its {count} {what} do not exist in the file, for example {lost[0]}"
