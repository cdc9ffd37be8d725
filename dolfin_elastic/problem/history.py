"""What a body remembers of its past, where its materials do.

Nothing of a trial is stored: the stress is a function of F, of the history as it was committed
last, and of the time since then.  Tried and rejected steps, line searches and retries leave no
trace, and `History.commit` evaluates once at the accepted state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from itertools import count

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.jit import compile_forms, options
from dolfin_elastic.core.jit.cell_integrals import CellExpression, CellIntegrals, can_be_packed
from dolfin_elastic.core.jit.compile import JitOptions
from dolfin_elastic.core.jit.point_roots import OfPoints, PointRoots
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.materials.growth import grown_volume
from dolfin_elastic.model.materials.memory import (
    ImplicitMemory,
    ImplicitStep,
    Memory,
    Root,
    Variable,
    in_a_row,
)
from dolfin_elastic.model.materials.plasticity import PLASTIC_STRAIN
from dolfin_elastic.model.materials.stepped import SteppedLaw
from dolfin_elastic.problem.constraints.periodic.unit_cell import Cell
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.material_regions import MaterialRegion
from dolfin_elastic.problem.weak_form import WeakForm

OF_A_STEP = 0.02
"""By how much the work of a step may differ from that of its end, over what it has dissipated: a
bent beam that yields in steps of 6 degrees has 0.2 % of its work."""
ROUND_OFF = 1e-12
"""What a value may differ from its start by and count as unchanged."""


class RegionHistory:
    """The history of one material region. Collective to make.

    Its values are polynomials in each cell, discontinuous, of the least degree that takes any
    values at the points of integration: there they are exact, and the stress has a value
    everywhere.

    Args:
        degree: Of the quadrature of the region's internal forces.

    Attributes:
        name: That of the material region, as the case has it.
        memory: What the region's law remembers.
        law: The region's law over a step.
        points: Of the reference cell, shape (points, dim).
        values: Of the variables, at the nodes of the region's owned cells.
    """

    def __init__(self, body: Body, region: MaterialRegion, degree: int) -> None:
        mesh, kind = body.mesh, body.mesh.basix_cell()
        memory, self.name = region.law.memory, region.name
        assert memory is not None
        self.memory: Memory = memory
        self.points = basix.make_quadrature(kind, degree)[0]
        for order in count():
            table = basix.ufl.element("DG", kind, order).tabulate(0, self.points)[0]
            if np.linalg.matrix_rank(table) == len(self.points):
                break
        self._table = np.asarray(table).reshape(len(self.points), -1)
        self._to_nodes = np.linalg.pinv(self._table)
        self._cells = region.cells
        self._spaces = {
            size: fem.functionspace(mesh, ("DG", order, (size,)))
            for size in {v.size for v in (*memory.variables, *memory.seen, *memory.told)}
        }
        dofmap = next(iter(self._spaces.values())).dofmap
        rows = dofmap.list[region.cells].reshape(-1)
        self._size = len(rows)
        # One region has all rows in their order, which a slice copies several times as fast.
        whole = np.array_equal(rows, np.arange(self._size))
        self._rows: IndexArray | slice = slice(self._size) if whole else rows
        every = (*memory.seen, *memory.told)
        self._past = {v.name: fem.Function(self._spaces[v.size]) for v in every}
        numbers = memory.step(0.0, passes=False)
        self._step = {name: fem.Constant(mesh, value) for name, value in numbers.items()}
        past = {v.name: v.value(self._past[v.name]) for v in every}
        self._order = order
        self._found: OfPoints | None = None
        law = memory.over_step(past, self._step)
        if isinstance(memory, ImplicitMemory):
            law = memory.with_root(past, self._step, self._make_root(memory.unknowns))
        assert isinstance(law, SteppedLaw)
        self.law = law
        self.values: dict[str, FloatArray] = {}
        self._room: FloatArray | None = None  # of what is evaluated at the end of a step
        self._start()

    def _make_root(self, unknowns: tuple[Variable, ...]) -> Root:
        """The unknowns of equations at the points, as coefficients of forms."""
        mesh, size = next(iter(self._spaces.values())).mesh, sum(v.size for v in unknowns)
        spaces = [fem.functionspace(mesh, ("DG", self._order, (n,))) for n in (size, size * size)]
        self._found, self._inverse = OfPoints(spaces[0]), fem.Function(spaces[1])
        start = np.concatenate([v.at_start for v in unknowns])
        self._found.x.array.reshape(-1, size)[:] = start
        return Root(unknowns, self._found, self._inverse)

    def solves_by(self, F: Callable[[], Expr], w: fem.Function, jit_options: JitOptions) -> None:
        """Says of which F equations at the points are, where there are any.

        Args:
            F: Gives the deformation gradient without growth.
        """
        if self._found is not None:
            self._found.make = lambda: self._make_roots(F(), w, jit_options)

    def renew(self) -> None:
        """What equations at the points depend on has changed. Not collective."""
        if self._found is not None and self._found.roots is not None:
            self._found.roots.renew()

    @property
    def solves(self) -> bool:
        """There are equations at the points."""
        return self._found is not None

    def follow(self) -> int:
        """Solves them; how many points of this rank have no root. Collective."""
        assert self._found is not None
        self._found.prepare()
        self._found.follow()
        return 0 if self._found.roots is None else self._found.roots.lost

    def _make_roots(self, F: Expr, w: fem.Function, jit_options: JitOptions) -> PointRoots:
        """Compiles the equations at the points. Collective."""
        assert isinstance(self.law, ImplicitStep)
        root, law = self.law.root, self.law
        return PointRoots(
            root.to_solve(law.equations(F)),
            (self._found, self._inverse),
            self.points,
            self._table,
            [k for k, v in enumerate(root.variables) for _ in range(v.size)],
            self._cells,
            lambda: np.hstack([self._rows_of(v) for v in root.variables]),
            w=w,
            jit_options=jit_options,
        )

    def _rows_of(self, variable: Variable) -> FloatArray:
        """What the law over a step sees of a variable, at the nodes of the region."""
        values = self._past[variable.name].x.array.reshape(-1, variable.size)
        return np.asarray(values[self._rows])

    def _start(self) -> None:
        """The body at rest, outside of the region, too, where no law is to divide by zero."""
        at_rest = {v.name: v.at_start[None] for v in self.memory.variables}
        for name, values in self.memory.fold(at_rest, 0.0).items():
            self._past[name].x.array.reshape(-1, values.shape[1])[:] = values
        self.reset()

    def reset(self) -> None:
        """Forgets all: the body at rest. Not collective."""
        self.values = {v.name: np.tile(v.at_start, (self._size, 1)) for v in self.memory.variables}

    @property
    def changed(self) -> bool:
        """Whether a value differs from the start by more than round-off. Not collective."""
        memory = self.memory
        own = memory.unknowns if isinstance(memory, ImplicitMemory) else memory.variables
        return any(
            np.any(np.abs(self.values[v.name] - v.at_start) > ROUND_OFF * max(abs(v.start), 1.0))
            for v in own
        )

    def begin_step(self, dt: float, *, passes: bool, elastic: bool = False) -> None:
        """Sets the law over a step from the history, of a length [s]. Not collective.

        Args:
            passes: See `Memory.step`.
            elastic: See `Memory.elastic_step`.
        """
        constants = self.memory.step(dt, passes=passes)
        constants |= self.memory.elastic_step() if elastic else {}
        for name, value in constants.items():
            self._step[name].value = value
        past = {v.name: self._past[v.name].x.array.reshape(-1, v.size) for v in self.memory.seen}
        if isinstance(self._rows, slice):
            out = {name: values[self._rows] for name, values in past.items()}
            self.memory.fold_into(self.values, dt, out)
            return
        for name, values in self.memory.fold(self.values, dt).items():
            past[name][self._rows] = values

    def tell(self, dt: float) -> None:
        """Sets what the energies of the law over a step need beside `past`. Not collective.

        Args:
            dt: Length of the step [s].
        """
        if not self.memory.told:
            return
        at_points = {name: self._at_points(values) for name, values in self.values.items()}
        for name, values in self.memory.tell(at_points, dt).items():
            told = self._past[name].x.array.reshape(-1, values.shape[1])
            told[self._rows] = self._at_nodes(values)

    def _at_points(self, values: FloatArray) -> FloatArray:
        """Of all points in a row, from those at nodes; of one-point rules both are the same."""
        return values if len(self.points) == 1 else self._moved(self._table, values)

    def _at_nodes(self, values: FloatArray) -> FloatArray:
        """The inverse."""
        return values if len(self.points) == 1 else self._moved(self._to_nodes, values)

    def _moved(self, table: FloatArray, values: FloatArray) -> FloatArray:
        size = values.shape[1]
        rows = values.reshape(len(self._cells), table.shape[1], size)
        return np.einsum("kn,cnj->ckj", table, rows).reshape(-1, size)

    @property
    def past(self) -> list[fem.Function]:
        """What the law over a step sees of the history, see `Memory.seen`."""
        return list(self._past.values())

    def numbers_at_end(self, law: SteppedLaw, F: Expr) -> Expr:
        """All that `commit` takes, as one UFL vector."""
        return in_a_row(self.memory.found, law.at_end(F))

    def commit(self, numbers: CellExpression, dt: float) -> None:
        """Takes over the present state at the end of a step. Not collective.

        Args:
            numbers: Of `numbers_at_end`, at the points.
            dt: Length of the step [s].
        """
        found = self.memory.found
        size = sum(v.size for v in found)
        if self._room is None:
            self._room = np.empty((len(self._cells), len(self.points) * size))
        now: FloatArray = numbers.eval(self._cells, self._room).reshape(-1, size)
        values = self.values
        if self.memory.pointwise:
            values = {name: self._at_points(x) for name, x in values.items()}
        else:
            now = self._at_nodes(now)
        parts = np.split(now, np.cumsum([v.size for v in found])[:-1], axis=1)
        by_name = {v.name: part for v, part in zip(found, parts, strict=True)}
        followed = self.memory.follow(values, by_name, dt)
        if self.memory.pointwise:
            followed = {name: self._at_nodes(x) for name, x in followed.items()}
        # What is no variable's own array stands in the room of the next evaluation.
        self.values = {
            name: values if values is self.values.get(name) else np.array(values)
            for name, values in followed.items()
        }

    def largest(self, name: str) -> float:
        """Largest value of a scalar at the points of this rank; 0 where there is none."""
        if name not in self.values or not len(self._cells):
            return 0.0
        nodal = self.values[name].reshape(len(self._cells), -1)
        return float((nodal @ self._table.T).max())

    def functions(self) -> dict[str, fem.Function]:
        """The variables as functions, 0 outside of the region: copies."""
        result = {}
        for v in self.memory.variables:
            result[v.name] = fem.Function(self._spaces[v.size])
            result[v.name].x.array.reshape(-1, v.size)[self._rows] = self.values[v.name]
        return result

    def take(self, functions: Mapping[str, fem.Function]) -> None:
        """Takes over what `functions` gave."""
        for v in self.memory.variables:
            self.values[v.name] = functions[v.name].x.array.reshape(-1, v.size)[self._rows].copy()


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
        self._branches: list[Callable[[FloatArray], None]] = []
        self._told: dict[str, fem.Form] = {}
        self._volumes: list[fem.Form] = []
        self._heat = 0.0  # of the committed state
        self._before: tuple[FloatArray, FloatArray] = (np.empty(0), np.empty(0))

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
        """Sets the laws over the step from the last committed state to a time [s]. Local."""
        self._now = t
        step = 0.0 if self._t is None else max(t - self._t, 0.0)
        if self.long_term:
            step = np.inf
        if step != self._step:
            self._step = step
            for part in self._regions.values():
                fades = self.long_term and part.memory.fades
                dt = step if fades or not self.long_term else 0.0
                part.begin_step(dt, passes=self.passes or fades, elastic=self.elastic)
        for part in self._regions.values():  # growth may follow the time, too
            part.renew()

    def choose(self, *, long_term: bool = False, elastic: bool = False) -> None:
        """Chooses the stiffness of what fades, and of what flows. Local."""
        self.long_term, self.elastic, self._step = long_term, elastic, None
        self.set_time(self._now)

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
        self.set_time(self._now)

    def begin(self, t: float = 0.0) -> None:
        """Time passes from here, at the present state: forgets what depends on it. Collective."""
        self.long_term = self.elastic = False
        self.forget()
        self._begin_at(t, 0.0)

    def settle(self) -> None:
        """Sets the laws to those of a step that begins now, see `commit`. Local."""
        if self._step is None:
            self.set_time(self._now)

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
        if self.passes and self._branches:
            self._before = self._forces() if forces is None else forces, self._moved()

    def _compile(self) -> None:
        """Compiles what is evaluated at the end of a step, once. Collective."""
        if self._at_end:
            return
        jit, w = options(self._comm), self._w
        for region, law, F in self._weak_form.elastic_parts():
            part = self._regions[region.name]
            numbers = part.numbers_at_end(law, F)
            self._at_end[region.name] = CellExpression(numbers, part.points, w, jit)
        told = {
            "lost": self._weak_form.of_steps(lambda law, F: law.lost(F)),
            "stored": self._weak_form.of_steps(lambda law, F: law.stored(F)),
            "missed": self._weak_form.of_steps(lambda law, F: law.missed()),
        }
        told = {name: form for name, form in told.items() if not form.empty()}
        self._told = dict(zip(told, compile_forms(self._comm, [*told.values()], jit), strict=True))
        if self._grows:
            return
        branches = [self._weak_form.branches()]
        if self._cell is not None:
            branches.append(self._weak_form.branches(of_cell=True))
        if not branches[0].empty():
            self._branches = [
                self._assembly(form, compiled)
                for form, compiled in zip(
                    branches, compile_forms(self._comm, branches, jit), strict=True
                )
            ]

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

    def _assembly(self, form: ufl.Form, compiled: fem.Form) -> Callable[[FloatArray], None]:
        """Adds the vector of a form, by loops of our own where they can. Collective."""
        (test,), w = form.arguments(), self._w
        ours = test.ufl_function_space() == w.function_space
        if ours and all(can_be_packed(field, w) for field in form.coefficients()):
            used = form.coefficients()
            return CellIntegrals(compiled, w, options(self._comm), used).add_to
        return lambda part: fem.assemble_vector(part, compiled)

    def _forces(self) -> FloatArray:
        """This rank's share of the nodal forces of the branches, not summed over ranks [N].

        Of a periodic cell first on the unknowns, then on the macroscopic displacement.
        """
        if not self._branches:
            return np.empty(0)
        result = np.zeros_like(self._moved())
        size = len(self._w.x.array)
        for add, part in zip(self._branches, (result[:size], result[size:]), strict=False):
            add(part)
        return result

    def _moved(self) -> FloatArray:
        """What `_forces` do work on: a copy of the local unknowns and, of a cell, more [m]."""
        w = self._w.x.array
        if self._cell is None:
            return w.copy()
        return np.append(w, self._cell.affine_at(self._context.unknowns.places))

    def work(self) -> float:
        """Work done on the branches since the beginning, up to the present state [J]. Collective.

        By the trapezoidal rule over each step.  They have stored some of it and lost the rest; how
        much of each is not known of laws of large strains.  0 where the body grows.
        """
        return self._work + self._over_step(self._forces())[0]

    def spent(self) -> dict[str, float]:
        """What the stored energy does not contain, by account [J]. Collective.

        Only accounts that a material has.  "relaxing": see `work`, and what branches of linear laws
        store; "remembered": the same where no material depends on time; "dissipated": what has
        become heat since the beginning.
        """
        self._compile()
        result = {}
        if (self._branches or "stored" in self._told) and self.passes:
            result["relaxing" if self.timed else "remembered"] = self.work() + self._sum("stored")
        if "lost" in self._told:
            result["dissipated"] = self._sum("lost")
        return result

    def _sum(self, name: str) -> float:
        """Integral of what the laws tell of the present state, see `OverStep` [J]. Collective."""
        if (form := self._told.get(name)) is None:
            return 0.0
        self.settle()
        for part in self._regions.values():
            part.tell(self._step or 0.0)
        self.follow()
        return float(total(self._comm, float(fem.assemble_scalar(form))))

    def _over_step(self, now: FloatArray) -> tuple[float, float]:
        """Work of the present step, and by how much it may be wrong [J]. Collective.

        Args:
            now: From `_forces` [N].
        """
        if self._t is None or not self._branches:
            return 0.0, 0.0
        before, w = self._before
        moved = self._moved() - w
        local = np.array([np.dot(before + now, moved), np.dot(now - before, moved)]) / 2
        work, change = total(self._comm, local)
        return float(work), abs(float(change))

    @stage("assemble")
    def commit(self, *, settle: bool = True) -> None:
        """Makes the present state, at the present time, the past. Collective.

        Args:
            settle: The laws become those of the next step. Else they stay those of this one, whose
                stress at the present state is the same, until `set_time` or `settle`.
        """
        if self._step is None:
            return
        self._compile()
        forces = self._forces()
        work, self.uncertainty = self._over_step(forces)
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
