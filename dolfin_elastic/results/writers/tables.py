"""CSV tables of the values at nodes and of those of cells, one of each a state.

Files:

    results.csv                    number and time of each written state, and its tables
    results_csv/000000_nodes.csv   node, its place [m] in the undeformed body, fields of nodes
    results_csv/000000_cells.csv   cell, its barycentre, fields of cells, where there are any

Each rank adds the rows of the nodes and cells that it owns, so that their order depends on the
number of ranks; the numbers in the first column do not.  All is in SI units.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.problem.state import State, plain
from dolfin_elastic.results.checkpoint.mesh_order import node_numbers
from dolfin_elastic.results.fields import component_names
from dolfin_elastic.results.files import replace_text
from dolfin_elastic.results.hdf5 import Rows
from dolfin_elastic.results.writers.series import IndexedSeries, add_text, lines_of

_PLACE = ("x", "y", "z")
_HEAD = "step,t,nodes,cells"


class TableWriter(IndexedSeries):
    """Writes states of a problem as CSV; see the module.  All of it is collective.

    See `SeriesWriter`.
    """

    folder = "_csv"
    own = re.compile(r"\d{6,}_(?:nodes|cells)\.csv")

    def _add(self, state: State, rows: Mapping[str, Rows]) -> str:
        files = []
        for centre, (numbers, places) in self._rows.items():
            fields = {
                n: r.values for n, r in rows.items() if self._evaluate.table[n].centre == centre
            }
            file = f"{len(self._frames):06d}_{centre}s.csv"
            if fields or centre == "node":
                self._write_table(file, centre, numbers, {"": places, **fields})
                files.append(f"{self.data.name}/{file}")
            else:
                files.append("")
        return f"{state.step},{plain(state.t)!r},{files[0]},{files[1]}"

    @cached_property
    def _rows(self) -> dict[str, tuple[IntArray, FloatArray]]:
        """Of nodes and cells the numbers and places [m] of this rank's. Collective."""
        grid = self._evaluate.grid
        points = grid.V.tabulate_dof_coordinates()
        corners = grid.V.dofmap.list[: grid.own_cells, : grid.mesh.topology.dim + 1]
        original = np.asarray(grid.mesh.topology.original_cell_index[: grid.own_cells])
        return {
            "node": (node_numbers(grid.V)[: grid.own_points], grid.points()),
            "cell": (original.astype(np.int64), points[corners].mean(axis=1)),
        }

    def _write_table(
        self, file: str, first: str, numbers: IntArray, columns: Mapping[str, AnyArray]
    ) -> None:
        """Writes one table. Collective.

        Args:
            numbers: This rank's part of it.
            columns: Name of a field to this rank's rows; of the places the name is empty.
        """
        names = [
            part
            for name, values in columns.items()
            for part in (component_names(name, values.shape[1]) if name else _PLACE)
        ]
        text = lines_of(
            np.column_stack(list(columns.values())).astype(np.float64),
            numbers,
            between=",",
        )
        head = ",".join([first, *names]) + "\n" if self.comm.rank == 0 else ""
        add_text(self.comm, self.data / file, head + text, 0)

    def _named(self, entry: str) -> list[str]:
        return [place.rpartition("/")[2] for place in entry.split(",")[2:] if place]

    def _entries(self) -> list[str]:
        rows = list(csv.reader(io.StringIO(self.path.read_text(encoding="utf-8"))))
        return [",".join(row) for row in rows[1:]]

    def _replace_index(self, frames: Sequence[str]) -> None:
        replace_text(self.path, "\n".join([_HEAD, *frames]) + "\n", durable=True)
