"""Compare what Blender finds in an exported file with what must be there.

blender --background --factory-startup --python-exit-code 1 --python foreign_blender.py -- \
    FILE EXPECTED.npz

FILE is a .glb with all states, or a .ply or .obj file of one, STEM_0002.ply.  In Blender's
coordinates, which are those of the run, places must agree to 1e-6 m, and colours to 1e-6.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np

TOLERANCE = 1e-6


def main(file: Path, expected: str) -> None:
    """Opens a file and compares all states in it."""
    want = np.load(expected)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if moving := file.suffix == ".glb":
        bpy.ops.import_scene.gltf(filepath=str(file))
        states = range(len(want["times"]))
    else:
        if file.suffix == ".ply":  # colours as they are in the file
            bpy.ops.wm.ply_import(filepath=str(file), import_colors="LINEAR")
        else:
            bpy.ops.wm.obj_import(filepath=str(file), forward_axis="Y", up_axis="Z")
        states = [int(file.stem.rpartition("_")[2])]
    scene, errors = bpy.context.scene, np.zeros(2)
    body = next(one for one in bpy.data.objects if one.type == "MESH")
    for state in states:
        if moving:
            seconds = want["times"][state] - want["times"][0]
            frame = float(seconds) * scene.render.fps / scene.render.fps_base
            scene.frame_set(int(frame), subframe=frame % 1)
        mesh = body.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
        turn = np.array(body.matrix_world, dtype=float)
        places = numbers(mesh.vertices, "co", 3) @ turn[:3, :3].T + turn[:3, 3]
        found = mesh.attributes[f"_COLOUR_{state}" if moving else mesh.color_attributes[0].name]
        kind, size = ("vector", 3) if found.data_type == "FLOAT_VECTOR" else ("color", 4)
        colours = numbers(found.data, kind, size)[:, :3]
        srgb = want["colours"][state]
        if file.suffix != ".ply":  # amounts of light
            srgb = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
        nodes = want["nodes"]
        off = places - (want["rest"] + want["displacement"][state])[nodes], colours - srgb
        errors = np.maximum(errors, [np.abs(one).max() for one in off])
    extra = [one.name for one in mesh.attributes if not one.name.startswith((".", "_COLOUR"))]
    print(
        f"Blender {bpy.app.version_string}, {file.name}: {len(places)} points, {len(states)} "
        f"states: places off by {errors[0]:.1e} m, colours ({found.domain}, {found.data_type}) by "
        f"{errors[1]:.1e}; attributes {', '.join(extra)}"
    )
    if max(errors) > TOLERANCE:
        sys.exit(1)


def numbers(rows: object, name: str, size: int) -> np.ndarray:
    """What Blender holds for each of some rows."""
    result = np.empty(len(rows) * size, dtype=np.float32)
    rows.foreach_get(name, result)
    return result.reshape(-1, size).astype(float)


if __name__ == "__main__":
    file, expected = sys.argv[sys.argv.index("--") + 1 :]
    main(Path(file), expected)
