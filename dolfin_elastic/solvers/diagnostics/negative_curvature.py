"""Negative curvature of a tangent, met by conjugate gradients without any factors.

Conjugate gradients build the Lanczos polynomials of the preconditioned operator and meet a
direction of negative curvature as soon as one of their Ritz values is negative.  A right-hand side
with a part in every mode cannot be solved for before: the residual polynomial is 1 at zero and has
to be small at each eigenvalue, a negative one, too.

The operator M is the tangent A itself; its symmetric part where A is not symmetric; and with
pressures the tangent of a softer material, `SofterVolume`, which is nowhere stiffer than the body,
and of a less soft one where that is not positive definite.  So where M is positive definite the
body is stable.  Where it is not, the directions D of negative curvature decide: the inertia of A is
that of its restriction to their complement, on which M has become positive definite, and that of
the small matrix D^T A^-1 D.

Sources: C. C. Paige and M. A. Saunders, SIAM J. Numer. Anal. 12 (1975) 617 (conjugate gradients
and Lanczos); E. V. Haynsworth, Linear Algebra Appl. 1 (1968) 73 (inertia of Schur complements).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import span
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.linear.schur import SofterVolume
from dolfin_elastic.solvers.nonlinear.newton import Newton, Soft

ROUGH, FINE = 1e-2, 1e-3
"""Relative preconditioned residual of conjugate gradients; a mode of negative stiffness is met if
its part of the right-hand side is larger.  The second where there are modes of little stiffness
left, among which the negative one may have a small part."""

WEAK = 0.1
"""Smallest Ritz value below which it counts as little: those of multigrid are between 0.3 and 1."""

ITERATIONS = 200
"""Of conjugate gradients: 10 serve for a preconditioner of this tangent, 30 where it is old."""

MOST_DIRECTIONS = 8
"""Directions of negative curvature after which it is given up.  Softer pressures add some below
the critical load, one for each mode that is near its own."""

RESPONSES = 3
"""States whose responses are left out of conjugate gradients, at a product each: two equal modes
of a square column take two of them, and a third tells how the force divides among the others."""

_NEW = 1e-3
"""Share of a response that is new beside others, below which it is no more than the error of
conjugate gradients."""

_SOLVE, _SOLVE_ITERATIONS = 0.1, 500
"""Relative residual of the solves with the whole tangent, and their iterations: the quotient
d . A^-1 d is known to a hundredth then, and only its sign counts."""

_WEIGHTS = np.array([1.0, 1.0, 3.0])
"""Of the noise, of the preconditioned one, and of the smooth part in the right-hand side: with
equal ones the parts of a mode of the whole body cancelled each other on some meshes."""

ROUND_OFF = 1e-8
"""Of inner products of vectors of size 1, in the preconditioner's norm."""

FLUTTER = (
    "its tangent is not symmetric and has complex eigenvalues: flutter is a question of motion"
)

_REAL = 1e-6
"""Imaginary over absolute value of eigenvalues that count as real."""


@dataclass(frozen=True)
class Inertia:
    """What the directions of negative curvature say of a tangent.

    Attributes:
        negative: Its negative eigenvalues; None where nothing is certain.
        at_least: There may be more of them.
        direction: Displacement that the tangent resists least, or less than not at all: owned
            entries of all unknowns; None without any.
        reason: Why nothing is certain.
    """

    negative: int | None
    at_least: bool = False
    direction: FloatArray | None = None
    reason: str = ""


