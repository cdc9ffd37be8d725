"""`fill`: tetrahedra between the triangles of a `Plc`, made by Gmsh in a process of its own."""

from __future__ import annotations

import io
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from dolfinx import cpp
from dolfinx.mesh import CellType

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.mesh.formats.cad.process import Permission, gmsh_process, notes_of
from dolfin_elastic.mesh.formats.raw import Block, MeshFile
from dolfin_elastic.mesh.formats.surfaces.filling.bodies import bodies_of, region_volumes
from dolfin_elastic.mesh.formats.surfaces.filling.in_gmsh import FILLED, GIVEN
from dolfin_elastic.mesh.formats.surfaces.filling.plc import Plc
from dolfin_elastic.mesh.geometry.curved import cell_gradients, quadrature_rule
from dolfin_elastic.mesh.geometry.simplices import determinants, qualities

_LARGEST, _SMALLEST = 1 / 10, 1 / 200
"""Default sizes over the diagonal of the body, as for CAD files."""
_STEEPEST = 20.0
"""Largest over smallest size where one is given."""
_CAP = 10.0
"""Smallest size over the deviation: an edge of this size on a circle, of which it is an eighth, is
so far from it."""
_ROUNDS = 8.0, 12.0, 24.0
"""Elements round a circle, the coarser first."""
_FEW = 20_000
"""Cells of the way before it up to which the last of these is tried: on tubes of long triangles the
coarser ones may miss the volume, and the triangles given make cells without height."""
_VOLUME = 1e-3
"""Relative error of a volume from which on another way is tried."""
_FLAT = 1e-6
"""Height of a cell, over that of a regular one on its longest edge, below which it is none: Gmsh
may set nodes of a long surface on one line, which those of another size are not on."""
_OTHER = 1.1
"""Elements round a circle then, over those asked for."""
_KEPT = 1 / 4
"""Share of the time that is kept for the way that meets the volume exactly."""


@dataclass(frozen=True)
class _Way:
    """How a complex is filled; see `in_gmsh.fill_in_gmsh`."""

    remesh: bool
    order: int
    smallest: float
    largest: float
    round: float
    words: str


def fill(
    plc: Plc,
    *,
    source: str,
    size: float | None,
    deviation: float | None,
    curved: bool | None,
    permission: Permission,
    even: bool = False,
) -> MeshFile:
    """Fills the regions of a complex with tetrahedra. Local: one rank fills.

    New triangles on the surface, and quadratic cells that follow it, come first; where Gmsh fails
    or a volume is wrong by more than 0.1 %, finer ones do, and last the triangles given.  Parts of
    the complex become surfaces and regions by their names; quadratic cells have VTK's order.

    Args:
        source: Name of the file, for messages.
        size: Of the elements, in the file's unit; None: a tenth of the diagonal, and smaller ones
            where the surface is curved.
        deviation: Distance from the surface that does no harm: sizes by curvature are not smaller
            than it needs; None: 1/2000 of the diagonal.
        curved: False: straight cells.
        permission: Time that Gmsh may take.
        even: Sizes do not follow the curvature, which surfaces between voxels only pretend.

    Raises:
        MeshError: Gmsh cannot fill it.
    """
    bodies, regions = bodies_of(plc)
    wanted = region_volumes(plc)
    until = time.monotonic() + permission.seconds
    best: tuple[tuple[bool, float], _Way, Mapping[str, AnyArray]] | None = None
    error: MeshError | None = None
    ways = deque(_ways(plc, size, deviation, straight=curved is False, even=even))
    while ways:
        way = ways.popleft()
        if way.round == _ROUNDS[-1] and (best is None or len(best[2]["cells"]) > _FEW):
            continue
        left = until - time.monotonic() - (permission.seconds * _KEPT if way.remesh else 0.0)
        try:
            filled = _filled(plc, bodies, source, way, left)
        except MeshError as caught:
            error = error or caught
            continue
        volumes = np.bincount(
            regions[filled["bodies"]], cell_volumes(filled["points"], filled["cells"]), len(wanted)
        )
        flat = bool(qualities(filled["points"][filled["cells"][:, :4]]).min() < _FLAT)
        found = flat, float(np.abs(volumes / wanted - 1).max())
        if best is None or found < best[0]:
            best = found, way, filled
        if found[1] < _VOLUME and not flat:
            break
        if flat and way.round in _ROUNDS:
            ways.appendleft(replace(way, round=_OTHER * way.round))
    if best is None:
        raise error or MeshError("Gmsh cannot fill it", where=source)
    (_, miss), way, filled = best
    file = _file(plc, filled, regions)
    notes = list(notes_of(permission))
    if miss >= _VOLUME:
        notes.append(f"the volume of the elements differs by {miss:.1%} from that of the surface")
    order = "elements curved" if filled["cells"].shape[1] == 10 else ""
    words = ", ".join(filter(None, [f"filled by Gmsh, {way.words}", order]))
    return replace(file, notes=notes, information=[words])


