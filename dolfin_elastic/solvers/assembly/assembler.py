"""From forms to vectors and matrices: the only place that knows lifting and ghost updates."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np
import ufl
from dolfinx import fem, la
from mpi4py import MPI
from petsc4py import PETSc
from ufl.algorithms import extract_coefficients
from ufl.integral import Integral

from dolfin_elastic.core.ghosts import assembled
from dolfin_elastic.core.jit import compile_forms
from dolfin_elastic.core.jit.cell_integrals import CellIntegrals, can_be_packed
from dolfin_elastic.core.parallel import largest_row, total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import middle_of
from dolfin_elastic.model.kinematics import moment_of
from dolfin_elastic.problem.damping import Damping
from dolfin_elastic.problem.problem import Problem, configuration_of_moments, parts_held
from dolfin_elastic.problem.state import Moment
from dolfin_elastic.problem.term import Blocks, Term
from dolfin_elastic.solvers.assembly.cell_stress import CellStress
from dolfin_elastic.solvers.assembly.dofs import ConstrainedDofs
from dolfin_elastic.solvers.assembly.matrix import BilinearForm, ConstrainedMatrix, TangentMatrix
from dolfin_elastic.solvers.assembly.node_blocks import NodeBlocks
from dolfin_elastic.solvers.assembly.scalar_mass import InertiaForces
from dolfin_elastic.solvers.assembly.symmetric.matrix import SymmetricMatrix, can_be_halved
from dolfin_elastic.solvers.assembly.two_stage.form import TwoStageForm, tangent_form
from dolfin_elastic.solvers.petsc.aij import SumOfTwo


class Reactions:
    """Nodal forces of the surroundings on the body: loads, springs, contact, supports. Collective.

    Args:
        dofs: The unknowns and what is prescribed of them.
        loads: Compiled virtual work of the loads that are integrals; None without any.
        restraints: Label of springs, dashpots and contact pairs to their compiled virtual work.
        cell: Macroscopic stress of a periodic cell, or None.
    """

    def __init__(
        self,
        dofs: ConstrainedDofs,
        loads: fem.Form | None,
        restraints: Mapping[str, fem.Form],
        cell: CellStress | None,
    ) -> None:
        self._dofs, self._loads, self._restraints, self._cell = dofs, loads, restraints, cell
        unknowns, u = dofs.problem.unknowns, dofs.problem.u.x.array
        self._entries = unknowns.mixed_dofs(np.arange(len(u), dtype=np.int32))
        self._added: list[FloatArray] = []  # of restraints that are in no form

    def nodal(self, form: fem.Form) -> FloatArray:
        """Nodal forces of a compiled virtual work, owned entries [N]."""
        return assembled(form, self._dofs.problem.W)

    def loads(self) -> FloatArray:
        """Nodal forces of the loads at the present time, owned entries [N]."""
        return self._load_vector().array[: self._dofs.size]

    def load_norm(self) -> float:
        """Norm of the nodal forces of the loads at the present time [N].

        Of a periodic cell: of the forces that its neighbours exert.
        """
        if self._cell is not None:
            return self._cell.force()
        return float(la.norm(self._load_vector()))

    def _load_vector(self) -> la.Vector:
        forces = self._dofs.ghosted_vector()
        if self._loads is not None:
            fem.assemble_vector(forces.array, self._loads)
        self.add_terms(forces.array, 1.0, restraining=False)
        forces.scatter_reverse(la.InsertMode.add)
        return forces

    def add_terms(self, forces: FloatArray, sign: float, *, restraining: bool | None) -> None:
        """Adds this rank's share of the forces of terms that are in no form. Collective.

        Args:
            forces: Entries of all unknowns, owned and ghost, before the ranks are summed [N].
            sign: 1 or -1.
            restraining: Of restraints, of loads, or, None, of all.
        """
        of_all = restraining is None
        if of_all:
            self._added.clear()
        for term in self._dofs.problem.terms:
            if term.nodal and (of_all or term.restrains == restraining):
                rows = self._of_term(term)
                forces[self._entries] += sign * rows
                if of_all and term.restrains:
                    self._added.append(rows)

    def _of_term(self, term: Term) -> FloatArray:
        rows = np.zeros(len(self._entries))
        term.add_forces(rows)
        return rows

    def _restraining(self, without: Collection[str] = ()) -> Iterator[tuple[str, FloatArray]]:
        """Label and nodal forces of each restraint, owned entries [N]."""
        for label, form in self._restraints.items():
            if label not in without:
                yield label, self.nodal(form)
        for term in self._dofs.problem.terms:
            if term.nodal and term.restrains and term.label not in without:
                yield term.label, self.of_term(term)

    def of_term(self, term: Term) -> FloatArray:
        """Nodal forces of a term that are in no form, owned entries [N]."""
        return self._owned(self._of_term(term))

    def _owned(self, rows: FloatArray) -> FloatArray:
        """Sums over the ranks, at the owned entries of all unknowns. Collective."""
        forces = self._dofs.ghosted_vector()
        forces.array[self._entries] = rows
        forces.scatter_reverse(la.InsertMode.add)
        return np.asarray(forces.array[: self._dofs.size])

    @property
    def labels(self) -> list[str]:
        """Of springs, dashpots, contact pairs and terms, see `by_label`."""
        acting = [term for term in self._dofs.problem.terms if term.nodal and term.restrains]
        within = self._within_body()
        return [*self._restraints, *(one.label for one in acting if one.label not in within)]

    def _within_body(self) -> set[str]:
        """Labels of what surfaces do to themselves: no force of the surroundings."""
        return {term.label for term in self._dofs.problem.terms if term.bars}

    def restraints(self, without: Collection[str] = ()) -> FloatArray:
        """Nodal forces of springs, dashpots and contact pairs, owned entries [N]."""
        result = (forces for _, forces in self._restraining(without))
        return np.asarray(sum(result, np.zeros(self._dofs.size)))

    def restraint_norm(self) -> float:
        """Norm of the nodal forces of springs, dashpots and contact pairs, each by itself [N].

        Of terms that are in no form as they were when all terms were added last.
        """
        if not (self._restraints or self._dofs.problem.terms):
            return 0.0
        forces = [*map(self.nodal, self._restraints.values()), *map(self._owned, self._added)]
        squares = sum(float(np.sum(np.square(one))) for one in forces)
        return float(np.sqrt(total(self._dofs.comm, squares)))

    def by_label(self) -> dict[str, FloatArray]:
        """Label of springs, dashpots and contact pairs to nodal forces, shape (nodes, dim) [N].

        Of contact between two surfaces those on the side that carries the pressures; not those of
        surfaces on themselves, whose sum is none.
        """
        dofs, dim = self._dofs.displacement_dofs, self._dofs.problem.body.dim
        result: dict[str, FloatArray] = {}
        for label, forces in self._restraining(self._within_body()):
            result[label] = result.get(label, 0.0) + forces[dofs].reshape(-1, dim)
        for pair in self._dofs.problem.contact_pairs:
            if pair.carrier is not None:
                result[pair.label][~pair.carrier] = 0.0
        return result


class Tangent:
    """The tangent of a problem, with ones on the diagonal of prescribed dofs. Collective.

    Fixed pressures have the pivots of `ConstrainedDofs.level` there, of their own sign.  Where
    constraints combine entries it is T^T K T + s E, see `ConstrainedMatrix`, with s of the size of
    K: round-off of K would drown E otherwise.

    Args:
        dofs: The unknowns and what is prescribed of them.
        form: Of what is integrals; the blocks of the problem's terms come to it.
        inertia: What it has in motion, too; None: nothing.
        iterated: Only products and the diagonal are asked for, until `to_entries`: where it can
            be, it is then kept as `SymmetricBlocks`.

    Attributes:
        form: The compiled bilinear form.
        matrix: The tangent; owned here.
        beside: What is not in the form.
        pattern: Grows whenever `matrix` has other entries.
    """

    def __init__(
        self,
        dofs: ConstrainedDofs,
        form: BilinearForm,
        *,
        inertia: InertiaForces | None = None,
        iterated: bool,
    ) -> None:
        self._dofs, self.form, self._inertia = dofs, form, inertia
        self.blocks: NodeBlocks | None = None
        if dofs.problem.terms.blocks() is not None:
            self.blocks = NodeBlocks(dofs, self._blocks_of_terms)
        self.beside = [part for part in (self.blocks, inertia) if part is not None]
        self._shift: float | None = None
        self._sum: SumOfTwo | None = None
        with stage("assemble"):
            self._assembled: TangentMatrix | SymmetricMatrix
            if iterated and isinstance(form, TwoStageForm) and can_be_halved(dofs, form):
                self._assembled = SymmetricMatrix(dofs, form, self.blocks, inertia)
            else:
                self._assembled = self._by_entries()
        self._take(self._assembled.petsc)

    def _blocks_of_terms(self) -> Blocks:
        result = self._dofs.problem.terms.blocks()
        assert result is not None
        return result

    def _by_entries(self) -> TangentMatrix:
        dofs = self._dofs
        fixed = None if dofs.level is None else (dofs.fixed_pressures, dofs.level.pivots)
        return TangentMatrix(self.form, fixed=fixed, inertia=self._inertia)

    def _take(self, matrix: PETSc.Mat) -> None:
        dofs, self.pattern, self._sum = self._dofs, 0, None
        self._constrained = ConstrainedMatrix(dofs.problem, dofs, matrix, dofs.displacement_dofs)
        self.matrix = self._of_forms = self._constrained.matrix
        if self.blocks is not None and not isinstance(self._assembled, SymmetricMatrix):
            self.matrix = self._of_forms.copy()
        self._mark()

    def _mark(self) -> None:
        if self._dofs.problem.symmetric:
            self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self.matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)

    def to_entries(self) -> None:
        """Makes `matrix` another one, of PETSc's entries, as it was assembled. Collective.

        Factorisations need it; who holds the old one has to take the new one.
        """
        if isinstance(self._assembled, SymmetricMatrix):
            old, self._assembled = self._assembled, self._by_entries()
            self._take(self._assembled.petsc)
            self._renew()
            old.destroy()

    @contextmanager
    def entries(self) -> Iterator[PETSc.Mat]:
        """The tangent as it is, as a matrix of PETSc's entries, which factorisations need.

        Collective.
        """
        if not isinstance(self._assembled, SymmetricMatrix):
            yield self.matrix
            return
        matrix = self._assembled.aij()
        try:
            yield matrix
        finally:
            matrix.destroy()

    def assemble(self, x: PETSc.Vec, shift: float = 0.0, *, unit: float | None = None) -> None:
        """Assembles the tangent into `matrix`, unless neither it nor the shift can have changed.

        A matrix that is left alone keeps its factorisation.

        Args:
            x: The unknowns, from `ConstrainedDofs.origin`.
            shift: Factor of the inertia in the form, by which linear tangents differ.
            unit: The factor s of E; by default of the size of the tangent [N/m].
        """
        with stage("assemble"):
            self._dofs.put(x)
            if self._dofs.problem.linear and shift == self._shift:
                return
            self._renew(unit)
            self._shift = shift

    def _renew(self, unit: float | None = None) -> None:
        if isinstance(self._assembled, SymmetricMatrix):
            self._assembled.assemble()
            return
        if (history := self._dofs.problem.history) is not None:
            history.follow()
        self._assembled.assemble(self._dofs.bcs)
        self._constrained.renew(unit)
        if self.blocks is not None:
            self._add_blocks(self.blocks)

    def _add_blocks(self, blocks: NodeBlocks) -> None:
        """Makes `matrix` the sum of that of the forms and of blocks, whose pattern may be new."""
        added, how = blocks.free(), PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN
        if blocks.pattern == self.pattern and self._sum is not None:
            self._sum.renew()
            return
        self._of_forms.copy(self.matrix, how)
        self.matrix.axpy(1.0, added, how)
        self._sum, self.pattern = SumOfTwo(self.matrix, self._of_forms, added), blocks.pattern
        self._mark()

    def scale(self) -> float:
        """Mean size of the tangent's diagonal at the first call, a power of two [N/m]."""
        if self._constrained.scale == 0.0:
            self._renew()
            self.invalidate()
        return self._constrained.scale

    def shift_diagonal(self, share: float) -> None:
        """Adds a share of its size to the diagonal of free dofs."""
        diagonal = self.matrix.getDiagonal()
        added = share * np.abs(diagonal.array_r)
        added[self._dofs.prescribed_dofs] = 0.0
        diagonal.array_w[:] += added
        self.matrix.setDiagonal(diagonal)
        diagonal.destroy()
        self.invalidate()

    def invalidate(self) -> None:
        """`matrix` was changed: `assemble` assembles it, also in a linear problem. Local."""
        self._shift = None

    def destroy(self) -> None:
        """Frees the matrix."""
        if self.matrix is not self._of_forms:
            self.matrix.destroy()
        if self.blocks is not None:
            self.blocks.destroy()
        self._constrained.destroy()
        self._assembled.destroy()