def count_negative(newton: Newton, *, exactly: bool = False) -> Inertia:
    """Negative eigenvalues of the fields' last tangent, those of pressures left out. Collective.

    For factors of one that is not symmetric see `factored_inertia`.

    Args:
        newton: The solver, whose preconditioner or factors may be those of an older tangent.
        exactly: All of them are wanted; else one that is proven is enough.
    """
    options = newton.options  # of parts of the preconditioner that are made at their first use
    with options.in_force(), options.elastic_errors(), newton.linear.left_as_it_is():
        tangent, kept = _Tangent(newton), newton.soft
        directions = _Directions(tangent)
        # Near a critical load the softer volume is too soft along the same motions again.
        while tangent.is_negative_along(kept):
            if not tangent.stiffen():
                directions.begin(kept)
                break
        # Factors are asked anew along which of several forces they are negative.
        known = None if newton.linear.direct else kept.force
        begin = _begin(tangent) if known is None else _Begin(known, tangent.precondition(known))
        inertia, response = _count(tangent, directions, begin, kept.responses, exactly=exactly)
        responses = () if response is None else (response, *kept.responses)[:RESPONSES]
        newton.soft = replace(directions.kept(), force=begin.force, responses=responses)
        tangent.destroy()
    return inertia


def _count(
    tangent: _Tangent,
    directions: _Directions,
    begin: _Begin,
    responses: Sequence[FloatArray],
    *,
    exactly: bool,
) -> tuple[Inertia, FloatArray | None]:
    """The inertia, and the response to the force where M is positive definite as a whole."""
    enough = tangent.symmetric and not exactly  # of others, one proves nothing before the end
    while True:
        ended = _conjugate_gradients(tangent, directions, begin, responses)
        if ended.response is not None:
            of_all = None if directions.count else ended.response
            return directions.verdict(at_least=False), of_all
        if ended.direction is None:
            return Inertia(None, reason=ended.reason), None
        if enough and tangent.is_whole:
            return _proven(tangent, ended.direction), None
        if not directions.count and tangent.stiffen():
            continue  # cheaper than a solve for a direction, which it may save
        if not directions.add(ended.direction):
            return Inertia(
                None, reason="the linear solver does not converge with its tangent"
            ), None
        if enough and directions.verdict(at_least=True).negative:
            return directions.verdict(at_least=True), None
        if directions.count >= MOST_DIRECTIONS:
            reason = f"its tangent has more than {MOST_DIRECTIONS} directions of little or negative"
            return Inertia(None, reason=f"{reason} stiffness"), None


def _proven(tangent: _Tangent, d: FloatArray) -> Inertia:
    """A negative eigenvalue, where a symmetric tangent itself is negative along d. Collective.

    Conjugate gradients end with such a direction also where only the preconditioner is negative.
    """
    if tangent.dot(d, tangent.product(d)) > 0.0:
        return Inertia(None, reason="its preconditioner is not positive definite")
    return Inertia(1, at_least=True, direction=tangent.spread(d))


