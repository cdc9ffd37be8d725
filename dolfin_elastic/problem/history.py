"""What a body remembers of its past, where its materials relax.

Nothing of a trial is stored: the stress is a function of F, of the history as it was committed
last, and of the time since then.  Tried and rejected steps, line searches and retries leave no
trace, and `History.commit` evaluates once at the accepted state.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import count
from typing import cast

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.jit import compile_forms, options
from dolfin_elastic.core.jit.cell_integrals import CellExpression
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.materials.growth import GrownLaw
from dolfin_elastic.model.materials.prony import Relaxed, Relaxing, overstress
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.material_regions import MaterialRegion
from dolfin_elastic.problem.weak_form import WeakForm

PERIODIC = "a periodic cell of materials that relax is not computed"
NO_PRONY = "leave out `prony`, or the cell"
ROW = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
"""Components of a symmetric tensor, in the order of the six numbers that are stored."""
TENSOR = ((0, 3, 5), (3, 1, 4), (5, 4, 2))


class RelaxingRegion:
    """The history of one material region. Collective to make.

    Tensors are polynomials in each cell, discontinuous, of the least degree that takes any values
    at the points of integration: there they are exact, and the stress has a value everywhere.

    Args:
        degree: Of the quadrature of the region's internal forces.

    Attributes:
        law: The region's law over a step.
        points: Of the reference cell, shape (points, dim).
        tensors: Six numbers at each node of the region's owned cells [Pa], shape (1 + terms, nodes,
            6): S, then h of each term, as `model.materials.prony` has them.
    """

    def __init__(self, body: Body, region: MaterialRegion, degree: int) -> None:
        mesh, kind = body.mesh, body.mesh.basix_cell()
        law = cast("Relaxing", region.law)
        self.points = basix.make_quadrature(kind, degree)[0]
        for order in count():
            table = basix.ufl.element("DG", kind, order).tabulate(0, self.points)[0]
            if np.linalg.matrix_rank(table) == len(self.points):
                break
        self._to_nodes = np.linalg.pinv(table)
        V = fem.functionspace(mesh, ("DG", order, (6,)))
        self._cells = region.cells
        self._rows = V.dofmap.list[region.cells].reshape(-1)
        self._past = fem.Function(V)
        self._instant = fem.Constant(mesh, 1.0)
        self._g = np.array([term.g for term in law.prony])
        self._tau = np.array([term.tau for term in law.prony])
        past = ufl.as_matrix([[self._past[i] for i in row] for row in TENSOR])
        self._lasting = fem.Constant(mesh, 1.0)
        self.law = Relaxed(law, self._instant, self._lasting, past)
        self.tensors: FloatArray = np.zeros((1 + len(self._g), len(self._rows), 6))

    def _weights(self, dt: float) -> tuple[FloatArray, FloatArray]:
        """e and f of each term, see `model.materials.prony`."""
        x = dt / self._tau
        return np.exp(-x), -np.expm1(-x) / x if dt > 0.0 else np.ones_like(x)

    def let_relax(self, *, relaxing: bool) -> None:
        """Sets what is left after a long time: all, if no time passes. Not collective."""
        self._lasting.value = 1.0 - float(self._g.sum()) if relaxing else 1.0

    def begin_step(self, dt: float) -> None:
        """Sets the law over a step from the history, of a length [s]. Not collective."""
        e, f = self._weights(dt)
        self._instant.value = 1.0 - self._g @ (1.0 - f)
        past = np.tensordot(self._g * e, self.tensors[1:], 1) - (self._g @ f) * self.tensors[0]
        self._past.x.array.reshape(-1, 6)[self._rows] = past

    def commit(self, stress: CellExpression, dt: float) -> None:
        """Takes over the present state at the end of a step. Not collective.

        Args:
            stress: Six numbers of S at the points.
            dt: Length of the step [s].
        """
        result = stress.eval(self._cells).reshape(len(self._cells), len(self.points), 6)
        now = np.einsum("nk,ckj->cnj", self._to_nodes, result).reshape(-1, 6)
        e, f = self._weights(dt)
        self.tensors[1:] *= e[:, None, None]
        self.tensors[1:] += f[:, None, None] * (now - self.tensors[0])
        self.tensors[0] = now

    def functions(self) -> list[fem.Function]:
        """The tensors as functions, 0 outside of the region: copies."""
        result = []
        for rows in self.tensors:
            result.append(fem.Function(self._past.function_space))
            result[-1].x.array.reshape(-1, 6)[self._rows] = rows
        return result

    def take(self, functions: list[fem.Function]) -> None:
        """Takes over what `functions` gave."""
        for rows, function in zip(self.tensors, functions, strict=True):
            rows[:] = function.x.array.reshape(-1, 6)[self._rows]


class History:
    """The history of a problem whose materials relax. Collective to make.

    Until `begin` no time passes: the laws are those of a sudden load.

    Args:
        weak_form: Whose laws become those over a step.
        grows: There is growth or warmth, which stores energy of its own.

    Attributes:
        uncertainty: By how much the work of the last committed step may be wrong [J]: half the
            change of forces times the change of displacement.

    Raises:
        InputError: A periodic cell.
    """

    def __init__(self, context: FormContext, weak_form: WeakForm, *, grows: bool) -> None:
        if context.unknowns.U is not context.unknowns.V:
            raise InputError(PERIODIC, where="periodic", expected=NO_PRONY)
        self._context, self._weak_form, self._grows = context, weak_form, grows
        self._comm, self._w = context.body.comm, context.unknowns.w
        self._regions = {
            region.name: RelaxingRegion(context.body, region, weak_form.rule(region))
            for region in context.regions
            if region.law.relaxes
        }
        weak_form.relaxed.update({name: part.law for name, part in self._regions.items()})
        self._t: float | None = None  # of the past that is committed
        self._now = 0.0
        self._step: float | None = None
        self._work = self.uncertainty = 0.0
        self._stresses: dict[str, CellExpression] = {}
        self._branches: fem.Form | None = None
        self._before: tuple[FloatArray, FloatArray] = (np.empty(0), np.empty(0))

    @property
    def passes(self) -> bool:
        """Time passes: not in a preload, whose materials are those of a sudden load."""
        return self._t is not None

    def set_time(self, t: float) -> None:
        """Sets the laws over the step from the last committed state to a time [s]. Local."""
        self._now = t
        step = 0.0 if self._t is None else max(t - self._t, 0.0)
        if step != self._step:
            self._step = step
            for part in self._regions.values():
                part.begin_step(step)

    def forget(self) -> None:
        """Forgets the past: no time passes until `begin`. Local."""
        for part in self._regions.values():
            part.tensors[:] = 0.0
            part.let_relax(relaxing=False)
        self._t, self._step, self._work, self.uncertainty = None, None, 0.0, 0.0
        self.set_time(self._now)

    def begin(self, t: float = 0.0) -> None:
        """Forgets the past: time passes from here, at the present state. Collective."""
        self.forget()
        self._begin_at(t, 0.0)

    def _begin_at(self, t: float, work: float) -> None:
        self._compile()
        for part in self._regions.values():
            part.let_relax(relaxing=True)
        self._t, self._step, self._work = t, None, work
        self.set_time(t)
        self._before = self._forces(), self._w.x.array.copy()

    def _compile(self) -> None:
        """Compiles S of each region and the forces of all branches, once. Collective."""
        if self._stresses:
            return
        jit, w, F = options(self._comm), self._w, self._weak_form.F(self._w)
        for region in self._context.regions:
            if (part := self._regions.get(region.name)) is not None:
                response = self._weak_form.response(region, w)
                elastic = response.elastic(F) if isinstance(response, GrownLaw) else F
                S = overstress(part.law.law, elastic)
                six = ufl.as_vector([S[i, j] for i, j in ROW])
                self._stresses[region.name] = CellExpression(six, part.points, w, jit)
        if not self._grows:
            self._branches = compile_forms(self._comm, [self._weak_form.relaxing], jit)[0]

    def _forces(self) -> FloatArray:
        """This rank's share of the nodal forces of the branches, not summed over ranks [N]."""
        result = np.zeros(len(self._w.x.array))
        if self._branches is not None:
            fem.assemble_vector(result, self._branches)
        return result

    def work(self) -> float:
        """Work done on the branches since the beginning, up to the present state [J]. Collective.

        By the trapezoidal rule over each step.  They have stored some of it and lost the rest; how
        much of each is not known of laws of large strains.  0 where the body grows.
        """
        return self._work + self._over_step()[0]

    def _over_step(self) -> tuple[float, float]:
        """Work of the present step, and by how much it may be wrong [J]. Collective."""
        if self._t is None or self._branches is None:
            return 0.0, 0.0
        (before, w), now = self._before, self._forces()
        moved = self._w.x.array - w
        local = np.array([np.dot(before + now, moved), np.dot(now - before, moved)]) / 2
        work, change = total(self._comm, local)
        return float(work), abs(float(change))

    @stage("assemble")
    def commit(self) -> None:
        """Makes the present state, at the present time, the past. Collective."""
        if self._t is None or self._step is None:
            return
        work, self.uncertainty = self._over_step()
        self._work += work
        for name, part in self._regions.items():
            part.commit(self._stresses[name], self._step)
        self._begin_at(self._now, self._work)

    # --- restarts ---

    def fields(self) -> dict[str, fem.Function]:
        """Name to function, in spaces of discontinuous elements, as `RestartState` has them."""
        return {
            f"history {i + 1}.{k}": function
            for i, part in enumerate(self._regions.values())
            for k, function in enumerate(part.functions())
        }

    def restart_state(self) -> dict[str, float]:
        """See `Restartable`: what is no field. Not collective."""
        return {"t": self._t or 0.0, "work": self._work}

    def restore(self, fields: Mapping[str, fem.Function], saved: Mapping[str, float]) -> None:
        """See `Restartable`; the problem has the state of that time already. Collective.

        Args:
            fields: As `fields` names them, filled; others are left out.
        """
        for i, part in enumerate(self._regions.values()):
            part.take([fields[f"history {i + 1}.{k}"] for k in range(len(part.tensors))])
        self._begin_at(saved["t"], saved["work"])
