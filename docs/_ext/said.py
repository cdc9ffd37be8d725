"""What the program says: the messages of its errors, its warnings, and the reasons of audits.

They are found in its text, which is read and not run.
"""

from __future__ import annotations

import ast
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import product
from pathlib import Path
from typing import TypeAlias

ROOT = Path(__file__).parents[2]
_CODES = {
    "SolveError": "3",
    "ConvergenceError": "3",
    "StabilityError": "3",
    "OutputError": "4",
    "DrawingError": "4",
    "StoppedError": "130",
    "Violation": "0 or 5",
    "warning": "0",
}
"""Exit codes that are not 2; the run goes on beside a violation, which is what an audit finds."""
_KINDS = re.compile(
    r"(Input|Mesh|Unit|Case|Solve|Convergence|Stability|Output|Drawing|Restart|Formula|Stopped)Error"
    "|Violation|UnusedKeys"
)
CLICK = (
    "Missing argument '…'.",
    "Missing option '…'.",
    "No such option: …",
    "Got unexpected extra argument (…)",
    "Got unexpected extra arguments (…)",
    "Option '…' requires an argument.",
    "Option '…' requires … arguments.",
    "Option '…' does not take a value.",
    "Invalid value for '…': …",
)
"""Messages of click, which reads the command line."""
_NOTES = re.compile(r"(\w+_)?notes|notes_of|touching|_?left_out|_gaps|_coarse|place")
"""Functions that return or yield notes of `check`."""
HOLE = "…"
"""Stands for what is known only when the program runs."""

Names = Mapping[str, Sequence[str]]


@dataclass(frozen=True)
class Message:
    """A message of the program.

    Attributes:
        text: Its text, with an ellipsis for what is known only when the program runs.
        advice: What it says to do; may be empty, or an ellipsis.
        code: Exit code.
        part: Folder of the package that it is from.
    """

    text: str
    advice: str
    code: str
    part: str


@dataclass(frozen=True)
class _Function:
    """A function of the program, with the names of its module.

    Attributes:
        folder: Of its module.
        node: It.
        constants: Texts that names of the module, or names in capitals of others, stand for.
        validates: The module imports pydantic, which makes messages of each ValueError.
    """

    folder: Path
    node: ast.FunctionDef
    constants: Names
    validates: bool

    @cached_property
    def nodes(self) -> Sequence[ast.AST]:
        """All that it is made of."""
        return list(ast.walk(self.node))

    @cached_property
    def names(self) -> Names:
        """Texts that names within it stand for."""
        return {**self.constants, **_assigned(self.nodes)}

    def arguments(self) -> list[str]:
        """Names of its arguments, without `self`."""
        every = (*self.node.args.args, *self.node.args.kwonlyargs)
        return [one.arg for one in every if one.arg != "self"]


Made: TypeAlias = "defaultdict[str, list[tuple[_Function, ast.Call]]]"


@cache
def messages() -> list[Message]:
    """Every message of an error, every reason of an audit, and every warning in the log."""
    functions = list(_functions())
    made = _made(functions)
    found: dict[Message, None] = {}
    for function in functions:
        part = (*function.folder.relative_to(ROOT / "dolfin_elastic").parts, "")[0]
        for call in _errors(function):
            for text, advice in _of_call(call, function, made):
                if re.search(r"[a-z]{2}", text):
                    found[Message(text, advice, _CODES.get(_name(call), "2"), part)] = None
        for note in _notes(function):
            for text in _lines(note, function.names):
                if len(re.findall(r"[a-z]{2,}", text)) > 2:
                    found[Message(text, "", "0", part)] = None
    found |= dict.fromkeys(Message(text, "", "2", "cli") for text in CLICK)
    return list(found)