class _Tangent:
    """M, its preconditioner, and the inverse of A, on owned rows of the fields. Collective.

    Attributes:
        comm: The ranks.
        symmetric: A is.
        is_whole: M is A.
    """

    def __init__(self, newton: Newton) -> None:
        assembler = newton.assembler
        problem = assembler.problem
        self._assembler, self._linear = assembler, newton.linear
        self.comm, self.symmetric = assembler.comm, bool(problem.symmetric)
        self._softer = SofterVolume(assembler) if problem.mixed else None
        self._rows: IndexArray | slice = slice(None)
        if self._softer is not None:
            self._rows = self._softer.moves
        self.is_whole = self.symmetric and self._softer is None
        self._A, self._pc = assembler.tangent.matrix, newton.ksp.getPC()
        self._x, self._y, self._z = (assembler.create_vector() for _ in range(3))
        self._ksp: PETSc.KSP | None = None

    def stiffen(self) -> bool:
        """Makes M stiffer, as far as it may be; False where it is so already. Collective."""
        return self._softer is not None and self._softer.stiffen()

    def is_negative_along(self, kept: Soft) -> bool:
        """Whether M is along a direction that was found in another state. Collective."""
        return any(self.dot(d, self.product(d)) < 0.0 for d in kept.directions)

    def product(self, x: FloatArray) -> FloatArray:
        """M x [N] of a vector without constrained components. Collective."""
        self._put(x)
        self._A.mult(self._x, self._y)
        result = self._y.array_r
        if not self.symmetric:
            self._A.multTranspose(self._x, self._z)
            result = (result + self._z.array_r) / 2
        return result.copy() if self._softer is None else self._softer.eliminate(result)

    def precondition(self, r: FloatArray) -> FloatArray:
        """An approximation of M^-1 r, without constrained components as r. Collective."""
        split = self._linear.split
        if split is not None:
            return self._free(split.precondition(r))
        self._put(r)
        self._pc.apply(self._x, self._y)
        return self._free(self._y.array_r[self._rows].copy())

    def inverse(self, f: FloatArray, guess: FloatArray | None = None) -> FloatArray | None:
        """A^-1 f, None where the linear solver does not converge. Collective.

        Roughly where it iterates.  GMRES, whatever Newton's solver: A may be indefinite.

        Args:
            guess: Of the solution, on all rows, of any length.

        Returns:
            On all owned rows.
        """
        self._take(f)
        if self._linear.direct:
            self._pc.apply(self._x, self._y)
            good = bool(np.isfinite(self._y.norm()))
        else:
            ksp = self._gmres()
            ksp.setInitialGuessNonzero(guess is not None)
            if guess is not None:
                self._guess(guess)
            ksp.solve(self._x, self._y)
            good = ksp.getConvergedReason() > 0
        if not good:
            return None
        self._assembler.remove_constrained(self._y)
        return np.asarray(self._y.array_r.copy())

    def _guess(self, guess: FloatArray) -> None:
        """Of the length that leaves the smallest residual."""
        self._y.array_w[:] = guess
        self._assembler.remove_constrained(self._y)
        self._A.mult(self._y, self._z)
        square = self._z.dot(self._z)
        self._y.scale(self._z.dot(self._x) / square if square > 0.0 else 0.0)

    def force(self, w: FloatArray) -> FloatArray:
        """The rows of M of A w. Collective."""
        self._x.array_w[:] = w
        self._assembler.remove_constrained(self._x)
        self._A.mult(self._x, self._y)
        return self._free(self.on_rows(self._y.array_r))

    def on_rows(self, w: FloatArray) -> FloatArray:
        """The rows of M of all owned ones."""
        return np.asarray(w[self._rows])

    def _gmres(self) -> PETSc.KSP:
        if self._ksp is None:
            self._ksp = PETSc.KSP().create(self.comm)
            self._ksp.setType("gmres")
            self._ksp.setGMRESRestart(100)
            self._ksp.setPCSide(PETSc.PC.Side.RIGHT)
            self._ksp.setPC(self._pc)
            self._ksp.setOperators(self._A)
            self._ksp.setTolerances(rtol=_SOLVE, max_it=_SOLVE_ITERATIONS)
        return self._ksp

    def start(self) -> tuple[list[FloatArray], list[FloatArray]]:
        """Right-hand sides that have a part in every mode together, preconditioned. Collective.

        A smooth one for the modes of the whole body; noise for those of short waves, as of
        wrinkles; and the preconditioned noise, in which modes weigh as they are soft.

        Returns:
            The three, and their products with the preconditioner.
        """
        moves, smooth = self._assembler.displacement_dofs, start_vector(self._assembler)
        rough = self._forces(moves, noise(self._assembler))
        parts = [rough, self.precondition(rough), self._forces(moves, smooth)]
        return parts, [parts[1], *map(self.precondition, parts[1:])]

    def _forces(self, moves: IndexArray, values: FloatArray) -> FloatArray:
        self._x.set(0.0)
        self._x.array_w[moves] = values
        self._assembler.remove_constrained(self._x)
        return np.asarray(self._x.array_r[self._rows].copy())

    def _put(self, x: FloatArray) -> None:
        self._x.set(0.0)
        self._x.array_w[self._rows] = x

    def _take(self, x: FloatArray) -> None:
        self._put(x)
        self._assembler.remove_constrained(self._x)

    def _free(self, x: FloatArray) -> FloatArray:
        """Without constrained components."""
        self._take(x)
        return np.asarray(self._x.array_r[self._rows].copy())

    def dot(self, a: FloatArray, b: FloatArray) -> float:
        """Inner product over all ranks. Collective.

        Args:
            a: Owned rows.
            b: Owned rows.
        """
        return float(total(self.comm, float(np.dot(a, b))))

    def spread(self, x: FloatArray) -> FloatArray:
        """Owned entries of all unknowns; pressures are zero, tied ones follow. Collective."""
        self._take(x)
        result = self._x.array_r.copy()
        self._assembler.extend(result)
        return result

    def destroy(self) -> None:
        """Frees what it owns. Collective."""
        for thing in (self._x, self._y, self._z, self._softer, self._ksp):
            if thing is not None:
                thing.destroy()