class Residual:
    """Out-of-balance nodal forces, without and with the Dirichlet conditions. Collective.

    The residual's rows at prescribed dofs are replaced by (x - g), and the columns of the tangent
    there by zero; what the replaced columns would have done is added to the residual (lifting).
    So the first Newton step moves the boundary and the inside together, and a line search can
    shorten both.  At skew nodes the same is done along their prescribed directions: rows
    Q R + s (P x - N+ g), with s of `Tangent.scale`.

    Args:
        dofs: The unknowns and what is prescribed of them.
        tangent: For `constrain`; None where nobody asks for that.
        reactions: Loads at points, and the scale of restraints.
        inertia: Forces beside this work; None: nothing.

    Attributes:
        work: As given.
        vector: The residual without Dirichlet conditions, ghosts included: out-of-balance nodal
            forces [N], whose entries at prescribed dofs are the reactions.
        free_norm: Norm of the free entries of the last residual [N].
        reaction_norm: Norm of its prescribed entries [N].
        restraint_norm: Norm of the forces of springs and contact at the last residual [N].
        tied_nodal: Forces of ties on the entries that they tie, at the last assembly [N].
        gap: Largest |x - g| over prescribed dofs at the last residual [m].
    """

    def __init__(
        self,
        dofs: ConstrainedDofs,
        work: ufl.Form,
        tangent: Tangent | None,
        reactions: Reactions,
        inertia: InertiaForces | None,
    ) -> None:
        self._dofs, self.work, self._tangent, self._reactions = dofs, work, tangent, reactions
        self._inertia = inertia
        self._parts: tuple[CellIntegrals | None, fem.Form | None] | None = None
        self._along: tuple[fem.Function, fem.Form] | None = None
        self.vector, self._lift = dofs.ghosted_vector(), dofs.ghosted_vector()
        self.tied_nodal: FloatArray = np.zeros(len(dofs.tied_dofs))
        self.free_norm = self.reaction_norm = self.restraint_norm = self.gap = 0.0

    @property
    def owned(self) -> FloatArray:
        """Owned entries of `vector` [N], not copied."""
        return self.vector.array[: self._dofs.size]

    def along(self, entries: IndexArray, motion: FloatArray) -> FloatArray:
        """Derivative of the work of these forces on a motion, see `OutOfBalance`."""
        problem = self._dofs.problem
        if self._along is None:
            moved = fem.Function(problem.W)
            work, test = ufl.action(self.work, moved), ufl.TestFunction(problem.W)
            self._along = moved, compiled(problem, [ufl.derivative(work, problem.w, test)])[0]
        moved, form = self._along
        moved.x.array[:] = 0.0
        moved.x.array[entries] = motion
        moved.x.scatter_forward()
        result = assembled(form, problem.W)
        if self._tangent is not None and self._tangent.blocks is not None:
            result += self._tangent.blocks.times(moved.x.array[: len(result)], transposed=True)
        return result

    def assemble(self) -> None:
        """Assembles `vector` at the problem's unknowns."""
        self.vector.array[:] = 0.0
        if self._parts is None:  # explicit motion never asks
            self._parts = in_cells(self._dofs.problem, self.work)
        cells, others = self._parts
        if cells is not None:
            cells.add_to(self.vector.array)
        if others is not None:
            fem.assemble_vector(self.vector.array, others)
        if self._inertia is not None:
            self._inertia.add_forces(self.vector.array)
        self._reactions.add_terms(self.vector.array, -1.0, restraining=None)
        self.vector.scatter_reverse(la.InsertMode.add)
        if self._dofs.tied:
            self.tied_nodal = self.owned[self._dofs.tied_dofs]
            self.owned[:] = self._dofs.collect(self.owned)

    def evaluate(self, x: PETSc.Vec, f: PETSc.Vec, *, target: FloatArray | None = None) -> None:
        """Evaluates the residual with its Dirichlet conditions.

        Args:
            x: The unknowns, from `ConstrainedDofs.origin`; the problem takes them over.
            target: Prescribed values as of `Constraints.targets`; None: the problem's.
        """
        with stage("assemble"):
            self._dofs.put(x)
            self.assemble()
        self.constrain(f, target=target)

    def constrain(self, f: PETSc.Vec, *, target: FloatArray | None = None) -> None:
        """The residual with Dirichlet conditions, from `vector` as it was assembled.

        Args:
            target: Prescribed values as of `Constraints.targets`; None: the problem's.
        """
        dofs = self._dofs
        assert self._tangent is not None
        with stage("assemble"):
            differences = dofs.differences(target)
            out = dofs.balanced(self.owned)
            self._measure(out, differences)
            if self.gap > 0.0 and np.isfinite(self.free_norm):
                dofs.lift(self._tangent.form, differences, self._lift, self._tangent.beside)
                # A support that turns keeps the volume, but its chord does not: the rest of a fixed
                # pressure's row would change the volume of the cells around that one.
                out = out + dofs.balanced(dofs.collect(self._lift.array[: dofs.size]))
            f.array_w[:] = dofs.free_part(out)
            f.array_w[dofs.prescribed_dofs] = differences[dofs.prescribed_dofs]
            f.array_w[dofs.fixed_pressures] = 0.0  # the sum of the other rows, which are zero
            if dofs.skewed:
                f.array_w[dofs.skew_dofs] += self._tangent.scale() * differences[dofs.skew_dofs]

    def _measure(self, out: FloatArray, differences: FloatArray) -> None:
        """Norms of the residual before it is lifted."""
        with np.errstate(over="ignore", invalid="ignore"):
            reactions = self._dofs.constrained_part(out)
            squares = [np.sum(np.square(out - reactions)), np.sum(np.square(reactions))]
        comm = self._dofs.comm
        sums = comm.allreduce(np.array(squares), op=MPI.SUM)
        self.free_norm, self.reaction_norm = (float(value) for value in np.sqrt(sums))
        # NaN would come out of a maximum on some ranks only.
        gap = float(np.max(np.nan_to_num(np.abs(differences), nan=np.inf), initial=0.0))
        self.gap = float(comm.allreduce(gap, op=MPI.MAX))
        self.restraint_norm = self._reactions.restraint_norm()

    def norm(self) -> float:
        """Norm of the residual at the problem's unknowns; infinite where it is not finite."""
        x, f = self._dofs.create_vector(), self._dofs.create_vector()
        self._dofs.get(x)
        self.evaluate(x, f)
        norm = float(f.norm())
        x.destroy()
        f.destroy()
        return norm if np.isfinite(norm) else np.inf

    def largest(self) -> tuple[float, FloatArray]:
        """Largest free nodal force of `vector` [N] and the node's reference place X, (dim,) [m]."""
        dofs, problem = self._dofs, self._dofs.problem
        forces = (self.owned - dofs.constrained_part(self.owned))[dofs.displacement_dofs]
        norms = np.linalg.norm(forces.reshape(-1, problem.body.dim), axis=1)
        norms = np.where(np.isfinite(norms), norms, np.inf)
        coordinates, dim = problem.unknowns.unknown_places, problem.body.dim
        row = largest_row(dofs.comm, norms, lambda nodes: coordinates[nodes, :dim])
        return (-1.0, np.zeros(dim)) if row is None else (row.value, np.array(row.place))


