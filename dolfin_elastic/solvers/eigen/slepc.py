"""Eigenvalues of large symmetric pencils by SLEPc or LOBPCG, and how many of them there are.

Krylov-Schur iterations find the eigenvalues of A x = value B x that lie nearest to a shift, by
solving with A - shift B; where that has no factors, `lobpcg` finds them.  B may be singular:
prescribed displacements, and pressures without inertia, have infinite eigenvalues, which
shift-and-invert maps to zero, so that none of them is ever found; SLEPc purges what is left of them
from the vectors.  How many eigenvalues lie below a number follows from the signs of the pivots of
A - number B, by Sylvester's law of inertia.

Sources: G. W. Stewart, SIAM J. Matrix Anal. Appl. 23 (2002) 601; B. Nour-Omid, B. Parlett,
T. Ericsson and P. Jensen, Math. Comp. 48 (1987) 663 (B singular); G. Golub and C. Van Loan, Matrix
Computations (2013), section 8.1.5 (inertia).
"""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.core.compat import petsc_errors
from dolfin_elastic.core.errors import ConvergenceError
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.petsc_options import PREFIX, PetscOptions, PetscValue
from dolfin_elastic.core.si_text import counted
from dolfin_elastic.core.signals import raise_if_agreed, stop_agreed
from dolfin_elastic.core.startup.slepc import SLEPc
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.geometry.simplices import boundary_facets
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler, Tangent
from dolfin_elastic.solvers.assembly.symmetric.blocks import halves
from dolfin_elastic.solvers.assembly.symmetric.several import EIGHT
from dolfin_elastic.solvers.eigen.lobpcg import (
    Cycle,
    Lobpcg,
    NotConvergedError,
    Preconditioned,
    multiply,
)
from dolfin_elastic.solvers.linear.choice import (
    BLOCKS,
    Choice,
    LinearSettings,
    factorising,
    grids,
    petsc_multigrid,
)
from dolfin_elastic.solvers.linear.hierarchy import Multigrid
from dolfin_elastic.solvers.linear.multigrid import PMultigrid, rigid_body_modes
from dolfin_elastic.solvers.messages import eigenvalues
from dolfin_elastic.solvers.petsc.options import Options, cause_of, ksp_reason

DIRECT_LIMIT = {2: 600_000, 3: 20_000}
"""Unknowns up to which is factorised by default: a block of 10 000 takes as long either way, one of
20 000 three fifths without factors."""

COUNTED_LIMIT = {2: 600_000, 3: 100_000}
"""The same where values are to be counted, which takes factors, and for modes of thin bodies, whose
factors are small: without them plates of 15 000 to 60 000 take 1.3 to 1.7 times as long."""

THIN = 0.45
"""Fraction of nodes on the boundary from which a body is thin: a bar seven nodes across has 0.49,
a plate four nodes thick 0.54."""

SPARE = 4
"""Modes computed beyond the requested ones, so that there is a gap to count in."""

BLOCK = 50
"""Modes that LOBPCG looks for at once, at most: it has five vectors for each."""

ROOM = 15
"""Krylov vectors beyond the number of requested modes, at least."""

_NAMES = {SLEPc.EPS.Type.KRYLOVSCHUR: "Krylov-Schur"}

log = logging.getLogger("dolfin_elastic")

INFINITE = 1e13
"""Distance from the shift, over that of the nearest eigenvalue, from which an eigenvalue counts as
infinite: more pressures than free displacements leave such ones, up to round-off."""


@dataclass(frozen=True)
class Pair:
    """An eigenvalue and its vector: owned entries of all unknowns, of any length."""

    value: float
    vector: FloatArray


