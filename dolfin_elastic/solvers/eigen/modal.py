"""Natural frequencies and modes of vibration, at rest or about a loaded state, by SLEPc.

K u = omega^2 M u with the tangent K of the state about which the body vibrates and its consistent
mass M.  Source: K.-J. Bathe, Finite Element Procedures (2014), sections 4.2.1 and 10.2.
"""

from __future__ import annotations

import logging
from collections.abc import Generator, Iterator
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.core.errors import ConvergenceError, InputError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.petsc_options import PetscOptions
from dolfin_elastic.core.schema import settings_from
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.together import failing_together
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.amplitude import RAMP
from dolfin_elastic.problem.problem import Problem, partly_incompressible
from dolfin_elastic.problem.state import Mode, State
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.assembly.hydrostatic_constant import HydrostaticConstant
from dolfin_elastic.solvers.eigen.effective_mass import (
    Frame,
    Mass,
    RigidMode,
    rigid_modes,
)
from dolfin_elastic.solvers.eigen.mode_shapes import (
    at_rest,
    complete,
    refuse,
    shape,
    undetermined,
)
from dolfin_elastic.solvers.eigen.preload import PreloadedAnalysis
from dolfin_elastic.solvers.eigen.settings import UNMOVED, ModalSettings
from dolfin_elastic.solvers.eigen.slepc import (
    Pair,
    Spectrum,
    choose_eigen,
    thin,
    uneven,
)
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.linear.ksp import times
from dolfin_elastic.solvers.statics.settings import StaticsSettings

log = logging.getLogger("dolfin_elastic")


def constrained_motions(assembler: Assembler) -> int:
    """How many motions of its displacements a body does not have, for it is incompressible.

    Each pressure that stands in none of its own rows takes one away; one that is fixed, because
    the body is held all around, stands in its own. Collective.
    """
    problem = assembler.problem
    if not partly_incompressible(problem):
        return 0
    if problem.unknowns.stabilised:  # their own rows know all but the mean
        whole = all(region.incompressible for region in problem.regions)
        known = 0 if assembler.level is None else len(assembler.level.bodies)
        return 1 - known if whole else 0
    pressures = np.setdiff1d(np.arange(assembler.size), assembler.displacement_dofs)
    diagonal = assembler.tangent.matrix.getDiagonal()
    count = total(problem.body.comm, int(np.sum(diagonal.array_r[pressures] == 0.0)))
    diagonal.destroy()
    return count


MOST = 500
"""Modes that are looked for by frequency, at most."""

SOFT = 1e-3
"""First shift below zero, over the Rayleigh quotient of a smooth motion."""

FAR = 30.0
"""Ratio of shift to first eigenvalue from which the eigenvalue loses digits."""

NOTHING = 1e-8
"""Eigenvalues over the Rayleigh quotient of a smooth motion whose sign may be round-off."""


class Modal(PreloadedAnalysis):
    """Finds the modes of vibration of a problem.

    Args:
        problem: What vibrates; every material needs a density.
        settings: See `ModalSettings`; keyword arguments are its fields.
        statics: How the loaded state is found, with `preload`.
        petsc: PETSc and SLEPc options, which win over everything.
    """

    table = "modal"
    settings: ModalSettings

    def __init__(
        self,
        problem: Problem,
        settings: ModalSettings | None = None,
        *,
        statics: StaticsSettings | None = None,
        linear: LinearSettings | None = None,
        petsc: PetscOptions | None = None,
        **fields: Any,
    ) -> None:
        super().__init__(problem, statics, linear, petsc)
        self.settings = settings_from(ModalSettings, settings, fields)
        self._check_stiffness()
        self._check_statics_keys("modal.preload", 1.0 if self.settings.preload else 0.0)
        refuse(problem, "modal", loaded=self.settings.preload)
        for region in problem.regions:
            problem.context.density(region)  # raises where there is none
        counted = self.settings.below is not None
        self.choice = choose_eigen(problem, self.linear, counted=counted or thin(problem))
        if counted and not self.choice.direct:
            raise InputError(
                "modes below a frequency are counted by a factorisation, and an iterative "
                "solver makes none",
                where="modal.below",
                expected='count, or solver.method = "direct"',
            )

    def _steps(self) -> Generator[State | Mode, None, None]:
        """See `steps`."""
        self._choose_stiffness()
        self._warn_of_dashpots("undamped modes")
        if self.settings.preload:
            if self.problem.context.linear:
                log.warning(UNMOVED)
            yield from self._load(self.statics)
        else:
            at_rest(self.problem)
        yield from self._about_this_state()

    def _about_this_state(self) -> Generator[Mode, None, None]:
        """See `about_this_state`."""
        self._take_yielded()
        self.choice.report()
        vibration = Vibration(self)
        try:
            with failing_together(self.problem.body.comm):
                yield from vibration.modes()
        finally:
            vibration.destroy()


