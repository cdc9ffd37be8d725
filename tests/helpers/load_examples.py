"""A load of each kind, for the tests that loop over the table of loads."""

from __future__ import annotations

from typing import Any

SIZE = 1e4
"""Of the loads below, so that their tangents are a few percent of the material's."""
EXAMPLES: dict[str, dict[str, Any]] = {
    "traction": {"on": "top", "value": [f"{SIZE}*x", SIZE, SIZE]},
    "force": {"on": ["top", "right"], "value": [SIZE, f"{SIZE}*x", SIZE]},
    "pressure": {"on": ["top", "right"], "value": f"{SIZE}*(1 + x)"},
    "remote-force": {"on": ["top", "right"], "point": [2, 1, 3], "force": [SIZE, -SIZE, "1e4*t"]},
    "body-force": {"value": [SIZE, f"{SIZE}*x", 0]},
    "gravity": {},
    "base-acceleration": {"value": [SIZE, "10*t", 0]},
    "centrifugal": {"value": 5, "point": [0.2, 0.1, 0]},
    "point-force": {"at": [0.3, 0.4, 0.2], "value": [SIZE, 0, SIZE]},
    "thermal": {"value": "20 + 10*x"},
    "growth": {"value": [1.02, 0.99, "1 + 0.05*y"]},
    "line-force": {"start": [0, 0, 0], "end": [1, 1, 0.5], "value": [0, SIZE, 0]},
}
"""One of each kind; in a plane vectors lose their last component."""


def example(kind: str, dim: int) -> dict[str, Any]:
    """The keys of a load, beside its kind, for a body in so many dimensions."""
    return {
        k: v[:dim] if k != "on" and isinstance(v, list) else v for k, v in EXAMPLES[kind].items()
    }
