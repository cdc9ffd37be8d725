"""The stable step by cells and by Lanczos: never above the true one, and followed as bodies deform.

Source of the bound: see `explicit.frequency_bound`.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from helpers.matrices import dense
from mpi4py import MPI

from dolfin_elastic import (
    Contact,
    LinearElastic,
    NeoHookean,
    Problem,
    Spring,
    StVenantKirchhoff,
    Support,
    Textbook,
    box_body,
    rectangle_body,
)
from dolfin_elastic.mesh import Body
from dolfin_elastic.solvers.dynamics.explicit.explicit import Explicit
from dolfin_elastic.solvers.dynamics.explicit.scheme import SymplecticEuler
from dolfin_elastic.solvers.dynamics.explicit.stable_step import StepSize

E, RHO = 1e6, 1000.0


def march_of(problem: Problem, **settings: Any) -> Explicit:
    settings = {"end": 1.0, "dt": None, "safety": 0.9, "every": 1} | settings
    return Explicit(problem, fem.Function(problem.V), SymplecticEuler, **settings)


def true_square(march: Explicit) -> float:
    """omega_max^2 from all eigenvalues of the free body, obstacles not counted."""
    a, comm = march.assembler, march.problem.body.comm
    x = a.create_vector()
    a.get(x)
    a.tangent.invalidate()
    a.tangent.assemble(x)
    x.destroy()
    K, mass = dense(a.tangent.matrix, comm), np.concatenate(comm.allgather(march.mass))
    fixed = a.tangent.matrix.getOwnershipRange()[0] + march.problem.constraints.prescribed_dofs
    free = np.setdiff1d(np.arange(len(mass)), np.concatenate(comm.allgather(fixed)))
    scaled = (K / np.sqrt(np.outer(mass, mass)))[np.ix_(free, free)]
    return float(np.abs(np.linalg.eigvals(scaled)).max())


def shaken(body: Body, *, wild: bool) -> Body:
    """Nodes moved by up to a third of a cell, and for wild ones all pressed flat, tenfold."""
    x = body.mesh.geometry.x
    moved = 0.08 * np.sin(17 * x[:, [1, 2, 0]] + 29 * x[:, [2, 0, 1]] + 5 * x)
    x[:, : body.dim] += moved[:, : body.dim]
    if wild:
        x[:, body.dim - 1] *= 0.1
    return body


BODIES = {
    "even": lambda dim: box_body(size=(1, 1, 1)[:dim], cells=(3, 3, 3)[:dim]),
    "shaken": lambda dim: shaken(BODIES["even"](dim), wild=False),
    "flat": lambda dim: shaken(BODIES["even"](dim), wild=True),
}
MAPS = {
    "rest": np.eye(3),
    "pulled": np.diag([2.5, 0.7, 0.7]),
    "pressed": np.diag([1.3, 0.3, 1.1]),
    "sheared and turned": np.array([[0.2, -1.1, 0.1], [0.9, 0.6, 0.8], [0, 0.2, 1.2]]),
}


def deformed(problem: Problem) -> Iterator[str]:
    """Large deformations, one after the other; uneven where the law allows it."""
    dim = problem.body.dim
    x = problem.V.tabulate_dof_coordinates()[:, :dim]
    for name, F in MAPS.items():
        uneven = 0.01 * np.sin(7 * x + 3 * x[:, ::-1]) if name != "rest" else 0.0
        problem.u.x.array[:] = (x @ (F[:dim, :dim] - np.eye(dim)).T + uneven * x).ravel()
        yield name


@pytest.mark.parametrize("mesh", BODIES)
@pytest.mark.parametrize(
    ("dim", "law"),
    [
        (2, NeoHookean(E=E, nu=0.3, density=RHO)),
        (3, NeoHookean(E=E, nu=0.45, density=RHO)),
        (2, StVenantKirchhoff(E=E, nu=0.0, density=RHO)),
        (2, Textbook(E=E, nu=0.3, density=RHO)),
        (3, LinearElastic(E=E, nu=-0.3, density=RHO)),
    ],
    ids=lambda value: value if isinstance(value, int) else type(value).__name__,
)
def test_no_frequency_is_above_the_worst_cells(mesh, dim, law):
    """On good and bad meshes, at large strains, also compressed so far that modes are unstable."""
    problem = Problem(BODIES[mesh](dim), law, degree=1)
    march = march_of(problem)
    for name in deformed(problem):
        true, bound = true_square(march), march.size.cell_bound()
        assert bound > 0.999999 * true, name
        # The norm counts all modes of a cell, and neighbours do not all swing in its stiffest one.
        # 1.2 to 3.3 found; a bound of nothing would be infinite.
        assert bound < 3.5 * true, name
    march.assembler.destroy()


def test_springs_and_obstacles_count():
    """Both stiffer than the cells beside them; the obstacle before it touches."""
    found = {}
    for held in ("free", "springs", "obstacle", "both"):
        more: dict[str, Any] = {}
        if held in ("springs", "both"):
            more["supports"] = [Spring(on="left", stiffness=[1e9, 2e9])]
        if held in ("obstacle", "both"):
            floor = Contact(on="bottom", plane={"axis": "y", "at": 0.0}, stiffness=3e9)
            more["contacts"] = [floor]
        body = rectangle_body(size=(1, 1), cells=(3, 3))
        problem = Problem(body, NeoHookean(E=E, nu=0.3, density=RHO), degree=1, **more)
        x = problem.V.tabulate_dof_coordinates()
        problem.u.x.array[1::2] = 0.1 * x[:, 0]  # one corner still touches
        march = march_of(problem)
        found[held] = march.size.cell_bound()
        assert found[held] > 0.999999 * true_square(march)
        assert found[held] > march.size.largest_frequency() * (1 - 1e-6)
        march.assembler.destroy()
    # What is added is the largest row over its mass: k A/(rho V) = 2e9/(1000/3) 3/2, at corners.
    assert found["springs"] - found["free"] == pytest.approx(2e9 / RHO * 9, rel=0.5)
    assert found["both"] >= max(found["springs"], found["obstacle"])


def test_lanczos_is_never_above():
    """What is left of its equation is added to the eigenvalue: the step errs to the short side."""
    for make in BODIES.values():
        problem = Problem(make(2), NeoHookean(E=E, nu=0.3, density=RHO), degree=1)
        march = march_of(problem)
        true = true_square(march)
        # Within the tolerance that it was asked for, 1e-3.
        assert true * (1 - 1e-12) <= march.size.largest_frequency() < true * 1.01
        march.assembler.destroy()


def test_the_step_follows_a_body_that_is_crushed_and_let_go():
    """Looks by cells between two eigenvalues: safe on the way down, and up again afterwards."""
    body = shaken(rectangle_body(size=(1, 1), cells=(4, 4)), wild=False)
    problem = Problem(body, NeoHookean(E=E, nu=0.3, density=RHO), degree=1)
    march = march_of(problem)
    size, x = march.size, problem.V.tabulate_dof_coordinates()
    y = x[:, 1] - 0.5
    first, step, by_cells = size.stable, 0, 0
    for crush in [*np.linspace(0, 0.5, 40), *np.linspace(0.5, 0, 40)]:
        problem.u.x.array[1::2] = -crush * (y + 0.2 * np.sin(3 * y))
        known = size._found_at
        size.update(step, 0.0)
        by_cells += size._found_at == known
        true = 2 / np.sqrt(true_square(march))
        assert 0.9 * size.stable < true  # the step that is taken
        step += 20
    assert by_cells > 50  # of 80
    size.check_before(step)
    size.update(step, 0.0)
    assert size.stable == pytest.approx(first, rel=1e-2)
    march.assembler.destroy()


def test_bodies_without_a_bound_by_cells():
    """Where a tangent changes inside a cell, Lanczos' method is asked each time."""
    body = rectangle_body(size=(1, 1), cells=(2, 2))
    law = NeoHookean(E=E, nu=0.3, density=RHO)
    round_body = Problem(body, law, geometry="axisymmetric", degree=1)
    march = march_of(round_body)
    assert march.size.bound is None
    assert march.size.cell_bound() == np.inf
    before = march.size.stable
    march.size.update(10, 0.0)
    assert march.size.stable == pytest.approx(before, rel=1e-3)
    march.assembler.destroy()