def _assembler(problem: Problem, *, loaded: bool, iterated: bool) -> Assembler:
    """Stiffness of the present state, without the load stiffness of follower loads if unloaded."""
    on = [
        load
        for load in problem.loads
        if load.follower and not load.is_eigenstrain and (load.amplitude or RAMP).at(0.0) != 0.0
    ]
    if loaded or not on or problem.weak_form.external is None:
        return Assembler(problem, iterated=iterated)
    trial = ufl.TrialFunction(problem.W)
    return Assembler(
        problem,
        extra=problem.weak_form.external,
        extra_tangent=ufl.derivative(problem.weak_form.external, problem.w, trial),
        iterated=iterated,
    )


class Vibration:
    """Stiffness and mass of a state, and their eigenmodes. Collective; `destroy` it."""

    def __init__(self, modal: Modal) -> None:
        self.problem, self.settings = modal.problem, modal.settings
        problem, comm = self.problem, self.problem.body.comm
        self._comm = comm
        loaded = self.settings.preload
        iterated = not (modal.choice.direct or modal.of_modes(loaded=loaded))
        self.assembler = _assembler(problem, loaded=loaded, iterated=iterated)
        self.mass = Mass(self.assembler)
        x = self.assembler.create_vector()
        self.assembler.get(x)
        self.assembler.tangent.assemble(x)
        x.destroy()
        self.assembler.tangent.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        with stage("assemble"):
            everywhere = np.ones(
                len(self.assembler.displacement_dofs) // problem.body.dim, dtype=bool
            )
            self.whole = Frame(problem, self.mass, everywhere)
            self.rigid = rigid_modes(self.assembler, self.mass)
            self.mass.constrain()
            if self.assembler.problem.mixed:
                HydrostaticConstant(self.assembler.problem).report()
            self.room = self._room() - constrained_motions(self.assembler) - len(self.rigid)
        if self.room <= 0 and not self.rigid:
            raise InputError(
                "nothing can vibrate: supports hold every node, or all but those that "
                "incompressibility holds",
                where="support",
                expected="some nodes that are free to move: a finer mesh, or fewer supports",
            )
        self.spectrum = Spectrum(
            self.assembler,
            self.mass.matrix,
            choice=modal.choice,
            users=modal.of_modes(loaded=loaded),
            tolerance=self.settings.tolerance,
        )
        self.smooth = self._smooth()

    def _room(self) -> int:
        """How many modes there are: displacements that nothing prescribes."""
        assembler = self.assembler
        free = len(assembler.displacement_dofs) - assembler.count
        return int(self._comm.allreduce(free))

    def modes(self) -> Iterator[Mode]:
        """Rigid modes, then all others. Collective."""
        shift, count = self._wanted()
        pairs = self._pairs(shift, count)
        base = fem.Function(self.problem.V, name="displacement")
        base.x.array[:] = self.problem.u.x.array
        result: list[RigidMode | Pair] = [*self.rigid, *pairs]
        if pairs and self._grows(pairs[0].value):
            log.warning("the state is unstable: some modes have no stiffness, but grow")
        for k, one in enumerate(result, start=1):
            yield self._mode(k, one, base, k / len(result))

    def _wanted(self) -> tuple[float, int]:
        """The shift, and how many modes to look for."""
        shift = self._shift()
        if self.settings.below is None:
            count = self.settings.count or 6
            if count > self.room:
                log.warning("%d modes asked for, there are only %d", count, self.room)
            return shift, min(count, self.room)
        top = (2 * np.pi * self.settings.below) ** 2
        number = self.spectrum.below(top) or self.spectrum.below(top * (1 + 1e-9)) or 0
        count = number - len(self.rigid)
        if count > MOST:
            raise InputError(
                f"{count} modes lie below {self.settings.below:g} Hz",
                where="modal.below",
                expected=f"a frequency with at most {MOST}, or count",
            )
        log.info("%d modes lie below %g Hz", count, self.settings.below)
        return shift, count

    def _shift(self) -> float:
        """A number below all eigenvalues, at which the matrix can be factorised.

        Zero where supports hold the body; with rigid modes, mechanisms or instabilities below zero.
        """
        if not self.rigid and (not self.spectrum.counted or self.spectrum.below(0.0) == 0):
            return 0.0
        shift, counts = -SOFT * self.smooth, set[int | None]()
        for _ in range(40):
            if not self.spectrum.counted or (below := self.spectrum.below(shift)) == 0:
                return shift
            counts.add(below)
            shift *= 10.0
        if counts == {None}:
            raise undetermined()
        raise ConvergenceError(
            "the loaded state has eigenvalues without bound below zero",
            advice="check the materials and the loads",
        )

    def _smooth(self) -> float:
        """Rayleigh quotient of a smooth motion without its rigid part [1/s^2]. Collective."""
        motion = uneven(self.problem, 0)
        motion[self.assembler.prescribed_dofs] = 0.0
        motion[self.assembler.skew_dofs] = 0.0
        self.assembler.extend(motion)
        image = self.mass.times(motion[:, None])[:, 0]
        for mode in self.rigid:
            motion = motion - self._product(mode.vector, image) * mode.vector
        columns = motion[:, None]
        stiff = times(self.assembler.tangent.matrix, columns)[:, 0]
        work = self._product(motion, stiff)
        return abs(work / self._product(motion, self.mass.times(columns)[:, 0]))

    def _grows(self, value: float) -> bool:
        """A negative eigenvalue that is no round-off."""
        return value < -NOTHING * self.smooth

    def _product(self, a: FloatArray, b: FloatArray) -> float:
        return float(self._comm.allreduce(float(np.sum(a * b))))

    def _pairs(self, shift: float, count: int) -> list[Pair]:
        """Elastic modes, complete up to the last."""
        known = [mode.vector for mode in self.rigid]
        for _ in range(3):
            pairs = complete(
                self.spectrum, shift, count, room=self.room, known=known, zeros=len(self.rigid)
            )
            first = abs(pairs[0].value) if pairs else np.inf
            if not (-shift > FAR * first and first > NOTHING * self.smooth):
                break
            shift = -first  # nearer, for the sake of the lowest ones
        return self.spectrum.in_double(pairs[:count])

    def _mode(self, number: int, pair: Pair | RigidMode, base: fem.Function, done: float) -> Mode:
        vector = pair.vector.copy()
        self.assembler.extend(vector)
        images = self.mass.times(vector[:, None])[:, 0]
        mass = self._product(vector, images)
        shared: FloatArray = total(self._comm, self.whole.images.T @ vector)
        rigid = isinstance(pair, RigidMode)
        value = 0.0 if isinstance(pair, RigidMode) else pair.value
        u, size = shape(self.problem, vector)
        return Mode(
            number=number,
            kind="rigid" if rigid else "unstable" if self._grows(value) else "elastic",
            u=u,
            base=base,
            eigenvalue=value,
            frequency=float(np.sqrt(max(value, 0.0)) / (2 * np.pi)),
            mass=mass / size**2,
            participation=self._named(shared / mass * size),
            effective=self._named(np.square(shared) / mass),
            whole=self._named(self.whole.whole),
            name=pair.name if isinstance(pair, RigidMode) else "",
            solver=self.spectrum.solver,
            done=done,
        )

    def _named(self, values: FloatArray) -> dict[str, float]:
        return {n: float(v) for n, v in zip(self.whole.names, values, strict=True)}

    def destroy(self) -> None:
        """Frees all matrices. Collective."""
        self.spectrum.destroy()
        self.mass.destroy()
        self.assembler.destroy()
