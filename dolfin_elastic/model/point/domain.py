"""Which operation of a law's formula is undefined at given deformation gradients."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import ufl
from ufl.algorithms import expand_derivatives
from ufl.classes import Division, Exp, Expr, Ln, Power, ScalarValue, Sqrt
from ufl.corealg.traversal import unique_post_traversal

from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.model.kinematics import gradient_symbol
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.point.ufl_to_numpy import NumpyProgram


def undefined_operation(law: Law, F: FloatArray) -> str:
    """Describes the first operation that is undefined; empty if there is none.

    Args:
        law: A law with numbers, not with fields.
        F: Deformation gradients at which energy or stress is not finite, shape (n, 3, 3).

    Returns:
        For example "ln of a negative number, -0.2": the innermost such operation, and the operand
        of the largest absolute value.
    """
    at = gradient_symbol()
    formula = law.energy(at) if law.has_energy else law.stress(at)
    for node in unique_post_traversal(expand_derivatives(ufl.as_ufl(formula))):
        if (fault := _fault(node, lambda e: NumpyProgram(e, at)(F))) is not None:
            return fault
    return ""


def _fault(node: Expr, value: Callable[[Expr], FloatArray]) -> str | None:
    """What is wrong with one operation at some of the points."""
    if not isinstance(node, Ln | Sqrt | Power | Division | Exp) or node.ufl_free_indices:
        return None
    operand = node.ufl_operands[1 if isinstance(node, Division) else 0]
    a = value(operand)
    bad, words = _outside(node, a)
    if not bad.any():
        return None
    return words + ("" if isinstance(node, Division) else f", {_farthest(a[bad]):.3g}")


def _outside(node: Expr, a: FloatArray) -> tuple[BoolArray, str]:
    if isinstance(node, Ln):
        return a <= 0.0, "ln of a negative number" if (a < 0.0).any() else "ln of zero"
    if isinstance(node, Sqrt):
        return a < 0.0, "square root of a negative number"
    if isinstance(node, Division):
        return a == 0.0, "division by zero"
    if isinstance(node, Exp):
        return a > np.log(np.finfo(float).max), "exp of too large a number"
    exponent = node.ufl_operands[1]
    broken = isinstance(exponent, ScalarValue) and not float(exponent).is_integer()
    return (a < 0.0) & broken, "broken power of a negative number"


def _farthest(a: FloatArray) -> float:
    return float(a[np.argmax(np.abs(a))])