@dataclass(frozen=True)
class Search:
    """Which eigenpairs are looked for.

    Attributes:
        shift: Below all values that are looked for: omega^2 [1/s^2], or a load factor.
        count: How many, the nearest ones.
        room: How many there are at all.
        spare: How many more than `count`, which may be less accurate.
        known: Vectors that are found already, owned entries of each, orthogonal to each other in
            the inner product of the solver.
        seed: Number of a search, each of which begins with vectors of its own.
        below: Values above it are not wanted, though there may be some.
    """

    shift: float
    count: int
    room: int
    spare: int = 0
    known: Sequence[FloatArray] = ()
    seed: int = 0
    below: float = np.inf


def choose_eigen(problem: Problem, settings: LinearSettings, *, counted: bool) -> Choice:
    """Chooses how an eigenvalue problem is solved, and says why.

    Args:
        settings: As the user chose.
        counted: Factors are worth it further: values are to be counted, or the body is thin.
    """
    limits = COUNTED_LIMIT if counted else DIRECT_LIMIT
    dofs, limit = problem.num_dofs, limits[problem.body.dim]
    direct = settings.method == "direct" or (settings.method == "auto" and dofs <= limit)
    size = f"{dofs} unknowns"
    if settings.method != "auto":
        size += f", '{settings.method}' asked for"
    if direct or problem.unknowns.auxiliary_fields:
        if not direct:
            size += ", with scalar fields beside the displacement"
        detail = "Krylov-Schur with shift and invert (SLEPc; MUMPS, LDL^T)"
        return Choice(True, prefixed(factorising(True)), f"{size}, direct solver", detail)
    options = {
        "ksp_type": "cg",
        "ksp_rtol": 1e-11,  # errors of solutions are errors of eigenvectors
        "ksp_max_it": 2000,
        **BLOCKS,
    }
    name = grids(problem.degree)
    detail = f"LOBPCG, {name}"
    return Choice(False, prefixed(options), f"{size}, iterative solver", detail)


def thin(problem: Problem) -> bool:
    """Whether about half of a body's nodes lie on its boundary, if that matters. Collective."""
    dim, nodes = problem.body.dim, problem.V.dofmap.index_map
    if not DIRECT_LIMIT[dim] < problem.num_dofs <= COUNTED_LIMIT[dim]:
        return False
    facets = boundary_facets(problem.body.mesh)
    outside = fem.locate_dofs_topological(problem.V, dim - 1, facets)
    own = int(np.count_nonzero(outside < nodes.size_local))
    return total(problem.body.comm, own) >= THIN * nodes.size_global


def prefixed(options: PetscOptions) -> dict[str, PetscValue]:
    """Options of a linear solver inside SLEPc's spectral transformation."""
    return {f"st_{name}": value for name, value in options.items()}


def negative(matrix: PETSc.Mat) -> int | None:
    """Negative eigenvalues of a symmetric matrix, from its pivots; None: one is zero. Collective.

    Raises:
        ConvergenceError: It cannot be factorised.
        StoppedError: A signal has asked for the end of the run.
    """
    raise_if_agreed(matrix.comm.tompi4py())
    ksp = PETSc.KSP().create(matrix.comm)
    try:
        ksp.setOptionsPrefix(PREFIX + "inertia_")
        ksp.setOperators(matrix)
        ksp.setType("preonly")
        pc = ksp.getPC()
        pc.setType("cholesky")
        pc.setFactorSolverType("mumps")
        pc.setFactorSetUpSolverType()
        factors = pc.getFactorMatrix()
        # Room for pivots; without ScaLAPACK at the root, which hides signs; null pivots are met.
        for number, value in ((14, 80), (13, 1), (24, 1)):
            factors.setMumpsIcntl(number, value)
        ksp.setUp()
        if pc.getFailedReason() != PETSc.PC.FailedReason.NOERROR:
            raise _no_factors()
        below, zero, _ = pc.getFactorMatrix().getInertia()
        return None if zero else int(below)
    except PETSc.Error:
        raise _no_factors() from None
    finally:
        ksp.destroy()


def _no_factors() -> ConvergenceError:
    return ConvergenceError(
        "the eigenvalues cannot be counted: MUMPS cannot factorise the matrix",
        advice="more memory (more ranks), a coarser mesh",
    )


