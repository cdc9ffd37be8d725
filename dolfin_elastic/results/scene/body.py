"""`Scene`: the surface of a body on rank 0, with what is drawn on it; the mesh is not gathered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.shapes.shapes import Shape
from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.geometry.curved import facet_points, shape_functions
from dolfin_elastic.mesh.geometry.simplices import (
    boundary_facets,
    outward_normals,
    prepare_facets,
)
from dolfin_elastic.results.scene.scene import Up

_DIVISIONS, _FEW = (3, 6), 2000
"""Divisions of the sides of curved facets: of many, and of fewer than this number."""
_MOST_PLACES = 14
"""Symbols of a support or arrows of a load."""


@dataclass(frozen=True)
class Patch:
    """Triangles that are drawn in one colour with one label.

    Attributes:
        face: Number of their CAD face, or 0.
        names: Of the surfaces, or regions of a plane body, that they belong to.
    """

    face: int
    names: tuple[str, ...]


@dataclass(frozen=True)
class Symbols:
    """Symbols at places of the body.

    Attributes:
        kind: "support", "load" or "contact".
        label: What stands beside them.
        places: [m], shape (n, 3).
        directions: Unit vectors of forces, or outward normals of supports, shape (n, 3).
        normals: Outward normals, or zero, shape (n, 3).
    """

    kind: str
    label: str
    places: FloatArray
    directions: FloatArray
    normals: FloatArray


@dataclass(frozen=True)
class Curve:
    """A surface of a plane body, which is a curve.

    Attributes:
        label: Its name or number.
        named: It has a name.
        pieces: Points along each of its facets [m], shape (n, 3, 3): facet, point, coordinate.
    """

    label: str
    named: bool
    pieces: FloatArray


@dataclass(frozen=True)
class Scene:
    """All that a picture shows.

    Attributes:
        title: Above it.
        points: [m], shape (n, 3).
        triangles: Rows of points, shape (m, 3).
        patch: The patch of each triangle, shape (m,).
        patches: They.
        plane: The body is plane.
        symbols: Of supports, loads and contacts.
        obstacles: Of contacts: what stands beside each, to its shape in metres.
        curves: Surfaces of a plane body.
        legend: Name of a surface to what it is for.
        up: Axis that is up in the picture of a solid.
    """

    title: str
    points: FloatArray
    triangles: AnyArray
    patch: AnyArray
    patches: tuple[Patch, ...]
    plane: bool
    symbols: Sequence[Symbols] = ()
    obstacles: Mapping[str, Shape] = field(default_factory=dict)
    curves: Sequence[Curve] = ()
    legend: Mapping[str, str] = field(default_factory=dict)
    up: Up = "z"


def gather_scene(body: Body, title: str, legend: Mapping[str, str]) -> Scene | None:
    """The surface of a body, or all of a plane one, on rank 0; None on the others. Collective.

    Args:
        legend: Name to what it is for; surfaces (regions of a plane body) that are coloured.
    """
    points, triangles, faces, marks = (
        _plane_share(body, legend) if body.dim == 2 else _solid_share(body, legend)
    )
    curves = _curves(body) if body.dim == 2 else []
    shares = body.comm.gather((points, triangles, faces, marks))
    if shares is None:
        return None
    starts = np.cumsum([0, *(len(share[0]) for share in shares)])
    triangles = np.concatenate([s[1] + at for s, at in zip(shares, starts, strict=False)])
    keys = np.column_stack(
        [np.concatenate([s[2] for s in shares]), np.concatenate([s[3] for s in shares])]
    )
    unique, patch = np.unique(keys, axis=0, return_inverse=True)
    names = list(legend)
    patches = [
        Patch(int(row[0]), tuple(n for n, mark in zip(names, row[1:], strict=True) if mark))
        for row in unique
    ]
    every = np.concatenate([share[0] for share in shares])
    return Scene(
        title,
        every,
        triangles,
        patch.reshape(-1),
        tuple(patches),
        body.dim == 2,
        curves=curves,
        legend=legend,
    )


_Share = tuple[FloatArray, AnyArray, AnyArray, AnyArray]
"""Points, triangles, the face of each, and whether it belongs to each name."""


def _divisions(body: Body, count: int) -> int:
    """Divisions of the sides of facets or cells, of which this rank has `count`. Collective."""
    few = total(body.comm, count) < _FEW
    return 1 if int(body.mesh.geometry.cmap.degree) == 1 else _DIVISIONS[int(few)]


def _solid_share(body: Body, legend: Mapping[str, str]) -> _Share:
    facets = boundary_facets(body.mesh)
    lattice, pieces = _lattice(_divisions(body, len(facets)))
    x, _ = facet_points(body.mesh, facets, lattice)
    faces: AnyArray = np.zeros(len(facets), dtype=np.int64)
    if body.faces is not None:
        faces = body.faces.numbers_of(facets)
    marks = np.zeros((len(facets), len(legend)), dtype=np.int64)
    for column, name in enumerate(legend):
        if name in body.surfaces:
            marks[:, column] = np.isin(facets, body.surfaces[name])
    return _triangles(x, pieces, faces, marks)


def _plane_share(body: Body, legend: Mapping[str, str]) -> _Share:
    cells = body.owned_cells()
    lattice, pieces = _lattice(_divisions(body, len(cells)))
    nodes = body.mesh.geometry.x[body.mesh.geometry.dofmap[cells], :2]
    x = np.einsum("pn,cnj->cpj", shape_functions(body.mesh, lattice), nodes)
    marks = np.zeros((len(cells), len(legend)), dtype=np.int64)
    for column, name in enumerate(legend):
        if name in body.regions:
            marks[:, column] = np.isin(cells, body.regions[name])
    return _triangles(
        np.pad(x, ((0, 0), (0, 0), (0, 1))), pieces, np.zeros(len(cells), dtype=np.int64), marks
    )


def _curves(body: Body) -> list[Curve]:
    """Named surfaces of a plane body, and curves of its CAD file, on all ranks. Collective."""
    prepare_facets(body.mesh)
    names = sorted(body.surfaces.keys() - body.uncovered.keys())
    parts, named_numbers = list[tuple[str, bool, IndexArray]](), set[int]()
    for name in names:
        facets, numbers = body.owned_facets(name), set[int]()
        if body.faces is not None:
            own = np.unique(body.faces.numbers_of(facets)).tolist()
            numbers = {int(n) for share in body.comm.allgather(own) for n in share if n}
        also = f" ({', '.join(map(str, sorted(numbers)))})" if numbers else ""
        parts.append((name + also, True, facets))
        named_numbers |= numbers
    size = body.mesh.topology.index_map(1).size_local
    if body.faces is not None:
        for number in sorted(body.faces.faces.keys() - named_numbers):
            facets = body.faces.facets_of([number])
            parts.append((str(number), False, facets[facets < size]))
    found = []
    for label, named, facets in parts:
        x, _ = facet_points(body.mesh, facets, np.array([[0.0], [0.5], [1.0]]))
        every = np.concatenate(body.comm.allgather(x))
        found.append(Curve(label, named, np.pad(every, ((0, 0), (0, 0), (0, 1)))))
    return found


def _triangles(x: AnyArray, pieces: AnyArray, faces: AnyArray, marks: AnyArray) -> _Share:
    """Facets divided into triangles; arguments of facets, shape (n, points, 3) and (n, ...)."""
    first = np.arange(len(x))[:, None, None] * x.shape[1]
    return (
        np.asarray(x.reshape(-1, 3), dtype=np.float64),
        (first + pieces[None]).reshape(-1, 3),
        np.repeat(faces, len(pieces)),
        np.repeat(marks, len(pieces), axis=0),
    )


def _lattice(n: int) -> tuple[FloatArray, AnyArray]:
    """Points of the reference triangle divided n times along its sides, and the triangles."""
    number = {(p, q): 0 for q in range(n + 1) for p in range(n + 1 - q)}
    number = {key: i for i, key in enumerate(number)}
    pieces = []
    for (p, q), here in number.items():
        if p + q < n:
            pieces.append((here, number[p + 1, q], number[p, q + 1]))
        if p + q < n - 1:
            pieces.append((number[p + 1, q], number[p + 1, q + 1], number[p, q + 1]))
    return np.array(list(number), dtype=np.float64) / n, np.array(pieces)


def spread_facets(body: Body, facets: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Middles and outward normals of some facets that lie far from each other. Collective.

    Args:
        facets: Local facets.

    Returns:
        Both on all ranks, shape (n, 3).
    """
    size = body.mesh.topology.index_map(body.dim - 1).size_local
    owned = facets[facets < size]
    inner = np.full((1, body.dim - 1), 1.0 / body.dim)
    x = facet_points(body.mesh, owned, inner)[0][:, 0]
    n = outward_normals(body.mesh, owned)
    chosen = _spread(x)
    shares = body.comm.allgather((x[chosen], n[chosen]))
    every, normals = (np.concatenate([share[i] for share in shares]) for i in (0, 1))
    last = _spread(every)
    wide = ((0, 0), (0, 3 - body.dim))
    return np.pad(every[last], wide), np.pad(normals[last], wide)


def _spread(x: AnyArray) -> AnyArray:
    """Rows of points, each the farthest from those before: T. F. Gonzalez, TCS 38 (1985) 293."""
    if not len(x):
        return np.empty(0, dtype=np.int64)
    chosen = [int(np.lexsort(np.round(x, 9).T)[0])]
    away = np.linalg.norm(x - x[chosen[0]], axis=1)
    while len(chosen) < min(_MOST_PLACES, len(x)) and away.max() > 0:
        chosen.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(x - x[chosen[-1]], axis=1))
    return np.array(chosen)
