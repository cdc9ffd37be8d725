"""Draws a scene in a process of its own, as all pictures are."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np

from dolfin_elastic.core.files.regular import fresh
from dolfin_elastic.core.shapes.box import Box
from dolfin_elastic.results.files import make_folder, writing
from dolfin_elastic.results.scene.body import Scene
from dolfin_elastic.results.scene.renderer import Renderer
from dolfin_elastic.results.scene.scene import axes_of

_PROGRAM = Path(__file__).with_name("_draw_body.py")


def draw_scene(scene: Scene, file: Path) -> None:
    """Draws a body from two opposite sides, a plane one from the front. Not collective.

    Args:
        file: The PNG file.

    Raises:
        OutputError: It cannot be drawn or written.
    """
    back, _, top = axes_of("z" if scene.plane else "isometric", "z" if scene.plane else scene.up)
    words = {
        "title": scene.title,
        "plane": scene.plane,
        "views": [back.tolist()] if scene.plane else [back.tolist(), (-back).tolist()],
        "up": top.tolist(),
        "patches": [{"face": p.face, "names": p.names} for p in scene.patches],
        "legend": dict(scene.legend),
        "curves": [{"label": c.label, "named": c.named} for c in scene.curves],
        "symbols": [{"kind": s.kind, "label": s.label} for s in scene.symbols],
        "obstacles": list(scene.obstacles),
    }
    arrays = {
        f"{key}{i}": getattr(one, key)
        for i, one in enumerate(scene.symbols)
        for key in ("places", "directions", "normals")
    }
    arrays |= {f"curve{i}": one.pieces for i, one in enumerate(scene.curves)}
    near = Box(scene.points.min(axis=0), scene.points.max(axis=0))
    for i, shape in enumerate(scene.obstacles.values()):
        points, triangles = shape.drawn(near, 2 if scene.plane else 3)
        arrays |= {f"obstacle_points{i}": points, f"obstacle_triangles{i}": triangles}
    make_folder(file.parent)
    with tempfile.TemporaryDirectory(prefix="dolfin_elastic-") as folder:
        data, drawn = Path(folder, "scene.npz"), Path(folder, "scene.png")
        np.savez(
            data,
            points=scene.points,
            triangles=scene.triangles,
            patch=scene.patch,
            words=np.frombuffer(json.dumps(words).encode(), dtype=np.uint8),
            **arrays,
        )
        renderer = Renderer(_PROGRAM)
        try:
            renderer.draw([data], drawn)
        finally:
            renderer.close()
        draft = file.with_name(f".{file.name}.part")
        with writing(file):
            fresh(draft).write_bytes(drawn.read_bytes())
            draft.replace(file)
