"""Tetrahedra between triangles, in the process of Gmsh (`cad/worker.py`)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.mesh.formats.cad.curved import is_curved
from dolfin_elastic.mesh.formats.cad.folded import straighten_folded
from dolfin_elastic.mesh.formats.cad.meshing import logged_errors

GIVEN = "complex.npz"
"""The file with points, triangles, groups and bodies; see `fill_in_gmsh`."""
FILLED = "filled.npz"
"""The file with points, cells and their bodies, facets and their groups."""
_SHARP = 40.0
"""Angle between triangles from which on their common edge stays an edge [degrees]."""
_SAME = 1e-7
"""Distance of nodes that are one, over the size of the model."""
_TRIANGLE, _TETRAHEDRON = 2, 4
_CURVED = {2: 9, 3: 11}
"""Gmsh's types of elements."""
_GMSH_TO_VTK = [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]
_HALVINGS = 5
"""Of the rise of the edges of a folded cell, before these become straight."""


def fill_in_gmsh(gmsh: ModuleType, given: Path, folder: Path, way: Mapping[str, float]) -> None:
    """Fills bodies with cells; writes them as `FILLED`, quadratic ones in VTK's order.

    Args:
        gmsh: Gmsh with an empty model.
        given: File with `points`, shape (n, 3), `triangles` (m, 3), their `groups` (m,), which stay
            apart, and the `bodies` behind and in front of them (m, 2), -1 for none.
        folder: Where `FILLED` is written, and nothing else.
        way: `remesh`: new triangles on the surface; `order` of the cells; sizes `smallest` and
            `largest`; elements `round` a circle, 0 for those sizes alone.

    Raises:
        MeshError: Gmsh cannot do it.
    """
    data = np.load(given, allow_pickle=False)
    points, triangles, bodies = data["points"], data["triangles"], data["bodies"]
    groups = data["groups"]
    _surfaces(gmsh, points, triangles, groups, remesh=bool(way["remesh"]))
    # A facet between coarse nodes may be nearer to another group than to its own.
    owners = _owners(gmsh, points[triangles].mean(axis=1), np.column_stack([groups, bodies]))
    volumes = _volumes(gmsh, owners)
    options = {
        "MeshSizeMax": way["largest"],
        "MeshSizeMin": way["smallest"],
        "MeshSizeFromCurvature": way["round"],
        "OptimizeThreshold": 0.5,
    }
    for name, value in options.items():
        gmsh.option.setNumber(f"Mesh.{name}", value)
    _generate(gmsh)
    _weld(gmsh)
    curved = way["order"] == 2 and _curve(gmsh)
    own = {tag: int(owner[0]) for tag, owner in owners.items()}
    _save(gmsh, folder / FILLED, volumes, own, order=2 if curved else 1)


def _surfaces(
    gmsh: ModuleType, points: FloatArray, triangles: IntArray, groups: IntArray, *, remesh: bool
) -> None:
    """Makes a discrete surface of each group; of these, if asked for, ones with parameters."""
    mesh = gmsh.model.mesh
    order = np.argsort(groups, kind="stable")
    starts = np.flatnonzero(np.diff(groups[order], prepend=-1))
    for k, rows in enumerate(np.split(order, starts[1:])):
        tag = gmsh.model.addDiscreteEntity(2)
        if k == 0:
            mesh.addNodes(2, tag, np.arange(1, len(points) + 1), points.ravel())
        mesh.addElementsByType(tag, _TRIANGLE, [], (triangles[rows] + 1).ravel())
    mesh.reclassifyNodes()
    if remesh:
        mesh.classifySurfaces(np.radians(_SHARP), True, True, np.pi)
        mesh.createGeometry()
    else:
        mesh.createTopology()