def _functions() -> Iterator[_Function]:
    trees = {
        path: ast.parse(text)
        for path in sorted((ROOT / "dolfin_elastic").rglob("*.py"))
        if re.search(
            r"Error\(|Violation\(|UnusedKeys\(|raise |log.warning|note|touching",
            text := path.read_text(encoding="utf-8"),
        )
    }
    of_modules = {path: _assigned(tree.body) for path, tree in trees.items()}
    shared = {
        name: texts
        for names in of_modules.values()
        for name, texts in names.items()
        if re.fullmatch("[A-Z][A-Z_]+", name)
    }
    for path, tree in trees.items():
        names = {**shared, **of_modules[path]}
        validates = any(
            isinstance(one, ast.ImportFrom) and one.module == "pydantic" for one in tree.body
        )
        bodies = [tree.body] + [one.body for one in tree.body if isinstance(one, ast.ClassDef)]
        for node in (one for body in bodies for one in body):
            if isinstance(node, ast.FunctionDef):
                yield _Function(path.parent, node, names, validates)


def _errors(function: _Function) -> Iterator[ast.Call]:
    """What makes an error in a function, or warns."""
    for one in function.nodes:
        if isinstance(one, ast.Call) and one.args:
            name = one.func.id if isinstance(one.func, ast.Name) else ""
            validates = name == "ValueError" and function.validates
            if _KINDS.fullmatch(name) or validates or _name(one) in ("warning", "UsageError"):
                yield one


def _notes(function: _Function) -> Iterator[ast.expr]:
    """What a function says as notes: yields, returns in a list, or appends to one."""
    returns = ast.unparse(function.node.returns) if function.node.returns else ""
    whole = bool(_NOTES.fullmatch(function.node.name))
    whole |= "check" in function.folder.relative_to(ROOT).parts and returns == "Iterator[str]"
    for one in function.nodes:
        said: list[ast.expr | None] = []
        if isinstance(one, ast.Call) and _name(one) in ("append", "_noted"):
            named = "note" in ast.unparse(one.func)
            said = [*one.args] if whole or named else []
        elif isinstance(one, ast.Assign) and ast.unparse(one.targets[0]) in ("note", "notes"):
            said = _elements(one.value)
        elif whole and isinstance(one, ast.Yield):
            said = [one.value]
        elif whole and isinstance(one, ast.Return) and one.value is not None:
            said = _elements(one.value)
        elif whole and isinstance(one, ast.ListComp):
            said = [one.elt]
        texts = ast.JoinedStr, ast.BinOp, ast.Constant
        yield from (text for text in said if isinstance(text, texts))


def _elements(value: ast.expr) -> list[ast.expr | None]:
    """What a list or tuple holds, with or without a condition; else the value itself."""
    if isinstance(value, ast.IfExp):
        return [*_elements(value.body), *_elements(value.orelse)]
    if isinstance(value, ast.List | ast.Tuple):
        return [*value.elts]
    return [value]


def _made(functions: Iterable[_Function]) -> Made:
    """What is raised or returned, by the last name of what makes it."""
    found: Made = defaultdict(list)
    for function in functions:
        for one in function.nodes:
            call = one.exc if isinstance(one, ast.Raise) else None
            call = one.value if isinstance(one, ast.Return) else call
            if isinstance(call, ast.Call):
                found[_name(call)].append((function, call))
    return found


def _of_call(call: ast.Call, function: _Function, made: Made) -> Iterator[tuple[str, str]]:
    """Text and advice of what makes an error.

    Args:
        call: It.
        function: Where it stands; of one with an argument `what`, the texts are its callers'.
        made: See `_made`.
    """
    names = function.names
    hints = [one.value for one in call.keywords if one.arg in ("expected", "advice")]
    advice = [text for hint in hints for text in _lines(hint, names)]
    given = []
    said = call.args[0]
    if _name(call) == "warning":  # the logger fills in %s and the like
        for text in _lines(said, names):
            yield re.sub(r"%[-.\d]*[a-z]", HOLE, text).replace("%%", "%"), ""
        return
    if _name(call) == "UnusedKeys":  # its first argument are the keys
        said = call.args[1]
        advice = [t for one in call.args[2:] for t in _lines(one, names)] or ["leave it out"]
    if "what" in function.arguments() and _uses(said, "what"):
        given = list(_given(function, made[function.node.name]))
    if given:
        for whats, theirs in given:
            for text in _lines(said, {**names, "what": whats}):
                yield text, _either(theirs if "expected" in function.arguments() else advice)
    else:
        for text in _lines(said, names):
            yield text, _either(advice)


