"""Forces of explicit motion and what materials remember in one loop over cells.

An explicit step asks for forces once, at a state that is never taken back.  So what follows from
the same deformation and the same past is evaluated with them: the stress, the part of it whose work
is summed up, and the history at the end of the step, which is written where it was read.  Each is a
function of F, of the committed history and of the length of the step, see `Memory.whole_step`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import basix
import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfin_elastic.core.jit.cell_integrals import CellExpression, Loops
from dolfin_elastic.core.jit.compile import JitOptions
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.model.materials.memory import WholeStep
from dolfin_elastic.problem.history.region import RegionHistory


class _Step:
    """What a region's step is compiled from.

    Attributes:
        whole: As functions of F.
        variables: Which `whole` gives.
        functions: Stand in the forms for what is remembered, by name.
        numbers: See `Memory.numbers`.
    """

    def __init__(self, part: RegionHistory, F: Expr, w: fem.Function) -> None:
        memory, mesh = part.memory, w.function_space.mesh
        self.functions = {
            v.name: fem.Function(fem.functionspace(mesh, ("DG", 0, (v.size,))))
            for v in memory.variables
        }
        values = {v.name: v.value(self.functions[v.name]) for v in memory.variables}
        self.numbers = fem.Constant(mesh, memory.numbers(0.0))
        self.whole = memory.whole_step(F, values, part.step, self.numbers)
        at_end: Mapping[str, Expr] = {} if self.whole is None else self.whole.at_end
        of_step = [v for v in memory.told if v.name in at_end and v.name not in values]
        self.variables = [*memory.variables, *of_step]

    @property
    def branches(self) -> bool:
        """Work of branches is summed up."""
        return self.whole is not None and self.whole.branch_stress is not None


class _Region:
    """The loop over a region. Collective to make.

    Args:
        row: Numbers of a node in `room`, see steps.c.

    Attributes:
        fixed: Fields that neither follow the motion nor are remembered.
    """

    def __init__(
        self,
        part: RegionHistory,
        step: _Step,
        whole: WholeStep,
        w: fem.Function,
        row: int,
        jit_options: JitOptions,
    ) -> None:
        self._part, self._numbers, self._variables = part, step.numbers, step.variables
        stresses = [whole.stress] + ([whole.branch_stress] if step.branches else [])
        given = [P[i, j] for P in stresses for i in range(3) for j in range(3)]
        self._begin = [len(given)]
        for v in step.variables:
            given += v.numbers(whole.at_end[v.name])
            self._begin.append(len(given))
        mesh = w.function_space.mesh
        _, weights = basix.make_quadrature(mesh.basix_cell(), 0)
        coordinates = mesh.ufl_domain().ufl_coordinate_element().sub_elements[0]
        geometry = coordinates.tabulate(1, part.points)[1:, 0].T
        shape = w.function_space.element.basix_element.tabulate(1, part.points)[1:, 0, :, 0]
        table = np.zeros((len(shape), 4))
        table[:, : shape.shape[1]] = shape
        sizes = {"DIM": len(shape), "ND": shape.shape[1], "NDP": 4, "NG": len(geometry)}
        sizes |= {"WIDTH": row, "BRANCH": int(step.branches)}
        self._tables: list[AnyArray] = [
            np.ascontiguousarray(one) for one in (table, geometry, weights)
        ]
        filled, loops = [*step.functions.values()], Loops("steps.c", sizes)
        self.kernel = CellExpression(
            ufl.as_vector(given), part.points, w, jit_options, loops, filled=filled
        )
        self.fixed = [one for one in self.kernel.fields if one not in filled]
        self._places = [
            self.kernel.place_of(step.functions[v.name]) if v.name in step.functions else -1
            for v in step.variables
        ]

    def set_step(self, dt: float) -> None:
        """The length of the step [s]."""
        self._numbers.value = self._part.memory.numbers(dt)

    def add(self, room: FloatArray, *, accept: bool) -> None:
        """Adds forces, and takes over the history at the end of the step."""
        values, count = self._part.values, len(self._part.cells)
        for v in self._variables:
            rows = values[v.name] if v.name in values else np.zeros((count, v.size))
            values[v.name] = np.ascontiguousarray(rows)
        table = np.array(
            [
                [values[v.name].ctypes.data, v.size, place, begin]
                for v, place, begin in zip(self._variables, self._places, self._begin, strict=False)
            ],
            dtype=np.int64,
        )
        cells, size, more = self._part.cells, self.kernel.size, (int(accept), room)
        self.kernel.call("add_steps", cells, size, *self._tables, len(table), table.ravel(), *more)


class FusedSteps:
    """Forces and history of all regions that remember. Collective to make.

    Args:
        parts: Each region's history, with its F.

    Attributes:
        branches: Work of branches is summed up.
        possible: All regions have such steps; else nothing here can be called.
        accepted: The history is that of the end of the step.
    """

    def __init__(
        self,
        parts: Sequence[tuple[RegionHistory, Expr]],
        w: fem.Function,
        jit_options: JitOptions,
    ) -> None:
        steps = [(part, _Step(part, F, w)) for part, F in parts]
        self.branches, self._w = any(step.branches for _, step in steps), w
        self.possible = all(step.whole is not None for _, step in steps)
        row = 8 if self.branches else 4
        self._regions: list[_Region] = []
        for part, step in steps if self.possible else []:
            assert step.whole is not None
            self._regions.append(_Region(part, step, step.whole, w, row, jit_options))
        self.possible &= all(one.kernel.kernel is not None for one in self._regions)
        nodes = w.function_space.dofmap.index_map
        count = nodes.size_local + nodes.num_ghosts
        self._room, self._before = np.zeros(row * count), np.zeros(row * count)
        self._work, self.accepted = np.zeros(1), False

    @staticmethod
    def fits(parts: Sequence[RegionHistory], w: fem.Function) -> bool:
        """Whether cells are linear simplices with one point each. Not collective."""
        dim, dofmap = w.function_space.mesh.topology.dim, w.function_space.dofmap
        linear = dofmap.bs == dim and dofmap.list.shape[1] == dim + 1
        return linear and all(len(part.points) == 1 for part in parts)

    def set_step(self, dt: float) -> None:
        """The length of the step [s]. Not collective."""
        self.accepted = False
        for one in self._regions:
            one.set_step(dt)

    def add_forces(self, out: FloatArray, *, accept: bool) -> None:
        """Adds the forces of the present state. Not collective.

        Args:
            out: Local entries, those of ghosts too [N].
            accept: It is the end of the step: the history becomes that of the end.
        """
        for one in self._regions:
            one.add(self._room, accept=accept)
        self._collect(out, int(accept))
        self.accepted = accept

    def begin(self) -> None:
        """Work on branches is summed up from here. Not collective."""
        for one in self._regions:
            one.add(self._room, accept=False)
        self._collect(np.zeros(len(self._w.x.array)), 2)
        self._work[0] = 0.0

    def _collect(self, out: FloatArray, accept: int) -> None:
        nodes = len(out) // self._w.function_space.dofmap.bs
        where = (nodes, self._room, out, self._w.x.array, self._before)
        self._regions[0].kernel.loops.call("collect", *where, accept, self._work)

    def accept(self) -> None:
        """Takes the present state over, unless `add_forces` has. Not collective."""
        if not self.accepted:
            self.add_forces(np.zeros(len(self._w.x.array)), accept=True)

    def take_work(self) -> float:
        """Work of this rank since the last call [J]. Not collective."""
        work, self._work[0] = float(self._work[0]), 0.0
        return work

    def given(self) -> list[FloatArray]:
        """Numbers and fields that follow neither the motion nor the time. Not collective."""
        kernels = [one.kernel for one in self._regions]
        fields = [field.x.array for one in self._regions for field in one.fixed]
        return [one.constants for one in kernels] + fields