def test_the_cell_that_asks_for_the_step_is_named(caplog):
    body = rectangle_body(size=(1, 1), cells=(4, 4))
    x = body.mesh.geometry.x
    corner = np.isclose(x[:, 0], 0.25) & np.isclose(x[:, 1], 0.25)
    x[corner, :2] = 0.05
    with caplog.at_level("INFO", logger="dolfin_elastic"):
        march_of(Problem(body, NeoHookean(E=E, nu=0.3, density=RHO), degree=1)).assembler.destroy()
    heard = body.comm.allgather(list(caplog.messages))
    said = next(m for messages in heard for m in messages if m.startswith("stable step"))
    place = said.rpartition("(")[2].partition(")")[0].split(", ")
    assert all(0.0 <= float(part) < 0.13 for part in place), said


def test_held_bodies_have_no_step_of_held_nodes():
    """Nodes that are held do not count in Lanczos' method."""
    body = rectangle_body(size=(1, 1), cells=(1, 1))
    held = Support(on="left", displacement=[0, 0])
    problem = Problem(body, LinearElastic(E=E, nu=0.3, density=RHO), supports=[held], degree=1)
    march = march_of(problem)
    assert march.size.largest_frequency() == pytest.approx(true_square(march), rel=1e-6)
    assert isinstance(march.size, StepSize)
    assert MPI.COMM_WORLD.allreduce(march.size.stable) > 0
    march.assembler.destroy()


@pytest.mark.parametrize(("drag", "square"), [(0.0, 4.0), (3.0, 4.0), (0.5, 100.0), (7.0, 0.0)])
def test_a_root_reaches_minus_one_at_the_stable_step(drag: float, square: float) -> None:
    """z^2 - (2 - h c/m - h^2 omega^2) z + 1 - h c/m, with dashpots at the old velocity."""
    looking = SimpleNamespace(_drag=drag, _viscous=0.0)
    h = StepSize.step_for(looking, square)  # type: ignore[arg-type]
    for step, inside in ((0.999 * h, True), (1.001 * h, False)):
        roots = np.roots([1.0, step * drag + step**2 * square - 2, 1 - step * drag])
        assert (roots.real >= -1).all() == inside
    assert StepSize.step_for(SimpleNamespace(_drag=0.0, _viscous=0.0), 0.0) == np.inf  # type: ignore[arg-type]
