"""Gmsh's .msh file: the mesh, and each field as a view with the states as its time steps.

One file in text (version 2.2, which all of Gmsh reads, and meshio): sections `$Nodes`, `$Elements`,
and for each state and field `$NodeData` or `$ElementData`.  Each rank adds the lines of the nodes
and cells that it owns.  The first letter of a section is written when the section is complete:
should the run be killed before, Gmsh passes over what there is of it.

Nodes and cells have numbers that do not depend on the number of ranks.  Physical groups are the
materials.

Source: https://gmsh.info/doc/texinfo/gmsh.html#MSH-file-format-version-2-_0028Legacy_0029.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import cached_property
from typing import cast

import numpy as np

from dolfin_elastic.core.files.regular import open_regular
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.types import IntArray
from dolfin_elastic.problem.state import State, plain
from dolfin_elastic.results.checkpoint.mesh_order import node_numbers
from dolfin_elastic.results.files import missing_results, sync, writing
from dolfin_elastic.results.hdf5 import Rows
from dolfin_elastic.results.writer import Numbers
from dolfin_elastic.results.writers.series import SeriesWriter, add_text, lines_of

_TYPES = {"Triangle": 2, "Triangle_6": 9, "Tetrahedron": 4, "Tetrahedron_10": 11}
"""XDMF's name of a cell to Gmsh's number of it."""
_ORDERS = {"Tetrahedron_10": [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]}
"""XDMF's name of a cell to VTK's number of each of Gmsh's nodes, where these differ."""
_SECTIONS = {"node": "NodeData", "cell": "ElementData"}


class MshWriter(SeriesWriter):
    """Writes states of a problem as views of Gmsh; see the module.  All of it is collective.

    See `SeriesWriter`.
    """

    _end = 0
    """Size of the file [bytes]."""

    def _add(self, state: State, rows: Mapping[str, Rows]) -> str:
        if not self._end:
            self._write_mesh()
        for name, part in rows.items():
            node = self._evaluate.table[name].centre == "node"
            self._write_view(name, state, part, self._numbers[0] if node else self._numbers[1])
        return ""

    @cached_property
    def _numbers(self) -> tuple[IntArray, IntArray]:
        """Gmsh's numbers of the local nodes and of the owned cells. Collective."""
        grid = self._evaluate.grid
        cells = np.asarray(grid.mesh.topology.original_cell_index[: grid.own_cells])
        return node_numbers(grid.V) + 1, cells.astype(np.int64) + 1

    def _write_mesh(self) -> None:
        grid, (nodes, cells) = self._evaluate.grid, self._numbers
        regions = self.problem.regions
        names = [part.name.replace('"', "'") for part in regions]
        groups = "".join(
            f'{grid.mesh.topology.dim} {k + 1} "{name}"\n' for k, name in enumerate(names)
        )
        head = (
            "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"
            f"$PhysicalNames\n{len(regions)}\n{groups}$EndPhysicalNames\n"
        )
        self._end = add_text(self.comm, self.path, head if self.comm.rank == 0 else "", 0)
        own = nodes[: grid.own_points]
        count = grid.rows("node", grid.points()).count
        self._section("Nodes", str(count), lines_of(grid.points(), own))
        group = np.ones(grid.own_cells, dtype=np.int64)
        for k, part in enumerate(regions):
            group[part.cells] = k + 1
        table = nodes[grid.local_cells()][:, _ORDERS.get(grid.kind, slice(None))]
        kind = _TYPES[grid.kind]
        rows = zip(cells, group, cast("list[list[int]]", table.tolist()), strict=True)
        lines = "".join(
            f"{number} {kind} 2 {region} {region} {' '.join([str(node) for node in row])}\n"
            for number, region, row in rows
        )
        total = grid.mesh.topology.index_map(grid.mesh.topology.dim).size_global
        self._section("Elements", str(total), lines)

    def _write_view(self, name: str, state: State, rows: Rows, numbers: IntArray) -> None:
        """Adds a field of a state. Collective.

        Args:
            rows: This rank's values.
            numbers: Gmsh's numbers of their nodes or cells, perhaps with those of ghosts behind.
        """
        head = f'1\n"{name}"\n1\n{plain(state.t)!r}\n3\n{len(self._frames)}\n'
        head += f"{rows.shape[1]}\n{rows.count}"
        own = numbers[: len(rows.values)]
        lines = lines_of(rows.values.astype(np.float64), own)
        self._section(_SECTIONS[self._evaluate.table[name].centre], head, lines)

    def _section(self, name: str, head: str, lines: str) -> None:
        """Adds a section. Collective.

        Args:
            lines: This rank's lines behind them.
        """
        rank, last = self.comm.rank, self.comm.size - 1
        text = f"${name}\n{head}\n" if rank == 0 else ""
        text += lines + (f"$End{name}\n" if rank == last else "")
        self._end = add_text(self.comm, self.path, text, self._end)

    def _commit(self) -> None:
        """See `SeriesWriter`; each section is complete already."""

    def restart_state(self) -> Numbers:
        """See `Writer`."""
        return {**super().restart_state(), "bytes": self._end}

    def _resume(self, saved: Numbers) -> list[str]:
        self._end = int(saved["bytes"])
        on_root(self.comm, self._cut if self._end else self._clear)
        return [""] * int(saved["frames"])

    def _cut(self) -> None:
        if not self.path.is_file() or self.path.stat().st_size < self._end:
            raise missing_results(self.path, "steps")
        with writing(self.path), open(open_regular(self.path, os.O_RDWR), "r+b") as file:
            file.truncate(self._end)

    def _sync(self) -> None:
        if self._end:
            sync(self.path)
