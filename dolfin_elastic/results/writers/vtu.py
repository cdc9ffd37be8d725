"""VTK's XML files: a series of .vtu pieces, each written by its rank.

Files:

    results.pvd                 the states with their times
    results_vtu/000000.pvtu     the pieces of the first written state, and the fields they have
    results_vtu/000000_0.vtu    rank 0's cells with all of their points, by meshio
    results_vtu/000000_1.vtu    rank 1's ...

A point on cells of several ranks is in several pieces.  All but its owner's copy are marked in
`vtkGhostType` (1: a duplicate), so that sums over points in ParaView count each once.

Source: VTK XML formats, https://docs.vtk.org/en/latest/design_documents/VTKFileFormats.html.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from dolfin_elastic.core.files.regular import fresh
from dolfin_elastic.core.ghosts import with_ghosts
from dolfin_elastic.core.parallel import agree, on_root
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.problem.state import State, plain
from dolfin_elastic.results.files import replace_text, writing
from dolfin_elastic.results.hdf5 import Rows
from dolfin_elastic.results.writers.series import IndexedSeries

_ENTRY = re.compile(r'<DataSet [^>]* file="[^"/]*/([^"]+)"/>')
_PIECE = re.compile(r"(\d{6,})\.pvtu")
GHOSTS = "vtkGhostType"
_DUPLICATE = 1
_CELLS = {
    "Triangle": "triangle",
    "Triangle_6": "triangle6",
    "Tetrahedron": "tetra",
    "Tetrahedron_10": "tetra10",
}
"""XDMF's name of a cell to that of meshio, whose nodes have VTK's order."""
_TYPES = {"f": "Float64", "i": "Int32", "u": "UInt8"}


class VtuWriter(IndexedSeries):
    """Writes states of a problem as .vtu pieces; see the module.  All of it is collective.

    See `SeriesWriter`.
    """

    folder = "_vtu"
    own = re.compile(r"\d{6,}(?:\.pvtu|_\d+\.vtu)")

    def _add(self, state: State, rows: Mapping[str, Rows]) -> str:
        name = f"{len(self._frames):06d}"
        points, cells = self._arrays(rows)
        error: Exception | None = None
        try:
            self._write_piece(f"{name}_{self.comm.rank}.vtu", points, cells)
        except Exception as caught:  # raised on all ranks just below
            error = caught
        agree(self.comm, error)
        pieces = [f"{name}_{rank}.vtu" for rank in range(self.comm.size)]
        text = _summary(points, cells, pieces)
        on_root(self.comm, lambda: replace_text(self.data / f"{name}.pvtu", text))
        return (
            f'<DataSet timestep="{plain(state.t)!r}" part="0" file="{self.data.name}/{name}.pvtu"/>'
        )

    def _arrays(self, rows: Mapping[str, Rows]) -> tuple[dict[str, AnyArray], dict[str, AnyArray]]:
        """Fields of the points and of the cells of this rank's piece. Collective."""
        points, cells = {}, {}
        used, _, _ = self._piece
        for name, part in rows.items():
            if self._evaluate.table[name].centre == "cell":
                cells[name] = _plain_columns(part.values)
            else:
                points[name] = _plain_columns(
                    with_ghosts(self._evaluate.grid.V.dofmap.index_map, part.values)[used]
                )
        ghosts = used >= self._evaluate.grid.own_points
        points[GHOSTS] = np.where(ghosts, _DUPLICATE, 0).astype(np.uint8)
        return points, cells

    @cached_property
    def _piece(self) -> tuple[AnyArray, AnyArray, AnyArray]:
        """Local points of the piece, their places [m], and the cells by their positions there."""
        grid = self._evaluate.grid
        local = grid.local_cells()
        used, offsets = np.unique(local, return_inverse=True)
        cells = offsets.reshape(local.shape).astype(np.int64)
        return used, np.asarray(grid.V.tabulate_dof_coordinates()[used]), cells

    def _write_piece(
        self, name: str, points: Mapping[str, AnyArray], cells: Mapping[str, AnyArray]
    ) -> None:
        """Writes this rank's piece. Not collective.

        Args:
            name: Of the file.
            points: Name to values of the piece's points.
        """
        import meshio

        _, x, connected = self._piece
        mesh = meshio.Mesh(
            x,
            [(_CELLS[self._evaluate.grid.kind], connected)],
            point_data=dict(points),
            cell_data={name: [values] for name, values in cells.items()},
        )
        path = self.data / name
        with writing(path):
            meshio.vtu.write(fresh(path), mesh, compression=None, header_type="UInt64")

    def _named(self, entry: str) -> list[str]:
        """See `SeriesWriter`; as many pieces as the .pvtu names."""
        name = _ENTRY.findall(entry)[0]
        with writing(self.data):
            text = (self.data / name).read_text() if (self.data / name).is_file() else ""
        return [name, *re.findall(r'<Piece Source="([^"]+)"/>', text)]

    def _entries(self) -> list[str]:
        text = self.path.read_text(encoding="utf-8")
        return [match.group(0) for match in _ENTRY.finditer(text)]

    def _replace_index(self, frames: Sequence[str]) -> None:
        text = (
            '<?xml version="1.0"?>\n<VTKFile type="Collection" version="1.0">\n<Collection>\n'
            + "".join(f"{entry}\n" for entry in frames)
            + "</Collection>\n</VTKFile>\n"
        )
        replace_text(self.path, text, durable=True)


def _plain_columns(values: AnyArray) -> AnyArray:
    """A column as a plain array, as VTK has scalars."""
    return values[:, 0] if values.shape[1] == 1 else values


def _summary(
    points: Mapping[str, AnyArray], cells: Mapping[str, AnyArray], pieces: Sequence[str]
) -> str:
    """Text of a .pvtu file.

    Args:
        points: Fields of the points of a piece.
        pieces: Files of all pieces, relative to it.
    """

    def declared(arrays: Mapping[str, AnyArray]) -> str:
        return "".join(
            f'<PDataArray type="{_TYPES[a.dtype.kind]}" Name="{name}" '
            f'NumberOfComponents="{a.shape[1] if a.ndim > 1 else 1}"/>\n'
            for name, a in arrays.items()
        )

    files = "".join(f'<Piece Source="{name}"/>\n' for name in pieces)
    return (
        '<?xml version="1.0"?>\n<VTKFile type="PUnstructuredGrid" version="1.0">\n'
        '<PUnstructuredGrid GhostLevel="0">\n'
        '<PPoints><PDataArray type="Float64" Name="Points" NumberOfComponents="3"/></PPoints>\n'
        f"<PPointData>\n{declared(points)}</PPointData>\n"
        f"<PCellData>\n{declared(cells)}</PCellData>\n"
        f"{files}</PUnstructuredGrid>\n</VTKFile>\n"
    )
