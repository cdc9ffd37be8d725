"""A body in motion: its residual with inertia and damping, and the nodal forces of a step."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.context import show_velocity
from dolfin_elastic.problem.damping import Damping
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.term_list import forms_of
from dolfin_elastic.problem.weak_form import derives_from_strain
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled
from dolfin_elastic.solvers.assembly.mass import mass_diagonal
from dolfin_elastic.solvers.assembly.scalar_mass import InertiaForces, ScalarMass


@dataclass(frozen=True)
class Forces:
    """Nodal forces on a body at one moment, owned entries of all unknowns [N].

    Attributes:
        u: The displacement at that moment, owned entries [m].
        loads: Of loads.
        reactions: Of supports with prescribed displacements.
        restraints: Of springs, dashpots and obstacles.
        dashpots: Those of them that dashpots exert.
        contact: Those that rigid obstacles exert, shape (obstacles, entries of displacements).
        inertia: M a.
        damping: Of the material's viscosity and Rayleigh damping.
        ties: Of ties, on the entries that they tie.
        drag: The mass-proportional part of them, which resists rigid motions, too.
    """

    u: FloatArray
    loads: FloatArray
    reactions: FloatArray
    restraints: FloatArray
    dashpots: FloatArray
    contact: FloatArray
    inertia: FloatArray
    damping: FloatArray
    drag: FloatArray
    ties: FloatArray

    def mean(self, other: Forces) -> Forces:
        """Mean of two sets of forces, such as those at both ends of a step.

        Args:
            other: Of the same body.
        """
        ours, theirs = vars(self), vars(other)
        return Forces(**{name: (ours[name] + theirs[name]) / 2 for name in ours})


class DynamicResidual:
    """Residual and tangent of a body with mass.  Collective to make.

    Args:
        problem: What moves; of steps, if `over_step` has made it.
        mass: Rayleigh's factor of the mass [1/s].
        stiffness: Rayleigh's factor of the stiffness [s].
        iterated: See `Tangent`.

    Attributes:
        assembler: Residual with inertia and damping; owned here.
        inertia: Mass and rates in it.
        displacement_dofs: Owned entries of all unknowns that are displacements.
        auxiliary_dofs: The other owned entries: scalar fields, which have no inertia.
        acceleration_shift: Derivative of the acceleration by the displacement in the tangent
            [1/s^2].
        velocity_shift: The same of the velocity [1/s].
        mass: Diagonal of the mass matrix [kg]; owned here.
        obstacles: Terms of rigid obstacles.
        norm: Of the inertia forces at the stage that Newton's method solves for [N].
    """

    def __init__(
        self,
        problem: Problem,
        *,
        mass: float = 0.0,
        stiffness: float = 0.0,
        iterated: bool = False,
    ) -> None:
        self.problem, self.comm = problem, problem.body.comm
        self.damping = Damping(problem, mass, stiffness)
        self.acceleration_shift, self.velocity_shift = 0.0, self.damping.shift
        trial = problem.unknowns.displacement(ufl.TrialFunction(problem.W))
        dashpots, work = problem.weak_form.damping(trial), self.damping.work()
        self.inertia = InertiaForces(problem, ScalarMass(problem), self._mass_in_tangent)
        self.assembler = Assembler(
            problem,
            extra=work,
            extra_tangent=None if dashpots is None else self.velocity_shift * dashpots,
            inertia=self.inertia,
            damping=self.damping,
            iterated=iterated,
        )
        self.displacement_dofs = self.assembler.displacement_dofs
        self.auxiliary_dofs = np.setdiff1d(np.arange(self.assembler.size), self.displacement_dofs)
        against = problem.weak_form.damping()
        forms = {
            "damping": work,
            "dashpots": None if against is None else -against,
        }
        named = {name: form for name, form in forms.items() if form is not None}
        self._forms = dict(zip(named, compiled(problem, list(named.values())), strict=True))
        self.obstacles = [term for term in problem.terms if term.pose is not None]
        of_forms = [term for term in self.obstacles if not term.nodal]
        contact_forms = compiled(problem, forms_of(of_forms, "work"))
        self._contact_forms = dict(zip(of_forms, contact_forms, strict=True))
        # Restraints of a label are assembled as one: obstacles that share theirs with springs are
        # in them already, and must not be added once more.
        others = {term.label for term in problem.terms if term.pose is None}
        self._adds_restraint = [term.label not in others for term in self.obstacles]
        self._contact_labels = {term.label for term in self.obstacles} - others
        self._a: FloatArray = np.zeros(len(self.displacement_dofs))
        self._drag: FloatArray = self._a
        self._lumped = np.abs(self.inertia.mass.times(np.ones(len(self.displacement_dofs))))
        self.mass, self.norm = mass_diagonal(self.assembler, self.inertia.mass), 0.0

    def _mass_in_tangent(self) -> float:
        drag = self.damping.mass * float(self.velocity_shift.value)
        return self.acceleration_shift + drag

    def set_rates(self, v: FloatArray, a: FloatArray) -> None:
        """Sets the rates at which the residual is assembled. Collective.

        Args:
            v: Velocity, owned entries [m/s].
            a: Acceleration, owned entries [m/s^2].
        """
        self._drag = self.damping.mass * v
        self._a, rates = a.copy(), self.inertia.rates.x
        rates.array[: len(a)] = a + self._drag
        rates.scatter_forward()
        if self.problem.dashpots:
            show_velocity(self.problem.context, v)
        if self.damping.inside:
            self.damping.set_velocity(v)

    def set_unknowns(self, w: FloatArray) -> None:
        """Sets all unknowns, and the displacement with them. Collective.

        Args:
            w: Owned entries.
        """
        self.problem.w.x.array[: len(w)] = w
        self.problem.w.x.scatter_forward()
        self.problem.unknowns.w_to_u()

    def copy_to(self, U: PETSc.Vec, V: PETSc.Vec, v: fem.Function) -> None:
        """Gives TS the present state. Not collective.

        Args:
            U: Receives all unknowns.
            V: Receives the velocity in the rows of displacements.
            v: Velocity [m/s].
        """
        self.assembler.get(U)
        V.array_w[self.displacement_dofs] = v.x.array[: len(self.displacement_dofs)]

    def momentum(self, v: FloatArray) -> FloatArray:
        """M v, owned entries of all unknowns [kg m/s]. Collective.

        Args:
            v: Velocity, owned entries [m/s].
        """
        forces = np.zeros(self.assembler.size)
        forces[self.displacement_dofs] = self.inertia.mass.times(v)
        return forces

    @property
    def factor(self) -> float:
        """Factor of the mass matrix in the tangent [1/s^2], as `Newton` asks for it."""
        return self.acceleration_shift

    def set_stage_rates(self, v: FloatArray, a: FloatArray) -> None:
        """Sets the rates of a stage, and `norm`, by which its residual is judged. Collective.

        The norm is that of lumped masses, which is found without the consistent mass matrix.

        Args:
            v: Velocity, owned entries [m/s].
            a: Acceleration, owned entries [m/s^2].
        """
        self.set_rates(v, a)
        with np.errstate(over="ignore", invalid="ignore"):
            self.norm = float(np.sqrt(total(self.comm, np.sum((self._lumped * a) ** 2))))

    @property
    def conserves(self) -> bool:
        """The stress of all regions is that of steps, which conserves energy and momenta."""
        of_steps = self.problem.weak_form.start is not None
        return of_steps and all(derives_from_strain(part.law) for part in self.problem.regions)

    @contextmanager
    def step_from(self, w: FloatArray) -> Iterator[None]:
        """Within it, internal forces are those of a step, where the problem has such. Collective.

        Args:
            w: All unknowns at the start of the step, owned entries.
        """
        start = self.problem.weak_form.start
        if start is None:
            yield
            return
        start.w.x.array[: len(w)] = w
        start.w.x.scatter_forward()
        start.share.value = 1.0
        try:
            yield
        finally:
            start.share.value = 0.0

    def contact_forces(self) -> FloatArray:
        """`Forces.contact` at the present state. Collective."""
        rows = np.zeros((len(self.obstacles), len(self.displacement_dofs)))
        for row, term in zip(rows, self.obstacles, strict=True):
            form, reactions = self._contact_forms.get(term), self.assembler.reactions
            forces = reactions.of_term(term) if form is None else reactions.nodal(form)
            row[:] = forces[self.displacement_dofs]
        return rows

    def forces_at(self, t: float, v: FloatArray, a: FloatArray) -> Forces:
        """Forces at the present displacement, after assembling the residual there. Collective.

        Args:
            t: Time [s]; it is the problem's afterwards.
            v: Velocity, owned entries [m/s].
            a: Acceleration [m/s^2].
        """
        with stage("assemble"):
            self.problem.set_time(t)
            self.set_rates(v, a)
            self.assembler.residual.assemble()
            return self.forces()

    def forces(self) -> Forces:
        """Forces at the state at which the residual was assembled last. Collective."""
        a = self.assembler
        nothing = np.zeros(a.size)
        nodal = {name: a.reactions.nodal(form).copy() for name, form in self._forms.items()}
        drag = nothing if self.damping.mass == 0.0 else self.momentum(self._drag)
        contact, restraints = self.contact_forces(), a.reactions.restraints(self._contact_labels)
        restraints[self.displacement_dofs] += contact[self._adds_restraint].sum(axis=0)
        return Forces(
            u=self.problem.w.x.array[self.displacement_dofs],
            loads=a.reactions.loads(),
            reactions=a.constrained_part(a.residual.owned),
            restraints=restraints,
            dashpots=nodal.get("dashpots", nothing),
            contact=contact,
            inertia=self.momentum(self._a),
            damping=nodal.get("damping", nothing) + drag,
            drag=drag,
            ties=a.residual.tied_nodal,
        )

    def destroy(self) -> None:
        """Frees what it owns. Collective."""
        self.mass.destroy()
        self.assembler.destroy()