class _Freed(Protocol):
    """What has to be freed."""

    def destroy(self) -> object: ...


def destroy(*things: _Freed | None) -> None:
    """Frees objects. Collective.

    Args:
        things: A solver among them may have been left by an error, and be freed in part only.
    """
    for thing in things:
        if thing is not None:
            with suppress(PETSc.Error), petsc_errors():
                thing.destroy()


@contextmanager
def failing() -> Iterator[None]:
    """Converts an error of PETSc inside an eigenvalue solver into `ConvergenceError`.

    Raises:
        ConvergenceError: It has failed.
    """
    try:
        yield
    except PETSc.Error as error:
        raise _failed(cause_of(error)) from None


def _failed(cause: str) -> ConvergenceError:
    return ConvergenceError(
        f"the eigenvalue solver has failed: {cause}",
        advice='solver.method = "direct", more memory (more ranks), a coarser mesh',
    )


class Pencil(ABC):
    """Finds and counts eigenvalues of A x = value B x, both symmetric. Collective.

    Args:
        assembler: Its tangent, as it is assembled, is A.
        B: Of PETSc's entries, or makes itself such, see `to_entries`.
        tolerance: Relative error of eigenvalues.

    Attributes:
        counted: How many values lie below a number can be counted.
        iterations: Name of each solver to how many of its iterations have found something.
    """

    def __init__(
        self,
        assembler: Assembler,
        B: PETSc.Mat,
        *,
        choice: Choice,
        users: PetscOptions,
        tolerance: float,
    ) -> None:
        self.problem, self.B, self.tolerance = assembler.problem, B, tolerance
        self.A, self._assembler, self._made = assembler.tangent.matrix, assembler, list[_Freed]()
        self.options, self.counted = Options(choice.options, users), choice.direct
        self.options.update(
            petsc_multigrid(self.options.all, self.options.users, self.problem.degree)
        )
        self.pressures = self.problem.unknowns.count("pressure")
        self.iterations = Counter[str]()

    @property
    def solver(self) -> str:
        """What has found values, and in how many iterations, for people."""
        return ", ".join(f"{n}, {counted(k, 'iteration')}" for n, k in self.iterations.items())

    def below(self, number: float) -> int | None:
        """How many negative eigenvalues A - number B has; None: it is singular. Collective.

        Each pressure adds a negative pivot, see `diagnostics.stability`.
        """
        with stage("solve"):
            shifted = self.shifted(number)
            try:
                count = negative(shifted)
            finally:
                shifted.destroy()
        return None if count is None else count - self.pressures

    def shifted(self, number: float) -> PETSc.Mat:
        """A - number B, which the caller destroys. Collective."""
        shifted = self.A.copy()
        shifted.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        if number != 0.0:
            shifted.axpy(-number, self.B, PETSc.Mat.Structure.UNKNOWN_NONZERO_PATTERN)
        return shifted

    def near(self, search: Search) -> list[Pair]:
        """The eigenpairs next to a shift, in the order of their values. Collective.

        Without factors and options of the user by LOBPCG, if it converges.

        Raises:
            ConvergenceError: The solver has failed.
            StoppedError: See `solve`.
        """
        if not self.counted and not self.options.users:
            try:
                with stage("solve"), failing():
                    return self._by_blocks(search)
            except NotConvergedError:
                log.info("LOBPCG has not converged: %s instead", self.leave_blocks())
        return self._by_krylov(search)

    @abstractmethod
    def leave_blocks(self) -> str:
        """Prepares for Krylov-Schur iterations, and names them. Collective."""

    @abstractmethod
    def preconditioned(self, shift: float) -> Preconditioned:
        """What LOBPCG solves: A - shift B, whose multigrid is kept, with B. Collective."""

    @abstractmethod
    def ritz(self, value: float) -> float:
        """What LOBPCG finds for a value, less the shift, or the other way round."""

    def to_entries(self) -> None:
        """Makes A and B such of PETSc's entries, which are freed with this. Collective."""
        tangent, self.B = self._tangent_in_double(), self.B.getPythonContext().aij()
        self.A, self._made = tangent.matrix, [tangent, self.B]

    def _tangent_in_double(self) -> Tangent:
        tangent = Tangent(self._assembler, self._assembler.tangent.form, iterated=False)
        x = self._assembler.create_vector()
        self._assembler.get(x)
        tangent.assemble(x)
        x.destroy()
        return tangent

    def in_double(self, pairs: Sequence[Pair]) -> list[Pair]:
        """The same with the Rayleigh quotients of A in double precision, ascending. Collective.

        The half of its blocks has 48 digits of 53, and stretching stiffness that of bending, which
        is smaller by the square of slenderness: twenty elements in a row lose 1e-9 of a value.  The
        vectors' errors count by their square.
        """
        if halves(self.A) is None or not pairs:
            return list(pairs)
        tangent, exact = self._tangent_in_double(), list[Pair]()
        for first in range(0, len(pairs), EIGHT):
            vectors = np.array([pair.vector for pair in pairs[first : first + EIGHT]])
            products, image = np.empty((2, len(vectors))), np.empty_like(vectors)
            for matrix, row in zip((tangent.matrix, self.B), products, strict=True):
                multiply(matrix, vectors, image)
                row[:] = np.einsum("ki,ki->k", vectors, image)
            above, below = total(self._assembler.comm, products)
            quotients = above / below
            exact += [Pair(float(q), v) for q, v in zip(quotients, vectors, strict=True)]
        tangent.destroy()
        return sorted(exact, key=lambda pair: pair.value)

    def destroy(self) -> None:
        """Frees what was made, not A and B as they were given. Collective."""
        destroy(*self._made)

    def _by_blocks(self, search: Search) -> list[Pair]:
        """See `near`: `BLOCK` after `BLOCK`."""
        pairs = list[Pair]()
        below = self.ritz(search.below - search.shift)
        while (wanted := min(search.count, search.room) - len(pairs)) > 0:
            now = min(wanted, BLOCK)
            more = search.spare if now == wanted else SPARE
            size = min(max(now + more, EIGHT), search.room - len(pairs))
            known = [*search.known, *(pair.vector for pair in pairs)]
            seed = search.seed + len(pairs)
            block = Lobpcg(self.preconditioned(search.shift), size, known=known, seed=seed)
            block.solve(now, self.tolerance, below)
            self.iterations["LOBPCG with multigrid"] += block.steps
            kept = block.values < below
            if now < wanted or search.spare == 0:
                kept &= block.converged
            for value, v in zip(block.values[kept], block.vectors()[kept], strict=True):
                pairs.append(Pair(search.shift + self.ritz(float(value)), v))
            if search.below < np.inf:
                break
        return sorted(pairs, key=lambda pair: pair.value)

    def _by_krylov(self, search: Search) -> list[Pair]:
        """See `near`."""
        if self.A.getType() == "python":
            self.to_entries()
        if not self.counted and search.below < np.inf:
            # Whether there is one at all: more take longer, or fail.
            search = replace(search, count=min(search.count, 1))
        shift, count = search.shift, min(search.count + search.spare, search.room)
        if count < 1:
            return []
        eps = SLEPc.EPS().create(self.A.comm)
        eps.setOptionsPrefix(PREFIX)
        eps.setTolerances(tol=self.tolerance, max_it=500)
        self.set_up(eps, shift, count, search.room)
        spaces = [self._vector(v) for v in (uneven(self.problem, search.seed), *search.known)]
        eps.setInitialSpace(spaces[0])
        if search.known:
            eps.setDeflationSpace(spaces[1:])
        temporary: Sequence[_Freed | None] = ()
        try:
            with stage("solve"), failing(), self.options.in_force(), self.options.elastic_errors():
                eps.setFromOptions()
                temporary = self.prepare(eps.getST(), shift)
                solve(eps)
                self.options.report_unused()
            name = "factors" if self.counted else "multigrid"
            self.iterations[f"{_NAMES.get(eps.getType(), eps.getType())} with {name}"] += (
                eps.getIterationNumber()
            )
            return self.chosen(eps, self._pairs(eps), shift, count)
        finally:
            destroy(eps, *spaces, *temporary)

    @abstractmethod
    def set_up(self, eps: SLEPc.EPS, shift: float, count: int, room: int) -> None:
        """Says which eigenvalues are looked for, and how. Collective."""

    def prepare(self, transform: SLEPc.ST, shift: float) -> Sequence[_Freed | None]:
        """Prepares the solver inside; returns what is destroyed after the solve. Collective."""
        return ()

    @abstractmethod
    def chosen(
        self, eps: SLEPc.EPS, pairs: Sequence[tuple[complex, FloatArray]], shift: float, count: int
    ) -> list[Pair]:
        """The pairs that are asked for, of those that have converged."""

    def _pairs(self, eps: SLEPc.EPS) -> list[tuple[complex, FloatArray]]:
        vector, pairs = self._vector(None), []
        for k in range(int(eps.getConverged())):
            value = complex(eps.getEigenpair(k, vector))
            pairs.append((value, np.array(vector.array_r)))
        vector.destroy()
        return pairs

    def _vector(self, values: FloatArray | None) -> PETSc.Vec:
        vector = self.A.createVecRight()
        if values is not None:
            vector.array_w[:] = values
        return vector


