"""Finer cells in a finished mesh: all of them, or those of named parts, spheres and boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dolfin_elastic.core.errors import MeshError, nearest
from dolfin_elastic.core.files.memory import check_memory
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.core.units import metres
from dolfin_elastic.mesh.body import Body, spelling
from dolfin_elastic.mesh.geometry.simplices import cell_corners, prepare_facets
from dolfin_elastic.mesh.local_size import MOST_CELLS, LocalSize
from dolfin_elastic.mesh.refine.refinement import refine_body

_BYTES = {2: 900, 3: 1300}
"""Memory per element of the finer mesh [byte], by dimension: both meshes are there at the peak.

Measured as in `mesh/distribute.py`, of 3e5 elements after two refinements: 840 of a square,
1214 and 1323 of cubes.
"""


def refined_uniformly(body: Body, times: int) -> Body:
    """The body with every edge of its cells halved so many times. Collective.

    Raises:
        MeshError: There would be too many cells.
    """
    _check_count(body, float(body.num_cells) * 2.0 ** (body.dim * times), "mesh.refine")
    coarse = body
    for _ in range(times):
        body = refine_body(body, body.owned_cells()).body
    return _with_remarks(coarse, body, f"uniformly {times} time{'s' if times > 1 else ''}")


def refined_locally(body: Body, sizes: Sequence[LocalSize]) -> Body:
    """The body with its cells divided until they are as small as asked for. Collective.

    The size of a cell is the mean length of its edges.  Neighbours are divided as far as it takes
    to leave no node hanging.

    Args:
        sizes: Where, and how small; bare numbers are in the body's unit.

    Raises:
        MeshError: A name does not exist, there is nothing in a place, or there would be too many
            cells.
    """
    coarse, information = body, []
    for index, one in enumerate(sizes):
        where = f"mesh.refine[{index}]"
        size = metres(one.size, body.unit.metres)
        _check_count(body, body.num_cells + _more(body, one, size, where), f"{where}.size")
        information.append(one.words(body.unit))
        while True:
            inside = _inside(body, one, where)
            if not total(body.comm, int(np.count_nonzero(inside))):
                raise MeshError(
                    f"there is no element in {one.place()}",
                    where=where,
                    expected=f"a point in the body; lengths without a unit are in {body.unit.name}",
                )
            marked = np.flatnonzero(inside & (_lengths(body).mean(axis=1) > size))
            count = total(body.comm, len(marked))
            if not count:
                break
            _check_count(body, body.num_cells + count * (2.0**body.dim - 1.0), f"{where}.size")
            body = refine_body(body, marked.astype(np.int32)).body
    return _with_remarks(coarse, body, f"to {', '.join(information)}")


def _with_remarks(coarse: Body, body: Body, how: str) -> Body:
    """The refined body, also with the remarks about the one that was read."""
    notes = tuple(dict.fromkeys((*coarse.notes, *body.notes)))
    text = f"refined {how}: {coarse.num_cells} elements before"
    return replace(body, notes=notes, information=(*coarse.information, text))


def _check_count(body: Body, cells: float, where: str) -> None:
    """Refuses refinements that are meant otherwise, or do not fit into the memory. Collective."""
    if cells > MOST_CELLS:
        raise MeshError(
            f"refined like this {body.source or 'the mesh'} would have about {cells:.1g} elements",
            where=where,
            expected=f"at most {MOST_CELLS:.0g}; lengths without a unit are in {body.unit.name}",
        )
    more, each = cells - body.num_cells, _BYTES[body.dim]
    check_memory(body.comm, more, each, where=where, expected="less refinement")


def _more(body: Body, one: LocalSize, size: float, where: str) -> float:
    """About how many cells more there will be, rather too few than too many. Collective.

    Cells of a region are divided as a whole, those at a surface along it.  A sphere or box may be
    much smaller than a cell; a cell of edge h fills about h^3/8 (h^2/2) of it.
    """
    d, unit, inside = body.dim, body.unit.metres, _inside(body, one, where)
    along = any(spelling(body, name) not in body.regions for name in one.parts)
    ratio = np.maximum(_lengths(body)[inside].mean(axis=1) / size, 1.0) ** (d - 1 if along else d)
    more = total(body.comm, float(ratio.sum() - len(ratio)))
    if one.parts:
        return more
    volume = one.shape(unit, d, where).volume(d)
    return min(more, volume / size**d * (8 if d == 3 else 2))


def _lengths(body: Body) -> FloatArray:
    """Lengths of the edges of each owned cell [m], shape (cells, edges)."""
    corners = cell_corners(body.mesh, body.owned_cells())
    pairs = [(i, j) for i in range(body.dim + 1) for j in range(i)]
    return np.stack([np.linalg.norm(corners[:, i] - corners[:, j], axis=1) for i, j in pairs], 1)


def _inside(body: Body, one: LocalSize, where: str) -> BoolArray:
    """Which owned cells belong to a place: have a vertex in it, or are of a region. Collective."""
    cells = body.owned_cells()
    mask = np.zeros(len(cells), dtype=bool)
    for name in one.parts:
        mask |= _of_part(body, name, f"{where}.on")
    if one.parts:
        return mask
    corners = cell_corners(body.mesh, cells)
    outside = one.shape(body.unit.metres, body.dim, where).outside
    mask = outside(corners).min(axis=1, initial=np.inf) <= 0.0
    if not total(body.comm, int(np.count_nonzero(mask))):
        # The place may lie between the vertices of a cell: these are the cells that may hold it.
        mask = outside(corners.mean(axis=1)) <= _lengths(body).max(axis=1, initial=0.0)
    return mask


def _of_part(body: Body, name: str, where: str) -> BoolArray:
    """Owned cells of a region, or with a vertex on a surface. Collective."""
    size = len(body.owned_cells())
    name = spelling(body, name)
    if name in body.regions:
        mask = np.zeros(size, dtype=bool)
        mask[body.owned_cells(name)] = True
        return mask
    if name not in body.surfaces:
        known = {*body.regions, *body.surfaces}
        advice = nearest(name, known)
        if body.faces is not None:
            advice = f"{advice}; {body.faces.alike(name)}"
        raise MeshError(f"there is no surface or region '{name}'", where=where, expected=advice)
    return _touching(body, name)


def _touching(body: Body, name: str) -> BoolArray:
    """Owned cells that have a vertex on a surface, also those of other ranks. Collective."""
    from dolfin_elastic.core.ghosts import marked

    mesh = body.mesh
    prepare_facets(mesh)
    d = mesh.topology.dim
    mesh.topology.create_connectivity(d - 1, 0)
    mesh.topology.create_connectivity(d, 0)
    links = mesh.topology.connectivity(d - 1, 0).array.reshape(-1, d)
    marks = marked(mesh.topology.index_map(0), links[body.surface(name)])
    vertices = mesh.topology.connectivity(d, 0).array.reshape(-1, d + 1)
    return np.asarray(marks[vertices[body.owned_cells()]].any(axis=1))
