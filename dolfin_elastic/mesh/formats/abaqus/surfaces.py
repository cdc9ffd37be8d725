"""Facets of elements that a *SURFACE of Abaqus names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dolfin_elastic.core.types import IntArray
from dolfin_elastic.mesh.formats.abaqus.elements import faces, stem
from dolfin_elastic.mesh.formats.raw import boundary, match_rows

_KINDS = {2: "line", 3: "triangle"}


@dataclass(frozen=True)
class Elements:
    """Elements of one *ELEMENT.

    Attributes:
        kind: In the words of meshio.
        labels: Numbers of the elements, shape (n,).
        nodes: Numbers of their nodes, shape (n, k).
    """

    kind: str
    labels: IntArray
    nodes: IntArray


@dataclass(frozen=True)
class Picked:
    """The facets that one line of a *SURFACE names.

    Attributes:
        found: Kind and nodes of facets, shape (n, vertices) each.
        asked: Number of elements that the line names.
        missing: How many of them do not exist or have no such face.
        unknown_side: Some exist, but none has such a face.
    """

    found: list[tuple[str, IntArray]]
    asked: int
    missing: int
    unknown_side: bool


class Facets:
    """Facets of the elements of a file.

    Args:
        elements: All elements.
    """

    def __init__(self, elements: Sequence[Elements]) -> None:
        self._elements = elements
        solid = any(stem(e.kind) in ("tetra", "hexahedron", "wedge", "pyramid") for e in elements)
        self._dim, self._cells = (3, "tetra") if solid else (2, "triangle")

    def pick(self, members: IntArray, side: str) -> Picked:
        """Facets of one line of a *SURFACE.

        Args:
            members: Numbers of elements, all different.
            side: The face in capitals; empty: those on the boundary of the body.
        """
        found, with_face, existing = [], 0, 0
        for elements in self._elements:
            inside = np.isin(elements.labels, members)
            existing += int(np.count_nonzero(inside))
            corners = faces(elements.kind, side, self._dim)
            if corners is None or not inside.any():
                continue
            with_face += int(np.count_nonzero(inside))
            for local in corners:
                nodes = elements.nodes[inside][:, list(local)]
                if not side and stem(elements.kind) == self._cells:
                    nodes = nodes[match_rows(self._boundary, np.sort(nodes, axis=1)) >= 0]
                found.append((_KINDS[nodes.shape[1]], nodes))
        missing = max(len(members) - with_face, 0)
        return Picked(found, len(members), missing, existing > 0 and with_face == 0)

    @cached_property
    def _boundary(self) -> IntArray:
        """Facets on the boundary of the body, sorted vertices."""
        width = self._dim + 1
        return boundary(
            [e.nodes[:, :width] for e in self._elements if stem(e.kind) == self._cells]
            or [np.empty((0, width), dtype=np.int64)]
        )
