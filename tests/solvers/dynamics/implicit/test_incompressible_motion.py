"""Motion of incompressible bodies: pressures of turning bodies, and which velocities there are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from mpi4py import MPI

from dolfin_elastic import (
    Dynamics,
    Growth,
    NeoHookean,
    Problem,
    rectangle_body,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.jit import compile_forms
from dolfin_elastic.solvers.assembly.assembler import integral

COMM = MPI.COMM_WORLD
RHO = 1000.0


def free_block(
    cells: tuple[int, int], size: tuple[float, float] = (1.0, 0.5), **more: Any
) -> Problem:
    """Rubber in plane strain that nothing holds, about the origin."""
    body = rectangle_body(size=size, cells=cells, origin=(-size[0] / 2, -size[1] / 2))
    law = NeoHookean(E=1e6, nu=0.5, density=RHO)
    return Problem(body, law, degree=2, formulation="mixed", **more)


def largest(values: Any) -> float:
    return float(COMM.allreduce(float(np.max(np.abs(values), initial=0.0)), op=MPI.MAX))


def spun(dt: float, radius: float) -> tuple[np.ndarray, float]:
    """Pressures of a block that begins to turn at 5/s, and the energy that came from nowhere."""
    problem = free_block((2, 1))
    unknowns = problem.unknowns
    all_of_them = np.arange(problem.W.dofmap.index_map.size_local)
    scalars = np.setdiff1d(all_of_them, unknowns.displacement_dofs)
    rows, gained = [], 0.0
    for state in Dynamics(
        problem,
        end=0.02,
        dt=dt,
        spectral_radius=radius,
        rtol=1e-10,
        initial_velocity=["-5*y", "5*x"],
    ).steps():
        rows.append(problem.w.x.array[scalars] * float(unknowns.scale["pressure"].value))
        gained = max(gained, abs(state.energies["balance"]) / state.energies["total"])
    return np.array(rows), gained


@pytest.mark.sample(1)
@pytest.mark.parametrize("radius", [1.0, 0.9])
def test_the_pressure_of_a_turning_body(radius):
    """Of second order against steps that are an eighth: 3 % and 0.7 % of the largest found.

    Where volumes are those of the stage it swings by as much as it is, with any step.
    """
    fine = 6.25e-4
    known, _ = spun(fine, radius)
    share, scale, off = radius / (1 + radius), largest(known), []
    for n in (8, 4):
        found, gained = spun(n * fine, radius)
        # Pressures are those of the stage, alpha_f of a step before the end.
        at = np.arange(1, len(found)) * n - share * n + share
        before = np.floor(at).astype(int)
        weight = (at - before)[:, None]
        there = (1 - weight) * known[before] + weight * known[before + 1]
        off.append(largest(found[1:] - there) / scale)
    assert off[0] < 0.04
    assert off[1] < 0.4 * off[0]
    # The trapezoidal rule of the volumes' work is exact to the third order of the step.
    assert gained < (1e-6 if radius == 1.0 else 1e-5)


@pytest.mark.parametrize(("cells", "near"), [(4, 0.03), (8, 8e-3)])
def test_a_velocity_that_changes_volumes_is_not_begun_with(cells, near, caplog):
    """v = (x, 0) in a square of side 1 loses grad phi, laplace phi = 1, phi = 0 at its free sides.

    That is the stress function of a square bar under torsion, whose rigidity is 0.1405770 a^4: the
    integral of |grad phi|^2 is a quarter of it.  Source: S. P. Timoshenko & J. N. Goodier, Theory
    of Elasticity (1970), article 109.  Of the energy rho/24 that is 42.17 %; quadratic in the size
    of the cells, 2.6 % off on four of them.
    """
    problem = free_block((cells, cells), (1.0, 1.0))
    with caplog.at_level("INFO", logger="dolfin_elastic"):
        motion = Dynamics(problem, end=1e-3, dt=1e-3, initial_velocity=["x", 0])
        first = next(motion.steps())
    said = [r for r in caplog.records if "does not fit volumes that cannot change" in r.message]
    assert any(COMM.allgather(bool(said)))
    assert all(record.levelname == "WARNING" for record in said)
    lost = 1 - first.energies["kinetic"] / (RHO / 24)
    assert lost == pytest.approx(12 * 0.1405770 / 4, rel=near)
    assert np.abs(first.momenta["linear"]).max() < 1e-9 * RHO


def test_a_velocity_that_fits_is_left_as_it_is(caplog):
    """A rotation and a flow with div v = 0, both exact in quadratic elements."""
    problem = free_block((2, 1))
    with caplog.at_level("INFO", logger="dolfin_elastic"):
        motion = Dynamics(problem, end=1.0, dt=0.1, initial_velocity=["x - 5*y", "5*x - y"])
        next(motion.steps())
    assert not [r for r in caplog.records if "does not fit volumes" in r.message]
    x, y = problem.V.tabulate_dof_coordinates()[:, :2].T
    v = motion.velocity.x.array.reshape(-1, 2)
    assert largest(v - np.stack([x - 5 * y, 5 * x - y], axis=1)) < 1e-7


def area(problem: Problem) -> float:
    form = ufl.det(problem.weak_form.F(problem.w)) * problem.weak_form.volume(None, 4)
    return integral(problem, compile_forms(COMM, [form], problem.jit)[0])


@pytest.mark.parametrize("rest", [False, True])
def test_a_body_that_grows(rest, caplog):
    """Its volume at each end of a step is that of the growth then.

    Thrown as fast as it grows, no force is needed: it keeps its energy, and hears of nothing.  From
    rest it is not strained evenly, and mean pressures keep no volumes: 1.4e-5 found.  Growth of
    the stage would be off by 5e-3.
    """
    problem = free_block((2, 1), loads=[Growth(value=["1 + 5*t", "1 + 5*t", 1])])
    start = {} if rest else {"initial_velocity": ["5*x", "5*y"]}
    near = 1e-4 if rest else 1e-6
    with caplog.at_level("INFO", logger="dolfin_elastic"):
        for state in Dynamics(problem, end=0.05, dt=0.005, rtol=1e-11, **start).steps():
            assert area(problem) / 0.5 == pytest.approx((1 + 5 * state.t) ** 2, rel=near)
            if not rest:
                exact = RHO / 2 * 25 * (1 + 0.5**2) / 12 * 0.5
                assert state.energies["kinetic"] == pytest.approx(exact, rel=1e-6)
    said = [r for r in caplog.records if "does not fit volumes" in r.message]
    assert any(COMM.allgather(bool(said))) == rest
    assert all(record.levelname == "INFO" for record in said)


def test_petscs_scheme_is_refused():
    with pytest.raises(InputError, match=r"dynamics\.scheme: PETSc's 'alpha2' asks for volumes"):
        Dynamics(free_block((1, 1)), scheme="alpha2", end=1.0, dt=0.1)
