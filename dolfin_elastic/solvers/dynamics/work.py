"""Energies of a motion: what its states store, and the work that loads and supports have done.

`MotionBook` evaluates the energies of a state.  Work depends on the path between two states:
implicit schemes sum it up in an `EnergyBalance`, from the forces of each step, which they have
anyway; explicit ones in an `ExternalWork`.  That assembles forces of its own, but only where the
work does not follow from two states, because one such force costs as much as an explicit step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Protocol

import numpy as np
import ufl
from dolfinx import fem, la

from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.term import Term
from dolfin_elastic.problem.term_list import forms_of
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled, integral
from dolfin_elastic.solvers.assembly.energy_momentum import NodalMass
from dolfin_elastic.solvers.assembly.nodal_forces import Forces as NodalForces
from dolfin_elastic.solvers.audit.equilibrium import EnergyBook
from dolfin_elastic.solvers.dynamics.implicit.volume_constraint import PressureEnergy
from dolfin_elastic.solvers.dynamics.residual import DynamicResidual, Forces


class Damper(Protocol):
    """Damping whose work is summed up."""

    @property
    def viscous(self) -> bool:
        """There is bulk viscosity."""

    def take(self) -> FloatArray:
        """This rank's work since the last call, of all damping and of bulk viscosity [J].

        Not collective.
        """


Measures = tuple[dict[str, float], dict[str, FloatArray]]
"""Energies [J] by name, and momenta by name: "linear" [kg m/s], "angular" [kg m^2/s]."""

_NAMES = ("external", "damping", "dashpots", "friction")

_NOISE = 10.0
"""Round-off of the stored energy over eps mu V: up to 1.8 was found, of laws whose energy is a
difference, such as neo-Hookean and corotated ones."""


Work = Callable[[float, float], dict[str, float]]
"""Gives the work since the start of a motion, up to its present state, and what follows from it [J]
by name, of its kinetic energy and of what it has stored in strains and contact penalties [J], nan
where a law has no energy.  Collective."""


class MotionBook(EnergyBook):
    """Energies and momenta of the states of a motion. Collective to make.

    Args:
        inertia: Kinetic energy and momenta of its velocity, with the mass of the scheme.
        pressure: Where the pressure is not that of the states.
    """

    def __init__(
        self,
        problem: Problem,
        inertia: NodalMass,
        work: Work,
        pressure: PressureEnergy | None = None,
    ) -> None:
        super().__init__(problem, ("springs", "contact"))
        self._inertia, self._work, self._pressure = inertia, work, pressure

    @np.errstate(all="ignore")  # whether the values are finite is asked by `finite`
    def measure(self) -> Measures:
        """Energies and momenta of the present displacement and velocity. Collective."""
        kinetic, linear, angular = self._inertia.measure()
        stored = self.stored()
        if self._pressure is not None:
            stored["strain"] += self._pressure.energy()
        inside = stored["strain"] + stored.get("contact", 0.0)
        energies = {
            "strain": stored.pop("strain"),
            "kinetic": kinetic,
            "total": inside + kinetic,
            **self._work(kinetic, inside),
            **stored,
        }
        return energies, {"linear": linear, "angular": angular}

    def finite(self, energies: Mapping[str, float], forces: FloatArray) -> bool:
        """Whether energies and forces are finite, but for energies a law lacks. Collective.

        Args:
            energies: From `measure` [J].
            forces: At owned entries [N].
        """
        missing = ("strain", "total") if self.none else ()
        values = [energy for name, energy in energies.items() if name not in missing]
        bad = not (np.isfinite(values).all() and np.isfinite(forces).all())
        return largest(self._problem.body.comm, float(bad)) == 0.0


def supports_move(problem: Problem) -> bool:
    """A prescribed displacement is not zero."""
    return any(not s.at_rest for s in problem.supports if s not in problem.springs)


def springs_of_friction(problem: Problem) -> float:
    """What points that stick store [J]. Collective."""
    return sum(term.energy() for term in problem.terms if term.dissipates)


class Middle:
    """How rigid obstacles carry points of the body in a step."""

    def __init__(self, problem: Problem) -> None:
        self._dim, own = problem.body.dim, problem.V.dofmap.index_map.size_local
        self._u = problem.u.x.array[: own * self._dim]
        self._X = problem.V.tabulate_dof_coordinates()[:own, : self._dim]

    def carried(self, term: Term, before: FloatArray, du: FloatArray) -> FloatArray:
        """Motion of what was at the owned nodes in the middle of a step, owned entries [m].

        Args:
            term: Of a rigid obstacle, with a pose that is not None.
            before: That of the start of the step, see `Pose.now`.
            du: Change of the displacement up to now, owned entries [m].
        """
        assert term.pose is not None
        places = self._X + (self._u - du / 2).reshape(-1, self._dim)
        return term.pose.carried(before, places).reshape(-1)


# --- implicit motion ---


class EnergyBalance:
    """Work, dissipation and balance of energy of an implicit motion.

    The work of a step is that of the forces in the middle of it on its displacement, of second
    order: forces of the stage where that is the middle, else the mean of those at both ends.
    Penalty energy of contacts counts as the body's, so obstacles do work only where they move.
    Friction takes up the work over the motion past an obstacle: "friction" is what of it is lost.
    What springs of points that stick store counts as that of the contact.
    Moving supports do work against the inertia of their nodes, M dv . (v0 + v1)/2: the change of
    their kinetic energy, also of a support that is set going at once, with an unbounded force.

    Collective to make.

    Attributes:
        scale: The largest energy so far [J].
    """

    def __init__(self, moving: DynamicResidual, v: fem.Function) -> None:
        self._moving, self._velocity = moving, v
        self._supports_move = supports_move(moving.problem)
        self._v: FloatArray = np.empty(0)
        self._sums = dict.fromkeys(_NAMES, 0.0)
        self._initial: float | None = None
        self.scale = 0.0
        problem = moving.problem
        self._constant = problem.loaded and not problem.loads_change
        self._poses: list[FloatArray] = []
        self._middle = Middle(problem)
        self._springs = 0.0
        size = problem.constant(1.0) * problem.weak_form.volume(None, 1)
        volume = integral(problem, compiled(problem, [size])[0])
        self._round_off = _NOISE * np.finfo(float).eps * problem.stiffness * volume

    def begin(self) -> None:
        """Takes in positions of obstacles and the velocity that the motion begins with."""
        self._poses = self._poses_now()
        self._v = self._velocity_now()
        self._springs = springs_of_friction(self._moving.problem)

    def add(self, forces: Forces, contact: FloatArray, du: FloatArray) -> None:
        """Adds the work of one step. Collective.

        Args:
            forces: In the middle of the step; the problem's time is that of its end.
            contact: `Forces.contact` of its stage: obstacles feel what the body does.
            du: Change of the displacement, owned entries [m].
        """
        moves = self._moving.displacement_dofs
        outside = forces.loads + forces.reactions + forces.restraints
        rows = (outside, forces.damping, -forces.dashpots)
        local = np.array([*(np.dot(row[moves], du) for row in rows), 0.0])
        before, self._poses = self._poses, self._poses_now()
        local[0] -= np.dot(forces.contact.sum(axis=0), du)
        for term, push, pose in zip(self._moving.obstacles, contact, before, strict=True):
            work = np.dot(push, self._middle.carried(term, pose, du))
            local[0] += work
            local[3] += (work - np.dot(push, du)) * term.dissipates
        if self._supports_move:
            local[0] += self._work_against_inertia(forces, du)
        sums = total(self._moving.comm, local)
        springs, self._springs = self._springs, springs_of_friction(self._moving.problem)
        sums[3] += springs - self._springs
        for name, value in zip(_NAMES, sums, strict=True):
            self._sums[name] += float(value)

    def _work_against_inertia(self, forces: Forces, du: FloatArray) -> float:
        """Work of supports against inertia that the reactions do not contain, on this rank [J].

        Args:
            du: Change of the displacement, owned entries [m].
        """
        a, moves = self._moving.assembler, self._moving.displacement_dofs
        before, self._v = self._v, self._velocity_now()
        change = a.constrained_part(self._moving.momentum(self._v - before))[moves]
        pushed = a.constrained_part(forces.inertia)[moves]
        return float(np.dot(change, (before + self._v) / 2) - np.dot(pushed, du))

    def _velocity_now(self) -> FloatArray:
        """A copy of the present velocity, owned entries [m/s]."""
        return self._velocity.x.array[: len(self._moving.displacement_dofs)].copy()

    def _poses_now(self) -> list[FloatArray]:
        """Those of the obstacles."""
        return [one.pose.now for one in self._moving.obstacles if one.pose is not None]

    @property
    def work(self) -> float:
        """What has come in and has not been dissipated so far [J]."""
        return self._sums["external"] - self._sums["damping"] - self._sums["friction"]

    def energies(self, kinetic: float, stored: float) -> dict[str, float]:
        """See `Work`; with dissipation, potential and balance. Collective."""
        result = {"external": self._sums["external"]}
        if not self._moving.damping.none:
            result["damping"] = self._sums["damping"]
        if self._moving.problem.dashpots:
            result["dashpots"] = self._sums["dashpots"]
        if self._moving.problem.terms.dissipates:
            result["friction"] = self._sums["friction"]
        if self._constant:  # minus forces times displacement
            a, moves = self._moving.assembler, self._moving.displacement_dofs
            work = np.dot(a.reactions.loads()[moves], a.problem.w.x.array[moves])
            result["potential"] = -float(total(a.comm, float(work)))
        if math.isfinite(stored):
            if self._initial is None:
                self._initial = kinetic + stored
            lost = self._sums["damping"] + self._sums["friction"]
            result["balance"] = kinetic + stored - self._initial + lost - self._sums["external"]
            moved = abs(self._sums["external"]) + lost
            self.scale = max(self.scale, kinetic, abs(stored), moved)
        return result

    def relative_imbalance(self, energies: Mapping[str, float]) -> float:
        """Energy out of balance over the largest energy so far; positive: a gain. Not collective.

        Dissipation that is negative is a gain, too.  Round-off of the stored energy is left out:
        where hardly anything moves, it would be all of the energy.

        Args:
            energies: From `MotionBook.measure` [J].
        """
        balance, noise = energies.get("balance", 0.0), self._round_off
        balance = max(balance, -energies.get("damping", 0.0)) if balance >= 0.0 else balance
        if self.scale == 0.0 or abs(balance) <= noise:
            return 0.0
        return (balance - math.copysign(noise, balance)) / self.scale

    # --- restarts ---

    def restart_state(self) -> dict[str, float | None]:
        """See `Restartable`. Not collective."""
        return {**self._sums, "initial": self._initial, "scale": self.scale}

    def restore(self, saved: Mapping[str, float | None]) -> None:
        """See `Restartable`; the problem has the state of that time already. Collective."""
        self.begin()
        self._sums = {name: float(saved.get(name) or 0.0) for name in _NAMES}
        self._initial, self.scale = saved["initial"], float(saved["scale"] or 0.0)


# --- explicit motion ---


class _Path:
    """Work of nodal forces that is summed up step by step, by the trapezoidal rule.

    Args:
        forces: Gives those at the present state, owned entries [N]; collective.
        obstacle: What they move instead of the body.
        middle: Gives how; None without an obstacle.
        past: They are friction on what moves so; their work is what they take from the body's
            motion past it.

    Attributes:
        past: See above.
    """

    def __init__(
        self,
        forces: Callable[[], FloatArray],
        obstacle: Term | None = None,
        middle: Middle | None = None,
        *,
        past: bool = False,
    ) -> None:
        self._forces, self._obstacle, self._middle, self.past = forces, obstacle, middle, past
        self._before: FloatArray = np.empty(0)
        self._pose: FloatArray = self._before

    def begin(self) -> None:
        """Takes in the state from which the next step starts. Collective."""
        self._before = self._forces().copy()
        if self._obstacle is not None and self._obstacle.pose is not None:
            self._pose = self._obstacle.pose.now

    def step(self, du: FloatArray) -> float:
        """This rank's share of the work of a step [J]. Collective.

        Args:
            du: Change of the displacement in the step, owned entries [m].
        """
        if (one := self._obstacle) is not None and one.pose is not None:
            assert self._middle is not None
            along, self._pose = self._middle.carried(one, self._pose, du), one.pose.now
            du = along - du if self.past else along
        now = self._forces()
        work = 0.5 * (np.dot(self._before, du) + np.dot(now, du))
        self._before[:] = now
        return float(work)


class ExternalWork:
    """Work on the body and on contact penalties in explicit motion. Collective to make.

    Where the work follows from two states it is computed when a state is asked for: force times
    displacement of constant loads, energy of springs with a fixed base, kinetic energy of the mass
    that supports move.  Fixed obstacles do no work.  The rest is summed up step by step: loads that
    change, springs with a moving base, dashpots, reactions of moving supports without inertia, and
    forces of moving obstacles over the displacement of these.

    Args:
        mass: Lumped mass at every owned entry [kg].

    Attributes:
        sum: The work at the last state asked for [J].
        friction: What friction has taken up until then [J], see `EnergyBalance`.
        damping: What damping has, all of it and bulk viscosity [J].
        damper: Sums that up; None without.
        paths: Work that is summed up step by step.
    """

    def __init__(
        self, problem: Problem, assembler: Assembler, mass: FloatArray, v: fem.Function
    ) -> None:
        self._problem, self._assembler, self._mass = problem, assembler, mass
        self._u, self._v = problem.u.x.array[: assembler.size], v.x.array[: assembler.size]
        springs = [term for term in problem.terms if term.account == "springs"]
        resting = springs if all(term.at_rest for term in springs) else []
        works = [term for term in problem.terms if term.pose is None and term not in resting]
        changing = forms_of(works, "work")
        if problem.loaded and problem.loads_change:
            at_points = problem.constant(0.0) * sum(problem.v) * problem.weak_form.volume(None, 1)
            external = problem.weak_form.external
            changing.append(at_points if external is None else external)
        self._steady, self._middle = problem.loaded and not problem.loads_change, Middle(problem)
        self.paths: list[_Path] = []
        self._forces: list[NodalForces] = []
        if changing:
            self._add(sum(changing), points=float(not self._steady))
        self._moving_supports = supports_move(problem)
        if self._moving_supports:
            a = assembler
            self.paths.append(_Path(lambda: a.constrained_part(a.residual.owned)))
        for term in problem.terms:
            if term.pose is not None and not term.at_rest:
                self._add_term(term)
        self.damper: Damper | None = None
        self.damping: FloatArray = np.zeros(2)
        self._rubs = problem.terms.dissipates
        for term in problem.terms:
            if term.dissipates:
                self._add_term(term, past=True)
        stored = forms_of(resting, "energy")
        self._springs = compiled(problem, [sum(stored)])[0] if stored else None
        self._constant: FloatArray = np.empty(0)
        self._before = self._local = self._rubbed = self.sum = self.friction = self._stored = 0.0

    def _add_term(self, term: Term, *, past: bool = False) -> None:
        if (work := term.form("work")) is not None:
            self._add(work, obstacle=term, past=past)
        else:
            forces = partial(self._assembler.reactions.of_term, term)
            self.paths.append(_Path(forces, term, self._middle, past=past))

    def _add(
        self,
        work: ufl.Form,
        points: float = 0.0,
        obstacle: Term | None = None,
        *,
        past: bool = False,
    ) -> None:
        dofmap = self._problem.V.dofmap
        vector = la.vector(dofmap.index_map, dofmap.index_map_bs)
        self._forces.append(NodalForces(self._problem, work, vector, points=points))
        forces = self._forces[-1].assemble
        self.paths.append(_Path(forces, obstacle, self._middle, past=past))

    def begin(
        self,
        work: float = 0.0,
        friction: float = 0.0,
        damping: Sequence[float] | FloatArray = (0.0, 0.0),
    ) -> None:
        """Takes in the state that the next step begins with. Collective.

        Args:
            work: Done so far [J].
            friction: What friction has taken up so far [J].
            damping: What all damping and bulk viscosity have [J].
        """
        self.damping = np.array(damping)
        if self.damper is not None:
            self.damper.take()
        self.sum, self.friction, self._local, self._rubbed = work, friction, 0.0, 0.0
        self._stored = springs_of_friction(self._problem)
        if self._steady:
            self._constant = self._assembler.reactions.loads()
        self._before = self._of_state()
        for path in self.paths:
            path.begin()

    def update_time(self) -> None:
        """Takes over the values of the present time. Not collective."""
        for forces in self._forces:
            forces.renew()

    def renew(self) -> None:
        """Goes on with forces that a program has changed at the present state. Collective.

        What was done before stays as it is; the work of the next step begins with the new forces.
        """
        for forces in self._forces:
            forces.pack_again()
        self.begin(self.sum, self.friction, self.damping)

    def step(self, du: FloatArray) -> None:
        """Adds the work of a step that has led to the present state. Collective.

        Without `paths` there is nothing to add, and no need to call it.

        Args:
            du: Change of the displacement in the step, owned entries [m].
        """
        for path in self.paths:
            if path.past:
                self._rubbed += path.step(du)
            else:
                self._local += path.step(du)

    def close(self) -> float:
        """The work up to the present state [J]. Collective."""
        now, comm = self._of_state(), self._problem.body.comm
        self.sum += total(comm, self._local + now - self._before)
        if self._rubs:
            before, self._stored = self._stored, springs_of_friction(self._problem)
            self.friction += total(comm, self._rubbed) + before - self._stored
        if self.damper is not None:
            self.damping += total(comm, self.damper.take())
        self._local, self._rubbed, self._before = 0.0, 0.0, now
        return self.sum

    def energies(self, kinetic: float, stored: float) -> dict[str, float]:
        """See `Work`. Collective."""
        result = {"external": self.close()}
        if self.damper is not None:
            result["damping"] = float(self.damping[0])
            if self.damper.viscous:
                result["bulk_viscosity"] = float(self.damping[1])
        return {**result, "friction": self.friction} if self._rubs else result

    def _of_state(self) -> float:
        """What of the work follows from the state, this rank's share but for a constant [J]."""
        work = 0.0 if self._springs is None else -float(fem.assemble_scalar(self._springs))
        if self._steady:
            work += float(np.dot(self._constant, self._u))
        if self._moving_supports:
            v = self._assembler.constrained_part(self._v)
            work += 0.5 * float(np.dot(self._mass * v, v))
        return work