def _ways(
    plc: Plc, size: float | None, deviation: float | None, *, straight: bool, even: bool
) -> Iterator[_Way]:
    """How it is tried, one way after the other."""
    diagonal = float(np.linalg.norm(np.ptp(plc.points, axis=0)))
    largest = _LARGEST * diagonal if size is None else size
    smallest = _SMALLEST * diagonal if size is None else size / _STEEPEST
    if deviation is not None:
        smallest = min(max(smallest, _CAP * deviation), largest)
    words = "default size" if size is None else f"size {size:.4g}"
    order = 1 if straight else 2
    if even:
        yield _Way(True, order, 0.0, largest, 0.0, words)
        yield _Way(True, order, 0.0, largest / 2, 0.0, f"{words}, halved for the volume's sake")
    else:
        for count in _ROUNDS:
            yield _Way(True, order, smallest, largest, count, words)
    yield _Way(False, 1, 0.0, largest, 0.0, f"{words}, with the file's own triangles")


def _filled(
    plc: Plc, bodies: IntArray, source: str, way: _Way, seconds: float
) -> Mapping[str, AnyArray]:
    """The arrays that `in_gmsh.fill_in_gmsh` writes."""
    content = io.BytesIO()
    np.savez(
        content,
        points=plc.points,
        triangles=plc.triangles,
        groups=_groups(plc)[1],
        bodies=bodies,
    )
    within = Permission(seconds=max(seconds, 1.0))
    files = {Path(GIVEN): content.getvalue()}
    with gmsh_process(Path(source), files, within) as (gmsh, folder):
        arguments: dict[str, object] = vars(way)
        gmsh.ask("fill", way=arguments)
        with np.load(folder / FILLED, allow_pickle=False) as data:
            return {name: data[name] for name in data.files}


def _groups(plc: Plc) -> tuple[IntArray, IntArray]:
    """The patch of each group of triangles that stay apart, and the group of each triangle."""
    keys = np.column_stack([plc.patches, plc.regions])
    found, groups = np.unique(keys, axis=0, return_inverse=True)
    return found[:, 0], groups.reshape(-1)


def _file(plc: Plc, filled: Mapping[str, AnyArray], regions: IntArray) -> MeshFile:
    """Cells and facets with their names."""
    points, cells, facets = filled["points"], filled["cells"], filled["facets"]
    patches = _groups(plc)[0][filled["groups"]]
    groups = {name: np.flatnonzero(np.isin(patches, of)) for name, of in plc.groups.items()}
    order = 1 if cells.shape[1] == 4 else 2
    return MeshFile(
        points,
        [
            Block(
                "tetra" if order == 1 else "tetra10",
                cells,
                _named(plc.region_names, regions[filled["bodies"]]),
            ),
            Block(
                "triangle" if order == 1 else "triangle6",
                facets,
                {**_named(plc.patch_names, patches), **groups},
            ),
        ],
    )


def _named(names: Sequence[str], numbers: IntArray) -> dict[str, IntArray]:
    """Name to the rows that carry it."""
    rows = {name: [k for k, other in enumerate(names) if other == name] for name in names if name}
    return {name: np.flatnonzero(np.isin(numbers, of)) for name, of in rows.items()}


def cell_volumes(points: FloatArray, cells: IntArray) -> FloatArray:
    """Volumes of tetrahedra, quadratic ones in VTK's order, shape (n,)."""
    degree = 1 if cells.shape[1] == 4 else 2
    inside, weights = quadrature_rule(3, 3 * (degree - 1))
    order = cpp.io.perm_vtk(CellType.tetrahedron, cells.shape[1])
    result = determinants(cell_gradients(points[cells[:, order]], degree, inside)) @ weights
    return np.asarray(np.abs(result) if degree == 1 else result)
