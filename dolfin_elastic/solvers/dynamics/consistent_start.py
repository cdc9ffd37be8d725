"""The consistent initial state: acceleration, and scalar fields such as the pressure.

Where a material is exactly incompressible the motion is a differential-algebraic equation of index
3.  The pressure p does not follow from the displacement: it is the Lagrange multiplier that keeps
the acceleration from changing the volume.  The constraint is g(u, t) = 0, which depends on t where
the material grows or is heated; B is its gradient.  Acceleration and pressure solve

    M a + B p = f,    -B^T a = d^2/dt^2 g(u + t v, t),

the second one being the second derivative of the constraint.  Its first derivative,
B^T v + dg/dt = 0, must hold for the initial velocity.  If it does not, the velocity is projected
onto the nearest one in the norm of the kinetic energy, by M dv + B q = 0: an impulse of pressure.
So is the displacement, which the program knows between its nodes only, by M du + B q = 0 and
g(u + du, 0) = 0: the first step would remove what is left of g, and throw the body as fast as that
is over the step.

Source: E. Hairer & G. Wanner, Solving Ordinary Differential Equations II (1996), sections VII.1,
consistent values of systems of index 3, and VII.2, projection.
"""

from __future__ import annotations

import logging

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.core.compat import collapsed
from dolfin_elastic.core.errors import ConvergenceError
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.petsc_options import PREFIX
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import cell_size
from dolfin_elastic.problem.problem import Problem, partly_incompressible, wholly_incompressible
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.assembly.mass import initial_acceleration, prescribed_acceleration
from dolfin_elastic.solvers.dynamics.residual import DynamicResidual
from dolfin_elastic.solvers.linear.choice import LAST_DIRECT, LinearSettings, choose, factorising
from dolfin_elastic.solvers.messages import linear
from dolfin_elastic.solvers.nonlinear.convergence import Tolerance
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.solvers.petsc.options import Options, ksp_reason

log = logging.getLogger("dolfin_elastic")

INERTIA_OVER_STIFFNESS = 1e6
"""Ratio of s M to K in the matrix; each solve leaves a relative error of its inverse."""

SOLVES = 3
"""Solves with one factorisation, after which the error is round-off."""

PLACES, ROUND_OFF = 20, 1e-13
"""Most corrections of the displacement, with one factorisation, and how small one ends them, over
the largest displacement."""

STRAIN = 1e-3
"""Strain of the differences in time, by which the body is moved along its velocity.

Its square is far above round-off; larger terms of g, a cubic polynomial of the displacement, do no
harm, for differences of four points are exact for it."""

FIRST, SECOND = (-11 / 6, 3.0, -3 / 2, 1 / 3), (2.0, -5.0, 4.0, -1.0)
"""Weights of the first and second derivative at the first of four points one step apart.

Differences are forward in time, for formulas in t and curves may have no values before the start.
"""

UNREPORTED, SMALL = 1e-6, 0.01
"""Changes of the velocity, over its largest component, up to which the projection is not reported,
and up to which it is information and no warning."""


def find_initial_acceleration(
    moving: DynamicResidual, v: fem.Function, a: fem.Function, h: float
) -> None:
    """Finds the acceleration of the initial state, and its pressure if that is a multiplier.

    Collective.

    Args:
        moving: The body; rates and the vector of `assembler.residual` are those of the initial
            state.
        v: Velocity [m/s]; projected where an incompressible material cannot have it.
        a: Receives the acceleration [m/s^2].
        h: Step of the differences in time of prescribed displacements [s].

    Raises:
        ConvergenceError: The linear system has no solution.
    """
    problem = moving.problem
    prescribed = prescribed_acceleration(problem, h)
    small = problem.num_dofs <= LAST_DIRECT[problem.body.dim]
    if partly_incompressible(problem) and not small:
        log.warning(
            "with so many unknowns the first acceleration and pressure of what cannot be "
            "compressed are not found: the motion begins without, and swings unless the scheme "
            "damps (generalized-alpha with a spectral_radius of 0.5)"
        )
    if not (partly_incompressible(problem) and small):
        initial_acceleration(moving.assembler, moving.inertia.mass, prescribed, a)
        return
    a.x.array[:] = 0.0
    problem.constraints.impose(a.x.array, prescribed)
    a.x.scatter_forward()
    if moving.assembler.max_displacement() > 0.0:
        place = _IncompressibleStart(moving, v, h)
        try:
            place.project_displacement()
        finally:
            place.destroy()
    start = _IncompressibleStart(moving, v, h)
    try:
        start.project(v)
        for count in range(SOLVES):
            start.correct(a, first=count == 0)
        moving.assembler.settle_pressures()
    finally:
        start.destroy()


