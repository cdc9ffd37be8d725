"""Products with several vectors, eight side by side: what is read of a matrix serves them all."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from dolfin_elastic.core.jit import CFunctions
from dolfin_elastic.core.types import FloatArray, SingleArray

Vectors: TypeAlias = FloatArray | SingleArray
"""One, in double precision, or `EIGHT` side by side, which may be in single precision."""

EIGHT = 8
"""Vectors of one pass over a matrix: what a vector register holds."""


def by_eights(
    vectors: FloatArray,
    images: FloatArray,
    room: Vectors,
    times: Callable[[], Vectors],
    loops: CFunctions,
) -> None:
    """Overwrites images by products with vectors, which they may be themselves.

    Args:
        vectors: Owned entries, one vector below the other; so are the images.
        room: For owned entries at least, shape (entries, `EIGHT`): what is multiplied.
        times: Gives the product with what stands there, in the same order.
        loops: Compiled of a file that includes halves.h, whose copies are called.
    """
    entries = vectors.shape[1]
    for first in range(0, len(vectors), EIGHT):
        some, into = (x[first : first + EIGHT] for x in (vectors, images))
        loops.call("side_by_side", len(some), entries, some, room)
        loops.call("one_below_the_other", len(some), entries, times(), into)
