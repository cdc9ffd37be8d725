"""Contact and friction over a time step: their work, and their tangent."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
from helpers.tangents import against_differences
from mpi4py import MPI

from dolfin_elastic import Contact, NeoHookean, Problem, box_body, rectangle_body
from dolfin_elastic.model.amplitude import CONSTANT
from dolfin_elastic.problem.term import StepWeights
from dolfin_elastic.problem.terms.contact.friction import CoulombFriction
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.audit.equilibrium import EnergyBook
from dolfin_elastic.solvers.dynamics.work import Middle

SHAPES = [
    {"plane": {"point": [0, 0.01], "normal": [0.02, 1]}},
    {"sphere": {"center": [0.5, -1.98], "radius": 2.0}},
    {"cylinder": {"point": [0.5, 1.97], "radius": 2.0, "inside": True}},
    {"box": {"center": [0.5, -0.49], "size": [0.6, 1]}},
]
TURNING = {"rotation": {"point": [0.2, -0.5], "angle": "-0.03*t"}, "motion": [0.01, "0.01*t"]}
TURNED = [
    {"plane": {"point": [0, 0.02], "normal": [0.02, 1]}, **TURNING},
    {"box": {"center": [0.5, -0.49], "size": [0.6, 1]}, **TURNING},
]


def resting(degree: int, friction: float = 0.0, **shape: object) -> Problem:
    problem = Problem(
        rectangle_body(size=(1, 1), cells=(12, 2)),
        NeoHookean(E=1e6, nu=0.3),
        contacts=[Contact(on="bottom", name="it", friction=friction, **shape)],
        degree=degree,
    )
    problem.terms.begin(moving=True)
    return problem


def step_from_here(problem: Problem, old: float, size: float) -> None:
    """A step whose start is off the present displacement; times are 0, and 1 at its end."""
    u = problem.u.x.array
    here, places = u.copy(), problem.V.tabulate_dof_coordinates()[:, : problem.body.dim]
    u += size * np.sin(17 * places[:, ::-1] + 2 * places).ravel()
    problem.set_time(0.0)
    problem.terms.begin_step()
    u[:] = here
    problem.set_time(1.0)
    problem.terms.enter_stage(StepWeights(1.0, old, old, 0.25, 0.5, 0.25), problem.terms.poses)


def name_of(shape: dict[str, object]) -> str:
    return next(iter(shape)) + "_that_turns" * ("rotation" in shape)


@pytest.mark.parametrize("shape", SHAPES + TURNED, ids=name_of)
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("old", [0.5, 0.4])
def test_work_of_a_step(old, degree, shape):
    """It is the change of the energy, to round-off; below alpha = 1/2 less comes out of it."""
    check_work(resting(degree, **shape), old)


@pytest.mark.parametrize("turns", [{}, {"point": [0, 0, -1], "axis": "y", "angle": "0.02*t"}])
@pytest.mark.parametrize("degree", [1, 2])
def test_work_of_a_step_on_triangles(degree, turns, folder, comm):
    """The same on a rigid mesh, over edges of which normals jump."""
    points = [(0, 0, 0.06), (2, 0, -0.1), (0, 2, -0.1), (-2, 0, -0.1), (0, -2, -0.1)]
    fan = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 1)]
    if comm.rank == 0:
        cells = [("triangle", np.array(fan))]
        meshio.write_points_cells(folder / "tip.stl", np.array(points, float), cells)
    comm.barrier()
    body = box_body(size=(1, 1, 1), cells=(4, 4, 1), origin=(-0.5, -0.5, 0))
    contact: dict[str, object] = {"on": "bottom", "mesh": str(folder / "tip.stl"), "name": "it"}
    if turns:
        contact["rotation"] = turns
    problem = Problem(
        body,
        NeoHookean(E=1e6, nu=0.3),
        contacts=[Contact.model_validate(contact)],
        degree=degree,
    )
    problem.terms.begin(moving=True)
    check_work(problem, 0.5)


def check_work(problem: Problem, old: float) -> None:
    """Some nodes hit within the step, some leave and some stay in contact."""
    (pair,), u, dim = problem.contact_pairs, problem.u.x.array, problem.body.dim
    assembler, comm = Assembler(problem), problem.body.comm
    u[:] = 0.05 * np.cos(9 * problem.V.tabulate_dof_coordinates()[:, :dim][:, ::-1]).ravel()
    own = assembler.size
    step_from_here(problem, old, 0.08)
    poses = [pair.contact.pose_at(t, CONSTANT, dim) for t in (0.0, 1.0)]
    pasts = zip(pair.step.past_ends(), poses, strict=True)
    start, end = ((past + pose[:, 0]).ravel() for past, pose in pasts)
    first, last = pair.end_gaps()
    forces = assembler.reactions.by_label()["it"].ravel()
    kinds = {(bool(a < 0), bool(b < 0)) for a, b in zip(first, last, strict=True)}
    assert {(True, True), (True, False), (False, True)} <= set().union(*comm.allgather(kinds))
    problem.terms.leave_stage(found=True)
    stored, book = [], EnergyBook(problem, ("contact",))
    for t, place in enumerate((start, end)):
        problem.set_time(float(t))
        u[:] = place
        stored.append(book.stored()["contact"])
    change = (end - start)[:own]
    past = change - Middle(problem).carried(pair, poses[0], change)
    work = comm.allreduce(float(forces[:own] @ past), op=MPI.SUM)
    assembler.destroy()
    off = work + stored[1] - stored[0]
    if old == 0.5:
        assert abs(off) < 1e-12 * max(stored)
    else:
        assert -0.5 * max(stored) < off < -1e-3 * max(stored)


@pytest.mark.parametrize("shape", SHAPES[:2] + TURNED[:1], ids=name_of)
@pytest.mark.parametrize("degree", [1, 2])
def test_tangent_of_a_step(degree, shape):
    """Against differences, with friction; of quadratic faces but for the square of the way."""
    problem = resting(degree, friction=0.3, **shape)
    (friction,) = (term for term in problem.terms if isinstance(term, CoulombFriction))

    def begun() -> None:
        step_from_here(problem, 0.5, 1e-3)

    with against_differences(problem, begun) as (_, off, size):
        seen = set().union(*problem.body.comm.allgather(set(friction.status().tolist())))
        assert len(seen) > 1
        assert off < (1e-7 if degree == 1 or "plane" in shape else 1e-5) * size
