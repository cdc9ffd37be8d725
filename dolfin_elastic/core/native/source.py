"""C files of this folder, with the headers they include put in: all that a compiler sees of us.

So the text is what compiled code depends on, and needs no folder where headers are found.
Functions that Python calls are those that return an int64_t and are not static.  The prototypes in
front of their bodies are the only ones; they name the length of each array.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from typing import NamedTuple

_OWN_HEADER = re.compile(r'#include "([\w.]+)"')
_PROTOTYPE = re.compile(r"^int64_t (\w+)\(([^;{]*)\)\n\{", re.M)
_PARAMETER = re.compile(r"(?P<kind>(const )?\w+) (?P<name>\w+)(\[(?P<length>.+)\])?", re.S)
_WORD = re.compile(r"[A-Za-z_]\w*")


def read(name: str, generated: Mapping[str, str] | None = None) -> str:
    """The text of a file, with each of our headers where it is first included.

    Args:
        name: Of the file.
        generated: Headers that are in no file, by name.
    """
    return "".join(_lines(name, generated or {}, set()))


def _lines(name: str, generated: Mapping[str, str], seen: set[str]) -> Iterator[str]:
    seen.add(name)
    text = generated[name] if name in generated else written(name)
    for line in text.splitlines(keepends=True):
        if not (own := _OWN_HEADER.match(line)):
            yield line
        elif own.group(1) not in seen:
            yield from _lines(own.group(1), generated, seen)


def written(name: str) -> str:
    """What stands in a file."""
    return files("dolfin_elastic.core.native").joinpath(name).read_text(encoding="utf-8")


class Parameter(NamedTuple):
    """What a function takes.

    Attributes:
        name: In its prototype.
        kind: Type of the number, or of the entries of an array.
        length: Of the array at least, an expression in C of integers and arrays before it, and of
            macros; None: a number.
    """

    name: str
    kind: str
    length: str | None


def prototypes(text: str) -> dict[str, list[Parameter]]:
    """Parameters of the functions that Python calls, by name.

    Args:
        text: From `read`.

    Raises:
        ValueError: An array has no length.
    """
    found: dict[str, list[Parameter]] = {}
    for name, listed in _PROTOTYPE.findall(text):
        found[name] = []
        for one in listed.split(",") if listed != "void" else []:
            if not (parsed := _PARAMETER.fullmatch(one.strip())):
                raise ValueError(f"{name}: {one.strip()} is neither a number nor an array[length]")
            found[name].append(Parameter(parsed["name"], parsed["kind"], parsed["length"]))
    return found


def declarations(functions: Mapping[str, Sequence[Parameter]]) -> str:
    """The same for cffi, which knows no lengths, and the macros that they are made of.

    Args:
        functions: From `prototypes`.
    """
    lines, macros = [], set()
    for name, parameters in functions.items():
        listed = [p.kind + (" " if p.length is None else "* ") + p.name for p in parameters]
        lines.append(f"int64_t {name}({', '.join(listed) or 'void'});\n")
        used = {word for p in parameters for word in _WORD.findall(p.length or "")}
        macros |= used - {p.name for p in parameters}
    return "".join([*(f"#define {name} ...\n" for name in sorted(macros)), *lines])
