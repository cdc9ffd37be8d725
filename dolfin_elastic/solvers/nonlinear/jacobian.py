"""det F, which must stay positive, and grad u, which must stay small for small-strain laws."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import NamedTuple

import basix
import numpy as np
import ufl
from dolfinx.mesh import Mesh
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.core.jit import compile_c, compile_expression
from dolfin_elastic.core.parallel import largest_row, total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.model.kinematics import displacement_gradient
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.assembly.two_stage.form import tabulated
from dolfin_elastic.solvers.nonlinear.bordered import Bordered

BLOCK = 8192
"""Cells that are evaluated at once: the values of their displacements stay in the cache of a core,
where those of all cells would take 96 bytes a linear one."""

Extreme = tuple[float, FloatArray]
"""A value and the place of its cell in the reference configuration [m]."""

NOWHERE: FloatArray = np.zeros(3)


ROUND_OFF = 1e-14
"""Difference of two det F, or of two |grad u|, that rounding decides."""


class Extremes(NamedTuple):
    """Extremes over all cells.

    Attributes:
        low: Smallest det F.
        high: Largest det F.
        steepest: Largest |grad u| in cells of linear laws.
        refused: Smallest det F in cells whose law does not survive inversion.
        inverted: How many cells have a det F that is not positive.
    """

    low: Extreme
    high: Extreme
    steepest: Extreme
    refused: Extreme
    inverted: int


class CellExtremes(NamedTuple):
    """Extremes inside each owned cell of a rank.

    Attributes:
        least: Smallest det F; what is no number counts as -inf.
        most: Largest det F, likewise.
        squares: Largest |grad u|^2; empty where no law is linear.
    """

    least: FloatArray
    most: FloatArray
    squares: FloatArray


class JacobianWatch:
    """Smallest and largest det F of a body, at the points where the energy is integrated.

    Where there are laws for small strains it sees the largest displacement gradient in their cells
    as well, for what they leave out are its squares.

    Attributes:
        survives: A law goes on in inverted cells.
    """

    def __init__(self, problem: Problem) -> None:
        mesh = problem.body.mesh
        kind = getattr(basix.CellType, mesh.topology.cell_name())
        points, _ = basix.make_quadrature(
            kind, max(problem.weak_form.rule(region) for region in problem.regions)
        )
        self._problem = problem
        self._small = _marks(problem, [part.law.linear for part in problem.regions])
        self._surviving = _marks(problem, [part.law.survives_inversion for part in problem.regions])
        self.survives = self._surviving is not None
        plain = problem.W is problem.V and problem.cell is None
        evaluator = _ByLoop if plain and not problem.context.axisymmetric else _ByExpression
        self._evaluate: _ByLoop | _ByExpression = evaluator(
            problem, points, linear=self._small is not None
        )
        self._seen: FloatArray | None = None
        self._found: Extremes | None = None

    def smallest(self) -> Extreme:
        """Smallest det F and the reference place of its cell [m]. Collective."""
        return self.extremes()[0]

    def refused(self) -> Extreme:
        """Smallest det F, and its place [m], where no inverted cell can be let pass. Collective.

        Infinite where all laws survive inversion.
        """
        return self._now().refused

    def inverted(self) -> int:
        """Number of inverted cells. Collective."""
        return self._now().inverted

    def extremes(self) -> tuple[Extreme, Extreme]:
        """Smallest and largest det F and the reference places of their cells [m]. Collective.

        Asked again before anything has moved, nothing is evaluated again.
        """
        result = self._now()
        return result.low, result.high

    def _now(self) -> Extremes:
        """Extremes of all cells at the present displacement. Collective."""
        now = self._state()
        same = self._seen is not None and np.array_equal(self._seen, now)
        comm = self._problem.body.comm
        if self._found is None or not comm.allreduce(same, op=MPI.LAND):
            self._seen, self._found = now.copy(), self._evaluated()
        return self._found

    def steepest(self) -> Extreme:
        """Largest |grad u| in cells of linear laws, 0 without any, and its place [m]. Collective.

        The Frobenius norm: strains and rotations count alike.
        """
        return self._now().steepest

    def _state(self) -> FloatArray:
        """All that F depends on."""
        fields, cell = self._problem.w.x.array, self._problem.cell
        return fields if cell is None else np.append(fields, cell.H.value)

    def _evaluated(self) -> Extremes:
        """See `_now`. Collective."""
        with stage("assemble"):
            least, most, squares = self._evaluate()
        inverted = total(self._problem.body.comm, int(np.count_nonzero(~(least > 0.0))))
        low, refused = self._at_smallest(least), None
        if self._surviving is not None:
            refused = self._at_smallest(np.where(self._surviving, np.inf, least))
        steepest = 0.0, NOWHERE
        if self._small is not None:
            steep = np.nan_to_num(np.sqrt(np.where(self._small, squares, 0.0)))
            steepest = self._at_largest(steep, about=0.0)
        high = self._at_largest(most)
        if high[0] == -np.inf:  # there is no number at all: a cell is named all the same
            high = low
        return Extremes(low, high, steepest, refused or low, inverted)

    def _at_smallest(self, values: FloatArray) -> Extreme:
        value, place = self._at_largest(-values, about=-1.0)
        return -value, place

    def _at_largest(self, values: FloatArray, *, about: float = 1.0) -> Extreme:
        """The largest value of the owned cells of all ranks, and its place. Collective.

        Args:
            values: One for each cell; -inf where none counts.
            about: Value whose differences count: that of the undeformed body.
        """
        mesh, cells = self._problem.body.mesh, self._problem.body.owned_cells()
        row = largest_row(
            self._problem.body.comm,
            values,
            lambda rows: _middles(mesh, cells[rows]),
            least=ROUND_OFF,
            about=about,
        )
        return (-np.inf, NOWHERE) if row is None else (row.value, np.array(row.place))


def _marks(problem: Problem, of_regions: Sequence[bool]) -> BoolArray | None:
    """Which owned cells lie in regions that are marked; None: no region is."""
    if not any(of_regions):
        return None
    mask = np.zeros(len(problem.body.owned_cells()), dtype=bool)
    for part, mark in zip(problem.regions, of_regions, strict=True):
        mask[part.cells] = mark
    return mask


class _ByLoop:
    """Extremes by one loop over the cells, for F = I + grad u. Collective to make.

    Args:
        problem: Whose displacement is the only unknown.
        points: Of each cell.
    """

    def __init__(self, problem: Problem, points: FloatArray, *, linear: bool) -> None:
        mesh = problem.body.mesh
        gradients, corners, sizes = tabulated(problem, points)
        self._loop = compile_c(problem.body.comm, "extremes.c", sizes, problem.jit)
        self._w = problem.w
        nodes = [
            np.ascontiguousarray(dofs) for dofs in (mesh.geometry.dofmap, problem.V.dofmap.list)
        ]
        self._cells = (*nodes, len(mesh.geometry.x), mesh.geometry.x)
        self._tables, self._count = (gradients, corners), len(problem.body.owned_cells())
        self._linear = linear

    def __call__(self) -> CellExtremes:
        """Of the owned cells of this rank. Not collective."""
        count = self._count
        result = CellExtremes(
            np.empty(count), np.empty(count), np.empty(count if self._linear else 0)
        )
        w = self._w.x.array
        arrays = (*self._cells, len(w), w, *self._tables)
        self._loop.call("extremes", count, *arrays, int(self._linear), *result)
        return result


class _ByExpression:
    """The same for any F of all unknowns, by an expression of it. Collective to make.

    Args:
        problem: Of any unknowns.
        points: Of each cell.
    """

    def __init__(self, problem: Problem, points: FloatArray, *, linear: bool) -> None:
        self._mesh, self._points, self._linear = problem.body.mesh, points, linear
        self._cells = problem.body.owned_cells()
        F = problem.weak_form.F(problem.w)
        seen = [ufl.det(F)]
        if linear:
            H = displacement_gradient(F)
            seen.append(ufl.inner(H, H))
        self._columns = len(seen)
        self._seen_in = compile_expression(
            problem.body.comm, ufl.as_vector(seen), points, problem.jit
        )

    def __call__(self) -> CellExtremes:
        """Of the owned cells of this rank. Not collective."""
        count = len(self._cells)
        result = CellExtremes(
            np.empty(count), np.empty(count), np.empty(count if self._linear else 0)
        )
        for first in range(0, count, BLOCK):
            cells = self._cells[first : first + BLOCK]
            here = slice(first, first + len(cells))
            seen = self._seen_in.eval(self._mesh, cells)
            seen = seen.reshape(len(cells), len(self._points), self._columns)
            J = np.where(np.isnan(seen[:, :, 0]), -np.inf, seen[:, :, 0])
            result.least[here], result.most[here] = J.min(axis=1), J.max(axis=1)
            if self._linear:
                result.squares[here] = np.nan_to_num(seen[:, :, 1]).max(axis=1)
        return result


def _middles(mesh: Mesh, cells: IndexArray) -> FloatArray:
    """Mean places of the nodes of cells [m], shape (n, 3)."""
    nodes = mesh.geometry.dofmap[cells].T  # a row at a time: NumPy's mean takes four times as long
    return np.asarray(sum(mesh.geometry.x[row] for row in nodes) / len(nodes))


HALVINGS = 10
"""Times that one Newton step is halved before it is given up."""

PATIENCE = 12
"""Shortened steps in one solve from which a smaller load step gets there sooner."""


class InversionGuard:
    """Shortens Newton steps that would turn a cell inside out, before they are tried.

    Laws that grow without bound as J goes to zero say so by an infinite residual; others let a
    cell pass through zero volume and find an equilibrium on the other side of it.  So det F is
    looked at itself, at the points where the energy is integrated.  Cells of laws that survive
    inversion may be inverted, but only where there is no other way: where the solve begins so, or
    no part of a step avoids it.

    Args:
        bordered: Scalar unknowns beside the fields, on which F may depend.

    Attributes:
        rejected: Trial states refused since `begin`.
        worst: Smallest det F of them and the reference place of its cell [m].
        stuck: No part of the last step was without inverted cells.
        passes: Steps that `Newton` has shortened since `begin` lest surfaces pass each other.
    """

    def __init__(
        self, assembler: Assembler, watch: JacobianWatch, bordered: Bordered | None = None
    ) -> None:
        self._assembler, self.watch, self._bordered = assembler, watch, bordered
        self.rejected, self.stuck, self._lets_pass, self.passes = 0, False, False, 0
        self.worst: Extreme = (np.inf, NOWHERE)

    def begin(self) -> None:
        """Begins a new solve: nothing has been refused. Collective."""
        self.rejected, self.stuck, self.passes = 0, False, 0
        self.worst = (np.inf, NOWHERE)
        self._lets_pass = self.watch.survives and self.watch.inverted() > 0

    def shorten(self, x: PETSc.Vec, y: PETSc.Vec) -> bool:
        """Halves the step y until x - y has no inverted cell. Collective.

        Returns:
            Whether y was changed.
        """
        refused = self.rejected
        share = self._upright_share(x, y)
        if share is None and self.watch.survives and not self._lets_pass:
            self._lets_pass, self.rejected = True, refused
            share = self._upright_share(x, y)
        self.stuck = share is None
        if share is None:
            share = 0.5 ** (HALVINGS + 1)
        if share < 1.0:
            y.scale(share)
        return share < 1.0

    def _upright_share(self, x: PETSc.Vec, y: PETSc.Vec) -> float | None:
        """Share of the step y with which no cell is inverted that must not be. Collective.

        Returns:
            None: none has been found.
        """
        size, w = self._assembler.size, self._assembler.problem.w.x
        step = y.array_r[:size].copy()
        share = 1.0
        for _ in range(HALVINGS + 1):
            w.array[:size] = self._assembler.origin + (x.array_r[:size] - share * step)
            w.scatter_forward()
            self._move_scalars(x, y, share)
            smallest = self.watch.refused() if self._lets_pass else self.watch.smallest()
            if smallest[0] > 0.0:
                return share
            self.rejected += 1
            self.worst = min(self.worst, smallest, key=lambda pair: pair[0])
            share /= 2
        return None

    def _move_scalars(self, x: PETSc.Vec, y: PETSc.Vec, share: float) -> None:
        if (bordered := self._bordered) is not None:
            now, step = bordered.scalar_part(x), bordered.scalar_part(y)
            bordered.scalars.put(now - share * step)


log = logging.getLogger("dolfin_elastic")

SMALL_STRAINS = 0.1
"""|grad u| up to which laws for small strains may be trusted: they leave out terms of its square,
one percent."""


class SmallStrains:
    """Warns once that a law for small strains is used for large ones.  Collective to make.

    Args:
        watch: Of its displacement gradient; made here if none is given and one is needed.

    Attributes:
        note: The warning; empty before.
    """

    def __init__(self, problem: Problem, watch: JacobianWatch | None = None) -> None:
        self.note, self._dim, self._unit = "", problem.body.dim, problem.body.unit
        small = [part.law for part in problem.regions if part.law.linear]
        self._names = ", ".join(sorted({law.name() for law in small}))
        self._others = ", ".join(sorted({law.follows_large for law in small}))
        self._watch = (watch or JacobianWatch(problem)) if self._names else None

    def restore(self, note: str) -> None:
        """Goes on with the note of a run that was stopped."""
        self.note = note

    def check(self, when: str) -> None:
        """Evaluates the present displacement, unless there is a note already. Collective.

        Args:
            when: Load factor or time, for the message.
        """
        if self._watch is None or self.note:
            return
        steepest, place = self._watch.steepest()
        if steepest <= SMALL_STRAINS:
            return
        self.note = (
            f"the law {self._names} is for small strains and rotations, but |grad u| is "
            f"{steepest:.2g} at {self._unit.point(place[: self._dim])} ({when}): {self._others}"
        )
        log.warning("%s", self.note)
