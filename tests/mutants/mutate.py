"""Mutants of the package: one operator, comparison, connective or number of it changed.

A mutant is known by its module, the text of its statement and the change, so that edits elsewhere
leave it, and its verdict, as they are.
"""

from __future__ import annotations

import ast
import hashlib
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

OPERATORS: dict[type[ast.operator], tuple[str, str]] = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.Pow: ("**", "*"),
}
COMPARISONS: dict[type[ast.cmpop], tuple[str, tuple[str, ...]]] = {
    ast.Lt: ("<", ("<=", ">=")),
    ast.LtE: ("<=", ("<", ">")),
    ast.Gt: (">", (">=", "<=")),
    ast.GtE: (">=", (">", "<")),
    ast.Eq: ("==", ("!=",)),
    ast.NotEq: ("!=", ("==",)),
    ast.Is: ("is", ("is not",)),
    ast.IsNot: (r"is\s+not", ("is",)),
    ast.In: ("in", ("not in",)),
    ast.NotIn: (r"not\s+in", ("in",)),
}
MESSAGES = {"log", "logger", "logging", "warnings"}
"""Names whose methods write texts."""
SMALL = 1e-2
"""A number below it is a tolerance: only a large change of it is a fault."""


@dataclass(frozen=True)
class Mutant:
    """A change of the bytes begin to end of a module.

    Attributes:
        module: The file, relative to the repository.
        kind: "operator", "comparison", "connective" or "number".
        line: Its line, from 1.
        column: Its column, from 1.
        lines: The lines of the statement around it (of a compound one, its head).
        begin: First byte that changes.
        end: The byte after the last one.
        old: What stands there.
        new: What comes there.
        key: What it is known by.
        inside: Whether it lies in a function; else it is executed when the module is imported.
    """

    module: str
    kind: str
    line: int
    column: int
    lines: range
    begin: int
    end: int
    old: str
    new: str
    key: str
    inside: bool

    def __str__(self) -> str:
        """Place and change."""
        return f"{self.module}:{self.line}:{self.column} `{self.old}` -> `{self.new}`"

    def applied(self, source: bytes) -> bytes:
        """The module with the change."""
        assert source[self.begin : self.end].decode() == self.old
        return source[: self.begin] + self.new.encode() + source[self.end :]


@dataclass(frozen=True)
class _Site:
    """A place that can change: bytes begin to end become one of `news`."""

    kind: str
    begin: int
    end: int
    news: tuple[str, ...]
    statement: ast.stmt
    inside: bool


