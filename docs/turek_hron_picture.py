"""Draws docs/turek_hron.png: the flag of demos/turek_hron at four moments, and its tip over 10 s.

docker/run python3 docs/turek_hron_picture.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from dolfinx.plot import vtk_mesh

from dolfin_elastic import read_case
from dolfin_elastic.case.case import Case
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.probes import Probe
from dolfin_elastic.results.scene.colour_bar import colour_map

ROOT = Path(__file__).resolve().parent.parent
MOMENTS = (0.0, 0.15, 0.25, 0.455)
PUBLISHED = (-63.607, 65.160)
BLUE, GREY = "#1f5fa8", "#8a8f98"
PIECES = [(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)]
"""Triangles between the nodes of VTK's quadratic one."""


def swing():
    """The shapes with their stress at the moments, and rows of time and u_y of A [mm]."""
    folder = ROOT / "demos/turek_hron"
    tables = read_case(folder / "case.toml").to_dict()
    tables["dynamics"] |= {"end": 10.0}
    case = Case.from_dict(tables, folder=folder)
    problem = case.make_problem(case.read_body())
    probe, stress = Probe(problem, {"A": [0.6, 0.2]}), Evaluator(problem, ["von_mises_nodal"])
    shapes, rows = [], []
    for state in case.make_solver(problem).steps():
        rows.append((state.t, 1e3 * probe.numbers(state)["A_y"]))
        if any(abs(state.t - moment) < 1e-9 for moment in MOMENTS):
            u = state.u.x.array.reshape(-1, 2).copy()
            shapes.append((state.t, u, stress(state)["von_mises_nodal"][:, 0] / 1e3))
    return problem, shapes, np.array(rows)


def draw(problem, shapes, rows):
    """The flag above, the curve below."""
    figure, (top, below) = plt.subplots(
        2, 1, figsize=(9, 7.2), height_ratios=[1.5, 1], layout="constrained"
    )
    cells, _, x = vtk_mesh(problem.V)
    pieces = cells.reshape(-1, 7)[:, 1:][:, PIECES].reshape(-1, 3)
    largest = max(values.max() for _, _, values in shapes)
    for t, u, values in shapes:
        places = x[:, :2] + u
        painted = top.tripcolor(
            *places.T, pieces, values, cmap=colour_map(), vmin=0, vmax=largest, shading="gouraud"
        )
        tip = places[np.argmin(np.linalg.norm(x[:, :2] - [0.6, 0.21], axis=1))]
        top.annotate(f"{t:g} s", tip, (4, 0), textcoords="offset points", fontsize=9)
    top.add_patch(plt.Circle((0.2, 0.2), 0.05, color=GREY))
    top.set(xlim=(0.13, 0.66), ylim=(0.04, 0.27), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    figure.colorbar(painted, ax=top, label="von Mises stress [kPa]", shrink=0.8)
    middle, half = PUBLISHED
    below.axhspan(middle - half, middle + half, color=GREY, alpha=0.15, lw=0)
    below.plot(*rows.T, color=BLUE, lw=1.4)
    below.text(
        10.0,
        middle - half - 3,
        "published extremes of the last period",
        ha="right",
        va="top",
        fontsize=9,
    )
    below.set(
        xlim=(0, 10), ylim=(-150, 12), xlabel="t [s]", ylabel="height of the tip, $u_y(A)$ [mm]"
    )
    for axes in (top, below):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(ROOT / "docs/turek_hron.png", dpi=130)


if __name__ == "__main__":
    draw(*swing())
