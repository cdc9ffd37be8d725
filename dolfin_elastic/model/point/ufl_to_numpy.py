"""UFL expressions of F evaluated by numpy, for many F at once and without a compiler.

An expression becomes a list of steps, common subexpressions once only.  Each step works on arrays
whose axes are the free indices in ascending order, then the shape, then the points.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import ufl
from ufl.algorithms import expand_derivatives
from ufl.classes import (
    Abs,
    ComponentTensor,
    Condition,
    Conditional,
    Conj,
    Expr,
    FixedIndex,
    Identity,
    Indexed,
    IndexSum,
    Label,
    ListTensor,
    MathFunction,
    MultiIndex,
    NotCondition,
    Real,
    ScalarValue,
    Variable,
    Zero,
)
from ufl.corealg.traversal import unique_post_traversal

from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.model.kinematics import gradient_symbol, variables
from dolfin_elastic.model.materials.law import Law

Step = Callable[[list[AnyArray]], AnyArray]
_NO_VALUE = (MultiIndex, Label)

_FUNCTIONS: dict[str, Callable[..., AnyArray]] = {
    "ln": np.log,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "erf": np.vectorize(math.erf),
}
_BINARY: dict[str, Callable[..., AnyArray]] = {
    "Sum": np.add,
    "Product": np.multiply,
    "Division": np.divide,
    "Power": np.power,
    "MinValue": np.minimum,
    "MaxValue": np.maximum,
    "Atan2": np.arctan2,
    "LT": np.less,
    "LE": np.less_equal,
    "GT": np.greater,
    "GE": np.greater_equal,
    "EQ": np.equal,
    "NE": np.not_equal,
    "AndCondition": np.logical_and,
    "OrCondition": np.logical_or,
}


def _rank(e: Expr) -> tuple[tuple[int, ...], int]:
    """Free indices and number of further axes."""
    if isinstance(e, Condition | MultiIndex):
        return (), 0
    return tuple(e.ufl_free_indices), len(e.ufl_shape)


def _aligned(e: Expr, free: Sequence[int], rank: int) -> Callable[[AnyArray], AnyArray]:
    """Function that broadcasts an operand's array to the axes of the result.

    Args:
        free: Free indices of the result, ascending.
        rank: Number of axes of the result's shape.
    """
    own, own_rank = _rank(e)
    index: list[slice | None] = [slice(None) if i in own else None for i in free]
    index += [None] * (rank - own_rank)
    return lambda a: a[(*index, ...)]


def _elementwise(e: Expr, function: Callable[..., AnyArray]) -> Step:
    free, rank = _rank(e)
    if all(_rank(o) == (free, rank) for o in e.ufl_operands):
        return lambda args: function(*args)
    parts = [_aligned(o, free, rank) for o in e.ufl_operands]
    return lambda args: function(*(part(a) for part, a in zip(parts, args, strict=True)))


def _indexed(e: Indexed) -> Step:
    tensor, multi = e.ufl_operands
    own, _ = _rank(tensor)
    labels = list(own)
    pick: list[slice | int] = [slice(None)] * len(own)
    for index in multi.indices():
        fixed = isinstance(index, FixedIndex)
        pick.append(int(index) if fixed else slice(None))
        if not fixed:
            labels.append(index.count())
    small = {label: n for n, label in enumerate(dict.fromkeys(labels))}
    source = [small[label] for label in labels]
    target = [small[label] for label in _rank(e)[0]]
    taken = tuple(pick)
    if source == target:
        return lambda args: args[0][taken]
    return lambda args: np.einsum(args[0][taken], [*source, Ellipsis], [*target, Ellipsis])


def _component_tensor(e: ComponentTensor) -> Step:
    inner, multi = e.ufl_operands
    own, free = _rank(inner)[0], _rank(e)[0]
    order = [own.index(i) for i in (*free, *(index.count() for index in multi.indices()))]
    return lambda args: args[0].transpose(*order, len(order))


def _list_tensor(e: ListTensor) -> Step:
    free, rank = _rank(e)
    parts = [_aligned(o, free, rank - 1) for o in e.ufl_operands]

    def stack(args: list[AnyArray]) -> AnyArray:
        rows = np.broadcast_arrays(*(part(a) for part, a in zip(parts, args, strict=True)))
        return np.stack(rows, axis=len(free))

    return stack


def _index_sum(e: IndexSum) -> Step:
    inner, multi = e.ufl_operands
    axis, count = _rank(inner)[0].index(multi[0].count()), e.dimension()

    def add(args: list[AnyArray]) -> AnyArray:
        a = args[0]
        return a.sum(axis=axis) if a.shape[axis] == count else count * a.squeeze(axis)

    return add


def _constant(value: float | FloatArray) -> Step:
    array = np.asarray(value, dtype=np.float64)[..., None]
    return lambda args: array


def _passed(e: Expr) -> Step:
    return lambda args: args[0]


def _function(e: MathFunction) -> Step:
    return _elementwise(e, _FUNCTIONS.get(e._name) or getattr(np, e._name))


_MAKERS: dict[type[Expr], Callable[[Any], Step]] = {
    Zero: lambda e: _constant(np.zeros((*e.ufl_index_dimensions, *e.ufl_shape))),
    ScalarValue: lambda e: _constant(float(e)),
    Identity: lambda e: _constant(np.eye(e.ufl_shape[0])),
    Variable: _passed,
    Conj: _passed,  # all numbers are real
    Real: _passed,
    Indexed: _indexed,
    ComponentTensor: _component_tensor,
    ListTensor: _list_tensor,
    IndexSum: _index_sum,
    Conditional: lambda e: _elementwise(e, np.where),
    MathFunction: _function,
    Abs: lambda e: _elementwise(e, np.abs),
    NotCondition: lambda e: _elementwise(e, np.logical_not),
}


def _step(e: Expr) -> Step:
    """The numpy operation of one node of an expression."""
    name = type(e).__name__
    if name in _BINARY:
        return _elementwise(e, _BINARY[name])
    for kind, make in _MAKERS.items():
        if isinstance(e, kind):
            return make(e)
    raise NotImplementedError(f"a material's energy cannot have a UFL {name} at a point")


class NumpyProgram:
    """A UFL expression of symbols as a function of numpy arrays.

    Args:
        expression: Without derivatives, as `expand_derivatives` returns it.
        symbols: The UFL constants to be replaced by numbers, F of shape (3, 3) the first.
    """

    def __init__(self, expression: Expr, *symbols: Expr) -> None:
        self.shape = expression.ufl_shape
        nodes = [e for e in unique_post_traversal(expression) if not isinstance(e, _NO_VALUE)]
        offset = {e: n for n, e in enumerate(nodes)}
        place = {symbol: n for n, symbol in enumerate(symbols)}
        self._steps = [
            (
                place[e] if e in place else _step(e),
                [offset[o] for o in e.ufl_operands if not isinstance(o, _NO_VALUE)],
            )
            for e in nodes
        ]

    def __call__(self, F: AnyArray, *others: AnyArray) -> AnyArray:
        """Values at F of shape (n, 3, 3): shape (n, *shape of the expression).

        Args:
            others: Of the other symbols, shape (n, *shape of the symbol).
        """
        at = [np.moveaxis(np.asarray(a, dtype=np.float64), 0, -1) for a in (F, *others)]
        done: list[AnyArray] = []
        with np.errstate(all="ignore"):
            for step, slots in self._steps:
                done.append(at[step] if isinstance(step, int) else step([done[s] for s in slots]))
        full = np.broadcast_to(done[-1], (*self.shape, at[0].shape[-1]))
        return np.array(np.moveaxis(full, -1, 0))


class LawAtPoints:
    """A law at points: energy, first Piola-Kirchhoff stress and tangent for given F.

    Args:
        law: Any law.
    """

    def __init__(self, law: Law) -> None:
        self.law, self._F = law, gradient_symbol()

    def _program(self, expression: Expr) -> NumpyProgram:
        return NumpyProgram(expand_derivatives(expression), self._F)

    @cached_property
    def energy(self) -> NumpyProgram:
        """psi [J/m^3], of shape (n,)."""
        return self._program(ufl.as_ufl(self.law.energy(self._F)))

    @cached_property
    def stress(self) -> NumpyProgram:
        """P [Pa], of shape (n, 3, 3)."""
        return self._program(self.law.stress(self._F))

    @cached_property
    def tangent(self) -> NumpyProgram:
        """dP/dF [Pa], of shape (n, 3, 3, 3, 3)."""
        H, F = variables(self._F)
        return self._program(ufl.diff(self.law.stress(F), H))