def _owners(gmsh: ModuleType, middles: FloatArray, owners: IntArray) -> dict[int, IntArray]:
    """Number of each surface to the group that it is in, and the bodies on both of its sides.

    Args:
        middles: Of the triangles given, of which Gmsh's surfaces still consist, shape (m, 3).
        owners: Group and bodies of each of these, shape (m, 3).
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(middles)
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    at = np.zeros((int(tags.max()) + 1, 3))
    at[tags] = coordinates.reshape(-1, 3)
    result = {}
    for _, tag in gmsh.model.getEntities(2):
        nodes = gmsh.model.mesh.getElementsByType(_TRIANGLE, tag)[1].reshape(-1, 3)
        rows = tree.query(at[nodes.astype(np.int64)].mean(axis=1))[1]
        every, count = np.unique(owners[rows], axis=0, return_counts=True)
        result[int(tag)] = every[np.argmax(count)]
    return result


def _volumes(gmsh: ModuleType, owners: Mapping[int, IntArray]) -> dict[int, int]:
    """Number of each volume to its body."""
    result = {}
    for body in sorted({int(b) for owner in owners.values() for b in owner[1:] if b >= 0}):
        around = [tag for tag, owner in owners.items() if body in owner[1:]]
        loop = gmsh.model.geo.addSurfaceLoop(around)
        result[int(gmsh.model.geo.addVolume([loop]))] = body
    gmsh.model.geo.synchronize()
    return result


def _generate(gmsh: ModuleType) -> None:
    gmsh.option.setNumber("General.AbortOnError", 1)
    gmsh.model.mesh.generate(3)
    empty = [e for e in gmsh.model.getEntities(3) if not len(gmsh.model.mesh.getElements(*e)[0])]
    if told := logged_errors(gmsh) or ("a body has no elements" if empty else ""):
        raise MeshError(f"Gmsh cannot fill it: {told}")


def _weld(gmsh: ModuleType) -> None:
    """Nodes at one place become one; cells and facets without extent between them are left out.

    On the parameters of a long surface two nodes may differ that are 1e-9 of its length apart.
    """
    mesh = gmsh.model.mesh
    gmsh.option.setNumber("Geometry.Tolerance", _SAME)
    mesh.removeDuplicateNodes()
    for dim, kind, corners in ((2, _TRIANGLE, 3), (3, _TETRAHEDRON, 4)):
        for _, tag in gmsh.model.getEntities(dim):
            numbers, nodes = mesh.getElementsByType(kind, tag)
            nodes = np.sort(np.asarray(nodes).reshape(-1, corners), axis=1)
            twice = (np.diff(nodes, axis=1) == 0).any(axis=1)
            if twice.any():
                mesh.removeElements(dim, tag, numbers[twice])


def _curve(gmsh: ModuleType) -> bool:
    """Makes cells quadratic whose surface is curved; folded ones follow it less.

    Gmsh's own optimisations are not asked: "HighOrder" may take half a minute for a thousand cells
    and end the process, and the results of both depend on addresses in memory, so on the run.
    """
    mesh = gmsh.model.mesh
    mesh.setOrder(2)
    if not is_curved(gmsh, 3):
        mesh.setOrder(1)
        return False
    straighten_folded(gmsh, 3, _HALVINGS)
    return True


def _save(
    gmsh: ModuleType,
    path: Path,
    volumes: Mapping[int, int],
    groups: Mapping[int, int],
    *,
    order: int,
) -> None:
    cell, facet = (_TETRAHEDRON, _TRIANGLE) if order == 1 else (_CURVED[3], _CURVED[2])
    blocks: dict[str, list[IntArray]] = {"cells": [], "bodies": [], "facets": [], "groups": []}
    for dim, kind, nodes, owner in ((3, cell, "cells", "bodies"), (2, facet, "facets", "groups")):
        for _, tag in gmsh.model.getEntities(dim):
            numbers, rows = gmsh.model.mesh.getElementsByType(kind, tag)
            blocks[nodes].append(np.asarray(rows, dtype=np.int64).reshape(len(numbers), -1))
            number = (volumes if dim == 3 else groups)[int(tag)]
            blocks[owner].append(np.full(len(numbers), number))
    arrays: dict[str, AnyArray] = {name: np.concatenate(parts) for name, parts in blocks.items()}
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    used = np.unique(arrays["cells"])
    rows = np.argsort(tags)[np.searchsorted(np.sort(tags), used)]
    arrays["points"] = np.asarray(coordinates).reshape(-1, 3)[rows]
    for name in ("cells", "facets"):
        arrays[name] = np.searchsorted(used, arrays[name])
    if order == 2:
        arrays["cells"] = arrays["cells"][:, _GMSH_TO_VTK]
    np.savez(path, allow_pickle=False, **arrays)