class Assembler(ConstrainedDofs):
    """Unknowns, residual, tangent and reactions of a problem. Collective.

    Args:
        problem: Whose residual and tangent; its unknowns are changed by every evaluation.
        extra: Terms added to the residual, for example damping.
        extra_tangent: The same of the tangent.
        inertia: That of a motion; None: nothing.
        damping: Whose moduli are in the tangent; None: nothing.
        displacement_fixed: All displacements are prescribed: only the scalar fields are unknown.
        iterated: See `Tangent`.

    Attributes:
        residual: Out-of-balance forces.
        tangent: Their derivative.
        reactions: Forces of the surroundings.
        pressures: How many unknowns are pressures, on all ranks.
        cell: Macroscopic stress of a periodic cell, or None.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        extra: ufl.Form | None = None,
        extra_tangent: ufl.Form | None = None,
        inertia: InertiaForces | None = None,
        damping: Damping | None = None,
        displacement_fixed: bool = False,
        iterated: bool = False,
    ) -> None:
        super().__init__(problem, displacement_fixed=displacement_fixed)
        weak_form = problem.weak_form
        residual = weak_form.residual if extra is None else weak_form.residual + extra
        loads = [] if weak_form.external is None else [weak_form.external]
        restraints = weak_form.restraint_works
        forms = compiled(problem, [*loads, *restraints.values()])
        by_label = dict(zip(restraints, forms[len(loads) :], strict=True))
        self.cell = None if problem.cell is None else CellStress(problem)
        self.pressures = problem.unknowns.count("pressure")
        self.reactions = Reactions(self, forms[0] if loads else None, by_label, self.cell)
        form = tangent_form(problem, extra_tangent, damping)
        self.tangent = Tangent(self, form, inertia=inertia, iterated=iterated)
        self.residual = Residual(self, residual, self.tangent, self.reactions, inertia)

    def check_volumes(self) -> None:
        """Compares the volumes of enclosed bodies with what supports leave them. Collective.

        Raises:
            InputError: See `HydrostaticConstant.check_volumes`.
        """
        if self.level is not None:
            self.level.check_volumes(self.residual.owned)

    def destroy(self) -> None:
        """Frees the tangent's matrix."""
        self.tangent.destroy()


