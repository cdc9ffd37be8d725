"""Draws docs/duck.png: the duck of demos/duck before and after, on a finer mesh.

docker/run xvfb-run -a python3 docs/duck_picture.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyvista as pv
from dolfinx.plot import vtk_mesh
from matplotlib.colors import LinearSegmentedColormap

from dolfin_elastic import read_case
from dolfin_elastic.case.case import Case
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.scene.colour_bar import make_colour_bar

ROOT = Path(__file__).resolve().parent.parent
SIZE = 4.0
FROM, UP, APART = np.array([0.55, -1.0, 0.3]), np.array([0.0, 0.0, 1.0]), 0.15
YELLOW, ORANGE, BLACK = "#ffcc1a", "#ff7a1a", "#202020"
HEAT = LinearSegmentedColormap.from_list(
    "heat", ["#ffe36b", "#ffb020", "#f0591e", "#b3122b", "#4a0530"]
)


def pressed():
    """The surface, its displacement [m] and von Mises stress [kPa]."""
    tables = read_case(ROOT / "demos/duck/case.toml").to_dict()
    tables["mesh"] |= {"size": SIZE, "degree": 1}
    case = Case.from_dict(tables, folder=ROOT / "demos/duck")
    problem = case.make_problem(case.read_body())
    for state in case.make_solver(problem).steps():
        print(f"load {100 * state.load_factor:.0f} %", flush=True)
    grid = pv.UnstructuredGrid(*vtk_mesh(problem.V))
    grid["u"] = state.u.x.array.reshape(-1, 3).copy()
    grid["von Mises stress [kPa]"] = (
        Evaluator(problem, ["von_mises_nodal"])(state)["von_mises_nodal"][:, 0] / 1e3
    )
    return grid.extract_surface()


def paint(surface):
    """Colours of a toy: yellow, an orange beak, black eyes."""
    x, y, z = surface.points.T * 1e3
    colours = np.tile(pv.Color(YELLOW).int_rgb, (len(x), 1))
    head = (x - 30) ** 2 + y**2 + (z - 68) ** 2 > 25.6**2
    beak = (x > 46) & (abs(z - 64) < 8) & (abs(y) < 14) & head
    eyes = head & (z > 72) & (x > 40)
    colours[beak] = pv.Color(ORANGE).int_rgb
    colours[eyes] = pv.Color(BLACK).int_rgb
    surface["toy"] = colours.astype(np.uint8)


def main():
    """Two ducks side by side."""
    surface = pressed()
    paint(surface)
    plot = pv.Plotter(off_screen=True, window_size=[1800, 800])
    plot.set_background("white")
    plot.enable_anti_aliasing("ssaa")
    plot.remove_all_lights()
    for place, power in (((1, -0.9, 1.4), 0.75), ((1, 1.2, 0.5), 0.35), ((0.2, -1, 0.2), 0.25)):
        plot.add_light(pv.Light(position=place, light_type="scene light", intensity=power))
    look = {
        "smooth_shading": True,
        "split_sharp_edges": True,
        "feature_angle": 35,
        "ambient": 0.4,
        "diffuse": 0.65,
        "specular": 0.25,
        "specular_power": 20,
    }
    plot.add_mesh(surface, scalars="toy", rgb=True, **look)
    after = surface.copy()
    right = np.cross(UP, FROM)
    after.points += after["u"] + APART * right / np.linalg.norm(right)
    values = after["von Mises stress [kPa]"]
    ticks = make_colour_bar(values[values < np.percentile(values, 99.5)], "").ticks
    plot.add_mesh(
        after,
        scalars="von Mises stress [kPa]",
        cmap=HEAT,
        clim=[ticks[0], ticks[-1]],
        scalar_bar_args={
            "vertical": True,
            "position_x": 0.87,
            "position_y": 0.2,
            "height": 0.6,
            "width": 0.035,
            "fmt": "%.0f",
            "color": "black",
            "n_labels": len(ticks),
            "title": "von Mises stress [kPa]\n",
            "title_font_size": 22,
            "label_font_size": 22,
        },
        **look,
    )
    plot.view_vector(FROM, viewup=UP)
    plot.enable_parallel_projection()
    plot.camera.zoom(1.75)
    plot.camera.SetWindowCenter(0.08, 0.0)
    plot.screenshot(ROOT / "docs/duck.png")


if __name__ == "__main__":
    main()
