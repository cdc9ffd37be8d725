"""Load factors at which a body buckles, and how, by SLEPc.

All loads and prescribed displacements of the problem grow with one factor.  About an equilibrium
at the factor s0, at rest or under a preload,

    (K + (factor - s0) (K_sigma + K_load)) u = 0.

K is the tangent there.  K_sigma is the geometric stiffness of the stress that a growing factor
adds, which is that of the linear solution -K^-1 dR/ds, and K_load the stiffness that it adds to
loads that follow the body.  Both are those of the geometry at s0: what the displacements before
buckling do to the stiffness is left out.  The nearer s0 is to the factor, the less that is.
Before, the body must be stable: then K is positive, and the eigenvalues 1/(factor - s0) of
-(K_sigma + K_load) u = value K u are real.

Of a linearisation about s0 > 0 only the factors beyond s0 are taken.  Those between 0 and s0 are
none: there the way to s0 has led past, and the body was stable.  Those below 0 are farther from s0
than from the state at rest, so reversed loads are linearised at rest, whatever s0 is.

Sources: R. Cook et al., Concepts and Applications of Finite Element Analysis (2002), chapter 18;
Abaqus Analysis User's Guide, "Eigenvalue buckling prediction" (base state, load stiffness);
CalculiX CrunchiX User's Manual, "*BUCKLE".
"""

from __future__ import annotations

import logging
from collections.abc import Generator, Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.core.errors import ConvergenceError, InputError
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.petsc_options import PetscOptions
from dolfin_elastic.core.schema import settings_from
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.together import failing_together
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import cell_size
from dolfin_elastic.model.amplitude import Amplitude
from dolfin_elastic.model.kinematics import displacement_gradient
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import Mode, State
from dolfin_elastic.solvers.assembly.assembler import Assembler, Tangent, compiled, integral
from dolfin_elastic.solvers.assembly.matrix import BilinearForm
from dolfin_elastic.solvers.assembly.symmetric.blocks import halves
from dolfin_elastic.solvers.assembly.two_stage.form import tangent_of_external_terms
from dolfin_elastic.solvers.diagnostics.rigid_body import check_no_rigid_motion
from dolfin_elastic.solvers.diagnostics.stability import FactorisedTangent
from dolfin_elastic.solvers.eigen.critical_load import CriticalLoad
from dolfin_elastic.solvers.eigen.lobpcg import Cycle, NotConvergedError
from dolfin_elastic.solvers.eigen.mode_shapes import at_rest, refuse, shape
from dolfin_elastic.solvers.eigen.preload import PreloadedAnalysis
from dolfin_elastic.solvers.eigen.settings import BucklingSettings
from dolfin_elastic.solvers.eigen.slepc import Pair, choose_eigen, destroy
from dolfin_elastic.solvers.linear.block_rows import halved
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.statics.settings import StaticsSettings

log = logging.getLogger("dolfin_elastic")

LEAST_PART = 1e-6
"""Of the volume: more has yielded only where there is more than round-off."""
STEP = 1e-5
"""Displacement over the size of a cell across which the stress is differentiated.

The strain is smaller still: at 1e-6 the error of the central difference is about 1e-12, and
round-off 1e-10, of the stress.
"""

LARGE = 0.05
"""Mean strain from which a linearised state is far from the one at the load factor."""

SHARE = 1e-3
"""Difference of the load over which its forces are differentiated, which are linear in it."""

_Buckled = tuple[Pair, fem.Function, str]
"""Load factor and mode, the displacement of the state about which they were found, and by what."""


