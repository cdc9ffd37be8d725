"""What a checkpoint's `.json` may hold: its digest says that it is whole, not that it is right.

A folder of results may come from anybody.  What decides how a run goes on (steps, times, sizes of
steps, where files end) is checked here by its dotted key, before any of it is used; what is left
out here, its reader refuses (`restoring` in problem/state.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeGuard


@dataclass(frozen=True)
class Kind:
    """A kind of value.

    Attributes:
        name: In words, with an article.
        fits: Whether a value is one.
    """

    name: str
    fits: Callable[[object], bool]


def _number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300


def _any_number(value: object) -> bool:
    """Also those without a value, which an audit may have."""
    return _number(value) or (isinstance(value, float) and not math.isfinite(value))


def _whole(value: object, least: int) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool) and least <= value < 1 << 62


def _nested(value: object) -> bool:
    """Numbers in lists, which may lie in lists."""
    return isinstance(value, list) and all(_nested(one) or _number(one) for one in value)


def _two(value: object) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(map(_any_number, value))


def _violation(value: object) -> bool:
    if isinstance(value, str):  # of older checkpoints
        return True
    return (
        isinstance(value, dict)
        and isinstance(value.get("text"), str)
        and _any_number(value.get("size"))
        and isinstance(value.get("fails", False), bool)
        and all(isinstance(value.get(key, ""), str) for key in ("when", "since"))
    )


FINITE = Kind("a finite number", _number)
TIME = Kind("a finite number not below 0", lambda v: _number(v) and v >= 0)
SIZE = Kind("a positive number", lambda v: _number(v) and v > 0)
DONE = Kind("a finite number up to 1", lambda v: _number(v) and v <= 1)
MEASURED = Kind("a number", _any_number)
UNKNOWN = Kind("a number or null", lambda v: v is None or _any_number(v))
KNOWN_SIZE = Kind("a positive number or null", lambda v: v is None or (_number(v) and v >= 0))
COUNT = Kind("a whole number not below 0", lambda v: _whole(v, 0))
COUNTED = Kind("a whole number not below 0, or null", lambda v: v is None or _whole(v, 0))
POSITIVE = Kind("a whole number above 0", lambda v: _whole(v, 1))
LAST = Kind("a whole number from -1 on", lambda v: _whole(v, -1))
TEXT = Kind("a text", lambda v: isinstance(v, str) and "\0" not in v)
FLAG = Kind("true or false", lambda v: isinstance(v, bool))
TABLE = Kind("a table", lambda v: isinstance(v, dict))
LISTS = Kind("a list of tables", lambda v: isinstance(v, list) and all(map(TABLE.fits, v)))
NUMBERS = Kind("a list of numbers", _nested)
PAIRS = Kind("a list of pairs of numbers", lambda v: isinstance(v, list) and all(map(_two, v)))
MEASURES = Kind("a list of numbers", lambda v: isinstance(v, list) and all(map(_any_number, v)))
VIOLATIONS = Kind(
    "a table of violations", lambda v: isinstance(v, dict) and all(map(_violation, v.values()))
)
SCALARS = Kind(
    "a table of single values",
    lambda v: (
        isinstance(v, dict) and all(isinstance(one, str | int | float | None) for one in v.values())
    ),
)

_CONTENT = {
    "step": COUNT,
    "t": FINITE,
    "done": DONE,
    "written": TEXT,
    "mesh": TABLE,
    "case": TEXT,
    "file": TEXT,
    "petsc": SCALARS,
    "arrays": TABLE,
    "numbers": TABLE,
    "outputs": LISTS,
}
_NUMBERS = {
    "t": TIME,
    "step": COUNT,
    "newton": TABLE,
    "newton.stiffest": KNOWN_SIZE,
    "newton.linear": TEXT,
    # statics
    "count": COUNT,
    "scalars": NUMBERS,
    "sizes": TABLE,
    "sizes.size": SIZE,
    "sizes.calm": COUNT,
    "jumps": COUNT,
    "speed": KNOWN_SIZE,
    "limits": PAIRS,
    "before": TABLE,
    "before.t": TIME,
    "before.scalars": NUMBERS,
    "fallback": TABLE,
    "fallback.t": TIME,
    "fallback.scalars": NUMBERS,
    "arc": TABLE,
    "arc.lead": NUMBERS,
    "arc.size": SIZE,
    "arc.longest": MEASURED,
    "arc.slope": MEASURED,
    "arc.negative": COUNTED,
    "arc.limits": PAIRS,
    "arc.newton": TABLE,
    "arc.newton.stiffest": KNOWN_SIZE,
    "arc.newton.linear": TEXT,
    # audits
    "audit": TABLE,
    "audit.work": MEASURED,
    "audit.stored": MEASURED,
    "audit.energy": MEASURED,
    "audit.change": MEASURED,
    "audit.warned": VIOLATIONS,
    "audit.unbalanced": FLAG,
    "audit.far": TEXT,
    "audit.worst": Kind("two numbers", _two),
    "audit.reasons": VIOLATIONS,
    "audit.off": MEASURED,
    "audit.scale": MEASURED,
    "audit.resolution": MEASURES,
    # implicit motion
    "dt": SIZE,
    "scale": FINITE,
    "ledger": TABLE,
    "ledger.initial": UNKNOWN,
    "ledger.scale": UNKNOWN,
    # explicit motion
    "remaining": FINITE,
    "every": SIZE,
    "work": FINITE,
    "square": SIZE,
    "known_square": SIZE,
    "found_at": COUNT,
    "interval": POSITIVE,
    "due": COUNT,
    "doubtful": FLAG,
    "lookout": TABLE,
    "lookout.far": TEXT,
    "lookout.inside_out": TEXT,
    "lookout.place": NUMBERS,
    "lookout.told": FLAG,
    "lookout.states": COUNT,
    "lookout.first": MEASURES,
    "lookout.most": MEASURED,
    "lookout.start": MEASURED,
    "lookout.violations": VIOLATIONS,
}
_OUTPUT = {
    "frames": COUNT,
    "taken": LAST,
    "bytes": COUNT,
    "drawn": LAST,
    "times": TABLE,
    "started": TEXT,
    "newton": COUNT,
    "krylov": COUNT,
    "timings": SCALARS,
    "audits": LISTS,
    "restarts": Kind("a list", lambda v: isinstance(v, list)),
    "last": TABLE,
    "convergence": TABLE,
    "largest": TABLE,
    "strained": TABLE,
}


def fault_of(content: object, step: int) -> str:
    """What is wrong with the content of a checkpoint; empty: nothing. Not collective.

    Args:
        content: Of its `.json`.
    """
    if not isinstance(content, dict):
        return "it is no table"
    missing = next((f"it has no '{key}'" for key in _CONTENT if key not in content), "")
    faults = missing or _first(content, _CONTENT, "")
    if faults:
        return faults
    if content["step"] != step:
        return f"'step' is {content['step']}, not {step}"
    known = content.get("case_text")
    if known is not None and not TEXT.fits(known):
        return "'case_text' is no text"
    # Behind a limit point the load of a path may fall below 0.
    path = {"t": FINITE} if content["numbers"].get("arc") else {}
    return (
        _first(content["numbers"], {**_NUMBERS, **path}, "numbers.")
        or _array_fault(content["arrays"])
        or next(filter(None, _of_outputs(content["outputs"])), "")
    )


def _of_outputs(outputs: list[Mapping[str, object]]) -> Iterable[str]:
    return (_first(one, _OUTPUT, f"outputs[{i}].") for i, one in enumerate(outputs))


def _first(table: Mapping[str, object], kinds: Mapping[str, Kind], path: str) -> str:
    """The first value that is of another kind than its key says.

    Args:
        table: The values; those that are not there are for their reader to miss.
        kinds: Dotted keys to kinds, those of a table before those in it.
        path: What stands before them in the message.
    """
    for key, kind in kinds.items():
        is_there, value = _at(table, key.split("."))
        if is_there and not kind.fits(value):
            return f"'{path}{key}' is {str(value)[:60]!r}, not {kind.name}"
    return ""


def _at(table: object, keys: list[str]) -> tuple[bool, object]:
    for key in keys:
        if not isinstance(table, dict) or key not in table:
            return False, None
        table = table[key]
    return True, table


def _array_fault(arrays: Mapping[str, object]) -> str:
    for name, one in arrays.items():
        table = one if isinstance(one, dict) else {}
        if not (_shape(table.get("shape")) and isinstance(table.get("sum"), str)):
            return f"'arrays.{name}' is {str(one)[:60]!r}, not a shape and a sum"
    return ""


def _shape(value: object) -> bool:
    """Rows and columns."""
    return (
        isinstance(value, list) and len(value) == 2 and _whole(value[0], 0) and _whole(value[1], 1)
    )
