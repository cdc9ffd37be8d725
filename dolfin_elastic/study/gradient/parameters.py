"""Parameters of an equilibrium: constants of materials, and any other number of a case.

How a parameter changes the equations and the numbers at fixed unknowns is found by central
differences of fourth order, which take evaluations but no solution: with a step of 1e-4 their
error is round-off, about 1e-11.  What depends on all unknowns is exact, see
`solvers.nonlinear.adjoint`.
Source of the differences: B. Fornberg, Math. Comp. 51 (1988) 699, table 1.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
from dolfinx.fem import Constant

from dolfin_elastic.case.toml import key_parts
from dolfin_elastic.core.errors import InputError, nearest
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import (
    LENGTHS,
    is_quantity,
    number_and_unit,
    stress_unit,
    to_base,
    unit_to_si,
)
from dolfin_elastic.mesh.body import Body, cell_size
from dolfin_elastic.model.amplitude import PROPORTIONAL
from dolfin_elastic.model.materials.spatial import units_of
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler, Reactions, Residual
from dolfin_elastic.solvers.assembly.dofs import ConstrainedDofs
from dolfin_elastic.solvers.nonlinear.newton import Newton, scalar_unknowns
from dolfin_elastic.study.gradient.functionals import Functional
from dolfin_elastic.study.quiet import quietly

if TYPE_CHECKING:
    from dolfin_elastic.case.case import Case

STEP = 1e-4
"""Of the differences, relative to the value, or to its distance from what is impossible."""
WEIGHTS = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}
"""Of the values at so many steps from the present one."""
_TABLES = ("materials", "support", "load", "contact", "tie", "mass", "periodic", "axes")
"""Of a case, of whose numbers a problem is made on the same mesh."""
_OPTION = "--by"


@dataclass(frozen=True)
class Sides:
    """What depends on a parameter at fixed unknowns, or its derivative.

    Attributes:
        forces: Out-of-balance nodal forces, owned entries [N].
        equations: Residuals of scalar unknowns.
        numbers: The functionals.
        pressures: Of contact at owned vertices, one after the other [Pa].
    """

    forces: FloatArray
    equations: FloatArray
    numbers: FloatArray
    pressures: FloatArray = field(default_factory=lambda: np.zeros(0))


def combined(parts: Sequence[tuple[float, Sides]]) -> Sides:
    """A sum with factors, such as a difference."""
    return Sides(
        np.asarray(sum(w * side.forces for w, side in parts)),
        np.asarray(sum(w * side.equations for w, side in parts)),
        np.asarray(sum(w * side.numbers for w, side in parts)),
        np.asarray(sum(w * side.pressures for w, side in parts)),
    )


class Basis(Protocol):
    """What parameters change.  All of it is collective."""

    def evaluated(self) -> Sides:
        """All that depends on parameters, as they are now."""

    def on(self, changed: Problem) -> Sides:
        """The same of another problem on the same mesh."""


class Equilibrium:
    """An equilibrium, and the numbers that are told of it.  All of it is collective.

    Args:
        newton: After the solve.
        numbers_of: Makes them of a problem on the same mesh: growth and thickness are in them, too.
        functionals: What it has made of the problem at its equilibrium.
        t: Load factor, or time [s].

    Attributes:
        pressing: Which owned vertices of each contact press: these stay in contact.
    """

    def __init__(
        self,
        newton: Newton,
        numbers_of: Callable[[Problem], Sequence[Functional]],
        functionals: Sequence[Functional],
        t: float,
    ) -> None:
        self.newton, self.assembler, self.functionals = newton, newton.assembler, functionals
        self.problem, self.t, self._numbers_of = newton.assembler.problem, t, numbers_of
        self.pressing = [pair.pressures() > 0.0 for pair in self.problem.contact_pairs]

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Inside, these and no others are in contact; afterwards all is as before, to the last bit.

        What is evaluated, and the tangent, is smooth beside the equilibrium then.
        """
        pairs = self.problem.contact_pairs
        before = [pair.lam.x.array.copy() for pair in pairs]
        for pair, pressing in zip(pairs, self.pressing, strict=True):
            eps, gaps = pair.eps, pair.pressing_gaps()
            pair.keep(pressing)
            more = (pair.eps - eps) * gaps  # of the penalty that it has now: pressures stay
            pair.lam.x.array[pair.nodes] += np.where(pressing, more, 0.0)
            pair.lam.x.scatter_forward()
        try:
            yield
        finally:
            for pair, lam in zip(pairs, before, strict=True):
                pair.keep(None)
                pair.lam.x.array[:] = lam

    def evaluated(self) -> Sides:
        """All that depends on parameters, as they are now."""
        residual, bordered = self.assembler.residual, self.newton.bordered
        residual.assemble()
        forces = residual.owned.copy()
        equations = np.zeros(0) if bordered is None else bordered.scalars.residual(residual)
        return Sides(forces, equations, self.numbers(forces), pressures_of(self.problem))

    def on(self, changed: Problem) -> Sides:
        """All that depends on parameters, of another problem at the same unknowns and time.

        What it prescribes moves the unknowns.
        """
        bordered = self.newton.bordered
        _take_state(changed, self.problem, self.t)
        for pair, pressing in zip(changed.contact_pairs, self.pressing, strict=True):
            pair.keep(pressing)
        equations: FloatArray = np.zeros(0)
        if bordered is None:
            dofs, residual = residual_of(changed)
            move_prescribed(dofs)
            residual.assemble()
        else:
            assembler = Assembler(changed)
            try:
                scalars = scalar_unknowns(assembler)
                assert scalars is not None
                scalars.put(bordered.scalars.get())
                residual = assembler.residual
                move_prescribed(assembler)
                residual.assemble()
                equations = scalars.residual(residual)
            finally:
                assembler.destroy()
        # Growth, thickness and the macroscopic strain are in the numbers, too.
        numbers = [one.value(residual.owned) for one in self._numbers_of(changed)]
        pressures = pressures_of(changed)
        return Sides(residual.owned.copy(), equations, np.array(numbers), pressures)

    def by_scalars(self) -> FloatArray:
        """Derivatives of the functionals by scalar unknowns, shape (functionals, scalars).

        At fixed fields, those that scalars prescribe, too: what these do the adjoint knows.
        """
        residual, bordered = self.assembler.residual, self.newton.bordered
        if bordered is None:
            return np.zeros((len(self.functionals), 0))
        scalars, x = bordered.scalars, self.assembler.create_vector()
        self.assembler.get(x)
        values, result = scalars.get(), np.zeros((len(self.functionals), scalars.size))
        for j in np.flatnonzero(~scalars.prescribing):
            for k, weight in WEIGHTS.items():
                changed = values.copy()
                changed[j] += k * scalars.steps[j]
                scalars.put(changed)
                self.assembler.put(x)
                residual.assemble()
                result[:, j] += weight / scalars.steps[j] * self.numbers(residual.owned)
        scalars.put(values)
        self.assembler.put(x)
        x.destroy()
        return result

    def numbers(self, forces: FloatArray) -> FloatArray:
        """The functionals at the problem's present unknowns.

        Args:
            forces: Out-of-balance nodal forces, owned entries [N].
        """
        return np.array([one.value(forces) for one in self.functionals])


