"""The formula language of case files: ``"0.1*x*sin(2*pi*t)"``, for numpy and for UFL.

    numbers      2   0.5   1e-3
    operators    + - * /   ^ or ** (power; -x^2 is -(x^2))   ( )
    names        what the place allows, for example x, y, z, t; and pi, e
    functions    sin cos tan asin acos atan atan2(y, x) sinh cosh tanh exp ln log (= ln) log10
                 sqrt abs sign min max
    steps        heaviside(a)    0 below 0, 1 from 0 on
                 ramp(a)         0 below 0, a between, 1 above 1
                 smoothstep(a)   the same with horizontal tangents, 3a^2 - 2a^3
    choice       where(a < b, then, otherwise)   with < <= > >=
    tensors      where the place has any: A + B, a*A, A/a, A*B (product), I; tr det inv dev sym
                 transpose, inner(A, B), norm(A) = sqrt(inner(A, A))

Nothing is ever handed to `eval`: the text is cut into known tokens, Python's parser orders them,
and only the operations of one table are carried out, in floating point.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import FormulaError, nearest
from dolfin_elastic.core.formula_functions import (
    COMPARISONS,
    CONSTANTS,
    FUNCTIONS,
    GIVE_NUMBERS,
    OF_TENSORS,
    OPERATIONS,
    Operation,
    numeric,
    symbolic,
)
from dolfin_elastic.core.types import FloatArray, Scalar

MAX_LENGTH = 1000
MAX_DEPTH = 100
_SLIP = 0.75
"""Likeness from which on a name before brackets is a function: "coss", but not "mix"."""
_SHALLOW = f"at most {MAX_DEPTH} operations deep"

Tree: TypeAlias = float | str | tuple[str, list[Any]]
"""A number, a name, or an operation with its arguments."""


@dataclass(frozen=True)
class Formula:
    """A parsed formula.

    Attributes:
        text: As it was written.
        names: The free names it uses.
        tensor: Its value is a tensor of shape (3, 3), in UFL only.
    """

    text: str
    names: frozenset[str]
    _tree: Tree = field(repr=False, compare=False)
    tensor: bool = field(default=False, kw_only=True)

    @classmethod
    def parse(
        cls, text: str, *, allowed: Collection[str], tensors: Collection[str] = ()
    ) -> Formula:
        """Reads a formula.

        Args:
            text: At most 1000 characters, see the module.
            allowed: Names that may stand in it; they win over `pi` and `e`.
            tensors: Those of them that stand for tensors of shape (3, 3).

        Returns:
            The formula.

        Raises:
            FormulaError: With the column, a caret under the fault, and what would be right.
        """
        reader = _Reader(text, frozenset(allowed), frozenset(tensors))
        names, tree = reader.read()
        formula = cls(text, names, tree, tensor=reader.is_tensor(tree))
        if not formula.names:
            formula.evaluate()  # a constant shows here and now whether it is finite
        return formula

    def evaluate(self, **values: float | FloatArray) -> Any:
        """The value, in floating point.

        Args:
            **values: One for each of `names`, numbers or arrays that broadcast; more are ignored.

        Returns:
            A float if all values are numbers, else an array of their common shape.  An array may
            hold inf and nan: the ranks see different points, so the caller checks and agrees.

        Raises:
            FormulaError: All values are numbers and the result is not finite.
        """
        arrays = {name: np.asarray(value, dtype=np.float64) for name, value in values.items()}
        with np.errstate(all="ignore"):
            result = _walk(self._tree, arrays, numeric)
        shape = np.broadcast_shapes(*(a.shape for a in arrays.values()))
        if shape:
            return np.array(np.broadcast_to(result, shape), dtype=np.float64)
        return self._finite(float(result), values)

    @cached_property
    def divisors(self) -> tuple[Formula, ...]:
        """What the formula may have poles at the zeros of, with all parts of it that vary.

        These are denominators, bases of powers and, of a tangent, the cosine of its argument.
        """
        result = {repr(p): p for tree in _divisors(self._tree) for p in _parts(tree)}
        return tuple(
            Formula(self.text, names, tree) for tree in result.values() if (names := _names(tree))
        )

    def ufl(self, **values: Expr | float) -> Expr | float:
        """The formula as a UFL expression.

        Args:
            **values: One for each of `names`: scalar UFL expressions or numbers.

        Returns:
            A UFL expression, or a float where no expression is left.

        Raises:
            FormulaError: A constant part is not finite ("x/0").
        """
        try:
            result = _walk(self._tree, values, symbolic)
        except (ArithmeticError, ValueError):  # UFL says ValueError for a division by zero
            raise FormulaError(
                f"a part of '{self.text}' is not finite",
                expected="no division by zero, and no root or logarithm of a negative number",
            ) from None
        return result if isinstance(result, Expr) else self._finite(float(result), values)

    def _finite(self, result: float, values: Mapping[str, Scalar]) -> float:
        if math.isfinite(result):
            return result
        known = [n for n in sorted(self.names) if not isinstance(values[n], Expr)]
        where = ", ".join(f"{name} = {float(values[name]):g}" for name in known)
        raise FormulaError(
            f"'{self.text}' is {_not_finite(result)}" + (f" at {where}" if where else "")
        )


def _not_finite(result: float) -> str:
    return "not a real number" if math.isnan(result) else "infinite"


def _divisors(tree: Tree) -> Iterator[Tree]:
    """Denominators, bases of powers but for those with positive exponents, cosines of tangents."""
    if not isinstance(tree, tuple):
        return
    name, args = tree
    if name == "/":
        yield args[1]
    elif name == "^" and (_names(args[1]) or _negative(args[1])):
        yield args[0]
    elif name == "tan":
        yield ("cos", args)
    for arg in args:
        yield from _divisors(arg)


def _negative(tree: Tree) -> bool:
    """Whether a part without names is a negative number."""
    return bool(np.asarray(_walk(tree, {}, numeric)) < 0)


def _parts(tree: Tree) -> Iterator[Tree]:
    """The tree and all in it that have a value, no comparisons."""
    if not (isinstance(tree, tuple) and tree[0] in COMPARISONS):
        yield tree
    for arg in tree[1] if isinstance(tree, tuple) else ():
        yield from _parts(arg)


def _names(tree: Tree) -> frozenset[str]:
    """Free names in a part of a formula."""
    if isinstance(tree, tuple):
        return frozenset[str]().union(*map(_names, tree[1]))
    return frozenset({tree}) if isinstance(tree, str) else frozenset()


def _walk(
    tree: Tree, values: Mapping[str, Scalar], apply: Callable[[Operation, list[Scalar]], Scalar]
) -> Scalar:
    if isinstance(tree, float):
        return tree
    if isinstance(tree, str):
        return values[tree]
    name, args = tree
    return apply(OPERATIONS[name], [_walk(arg, values, apply) for arg in args])


_TOKEN = re.compile(
    r"""
    (?P<space>  \s+ )
  | (?P<number> (?: \d+\.?\d* | \.\d+ ) (?: [eE][+-]?\d+ )? )
  | (?P<name>   [A-Za-z_][A-Za-z_0-9]* )
  | (?P<op>     \*\* | <= | >= | [-+*/^<>] )
  | (?P<open>   \( ) | (?P<close> \) ) | (?P<comma> , )
