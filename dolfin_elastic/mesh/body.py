"""`Body`: a mesh whose parts have names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh, entities_to_geometry
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError, nearest
from dolfin_elastic.core.help.notebook import Shown
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.shapes.rigid_mesh import Facets
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.core.units import METRE, LengthUnit
from dolfin_elastic.mesh.faces import CadFaces
from dolfin_elastic.mesh.fields import MeshField, from_array
from dolfin_elastic.mesh.formats.cad.process import Permission
from dolfin_elastic.mesh.geometry.boundary_shape import BoundaryShape, KnownSurface
from dolfin_elastic.mesh.geometry.curved import (
    cell_volumes,
    edge_points,
    facet_areas,
    facet_quadrature,
    node_points,
)
from dolfin_elastic.mesh.geometry.simplices import boundary_facets

T = TypeVar("T")
_A = {"region": "a region", "surface": "a surface", "edge": "an edge", "point": "a point"}
"""Kinds of parts with their article."""


class PartNames(Mapping[str, T]):
    """Name to part.  A name is found as it is written, else as the only one that differs by case.

    Names of Abaqus do not distinguish capitals, and tools write one set in several ways; names of
    other formats that differ by case only are different names.  Iteration yields the names as the
    file has them.

    Args:
        others: Names of other parts of the same mesh: a name that is one of them is not taken for
            another one here that differs by case.
    """

    def __init__(self, parts: Mapping[str, T], others: Iterable[str] = ()) -> None:
        self._parts = dict(parts)
        self._every = {*self._parts, *others}
        self._caseless: dict[str, list[str]] = {}
        for name in sorted(self._every):
            self._caseless.setdefault(name.casefold(), []).append(name)

    def alike(self, name: str) -> list[str]:
        """The names that this one may mean: itself, else all that differ from it by case only."""
        return [name] if name in self._every else self._caseless.get(name.casefold(), [])

    def __getitem__(self, name: str) -> T:
        alike = self.alike(name)
        if len(alike) != 1:
            raise KeyError(name)
        return self._parts[alike[0]]

    def __contains__(self, name: object) -> bool:
        if not isinstance(name, str):
            return False
        alike = self.alike(name)
        return len(alike) == 1 and alike[0] in self._parts

    def __iter__(self) -> Iterator[str]:
        return iter(self._parts)

    def __len__(self) -> int:
        return len(self._parts)

    def __repr__(self) -> str:
        return f"PartNames({self._parts!r})"


class SurfaceNames(PartNames[IndexArray]):
    """Name to facets; what is no name is one of CAD faces by number or size, "hole r 4.5".

    Args:
        faces: The faces of the CAD file; None: of a finished mesh.
    """

    def __init__(
        self, parts: Mapping[str, IndexArray], others: Iterable[str], faces: CadFaces | None
    ) -> None:
        super().__init__(parts, others)
        self._faces = faces

    def _on_faces(self, name: str) -> tuple[int, ...]:
        return () if self._faces is None or self.alike(name) else self._faces.named(name)

    def __getitem__(self, name: str) -> IndexArray:
        if self._faces is not None and (numbers := self._on_faces(name)):
            return self._faces.facets_of(numbers)
        return super().__getitem__(name)

    def __contains__(self, name: object) -> bool:
        return super().__contains__(name) or (isinstance(name, str) and bool(self._on_faces(name)))


@dataclass(frozen=True)
class CadSource:
    """The CAD file that a mesh was made of.

    Attributes:
        path: The file.
        scale: Metres per unit of length of Gmsh's model of it.
        permission: What Gmsh may do when it reads the file again.
    """

    path: Path
    scale: float
    permission: Permission


class MeshFields(dict[str, MeshField]):
    """Name to field of a body; ``body.fields["mu"] = array`` makes one, or replaces it. Collective.

    An array has a row for each cell, or for each point of `mesh.geometry`, of this rank: of the
    owned ones, whose values the ghosts then get, or of all; in the order of the mesh.  Of an array
    `every` in the order of the cells (points) that the mesh was made of, the rows of this rank are
    ``every[mesh.topology.original_cell_index]`` (``every[mesh.geometry.input_global_indices]``).
    """

    def __init__(self, mesh: Mesh, given: Mapping[str, MeshField]) -> None:
        super().__init__(given)
        self._mesh = mesh

    def __setitem__(self, name: str, values: MeshField | npt.ArrayLike) -> None:
        """See the class.

        Args:
            values: Shape (rows,) or (rows, columns); or a `MeshField`, whose rows include ghosts.

        Raises:
            MeshError: See `from_array`.
        """
        if not isinstance(values, MeshField):
            values = from_array(self._mesh, values, name)
        super().__setitem__(name, values)


@dataclass(frozen=True, repr=False)
class Body(Shown):
    """A distributed mesh in the reference configuration, in metres, with named parts.

    Parts may overlap: each is a set of cells, facets, edges or nodes, not a tag.  A name may stand
    for parts of several dimensions, such as a set of nodes and the surface that they hold.

    Attributes:
        mesh: Tetrahedra (3D) or triangles (2D), of geometric degree 1 or 2.
        regions: Name to the local cells of this rank (owned and ghost), sorted.
        surfaces: Name to the local facets of this rank (owned and ghost), sorted.
        source: Where the mesh came from, for messages.
        fields: Name to values at cells or points, from the mesh file or set: see `MeshFields`.
        notes: Faults found while reading, and what is doubtful.
        cad: The CAD file it was made of, if it was.
        faces: The faces of that file, and the facets on them.
        edges: Name to the local mesh edges of this rank (owned and ghost), sorted; in 3D only, the
            edges of a plane body are its surfaces.
        points: Name to the local nodes of the mesh's geometry (rows of `mesh.geometry.x`), owned
            and ghost, sorted: vertices, and midside nodes of quadratic cells.
        uncovered: Name of a set of nodes that is a surface too, to the number of its nodes that
            lie on no facet of that surface: loads and supports that need its area are refused.
        incomplete: Name of a part some of whose members in the file are missing in the mesh, to
            the reason with their number; it is no part of the body, and a case that refers to it
            is refused with that reason.
        unit: Unit of length of the file, in which messages give places.
        information: How the mesh was made, and corrections without effect.
        known_surface: What is known of the surface for which the facets of the boundary stand.
        obstacles: Surfaces of rigid bodies beside it, by `RigidMesh.key`, that have been read.

    Names are found whatever the case of their letters, see `PartNames`.
    """

    mesh: Mesh
    regions: Mapping[str, IndexArray] = field(default_factory=dict)
    surfaces: Mapping[str, IndexArray] = field(default_factory=dict)
    source: str = ""
    notes: tuple[str, ...] = ()
    fields: dict[str, MeshField] = field(default_factory=dict)
    cad: CadSource | None = None
    faces: CadFaces | None = None
    edges: Mapping[str, IndexArray] = field(default_factory=dict)
    points: Mapping[str, IndexArray] = field(default_factory=dict)
    uncovered: Mapping[str, int] = field(default_factory=dict)
    incomplete: Mapping[str, str] = field(default_factory=dict)
    unit: LengthUnit = METRE
    information: tuple[str, ...] = ()
    known_surface: KnownSurface | None = None
    obstacles: Mapping[str, Facets] = field(default_factory=dict)
    _shapes: list[BoundaryShape] = field(
        default_factory=list, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        tables = ("regions", "surfaces", "edges", "points", "uncovered", "incomplete")
        every = {name for table in tables for name in getattr(self, table)}
        for table in tables:  # the only way to complete an object that is frozen
            object.__setattr__(self, table, PartNames(getattr(self, table), every))
        object.__setattr__(self, "fields", MeshFields(self.mesh, self.fields))
        object.__setattr__(self, "surfaces", SurfaceNames(self.surfaces, every, self.faces))

    def __repr__(self) -> str:
        """In a line: where it comes from, its size, and the names of its parts."""
        parts = (f"{kind}s {', '.join(names)}" for kind, names in self.parts.items() if names)
        return f"<Body {self.source}: {'; '.join([f'{self.num_cells} elements', *parts])}>"

    @property
    def comm(self) -> MPI.Comm:
        """The communicator the mesh lives on."""
        comm: MPI.Comm = self.mesh.comm
        return comm

    @property
    def dim(self) -> int:
        """Dimension of the space the body lives in: 3, or 2 for plane strain."""
        return int(self.mesh.geometry.dim)

    @property
    def num_cells(self) -> int:
        """Number of cells on all ranks."""
        return int(self.mesh.topology.index_map(self.mesh.topology.dim).size_global)

    # --- named parts ---

    @property
    def parts(self) -> dict[str, Mapping[str, IndexArray]]:
        """Kind of part to all parts of that kind, the highest dimension first."""
        return {
            "region": self.regions,
            "surface": self.surfaces,
            "edge": self.edges,
            "point": self.points,
        }

    def kinds(self, name: str) -> tuple[str, ...]:
        """The kinds of part that a name stands for, of "region", "surface", "edge", "point"."""
        return tuple(kind for kind, parts in self.parts.items() if name in parts)

    def check_whole(self, name: str) -> None:
        """Checks that the mesh has all members that the file gives a part of this name.

        Raises:
            MeshError: Some are missing, or the name may mean several parts.
        """
        if name in self.incomplete:
            raise MeshError(
                f"'{name}' of {self.source or 'the mesh'} is incomplete: {self.incomplete[name]}",
                expected="correct the mesh file, or name the part by where it lies",
            )
        alike = _alike(self, name)
        if len(alike) > 1:
            names = " or ".join(f"'{other}'" for other in alike)
            raise MeshError(f"'{name}' may mean {names}", expected="write it as the mesh file does")

    def part(self, kind: str, name: str) -> IndexArray:
        """Local cells, facets, edges or nodes of a part.

        Args:
            kind: "region", "surface", "edge" or "point".

        Raises:
            MeshError: There is none, or it is of another kind or not whole; or the area is needed
                of a set of nodes that facets do not cover.
        """
        self.check_whole(name)
        if name in self.parts[kind]:
            if kind == "surface" and (missed := self.uncovered.get(name)):
                raise MeshError(
                    f"the set of nodes '{name}' is no surface: no facet of it holds "
                    f"{missed} of its nodes",
                    expected="a displacement can be prescribed on it; for all else, a surface",
                )
            return self.parts[kind][name]
        others = self.kinds(name)
        near = nearest(name, {n for parts in self.parts.values() for n in parts})
        if self.faces is not None and kind == "surface":
            near = "; ".join(filter(None, (near, self.faces.alike(name))))
        if others:
            raise MeshError(
                f"'{name}' is {_A[others[0]]}, not {_A[kind]}",
                expected=nearest("", self.parts[kind]),
            )
        raise MeshError(
            f"no {kind} '{name}' in {self.source or 'the mesh'}",
            expected=near,
        )

    def common_kind(self, names: Sequence[str]) -> str:
        """The kind of highest dimension, but for regions, that all names stand for.

        Args:
            names: At least one.

        Raises:
            MeshError: There is none.
        """
        for kind in ("surface", "edge", "point"):
            if all(name in self.parts[kind] for name in names):
                return kind
        for name in names:
            if not set(self.kinds(name)) - {"region"}:
                self.surface(name)  # raises
        raise MeshError(
            f"{', '.join(repr(name) for name in names)} are of several dimensions",
            expected="name surfaces, edges and points apart",
        )

    def region(self, name: str) -> IndexArray:
        """Local cells of a named region; see `part`."""
        return self.part("region", name)

    def surface(self, name: str) -> IndexArray:
        """Local facets of a named surface; see `part`."""
        return self.part("surface", name)

    def edge(self, name: str) -> IndexArray:
        """Local mesh edges of a named edge of a three-dimensional body; see `part`."""
        return self.part("edge", name)

    def point(self, name: str) -> IndexArray:
        """Local geometry nodes of a named point or set of nodes; see `part`."""
        return self.part("point", name)

    def mesh_field(self, name: str) -> MeshField:
        """A field that the mesh came with.

        Raises:
            MeshError: The name does not exist.
        """
        if name not in self.fields:
            raise MeshError(
                f"no field '{name}' in {self.source or 'the mesh'}",
                expected=nearest(name, self.fields),
            )
        return self.fields[name]

    def owned_cells(self, name: str | None = None) -> IndexArray:
        """Local cells of a region (of the whole body by default) that this rank owns."""
        size = self.mesh.topology.index_map(self.mesh.topology.dim).size_local
        if name is None:
            return np.arange(size, dtype=np.int32)
        cells = self.region(name)
        return np.asarray(cells[cells < size])

    def owned_facets(self, name: str) -> IndexArray:
        """Local facets of a surface that this rank owns."""
        facets = self.surface(name)
        size = self.mesh.topology.index_map(self.mesh.topology.dim - 1).size_local
        return np.asarray(facets[facets < size])

    def owned_edges(self, name: str) -> IndexArray:
        """Local mesh edges of a named edge that this rank owns."""
        edges = self.edge(name)
        return np.asarray(edges[edges < self.mesh.topology.index_map(1).size_local])

    def owned_points(self, name: str) -> IndexArray:
        """Local geometry nodes of a named point that this rank owns."""
        nodes = self.point(name)
        return np.asarray(nodes[nodes < self.mesh.geometry.index_map().size_local])

    def count(self, name: str) -> int:
        """Number of facets of a surface on all ranks. Collective."""
        facets, size = self.surfaces[name], self.mesh.topology.index_map(self.dim - 1).size_local
        return int(total(self.comm, int(np.count_nonzero(facets < size))))

    def named(
        self,
        *,
        regions: Mapping[str, IndexArray] | None = None,
        surfaces: Mapping[str, IndexArray] | None = None,
        edges: Mapping[str, IndexArray] | None = None,
        points: Mapping[str, IndexArray] | None = None,
    ) -> Body:
        """The body with further named parts; those of the same name and kind are replaced.

        Args:
            regions: Name to local cells, sorted.
            surfaces: Name to local facets, sorted.
            edges: Name to local mesh edges, sorted.
            points: Name to local geometry nodes, sorted.
        """
        given = {*(regions or ()), *(surfaces or ()), *(edges or ()), *(points or ())}
        return replace(
            self,
            incomplete={n: why for n, why in self.incomplete.items() if n not in given},
            regions={**self.regions, **(regions or {})},
            surfaces={**self.surfaces, **(surfaces or {})},
            edges={**self.edges, **(edges or {})},
            points={**self.points, **(points or {})},
        )


def boundary_shape(body: Body) -> BoundaryShape:
    """Edges and arcs of a body's boundary; found once. Collective."""
    if not body._shapes:
        body._shapes.append(BoundaryShape(body.mesh, body.known_surface))
    return body._shapes[0]


