"""`Body`: a mesh whose parts have names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError, nearest
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import IndexArray
from dolfin_elastic.mesh.fields import MeshField


@dataclass(frozen=True)
class CadSource:
    """The CAD file that a mesh was made of.

    Attributes:
        path: The file.
        scale: Metres per unit of length of Gmsh's model of it.
    """

    path: Path
    scale: float


@dataclass(frozen=True)
class Body:
    """A distributed mesh in the reference configuration, in metres, with named parts.

    Regions and surfaces may overlap: each is a set of cells or facets, not a tag.

    Attributes:
        mesh: Tetrahedra (3D) or triangles (2D), of geometric degree 1 or 2.
        regions: Name to the local cells of this rank (owned and ghost), sorted.
        surfaces: Name to the local facets of this rank (owned and ghost), sorted.
        source: Where the mesh came from, for messages.
        fields: Name to values at cells or points from the mesh file.
        notes: Remarks on faults found and corrected while reading (unused points ...).
        cad: The CAD file it was made of, if it was.
    """

    mesh: Mesh
    regions: Mapping[str, IndexArray] = field(default_factory=dict)
    surfaces: Mapping[str, IndexArray] = field(default_factory=dict)
    source: str = ""
    notes: tuple[str, ...] = ()
    fields: Mapping[str, MeshField] = field(default_factory=dict)
    cad: CadSource | None = None

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

    def region(self, name: str) -> IndexArray:
        """Local cells of a named region.

        Raises:
            MeshError: The name does not exist.
        """
        if name not in self.regions:
            raise MeshError(
                f"no region '{name}' in {self.source or 'the mesh'}",
                expected=nearest(name, self.regions),
            )
        return self.regions[name]

    def surface(self, name: str) -> IndexArray:
        """Local facets of a named surface.

        Raises:
            MeshError: The name does not exist.
        """
        if name not in self.surfaces:
            raise MeshError(
                f"no surface '{name}' in {self.source or 'the mesh'}",
                expected=nearest(name, self.surfaces),
            )
        return self.surfaces[name]

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

    def count(self, name: str) -> int:
        """Number of facets of a surface on all ranks. Collective."""
        return int(total(self.comm, len(self.owned_facets(name))))

    def named(
        self,
        *,
        regions: Mapping[str, IndexArray] | None = None,
        surfaces: Mapping[str, IndexArray] | None = None,
    ) -> Body:
        """The body with further named parts; those of the same name are replaced.

        Args:
            regions: Name to local cells, sorted.
            surfaces: Name to local facets, sorted.
        """
        return replace(
            self,
            regions={**self.regions, **(regions or {})},
            surfaces={**self.surfaces, **(surfaces or {})},
        )


def extent(body: Body) -> tuple[float, ...]:
    """Sides of the body's bounding box [m]. Collective."""
    x = body.mesh.geometry.x[:, : body.dim]
    corners = np.concatenate([x.max(axis=0, initial=-np.inf), -x.min(axis=0, initial=np.inf)])
    everywhere = np.empty_like(corners)
    body.comm.Allreduce(corners, everywhere, op=MPI.MAX)
    return tuple(float(side) for side in everywhere[: body.dim] + everywhere[body.dim :])


def span(body: Body) -> float:
    """Diagonal of the body's bounding box [m]. Collective."""
    return float(np.linalg.norm(extent(body)))


def cell_size(body: Body) -> float:
    """About the edge length of a cell [m]. Collective."""
    return span(body) / float(body.num_cells ** (1 / body.dim))