def compiled(problem: Problem, forms: Sequence[ufl.Form]) -> list[fem.Form]:
    """Compiles forms with the problem's options. Collective.

    Args:
        problem: Its ranks and its options for the form compiler.
    """
    return compile_forms(problem.body.comm, list(forms), problem.jit)


def in_cells(problem: Problem, form: ufl.Form) -> tuple[CellIntegrals | None, fem.Form | None]:
    """The integrals over cells that loops of our own can take, and all others. Collective.

    Args:
        form: Of at most one test function.

    Returns:
        Both compiled; None in place of what the form has not.
    """
    parts: tuple[list[Integral], list[Integral]] = [], []
    for one in form.integrals():
        ours = all(can_be_packed(c, problem.w) for c in extract_coefficients(one.integrand()))
        parts[one.integral_type() != "cell" or not ours].append(one)
    forms = iter(compiled(problem, [ufl.Form(part) for part in parts if part]))
    cells, others = (next(forms) if part else None for part in parts)
    if cells is None:
        return None, others
    coefficients = ufl.Form(parts[0]).coefficients()
    return CellIntegrals(cells, problem.w, problem.jit, coefficients), others


def integral(problem: Problem, form: fem.Form) -> float:
    """Value of a compiled scalar form over all ranks. Collective.

    Args:
        problem: Its ranks.
        form: A form without arguments.
    """
    return float(problem.body.comm.allreduce(fem.assemble_scalar(form), op=MPI.SUM))