class _Directions:
    """Directions D of negative curvature, orthonormal, and A^-1 D."""

    def __init__(self, tangent: _Tangent) -> None:
        self._tangent = tangent
        self._d: list[FloatArray] = []
        self._whole: list[FloatArray] = []  # A^-1 D on all rows

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self._d)

    def begin(self, kept: Soft) -> None:
        """Begins with the motions of another state. Collective."""
        for motion in kept.motions:
            y = motion
            d = self._tangent.force(y)  # whose solution is nearly known
            for other, solved in zip(self._d, self._whole, strict=True):
                share = self._tangent.dot(other, d)
                d, y = d - share * other, y - share * solved
            self.add(d, guess=y)

    def kept(self) -> Soft:
        """For the next state that is judged."""
        return Soft(tuple(self._d), tuple(self._whole))

    def project(self, v: FloatArray) -> FloatArray:
        """The part of a vector on their complement. Collective."""
        if not self._d:
            return v
        D = np.array(self._d)
        return np.asarray(v - D.T @ total(self._tangent.comm, D @ v))

    def add(self, d: FloatArray, guess: FloatArray | None = None) -> bool:
        """Adds a direction and solves for it; False where that fails. Collective.

        Args:
            guess: Of A^-1 d, of any length.
        """
        d = self.project(self.project(d))  # twice is enough for round-off
        size = np.sqrt(self._tangent.dot(d, d))
        y = self._tangent.inverse(d / size, guess) if size > 0.0 else None
        if y is None:
            return False
        self._d.append(d / size)
        self._whole.append(y)
        return True

    def verdict(self, *, at_least: bool) -> Inertia:
        """What the eigenvalues of D^T A^-1 D say. Collective.

        Args:
            at_least: The tangent need not be positive definite on their complement.
        """
        if not self._d:
            return Inertia(0)
        D = np.array(self._d)
        Y = np.array([self._tangent.on_rows(y) for y in self._whole])
        symmetric = self._tangent.symmetric
        inertia = by_directions(self._tangent.comm, D, Y, symmetric=symmetric, at_least=at_least)
        if inertia.direction is None:
            return inertia
        return replace(inertia, direction=self._tangent.spread(inertia.direction))


def by_directions(
    comm: MPI.Comm,
    D: FloatArray,
    Y: FloatArray,
    *,
    symmetric: bool = False,
    at_least: bool,
) -> Inertia:
    """What the eigenvalues of D^T A^-1 D say. Collective.

    Args:
        comm: The ranks.
        D: Orthonormal directions, one a row, owned entries.
        Y: A^-1 D.
        at_least: The symmetric part of A need not be positive definite on their complement.

    Returns:
        With a direction that is a combination of the rows of Y.
    """
    G = total(comm, D @ Y.T)
    if symmetric:
        compliances, vectors = np.linalg.eigh((G + G.T) / 2)
    else:
        inertia, vectors = np.linalg.eig(G)
        if np.any(np.abs(inertia.imag) > _REAL * np.abs(inertia)):
            return Inertia(None, reason=FLUTTER)
        compliances, vectors = inertia.real, vectors.real
    weakest = int(np.argmin(compliances))
    if compliances[weakest] > 0.0:
        weakest = int(np.argmax(compliances))
    return Inertia(int(np.sum(compliances < 0.0)), at_least, vectors[:, weakest] @ Y)


