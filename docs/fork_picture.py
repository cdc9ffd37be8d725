"""Draws docs/fork.png: the tone of the fork of demos/tuning_fork, and two of its other modes.

docker/run xvfb-run -a python3 docs/fork_picture.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyvista as pv
from dolfinx.plot import vtk_mesh

from dolfin_elastic import read_case
from dolfin_elastic.results.scene.colour_bar import colour_map

ROOT = Path(__file__).resolve().parent.parent
WORDS = {4: "the tone", 3: "twisting", 2: "swaying"}
APART, SWING = 0.036, 0.0039


def shapes():
    """Number to surface and displacement of each mode."""
    case = read_case(ROOT / "demos/tuning_fork/case.toml")
    problem = case.make_problem(case.read_body())
    grid = pv.UnstructuredGrid(*vtk_mesh(problem.V))
    for mode in case.make_solver(problem).steps():
        if mode.number in WORDS:
            grid["u"] = mode.u.x.array.reshape(-1, 3).copy()
            yield mode.number, grid.extract_surface(nonlinear_subdivision=2)


def main():
    """Three forks side by side, each in both ends of its swing."""
    found = dict(shapes())
    plot = pv.Plotter(off_screen=True, window_size=[800, 1000])
    plot.set_background("white")
    plot.enable_anti_aliasing("ssaa")
    for k, number in enumerate(WORDS):
        surface = found[number]
        for sign, opacity in ((-1, 0.15), (1, 1.0)):
            drawn = surface.copy()
            drawn.points = surface.points + sign * SWING * surface["u"] + [k * APART, 0, 0]
            drawn["swing"] = np.linalg.norm(surface["u"], axis=1)
            plot.add_mesh(
                drawn,
                scalars="swing",
                cmap=colour_map(),
                clim=[0, 1],
                opacity=opacity,
                smooth_shading=True,
                split_sharp_edges=True,
                ambient=0.5,
                diffuse=0.52,
                show_scalar_bar=False,
            )
        edges = drawn.extract_feature_edges(35, manifold_edges=False, boundary_edges=False)
        plot.add_mesh(edges, color="#303840", line_width=2.5, lighting=False)
        x, y, z = surface.points.T
        foot = [(x.min() + x.max()) / 2 + k * APART, y.min() - 0.004, (z.min() + z.max()) / 2]
        plot.add_point_labels(
            [foot],
            [f"mode {number}:\n{WORDS[number]}"],
            show_points=False,
            shape=None,
            always_visible=True,
            justification_horizontal="center",
            justification_vertical="top",
            bold=False,
            font_size=34,
            text_color="black",
        )
    plot.view_vector([0.35, 0.0, 1.0], viewup=[0, 1, 0])
    plot.enable_parallel_projection()
    plot.camera.zoom(1.2)
    plot.camera.SetWindowCenter(0.0, -0.08)
    plot.screenshot(ROOT / "docs/fork.png")


if __name__ == "__main__":
    main()
