"""Compare what Blender finds in an exported file with what must be there.

blender --background --factory-startup --python-exit-code 1 --python blender_check.py -- \
    FILE STATE EXPECTED.npz

FILE is a .glb with all states, or the .ply file of STATE.  In Blender's coordinates, which are
those of the run, places must agree to 1e-6 m, and colours to 1e-6.
"""

from __future__ import annotations

import sys

import bpy
import numpy as np

TOLERANCE = 1e-6


def main(file: str, state: int, expected: str) -> None:
    """Opens a file, goes to the state and compares."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    want = np.load(expected)
    scene = bpy.context.scene
    if file.endswith(".glb"):
        bpy.ops.import_scene.gltf(filepath=file)
        frame = float(want["seconds"][0]) * scene.render.fps / scene.render.fps_base
        scene.frame_set(int(frame), subframe=frame % 1)
    else:
        bpy.ops.wm.ply_import(filepath=file, import_colors="LINEAR")  # as they are in the file
    body = next(one for one in bpy.data.objects if one.type == "MESH")
    mesh = body.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    local = numbers(mesh.vertices, "co", 3)
    turn = np.array(body.matrix_world, dtype=float)
    places = local @ turn[:3, :3].T + turn[:3, 3]
    attribute = f"_COLOUR_{state}" if file.endswith(".glb") else mesh.color_attributes[0].name
    found = mesh.attributes[attribute]
    kind, size = ("vector", 3) if found.data_type == "FLOAT_VECTOR" else ("color", 4)
    colours = numbers(found.data, kind, size)[:, :3]
    srgb = want["colours"]
    if file.endswith(".glb"):  # amounts of light
        srgb = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    errors = np.abs(places - want["places"]).max(), np.abs(colours - srgb).max()
    extra = [one.name for one in mesh.attributes if not one.name.startswith((".", "_COLOUR"))]
    print(
        f"Blender {bpy.app.version_string}, {file.rpartition('/')[2]}: {len(places)} points, state "
        f"{state}: places off by {errors[0]:.1e} m, colours ({found.domain}, {found.data_type}) by "
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
    file, state, expected = sys.argv[sys.argv.index("--") + 1 :]
    main(file, int(state), expected)