@dataclass(frozen=True)
class _Ended:
    """How conjugate gradients have ended.

    Attributes:
        response: To the force: they have converged, the operator is positive definite.
        direction: Of negative curvature, where they have met one.
        reason: Why neither.
    """

    response: FloatArray | None = None
    direction: FloatArray | None = None
    reason: str = ""


def _conjugate_gradients(
    tangent: _Tangent,
    directions: _Directions,
    begin: _Begin,
    responses: Sequence[FloatArray],
) -> _Ended:
    """Conjugate gradients on the complement of some directions. Collective.

    Source: G. Golub and Q. Ye, SIAM J. Sci. Comput. 21 (1999) 1305 (of a varying preconditioner).
    """
    whole = not directions.count
    apart = _Apart(tangent, responses if whole else ())
    negative = begin.negative if whole and begin.negative is not None else apart.negative
    if negative is not None:
        return _Ended(direction=negative)
    x, r = apart.begin(directions.project(begin.force))
    z = begin.image if whole and not apart.count else directions.project(tangent.precondition(r))
    p, rz = apart.conjugate(z), tangent.dot(r, z)
    square, ritz = tangent.dot(begin.force, begin.image) if whole else rz, _RitzValues()
    for _ in range(ITERATIONS):
        if abs(rz) <= ROUGH**2 * square and (abs(rz) <= FINE**2 * square or ritz.smallest() > WEAK):
            return _Ended(response=x)
        if rz <= 0.0:  # nothing is free to move, or the preconditioner itself is negative
            return _Ended(response=x) if rz == 0.0 else _Ended(direction=z)
        image = apart.rest(directions.project(tangent.product(p)))
        curvature = tangent.dot(p, image)
        if not np.isfinite(curvature):
            return _Ended(reason="its tangent is not finite")
        if curvature <= 0.0:
            return _Ended(direction=p)
        x = x + rz / curvature * p
        r, last = r - rz / curvature * image, r
        z = directions.project(tangent.precondition(r))
        before, rz = rz, tangent.dot(r, z)
        ritz.add(before / curvature, rz / before)
        # The second product is zero unless the preconditioner is not symmetric, as the tangent.
        p = apart.conjugate(z) + (rz - tangent.dot(last, z)) / before * p
    return _Ended(reason=f"conjugate gradients need more than {ITERATIONS} iterations")


