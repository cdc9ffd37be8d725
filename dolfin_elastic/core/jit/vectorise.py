"""C code of a kernel for several cells at once, made of what FFCx has written for one."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

LANES = 8
"""Cells at once: numbers in a register of 512 bits, or in two or four smaller ones."""

_OF_ANGLES = ["cos", "sin", "tan", "acos", "asin", "atan", "cosh", "sinh", "tanh"]
_OF_ONE = ["sqrt", "fabs", "exp", "log", "erf", *_OF_ANGLES]
_OF_TWO = ["pow", "atan2", "fmin", "fmax"]
_OURS = {"exp", "log", "pow"}
"""Those of lanes.h; of others the C library's are called for each number."""

_FUNCTIONS = {*_OF_ONE, *_OF_TWO}

_NUMBERS = r"[\w\s\[\]().,+\-*/]+"
"""An expression without comparisons, conditions and blocks."""
_TABLE = re.compile(r"static const double \w+(\[\d+\])+ = \{.*\};")
_COMMENT = re.compile(r"//.*")
_CUT = re.compile(r"(?<=,)\n")
"""Within a table of several lines."""
_LOOP = re.compile(r"for \(int (\w+) = 0; \1 < \d+; \+\+\1\)")
_ARRAY = re.compile(r"double (\w+(?:\[\d+\])+) = \{0\};")
_STATEMENT = re.compile(rf"(double )?(\w+(?:\[{_NUMBERS}\])*) (\+?=) ({_NUMBERS});")
_COMPARISON = re.compile(rf"bool (\w+) = ({_NUMBERS}) (<|>|<=|>=|==|!=) ({_NUMBERS});")
_CHOICE = re.compile(rf"double (\w+) = (\w+) \? ({_NUMBERS}) : ({_NUMBERS});")
_OTHER = re.compile(r"\((double|float|int)\)|\b(I|entity_local_index|quadrature_permutation)\b")
"""Casts, complex numbers, and arguments that are not handed on."""
_CALL = re.compile(r"\b([A-Za-z_]\w*)\(")
_POWER = re.compile(r"\bpow\((\w+), ([23])\)")
_DIVISION = re.compile(r" / (sp_\w+)\b")
"""By a number that has one value in its block."""
_DEFINED = re.compile(r"lanes (sp_\w+) = ")


def kernel_of_one_cell(arguments: int) -> str:
    """LANES = 1, and TABULATE, which calls FFCx's function at `kernel`."""
    return f'#define LANES 1\n#define ARGUMENTS {arguments}\n#include "lanes.h"\n'


def kernel_in_lanes(folder: Path, number: int) -> str | None:
    """LANES > 1, and TABULATE for so many cells; None where FFCx's function has unknown code.

    Args:
        number: Which integral of its form; 0 for an expression.
    """
    body = _in_lanes(_body(folder, number))
    if body is None:
        return None
    functions = [f"OF_ONE({f})\n" for f in _OF_ONE if f not in _OURS]
    functions += [f"OF_TWO({f})\n" for f in _OF_TWO if f not in _OURS]
    functions += [f"#define {f}_lanes(x) each_{f}(SPREAD(x))\n" for f in _OF_ONE]
    two = "(x, y) each_{}(SPREAD(x), SPREAD(y))"
    functions += [f"#define {f}_lanes{two.format(f)}\n" for f in _OF_TWO]
    return (
        f'#define LANES {LANES}\n#include "lanes.h"\n{"".join(functions)}'
        "static __attribute__((noinline)) void tabulate(lanes* restrict A,\n"
        "    const lanes* restrict w, const lanes* restrict c,\n"
        "    const lanes* restrict coordinate_dofs)\n"
        f"{body}\n#define TABULATE(...) ((void)kernel, tabulate(__VA_ARGS__))\n"
    )


def _body(folder: Path, number: int) -> str:
    """The block of a function in a module's code; empty where it is not found."""
    text = next(folder.glob("libffcx_*.c")).read_text(encoding="utf-8")
    integrals = re.search(r"ufcx_integral\* form_integrals_\w+\[\d+\] = \{(.*?)\};", text)
    names = re.findall(r"&(\w+)", integrals.group(1)) if integrals else [r"\w+"]
    entry = re.search(
        rf"^ufcx_\w+ {names[number]} =\n.*?\.tabulate_tensor_float64 = (\w+),", text, re.M | re.S
    )
    start = text.find(f"void {entry.group(1)}(") if entry else -1
    if start < 0:
        return ""
    depth, begin = 0, text.index("\n{", start) + 1
    for brace in re.finditer(r"[{}]", text[begin:]):
        depth += 1 if brace.group() == "{" else -1
        if depth == 0:
            return text[begin : begin + brace.end()]
    return ""


def _in_lanes(body: str) -> str | None:
    """A block of FFCx's code with vectors in place of numbers; None where it has other code."""
    lines = list(_lines(body))
    return None if not lines or "" in lines else "\n".join(_without_divisions(lines))


def _without_divisions(lines: Sequence[str]) -> Iterator[str]:
    """Products with the reciprocals of numbers by which several others are divided.

    A division of eight numbers takes as long as thirty products.  The result may differ by one
    unit in the last place.
    """
    often = Counter(name for line in lines for name in _DIVISION.findall(line))
    inverse = {name: f"{name}_inverse" for name, times in often.items() if times > 1}
    for line in lines:
        yield _DIVISION.sub(lambda m: f" * {inverse[m[1]]}" if m[1] in inverse else m[0], line)
        if (new := _DEFINED.match(line)) and new[1] in inverse:
            yield f"const lanes {inverse[new[1]]} = 1.0 / {new[1]};"


def _lines(body: str) -> Iterator[str]:
    """Lines of code in lanes; an empty one for each that is not of a known kind."""
    for line in map(str.strip, _CUT.sub(" ", _COMMENT.sub("", body)).splitlines()):
        if not line:
            continue
        if line in ("{", "}") or _TABLE.fullmatch(line) or _LOOP.fullmatch(line):
            yield line
        elif match := _ARRAY.fullmatch(line):
            yield f"lanes {match.group(1)} = {{ZERO}};"
        elif not set(_CALL.findall(line)) <= _FUNCTIONS or _OTHER.search(line):
            yield ""
        elif match := _STATEMENT.fullmatch(line):
            new, target, sign, value = match.groups()
            yield f"{'lanes ' if new else ''}{target} {sign} {_vector(value)};"
        elif match := _COMPARISON.fullmatch(line):
            name, one, sign, two = match.groups()
            yield f"marks {name} = {_vector(one)} {sign} {_vector(two)};"
        elif match := _CHOICE.fullmatch(line):
            name, mark, one, two = match.groups()
            yield f"lanes {name} = CHOOSE({mark}, {_vector(one)}, {_vector(two)});"
        else:
            yield ""


def _vector(value: str) -> str:
    value = _POWER.sub(lambda m: "(" + " * ".join([m[1]] * int(m[2])) + ")", value)
    return "SPREAD(" + _CALL.sub(r"\1_lanes(", value) + ")"