class SupportForces:
    """Resultants of the nodal forces of each support, by label. Collective to make.

    Nodal forces are virtual work, and a rigid rotation of the body is one of the displacements of
    its elements: the sum of their moments is that of the tractions, without error of its own.  The
    moments are taken where the stress is in balance, see `configuration_of_moments`, about the
    middle of the undeformed surface, fixed in space: then they change with the forces only.
    """

    def __init__(self, assembler: Assembler) -> None:
        self._assembler, self._problem = assembler, assembler.problem
        body, V = self._problem.body, self._problem.V
        self._comm, self._dim = body.comm, body.dim
        self._moves = configuration_of_moments(self._problem) != "reference"
        size = V.dofmap.index_map.size_local
        self._X = self._problem.places[:size, : self._dim]
        self._about: dict[str, FloatArray] = {}
        if self._problem.geometry != "axisymmetric" and self._problem.cell is None:
            self._about = {
                label: middle_of(body, list(dict.fromkeys(names)))
                for label, names in parts_held(self._problem).items()
            }

    def __call__(
        self, forces: FloatArray | None = None
    ) -> tuple[dict[str, FloatArray], dict[str, Moment]]:
        """Forces [N] and moments of the supports on the body, by label. Collective.

        Those of ties are on their tied side.

        Args:
            forces: Out-of-balance nodal forces, owned entries [N]; by default the residual as it
                was assembled last.
        """
        x = self._X
        if self._moves:
            x = x + self._problem.u.x.array[: x.size].reshape(x.shape)
        labels = (*self._problem.constraints.labels, *self._assembler.reactions.labels)
        resultants: dict[str, FloatArray] = {label: np.zeros(self._dim) for label in labels}
        moments = {label: np.zeros(3 if self._dim == 3 else 1) for label in self._about}
        forces = self._assembler.residual.owned if forces is None else forces
        for label, nodes, acting in self._acting(forces):
            resultants[label] = resultants.get(label, 0.0) + acting.sum(axis=0)
            if label in moments:  # not what a user's own virtual work does
                moments[label] += moment_of(x[nodes] - self._about[label], acting).sum(axis=0)
        whole = self._over_ranks(moments)
        return self._over_ranks(resultants), {
            label: Moment(whole[label], about) for label, about in self._about.items()
        }

    def _over_ranks(self, sums: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Sums over all ranks, which have the same labels. Collective."""
        if not sums:
            return {}
        return dict(zip(sums, total(self._comm, np.array(list(sums.values()))), strict=True))

    def _acting(self, forces: FloatArray) -> Iterator[tuple[str, IndexArray, FloatArray]]:
        """Label, owned nodes, and forces on them of this rank, shape (nodes, dim)."""
        a, nodal = self._assembler, forces[self._assembler.displacement_dofs]
        for holder, nodes, acting in a.problem.constraints.reactions(nodal, a.residual.tied_nodal):
            yield holder.label, nodes, acting
        for label, rows in a.reactions.by_label().items():
            nodes = np.flatnonzero(np.any(rows != 0.0, axis=1)).astype(np.int32)
            yield label, nodes, rows[nodes]
