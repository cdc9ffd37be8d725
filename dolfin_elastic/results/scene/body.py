"""The scene of a body without states, whose named parts are patches, on rank 0."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from dolfin_elastic.core.types import AnyArray, IndexArray, IntArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.geometry.curved import facet_points
from dolfin_elastic.mesh.geometry.simplices import prepare_facets
from dolfin_elastic.results.scene.edges import sharp_edges
from dolfin_elastic.results.scene.scene import Curve, Frame, Patch, Scene
from dolfin_elastic.results.scene.surface import gather_surface

BARE = "#d3d8de"
_COLOURS = (
    "#8fb8de",
    "#f2a07b",
    "#a5d08c",
    "#e5c95f",
    "#b8a1d9",
    "#7fcdc4",
    "#e79bb6",
    "#c3b091",
    "#9fc3f0",
    "#cdd86f",
    "#d6a3e0",
    "#f0bd8a",
)


def patch_colour(number: int) -> str:
    """Colour of a name or face."""
    return _COLOURS[number % len(_COLOURS)]


def body_scene(body: Body, names: Iterable[str]) -> Scene | None:
    """The surface of a body, or all of a plane one, on rank 0; None on the others. Collective.

    Args:
        names: Surfaces (regions of a plane body) that are coloured; without any CAD faces are.
    """
    names, plane = list(names), body.dim == 2
    parts = body.regions if plane else body.surfaces

    def marks(entities: IndexArray) -> AnyArray:
        faces: AnyArray = np.zeros(len(entities), dtype=np.int64)
        if body.faces is not None and not plane:
            faces = body.faces.numbers_of(entities)
        of_names = [np.isin(entities, parts.get(name, [])) for name in names]
        return np.column_stack([faces, *of_names]).astype(np.int64)

    surface = gather_surface(body.mesh, {}, of_faces=marks)
    curves = _curves(body) if plane else []
    if surface is None:
        return None
    assert surface.of_cells is not None
    rows, inverse = np.unique(surface.of_cells, axis=0, return_inverse=True)
    patch: IntArray = inverse.reshape(-1)
    patches = []
    for row in rows:
        face, own = int(row[0]), [int(i) for i in np.flatnonzero(row[1:])]
        number = own[0] if own else face if face and not names else None
        colour = BARE if number is None else patch_colour(number)
        patches.append(Patch(tuple(names[i] for i in own), face, colour))
    return Scene(
        surface.points,
        surface.triangles,
        sharp_edges(surface.points, surface.triangles, patch, (rows[:, 0] > 0)[patch]),
        (Frame("", np.zeros_like(surface.points)),),
        plane,
        patch=patch,
        patches=tuple(patches),
        curves=tuple(curves),
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
    result = []
    for label, named, facets in parts:
        x, _ = facet_points(body.mesh, facets, np.array([[0.0], [0.5], [1.0]]))
        every = np.concatenate(body.comm.allgather(x))
        result.append(Curve(label, named, np.pad(every, ((0, 0), (0, 0), (0, 1)))))
    return result
