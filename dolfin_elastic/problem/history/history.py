"""What a body remembers of its past, where its materials do.

Nothing of a trial is stored: the stress is a function of F, of the history as it was committed
last, and of the time since then.  Tried and rejected steps, line searches and retries leave no
trace, and `History.commit` evaluates once at the accepted state.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.jit import compile_forms, options
from dolfin_elastic.core.jit.cell_integrals import CellExpression
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.materials.growth import grown_volume
from dolfin_elastic.model.materials.plasticity import PLASTIC_STRAIN
from dolfin_elastic.model.materials.stepped import SteppedLaw
from dolfin_elastic.problem.constraints.periodic.unit_cell import Cell
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.history.branches import BranchWork
from dolfin_elastic.problem.history.fused import FusedSteps
from dolfin_elastic.problem.history.region import ROUND_OFF, RegionHistory
from dolfin_elastic.problem.weak_form import WeakForm

OF_A_STEP = 0.02
"""By how much the work of a step may differ from that of its end, over what it has dissipated: a
bent beam that yields in steps of 6 degrees has 0.2 % of its work."""


class History:
    """The history of a problem whose materials remember. Collective to make.

    Until `begin` no time passes: laws that depend on it are those of a sudden load.

    Args:
        weak_form: Whose laws become those over a step.
        cell: Of a periodic problem, whose displacement is not all in the unknowns.
        grows: There is growth or warmth, which stores energy of its own.

    Attributes:
        relaxes: The stress of a material fades with time.
        timed: A material depends on how long a step takes.
        yields: A material depends on previous strains, however long they took.
        flows: A material yields, as metals do.
        fused: Forces and history in one loop, between `begin` and `forget`; None: it is not so.
        long_term: In place of a sudden load, all that relaxes has done so, until `begin`.
        elastic: Nothing flows, until `reset` or `begin`.
        uncertainty: By how much the work of the last committed step may be wrong [J]: half the
            change of forces times the change of displacement.
    """

    def __init__(
        self, context: FormContext, weak_form: WeakForm, cell: Cell | None, *, grows: bool
    ) -> None:
        self._context, self._weak_form, self._grows = context, weak_form, grows
        for region in context.regions:
            memory = region.law.memory
            if memory is not None and not memory.plane_stress and context.unknowns.has("stretch"):
                raise InputError(
                    f"the law '{region.law.name()}' is not computed in plane stress",
                    where="mesh.geometry",
                    expected='"plane-strain", or a solid body',
                )
        self._cell = cell
        self._comm, self._w = context.body.comm, context.unknowns.w
        self._regions = {
            region.name: RegionHistory(context.body, region, weak_form.rule(region))
            for region in context.regions
            if region.law.memory is not None
        }
        memories = [part.memory for part in self._regions.values()]
        self.timed = any(memory.timed for memory in memories)
        self.yields = not all(memory.fades for memory in memories)
        self.relaxes = any(memory.fades for memory in memories)
        weak_form.stepped.update({name: part.law for name, part in self._regions.items()})
        for part in self._regions.values():
            part.solves_by(partial(_elastic, weak_form, part.name), self._w, options(self._comm))
        self.flows = any(PLASTIC_STRAIN in memory.variables for memory in memories)
        self.long_term = self.elastic = False
        self._t: float | None = None  # of the past that is committed
        self._now = 0.0
        self._step: float | None = None
        self._work = self.uncertainty = 0.0
        self._at_end: dict[str, CellExpression] = {}
        self.fused: FusedSteps | None = None
        self._folded = True
        self._branches: BranchWork | None = None
        self._told: dict[str, fem.Form] | None = None
        self._volumes: list[fem.Form] = []
        self._heat = 0.0  # of the committed state

    def follow(self) -> dict[str, int]:
        """Solves what equations at points determine, before DOLFINx assembles. Collective.

        Returns:
            How many points had no root, by the names of regions that have equations.
        """
        parts = (part for part in self._regions.values() if part.solves)
        return {part.name: int(total(self._comm, part.follow())) for part in parts}

    @property
    def passes(self) -> bool:
        """Time passes: not in a preload, whose materials are those of a sudden load."""
        return self._t is not None

    @property
    def past(self) -> list[fem.Function]:
        """Fields of the forms that change when a step begins or is committed."""
        return [function for part in self._regions.values() for function in part.past]

    def set_time(self, t: float) -> None:
        """Sets the laws over the step from the last committed state to a time [s]. Local.

        Of fused steps only what these need, until `settle`.
        """
        self._now = t
        step = 0.0 if self._t is None else max(t - self._t, 0.0)
        if self.long_term:
            step = np.inf
        if step != self._step:
            self._step, self._folded = step, False
            for part in self._regions.values():
                passes = self.passes or (self.long_term and part.memory.fades)
                part.begin_step(self._length(part), passes=passes, elastic=self.elastic)
            if self.fused is not None:
                self.fused.set_step(step)
            else:
                self._fold()
        for part in self._regions.values():  # growth may follow the time, too
            part.renew()

    def _length(self, part: RegionHistory) -> float:
        """Length of the step for a region [s]."""
        return 0.0 if self.long_term and not part.memory.fades else self._step or 0.0

    def _fold(self) -> None:
        for part in self._regions.values():
            part.fold(self._length(part))
        self._folded = True

    def choose(self, *, long_term: bool = False, elastic: bool = False) -> None:
        """Chooses the stiffness of what fades, and of what flows. Local."""
        self.long_term, self.elastic, self._step = long_term, elastic, None
        self.settle()

    def reset(self) -> None:
        """The body at rest: forgets all, and no time passes until `begin`. Local."""
        for part in self._regions.values():
            part.reset()
        self._heat, self.elastic = 0.0, False
        self.forget()

    def changed(self, *, flow: bool = True) -> bool:
        """Whether a material remembers strains, however long they took. Collective.

        Args:
            flow: Also metals, whose plastic strain leaves an elastic stiffness to choose.
        """
        parts = [part for part in self._regions.values() if not part.memory.fades]
        if not flow:
            parts = [part for part in parts if PLASTIC_STRAIN not in part.memory.variables]
        return largest(self._comm, float(any(part.changed for part in parts))) > 0.0

    def forget(self) -> None:
        """Forgets what depends on time, of which none passes until `begin`. Local."""
        for part in self._regions.values():
            if part.memory.timed:
                part.reset()
        self._t, self._step, self._work, self.uncertainty = None, None, 0.0, 0.0
        self.fused = None
        self.set_time(self._now)

    def begin(self, t: float = 0.0, *, fused: bool = False) -> None:
        """Time passes from here, at the present state: forgets what depends on it. Collective.

        Args:
            fused: Forces are only asked for at states that are accepted: `fused` takes both at
                once, where it can.
        """
        self.long_term = self.elastic = False
        self.forget()
        if fused and self._cell is None and not self._grows:
            self._fuse()
        self._begin_at(t, 0.0)

    def _fuse(self) -> None:
        parts, F = [*self._regions.values()], self._weak_form.F(self._w)
        if FusedSteps.fits(parts, self._w):
            steps = FusedSteps([(part, F) for part in parts], self._w, options(self._comm))
            self.fused = steps if steps.possible else None

    def settle(self) -> None:
        """Sets the laws to those of a step that begins now, see `commit`. Local."""
        if self._step is None:
            self.set_time(self._now)
        if not self._folded:
            self._fold()

    def _begin_at(
        self,
        t: float | None,
        work: float,
        forces: FloatArray | None = None,
        *,
        settle: bool = True,
    ) -> None:
        """Begins a step.

        Args:
            forces: Those of the branches, if they are known.
            settle: See `commit`.
        """
        self._t, self._step, self._work = t, None, work
        self._now = self._now if t is None else t
        if settle:
            self.settle()
        if self.passes:
            self._compile()
        if self.fused is not None:
            self.fused.begin()
        elif self.passes and self._branches is not None:
            self._branches.begin(forces)

    def _compile(self) -> None:
        """Compiles what is evaluated at the end of a step, once. Collective."""
        if self.fused is None and not self._at_end:
            self._compile_ends()
        if self._told is not None:
            return
        told = {
            "lost": self._weak_form.of_steps(lambda law, F: law.lost(F)),
            "stored": self._weak_form.of_steps(lambda law, F: law.stored(F)),
            "missed": self._weak_form.of_steps(lambda law, F: law.missed()),
        }
        told = {name: form for name, form in told.items() if not form.empty()}
        forms = compile_forms(self._comm, [*told.values()], options(self._comm))
        self._told = dict(zip(told, forms, strict=True))

    def _compile_ends(self) -> None:
        jit, w = options(self._comm), self._w
        for region, law, F in self._weak_form.elastic_parts():
            part = self._regions[region.name]
            numbers = part.numbers_at_end(law, F)
            self._at_end[region.name] = CellExpression(numbers, part.points, w, jit)
        if not (self._grows or self._weak_form.branches().empty()):
            self._branches = BranchWork(self._context, self._weak_form, self._cell)

    def results(self) -> dict[str, float]:
        """Largest equivalent plastic strain, and fraction of the body that has yielded. Collective.

        Of the committed state; nothing where no material yields.
        """
        if not self.flows:
            return {}
        if not self._volumes:
            yielded = self._weak_form.of_steps(_flowed)
            whole = sum(
                grown_volume(self._weak_form.response(region, self._w))
                * self._weak_form.volume(region, self._weak_form.rule(region))
                for region in self._context.regions
            )
            self._volumes = compile_forms(self._comm, [yielded, whole], options(self._comm))
        local = np.array([fem.assemble_scalar(form) for form in self._volumes])
        part, whole = total(self._comm, local)
        most = max((p.largest(PLASTIC_STRAIN.name) for p in self._regions.values()), default=0.0)
        return {
            "max_plastic_strain": float(largest(self._comm, most)),
            "yielded_fraction": float(part / whole),
        }

    def work(self) -> float:
        """Work done on the branches since the beginning, up to the present state [J]. Collective.

        By the trapezoidal rule over each step.  They have stored some of it and lost the rest; how
        much of each is not known of laws of large strains.  0 where the body grows.
        """
        if self.fused is not None:
            self._work += float(total(self._comm, self.fused.take_work()))
            return self._work
        if self._branches is None or not self.passes:
            return self._work
        return self._work + self._branches.since()[0]

    def spent(self) -> dict[str, float]:
        """What the stored energy does not contain, by account [J]. Collective.

        Only accounts that a material has.  "relaxing": see `work`, and what branches of linear laws
        store; "remembered": the same where no material depends on time; "dissipated": what has
        become heat since the beginning.
        """
        self._compile()
        result, told = dict[str, float](), self._told or {}
        branches = self._branches is not None if self.fused is None else self.fused.branches
        if (branches or "stored" in told) and self.passes:
            result["relaxing" if self.timed else "remembered"] = self.work() + self._sum("stored")
        if "lost" in told:
            result["dissipated"] = self._sum("lost")
        return result

    def _sum(self, name: str) -> float:
        """Integral of what the laws tell of the present state, see `OverStep` [J]. Collective."""
        if (form := (self._told or {}).get(name)) is None:
            return 0.0
        self.settle()
        for part in self._regions.values():
            part.tell(self._step or 0.0)
        self.follow()
        return float(total(self._comm, float(fem.assemble_scalar(form))))

    @stage("assemble")
    def commit(self, *, settle: bool = True) -> None:
        """Makes the present state, at the present time, the past. Collective.

        Args:
            settle: The laws become those of the next step. Else they stay those of this one, whose
                stress at the present state is the same, until `set_time` or `settle`.
        """
        if self._step is None:
            return
        if self.fused is not None:
            self.fused.accept()
            self._t, self._step, self._folded = self._now, None, False
            if settle:
                self.settle()
            return
        self._compile()
        forces, self.uncertainty = None, 0.0
        if self._branches is not None and self.passes:
            work, self.uncertainty, forces = self._branches.since()
            self._work += work
        for name, part in self._regions.items():
            if self.passes or not part.memory.timed:
                part.commit(self._at_end[name], 0.0 if self.long_term else self._step)
        # The stress of a state is that of the end of a step, and of the begin of the next.
        self._begin_at(self._now if self.passes else None, self._work, forces, settle=settle)
        if settle:
            before, self._heat = self._heat, self._sum("lost")
            self.uncertainty += abs(self._sum("missed"))
            # Linear branches tell exactly what the trapezoidal rule misses.
            if not all(part.memory.told for part in self._regions.values()):
                self.uncertainty += OF_A_STEP * max(self._heat - before, 0.0)

    # --- restarts ---

    def fields(self) -> dict[str, fem.Function]:
        """Name to function, in spaces of discontinuous elements, as `RestartState` has them."""
        return {
            f"history {i + 1}.{name}": function
            for i, part in enumerate(self._regions.values())
            for name, function in part.functions().items()
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
            part.take({v.name: fields[f"history {i + 1}.{v.name}"] for v in part.memory.variables})
        self._begin_at(saved["t"], saved["work"])
        self._heat = self._sum("lost")


def _elastic(weak_form: WeakForm, name: str) -> Expr:
    """F without growth of a region that remembers."""
    return next(F for region, _, F in weak_form.elastic_parts() if region.name == name)


def _flowed(law: SteppedLaw, F: Expr) -> Expr | None:
    """1 where the plastic strain is above round-off, else 0; None where nothing yields."""
    strain = law.plastic_strain(F)
    return None if strain is None else ufl.conditional(ufl.gt(strain, ROUND_OFF), 1.0, 0.0)