class Parameter(ABC):
    """A number on which the equilibrium depends.

    Attributes:
        key: Dotted.
        value: In `unit`.
        unit: As the case has it, or that of a bare number there; empty of pure numbers.
        step: Of the differences.
        room: By how much it may be larger, in `unit`.
    """

    room = math.inf

    def __init__(self, key: str, value: float, unit: str, step: float) -> None:
        self.key, self.value, self.unit, self.step = key, value, unit, step

    @abstractmethod
    def evaluated(self, basis: Basis, value: float) -> Sides:
        """What depends on it, at the same unknowns and another value. Collective."""

    def derivative(self, basis: Basis) -> Sides:
        """By the parameter, at fixed unknowns but those that it prescribes. Collective."""
        return combined(
            [
                (weight / self.step, self.evaluated(basis, self.value + k * self.step))
                for k, weight in WEIGHTS.items()
            ]
        )


class MaterialConstant(Parameter):
    """A constant of a material, changed where it is.

    Args:
        constant: Of the forms, in SI units.
        rooms: Distances of its value from smaller and larger ones that are impossible.
        written: Number and unit, see `_written`.
    """

    def __init__(
        self, key: str, constant: Constant, rooms: tuple[float, float], written: tuple[float, str]
    ) -> None:
        value, room = float(constant.value), min(rooms)
        number, unit = written
        self._size = value / number if number else to_base(f"1 {unit}") if unit else 1.0
        super().__init__(key, number, unit, STEP * min(abs(value) or room, room) / self._size)
        self._constant, self.room = constant, rooms[value > 0.0] / self._size

    def evaluated(self, basis: Basis, value: float) -> Sides:
        """See `Parameter`."""
        present = float(self._constant.value)
        self._constant.value = value * self._size
        try:
            return basis.evaluated()
        finally:
            self._constant.value = present


