"""The types of what `summary.json` holds, which may be damaged or come from a stranger."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dolfin_elastic.core.errors import InputError

_VALUE: dict[str, object] = {
    **dict.fromkeys(("value", "error", "t", "step"), float),
    **dict.fromkeys(("part", "surface", "singular", "unresolved"), str),
    "place": [float],
}
_MODE = {"*": float, "kind": str, "shape": str, "name": str}
_RESIDUALS = {"residuals": [float]}
_GLYPHS = {
    **dict.fromkeys(("key", "label", "colour"), str),
    "places": [[float]],
    "along": [[float]],
    "load": bool,
    "inside": bool,
    "tails": [bool],
}
SUMMARY: dict[str, object] = {
    **dict.fromkeys(("status", "reason", "started", "finished", "eigensolver"), str),
    **dict.fromkeys(("dofs", "cells", "ranks", "degree", "steps", "t", "load_factor"), float),
    "timed": bool,
    **dict.fromkeys(("newton_iterations", "krylov_iterations", "max_displacement"), float),
    "numbers": {"*": float},
    "timings": {"*": float},
    "peak_memory": {"*": float},
    "energies": {"*": float},
    "whole": {"*": float},
    "versions": {"*": str},
    "units": {"*": str},
    "reactions": {"*": [int]},
    "moments": {"*": {"*": [int]}},
    "limit_points": [float],
    "stability": {"verdict": str, "negative_eigenvalues": float, "reason": str},
    "audit": {
        "verdict": str,
        "reasons": [str],
        "notes": [str],
        **dict.fromkeys(("balance_force", "balance_moment"), float),
        **dict.fromkeys(("external_work", "stored_energy"), float),
        **dict.fromkeys(("min_jacobian", "max_jacobian"), _VALUE),
    },
    "convergence": {"*": _RESIDUALS},
    "diagnosis": {},
    "largest": {"*": float},
    "unloaded": {"*": float},
    "extremes": {"*": _VALUE},
    "error": {
        **dict.fromkeys(("von_mises", "elsewhere", "may_be_larger"), _VALUE),
        **dict.fromkeys(("safety_factor", "safety_factor_elsewhere"), _VALUE),
        "safety_factor_may_be_smaller": _VALUE,
        "energy_norm": float,
        "reservations": [str],
    },
    "motion": dict.fromkeys(
        ("von_mises", "elsewhere", "safety_factor", "safety_factor_elsewhere"), _VALUE
    ),
    "modes": [_MODE],
    "restarts": [],
    "case": {
        "title": str,
        "materials": {"*": {}},
        "support": [{}],
        "load": [{}],
        "contact": [{}],
        "mesh": {},
        "output": {},
        "statics": {},
        "dynamics": {},
        "modal": {},
        "buckling": {},
    },
    "model": {
        "file": str,
        "mesh": {
            "source": str,
            **dict.fromkeys(("dim", "metres", "volume"), float),
            "extent": [int],
            "information": [str],
        },
        "parts": {"*": {"area": float}},
        "loads": [{"load": str, "time": float, "force": [int], "moment": [int]}],
        "glyphs": [_GLYPHS],
        "obstacles": {"*": {"points": [[int]], "triangles": [[int]]}},
        "warnings": [str],
        "petsc": {},
    },
}
"""Keys of the summary to the types of their values; "*" stands for all other keys.  `float` is a
number or null, of what is unknown, `int` a number."""
_WORDS = {float: "a number", int: "a number", str: "a text", bool: "true or false"}


def check_types(
    value: object, shape: Any, file: str, key: str = "", *, needed: bool = True
) -> None:
    """Refuses a value that is not of its type.

    Args:
        shape: A type, a list of one, or a table of them, see `SUMMARY`.
        key: Where it stands in the file, dotted; empty: it is the whole file.
        needed: A table or list must not be null.

    Raises:
        InputError: It is of another type.
    """
    kind = dict if isinstance(shape, dict) else list if isinstance(shape, list) else shape
    if value is None and (kind in (float, str, bool) or not needed):
        return
    right = isinstance(value, int | float if kind in (float, int) else kind)
    if not right or (isinstance(value, bool) and kind in (float, int)):
        words = {dict: "a table", list: "a list", **_WORDS}
        found = next((text for one, text in words.items() if type(value) is one), "null")
        raise InputError(
            f"this is {found}", where=f"{file}: {key}", expected=f"expected {words[kind]}"
        )
    if isinstance(value, Mapping):
        for name, one in value.items():
            if (inner := shape.get(name, shape.get("*"))) is not None:
                needed = name not in shape or key == "case"
                check_types(one, inner, file, f"{key}.{name}".lstrip("."), needed=needed)
    elif isinstance(value, list):
        for i, one in enumerate(value if shape else ()):
            check_types(one, shape[0], file, f"{key}[{i}]")
