"""`Plc`: triangles that bound regions, a piecewise linear complex as mesh generators take it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from dolfin_elastic.core.types import FloatArray, IntArray

OUTSIDE = -1
"""The region that is not meshed."""


@dataclass(frozen=True)
class Plc:
    """Triangles without open edges, which meet in common nodes and edges only.

    Attributes:
        points: Corners in the file's unit, all in use, shape (n, 3).
        triangles: Rows of these, shape (m, 3).
        regions: Region behind each triangle, against its normal, and that in front of it; rows of
            `region_names` or `OUTSIDE`, shape (m, 2).
        patches: Rows of `patch_names`; a patch lies between the same two regions, shape (m,).
        region_names: Of each region; may be empty texts.
        patch_names: Of each patch; may be empty texts.
        groups: Further names, each of several patches.
    """

    points: FloatArray
    triangles: IntArray
    regions: IntArray
    patches: IntArray
    region_names: Sequence[str]
    patch_names: Sequence[str]
    groups: Mapping[str, Sequence[int]] = field(default_factory=dict)
