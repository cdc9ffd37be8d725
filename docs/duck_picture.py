"""Draws docs/duck.png from the results of the README's first command: before, and after, cut open.

docker/run mpirun -n 2 dolfin-elastic run demos/duck/case.toml
docker/run xvfb-run -a python3 docs/duck_picture.py
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pyvista as pv

from dolfin_elastic.results.finished.draw import shown
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.scene.colour_bar import colour_map, make_colour_bar
from dolfin_elastic.results.scene.scene import DIRECTIONS

ROOT = Path(__file__).resolve().parent.parent
APART = 0.15
YELLOW, ORANGE, BLACK = "#ffcc1a", "#ff7a1a", "#202020"
NAME = "von Mises stress [kPa]"
LOOK = {
    "smooth_shading": True,
    "split_sharp_edges": True,
    "feature_angle": 35,
    "ambient": 0.4,
    "diffuse": 0.65,
    "specular": 0.25,
    "specular_power": 20,
}


def paint(surface):
    """Colours of a toy: yellow, an orange beak, black eyes."""
    x, y, z = surface.points.T * 1e3
    colours = np.tile(pv.Color(YELLOW).int_rgb, (len(x), 1))
    head = (x - 30) ** 2 + y**2 + (z - 68) ** 2 > 25.05**2
    colours[head & (x > 52) & (z < 72)] = pv.Color(ORANGE).int_rgb
    for side in (-1, 1):
        eye = (x - 43.5) ** 2 + (y - side * 9.5) ** 2 + (z - 80) ** 2 < 6.1**2
        colours[head & eye] = pv.Color(BLACK).int_rgb
    surface["toy"] = colours.astype(np.uint8)


def main(folder="case_results"):
    """Two ducks side by side, seen as in the picture that the run has drawn."""
    grid = FinishedRun(folder).grid()
    before = grid.extract_surface(nonlinear_subdivision=3)
    paint(before)
    after = grid.clip("y", origin=(0, 0, 0), invert=False).extract_surface()
    after[NAME] = shown(after.point_data, "von_mises") / 1e3
    toward = np.array(DIRECTIONS["isometric"])
    right = np.cross((0.0, 0.0, 1.0), toward)
    after.points += after["displacement"] + APART * right / np.linalg.norm(right)
    plot = pv.Plotter(off_screen=True, window_size=[1800, 760])
    plot.set_background("white")
    plot.enable_anti_aliasing("ssaa")
    plot.remove_all_lights()
    for place, power in (((1, -0.9, 1.4), 0.75), ((1, 1.2, 0.5), 0.35), ((0.2, -1, 0.2), 0.25)):
        plot.add_light(pv.Light(position=place, light_type="scene light", intensity=power))
    plot.add_mesh(before, scalars="toy", rgb=True, **LOOK)
    ticks = make_colour_bar(after[NAME], "").ticks
    plot.add_mesh(
        after,
        scalars=NAME,
        cmap=colour_map(),
        clim=[ticks[0], ticks[-1]],
        scalar_bar_args={
            "vertical": True,
            "position_x": 0.91,
            "position_y": 0.2,
            "height": 0.6,
            "width": 0.03,
            "fmt": "%.0f",
            "color": "black",
            "n_labels": len(ticks),
            "title": "von Mises stress [kPa]\n",
            "title_font_size": 22,
            "label_font_size": 22,
        },
        **LOOK,
    )
    plot.view_vector(toward, viewup=(0, 0, 1))
    plot.enable_parallel_projection()
    plot.camera.zoom(1.95)
    plot.camera.SetWindowCenter(0.1, 0.0)
    plot.screenshot(ROOT / "docs/duck.png")


if __name__ == "__main__":
    main(*sys.argv[1:])
