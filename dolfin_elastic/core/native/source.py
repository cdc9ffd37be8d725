"""C files of this folder, with the headers they include put in: all that a compiler sees of us.

So the text is what compiled code depends on, and needs no folder where headers are found.
Functions that Python calls are those that return an int64_t and are not static; the prototypes in
front of their bodies are the only ones.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from importlib.resources import files

_OWN_HEADER = re.compile(r'#include "([\w.]+)"')
_PROTOTYPE = re.compile(r"^(int64_t \w+\([^()]*\))\n\{", re.M)


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


def declarations(text: str) -> str:
    """Prototypes of the functions that Python calls, for cffi.

    Args:
        text: From `read`.
    """
    return "".join(f"{prototype};\n" for prototype in dict.fromkeys(_PROTOTYPE.findall(text)))
