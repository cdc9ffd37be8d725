"""The beginning of a motion of exactly incompressible bodies: acceleration and pressure together.

The pressure of such a body is no function of its shape: it is what keeps the acceleration from
changing the volume.  With the constraint g(u, t) = 0, on t where the material grows or is heated,
and B its gradient, M a + B p = f and -B^T a = d^2/dt^2 g(u + t v, t): its second derivative in
time.  Its first one, B^T v + dg/dt = 0, says which velocities there are; one that is not is brought
to the nearest one in the norm of the kinetic energy, by M dv + B q = 0: an impulse of pressure.
Source: E. Hairer & G. Wanner, Solving Ordinary Differential Equations II (1996), sections VII.1,
consistent values of systems of index 3, and VII.2, projection.
"""

from __future__ import annotations

import logging

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.core.errors import ConvergenceError
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.petsc_options import PREFIX
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import cell_size
from dolfin_elastic.problem.incompressible import partly_incompressible, wholly_incompressible
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.assembly.mass import held_acceleration, initial_acceleration
from dolfin_elastic.solvers.dynamics.residual import DynamicResidual
from dolfin_elastic.solvers.linear.choice import LAST_DIRECT, LinearSettings, choose, factorising
from dolfin_elastic.solvers.nonlinear.convergence import Tolerance
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.solvers.petsc.options import Options, ksp_reason

log = logging.getLogger("dolfin_elastic")

HEAVY = 1e6
"""Inertia over stiffness in the matrix; each solve leaves an error of its inverse."""

SOLVES = 3
"""With one factorisation: their errors fall to those of rounding."""

STRAIN = 1e-3
"""To which the body is moved along its velocity: its square is far above round-off, and what is
left of g, a cubic polynomial of the place, is exact in differences of four points."""

FIRST, SECOND = (-11 / 6, 3.0, -3 / 2, 1 / 3), (2.0, -5.0, 4.0, -1.0)
"""Weights of derivatives at the first of four points one apart, looking ahead: formulas in t and
curves need have no past."""

UNSAID, SMALL = 1e-6, 0.01
"""Changes of a velocity, over its largest, that nobody is told of, and that nobody is warned of."""


def begin(moving: DynamicResidual, v: fem.Function, a: fem.Function, h: float) -> None:
    """Finds the acceleration, and the pressure where it is exact, of the initial state. Collective.

    Args:
        moving: The body; its rates are those of the initial state, and so is the vector of
            `assembler.residual`.
        v: Velocity [m/s]; changed where what is incompressible cannot have it.
        a: Receives the acceleration [m/s^2].
        h: Step of the differences of what is prescribed [s].

    Raises:
        ConvergenceError: There is none.
    """
    problem = moving.problem
    held = held_acceleration(problem, h)
    small = problem.num_dofs <= LAST_DIRECT[problem.body.dim]
    if partly_incompressible(problem) and not small:
        log.warning(
            "with so many unknowns the first acceleration and pressure of what cannot be "
            "compressed are not found: the motion begins without, and swings unless the scheme "
            "damps (generalized-alpha with a spectral_radius of 0.5)"
        )
    if not (partly_incompressible(problem) and small):
        initial_acceleration(moving.assembler, held, a)
        return
    a.x.array[:] = 0.0
    problem.dirichlet.impose(a.x.array, held)
    a.x.scatter_forward()
    saddle = _Saddle(moving, v, h)
    try:
        saddle.project(v)
        for count in range(SOLVES):
            saddle.correct(a, first=count == 0)
    finally:
        saddle.destroy()


