"""Element types of Abaqus and their faces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dolfin_elastic.core.types import IntArray
from dolfin_elastic.mesh.formats.raw import boundary, match_rows

_KINDS = {2: "line", 3: "triangle"}


@dataclass(frozen=True)
class Elements:
    """Elements of one *ELEMENT.

    Attributes:
        kind: In the words of meshio.
        labels: Numbers of the elements, shape (n,).
        nodes: Numbers of their nodes, shape (n, k).
        type: In capitals, as C3D10M.
    """

    kind: str
    labels: IntArray
    nodes: IntArray
    type: str


@dataclass(frozen=True)
class Picked:
    """The facets that one line of a *SURFACE names.

    Attributes:
        found: Kind and nodes of facets, shape (n, vertices) each.
        asked: Number of elements that the line names.
        missing: How many of them do not exist or have no such face.
        unknown_side: Some exist, but none has such a face.
        unsupported: Kind of those without faces, where elements of this kind are not supported.
    """

    found: list[tuple[str, IntArray]]
    asked: int
    missing: int
    unknown_side: bool
    unsupported: str = ""


class Facets:
    """Facets of the elements of a file."""

    def __init__(self, elements: Sequence[Elements]) -> None:
        self._elements = elements
        solid = any(stem(e.kind) in ("tetra", "hexahedron", "wedge", "pyramid") for e in elements)
        self._dim, self._cells = (3, "tetra") if solid else (2, "triangle")
        self._others = ("hexahedron", "wedge", "pyramid") if solid else ("quad",)

    def pick(self, members: IntArray, side: str) -> Picked:
        """Facets of one line of a *SURFACE.

        Args:
            members: Numbers of elements, all different.
            side: The face in capitals; empty: those on the boundary of the body.
        """
        result, with_face, existing, other = list[tuple[str, IntArray]](), 0, 0, ""
        for elements in self._elements:
            inside = np.isin(elements.labels, members)
            existing += int(np.count_nonzero(inside))
            corners = faces(elements.kind, side, self._dim)
            if corners is None and inside.any() and stem(elements.kind) in self._others:
                other = elements.kind
            if corners is None or not inside.any():
                continue
            with_face += int(np.count_nonzero(inside))
            for local in corners:
                nodes = elements.nodes[inside][:, list(local)]
                if not side and stem(elements.kind) == self._cells:
                    nodes = nodes[match_rows(self._boundary, np.sort(nodes, axis=1)) >= 0]
                result.append((_KINDS[nodes.shape[1]], nodes))
        missing = max(len(members) - with_face, 0)
        return Picked(result, len(members), missing, existing > 0 and with_face == 0, other)

    @cached_property
    def _boundary(self) -> IntArray:
        """Facets on the boundary of the body, sorted vertices."""
        width = self._dim + 1
        return boundary(
            [e.nodes[:, :width] for e in self._elements if stem(e.kind) == self._cells]
            or [np.empty((0, width), dtype=np.int64)]
        )


# An element type starts with one of these; what follows (H, R, M, T ...) is its formulation.
_TYPES = {
    ("tetra", 4): "C3D4 DC3D4 AC3D4",
    ("tetra10", 10): "C3D10 DC3D10 AC3D10",
    ("triangle", 3): "CPE3 CPS3 CAX3 S3 M3D3 R3D3 SFM3D3 STRI3 DC2D3",
    ("triangle6", 6): "CPE6 CPS6 CAX6 STRI65 M3D6 SFM3D6 DC2D6 S6",
    ("quad", 4): "CPE4 CPS4 CAX4 S4 M3D4 R3D4 SFM3D4",
    ("quad8", 8): "CPE8 CPS8 CAX8 S8 M3D8",
    ("hexahedron", 8): "C3D8 DC3D8 SC8",
    ("hexahedron20", 20): "C3D20 DC3D20",
    ("hexahedron27", 27): "C3D27",
    ("wedge", 6): "C3D6 DC3D6 SC6",
    ("wedge15", 15): "C3D15",
    ("pyramid", 5): "C3D5",
    ("line", 2): "T3D2 T2D2 B21 B31 B33 R2D2 PIPE21 PIPE31",
    ("line3", 3): "T3D3 T2D3 B22 B32 PIPE22 PIPE32",
    ("vertex", 1): "MASS ROTARYI SPRING1 DASHPOT1",
}
_WITHOUT_SHAPE = (
    *("SPRINGA", "SPRING2", "DASHPOTA", "DASHPOT2", "GAPUNI", "GAPCYL", "GAPSPHER", "GAPK"),
    *("CONN2D2", "CONN3D2", "JOINTC", "JOINT2D", "JOINT3D", "DCOUP2D", "DCOUP3D", "DISTCOUP"),
    *("ITSUNI", "ITSCYL", "HEATCAP", "DRAG2D", "DRAG3D", "DGAP", "RB2D2", "RB3D2"),
)
"""Types of elements that connect nodes by a law, whatever lies between them; D (pipes), too."""
# Vertices of the faces S1, S2 ... in the order of the Abaqus manual.
_TETRAHEDRON = ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0))
_TRIANGLE = ((0, 1), (1, 2), (2, 0))
_SHELL_SIDES = ("", "SPOS", "SNEG", "S1", "S2")
"""Both sides of a shell in a body of tetrahedra are one and the same facet."""


def element_kind(name: str) -> tuple[str, int] | None:
    """Kind of an element type in the words of meshio, and its number of nodes.

    Args:
        name: For example C3D10M, in capitals.

    Returns:
        None for a type that is not known.
    """
    fits = [
        (len(base), kind)
        for kind, bases in _TYPES.items()
        for base in bases.split()
        if name.startswith(base) and not name[len(base) :][:1].isdigit()
    ]
    return max(fits)[1] if fits else None


def has_no_shape(name: str) -> bool:
    """Whether elements of a type, in capitals, connect nodes by a law and are part of no mesh."""
    return name.startswith(_WITHOUT_SHAPE) or name == "D"


def stem(kind: str) -> str:
    """The shape of a kind: tetra of tetra10."""
    return kind.rstrip("0123456789")


def faces(kind: str, side: str, dim: int) -> tuple[tuple[int, ...], ...] | None:
    """Vertices of the faces that a line of a *SURFACE means of one element.

    Args:
        side: S1, S2 ... or SPOS, SNEG of a shell; empty: all of them.

    Returns:
        Local vertices of each face; None if elements of this kind have no such face.
    """
    if stem(kind) == "triangle" and dim == 3:
        return ((0, 1, 2),) if side in _SHELL_SIDES else None
    known = {("tetra", 3): _TETRAHEDRON, ("triangle", 2): _TRIANGLE}.get((stem(kind), dim))
    if known is None or not side:
        return known
    number = int(side[1:]) if side[:1] in "SP" and side[1:].isdigit() else 0
    return (known[number - 1],) if 1 <= number <= len(known) else None