class Spectrum(Pencil):
    """Eigenvalues next to a shift; B is not negative. Collective; `destroy` it.

    Where A is kept by the half of its blocks, B is an `effective_mass.FreeMass`, multiples of which
    are added to A itself.
    """

    _preconditioned: tuple[float, Preconditioned] | None = None
    _added = 0.0

    def leave_blocks(self) -> str:
        """See `Pencil`: as before, with conjugate gradients inside."""
        return "Krylov-Schur with shift and invert"

    def ritz(self, value: float) -> float:
        """See `Pencil`."""
        return value

    def preconditioned(self, shift: float) -> Preconditioned:
        """See `Pencil`."""
        if self._preconditioned is None or self._preconditioned[0] != shift:
            self._leave()
            blocks, matrix = halves(self.A), self.A
            if blocks is not None and shift != self._added:
                self.B.getPythonContext().add_to(blocks, self._added - shift)
                self._added = shift
            elif blocks is None and shift != 0.0:
                matrix = self.shifted(shift)
            cycle = Cycle(self.problem, matrix)
            self._preconditioned = shift, Preconditioned(matrix, self.B, cycle)
        return self._preconditioned[1]

    def to_entries(self) -> None:
        """See `Pencil`."""
        self._leave()
        super().to_entries()

    def in_double(self, pairs: Sequence[Pair]) -> list[Pair]:
        """See `Pencil`; the multigrid makes room for it."""
        self._leave()
        return super().in_double(pairs)

    def destroy(self) -> None:
        """See `Pencil`; and the multigrid."""
        self._leave()
        super().destroy()

    def _leave(self) -> None:
        if self._preconditioned is not None:
            _, last = self._preconditioned
            destroy(last.cycle, None if last.A is self.A else last.A)
        self._preconditioned = None

    def set_up(self, eps: SLEPc.EPS, shift: float, count: int, room: int) -> None:
        """See `Pencil`."""
        eps.setOperators(self.A, self.B)
        eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
        subspace = min(max(2 * count, count + ROOM), max(room, count + 1), self.A.getSize()[0])
        eps.setDimensions(nev=count, ncv=subspace)
        eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
        eps.setTarget(shift)
        transform = eps.getST()
        transform.setType(SLEPc.ST.Type.SINVERT)
        transform.setShift(shift)

    def prepare(self, transform: SLEPc.ST, shift: float) -> Sequence[_Freed | None]:
        """Attaches multigrid and its near null space. Collective."""
        if self.counted:
            return ()
        matrix = self.shifted(shift)
        modes = rigid_body_modes(self.problem.V, self.problem.unknowns.single_valued)
        matrix.setNearNullSpace(modes)
        modes.destroy()
        transform.setPreconditionerMat(matrix)
        ksp = transform.getKSP()
        ksp.setFromOptions()
        if ksp.getPC().getType() == "python":
            return matrix, Multigrid(self.problem, ksp.getPC())
        if ksp.getPC().getType() == "mg" and self.problem.degree > 1:
            return matrix, PMultigrid(self.problem, ksp.getPC())
        return (matrix,)

    def chosen(
        self, eps: SLEPc.EPS, pairs: Sequence[tuple[complex, FloatArray]], shift: float, count: int
    ) -> list[Pair]:
        """See `Pencil`; those at infinity are left out."""
        if len(pairs) < count:
            raise ConvergenceError(
                f"of {count} modes only {len(pairs)} were found: the eigenvalue solver has failed, "
                f"{eigenvalues(_reason(eps))}, after {eps.getIterationNumber()} iterations",
                advice='solver.method = "direct", fewer modes, or a larger tolerance',
            )
        far = INFINITE * min(abs(value.real - shift) for value, _ in pairs)
        finite = [Pair(z.real, v) for z, v in pairs if abs(z.real - shift) < far]
        return sorted(finite, key=lambda pair: pair.value)


