"""What surrounds or couples a body beyond its elements, as solvers see it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.types import FloatArray, IntArray


@dataclass(frozen=True)
class Blocks:
    """Entries of a tangent between nodes of the displacement, which need share no element.

    Each rank may have blocks of any nodes; those of one pair are summed, over the ranks, too.

    Attributes:
        rows: Global number of each block's node of forces in the displacement's space, shape (n,).
        columns: That of its node of displacements, shape (n,).
        values: Derivative of the out-of-balance forces, shape (n, dim, dim) [N/m].
    """

    rows: IntArray
    columns: IntArray
    values: FloatArray


class Term:
    """One part of the surroundings: what it does not say itself is nothing.

    Attributes:
        label: What results call it.
        linear: Its forces are linear in the displacement.
        symmetric: Its blocks are those of a symmetric matrix.
    """

    label: str
    linear: bool = False
    symmetric: bool = True

    def add_forces(self, forces: FloatArray) -> None:
        """Adds its present forces on the body that are in no form. Local.

        Args:
            forces: Of the displacement's owned nodes and ghosts, before the ranks are summed,
                shape (nodes * dim,) [N].
        """

    def blocks(self) -> Blocks | None:
        """Minus the derivative of these forces; None, on all ranks and always, without any.

        Collective.
        """
        return None


def blocks_of(terms: Sequence[Term]) -> Blocks | None:
    """The blocks of all terms; None where no term has any. Collective."""
    found = [blocks for term in terms if (blocks := term.blocks()) is not None]
    if not found:
        return None
    parts = [(blocks.rows, blocks.columns, blocks.values) for blocks in found]
    return Blocks(*(np.concatenate(part) for part in zip(*parts, strict=True)))
