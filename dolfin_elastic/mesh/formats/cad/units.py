"""The unit of length that a CAD file states."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path

from dolfin_elastic.core.units import LENGTHS, LengthUnit
from dolfin_elastic.mesh.formats.cad.script import files_named, without_comments

_PREFIXES = {
    "KILO": 1e3,
    "HECTO": 1e2,
    "DECA": 1e1,
    "DECI": 1e-1,
    "CENTI": 1e-2,
    "MILLI": 1e-3,
    "MICRO": 1e-6,
    "NANO": 1e-9,
}
_IGES_FLAGS = {
    1: 0.0254,
    2: 1e-3,
    4: 0.3048,
    5: 1609.344,
    6: 1.0,
    7: 1e3,
    8: 2.54e-5,
    9: 1e-6,
    10: 1e-2,
    11: 2.54e-8,
}
"""Unit flags [m] of the global section (IGES 5.3, 2.2.4.3.14); 3 refers to the name beside it."""
_MERGED = (".step", ".stp", ".iges", ".igs")


def stated_unit(path: Path) -> LengthUnit | None:
    """The unit of a STEP or IGES file. Local.

    Parts with different units are converted to millimetres; so is what a .geo file reads by
    Merge or ShapeFromFile.

    Returns:
        None where the file states none; .brep files never do.
    """
    suffix, data = path.suffix.lower(), path.read_bytes().decode("latin-1")
    result: set[float] = set()
    if suffix in (".step", ".stp"):
        result = set(_step_units(data))
    elif suffix in (".iges", ".igs"):
        result = set(_iges_units(data))
    elif suffix == ".geo" and "OCCTargetUnit" not in without_comments(data):
        read = [Path(name).suffix.lower() for name in files_named(data)]
        result = {1e-3} if not set(_MERGED).isdisjoint(read) else set()
    if not result:
        return None
    metres = result.pop() if len(result) == 1 else 1e-3
    near = (length for length in LENGTHS.values() if math.isclose(length, metres, rel_tol=1e-9))
    return LengthUnit.of(next(near, metres), stated=True)


def _step_units(text: str) -> Iterator[float]:
    """Units of length [m] of the contexts (global_unit_assigned_context of ISO 10303-41)."""
    contexts = re.findall(r"GLOBAL_UNIT_ASSIGNED_CONTEXT\s*\(\s*\(([^)]*)\)", text)
    for number in {n for context in contexts for n in re.findall(r"#(\d+)", context)}:
        if (unit := _step_unit(text, number)) is not None:
            yield unit


def _step_unit(text: str, number: str, depth: int = 0) -> float | None:
    """Length of a unit [m]; None if it is none of length, or not understood."""
    entity = re.search(rf"#{number}\s*=\s*([^;]*);", text)
    if entity is None or depth > 5:
        return None
    if si := re.search(r"SI_UNIT\s*\(\s*(?:\$|\.(\w+)\.)\s*,\s*\.METRE\.\s*\)", entity[1]):
        return _PREFIXES.get(si[1]) if si[1] else 1.0
    based = re.search(r"CONVERSION_BASED_UNIT\s*\(\s*'[^']*'\s*,\s*#(\d+)", entity[1])
    if based is None or "LENGTH_UNIT" not in entity[1].replace("_ANGLE_UNIT", ""):
        return None
    measure = re.search(rf"#{based[1]}\s*=\s*([^;]*);", text)
    number_and_base = r"LENGTH_MEASURE\s*\(\s*([-+\d.Ee]+)\s*\)[^#]*#(\d+)"
    factor = re.search(number_and_base, measure[1] if measure else "")
    if factor is None:
        return None
    base = _step_unit(text, factor[2], depth + 1)
    return None if base is None else float(factor[1]) * base


def _iges_units(text: str) -> Iterator[float]:
    """The unit of the global section [m], parameters 14 and 15."""
    section = "".join(line[:72] for line in text.splitlines() if line[72:73] == "G")
    values = list(_iges_parameters(section))
    flag = values[13].strip() if len(values) > 13 else ""
    if flag.isdigit() and int(flag) in _IGES_FLAGS:
        yield _IGES_FLAGS[int(flag)]


def _iges_parameters(section: str) -> Iterator[str]:
    """Parameters of the global section; texts are written as 2HMM, 1H, is a comma."""
    at, separator = 0, ","
    first = True
    while at < len(section):
        text = re.match(r"\s*(\d+)H", section[at:])
        if text:
            start = at + text.end()
            value = section[start : start + int(text[1])]
            at = start + int(text[1])
        else:
            end = min(
                (i for i in (section.find(separator, at), section.find(";", at)) if i >= 0),
                default=len(section),
            )
            value, at = section[at:end], end
        if first and text:
            separator = value
        first = False
        yield value
        if section[at : at + 1] == ";":
            return
        at += 1
