"""What a law remembers of its past, and how that follows from a time step.

A law that remembers is, over one step, a function of F and of what was committed at the step's
start: nothing of a trial is stored.  At the end of an accepted step what it remembers is evaluated
once.  Both are UFL; where the values are kept is the affair of `problem.history`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
import ufl
from ufl.core.expr import Expr

from dolfin_elastic.core.types import FloatArray

SIX = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
"""Components of a symmetric tensor, in the order of its six numbers."""
PLACES = ((0, 3, 5), (3, 1, 4), (5, 4, 2))


@dataclass(frozen=True)
class Variable:
    """One quantity that is remembered at each point.

    Attributes:
        shape: A full tensor has nine numbers, a symmetric one six; both are 3x3.
        start: Its value in the body at rest: of a tensor this number times the identity.
        unimodular: Its determinant is 1 and stays so.
    """

    name: str
    shape: Literal["scalar", "symmetric", "tensor"] = "scalar"
    start: float = 0.0
    unimodular: bool = False

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return {"scalar": 1, "symmetric": 6, "tensor": 9}[self.shape]

    @property
    def at_start(self) -> FloatArray:
        """Its numbers in the body at rest."""
        if self.shape == "scalar":
            return np.array([self.start])
        tensor = self.start * np.eye(3)
        return tensor.ravel() if self.shape == "tensor" else np.array([tensor[i] for i in SIX])

    def value(self, numbers: Expr) -> Expr:
        """The quantity, from a UFL vector of its numbers."""
        if self.shape == "scalar":
            return numbers[0]
        rows = PLACES if self.shape == "symmetric" else np.arange(9).reshape(3, 3).tolist()
        return ufl.as_matrix([[numbers[i] for i in row] for row in rows])

    def numbers(self, value: Expr) -> list[Expr]:
        """Its numbers, from the quantity."""
        if self.shape == "scalar":
            return [ufl.as_ufl(value)]
        pairs = SIX if self.shape == "symmetric" else tuple(np.ndindex(3, 3))
        return [value[i, j] for i, j in pairs]

    def square(self, numbers: FloatArray) -> FloatArray:
        """tr(A A) of tensors A from their numbers, shape (n, size): shape (n,)."""
        rows = PLACES if self.shape == "symmetric" else tuple(np.arange(9).reshape(3, 3).tolist())
        A = numbers[:, np.array(rows)]
        return np.einsum("nij,nji->n", A, A)


def in_a_row(variables: Iterable[Variable], values: Mapping[str, Expr]) -> Expr:
    """All numbers of variables, from the quantities by name, as one UFL vector."""
    return ufl.as_vector([x for v in variables for x in v.numbers(values[v.name])])


def unimodular(X: Expr) -> Expr:
    """X/det(X)^(1/3) of a tensor, shape (3, 3)."""
    return X / ufl.det(X) ** (1 / 3)


Values = Mapping[str, FloatArray]
"""Name of a variable to its numbers at nodes, shape (nodes, size)."""


@runtime_checkable
class HasStress(Protocol):
    """What all laws give."""

    def stress(self, F: Expr) -> Expr:
        """First Piola-Kirchhoff stress [Pa]."""


class OverStep(ABC):
    """What a law over a time step gives beside what laws give; F is of shape (3, 3)."""

    @abstractmethod
    def at_end(self, F: Expr) -> dict[str, Expr]:
        """What `Memory.found` names, at the end of the step."""

    def branch_stress(self, F: Expr) -> Expr | None:
        """First Piola-Kirchhoff stress [Pa] whose work is stored or lost.

        Nobody knows which, unless `stored` does.
        """
        return None

    def plastic_strain(self, F: Expr) -> Expr | None:
        """Equivalent plastic strain at the end of the step; None where nothing yields."""
        return None

    def stored(self, F: Expr) -> Expr | None:
        """Stored in branches, per reference volume [J/m^3]; None: not known."""
        return None

    def missed(self) -> Expr | None:
        """By how much the trapezoidal rule missed the work of the last step [J/m^3], if known."""
        return None

    def lost(self, F: Expr) -> Expr | None:
        """Dissipated since the beginning, per reference volume [J/m^3]; None: not known."""
        return None


@dataclass(frozen=True)
class WholeStep:
    """A step from all that is remembered to all that is then, as functions of F.

    Attributes:
        stress: First Piola-Kirchhoff stress [Pa].
        branch_stress: See `OverStep`; None where its work is known otherwise, too.
        at_end: The variables at the end of the step, and what else of `told` is of one step.
    """

    stress: Expr
    branch_stress: Expr | None
    at_end: Mapping[str, Expr]


class Memory(ABC):
    """What a law remembers, and how.

    Attributes:
        variables: What is kept.
        timed: It depends on how long a step takes: no time passes in a preload.
        fades: In a body at rest all of it is forgotten after a long time.
        pointwise: `follow` and `tell` multiply values: what they are given holds at points, not at
            the nodes of functions.
        plane_stress: It can be had with the stretch out of the plane as an unknown.
    """

    variables: tuple[Variable, ...]
    timed: bool = True
    fades: bool = False
    pointwise: bool = False
    plane_stress: bool = True

    @property
    def seen(self) -> tuple[Variable, ...]:
        """What the stress of a step depends on: the variables, or what `fold` makes of them."""
        return self.variables

    @property
    def found(self) -> tuple[Variable, ...]:
        """What is evaluated at the end of a step: the variables, or what `follow` needs."""
        return self.variables

    @property
    def told(self) -> tuple[Variable, ...]:
        """What `stored`, `lost` and `missed` of the law over a step need beside `seen`."""
        return ()

    def tell(self, values: Values, dt: float) -> Values:
        """`told`, see `fold`."""
        return {}

    @abstractmethod
    def over_step(self, past: Mapping[str, Expr], step: Mapping[str, Expr]) -> OverStep:
        """The law over a step.

        Args:
            past: Of `seen` and `told`.
            step: Constants, of the names that `step` gives.
        """

    def step(self, dt: float, *, passes: bool) -> dict[str, float]:
        """Constants of a step of a length [s], by name.

        Args:
            passes: Time passes at all; else the laws are those of a sudden load.
        """
        return {}

    def elastic_step(self) -> dict[str, float]:
        """Constants that differ from those of `step` where nothing is to flow, by name."""
        return {}

    def numbers(self, dt: float) -> FloatArray:
        """What `whole_step` needs to know of a step of a length [s] beside `step`."""
        return np.zeros(1)

    def whole_step(
        self, F: Expr, values: Mapping[str, Expr], step: Mapping[str, Expr], numbers: Expr
    ) -> WholeStep | None:
        """A step in one go: `fold`, `over_step` and `follow`; None: it cannot be written so.

        Args:
            values: Of the variables as the step began.
            step: See `over_step`.
            numbers: Those of `numbers`, a UFL vector.
        """
        follows = type(self).follow is not Memory.follow
        if follows or self.told or not self.seen == self.found == self.variables:
            return None
        law = self.over_step(values, step)
        assert isinstance(law, HasStress)
        branch = None if law.stored(F) is not None else law.branch_stress(F)
        return WholeStep(law.stress(F), branch, law.at_end(F))

    def fold(self, values: Values, dt: float) -> Values:
        """`seen`, from the variables at the start of a step of a length [s]."""
        return values

    def fold_into(self, values: Values, dt: float, out: Values) -> None:
        """Writes what `fold` gives into arrays."""
        for name, numbers in self.fold(values, dt).items():
            out[name][...] = numbers

    def follow(self, values: Values, found: Values, dt: float) -> Values:
        """The variables at the end of a step of a length [s].

        Args:
            values: The variables as the step began, at the nodes; they may be overwritten and
                returned.
            found: Of `found`, at its end; the result may contain these arrays.
        """
        return found


@dataclass(frozen=True)
class Root:
    """Unknowns z of a step at a point, of which equations r(F, z) = 0 hold.

    Before a form is evaluated z and K, the inverse of dr/dz there, are found.  Stresses are written
    with z - K r(F, z): its value is z, and its derivative by F is that of the root, -K dr/dF, by
    the implicit function theorem.  So UFL derives the consistent tangent from it, as it does of
    laws in closed form.

    Attributes:
        variables: Which z has, in the order of its numbers.
        found: The numbers of z, of shape (n,).
        inverse: Those of K, row by row, of shape (n*n,).
    """

    variables: tuple[Variable, ...]
    found: Expr
    inverse: Expr

    @property
    def size(self) -> int:
        """How many numbers z has."""
        return sum(v.size for v in self.variables)

    def values(self, numbers: Expr) -> dict[str, Expr]:
        """The quantities, from a UFL vector of their numbers."""
        result, at = dict[str, Expr](), 0
        for v in self.variables:
            result[v.name] = v.value(ufl.as_vector([numbers[at + i] for i in range(v.size)]))
            at += v.size
        return result

    def residual(self, equations: Equations, numbers: Expr) -> Expr:
        """r, a UFL vector, of the numbers of z."""
        return in_a_row(self.variables, equations(self.values(numbers)))

    def to_solve(self, equations: Equations) -> Expr:
        """r and dr/dz, row by row, at `found`, as one UFL vector."""
        z = ufl.variable(self.found)
        r, n = self.residual(equations, z), range(self.size)
        J = ufl.diff(r, z)
        return ufl.as_vector([r[i] for i in n] + [J[i, j] for i in n for j in n])

    def numbers(self, equations: Equations) -> Expr:
        """z - K r, a UFL vector."""
        r, n = self.residual(equations, self.found), range(self.size)
        step = [sum(self.inverse[self.size * i + j] * r[j] for j in n) for i in n]
        return ufl.as_vector([self.found[i] - step[i] for i in n])


Equations = Callable[[Mapping[str, Expr]], Mapping[str, Expr]]
"""What is zero, of the shapes of the unknowns, by the names of these."""


class ImplicitMemory(Memory):
    """A memory of which equations at each point say how it follows from a step.

    Attributes:
        unknowns: Of the equations; their values in `variables` of the same names are those from
            which an iteration begins.
    """

    unknowns: tuple[Variable, ...]

    def whole_step(
        self, F: Expr, values: Mapping[str, Expr], step: Mapping[str, Expr], numbers: Expr
    ) -> None:
        """See `Memory`: none, its unknowns are no functions of F."""

    def over_step(self, past: Mapping[str, Expr], step: Mapping[str, Expr]) -> ImplicitStep:
        """See `Memory`: a step in which the unknowns stay as they are, as in a sudden one."""
        size = sum(v.size for v in self.unknowns)
        found = in_a_row(self.unknowns, past)
        return self.with_root(past, step, Root(self.unknowns, found, ufl.zero(size * size)))

    @abstractmethod
    def with_root(
        self, past: Mapping[str, Expr], step: Mapping[str, Expr], root: Root
    ) -> ImplicitStep:
        """The law over a step, see `over_step`, with its unknowns."""


class ImplicitStep(OverStep):
    """What a law over a step gives whose unknowns equations determine, and whose energy is stored.

    Its `at_end` is that of `with_dissipation`.
    """

    root: Root

    def branch_stress(self, F: Expr) -> Expr | None:
        """See `OverStep`: none, the energy is what is stored."""
        return None

    def lost(self, F: Expr) -> Expr | None:
        """See `OverStep`."""
        return self.at_end(F)[LOST.name]

    @abstractmethod
    def equations(self, F: Expr) -> Equations:
        """See `Root`."""


# --- what a law with a stored energy dissipates ---

LOST = Variable("dissipated_density")
"""Dissipated since the beginning, per reference volume [J/m^3]."""


def _force(variable: Variable) -> Variable:
    """Of -dpsi/dx, the thermodynamic force of a variable x; of a tensor by its six numbers."""
    return Variable(f"force_on_{variable.name}", variable.shape)


def of_dissipation(unknowns: Iterable[Variable]) -> tuple[Variable, ...]:
    """What `with_dissipation` needs to remember."""
    return (LOST, *map(_force, unknowns))


def with_dissipation(
    root: Root,
    now: Mapping[str, Expr],
    past: Mapping[str, Expr],
    energy: Callable[[Mapping[str, Expr]], Expr],
) -> dict[str, Expr]:
    """Unknowns x at the end of a step, with what has been dissipated.

    That is the integral of the forces -dpsi/dx over x by the trapezoidal rule, exact where psi is
    quadratic; in the first step, and where it is below zero because the forces have changed their
    sign, that of the forces at the end.

    Args:
        now: x at the end, by name.
        past: At the start, with `of_dissipation`.
        energy: Stored energy psi of x at the present F [J/m^3].
    """
    variables = root.variables
    numbers = ufl.variable(in_a_row(variables, now))
    forces = -ufl.diff(energy(root.values(numbers)), numbers)
    before = in_a_row(map(_force, variables), past)
    change = in_a_row(variables, now) - in_a_row(variables, past)
    of_end = ufl.dot(forces, change)
    mean = (of_end + ufl.dot(before, change)) / 2
    begun = ufl.And(ufl.gt(ufl.dot(before, before), 0.0), ufl.gt(mean, 0.0))
    lost = past[LOST.name] + ufl.conditional(begun, mean, of_end)
    named = {_force(Variable(name)).name: x for name, x in root.values(forces).items()}
    return {**now, LOST.name: lost, **named}