""",
    re.VERBOSE | re.ASCII,
)
_HINTS = {
    "[": "the coordinates are x, y, z",
    "=": "comparisons are < <= > >=",
    "%": "write a/100",
    "!": "comparisons are < <= > >=",
    "µ": "write mu",
}


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str
    at: int


class _Reader:
    """Parser of one formula: cuts it into tokens, checks their order, builds the tree."""

    def __init__(self, text: str, allowed: frozenset[str], tensors: frozenset[str]) -> None:
        self.text, self.allowed, self.tensors = text, allowed, tensors
        self.names: set[str] = set()
        self.at: dict[int, int] = {}
        """Column in the source handed to Python's parser to column in the user's text."""

    def read(self) -> tuple[frozenset[str], Tree]:
        if len(self.text) > MAX_LENGTH:
            raise FormulaError(
                f"a formula of {len(self.text)} characters is too long",
                expected=f"at most {MAX_LENGTH}",
            )
        tokens = list(self._tokens())
        self._check_order(tokens)
        root = self._parse(tokens)
        self._check_depth(root)
        tree = self._tree(root)
        if isinstance(tree, tuple) and tree[0] in COMPARISONS:
            raise self._fault("a comparison is no number", root, "use where(a < b, c, d)")
        return frozenset(self.names), tree

    def _fault(self, what: str, at: int | ast.expr, expected: str = "") -> FormulaError:
        """An error with the text and a caret under the fault."""
        column = at if isinstance(at, int) else self.at.get(at.col_offset, 0)
        start = max(0, column - 50)
        shown = "".join(c if c.isprintable() else " " for c in self.text[start : start + 70])
        picture = f"\n    {shown}\n    {' ' * (column - start)}^"
        if expected:
            return FormulaError(what, expected=expected + picture)
        return FormulaError(what + picture)

    def _tokens(self) -> Iterator[_Token]:
        at = 0
        while at < len(self.text):
            match = _TOKEN.match(self.text, at)
            if not match:
                char = self.text[at]
                shown = char if char.isprintable() else f"U+{ord(char):04X}"
                raise self._fault(f"unexpected '{shown}'", at, _HINTS.get(char, ""))
            if match.lastgroup != "space":
                yield _Token(str(match.lastgroup), match[0], at)
            at = match.end()

    def _check_order(self, tokens: list[_Token]) -> None:
        """Refuses missing operands, operators and parentheses, with a caret under the place.

        After this check Python's parser meets nothing it could refuse with a text of its own.
        """
        opened: list[tuple[int, bool]] = []
        value_before = False
        for before, token in zip([None, *tokens], tokens, strict=False):
            call = before is not None and before.kind == "name"
            value_before = self._follow(token, value_before, call, opened)
        if not value_before:
            what = "a value is missing at the end" if tokens else "the formula is empty"
            raise self._fault(what, len(self.text))
        if opened:
            raise self._fault("this parenthesis is never closed", opened[-1][0], "add its )")

    def _follow(
        self, token: _Token, value_before: bool, call: bool, opened: list[tuple[int, bool]]
    ) -> bool:
        """Checks one token against what stands before it.

        Args:
            value_before: An operand is complete before it.
            call: A name stands before it, so that a parenthesis holds arguments.
            opened: Column of each open parenthesis and whether it holds arguments; updated.

        Returns:
            True when an operand is complete after the token.
        """
        if token.kind in ("number", "name") or (token.kind == "open" and not call):
            if value_before:
                raise self._fault("an operator is missing", token.at, "a product is written a*b")
        elif not value_before and not (token.kind == "op" and token.text in "+-"):
            raise self._fault(f"a value is missing before '{token.text}'", token.at)
        if token.kind == "open":
            opened.append((token.at, call))
        elif token.kind == "comma" and not (opened and opened[-1][1]):
            raise self._fault(
                "a comma stands only between the arguments of a function",
                token.at,
                "decimals are written 0.5",
            )
        elif token.kind == "close":
            if not opened:
                raise self._fault("this parenthesis was never opened", token.at)
            opened.pop()
        return token.kind in ("number", "name", "close")

    def _parse(self, tokens: list[_Token]) -> ast.expr:
        source = ""
        for token in tokens:
            self.at[len(source)] = token.at
            source += self._spelled(token) + " "
        try:
            return ast.parse(source, mode="eval").body
        except (SyntaxError, RecursionError, MemoryError):
            raise FormulaError("the formula is nested too deeply", expected=_SHALLOW) from None

    def _spelled(self, token: _Token) -> str:
        if token.kind == "number":
            if not math.isfinite(value := float(token.text)):
                raise self._fault("this number is too large", token.at)
            return repr(value)
        if token.kind == "name":
            return token.text + "_"  # so that no name is a Python keyword
        return "**" if token.text == "^" else token.text

    def _check_depth(self, root: ast.expr) -> None:
        level: list[ast.AST] = [root]
        for _ in range(2 * MAX_DEPTH):
            level = [child for node in level for child in ast.iter_child_nodes(node)]
            if not level:
                return
        raise FormulaError("the formula is nested too deeply", expected=_SHALLOW)

    def _tree(self, node: ast.expr) -> Tree:
        match node:
            case ast.Constant(value=float(number)):
                return number
            case ast.Name(id=name):
                return self._name(name[:-1], node)
            case ast.UnaryOp(op=sign, operand=inner):
                return ("-u" if isinstance(sign, ast.USub) else "+u", [self._value(inner)])
            case ast.BinOp(left=left, op=op, right=right):
                args = [self._value(left), self._value(right)]
                return self._of_shapes(_SYMBOLS[type(op)], args, right)
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                args = [self._value(left), self._value(right)]
                return self._of_shapes(_SYMBOLS[type(op)], args, right)
            case ast.Compare():
                raise self._fault("comparisons cannot be chained", node, "use where() twice")
            case ast.Call(func=ast.Name(id=name), args=args):
                return self._call(name[:-1], node, args)
        raise self._fault("this is no part of a formula", node)

    # --- tensors ---

    def is_tensor(self, tree: Tree) -> bool:
        """Whether the value of a part is a tensor."""
        if not isinstance(tree, tuple):
            return tree in self.tensors
        name, args = tree
        if name in OF_TENSORS:
            return name not in GIVE_NUMBERS
        if name == "*":
            return any(map(self.is_tensor, args))
        if name == "where":
            return self.is_tensor(args[1])
        return name in ("+", "-", "+u", "-u", "/") and self.is_tensor(args[0])

    def _of_shapes(self, name: str, args: list[Tree], node: ast.expr) -> Tree:
        """An operation, after its arguments are of the right shapes.

        Args:
            node: Where a fault is shown.
        """
        if not self.tensors:
            return (name, args)
        are = [self.is_tensor(arg) for arg in args]
        shown = {"^": "a power", "/": "a quotient"}.get(name, f"'{name}'")
        if name in OF_TENSORS and not all(are):
            example = f"{name}({', '.join('CE'[: len(args)])})"
            raise self._fault(f"{name} of a number", node, f"a tensor, as in {example}")
        if name in ("+", "-") and len(set(are)) > 1:
            raise self._fault(
                f"{shown} between a tensor and a number", node, "a*I is a tensor, tr(A) a number"
            )
        if name == "where" and are[1] != are[2]:
            raise self._fault("where() gives a tensor or a number", node, "two tensors, or numbers")
        allowed = {"+": 2, "-": 2, "*": 2, "/": 1, "where": 3}.get(name, 0)
        if name not in OF_TENSORS and any(are[allowed:]):
            hint = {"^": "A*A is a product", "/": "inv(A)"}.get(name, "a number, as tr(A)")
            raise self._fault(f"{shown} with a tensor", node, hint)
        return (name, args)

    def _value(self, node: ast.expr) -> Tree:
        tree = self._tree(node)
        if isinstance(tree, tuple) and tree[0] in COMPARISONS:
            raise self._fault("a comparison is no number", node, "use where(a < b, c, d)")
        return tree

    def _name(self, name: str, node: ast.expr) -> Tree:
        if name in self.allowed:
            self.names.add(name)
            return name
        if name in CONSTANTS:
            return CONSTANTS[name]
        if name in FUNCTIONS or (self.tensors and name in OF_TENSORS):
            raise self._fault(f"'{name}' is a function", node, f"write {name}(...)")
        raise self._fault(
            f"unknown name '{name}'", node, nearest(name, [*self.allowed, *CONSTANTS])
        )

    def _call(self, name: str, node: ast.expr, args: list[ast.expr]) -> Tree:
        functions = FUNCTIONS | OF_TENSORS if self.tensors else FUNCTIONS
        if name not in functions:
            # Texts may allow any name, so that a function with a slip in it looks like a factor.
            slips = get_close_matches(name, functions, n=1, cutoff=_SLIP)
            known = (name in self.allowed or name in CONSTANTS) and not slips
            what = f"'{name}' is not a function" if known else f"unknown function '{name}'"
            hint = f"write {name}*(...)" if known else nearest(name, functions)
            raise self._fault(what, node, hint)
        operation = functions[name]
        if not operation.fewest <= len(args) <= operation.most:
            count = f"{operation.fewest}" + ("" if operation.most < math.inf else " or more")
            raise self._fault(
                f"{name} takes {count} argument{'s' * (operation.fewest > 1)}, {len(args)} given",
                node,
            )
        if name == "where":
            values = [self._condition(args[0]), *map(self._value, args[1:])]
            return self._of_shapes(name, values, args[-1])
        return self._of_shapes(name, [*map(self._value, args)], args[0])

    def _condition(self, node: ast.expr) -> Tree:
        tree = self._tree(node)
        if not (isinstance(tree, tuple) and tree[0] in COMPARISONS):
            raise self._fault("where() starts with a comparison", node, "where(a < b, c, d)")
        return tree


_SYMBOLS: dict[type[ast.AST], str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.Pow: "^",
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
}
