"""NAFEMS LE10: a thick elliptic plate under pressure, held along an edge at mid-height.

Target: sigma_yy = -5.38 MPa at D = (2, 0, 0.6) m, on the upper side at the inner rim.  Source:
NAFEMS, The Standard NAFEMS Benchmarks, TNSB Rev. 3 (1990), LE10.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import Body, LinearElastic, Pressure, Probe, Problem, Statics, Support, Symmetry
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.core.units import METRE
from dolfin_elastic.mesh import EdgeSelector, Selector, name_parts
from dolfin_elastic.mesh.distribute import build_body
from dolfin_elastic.mesh.formats.raw import Block, MeshFile, RawMesh, assemble

COMM = MPI.COMM_WORLD
HEIGHT = 0.6
GRADING = 1.3
"""Exponent of the distances from D, around which the stress changes fast, in all directions."""
TARGET = -5.38e6


def quadratic_box(counts: tuple[int, int, int]) -> tuple[FloatArray, IntArray]:
    """10-node tetrahedra in the unit cube, six in each little one (Kuhn), nodes as in VTK."""
    fine = [2 * n + 1 for n in counts]
    grid = np.stack(np.meshgrid(*map(np.arange, fine), indexing="ij"), axis=-1).reshape(-1, 3)
    origins = 2 * np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1)
    cells = []
    for path in itertools.permutations(np.eye(3, dtype=int)):
        steps = 2 * np.concatenate([np.zeros((1, 3), int), np.cumsum(path, axis=0)])
        if np.linalg.det(path) < 0:
            steps[[2, 3]] = steps[[3, 2]]
        pairs = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
        nodes = np.concatenate([steps, [(steps[i] + steps[j]) // 2 for i, j in pairs]])
        at = origins.reshape(-1, 1, 3) + nodes
        cells.append((at[..., 0] * fine[1] + at[..., 1]) * fine[2] + at[..., 2])
    return grid / [2 * n for n in counts], np.concatenate(cells)


def plate(counts: tuple[int, int, int]) -> Body:
    """A quarter of the plate: from the inner to the outer ellipse, from x to y, from below to top.

    The outer face and the line at its mid-height come as sets of nodes, as in a deck of Abaqus.
    """
    s, cells = quadratic_box(counts)
    upper = counts[2] - 2  # two layers below mid-height
    below = [0, 0.25, *(1 - 0.5 * np.linspace(1, 0, upper + 1) ** GRADING)]
    layers = [np.linspace(0, 1, n + 1) ** GRADING for n in counts[:2]] + [np.array(below)]
    for j, heights in enumerate(layers):  # midside nodes stay in the middle
        s[:, j] = np.interp(s[:, j], np.linspace(0, 1, len(heights)), heights)
    angle = np.pi / 2 * s[:, 1]
    x = np.stack(
        [
            (2 + 1.25 * s[:, 0]) * np.cos(angle),
            (1 + 1.75 * s[:, 0]) * np.sin(angle),
            HEIGHT * s[:, 2],
        ],
        axis=1,
    )
    x[s[:, 1] == 1.0, 0] = 0.0
    outer = s[:, 0] == 1.0
    sets = {
        "outer": np.flatnonzero(outer),
        "line of nodes": np.flatnonzero(outer & (s[:, 2] == 0.5)),
    }

    def read() -> RawMesh:
        return assemble(MeshFile(x, [Block("tetra10", cells)], point_sets=sets), source="plate")

    body = build_body(read, comm=COMM, unit=METRE, source="plate")
    return name_parts(
        body,
        surfaces={
            "top": Selector(plane="z", at="max"),
            "along x": Selector(plane="y", at=0),
            "along y": Selector(plane="x", at=0),
        },
        edges={"line": EdgeSelector(of="outer", plane="z", at=HEIGHT / 2)},
    )


def stress_at_d(body: Body, line: str) -> tuple[float, FloatArray]:
    """sigma_yy at D [Pa], and the reaction of the line [N]."""
    problem = Problem(
        body,
        LinearElastic(E=210e9, nu=0.3),
        supports=[
            Symmetry(on="along x"),
            Symmetry(on="along y"),
            Support(on="outer", displacement=[0, 0, "free"]),
            Support(on=line, name="line", displacement=["free", "free", 0]),
        ],
        loads=[Pressure(on="top", value=1e6)],
        degree=2,
    )
    state = list(Statics(problem, steps=1).steps())[-1]
    stress = Probe(problem, {"D": [2, 0, HEIGHT]}, ["cauchy_stress"])(state)["D_cauchy_stress"]
    return float(stress[4]), np.asarray(state.reactions["line"])


def test_le10() -> None:
    """The stress at D to 1 % in 576 and in 1440 cells; the line bears the whole pressure.

    576, 1440, 2880 and 5880 cells give 1.001, 1.002, 1.004 and 1.003 of the target.  Cells must be
    fine along the rim, whose radius is 0.5 m at D, and in height, too: graded along the radius
    alone, 1536 cells give 1.015.  The line has no area to bear force, so that the deflection grows
    with every refinement, here by 1 %.  The loaded area is pi/4 (3.25 2.75 - 2 1) m^2; that of
    quadratic cells is short of it by O(h^4).
    """
    area = np.pi / 4 * (3.25 * 2.75 - 2)
    for counts in ((4, 6, 4), (6, 8, 5)):
        body = plate(counts)
        stress, reaction = stress_at_d(body, "line")
        assert reaction[2] == pytest.approx(1e6 * area, rel=8e-2 / counts[1] ** 4)
        assert stress == pytest.approx(TARGET, rel=0.01)
    by_nodes, _ = stress_at_d(body, "line of nodes")
    assert by_nodes == pytest.approx(stress, rel=1e-9)
