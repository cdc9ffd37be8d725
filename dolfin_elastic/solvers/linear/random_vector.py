"""Numbers that look random, for estimates by products with a vector.

numpy.random would do as well, but importing it costs each process 1.5 MB and some milliseconds.
"""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.types import FloatArray

STEP = 0x9E3779B97F4A7C15
"""2^64 over the golden ratio."""


def random_vector(first: int, count: int) -> FloatArray:
    """Numbers evenly spread between -1 and 1, always the same for the same places. Not collective.

    The generator SplitMix64, whose k-th number is a function of k: G. L. Steele, D. Lea and C. H.
    Flood, Fast splittable pseudorandom number generators, OOPSLA (2014) 453, with the constants of
    D. Stafford's thirteenth variant.

    Args:
        first: Place of the first one, as in a vector of which each rank has a part.
    """
    z = np.arange(first + 1, first + 1 + count, dtype=np.uint64) * np.uint64(STEP)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        z = (z ^ (z >> np.uint64(shift))) * np.uint64(factor)
    z ^= z >> np.uint64(31)
    return np.asarray((z >> np.uint64(11)) * 2.0**-52 - 1.0)
