"""Checksums of arrays and meshes that do not depend on the number of ranks."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.results.hdf5 import Rows

_ALL = (1 << 64) - 1
_ROWS = 1 << 16
_GOLDEN, _FIRST, _SECOND = 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB


def checksum(values: AnyArray, offsets: AnyArray) -> int:
    """Sum over all entries of a hash of value and position, modulo 2^64. Not collective.

    The checksums of parts add up to that of the whole array.  The hash is splitmix64: G. L. Steele,
    D. Lea, C. H. Flood, Fast splittable pseudorandom number generators, OOPSLA 2014.

    Args:
        values: Numbers of 8 bytes, shape (n, columns).
        offsets: Number of each row in the whole array, shape (n,).
    """
    cuts = range(0, len(values), _ROWS)
    return sum(_hash_sum(values[i : i + _ROWS], offsets[i : i + _ROWS]) for i in cuts) & _ALL


def _hash_sum(values: AnyArray, offsets: AnyArray) -> int:
    bits = np.ascontiguousarray(values).view(np.uint64)
    columns = np.arange(bits.shape[1], dtype=np.uint64)
    offset = offsets.astype(np.uint64)[:, None] * np.uint64(bits.shape[1]) + columns
    z = bits ^ ((offset + np.uint64(1)) * np.uint64(_GOLDEN))
    z = (z ^ (z >> np.uint64(30))) * np.uint64(_FIRST)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(_SECOND)
    return int(np.sum(z ^ (z >> np.uint64(31)), dtype=np.uint64))


def array_checksum(comm: MPI.Comm, rows: Rows) -> str:
    """Checksum of an array as 16 hexadecimal digits. Collective.

    Args:
        comm: The ranks that hold its rows.
        rows: This rank's rows.
    """
    offsets = np.arange(rows.first, rows.first + len(rows.values))
    return _text(total(comm, checksum(rows.values, offsets)))


def fingerprint(body: Body) -> dict[str, object]:
    """Numbers that identify a mesh with its regions and surfaces, as JSON data. Collective."""
    mesh, cells = body.mesh, body.owned_cells()
    original = np.asarray(mesh.topology.original_cell_index)
    x = mesh.geometry.x[mesh.geometry.dofmap[cells], : body.dim]
    geometry = checksum(x.reshape(len(cells), x.shape[1] * x.shape[2]), original[cells])
    named = {}
    for name in sorted(body.regions):
        own = original[body.owned_cells(name)].astype(np.int64)
        named[name] = _text(total(body.comm, checksum(own[:, None], own)))
    return {
        "cells": body.num_cells,
        "geometry": _text(total(body.comm, geometry)),
        "regions": named,
        "surfaces": {name: body.count(name) for name in sorted(body.surfaces)},
        **_lower_parts(body),
        **_obstacles(body),
    }


def _obstacles(body: Body) -> dict[str, object]:
    """Checksums of the corners of obstacles' triangles, if there are any, in any order of these."""
    corners = [facets.points[facets.triangles] for facets in body.obstacles.values()]
    rows = [one.reshape(len(one), 9) for one in corners]
    sums = sorted(_text(checksum(one, np.arange(len(one)))) for one in rows)
    return {"obstacles": sums} if sums else {}


def _lower_parts(body: Body) -> dict[str, object]:
    """Numbers of edges and nodes by name, if there are any. Collective."""
    edges = {name: int(total(body.comm, len(body.owned_edges(name)))) for name in body.edges}
    points = {name: int(total(body.comm, len(body.owned_points(name)))) for name in body.points}
    result = {"edges": edges, "points": points}
    return {kind: dict(sorted(parts.items())) for kind, parts in result.items() if parts}


def _text(value: int) -> str:
    return f"{value & _ALL:016x}"