def spelling(body: Body, name: str) -> str:
    """A part's name as the mesh has it, see `PartNames`; of an unknown part the name itself.

    Args:
        name: In any case.
    """
    alike = _alike(body, name)
    return alike[0] if len(alike) == 1 else name


def _alike(body: Body, name: str) -> list[str]:
    assert isinstance(body.regions, PartNames)  # since it was made
    return body.regions.alike(name)


def extent(body: Body) -> tuple[float, ...]:
    """Sides of the body's bounding box [m]. Collective."""
    columns = body.mesh.geometry.x[:, : body.dim].T  # one by one: five times as fast
    most = [column.max(initial=-np.inf) for column in columns]
    corners = np.array(most + [-column.min(initial=np.inf) for column in columns])
    everywhere = np.empty_like(corners)
    body.comm.Allreduce(corners, everywhere, op=MPI.MAX)
    return tuple(float(side) for side in everywhere[: body.dim] + everywhere[body.dim :])


def span(body: Body) -> float:
    """Diagonal of the body's bounding box [m]. Collective."""
    return float(np.linalg.norm(extent(body)))


def centre_of(body: Body, surfaces: Sequence[str]) -> FloatArray:
    """Centre of the facets of surfaces by their areas, of curved ones too [m]. Collective."""
    mesh, dim = body.mesh, body.dim
    facets = np.unique(np.concatenate([body.owned_facets(name) for name in surfaces]))
    mesh.topology.create_connectivity(dim - 1, dim)
    mesh.topology.create_connectivity(dim, dim - 1)
    if mesh.geometry.cmap.degree > 1:
        points = facet_quadrature(mesh, facets, 1)
        return _centre(body, points.weights, points.X)
    # Of flat facets the middle of the corners.
    corners = np.empty((0, dim), dtype=np.int32)
    if len(facets):  # DOLFINx 0.9 divides by their number
        corners = entities_to_geometry(mesh, dim - 1, facets.astype(np.int32))[:, :dim]
    x = mesh.geometry.x[corners][..., :dim]
    edges = x[:, 1:] - x[:, :1]
    areas = np.linalg.norm(edges[:, 0] if dim == 2 else np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return _centre(body, areas[:, None], x.mean(axis=1, keepdims=True))


def middle_of(body: Body, names: Sequence[str]) -> FloatArray:
    """Centre of the parts of highest dimension among some [m]. Collective.

    A set of nodes that facets do not cover counts as points.

    Args:
        names: Of surfaces, edges and points, each once.

    Raises:
        MeshError: A name is none of such a part.
    """
    kinds = {n: "point" if n in body.uncovered else body.common_kind([n]) for n in names}
    kind = next(kind for kind in ("surface", "edge", "point") if kind in kinds.values())
    highest = [name for name in names if kinds[name] == kind]
    if kind == "surface":
        return centre_of(body, highest)
    pick = body.owned_edges if kind == "edge" else body.owned_points
    entities = np.unique(np.concatenate([pick(name) for name in highest]))
    points = (
        edge_points(body.mesh, entities, 1) if kind == "edge" else node_points(body.mesh, entities)
    )
    return _centre(body, points.weights, points.X)


def _centre(body: Body, weights: FloatArray, X: FloatArray) -> FloatArray:
    """Weighted mean of the points of all ranks, of shapes (entities, points) and (..., dim).

    Not a number where there are none.
    """
    moments = np.einsum("ep,epj->j", weights, X)
    sums = total(body.comm, np.append(moments, weights.sum()))
    return np.asarray(sums[:-1] / sums[-1] if sums[-1] else np.full(body.dim, np.nan))


def cell_size(body: Body) -> float:
    """About the edge length of a cell [m]. Collective."""
    return span(body) / float(body.num_cells ** (1 / body.dim))


def mean_thickness(body: Body) -> float:
    """Twice the volume over the surface [m]: of a plate its thickness, of a square bar half a side.

    Of a plane body twice the area over the boundary.  Collective.
    """
    mesh = body.mesh
    volume = float(cell_volumes(mesh)[body.owned_cells()].sum())
    area = float(facet_areas(mesh, boundary_facets(mesh)).sum())
    volume, area = total(body.comm, np.array([volume, area]))
    return 2 * float(volume / area)


def connected_components(size: int, sets: IntArray | IndexArray) -> tuple[int, IntArray]:
    """The connected components of nodes, of which sets are given that belong together.

    Trees that point to smaller numbers are hooked onto each other and flattened until each is a
    component.  Not by `scipy.sparse.csgraph`: to import it takes longer than all the rest of a
    small `check`, and every run asks whether the body is one.

    Source: Y. Zhang, A. Azad, Z. Hu, Proc. SIAM PP20 (2020) 46, doi:10.1137/1.9781611976137.5.

    Args:
        sets: Nodes of each set, such as the cells of a mesh or the edges of a graph, shape (n, m).

    Returns:
        How many components there are, and that of each node, shape (size,): numbers from 0 in the
        order of their first nodes.
    """
    parent: IntArray = np.arange(size, dtype=np.int64)
    while True:
        roots = parent[sets]
        lowest = roots.min(axis=1, initial=size)
        if np.array_equal(roots, np.broadcast_to(lowest[:, None], roots.shape)):
            break
        for column in roots.T:
            np.minimum.at(parent, column, lowest)
        while not np.array_equal(flat := parent[parent], parent):
            parent = flat
    first, number = np.unique(parent, return_inverse=True)
    return len(first), np.asarray(number, dtype=np.int64)