class CaseNumber(Parameter):
    """A number of a case: the problem is made anew with another one, on the same mesh."""

    def __init__(self, key: str, case: Case, body: Body) -> None:
        given = case.value_at(key)
        read = number_and_unit(given)
        if read is None or not is_quantity(str(given)):
            raise InputError(
                f"the case has {given!r} there, which is no number",
                where=_OPTION,
                expected="a key with a number, such as load[0].value[2] or materials.steel.E",
            )
        number, unit = read
        unit = unit or _bare_unit(case, key, number, body)
        size = abs(number) or _size_beside(case, key)
        if key.startswith("support[") and ".displacement" in key and unit:
            size = cell_size(body) / unit_to_si(unit, "m")  # however small the cells are
        super().__init__(key, number, unit, STEP * size)
        self._case, self._body = case, body

    def written(self, value: float) -> object:
        """As the case takes it."""
        return f"{value!r} {self.unit}" if self.unit else value

    def evaluated(self, basis: Basis, value: float) -> Sides:
        """See `Parameter`."""
        changed = self._case.changed({self.key: self.written(value)})
        with quietly():  # what making it says was said before
            problem = changed.make_problem(self._body)
        return basis.on(problem)


def residual_of(problem: Problem) -> tuple[ConstrainedDofs, Residual]:
    """The forces of a problem without what a solution needs beside them. Collective."""
    dofs = ConstrainedDofs(problem)
    forces = Reactions(dofs, None, {}, None)
    return dofs, Residual(dofs, problem.weak_form.residual, None, forces, None)


def move_prescribed(dofs: ConstrainedDofs) -> None:
    """Moves what is prescribed of the problem's unknowns to its values. Collective."""
    w = dofs.problem.w
    w.x.array[: dofs.size] -= dofs.differences()
    dofs.extend(w.x.array)
    w.x.scatter_forward()
    dofs.problem.unknowns.w_to_u()


def _take_state(changed: Problem, here: Problem, t: float) -> None:
    """Puts a problem at the unknowns and the time of another one. Collective."""
    for name, scale in here.unknowns.scale.items():
        changed.unknowns.scale[name].value = scale.value
    changed.terms.begin(moving=False)
    changed.set_time(t, default=PROPORTIONAL)
    changed.w.x.array[:] = here.w.x.array
    changed.unknowns.w_to_u()
    for term, same in zip(changed.terms, here.terms, strict=True):
        for name, function in same.memory.items():
            term.memory[name].x.array[:] = function.x.array
    changed.terms.commit()


def pressures_of(problem: Problem) -> FloatArray:
    """Of all contacts at this rank's vertices, one after the other [Pa]. Collective."""
    return np.concatenate([np.zeros(0), *(pair.pressures() for pair in problem.contact_pairs)])


def _written(case: Case | None, key: str, problem: Problem, value: float) -> tuple[float, str]:
    """Number and unit of a constant: as the case has them, or with its SI unit.

    Args:
        value: Of the constant, in SI units.
    """
    units = {
        f"{region.table}.{name}": unit
        for region in problem.regions
        for name, unit in units_of(type(region.given)).items()
    }
    si = units.get(key, "")
    try:
        read = None if case is None else number_and_unit(case.value_at(key))
    except InputError:  # a default, or another name of the same
        size, unit = stress_unit(abs(value)) if si == "Pa" else (1.0, si)
        return value / size, unit
    number, unit = read or (value, "")
    return number, unit or si