def _given(
    helper: _Function, callers: Iterable[tuple[_Function, ast.Call]]
) -> Iterator[tuple[Sequence[str], Sequence[str]]]:
    """What is handed to a function that makes an error of it, and the advice beside it."""
    arguments = helper.arguments()
    at = arguments.index("what")
    method = helper.node.args.args[0].arg == "self"
    for function, call in callers:
        if not method or function.folder == helper.folder:
            names = function.names
            hints = [k.value for k in call.keywords if k.arg == "expected"]
            if "expected" in arguments:
                hints += call.args[arguments.index("expected") :]
            yield _texts(call.args[at], names), [t for h in hints for t in _lines(h, names)]


def _name(call: ast.Call) -> str:
    """Last name of what is called."""
    return str(getattr(call.func, "attr", getattr(call.func, "id", "")))


def _uses(node: ast.expr, name: str) -> bool:
    return any(isinstance(one, ast.Name) and one.id == name for one in ast.walk(node))


def _either(texts: Iterable[str]) -> str:
    return " or ".join(dict.fromkeys(text for text in texts if text))


def _assigned(inside: Sequence[ast.AST]) -> Names:
    """Texts that names stand for, of those that are given once and as a text."""
    stored = Counter(one.id for one in inside if isinstance(one, ast.Name) and _is_stored(one))
    arguments = {one.arg for one in inside if isinstance(one, ast.arg)}
    found: dict[str, list[str]] = {}
    for one in inside:
        if isinstance(one, ast.Assign) and isinstance(one.targets[0], ast.Name):
            name, texts = one.targets[0].id, _texts(one.value, {})
            if stored[name] <= 1 and name not in arguments and set(texts) != {HOLE}:
                found[name] = texts
    return found


def _is_stored(name: ast.Name) -> bool:
    return isinstance(name.ctx, ast.Store)


def _lines(node: ast.expr, names: Names) -> list[str]:
    """First lines of the texts that an expression may be."""
    lines = [re.sub(f"{HOLE}+", HOLE, text.partition("\n")[0]) for text in _texts(node, names)]
    return list(dict.fromkeys(" ".join(line.split()) for line in lines))


def _texts(node: ast.expr, names: Names) -> list[str]:
    """The texts that an expression may be, each with an ellipsis for what is not known."""
    if isinstance(node, ast.Constant):
        return [node.value if isinstance(node.value, str) else HOLE]
    if isinstance(node, ast.FormattedValue):
        return _texts(node.value, names)
    if isinstance(node, ast.IfExp):
        return [*_texts(node.body, names), *_texts(node.orelse, names)]
    if isinstance(node, ast.Name):
        return list(names.get(node.id, [HOLE]))
    if isinstance(node, ast.Call) and ast.unparse(node.func).endswith(".replace"):
        return _texts(node.func.value, names) if isinstance(node.func, ast.Attribute) else [HOLE]
    parts: list[ast.expr] = []
    if isinstance(node, ast.JoinedStr):
        parts = node.values
    elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        parts = [node.left, node.right]
    texts = [_texts(part, names) for part in parts] or [[HOLE]]
    return ["".join(one) for one in product(*texts)]


def constants() -> Iterator[str]:
    """Every text that stands in the program."""
    for path in (ROOT / "dolfin_elastic").rglob("*.py"):
        for one in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(one, ast.Constant) and isinstance(one.value, str):
                yield one.value
