"""Closed surfaces of triangles with known volumes, as complexes that mesh generators fill."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.surfaces.filling.plc import OUTSIDE, Plc

Surface = tuple[FloatArray, IntArray, FloatArray]
"""Corners, triangles, and the middle of each triangle's own face of the body."""


def ball(radius: float, centre: Sequence[float] = (0, 0, 0), times: int = 3) -> Surface:
    """An octahedron of which each triangle is divided in four a few times."""
    corners = np.array([s * e for e in np.eye(3) for s in (1, -1)])
    x = np.array([[corners[[a, b + 2, c + 4]]] for a, b, c in product((0, 1), repeat=3)])[:, 0]
    x[np.linalg.det(x) < 0] = x[np.linalg.det(x) < 0][:, ::-1]
    for _ in range(times):
        a, b, c = np.moveaxis(x, 1, 0)
        ab, bc, ca = (m / np.linalg.norm(m, axis=1, keepdims=True) for m in (a + b, b + c, c + a))
        parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        x = np.concatenate([np.stack(part, axis=1) for part in parts])
    points, triangles = welded(x)
    return radius * points + np.array(centre), triangles, np.zeros((len(x), 3))


def box(size: Sequence[float], corner: Sequence[float] = (0, 0, 0), n: int = 4) -> Surface:
    """A box; each side consists of n x n squares of two triangles."""
    ticks, x, middles = np.arange(n) / n, [], []
    for axis, side in product(range(3), (0, 1)):
        u, v = np.eye(3)[[(axis + 1) % 3, (axis + 2) % 3]][:: 1 if side else -1]
        start = np.eye(3)[axis] * side
        for i, j in product(ticks, ticks):
            a = start + i * u + j * v
            b, c, d = a + u / n, a + (u + v) / n, a + v / n
            x += [(a, b, c), (a, c, d)]
        middles += [start + (u + v) / 2] * (2 * n * n)
    points, triangles = welded(np.array(x))
    return points * size + np.array(corner), triangles, np.array(middles) * size + np.array(corner)


def torus(major: float, minor: float, n: int = 24) -> Surface:
    """A torus around the third axis of 2n x n squares of two triangles."""

    def at(i: int, j: int) -> list[float]:
        u, v = np.pi * (i % (2 * n)) / n, 2 * np.pi * (j % n) / n
        r = major + minor * np.cos(v)
        return [r * np.cos(u), r * np.sin(u), minor * np.sin(v)]

    x = []
    for i, j in product(range(2 * n), range(n)):
        a, b, c, d = at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)
        x += [(a, b, c), (a, c, d)]
    points, triangles = welded(np.array(x))
    return points, triangles, np.zeros((len(triangles), 3))


def welded(x: FloatArray) -> tuple[FloatArray, IntArray]:
    """Corners and triangles of a soup of triangles, shape (n, 3, 3)."""
    flat = x.reshape(-1, 3)
    _, first, rows = np.unique(np.round(flat, 9), axis=0, return_index=True, return_inverse=True)
    return flat[first], rows.reshape(-1, 3)


def complex_of(*parts: tuple[Surface, tuple[int, int]]) -> Plc:
    """One complex of surfaces, each with the regions behind and in front of it.

    Regions are called region0 ...; each plane side of a box is a patch, any other surface one.
    """
    starts = np.cumsum([0, *(len(surface[0]) for surface, _ in parts)])
    patches, count = [], 0
    for (_, _, middles), _ in parts:
        _, own = np.unique(middles, axis=0, return_inverse=True)
        patches.append(own.reshape(-1) + count)
        count += int(own.max()) + 1
    regions = np.concatenate([np.tile(pair, (len(s[1]), 1)) for s, pair in parts])
    return Plc(
        np.concatenate([s[0] for s, _ in parts]),
        np.concatenate([s[1] + start for (s, _), start in zip(parts, starts, strict=False)]),
        regions,
        np.concatenate(patches),
        [f"region{k}" for k in range(int(regions.max()) + 1)],
        [f"patch{k}" for k in range(count)],
    )


def alone(surface: Surface) -> Plc:
    """A complex of one body."""
    return complex_of((surface, (0, OUTSIDE)))