_SI = (
    *("m", "Pa", "N", "N*m", "K", "s", "kg", "m/s", "m/s^2", "1/s", "1/K", "kg/m^3", "m^3"),
    *("N/m", "N/m^3", "N*s/m", "Pa*s", "N*s/m^3"),
)
"""One unit for each kind of number that a case takes."""


def _bare_unit(case: Case, key: str, number: float, body: Body) -> str:
    """Unit of a number that a case has without one; empty: it is pure, or none is known.

    A problem is made of the case with the right unit alone. Collective.
    """
    inner: object = case
    owner, names = Record(), list[str]()
    for part in key_parts(key):
        rows = dict(enumerate(inner)) if isinstance(inner, list | tuple) else {}
        inner = rows.get(int(part)) if part.isdecimal() else getattr(inner, part, None)
        names.append(part)
        if isinstance(inner, Record):
            owner, names = inner, []
    name, *places = names
    if name in owner.lengths:
        return body.unit.name if body.unit.name in LENGTHS else ""
    if name in owner.angles:
        return owner.angles[name]
    if not all(map(str.isdecimal, places)):  # of a field, whose numbers have its own unit
        return ""

    def fits(unit: str, *, whole: bool) -> bool:
        try:
            changed = case.changed({key: f"{number!r} {unit}"})
            if whole:
                changed.make_problem(body)
        except InputError:
            return False
        return True

    with quietly():
        units = [unit for unit in _SI if fits(unit, whole=False)]
        if len(units) > 1:  # stiffnesses per area or length: which, is known on the mesh
            units = [unit for unit in units if fits(unit, whole=True)]
    return units[0] if units else ""


def _size_beside(case: Case, key: str) -> float:
    """Size of a number that is 0: that of the largest in its row, or 1."""
    row = case.value_at(key.rpartition("[")[0]) if key.endswith("]") else None
    read = map(number_and_unit, row if isinstance(row, list | tuple) else ())
    return max((abs(one[0]) for one in read if one is not None), default=0.0) or 1.0


def parameters(keys: Sequence[str], problem: Problem, case: Case | None) -> list[Parameter]:
    """Parameters by their keys. Collective.

    Args:
        keys: Dotted keys of the case; without one those of `Problem.parameters`.

    Raises:
        InputError: There is no such number, or no gradient by it.
    """
    return [_parameter(key, problem, case) for key in keys]


def _parameter(key: str, problem: Problem, case: Case | None) -> Parameter:
    known = problem.parameters
    # The stiffness of a barrier follows from the materials when a problem is made.
    made_anew = case is not None and problem.terms.bars
    if key in known and not known[key].ufl_shape and not made_anew:
        allowed = next(
            region.given.ranges().get(name)
            for region in problem.regions
            for name in region.constants
            if key == f"{region.table}.{name}"
        )
        value = float(known[key].value)
        written = _written(case, key, problem, value)
        rooms = (value - allowed.low, allowed.high - value) if allowed else (np.inf, np.inf)
        if min(rooms) == 0.0 or (value == 0.0 and np.isinf(min(rooms))):
            raise InputError(
                f"'{key}' is 0 or at the end of its range, where no size of a step is known",
                where=_OPTION,
                expected="a value beside it, or `sweep`",
            )
        return MaterialConstant(key, known[key], rooms, written)
    if case is None:
        raise InputError(
            f"there is no parameter '{key}'", where=_OPTION, expected=nearest(key, known)
        )
    if key.partition(".")[0].partition("[")[0] not in _TABLES:
        raise InputError(
            f"'{key}' is no number of a material, support, load or contact",
            where=_OPTION,
            expected="`sweep` for the mesh and for settings; --offset SURFACE for the shape",
        )
    if key.endswith(".friction"):
        raise InputError(
            f"there is no gradient by '{key}': friction depends on all steps before",
            where=_OPTION,
            expected="`sweep`, whose runs take the whole way",
        )
    return CaseNumber(key, case, problem.body)