class Buckling(PreloadedAnalysis):
    """Finds the load factors at which a problem buckles, and the modes.

    Args:
        problem: What is loaded, without curves over time.
        settings: See `BucklingSettings`; keyword arguments are its fields.
        statics: How the loaded state is found, with a `preload`.
        petsc: PETSc and SLEPc options, which win over everything.
    """

    table = "buckling"
    settings: BucklingSettings

    def __init__(
        self,
        problem: Problem,
        settings: BucklingSettings | None = None,
        *,
        statics: StaticsSettings | None = None,
        linear: LinearSettings | None = None,
        petsc: PetscOptions | None = None,
        **fields: Any,
    ) -> None:
        super().__init__(problem, statics, linear, petsc)
        self.settings = settings_from(BucklingSettings, settings, fields)
        self._check_stiffness()
        self._check_statics_keys("buckling.preload", self.settings.preload)
        refuse(problem, "buckling", loaded=True)
        _check_laws(problem, self.settings.preload)
        _check_proportional(problem)
        self.choice = choose_eigen(problem, self.linear, counted=False)

    def _steps(self) -> Generator[State | Mode, None, None]:
        """See `steps`."""
        self._choose_stiffness()
        check_no_rigid_motion(self.problem)
        self._warn_of_dashpots("load factors")
        at_rest(self.problem)
        share, opposite = self.settings.preload, list[_Buckled]()
        if share > 0.0:
            if self.settings.negative:
                log.info("reversed loads are linearised at rest, which is nearer to them")
                opposite = self._linearised(0.0, [-1])
            yield from self._load(self.statics.model_copy(update={"end": share}))
        yield from self._about_this_state(opposite)

    def _about_this_state(self, opposite: Sequence[_Buckled] = ()) -> Generator[Mode, None, None]:
        """See `about_this_state`.

        Args:
            opposite: What was found for the reversed loads, if it was looked for elsewhere.
        """
        self._take_yielded()
        share = self.settings.preload
        both = self.settings.negative and share == 0.0
        modes = [*self._linearised(share, [1, -1] if both else [1]), *opposite]
        if not modes:
            raise ConvergenceError(
                "the body does not buckle: the loads make it only stiffer",
                advice="buckling.negative = true for the reversed loads",
            )
        for k, (pair, base, solver) in enumerate(modes, start=1):
            yield Mode(
                number=k,
                kind="buckling",
                u=shape(self.problem, pair.vector)[0],
                base=base,
                eigenvalue=pair.value,
                solver=solver,
                done=k / len(modes),
            )

    def _linearised(self, share: float, signs: Sequence[int]) -> list[_Buckled]:
        """Load factors about the present state, and the modes. Collective.

        Args:
            signs: 1 for the loads as they are, -1 for the reversed ones.
        """
        self.choice.report()
        base = fem.Function(self.problem.V, name="displacement")
        base.x.array[:] = self.problem.u.x.array
        buckled = list[_Buckled]()
        perturbation = Perturbation(self.problem, share, direct=self.choice.direct)
        try:
            with failing_together(self.problem.body.comm):
                for sign in signs:
                    pairs, solver = self._pairs(perturbation, share, sign)
                    _warn_of_strains(pairs, perturbation.strain_rate, share)
                    self._warn_of_yield(pairs, perturbation, share)
                    buckled += [(pair, base, solver) for pair in pairs]
        finally:
            perturbation.destroy()
        return buckled

    def _warn_of_yield(
        self, pairs: Sequence[Pair], perturbation: Perturbation, share: float
    ) -> None:
        """Warns where a metal yields between the linearised state and the nearest mode."""
        history, w = self.problem.history, self.problem.w.x.array
        if history is None or not history.flows or not pairs:
            return
        elastic, base = history.elastic, w.copy()
        nearest = min((p.value for p in pairs), key=lambda value: abs(value - share))
        history.choose(long_term=history.long_term)
        before = history.results()["yielded_fraction"]
        w[:] = base + (nearest - share) * perturbation.along
        part = history.results()["yielded_fraction"] - before
        w[:] = base
        history.choose(long_term=history.long_term, elastic=elastic)
        if part > LEAST_PART:
            log.warning(
                "at load factor %.6g %.2g %% of the volume would yield: the body buckles or "
                'collapses earlier than its elastic stiffness says; statics.method = "arc-length" '
                "shows where",
                nearest,
                100 * part,
            )

    def _pairs(self, perturbation: Perturbation, share: float, sign: int) -> tuple[list[Pair], str]:
        """Load factors and modes, beginning with the nearest, and what has found them."""
        wanted = self.settings.count
        perturbation.turn(-float(sign))
        critical = CriticalLoad(
            perturbation.assembler,
            perturbation.rate,
            choice=self.choice,
            users=self.of_modes(loaded=self.settings.preload > 0.0),
            tolerance=self.settings.tolerance,
        )
        try:
            pairs = critical.lowest(wanted, perturbation.cycle)
        finally:
            critical.destroy()
        if len(pairs) < wanted:
            log.warning(
                "%d buckling modes asked for under %s loads, there are only %d",
                wanted,
                "these" if sign > 0 else "the reversed",
                len(pairs),
            )
        return [Pair(share + sign * p.value, p.vector) for p in pairs], critical.solver


