"""The operations of the formula language: each once for numpy and once for UFL."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce

import numpy as np
import ufl
from ufl.algebra import Abs
from ufl.constantvalue import ScalarValue, Zero
from ufl.core.expr import Expr

from dolfin_elastic.core.types import Scalar


@dataclass(frozen=True)
class Operation:
    """An operation of the formula language.

    Attributes:
        numeric: On numbers and arrays.
        symbolic: The same on UFL expressions.
        fewest: Least number of arguments.
        most: Largest number of arguments.
    """

    numeric: Callable[..., Scalar]
    symbolic: Callable[..., Scalar]
    fewest: int
    most: float


def _op(
    numeric: Callable[..., Scalar],
    symbolic: Callable[..., Scalar],
    fewest: int = 1,
    most: float | None = None,
) -> Operation:
    return Operation(numeric, symbolic, fewest, fewest if most is None else most)


def _fold(function: Callable[[Scalar, Scalar], Scalar]) -> Callable[..., Scalar]:
    return lambda *args: reduce(function, args)


def _choose(condition: Expr | bool, then: Scalar, otherwise: Scalar) -> Scalar:
    if isinstance(condition, bool | np.bool_):
        return then if condition else otherwise
    if isinstance(then, Expr) and isinstance(otherwise, Expr) and then.ufl_shape:
        rows, columns = map(range, then.ufl_shape)
        each = [
            [ufl.conditional(condition, then[i, j], otherwise[i, j]) for j in columns] for i in rows
        ]
        return ufl.as_matrix(each)
    return ufl.conditional(condition, then, otherwise)


def _abs(a: Expr) -> Expr:
    return a if isinstance(a, Abs) else abs(a)  # UFL ties abs(abs(a)) into an endless loop


def _sign(a: Expr) -> Expr:
    return ufl.conditional(ufl.gt(a, 0), 1, ufl.conditional(ufl.lt(a, 0), -1, 0))


def _ramp(a: Expr) -> Expr:
    return ufl.max_value(0, ufl.min_value(1, a))


def _smooth(a: Scalar) -> Scalar:
    return a * a * (3 - 2 * a)


OPERATORS: dict[str, Operation] = {
    "+": _op(np.add, operator.add, 2),
    "-": _op(np.subtract, operator.sub, 2),
    "*": _op(np.multiply, operator.mul, 2),
    "/": _op(np.divide, operator.truediv, 2),
    "^": _op(np.power, operator.pow, 2),
    "+u": _op(np.positive, operator.pos),
    "-u": _op(np.negative, operator.neg),
    "<": _op(np.less, ufl.lt, 2),
    "<=": _op(np.less_equal, ufl.le, 2),
    ">": _op(np.greater, ufl.gt, 2),
    ">=": _op(np.greater_equal, ufl.ge, 2),
}
FUNCTIONS: dict[str, Operation] = {
    "sin": _op(np.sin, ufl.sin),
    "cos": _op(np.cos, ufl.cos),
    "tan": _op(np.tan, ufl.tan),
    "asin": _op(np.arcsin, ufl.asin),
    "acos": _op(np.arccos, ufl.acos),
    "atan": _op(np.arctan, ufl.atan),
    "atan2": _op(np.arctan2, ufl.atan2, 2),
    "sinh": _op(np.sinh, ufl.sinh),
    "cosh": _op(np.cosh, ufl.cosh),
    "tanh": _op(np.tanh, ufl.tanh),
    "exp": _op(np.exp, ufl.exp),
    "ln": _op(np.log, ufl.ln),
    "log": _op(np.log, ufl.ln),
    "log10": _op(np.log10, lambda a: ufl.ln(a) / math.log(10.0)),
    "sqrt": _op(np.sqrt, ufl.sqrt),
    "abs": _op(np.abs, _abs),
    "sign": _op(np.sign, _sign),
    "min": _op(_fold(np.minimum), _fold(ufl.min_value), 2, math.inf),
    "max": _op(_fold(np.maximum), _fold(ufl.max_value), 2, math.inf),
    "heaviside": _op(lambda a: np.heaviside(a, 1.0), lambda a: ufl.conditional(ufl.ge(a, 0), 1, 0)),
    "ramp": _op(lambda a: np.clip(a, 0.0, 1.0), _ramp),
    "smoothstep": _op(lambda a: _smooth(np.clip(a, 0.0, 1.0)), lambda a: _smooth(_ramp(a))),
    "where": _op(np.where, _choose, 3),
}


def _of_ufl(symbolic: Callable[..., Scalar], arguments: int = 1) -> Operation:
    """An operation on tensors, which numpy does not carry out here."""

    def numeric(*_: Scalar) -> Scalar:
        raise TypeError("an operation on tensors, of numbers")

    return _op(numeric, symbolic, arguments)


_TINY = 1e-60


def _norm(A: Expr) -> Expr:
    """sqrt(A : A), whose derivative at A = 0 has a value, 0.

    UFL derives a choice as 1*(one branch) + 0*(the other), so that none may be infinite.
    """
    return ufl.sqrt(ufl.inner(A, A) + _TINY)


OF_TENSORS: dict[str, Operation] = {
    "norm": _of_ufl(_norm),
    "tr": _of_ufl(ufl.tr),
    "det": _of_ufl(ufl.det),
    "inner": _of_ufl(ufl.inner, 2),
    "inv": _of_ufl(ufl.inv),
    "dev": _of_ufl(ufl.dev),
    "sym": _of_ufl(ufl.sym),
    "transpose": _of_ufl(ufl.transpose),
}
"""Functions of tensors of shape (3, 3)."""
GIVE_NUMBERS = frozenset({"norm", "tr", "det", "inner"})
"""Those whose value is a number."""
CONSTANTS = {"pi": math.pi, "e": math.e}
COMPARISONS = frozenset({"<", "<=", ">", ">="})
OPERATIONS = OPERATORS | FUNCTIONS | OF_TENSORS


def numeric(operation: Operation, args: list[Scalar]) -> Scalar:
    """Applies an operation to numbers and arrays.

    Args:
        operation: One of `OPERATIONS`.
        args: Floats or arrays whose shapes broadcast.
    """
    return operation.numeric(*args)


def symbolic(operation: Operation, args: list[Scalar]) -> Scalar:
    """Applies an operation to UFL expressions; without any of them, to numbers.

    Args:
        operation: One of `OPERATIONS`.

    Raises:
        ArithmeticError: A number among the arguments is not finite.
    """
    if any(isinstance(arg, Expr) for arg in args):
        if operation.symbolic is not _choose or isinstance(args[0], Expr):
            args = [arg if isinstance(arg, Expr) else _literal(arg) for arg in args]
        return _folded(operation.symbolic(*args))
    with np.errstate(all="ignore"):
        result = operation.numeric(*args)
    return bool(result) if isinstance(result, np.bool_) else float(result)


def _folded(result: Expr) -> Expr | float:
    # "0*x + 9" is a number again.  As UFL's whole numbers, 9^9^9^9 would be worked out exactly.
    scalar = isinstance(result, ScalarValue | Zero) and not result.ufl_shape
    return float(result) if scalar else result


_SMALL = 1e6


def _literal(value: Scalar) -> float | int:
    # Whole numbers as integers: UFL then sees that x^2 is a polynomial of degree 2.
    if not math.isfinite(value):
        raise ArithmeticError
    return int(value) if float(value).is_integer() and abs(value) < _SMALL else float(value)
