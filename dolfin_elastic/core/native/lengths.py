"""Lengths of arrays that prototypes name, as functions of the arguments of a call."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

from dolfin_elastic.core.types import AnyArray

Arguments: TypeAlias = Sequence[int | AnyArray]
Length: TypeAlias = Callable[[Arguments], int]

_OPERATORS: dict[type[ast.operator], Callable[[int, int], int]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.floordiv,  # of integers, none of which is negative
}


def length_of(expression: str, names: Sequence[str], macros: Mapping[str, int]) -> Length:
    """What an expression in C gives for the arguments of a call.

    Args:
        expression: Of integers, their names, entries of arrays, + - * / and brackets.

    Raises:
        ValueError: There is something else in it.
    """
    return _compiled(ast.parse(" ".join(expression.split()), mode="eval").body, names, macros)


def _compiled(node: ast.expr, names: Sequence[str], macros: Mapping[str, int]) -> Length:
    match node:
        case ast.Constant(value=int(value)):
            return lambda _: value
        case ast.Name(id=name) if name in names:
            return operator.itemgetter(names.index(name))
        case ast.Name(id=name) if name in macros:
            number = macros[name]
            return lambda _: number
        case ast.Subscript(value=ast.Name(id=name), slice=index) if name in names:
            return _entry(names.index(name), _compiled(index, names, macros))
        case ast.BinOp(left=left, op=sign, right=right) if type(sign) in _OPERATORS:
            apply = _OPERATORS[type(sign)]
            one, two = _compiled(left, names, macros), _compiled(right, names, macros)
            if not any(_depends(side, names) for side in (left, right)):
                known = apply(one(()), two(()))
                return lambda _: known
            return lambda arguments: apply(one(arguments), two(arguments))
    raise ValueError(f"{ast.unparse(node)} is no length")


def _entry(array: int, index: Length) -> Length:
    """An entry of an argument, as int."""
    return lambda arguments: int(arguments[array][index(arguments)])  # type: ignore[index]


def _depends(node: ast.expr, names: Sequence[str]) -> bool:
    return any(isinstance(one, ast.Name) and one.id in names for one in ast.walk(node))