def _warn_of_strains(pairs: Sequence[Pair], strain_rate: float, share: float) -> None:
    """Warns where the strains between the linearised state and the nearest mode are large."""
    away = min((p.value for p in pairs), key=lambda value: abs(value - share), default=share)
    strain = abs(away - share) * strain_rate
    if strain > LARGE:
        log.warning(
            "on the way to load factor %.6g the body is strained by %.2g %% (mean), too "
            "much for a linearised state: %sa buckling.preload a little below %.6g, or a path with "
            'statics.method = "arc-length"',
            away,
            100 * strain,
            "" if away > 0 else "with the loads reversed in the case ",
            abs(away),
        )


class Perturbation:
    """A state, and what the loads change in it when they grow. Collective.

    Args:
        direct: It is factorised; else a multigrid is made, and factors only where that fails.

    Attributes:
        cycle: Of the stiffness; None: of factors only.
        assembler: Its tangent is K, ones on the diagonal where displacements are prescribed.
        rate: K_sigma + K_load, zero there; after `turn` with another sign.
        along: Rate of all unknowns with the load factor, ghosts included.
        strain_rate: Rate of the strain with the load factor, root of its mean square.
    """

    def __init__(self, problem: Problem, share: float, *, direct: bool = True) -> None:
        self._problem, self._share, self._direct = problem, share, direct
        self.cycle: Cycle | None = None
        self._sign = 1.0
        self.assembler = Assembler(problem, iterated=not direct)
        self._x = self.assembler.create_vector()
        try:
            self._make()
        except BaseException:
            self.assembler.destroy()
            raise
        finally:
            self._x.destroy()

    def _make(self) -> None:
        problem, assembler = self._problem, self.assembler
        base = problem.w.x.array.copy()
        rates = [self._residual(base, self._share + h) for h in (SHARE, -SHARE)]
        self._assembled(assembler.tangent, base, self._share)
        along = self._velocity(np.subtract(rates[1], rates[0]) / (2 * SHARE))
        top = largest(problem.body.comm, float(np.max(np.abs(along), initial=0.0)))
        if top == 0.0:
            raise InputError(
                "no load deforms the body", where="load", expected="at least one that does"
            )
        self.along, self.strain_rate = along, self._strain_rate(along)
        self.rate = self._rate(base, along, STEP * cell_size(problem.body) / top)
        self._residual(base, self._share)

    def _rate(self, base: FloatArray, along: FloatArray, step: float) -> PETSc.Mat:
        """Difference quotient of the stiffness of stress and loads."""
        problem, state = self._problem, fem.Function(self._problem.W)
        state.x.array[:] = base
        form = problem.weak_form.geometric(state)
        form += ufl.replace(tangent_of_external_terms(problem), {problem.w: state})
        (compiled_form,) = compiled(problem, [form])
        tangent = Tangent(self.assembler, BilinearForm(compiled_form), iterated=False)
        try:
            rate = self._assembled(tangent, base + step * along, self._share + step).copy()
            before = self._assembled(tangent, base - step * along, self._share - step)
            with stage("assemble"):
                rate.axpy(-1.0, before, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
                rate.scale(0.5 / step)
        finally:
            tangent.destroy()
        if halves(self.assembler.tangent.matrix) is None:
            return rate
        try:
            return halved(problem, compiled_form, rate)
        finally:
            rate.destroy()

    def turn(self, sign: float) -> None:
        """Makes `rate` the sum of both matrices times 1 or -1. Collective."""
        self.rate.scale(sign * self._sign)
        self._sign = sign

    def _put(self, values: FloatArray, share: float) -> None:
        """Sets the loads, and the vector of all unknowns."""
        self._problem.set_time(1.0, default=Amplitude(((0.0, share), (1.0, share))))
        self._problem.w.x.array[:] = values
        self.assembler.get(self._x)

    def _assembled(self, tangent: Tangent, values: FloatArray, share: float) -> PETSc.Mat:
        self._put(values, share)
        tangent.invalidate()
        tangent.assemble(self._x)
        return tangent.matrix

    def _velocity(self, forces: FloatArray) -> FloatArray:
        """K^-1 f, ghosts included."""
        assembler = self.assembler
        f, x = assembler.create_vector(), assembler.create_vector()
        f.array_w[:] = forces
        try:
            with stage("solve"):
                if self._direct or not self._solved_by_cycles(f, x):
                    self._solve_by_factors(f, x)
            along = fem.Function(self._problem.W)
            along.x.array[: assembler.size] = x.array_r
        finally:
            destroy(f, x)
        along.x.scatter_forward()
        return np.array(along.x.array)

    def _solved_by_cycles(self, f: PETSc.Vec, x: PETSc.Vec) -> bool:
        """Whether conjugate gradients converge, and the stiffness is shown to be positive."""
        stiffness = self.assembler.tangent.matrix
        self.cycle = Cycle(self._problem, stiffness)
        why = "the stiffness is not positive, or hardly"
        try:
            if self.cycle.is_positive(stiffness):
                if self.cycle.solve(f, x):
                    self.assembler.extend(x.array_w)
                    return True
                why = "conjugate gradients do not converge"
        except NotConvergedError:
            pass
        log.info("%s: factorising instead", why)
        self.cycle.destroy()
        self.cycle = None
        return False

    def _solve_by_factors(self, f: PETSc.Vec, x: PETSc.Vec) -> None:
        stability = FactorisedTangent(self.assembler)
        try:
            if not stability.sound or stability.negative != 0:
                raise ConvergenceError(
                    f"the body is not stable under {self._share:g} times the loads",
                    advice="a smaller buckling.preload; supports that hold every part",
                )
            stability.solve(f, x)
        finally:
            stability.destroy()

    def _strain_rate(self, along: FloatArray) -> float:
        """Root of the mean square of dE/ds = sym(F^T dF/ds), E = (F^T F - I)/2."""
        problem, w = self._problem, fem.Function(self._problem.W)
        w.x.array[:] = along
        rate = ufl.sym(
            problem.weak_form.F(problem.w).T * displacement_gradient(problem.weak_form.F(w))
        )
        forms = [ufl.inner(rate, rate), problem.constant(1.0)]
        volume = problem.weak_form.volume(None, 2)
        square, whole = (
            integral(problem, form) for form in compiled(problem, [f * volume for f in forms])
        )
        return float(np.sqrt(square / whole))

    def _residual(self, values: FloatArray, share: float) -> FloatArray:
        self._put(values, share)
        f = self.assembler.create_vector()
        self.assembler.residual.evaluate(self._x, f)
        result = f.array_r.copy()
        f.destroy()
        return result

    def destroy(self) -> None:
        """Frees both matrices and the multigrid. Collective."""
        destroy(self.cycle, self.assembler, self.rate)


def _check_laws(problem: Problem, preload: float) -> None:
    """Refuses laws of small rotations where the body or its loads turn with the displacement."""
    follows = [load.kind for load in problem.loads if load.follower and load.linearises]
    if preload > 0.0:
        reason = "its stiffness does not change under a preload"
    elif problem.context.linear and follows:
        reason = f"with it the load '{follows[0]}' does not follow the body"
    else:
        return
    for region in problem.regions:
        if region.law.linear:
            raise InputError(
                f"'{region.law.name()}' is a law of small rotations: {reason}",
                where=f"{region.table}.law",
                expected="st-venant-kirchhoff, which takes the same constants, or another law for "
                "large rotations",
            )


def _check_proportional(problem: Problem) -> None:
    """Refuses a buckling analysis without loads, or with loads that one factor cannot multiply."""
    if not problem.loads and all(support.at_rest for support in problem.supports):
        raise InputError(
            "no load deforms the body",
            where="load",
            expected="at least one, or a support that moves",
        )
    own = {
        "load": [load.amplitude is not None for load in problem.loads],
        "support": [not (support.at_rest or support.proportional) for support in problem.supports],
    }
    for key, rows in own.items():
        if any(rows):
            raise InputError(
                "a curve or a formula in t is not multiplied by a load factor",
                where=f"{key}[{rows.index(True)}].curve",
                expected="numbers without a curve, formulas without t",
            )
