"""Sizes that the C files of the package are compiled with."""

from __future__ import annotations

ELEMENTS = [(2, 3, 3, 1), (2, 6, 3, 3), (2, 6, 6, 6), (3, 4, 4, 1), (3, 10, 4, 4), (3, 10, 10, 15)]
"""Dimension, nodes of the displacement and of the geometry, and points."""


def tangents():
    """Linear and quadratic cells, straight and curved, with and without a pressure."""
    for dim, nodes, corners, points in ELEMENTS:
        sizes = {"DIM": dim, "ND": nodes, "NDP": -(-nodes // 4) * 4, "NG": corners, "NQ": points}
        for symmetric in (0, 1):
            plain = {"NP": 0, "STRIDE": dim, "NW": nodes, "BS": dim}
            mixed = {"NP": dim + 1, "STRIDE": 1, "NW": dim * nodes + dim + 1, "BS": 1}
            yield from (sizes | {"SYMMETRIC": symmetric} | one for one in (plain, mixed))


def recoveries():
    for dim, degree in [(2, 1), (2, 2), (3, 1), (3, 2)]:
        nodes = {(2, 1): 3, (2, 2): 6, (3, 1): 4, (3, 2): 10}[dim, degree]
        sizes = {"DIM": dim, "DEGREE": degree, "NG": dim + 1, "ND": nodes}
        yield sizes | {"NS": nodes, "NM": nodes, "WIDEST": 40}


SIZES = {
    "cells.c": [{"NG": 3, "NW": 3, "BS": 2}, {"NG": 10, "NW": 10, "BS": 3}],
    "extremes.c": [one for one in tangents() if one["NP"] == 0 and one["SYMMETRIC"] == 0],
    "multigrid.c": [{"DIM": dim, "MODES": 3 * dim - 3} for dim in (2, 3)],
    "patches.c": list(recoveries()),
    "roots.c": [
        {"NG": 3, "NW": 3, "BS": 2, "N": 1, "NQ": 1, "NN": 1},
        {"NG": 4, "NW": 10, "BS": 3, "N": 7, "NQ": 4, "NN": 4},
    ],
    "steps.c": [
        {"DIM": d, "NDP": 4, "BS": d, "WIDTH": width, "BRANCH": branch}
        | dict.fromkeys(("ND", "NG", "NW"), d + 1)
        for d in (2, 3)
        for width, branch in ((4, 0), (8, 0), (8, 1))
    ],
    "symmetric.c": [{"DIM": 2}, {"DIM": 3}],
    "tangent.c": list(tangents()),
    "thickness.c": [{"DIM": 2}, {"DIM": 3}],
    "triangles.c": [{"LEAF": 4}],
}
