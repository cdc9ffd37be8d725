"""`Grid`: points and cells of the output, the nodes and cells of the displacement's space.

A quadratic displacement is written on quadratic cells, so that nothing is interpolated.  Points and
cells are numbered over all ranks, rank after rank; each rank has those that it owns.
"""

from __future__ import annotations

import numpy as np
from dolfinx import cpp, fem
from dolfinx.mesh import CellType

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.ghosts import summed
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.mesh.geometry.simplices import cell_corners, signed_volumes
from dolfin_elastic.results.hdf5 import Rows

# Cell and number of its nodes -> XDMF's name.
_KINDS = {
    (CellType.triangle, 3): "Triangle",
    (CellType.triangle, 6): "Triangle_6",
    (CellType.tetrahedron, 4): "Tetrahedron",
    (CellType.tetrahedron, 10): "Tetrahedron_10",
}
# VTK's nodes of a cell whose first two corners are exchanged.
_MIRRORED = {
    3: [1, 0, 2],
    6: [1, 0, 2, 3, 5, 4],
    4: [1, 0, 2, 3],
    10: [1, 0, 2, 3, 4, 6, 5, 8, 7, 9],
}


_BLOCK = 16384
"""Cells whose corners are looked at at once, in the cache of a core."""


class Grid:
    """Points and cells of a displacement space.

    Args:
        V: Vector-valued Lagrange space of degree 1 or 2 on triangles or tetrahedra.
        places: Reference places of its nodes [m], where they are known.

    Attributes:
        kind: XDMF's name of the cell.

    Raises:
        InputError: The space is of another kind.
    """

    def __init__(self, V: fem.FunctionSpace, places: FloatArray | None = None) -> None:
        self.V, self.mesh, self._places = V, V.mesh, places
        self.nodes_per_cell = int(V.dofmap.list.shape[1])
        key = (self.mesh.topology.cell_type, self.nodes_per_cell)
        if key not in _KINDS:
            raise InputError(
                f"results cannot show {key[1]} nodes on a {key[0].name}",
                where="mesh.degree",
                expected="1 or 2",
            )
        self.kind = _KINDS[key]

    @property
    def own_points(self) -> int:
        """Number of points that this rank owns."""
        return int(self.V.dofmap.index_map.size_local)

    @property
    def own_cells(self) -> int:
        """Number of cells that this rank owns."""
        return int(self.mesh.topology.index_map(self.mesh.topology.dim).size_local)

    @property
    def number_type(self) -> type:
        """That of the numbers of points over all ranks."""
        few = self.V.dofmap.index_map.size_global < np.iinfo(np.int32).max
        return np.int32 if few else np.int64

    def points(self) -> FloatArray:
        """Places [m] of the owned points in the reference configuration, shape (n, 3)."""
        places = self.V.tabulate_dof_coordinates() if self._places is None else self._places
        return np.asarray(places[: self.own_points])

    def cells(self) -> AnyArray:
        """Points of each owned cell in VTK's order, numbered over all ranks.

        Two nodes of a cell with negative orientation are exchanged, so that all volumes are
        positive.

        Returns:
            Shape (owned cells, nodes of a cell).
        """
        local = self.local_cells()
        numbers = self.V.dofmap.index_map.local_to_global(local.ravel().astype(np.int32))
        return np.asarray(numbers, dtype=self.number_type).reshape(local.shape)

    def local_cells(self) -> AnyArray:
        """As `cells`, with the numbers that points have on this rank, ghosts too."""
        order = np.argsort(cpp.io.perm_vtk(self.mesh.topology.cell_type, self.nodes_per_cell))
        local = self.V.dofmap.list[: self.own_cells][:, order]
        for first in range(0, self.own_cells, _BLOCK):
            some = np.arange(first, min(first + _BLOCK, self.own_cells), dtype=np.int32)
            mirrored = some[signed_volumes(cell_corners(self.mesh, some)) < 0]
            local[mirrored] = local[mirrored][:, _MIRRORED[self.nodes_per_cell]]
        return np.asarray(local)

    def rows(self, centre: str, values: AnyArray) -> Rows:
        """This rank's values as rows of an array over all ranks. Not collective.

        Args:
            centre: "node" or "cell".
            values: Of the owned points or cells, shape (n, ...).
        """
        topology = self.mesh.topology
        index_map = (
            self.V.dofmap.index_map if centre == "node" else topology.index_map(topology.dim)
        )
        return Rows(
            values.reshape(len(values), int(np.prod(values.shape[1:]))),
            int(index_map.local_range[0]),
            int(index_map.size_global),
        )


def to_nodes(V: fem.FunctionSpace, values: FloatArray) -> FloatArray:
    """Values of cells, averaged at each node with the cells' volumes as weights. Collective.

    It is the L2 projection with a lumped mass matrix: no system to solve, and no overshoots.

    Args:
        V: Space at whose nodes the values are averaged.
        values: Of cells, shape (owned cells, columns).

    Returns:
        Shape (local nodes, columns), ghosts up to date.
    """
    weights = np.abs(signed_volumes(cell_corners(V.mesh))[: len(values)])
    columns = np.column_stack([values * weights[:, None], weights])
    sums = summed(V.dofmap.index_map, V.dofmap.list[: len(values)], columns[:, None])
    return np.asarray(sums[:, :-1] / sums[:, -1:])
