"""glTF 2.0 in one binary file: a surface that moves by morph targets, one a state.

The colours of the first state are COLOR_0, which all programs show, those of the others its
changes in the morph targets, which three.js plays; all of them are beside it as _COLOUR_0,
_COLOUR_1 ..., which Blender reads as attributes of points.  glTF is y-up: places are turned.

Source: Khronos Group, glTF 2.0 Specification, 2.0.1 (2021).
"""

from __future__ import annotations

import json
import shutil
import struct
import tempfile
from pathlib import Path
from typing import IO

import numpy as np

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.results.exports.moving import Moving, as_single, linear_light
from dolfin_elastic.results.files import drafted, need_space

_FLOAT, _INTEGER = 5126, 5125
_VERTICES, _TRIANGLES = 34962, 34963
"""What a buffer is for, as OpenGL counts."""
_MOST = (1 << 32) - (1 << 20)
"""Bytes of a file: its length has four."""

_UPRIGHT = {
    "x": [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
    "y": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "z": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
}
"""Turns the axis that is up to y."""


_Table = dict[str, object]
"""As JSON."""


class _Buffer:
    """Numbers one behind the other in a file, and glTF's tables of them."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file, self.size = file, 0
        self.views: list[dict[str, int]] = []
        self.accessors: list[_Table] = []

    def put(
        self, values: AnyArray, kind: str, target: int | None = None, *, ends: bool = False
    ) -> int:
        """Adds an array of four-byte numbers; returns its accessor.

        Args:
            kind: "SCALAR" or "VEC3".
            target: What it is for; None: neither vertices nor triangles.
            ends: Smallest and largest values are noted, by column.
        """
        view = {"buffer": 0, "byteOffset": self.size, "byteLength": values.nbytes}
        self.views.append(view | ({} if target is None else {"target": target}))
        accessor: _Table = {
            "bufferView": len(self.views) - 1,
            "componentType": _FLOAT if values.dtype.kind == "f" else _INTEGER,
            "count": len(values),
            "type": kind,
        }
        if ends:
            rows = values.reshape(len(values), -1)
            accessor |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        self.accessors.append(accessor)
        self._file.write(values.tobytes())
        self.size += values.nbytes
        return len(self.accessors) - 1


def write_glb(moving: Moving, file: Path) -> list[Path]:
    """Writes a surface with its states. Not collective.

    Returns:
        The file.

    Raises:
        InputError: It would be too large.
        OutputError: It cannot be written.
    """
    count, points = len(moving), len(moving.body.points)
    size = 12 * (points * (2 + 3 * count) + len(moving.body.triangles)) + 4 * count**2
    if size > _MOST:
        raise InputError(
            f"{count} states of {points} points have {size / 1e9:.1f} GB, a .glb 4.2 at most",
            where=str(file),
            expected="--frames with fewer states, or a series of .ply files",
        )
    need_space(file.parent, 2 * size)
    with drafted(file) as draft, tempfile.TemporaryFile(dir=file.parent) as numbers:
        buffer = _Buffer(numbers)
        text = json.dumps(_document(moving, buffer)).encode()
        text += b" " * (-len(text) % 4)
        numbers.seek(0)
        with draft.open("wb") as out:
            out.write(struct.pack("<4sII", b"glTF", 2, 28 + len(text) + buffer.size))
            out.write(struct.pack("<I4s", len(text), b"JSON") + text)
            out.write(struct.pack("<I4s", buffer.size, b"BIN\0"))
            shutil.copyfileobj(numbers, out, 1 << 20)
    return [file]


def _document(moving: Moving, buffer: _Buffer) -> _Table:
    turn = np.array(_UPRIGHT[moving.up], dtype=np.float64).T
    base = moving.body.points @ turn
    attributes: dict[str, int] = {}
    targets: list[dict[str, int]] = []
    triangles = np.ascontiguousarray(moving.body.triangles.ravel(), dtype="<u4")
    primitive: _Table = {
        "attributes": attributes,
        "indices": buffer.put(triangles, "SCALAR", _TRIANGLES),
        "material": 0,
    }
    mesh: _Table = {"name": "body", "primitives": [primitive]}
    document: _Table = {
        "asset": {"version": "2.0", "generator": "dolfin_elastic"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "body"}],
        "meshes": [mesh],
        "materials": [
            {
                "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.8},
                "doubleSided": moving.run.dim == 2,
            }
        ],
    }
    single = len(moving) == 1
    first = None
    for k, state in enumerate(moving.states()):
        places, colours = state.places @ turn, as_single(linear_light(state.colours))
        if first is None:
            first = colours
            places_at_rest = as_single(places if single else base)
            attributes["POSITION"] = buffer.put(places_at_rest, "VEC3", _VERTICES, ends=True)
            attributes["COLOR_0"] = buffer.put(colours, "VEC3", _VERTICES)
        if single:
            continue
        attributes[f"_COLOUR_{k}"] = buffer.put(colours, "VEC3", _VERTICES)
        target = {"POSITION": buffer.put(as_single(places - base), "VEC3", _VERTICES, ends=True)}
        target["COLOR_0"] = buffer.put(colours - first, "VEC3", _VERTICES)
        targets.append(target)
    if not single:
        count = len(targets)
        primitive["targets"] = targets
        mesh["weights"] = [1.0] + [0.0] * (count - 1)
        mesh["extras"] = {"targetNames": [f"state {k}" for k in range(count)]}
        document["animations"] = [_animation(moving, buffer, count)]
    document["buffers"] = [{"byteLength": buffer.size}]
    document["bufferViews"], document["accessors"] = buffer.views, buffer.accessors
    return document


def _animation(moving: Moving, buffer: _Buffer, count: int) -> _Table:
    times = buffer.put(as_single(np.array(moving.times)), "SCALAR", ends=True)
    weights = buffer.put(as_single(np.eye(count).ravel()), "SCALAR")
    sampler = {"input": times, "output": weights, "interpolation": "LINEAR"}
    channel = {"sampler": 0, "target": {"node": 0, "path": "weights"}}
    return {"name": "run", "channels": [channel], "samplers": [sampler]}
