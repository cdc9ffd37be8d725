"""Draws docs/bounce.png: the ball of demos/bounce, cut open, with its von Mises stress.

docker/run xvfb-run -a python3 docs/bounce_picture.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyvista as pv
from dolfinx.plot import vtk_mesh

from dolfin_elastic import read_case
from dolfin_elastic.case.case import Case
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.scene.colour_bar import colour_map

ROOT = Path(__file__).resolve().parent.parent
TIMES = (0.0, 0.006, 0.014, 0.021, 0.028, 0.044)
APART = 0.068
NAME = "von Mises stress [kPa]"


def instants():
    """The body, cut through the middle, at each time."""
    tables = read_case(ROOT / "demos/bounce/case.toml").to_dict()
    tables["mesh"]["size"] = 2.5
    tables["dynamics"] |= {"end": 1.001 * TIMES[-1], "every": 5}
    case = Case.from_dict(tables, folder=ROOT / "demos/bounce")
    problem = case.make_problem(case.read_body())
    evaluate = Evaluator(problem, ["von_mises_nodal"])
    grid, wanted = pv.UnstructuredGrid(*vtk_mesh(problem.V)), list(TIMES)
    for state in case.make_solver(problem).steps():
        if wanted and state.t >= wanted[0]:
            wanted.pop(0)
            print(f"t = {1e3 * state.t:.1f} ms, max |u| {1e3 * state.max_displacement:.1f} mm")
            grid[NAME] = evaluate(state)["von_mises_nodal"][:, 0] / 1e3
            warped = grid.copy()
            warped.points = grid.points + state.u.x.array.reshape(-1, 3)
            half = warped.clip("y", origin=(0, 0.0, 0.03), invert=False)
            yield state.t, half.extract_surface()


def main():
    """Side by side, on the floor."""
    plot = pv.Plotter(off_screen=True, window_size=[1800, 480])
    plot.set_background("white")
    plot.enable_anti_aliasing("ssaa")
    look = {"ambient": 0.5, "diffuse": 0.5, "specular": 0.2, "specular_power": 20}
    shots = list(instants())
    top = max(np.percentile(s[NAME], 99.5) for _, s in shots)
    for k, (t, surface) in enumerate(shots):
        surface.points[:, 0] += k * APART
        plot.add_mesh(
            surface,
            scalars=NAME,
            cmap=colour_map(),
            clim=[0, top],
            smooth_shading=True,
            split_sharp_edges=True,
            feature_angle=35,
            show_scalar_bar=k == 0,
            scalar_bar_args={
                "vertical": True,
                "position_x": 0.945,
                "position_y": 0.2,
                "height": 0.6,
                "width": 0.02,
                "fmt": "%.0f",
                "color": "black",
                "n_labels": 4,
                "title": "kPa\n",
                "title_font_size": 20,
                "label_font_size": 20,
            },
            **look,
        )
        label = np.array([[k * APART, 0, -0.0135]])
        plot.add_point_labels(
            label,
            [f"{1e3 * t:.0f} ms"],
            shape=None,
            show_points=False,
            font_size=24,
            text_color="black",
            justification_horizontal="center",
            always_visible=True,
        )
    middle = APART * (len(shots) - 1) / 2
    floor = pv.Box((-0.04, middle * 2 + 0.04, -0.03, 0.03, -0.005, -0.002))
    plot.add_mesh(floor, color="#c8ccd2", **look)
    plot.view_vector((0.0, -1.0, 0.12), viewup=(0, 0, 1))
    plot.enable_parallel_projection()
    plot.camera.focal_point = (middle + 0.016, 0, 0.034)
    plot.camera.position = (middle + 0.016, -1.0, 0.154)
    plot.camera.parallel_scale = 0.062
    plot.screenshot(ROOT / "docs/bounce.png")


if __name__ == "__main__":
    main()