def settle_auxiliary_fields(problem: Problem, assembler: Assembler) -> None:
    """Finds the scalar fields that are in equilibrium with an initial displacement. Collective.

    Nothing is done where the body is undeformed, or where a material is exactly incompressible:
    its pressure does not follow from the displacement.
    """
    if (
        not problem.unknowns.auxiliary_fields
        or partly_incompressible(problem)
        or assembler.max_displacement() == 0.0
    ):
        return
    fixed = Assembler(problem, displacement_fixed=True)
    newton = Newton(fixed, choose(problem, LinearSettings(method="direct")), Tolerance())
    start = problem.constraints.values.x.array.copy()
    try:
        problem.constraints.values.x.array[:] = problem.u.x.array
        newton.solve("basic")
    finally:
        problem.constraints.values.x.array[:] = start
        newton.destroy()
        fixed.destroy()
    assembler.residual.assemble()


class _IncompressibleStart:
    """Corrections of acceleration and pressure by [s M + K, B; B^T, -C] [a/s; p] = rhs.

    It is the matrix of Newton's method with a shift s so large that s M is far above K: no other
    matrix need be assembled. Collective.
    """

    def __init__(self, moving: DynamicResidual, v: fem.Function, h: float) -> None:
        self._moving, self._a, self._h = moving, moving.assembler, h
        self._problem, self._v = moving.problem, v.x.array[: len(moving.displacement_dofs)].copy()
        self._x, self._b = self._a.create_vector(), self._a.create_vector()
        moving.velocity_shift.value = 0.0
        diagonal = self._diagonal()
        diagonal[self._a.fixed_pressures] = 0.0
        self._no_compliance = diagonal[moving.auxiliary_dofs] == 0.0
        mass = moving.mass.array_r[moving.displacement_dofs]
        massive = mass > 0.0
        fastest = np.max(
            np.abs(diagonal[moving.displacement_dofs][massive]) / mass[massive], initial=0.0
        )
        self._s = INERTIA_OVER_STIFFNESS * largest(moving.comm, float(fastest))
        self._tangent(self._s)
        self._ksp = PETSc.KSP().create(moving.comm)
        self._ksp.setOptionsPrefix(PREFIX)
        self._ksp.setOperators(self._a.tangent.matrix)
        options = Options(factorising(self._problem.symmetric), {})
        with options.in_force():
            self._ksp.setFromOptions()
            self._ksp.setUp()

    def _tangent(self, shift: float) -> None:
        self._moving.acceleration_shift = shift
        self._a.get(self._x)
        self._a.tangent.invalidate()
        self._a.tangent.assemble(self._x, shift, unit=1.0)

    def _diagonal(self) -> FloatArray:
        self._tangent(0.0)
        diagonal = self._a.tangent.matrix.getDiagonal()
        result = np.array(diagonal.array_r)
        diagonal.destroy()
        return result

    def project_displacement(self) -> None:
        """Projects the displacement onto those that keep the volumes. Collective.

        As `project`, not with a stabilised pressure.
        """
        if self._problem.unknowns.stabilised:
            return
        moves, w = self._moving.displacement_dofs, self._problem.w.x.array
        size, before = self._a.max_displacement(), w[moves].copy()
        for _ in range(PLACES):
            rows = self._rows()[self._moving.auxiliary_dofs]
            self._b.set(0.0)
            self._b.array_w[self._moving.auxiliary_dofs] = np.where(self._no_compliance, -rows, 0.0)
            self._solve("initial displacement")
            w[moves] += self._x.array_r[moves]
            self._update_ghosts()
            if self._largest(self._x.array_r[moves]) <= ROUND_OFF * size:
                break
        change = self._largest(w[moves] - before)
        if change > UNREPORTED * size:
            log.log(
                logging.WARNING if change > SMALL * size else logging.INFO,
                "the displacement at the start, up to %.4g m, does not fit volumes that cannot "
                "change: changed by up to %.3g m",
                size,
                change,
            )

    def project(self, v: fem.Function) -> None:
        """Projects the velocity onto those that change no volume, and finds v . g'' v. Collective.

        With a stabilised pressure volumes may change, at a rate that depends on the unknown rate of
        the pressure: then the velocity is left as it is.

        Args:
            v: Velocity [m/s], changed.
        """
        speed = self._largest(self._v)
        step = self._step(speed)
        if step > 0.0 and not self._problem.unknowns.stabilised:
            rate = self._derivative(FIRST, step) / step
            self._b.set(0.0)
            self._b.array_w[self._moving.auxiliary_dofs] = np.where(self._no_compliance, -rate, 0.0)
            self._solve("initial velocity")
            change = self._x.array_r[self._moving.displacement_dofs].copy()
            self._v += change
            v.x.array[: len(change)] = self._v
            v.x.scatter_forward()
            self._report(self._largest(change), speed)
            step = self._step(self._largest(self._v))
        self._second_derivative: FloatArray = np.zeros(len(self._moving.auxiliary_dofs))
        if step > 0.0 and (self._problem.eigenstrains or not self._problem.linear):
            self._second_derivative = np.asarray(self._derivative(SECOND, step) / step**2)

    def _step(self, speed: float) -> float:
        """Step of the differences in time for a speed [m/s]; 0 where nothing changes [s]."""
        small = STRAIN * cell_size(self._problem.body) / speed if speed > 0.0 else np.inf
        if self._problem.eigenstrains:
            small = min(small, self._h)
        return small if small < np.inf else 0.0

    def _largest(self, values: FloatArray) -> float:
        return largest(self._moving.comm, float(np.max(np.abs(values), initial=0.0)))

    def _report(self, change: float, speed: float) -> None:
        if change > UNREPORTED * speed:
            log.log(
                logging.WARNING if change > SMALL * speed > 0.0 else logging.INFO,
                "the velocity at the start, of body and supports up to %.4g m/s, does not fit "
                "volumes that cannot change: changed by up to %.3g m/s",
                speed,
                change,
            )

    def _derivative(self, weights: tuple[float, ...], step: float) -> FloatArray:
        """Differences in time of the constraint g along the velocity, times the step's power [N].

        Args:
            weights: Of `FIRST` or `SECOND`.
            step: Between two of the four points [s].
        """
        moves, w = self._moving.displacement_dofs, self._problem.w.x.array
        here, result = w[moves].copy(), np.zeros(len(self._moving.auxiliary_dofs))
        for k, weight in enumerate(weights):
            w[moves] = here + k * step * self._v
            self._problem.set_time(k * step)
            result += weight * self._rows()[self._moving.auxiliary_dofs]
        w[moves] = here
        self._problem.set_time(0.0)
        self._update_ghosts()
        return result

    def _update_ghosts(self) -> None:
        self._problem.w.x.scatter_forward()
        self._problem.unknowns.w_to_u()

    def _rows(self) -> FloatArray:
        """The residual, without any boundary condition, of the problem's unknowns."""
        self._update_ghosts()
        self._a.residual.assemble()
        return self._a.residual.owned.copy()

    def _constraint(self, rows: FloatArray, *, first: bool) -> FloatArray:
        """Residual of the rows of the pressure that a solve has to remove.

        Rows without a diagonal (C = 0) are g itself, of the initial displacement, which is given:
        they are left out, for s would magnify their round-off.  So is, where C is a stabilisation
        that sees only differences of pressures, the mean of all rows, which is the total volume.
        The second derivative of the constraint is met by the first solve.

        Args:
            rows: Residual of the rows of the pressure [N].
        """
        rows = np.where(self._no_compliance, 0.0, rows)
        if self._problem.unknowns.stabilised and wholly_incompressible(self._problem):
            sums = total(self._moving.comm, np.array([rows.sum(), float(len(rows))]))
            rows = rows - sums[0] / sums[1]
        return rows + self._second_derivative / self._s if first else rows

    def correct(self, a: fem.Function, *, first: bool) -> None:
        """Corrects acceleration and pressure by one solve. Collective.

        Args:
            a: Acceleration [m/s^2], changed.
            first: It is the first solve, see `_constraint`.
        """
        moves, auxiliary = self._moving.displacement_dofs, self._moving.auxiliary_dofs
        size = len(moves)
        self._moving.set_rates(self._v, a.x.array[:size])
        rows = self._rows()
        rows[auxiliary] = self._constraint(rows[auxiliary], first=first)
        self._b.array_w[:] = -rows
        self._solve("initial acceleration")
        a.x.array[:size] += self._s * self._x.array_r[moves]
        a.x.scatter_forward()
        self._problem.w.x.array[auxiliary] += self._x.array_r[auxiliary]
        self._update_ghosts()

    def _solve(self, what: str) -> None:
        self._b.array_w[:] = self._a.balanced(self._b.array_r.copy())
        self._a.remove_constrained(self._b)
        self._ksp.solve(self._b, self._x)
        self._a.remove_constrained(self._x)
        reason = self._ksp.getConvergedReason()
        if reason < 0 or not np.isfinite(self._x.norm()):
            raise ConvergenceError(
                f"the {what} cannot be found: {linear(ksp_reason(reason))[0]}",
                advice="is every density positive, and are all initial values finite?",
            )

    def destroy(self) -> None:
        """Frees what it owns, and invalidates the tangent, which has its shift. Collective."""
        self._a.tangent.invalidate()
        for thing in (self._ksp, self._x, self._b):
            thing.destroy()


class AuxiliaryFields:
    """The scalar unknowns of a problem, each as a function of its own, for restarts.

    Collective to make.

    Attributes:
        fields: Name to function, up to date after `read`.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        result = {
            extra.name: collapsed(problem.W.sub(1 + k))
            for k, extra in enumerate(problem.unknowns.auxiliary_fields)
        }
        self._dofs = {name: dofs for name, (_, dofs) in result.items()}
        self.fields = {name: fem.Function(S, name=name) for name, (S, _) in result.items()}

    def read(self) -> None:
        """Copies all unknowns to the fields. Not collective."""
        for name, field in self.fields.items():
            field.x.array[:] = self._problem.w.x.array[self._dofs[name]]

    def write(self) -> None:
        """Copies the fields and the displacement to all unknowns. Not collective."""
        self._problem.unknowns.u_to_w()
        for name, field in self.fields.items():
            self._problem.w.x.array[self._dofs[name]] = field.x.array