class _Apart:
    """Motions V that conjugate gradients leave out. Collective.

    The inertia of M is that of V^T M V and that of M on the motions conjugate to V.  In each mode
    of these the force b keeps its part, v . (b - M V c) = v . b for any c, so that a negative one
    is met as without V, and soft ones that V holds take no iterations.

    Sources: E. V. Haynsworth, Linear Algebra Appl. 1 (1968) 73; Y. Saad, M. Yeung, J. Erhel and
    F. Guyomarc'h, SIAM J. Sci. Comput. 21 (2000) 1909 (deflated conjugate gradients).

    Attributes:
        negative: A motion along which M is negative; None where V^T M V is positive definite.
    """

    def __init__(self, tangent: _Tangent, motions: Sequence[FloatArray]) -> None:
        self._tangent = tangent
        self._V = np.empty((0, 0))  # a row each, of curvature 1, conjugate to each other
        self._images = self._V  # M V
        self.negative: FloatArray | None = None
        for motion in motions:
            v = self.conjugate(self.conjugate(motion))  # twice is enough for round-off
            if tangent.dot(v, v) <= _NEW**2 * tangent.dot(motion, motion):
                continue
            image = tangent.product(v)
            curvature = tangent.dot(v, image)
            if curvature <= 0.0:
                self.negative = v
                return
            size = np.sqrt(curvature)
            self._V = np.array([*self._V, v / size])
            self._images = np.array([*self._images, image / size])

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self._V)

    def begin(self, b: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The motion in V that answers b best, and the force that is left."""
        if not self.count:
            return np.zeros_like(b), b
        return self._work(b) @ self._V, self.rest(b)

    def rest(self, f: FloatArray) -> FloatArray:
        """The part of a force that does no work along V: skew parts and round-off have some."""
        return np.asarray(f - self._work(f) @ self._images) if self.count else f

    def _work(self, f: FloatArray) -> FloatArray:
        return np.asarray(total(self._tangent.comm, self._V @ f))

    def conjugate(self, z: FloatArray) -> FloatArray:
        """The part of a motion that is conjugate to V."""
        if not self.count:
            return z
        parts = total(self._tangent.comm, self._images @ z)
        return np.asarray(z - parts @ self._V)


class _RitzValues:
    """Those of the preconditioned operator on the Krylov space of conjugate gradients.

    Source: G. Golub and C. Van Loan, Matrix Computations (2013), section 11.3.5.
    """

    def __init__(self) -> None:
        self._diagonal: list[float] = []
        self._beside: list[float] = []
        self._rest = 0.0

    def add(self, step: float, ratio: float) -> None:
        """Adds an iteration.

        Args:
            ratio: Of its square of the residual to that before.
        """
        self._diagonal.append(1.0 / step + self._rest)
        self._beside.append(np.sqrt(abs(ratio)) / step)
        self._rest = ratio / step

    def smallest(self) -> float:
        """The smallest of them, an upper bound of the smallest eigenvalue."""
        if not self._diagonal:
            return np.inf
        T = np.diag(self._diagonal)
        off = np.array(self._beside[:-1])
        T[range(1, len(T)), range(len(off))] = off  # the lower triangle counts
        return float(np.linalg.eigvalsh(T)[0])


@dataclass(frozen=True)
class _Begin:
    """Where conjugate gradients begin.

    Attributes:
        force: Right-hand side.
        image: Its product with the preconditioner.
        negative: Motion along which the preconditioner itself is negative, as one made of factors
            can be; None where none was met.
    """

    force: FloatArray
    image: FloatArray
    negative: FloatArray | None = None


def _begin(tangent: _Tangent) -> _Begin:
    """The sum of the right-hand sides, weighted in the preconditioner's norm. Collective."""
    parts, images = tangent.start()
    products = total(tangent.comm, np.array([[a @ b for b in images] for a in parts]))
    sizes = np.sqrt(np.abs(np.diag(products)))
    scale = np.divide(1.0, sizes, out=np.zeros_like(sizes), where=sizes > 0.0)
    values, vectors = np.linalg.eigh(scale[:, None] * (products + products.T) / 2 * scale)
    negative = None
    if values[0] < -ROUND_OFF:
        negative = _combined(vectors[:, 0] * scale, images)
    weights = scale * _WEIGHTS
    return _Begin(_combined(weights, parts), _combined(weights, images), negative)


def _combined(weights: FloatArray, vectors: Sequence[FloatArray]) -> FloatArray:
    return np.asarray(sum(w * v for w, v in zip(weights, vectors, strict=True)))


def start_vector(assembler: Assembler) -> FloatArray:
    """Owned displacements that have a part in every mode, the same on any number of ranks."""
    problem = assembler.problem
    dim = problem.body.dim
    x = problem.unknowns.unknown_places[: len(assembler.displacement_dofs) // dim, :dim]
    waves = np.sin(1.7 * x.sum(axis=1)[:, None] / span(problem.body) + 2.3 * np.arange(dim))
    return np.asarray((1.0 + waves).ravel())


def noise(assembler: Assembler) -> FloatArray:
    """Numbers between -1 and 1 at owned displacements that look random, the same on any ranks.

    They are functions of the places, the last digits of sines.
    """
    problem = assembler.problem
    dim = problem.body.dim
    x = problem.unknowns.unknown_places[: len(assembler.displacement_dofs) // dim, :dim]
    phase = x @ np.array([12.9898, 78.233, 37.719])[:dim] / span(problem.body)
    digits = 43758.5453 * np.sin(phase[:, None] + 1.618 * np.arange(1, dim + 1))
    return np.asarray((2.0 * (digits - np.floor(digits)) - 1.0).ravel())