class _Finder(ast.NodeVisitor):
    """The places of a module that can change; those of annotations and messages are left out."""

    def __init__(self, source: bytes) -> None:
        self.source, self.sites = source, list[_Site]()
        self.starts = [0]
        for row in source.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(row))
        self.statement: ast.stmt = ast.Pass()
        self.functions = 0

    def at(self, line: int | None, column: int | None) -> int:
        """The byte of a place, both as `ast` counts them."""
        assert line is not None
        assert column is not None
        return self.starts[line - 1] + column

    def add(self, kind: str, begin: int, end: int, *news: str) -> None:
        """Notes a place."""
        inside = self.functions > 0
        self.sites.append(_Site(kind, begin, end, news, self.statement, inside))

    def between(self, left: ast.expr, right: ast.expr, pattern: str) -> tuple[int, int]:
        """The operator that stands between two operands, past parentheses and comments."""
        begin = self.at(left.end_lineno, left.end_col_offset)
        text = self.source[begin : self.at(right.lineno, right.col_offset)]
        text = re.sub(rb"#[^\n]*", lambda comment: b" " * len(comment[0]), text)
        found = re.search(pattern.encode(), text)
        assert found, (text, pattern)
        return begin + found.start(), begin + found.end()

    def visit(self, node: ast.AST) -> None:
        """Keeps the innermost statement in mind."""
        if not isinstance(node, ast.stmt):
            super().visit(node)
            return
        before, self.statement = self.statement, node
        super().visit(node)
        self.statement = before

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        """Its defaults are executed at import, its body when it is called."""
        for default in (*node.args.defaults, *node.args.kw_defaults):
            if default is not None:
                self.visit(default)
        self.functions += 1
        for statement in node.body:
            self.visit(statement)
        self.functions -= 1

    def visit_Lambda(self, node: ast.Lambda) -> None:
        """As a function."""
        self.functions += 1
        self.visit(node.body)
        self.functions -= 1

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        """Without its annotation."""
        if node.value is not None:
            self.visit(node.value)

    def visit_Raise(self, node: ast.Raise) -> None:
        """A message."""

    def visit_Assert(self, node: ast.Assert) -> None:
        """For the reader and the checker of types."""

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """A text."""

    def visit_Call(self, node: ast.Call) -> None:
        """But for those that write texts."""
        function = node.func
        of = function.value if isinstance(function, ast.Attribute) else None
        if not (isinstance(of, ast.Name) and of.id.strip("_").lower() in MESSAGES):
            self.generic_visit(node)

    def visit_If(self, node: ast.If) -> None:
        """But for imports of types."""
        if not (isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"):
            self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        """Operators between numbers; sums of texts and lists are none."""
        if type(node.op) in OPERATORS and not (_is_text(node.left) or _is_text(node.right)):
            old, new = OPERATORS[type(node.op)]
            self.add("operator", *self.between(node.left, node.right, re.escape(old)), new)
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        """`+=` and its kind."""
        if type(node.op) in OPERATORS and not _is_text(node.value):
            old, new = OPERATORS[type(node.op)]
            begin, end = self.between(node.target, node.value, re.escape(f"{old}="))
            self.add("operator", begin, end, f"{new}=")
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        """Comparisons: of numbers with the other limit, and turned round."""
        operands = (node.left, *node.comparators)
        for left, op, right in zip(operands, node.ops, operands[1:], strict=False):
            pattern, news = COMPARISONS[type(op)]
            self.add("comparison", *self.between(left, right, pattern), *news)
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        """Each `and` and `or`."""
        old, new = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        for left, right in zip(node.values, node.values[1:], strict=False):
            self.add("connective", *self.between(left, right, rf"\b{old}\b"), new)
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        """`not`, and numbers below zero."""
        operand = node.operand
        if isinstance(node.op, ast.USub) and isinstance(operand, ast.Constant):
            self.number(node, -operand.value)
            return
        if isinstance(node.op, ast.Not):
            begin = self.at(node.lineno, node.col_offset)
            self.add("connective", begin, begin + len("not"), "")
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        """Numbers."""
        self.number(node, node.value)

    def number(self, node: ast.expr, value: object) -> None:
        """One more than a whole number, twice a number, a thousand times a tolerance.

        Args:
            node: The number, with its sign.
            value: What it is, perhaps no number.
        """
        if isinstance(value, bool) or not isinstance(value, int | float):
            return
        new = value + 1 if isinstance(value, int) or value == 0 else 2 * value
        if isinstance(value, float) and 0 < abs(value) < SMALL:
            new = float(f"{1000 * value:.12g}")
        begin = self.at(node.lineno, node.col_offset)
        self.add("number", begin, self.at(node.end_lineno, node.end_col_offset), repr(new))


def _is_text(node: ast.expr) -> bool:
    """Whether an operand is a text or a list as it stands."""
    if isinstance(node, ast.BinOp):
        return _is_text(node.left) or _is_text(node.right)
    text = isinstance(node, ast.Constant) and isinstance(node.value, str)
    return text or isinstance(node, ast.JoinedStr | ast.List | ast.Tuple | ast.ListComp)


def _head(statement: ast.stmt) -> range:
    """Lines of a statement, of a compound one those before its body."""
    body = getattr(statement, "body", None)
    last = statement.end_lineno or statement.lineno
    if isinstance(body, list) and body:
        last = max(statement.lineno, body[0].lineno - 1)
    return range(statement.lineno, last + 1)


def _fingerprint(*parts: object) -> str:
    return hashlib.sha256("\n".join(map(str, parts)).encode()).hexdigest()[:10]


def mutants_of(path: Path, root: Path) -> list[Mutant]:
    """All mutants of a module.

    Args:
        path: The module.
        root: The repository.
    """
    source, module = path.read_bytes(), path.relative_to(root).as_posix()
    finder = _Finder(source)
    finder.visit(ast.parse(source))
    rows, found = source.splitlines(), []
    seen: Counter[str] = Counter()
    for site in finder.sites:
        lines = _head(site.statement)
        text = b" ".join(b" ".join(rows[n - 1].split()) for n in lines).decode()
        old = source[site.begin : site.end].decode()
        line = source.count(b"\n", 0, site.begin) + 1
        column = site.begin - finder.starts[line - 1] + 1
        for new in site.news:
            words = _fingerprint(module, text, old, new)
            key = _fingerprint(words, seen[words])
            seen[words] += 1
            place = (module, site.kind, line, column, lines, site.begin, site.end)
            found.append(Mutant(*place, old, new, key, site.inside))
    return found


def chosen(root: Path, count: int, seed: int) -> list[Mutant]:
    """A sample over the package: each module's share is that of its lines.  Any part of it is one.

    The files are laid end to end, and every n-th line takes a mutant of its file: the kinds in
    turn, of a kind that whose hash with the seed comes first.

    Args:
        root: The repository.
        count: How many.
        seed: Of the sample.
    """
    files = sorted((root / "dolfin_elastic").rglob("*.py"))
    lengths = [len(path.read_bytes().splitlines()) for path in files]
    step, taken = sum(lengths) / count, list[Mutant]()
    position, next_one, left = 0, step / 2, 0
    for path, length in zip(files, lengths, strict=True):
        position += length
        while next_one < position:
            next_one, left = next_one + step, left + 1
        if left:
            some = _in_turn(mutants_of(path, root), seed)[:left]
            left -= len(some)
            taken += some
    return sorted(taken, key=lambda one: _fingerprint(seed, one.key))


def _in_turn(mutants: list[Mutant], seed: int) -> list[Mutant]:
    kinds: dict[str, list[Mutant]] = defaultdict(list)
    places = set()
    for one in sorted(mutants, key=lambda one: _fingerprint(seed, one.key)):
        if (one.line, one.column) not in places:
            places.add((one.line, one.column))
            kinds[one.kind].append(one)
    return [one for row in _rows(list(kinds.values())) for one in row]


def _rows(columns: list[list[Mutant]]) -> Iterator[list[Mutant]]:
    for n in range(max(map(len, columns), default=0)):
        yield [column[n] for column in columns if n < len(column)]
