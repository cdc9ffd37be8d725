"""Audit of equilibria: force, moment and energy, from nodal vectors that are there already.

Whatever the mesh, the nodal forces inside a body sum up to nothing, and so do their moments where
the stress is symmetric; so what acts on it from outside must, too.  And what acts on it has done
the work that is stored in it.

Where forces change little by little, the energy that a body takes up in a step lies between what
the nodal forces before and after it would have done over it.  A body that has passed an energy
barrier within the step breaks this: the forces before and after may be alike, and yet the energy is
not.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import cell_size
from dolfin_elastic.model.kinematics import moment_of
from dolfin_elastic.problem.problem import Problem, configuration_of_moments
from dolfin_elastic.problem.state import Audit, Stability
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled, in_cells, integral
from dolfin_elastic.solvers.audit.violations import (
    Violation,
    Violations,
    WorstViolations,
    add_worse,
)
from dolfin_elastic.solvers.messages import count
from dolfin_elastic.solvers.nonlinear.jacobian import Extreme, JacobianWatch, SmallStrains

FORCE_TOLERANCE = 1e-6
"""Unbalanced share of the forces up to which they balance: a hundred times what Newton's method
leaves with its default tolerance."""

ENERGY_TOLERANCE = 1e-6
"""Share of work and energy by which they may differ beyond the bound of the trapezoidal rule."""

SLACK = 0.02
"""Share of the energy of a step by which it may miss the bounds."""

SMALL = 2e-3
"""Share of all stored energy by which it may miss them, too: where nodes come into contact one
after the other, the energy of a discrete body goes up and down a little."""

Measured = tuple[float, float, float, float]
"""The first four of `Audit`."""


class EnergyBook:
    """What is stored at the present displacement, in accounts. Collective to make.

    Args:
        terms: Accounts of terms that are asked for.

    Attributes:
        none: A law has no energy.
    """

    def __init__(self, problem: Problem, terms: Collection[str] = ("springs",)) -> None:
        strain, stored = problem.weak_form.strain_energy, problem.weak_form.stored
        self._problem, self.none = problem, strain is None
        self._cells, self._others = (None, None) if strain is None else in_cells(problem, strain)
        forms = {account: form for account in terms if (form := stored(account)) is not None}
        self._terms = dict(zip(forms, compiled(problem, list(forms.values())), strict=True))
        # Friction has forms of forces, but none of an energy.
        others = [t for t in problem.terms if t.restrains and (t.nodal or t.dissipates)]
        self._nodal = [t for t in others if t.account in terms]

    def stored(self) -> dict[str, float]:
        """Energies by account [J]. Collective.

        "strain" is not a number where a law has none.  What has been done on what relaxes, be it
        stored or lost already, and what plasticity has dissipated count with it, and are told as
        "relaxing" and "dissipated", too.
        """
        comm, history = self._problem.body.comm, self._problem.history
        spent = {} if history is None else history.spent()
        strain = float("nan")
        if not self.none:
            local = 0.0 if self._cells is None else self._cells.value()
            local += 0.0 if self._others is None else float(fem.assemble_scalar(self._others))
            strain = total(comm, local) + sum(spent.values())
        terms = {name: integral(self._problem, form) for name, form in self._terms.items()}
        for term in self._nodal:
            terms[term.account] = terms.get(term.account, 0.0) + term.energy()
        return {"strain": strain, **spent, **terms}


def no_balance(problem: Problem) -> str:
    """Why what is stored is not what forces have done; empty: it is."""
    if problem.weak_form.strain_energy is None:
        return "no balance of energy: a law has none"
    if problem.eigenstrains:
        return "no balance of energy: heat or growth stores some of its own"
    if problem.unknowns.stabilised:
        return "no balance of energy: the stabilised pressure stores some of its own"
    return ""


@dataclass(frozen=True)
class PathPoint:
    """One state of a path.

    Attributes:
        forces: Nodal forces, owned entries [N].
        u: What they move [m].
        energy: Stored [J]; nan where a law has none.
    """

    forces: FloatArray
    u: FloatArray
    energy: float

    def since(self, before: PathPoint, comm: MPI.Comm) -> tuple[float, float, float]:
        """Work of the step by the trapezoidal rule, and by how much it may be wrong. Collective.

        Returns:
            The work [J]; change of forces . change of displacement [J], of which it is wrong by at
            most a half where forces change steadily; and length of the change of displacement [m].
        """
        du, df = self.u - before.u, self.forces - before.forces
        own = [np.sum((self.forces + before.forces) * du) / 2, np.sum(df * du), np.sum(du**2)]
        work, change, square = map(float, total(comm, np.array(own)))
        return work, change, float(np.sqrt(square))


class PathEnergyCheck:
    """Compares the energy of steps with the work of the internal forces over them.

    Attributes:
        book: Measures the stored energy.
        stored: What it had at the state evaluated last [J].
    """

    def __init__(self, assembler: Assembler) -> None:
        self._assembler, self._problem = assembler, assembler.problem
        self.book = EnergyBook(assembler.problem)
        self.stored: dict[str, float] = {}
        self._before: PathPoint | None = None
        self._now: PathPoint | None = None

    @stage("audit")
    def evaluate(self) -> None:
        """Evaluates energy and forces of the present equilibrium. Collective.

        Its nodal forces are assembled already, in `Assembler.residual`.
        """
        a = self._assembler
        forces, u = internal_forces(a), a.problem.w.x.array[a.displacement_dofs].copy()
        if a.cell is not None:
            forces, u = map(np.append, (forces, u), a.cell.work())
        self.stored = self.book.stored()
        self._now = PathPoint(forces, u, self.stored["strain"])

    def finite(self) -> bool:
        """Whether the energy evaluated last is finite, if there is one."""
        return self.book.none or self._now is None or bool(np.isfinite(self._now.energy))

    def accept(self) -> None:
        """Begins the next step at the state evaluated last."""
        self._before = self._now

    def jumped(self, residual: float, share: float = 1.0) -> bool:
        """Whether the step took up another energy than its path would have given. Collective.

        The bounds are widened by round-off and by the residual that is left, which does work, too.

        Args:
            residual: Norm of the free residual that Newton's method may leave [N].
            share: Of the way from the middle of these bounds to either of them: less than 1 where
                the forces have to grow not only steadily but nearly in proportion.
        """
        before, now = self._before, self._now
        if no_balance(self._problem) or before is None or now is None:
            return False
        work, change, moved = now.since(before, self._assembler.comm)
        gained, half = now.energy - before.energy, abs(change) / 2
        slack = SLACK * max(abs(gained), abs(work) + half)
        slack += SMALL * max(abs(before.energy), abs(now.energy)) + 2 * residual * moved
        slack += round_off(self._assembler)[1]
        return bool(abs(gained - work) > share * half + slack)


def internal_forces(assembler: Assembler) -> FloatArray:
    """Internal nodal forces, equal to the external ones in equilibrium, owned [N]. Collective."""
    reactions = assembler.reactions
    forces = assembler.residual.owned + reactions.loads() + reactions.restraints()
    return np.asarray(forces[assembler.displacement_dofs])


def round_off(assembler: Assembler) -> tuple[float, float]:
    """Size of the round-off of all nodal forces [N] and of the stored energy [J]. Collective.

    The stress is known to machine precision of the stiffness, because F = I + grad u is.
    """
    diagonal = assembler.tangent.matrix.getDiagonal()
    stiff, sum_of_all = float(diagonal.norm()), float(diagonal.norm(0))
    diagonal.destroy()
    small, h = 40 * np.finfo(float).eps, cell_size(assembler.problem.body)
    return small * stiff * h, small * sum_of_all * h**2


class EquilibriumAuditor:
    """Judges one converged step after another. Collective.

    Args:
        assembler: Whose residual holds the nodal forces of the step.
    """

    def __init__(self, problem: Problem, assembler: Assembler, watch: JacobianWatch) -> None:
        self._problem, self._assembler, self._watch = problem, assembler, watch
        self._comm, self._dim = problem.body.comm, problem.body.dim
        self._X = problem.places[: len(assembler.displacement_dofs) // self._dim]
        self._moment_frame = configuration_of_moments(problem)
        self._previous: PathPoint | None = None
        self._change = 0.0  # what `PathPoint.since` gives of the step before
        self._work = self._stored = self._round_off_share = 0.0
        self._out_of_balance = False  # the last state was no equilibrium
        self._violations = WorstViolations()
        self._strains = SmallStrains(problem, watch)

    @stage("audit")
    def audit(self, t: float, energy: float, stability: Stability | None = None) -> Audit:
        """The audit of the step that the problem and the assembler are in. Collective.

        Args:
            energy: Stored energy [J]; nan where a law has none.
            stability: Of the equilibrium; None where nobody asks for it.
        """
        reasons: Violations = {}
        self._round_off_share = 0.0
        noise, energy_noise = round_off(self._assembler)
        external, forces, u = self._present()
        force = moment = np.nan
        if external:
            ties = self._assembler.residual.tied_nodal
            force, moment = self._balances(external, u, ties, noise, reasons)
            if self._previous is None and self._begins_out_of_balance(forces, noise):
                reasons.clear()  # nothing is solved yet; nan stays, for what has no balance
                force, moment, self._round_off_share = 0.0 * force, 0.0 * moment, 0.0
                forces = internal_forces(self._assembler).reshape(forces.shape)
                self._out_of_balance = True
        if self._previous is not None:  # what begins in an obstacle has not been pushed out yet
            self._check_contacts(reasons)
        if np.isfinite(energy) or self._problem.weak_form.strain_energy is None:
            self._check_energy(PathPoint(forces, u, energy), energy_noise, reasons)
        else:
            reasons["energy"] = Violation("the strain energy has no finite value", np.inf)
        if stability is not None and stability.negative is None:
            reasons["stability"] = Violation(f"stability not judged: {stability.reason}", 0.0)
        stored = self._stored if np.isfinite(energy) else np.nan
        return self._verdict(t, reasons, (force, moment, self._work, stored))

    def _verdict(self, t: float, reasons: Violations, measured: Measured) -> Audit:
        """The audit, with what strains and det F have to say. Collective.

        Args:
            reasons: Why it warns, by kind; det F adds its own.
        """
        self._strains.check(self._when(t))
        low, high = self._watch.extremes()
        inverted = self._watch.inverted() if self._watch.survives else None
        if not low[0] > 0.0:
            reasons.update(self._inside_out(low, inverted))
        if reasons:
            self._violations.add(reasons, self._when(t))
        audit = Audit(
            *measured,
            min_jacobian=low[0],
            max_jacobian=high[0],
            min_place=tuple(float(x) for x in low[1][: self._dim]),
            max_place=tuple(float(x) for x in high[1][: self._dim]),
            inverted=inverted,
            notes=self._notes(),
        )
        return self._violations.judged(audit, reasons) if self._violations.worst else audit

    def _inside_out(self, low: Extreme, inverted: int | None) -> Violations:
        """What speaks against a state with inverted cells. Not collective.

        Args:
            low: Smallest det F, and its place [m].
            inverted: Number of these cells, where a law survives that.
        """
        J, place = low[0], self._problem.body.unit.point(low[1])
        text = f"an element is inside out: det F = {J:.3g} at {place}"
        if inverted is not None:
            cells = count(self._problem.body.num_cells, "element")
            text = f"{inverted} of {cells} inverted, smallest det F = {J:.3g} at {place}"
        return {"jacobian": Violation(text, -J)}

    def restart_state(self) -> dict[str, Any]:
        """See `Restartable`; forces follow from the state itself. Not collective."""
        last = self._previous
        return {
            "work": self._work,
            "stored": self._stored,
            "warned": self._violations.restart_state(),
            "energy": last.energy if last else 0.0,
            "change": self._change,
            "unbalanced": self._out_of_balance,
            "far": self._strains.note,
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """See `Restartable`; the problem has the state of that time already. Collective."""
        _, forces, u = self._present()
        if saved["unbalanced"]:
            forces = internal_forces(self._assembler).reshape(forces.shape)
        self._previous, self._change = PathPoint(forces, u, saved["energy"]), saved["change"]
        self._work, self._stored = saved["work"], saved["stored"]
        self._violations.restore(saved["warned"])
        self._strains.restore(saved["far"])

    def _present(self) -> tuple[list[FloatArray], FloatArray, FloatArray]:
        """Nodal forces by origin (none of a cell), their sum, and what they move. Collective."""
        if self._assembler.cell is not None:
            return [], *self._assembler.cell.work()
        external = self._external_forces()
        forces = np.asarray(np.sum(external, axis=0))
        u = self._problem.u.x.array[: forces.size].reshape(forces.shape).copy()
        return external, forces, u

    def _notes(self) -> tuple[str, ...]:
        """What is not judged, and why."""
        notes = [self._strains.note] if self._strains.note else []
        if self._problem.cell is not None:
            notes.append("no balance of forces and moments: its neighbours hold a periodic cell")
        elif self._problem.geometry == "axisymmetric":
            notes.append("no balance of moments and radial forces: they cancel round the axis")
        elif self._moment_frame == "none":
            notes.append(
                "no balance of moments: the stress of linear laws is in balance on the undeformed "
                "body, that of the others on the deformed one"
            )
        if self._round_off_share > 0.0:
            notes.append(
                f"forces balance to {self._round_off_share:.1g} of their sum only: rounding errors "
                "of the stiffest elements"
            )
        return tuple(note for note in (*notes, no_balance(self._problem)) if note)

    def _when(self, t: float) -> str:
        return f"load factor {t:.6g}"

    # --- forces and moments ---

    def _external_forces(self) -> list[FloatArray]:
        """Nodal forces of loads, supports and springs, shape (nodes, dim) each [N]. Collective."""
        a = self._assembler
        reactions = a.constrained_part(a.residual.owned)
        forces = [a.reactions.loads()[a.displacement_dofs], reactions[a.displacement_dofs]]
        if a.reactions.labels:
            forces.append(a.reactions.restraints()[a.displacement_dofs])
        return [force.reshape(-1, self._dim) for force in forces]

    def _begins_out_of_balance(self, forces: FloatArray, noise: float) -> bool:
        """Whether loads or obstacles push before anything has moved. Collective.

        Node by node: in sum the forces of a ring that is pressed on a shaft cancel each other.

        Args:
            forces: External nodal forces [N].
            noise: Round-off of forces [N].
        """
        off = forces - internal_forces(self._assembler).reshape(forces.shape)
        left, size = total(self._comm, np.array([np.sum(off**2), np.sum(forces**2)]))
        return bool(np.sqrt(left) > FORCE_TOLERANCE * np.sqrt(size) + noise)

    def _check_contacts(self, reasons: Violations) -> None:
        """No node that presses is farther off its obstacle than the tolerance. Collective."""
        unit = self._problem.body.unit
        for pair in self._problem.contact_pairs:
            if pair.unsettled():
                off, allowed = pair.gap_error()
                held = pair.conflict(self._problem.constraints)
                reasons[f"contact {pair.label}"] = Violation(
                    held[0]
                    if held is not None
                    else f"contact '{pair.label}': a node that presses is {unit.length(off)} off "
                    f"the obstacle, above gap_tolerance = {unit.length(allowed)}; a larger "
                    "stiffness or more load steps help",
                    off,
                )

    def _balances(
        self,
        external: list[FloatArray],
        u: FloatArray,
        ties: FloatArray,
        noise: float,
        reasons: Violations,
    ) -> tuple[float, float]:
        """What is left of forces, and of moments where these are judged, by their size. Collective.

        Args:
            external: Forces by origin, shape (nodes, dim) each [N].
            u: Displacement at which they balance, owned entries [m].
            ties: Forces of ties on the entries that they tie [N].
            noise: Round-off of forces [N].
            reasons: Why the audit warns: what does not balance is added.
        """
        rows = external
        if self._problem.geometry == "axisymmetric":  # radial forces need not sum up to anything
            rows = [force[:, 1:] for force in external]
        left, size, allowed = self._imbalance(rows, noise)
        if left > allowed:
            what = f"loads and reactions do not balance: {left:.2g} of their {size:.3g} N is left"
            add_worse(reasons, {"force": Violation(what, left)})
        if self._moment_frame == "none":
            return left, np.nan
        x = self._X[:, : self._dim]
        if self._moment_frame == "current":
            x = x + u.reshape(x.shape)
        rows = [moment_of(x, force) for force in external]
        if (constraints := self._problem.constraints).tied:  # couples of the ties' forces
            axes = np.eye(self._dim)[constraints.tied_dofs % self._dim]
            rows.append(moment_of(constraints.levers(x), axes * ties[:, None]))
        arm = float(self._comm.allreduce(float(np.max(np.abs(x), initial=0.0)), op=MPI.MAX))
        turning, size, allowed = self._imbalance(rows, noise * arm)
        if turning > allowed:
            what = (
                f"the moments of loads and reactions about the origin do not balance: "
                f"{turning:.2g} of their {size:.3g} N m is left"
            )
            add_worse(reasons, {"moment": Violation(what, turning)})
        return left, turning

    def _imbalance(self, rows: list[FloatArray], noise: float) -> tuple[float, float, float]:
        """How far forces are from balance. Collective.

        Round-off is taken off what is left of the sum, unless it is a large part of small loads:
        then the share that may be left is that of round-off, and a note says so.

        Args:
            rows: Forces or moments by origin, shape (nodes, components) each.
            noise: Round-off of their sum, in the same unit.

        Returns:
            What is left of the sum over the sum of lengths; the sum of lengths; and the share
            that may be left.
        """
        lengths = [float(np.linalg.norm(row, axis=1).sum()) for row in rows]
        sums = np.sum([row.sum(axis=0) for row in rows], axis=0)
        result = total(self._comm, np.array([*lengths, *sums]))
        size = float(np.max(result[: len(rows)]))
        left = float(np.linalg.norm(result[len(rows) :]))
        if FORCE_TOLERANCE * size < noise < size:
            self._round_off_share = max(self._round_off_share, noise / size)
            return left / size, size, noise / size
        return (max(left - noise, 0.0) / size if size > 0 else 0.0), size, FORCE_TOLERANCE

    # --- energy ---

    def _check_energy(self, now: PathPoint, noise: float, reasons: Violations) -> None:
        """Adds the work of a step and compares it with what has been stored. Collective.

        Where forces turn around within the step, the change of forces times the change of
        displacement is small, and that of the step before says how they change.

        Args:
            now: The present state, shape (nodes, dim) each, with the forces from outside.
            noise: Round-off of its energy [J].
            reasons: Why the audit warns: a difference is added.
        """
        last, self._previous = self._previous, now
        if last is None:
            return
        work, change, moved = now.since(last, self._comm)
        stored = now.energy - last.energy
        self._work += work
        self._stored += stored
        allowed = max(abs(change), self._change) / 2
        allowed += ENERGY_TOLERANCE * max(abs(work), abs(stored))
        allowed += self._assembler.residual.free_norm * moved + noise
        if self._problem.history is not None:  # inside, more may change than forces from outside
            allowed += self._problem.history.uncertainty
        if self._problem.terms.opens:
            allowed += SMALL * max(abs(now.energy), abs(last.energy))
        if abs(work - stored) > allowed and not no_balance(self._problem):
            reasons["energy"] = Violation(
                f"the work of the step, {work:.4g} J, and what it has stored, {stored:.4g} J, "
                f"differ by more than a smooth path allows ({allowed:.2g} J): the body has jumped "
                "to another equilibrium, or a force is not what it should be",
                abs(work - stored),
            )
        self._change, self._out_of_balance = abs(change), False