def solve(eps: SLEPc.EPS) -> None:
    """Solves an eigenvalue problem, unless the run shall stop. Collective.

    PETSc itself raises an error where a linear solve inside does not converge, but not after any
    other error of the process within a solve: it counts solves within solves, and has lost count.

    Raises:
        ConvergenceError: A linear solve inside has not converged.
        StoppedError: A signal has asked for the end of the run.
    """
    comm = eps.comm.tompi4py()
    raise_if_agreed(comm)
    eps.setStoppingTest(_stops)
    inner, reasons = eps.getST().getKSP(), [0]
    if inner.getErrorIfNotConverged():
        inner.setPostSolve(lambda ksp, _b, _x: reasons.append(ksp.getConvergedReason()))
    with petsc_errors():
        eps.solve()
    if min(reasons) < 0:
        raise _failed(f"KSPSolve() has not converged, reason {ksp_reason(min(reasons))}")
    if eps.getConvergedReason() == SLEPc.EPS.ConvergedReason.CONVERGED_USER:
        raise_if_agreed(comm)


def _stops(eps: SLEPc.EPS, iteration: int, most: int, converged: int, wanted: int) -> int:
    """SLEPc's own test after each restart, and whether the run shall stop. Collective."""
    reason = SLEPc.EPS.ConvergedReason
    if converged >= wanted:
        return int(reason.CONVERGED_TOL)
    if stop_agreed(eps.comm.tompi4py()):
        return int(reason.CONVERGED_USER)
    return int(reason.DIVERGED_ITS if iteration >= most else reason.CONVERGED_ITERATING)


def _reason(eps: SLEPc.EPS) -> str:
    names = vars(SLEPc.EPS.ConvergedReason)
    number = eps.getConvergedReason()
    return next((n for n, value in names.items() if value == number), str(number))


def uneven(problem: Problem, seed: int) -> FloatArray:
    """An initial vector with a component of every mode, the same on any number of ranks."""
    dim, moves = problem.body.dim, problem.unknowns.displacement_dofs
    x = problem.unknowns.unknown_places[: len(moves) // dim, :dim]
    span = largest(problem.body.comm, float(np.max(np.abs(x), initial=0.0))) or 1.0
    waves = np.sin((7.3 + 1.9 * seed) * x @ np.arange(1.0, dim + 1) / span)
    size = problem.W.dofmap.index_map.size_local * problem.W.dofmap.index_map_bs
    start = np.zeros(size)
    start[moves] = (waves[:, None] + np.cos(3.1 * (1 + seed) * x / span)).ravel()
    return start
