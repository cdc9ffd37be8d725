"""Lines of each capability, and what has grown large; `.ci/lint` prints them.

    docker/run python3 tests/suite/capabilities.py

A module on no row of capabilities.toml fails.  Large modules, folders, classes and functions are
named: they are smells, of which a reader decides; tests/test_layout.py fails far beyond only.
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
import tomllib
from collections import Counter, defaultdict
from pathlib import Path

HERE = Path(__file__).resolve().parent
PACKAGE = HERE.parent.parent / "dolfin_elastic"
OWN = [path for kind in ("py", "c", "h", "js") for path in PACKAGE.rglob(f"*.{kind}")]
OWN = sorted(path for path in OWN if not path.name.endswith(".min.js"))

SMELLS = {"module": 500, "folder": 12, "class": 20, "function": 40}
"""Lines of a module, modules of a folder, methods of a class, lines of a function's body."""
WALLS = {"module": 650, "folder": 16, "class": 25, "function": 60}

LAWS = PACKAGE / "model" / "materials" / "laws"
"""One file a law: no large folder."""


def rows() -> dict[Path, str]:
    """Capability of each module that has one."""
    table = tomllib.loads((HERE / "capabilities.toml").read_text(encoding="utf-8"))
    places = {PACKAGE / place: name for name, at in table["capabilities"].items() for place in at}
    missing = [str(place) for place in places if not place.exists()]
    if missing:
        raise SystemExit(f"capabilities.toml: there is no {', '.join(missing)}")
    return {
        path: places[found[0]]
        for path in OWN
        if (found := [at for at in (path, *path.parents) if at in places])
    }


def explanation(path: Path) -> int:
    """Lines of docstrings and comments of a module."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return sum(line.lstrip().startswith(("//", "/*", "*")) for line in text.splitlines())
    lines: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            lines |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT and token.line.lstrip().startswith("#"):
            lines.add(token.start[0])
    return len(lines)


def sizes() -> dict[str, dict[str, int]]:
    """Size of each module, folder, class and function, by kind and name."""
    found: dict[str, dict[str, int]] = defaultdict(dict)
    folders = Counter(path.parent for path in OWN if path.name != "__init__.py")
    for folder, count in folders.items():
        if folder != LAWS:
            found["folder"][str(folder.relative_to(PACKAGE))] = count
    for path in OWN:
        name, text = str(path.relative_to(PACKAGE)), path.read_text(encoding="utf-8")
        found["module"][name] = len(text.splitlines())
        for node in ast.walk(ast.parse(text)) if path.suffix == ".py" else ():
            if isinstance(node, ast.ClassDef):
                methods = sum(isinstance(item, ast.FunctionDef) for item in node.body)
                found["class"][f"{name}: {node.name}"] = methods
            if isinstance(node, ast.FunctionDef):
                body = node.body[ast.get_docstring(node) is not None :] or node.body
                last = body[-1].end_lineno or body[-1].lineno
                found["function"][f"{name}: {node.name}"] = last - body[0].lineno + 1
    return found


def above(limits: dict[str, int]) -> dict[str, int]:
    """What is larger than a limit of its kind."""
    return {
        f"{kind} {name}": size
        for kind, known in sizes().items()
        for name, size in known.items()
        if size > limits[kind]
    }


def main() -> int:
    """Prints the table; 1 where a module is on no row."""
    capability = rows()
    count: dict[str, Counter[str]] = defaultdict(Counter)
    for path in OWN:
        text = path.read_text(encoding="utf-8")
        lines, told = len(text.splitlines()), explanation(path)
        blank = sum(not line.strip() for line in text.splitlines())
        row = {"modules": 1, "code": lines - told - blank, "explanation": told, "lines": lines}
        for name in (capability.get(path, "on no row"), "all"):
            count[name].update(row)
    print(f"{'capability':52}{'modules':>8}{'code':>8}{'explanation':>12}{'lines':>8}")
    for name, row in sorted(count.items(), key=lambda item: item[1]["lines"]):
        values = f"{row['modules']:8}{row['code']:8}{row['explanation']:12}{row['lines']:8}"
        print(f"{name:52}{values}")
    large = sorted(above(SMELLS).items())
    print(f"large ({len(large)}): " + ", ".join(f"{name} ({size})" for name, size in large))
    lost = [str(path.relative_to(PACKAGE)) for path in OWN if path not in capability]
    if lost:
        print(f"on no row of tests/suite/capabilities.toml: {', '.join(lost)}", file=sys.stderr)
    return bool(lost)


if __name__ == "__main__":
    raise SystemExit(main())