def settle(problem: Problem, assembler: Assembler) -> None:
    """Finds the scalar fields that belong to an initial displacement. Collective.

    Args:
        problem: Its scalar fields are changed.
        assembler: Whose `balance` is assembled anew.
    """
    if (
        not problem.unknowns.auxiliary_fields
        or partly_incompressible(problem)
        or assembler.max_displacement() == 0.0
    ):
        return  # an exactly incompressible body's pressure does not follow from its shape
    still = Assembler(problem, still=True)
    newton = Newton(still, choose(problem, LinearSettings(method="direct")), Tolerance())
    start = problem.dirichlet.values.x.array.copy()
    try:
        problem.dirichlet.values.x.array[:] = problem.u.x.array
        newton.solve("basic")
    finally:
        problem.dirichlet.values.x.array[:] = start
        newton.destroy()
        still.destroy()
    assembler.residual.assemble()


class _Saddle:
    """[s M + K, B; B^T, -C] [a/s; p] with s M far above K: corrections of both. Collective."""

    def __init__(self, moving: DynamicResidual, v: fem.Function, h: float) -> None:
        self._moving, self._a, self._h = moving, moving.assembler, h
        self._problem, self._v = moving.problem, v.x.array[: len(moving.moves)].copy()
        self._x, self._b = self._a.create_vector(), self._a.create_vector()
        moving.drag.value = 0.0
        diagonal = self._diagonal()
        self._pure = diagonal[moving.extras] == 0.0
        mass = moving.mass.array_r[moving.moves]
        heavy = mass > 0.0
        fastest = np.max(np.abs(diagonal[moving.moves][heavy]) / mass[heavy], initial=0.0)
        self._s = HEAVY * largest(moving.comm, float(fastest))
        self._tangent(self._s)
        self._ksp = PETSc.KSP().create(moving.comm)
        self._ksp.setOptionsPrefix(PREFIX)
        self._ksp.setOperators(self._a.tangent.matrix)
        options = Options(factorising(self._problem.symmetric), {})
        with options.in_force():
            self._ksp.setFromOptions()
            self._ksp.setUp()

    def _tangent(self, shift: float) -> None:
        self._moving.shift.value = shift
        self._a.get(self._x)
        self._a.tangent.invalidate()
        self._a.tangent.assemble(self._x, shift, unit=1.0)

    def _diagonal(self) -> FloatArray:
        self._tangent(0.0)
        diagonal = self._a.tangent.matrix.getDiagonal()
        found = np.array(diagonal.array_r)
        diagonal.destroy()
        return found

    def project(self, v: fem.Function) -> None:
        """Brings the velocity to one that changes no volume, and finds v . g'' v. Collective.

        Stabilised pressures let volumes change, and how much goes with a rate that is not known.
        """
        speed = self._largest(self._v)
        step = self._step(speed)
        if step > 0.0 and not self._problem.unknowns.stabilised:
            rate = self._derivative(FIRST, step) / step
            self._b.set(0.0)
            self._b.array_w[self._moving.extras] = np.where(self._pure, -rate, 0.0)
            self._solve("initial velocity")
            change = self._x.array_r[self._moving.moves].copy()
            self._v += change
            v.x.array[: len(change)] = self._v
            v.x.scatter_forward()
            self._tell(self._largest(change), speed)
            step = self._step(self._largest(self._v))
        self._curved: FloatArray = np.zeros(len(self._moving.extras))
        if step > 0.0 and (self._problem.eigenstrains or not self._problem.linear):
            self._curved = np.asarray(self._derivative(SECOND, step) / step**2)

    def _step(self, speed: float) -> float:
        """Step of differences in time [s]; 0 where nothing changes."""
        small = STRAIN * cell_size(self._problem.body) / speed if speed > 0.0 else np.inf
        if self._problem.eigenstrains:
            small = min(small, self._h)
        return small if small < np.inf else 0.0

    def _largest(self, values: FloatArray) -> float:
        return largest(self._moving.comm, float(np.max(np.abs(values), initial=0.0)))

    def _tell(self, change: float, speed: float) -> None:
        if change > UNSAID * speed:
            log.log(
                logging.WARNING if change > SMALL * speed > 0.0 else logging.INFO,
                "the velocity at the start, of body and supports up to %.4g m/s, does not fit "
                "volumes that cannot change: changed by up to %.3g m/s",
                speed,
                change,
            )

    def _derivative(self, weights: tuple[float, ...], step: float) -> FloatArray:
        """Sum of the pressure's rows on the way along the velocity, a step apart [N]."""
        moves, w = self._moving.moves, self._problem.w.x.array
        here, found = w[moves].copy(), np.zeros(len(self._moving.extras))
        for k, weight in enumerate(weights):
            w[moves] = here + k * step * self._v
            self._problem.set_time(k * step)
            found += weight * self._rows()[self._moving.extras]
        w[moves] = here
        self._problem.set_time(0.0)
        self._told()
        return found

    def _told(self) -> None:
        self._problem.w.x.scatter_forward()
        self._problem.unknowns.w_to_u()

    def _rows(self) -> FloatArray:
        """The residual, without any boundary condition, of the problem's unknowns."""
        self._told()
        self._a.residual.assemble()
        return self._a.residual.owned.copy()

    def _constraint(self, rows: FloatArray, *, first: bool) -> FloatArray:
        """What is off in the pressure's rows.

        Where p stands in none of its own rows they are left as they are found: an initial shape is
        what it is, and s would blow its round-off up.  So would it that of the whole volume where
        C knows but the differences of pressures.  The solve itself meets the derivative at once.
        """
        rows = np.where(self._pure, 0.0, rows)
        if self._problem.unknowns.stabilised and wholly_incompressible(self._problem):
            found = total(self._moving.comm, np.array([rows.sum(), float(len(rows))]))
            rows = rows - found[0] / found[1]
        return rows + self._curved / self._s if first else rows

    def correct(self, a: fem.Function, *, first: bool) -> None:
        """One solve. Collective.

        Args:
            a: The acceleration [m/s^2], changed.
            first: It has not met the constraint's second derivative yet.
        """
        moves, extras = self._moving.moves, self._moving.extras
        size = len(moves)
        self._moving.set_rates(self._v, a.x.array[:size])
        rows = self._rows()
        rows[extras] = self._constraint(rows[extras], first=first)
        self._b.array_w[:] = -rows
        self._solve("initial acceleration")
        a.x.array[:size] += self._s * self._x.array_r[moves]
        a.x.scatter_forward()
        self._problem.w.x.array[extras] += self._x.array_r[extras]
        self._told()

    def _solve(self, what: str) -> None:
        self._a.remove_constrained(self._b)
        self._ksp.solve(self._b, self._x)
        self._a.remove_constrained(self._x)
        reason = self._ksp.getConvergedReason()
        if reason < 0 or not np.isfinite(self._x.norm()):
            raise ConvergenceError(
                f"the {what} cannot be found: {ksp_reason(reason)}",
                advice="is every density positive, and are all initial values finite?",
            )

    def destroy(self) -> None:
        """Frees what it owns, and the tangent of what it has put there. Collective."""
        self._a.tangent.invalidate()
        for thing in (self._ksp, self._x, self._b):
            thing.destroy()


class AuxiliaryFields:
    """The scalar unknowns of a problem, each in a space of its own.  Collective to make.

    Args:
        problem: Whose unknowns.

    Attributes:
        fields: Name to function, up to date after `take`.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        found = {
            extra.name: problem.W.sub(1 + k).collapse()
            for k, extra in enumerate(problem.unknowns.auxiliary_fields)
        }
        self._dofs = {name: dofs for name, (_, dofs) in found.items()}
        self.fields = {name: fem.Function(S, name=name) for name, (S, _) in found.items()}

    def take(self) -> None:
        """From all unknowns to the fields. Not collective."""
        for name, field in self.fields.items():
            field.x.array[:] = self._problem.w.x.array[self._dofs[name]]

    def give(self) -> None:
        """From the fields and the displacement to all unknowns. Not collective."""
        self._problem.unknowns.u_to_w()
        for name, field in self.fields.items():
            self._problem.w.x.array[self._dofs[name]] = field.x.array
