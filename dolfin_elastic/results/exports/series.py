"""A surface as one .ply or .obj file a state, at its places [m], coloured as on a screen (sRGB).

PLY is binary, with colours as numbers from 0 to 1 and the field's own values beside them.  OBJ is
text, with the colours behind the places, as most programs read them.

Source: G. Turk, The PLY Polygon File Format (1994); Wavefront, Appendix B1. Object Files (1995).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.results.exports.moving import Moving, Shown, as_single, numbered
from dolfin_elastic.results.files import drafted


def write_ply(moving: Moving, file: Path) -> list[Path]:
    """Writes a .ply file a state. Not collective.

    Returns:
        The files.

    Raises:
        OutputError: One cannot be written.
    """
    triangles = moving.body.triangles
    faces = np.zeros(len(triangles), [("count", "u1"), ("nodes", "<i4", 3)])
    faces["count"], faces["nodes"] = 3, triangles
    names = ("x", "y", "z", "red", "green", "blue", moving.field)
    lines = ["ply", "format binary_little_endian 1.0", "comment lengths in m, fields in SI units"]
    lines += [f"element vertex {len(moving.body.points)}"]
    lines += [f"property float {name.replace(' ', '_')}" for name in names]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    head, end = ("\n".join(lines) + "\n").encode(), faces.tobytes()

    def content(state: Shown) -> bytes:
        return head + _columns(state, values=True).tobytes() + end

    return _written(moving, file, content)


def write_obj(moving: Moving, file: Path) -> list[Path]:
    """Writes an .obj file a state. Not collective.

    Returns:
        The files.

    Raises:
        OutputError: One cannot be written.
    """
    faces = _lines("f %d %d %d\n", moving.body.triangles + 1)

    def content(state: Shown) -> bytes:
        rows = _columns(state, values=False)
        return ("# lengths in m\n" + _lines("v" + " %.9g" * 6 + "\n", rows) + faces).encode()

    return _written(moving, file, content)


def _columns(state: Shown, *, values: bool) -> AnyArray:
    columns = (state.places, state.colours, *([state.values] if values else []))
    return as_single(np.column_stack(columns))


def _lines(form: str, rows: AnyArray) -> str:
    return "".join([form % tuple(row) for row in rows.tolist()])


def _written(moving: Moving, file: Path, content: Callable[[Shown], bytes]) -> list[Path]:
    files = [*numbered(file, len(moving))]
    for path, state in zip(files, moving.states(), strict=True):
        with drafted(path) as draft:
            draft.write_bytes(content(state))
    return files
