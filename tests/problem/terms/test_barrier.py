"""Contact of surfaces with themselves: forces, energies, steps, friction, restarts, messages."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from helpers.barriers import usable_ipctk
from helpers.stacked import grid, stacked
from helpers.tangents import against_differences
from mpi4py import MPI

from dolfin_elastic import (
    Contact,
    Dynamics,
    Fixed,
    Gravity,
    NeoHookean,
    Problem,
    SelfContact,
    Statics,
    Support,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.mesh import Body
from dolfin_elastic.mesh.distribute import make_mesh
from dolfin_elastic.mesh.geometry.simplices import (
    boundary_facets,
    cell_corners,
    facet_nodes,
    signed_volumes,
)
from dolfin_elastic.model.amplitude import CONSTANT
from dolfin_elastic.problem.state import State, StateCopy
from dolfin_elastic.problem.terms.bodies.barrier import Barrier
from dolfin_elastic.solvers.assembly.energy_momentum import NodalMass
from dolfin_elastic.solvers.audit.equilibrium import EnergyBook
from dolfin_elastic.solvers.dynamics.implicit.gain import GainRemoval
from dolfin_elastic.solvers.dynamics.residual import DynamicResidual
from dolfin_elastic.solvers.dynamics.work import EnergyBalance

ipctk = usable_ipctk()

MESHES: dict[int, dict[str, Any]] = {
    2: {"size": (1.0, 1.0), "lower": (3, 2), "upper": (4, 2)},
    3: {"size": (1.0, 1.0, 1.0), "lower": (2, 2, 1), "upper": (2, 1, 1)},
}
RUBBER = NeoHookean(E=1e5, nu=0.3, density=1000.0)
G = 9.81


def blocks(dim: int, degree: int, *, gap: float = 0.02, fixed: bool = True, **keys: Any) -> Problem:
    """A block above another one; their skins may touch."""
    return Problem(
        stacked(**MESHES[dim], gap=gap, shift=0.05, width=0.8),
        RUBBER,
        degree=degree,
        supports=[Fixed(on="bottom")] if fixed else [],
        loads=[Gravity(value=[*[0.0] * (dim - 1), -G])] if fixed else [],
        contacts=[SelfContact(all=True, name="skin", **keys)],
    )


def barrier(problem: Problem) -> Barrier:
    return next(term for term in problem.terms if isinstance(term, Barrier))


def press(problem: Problem, gap: float) -> None:
    """Brings the upper block down to a gap, and deforms both a little."""
    x, dim = problem.places, problem.body.dim
    u = problem.u.x.array.reshape(-1, dim)
    above = x[:, dim - 1] > 0.51
    u[:, dim - 1] += np.where(above, gap - 0.02, 0.0)
    u += 0.002 * np.sin(4 * x[:, :dim] + x[:, [0]])
    problem.unknowns.u_to_w()


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("degree", [1, 2])
def test_forces_are_those_of_the_energy_and_balance(dim, degree):
    """Each pair pushes both its partners alike: to round-off. The slope: second order in 1e-6."""
    problem = blocks(dim, degree)
    press(problem, 0.01)
    term, comm = barrier(problem), problem.body.comm
    forces = np.zeros(len(problem.u.x.array))
    term.add_forces(forces)
    sums = comm.allreduce(forces.reshape(-1, dim).sum(axis=0))
    size = comm.allreduce(float(np.abs(forces).sum()))
    assert size > 1.0
    np.testing.assert_allclose(sums / size, 0.0, atol=1e-13)

    way = np.cos(3 * problem.places[:, :dim]).ravel()
    energies = []
    for step in (1e-6, -2e-6):
        problem.u.x.array[:] += step * way
        energies.append(term.energy())
    problem.u.x.array[:] += 1e-6 * way
    size = problem.V.dofmap.index_map.size_local * dim
    work = comm.allreduce(float(forces[:size] @ way[:size]))
    assert (energies[1] - energies[0]) / 2e-6 == pytest.approx(work, rel=1e-5)


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_the_tangent_is_that_of_differences(friction):
    """Once steps are short it is exact; with friction too, in whose law limits are lagged."""
    problem = blocks(2, 2, fixed=False, friction=friction)

    def prepare() -> None:
        u = problem.u.x.array
        now = u.copy()
        u.reshape(-1, 2)[problem.places[:, 1] > 0.51, 0] -= 1e-3
        for term in problem.terms:
            term.advance()
            term.set_time(0.01, CONSTANT)
        u[:] = now
        barrier(problem).longest_step(np.zeros(len(u)))

    with against_differences(problem, prepare) as (_, off, size):
        assert off < 1e-6 * size


def test_the_tangent_is_made_semidefinite_where_it_leads_up():
    """Its least eigenvalue: of a gap that may turn it is negative, then round-off of the largest.

    The pairs of each rank by themselves.
    """
    problem = blocks(2, 1)
    press(problem, 0.01)
    term = barrier(problem)
    term.longest_step(np.zeros(len(problem.u.x.array)))

    def eigenvalues() -> np.ndarray:
        pairs, size = term.blocks(), 2 * len(term.surface.nodes)
        rows, columns = (
            np.searchsorted(term.surface.nodes, n) for n in (pairs.rows, pairs.columns)
        )
        K = np.zeros((size, size))
        for i, j, block in zip(rows, columns, pairs.values, strict=True):
            K[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] += block
        every = problem.body.comm.allgather(np.linalg.eigvalsh(K))
        return np.concatenate(every)

    exact = eigenvalues()
    assert exact.min() < -1e-4 * exact.max()
    assert term.make_convex()
    assert not term.make_convex()
    convex = eigenvalues()
    assert convex.min() > -1e-13 * convex.max()


@pytest.mark.parametrize(("dim", "degree"), [(2, 1), (2, 2), (3, 1)])
def test_a_block_falls_on_another(dim, degree):
    """Nothing intersects at any state, no energy appears, and Newton's method needs few steps."""
    problem = blocks(dim, degree)
    term, energies, nearest = barrier(problem), [], []
    for state in Dynamics(problem, end=0.12, dt=4e-3).steps():
        places = term.surface.places()
        assert not ipctk.has_intersections(term.surface.mesh, places)
        assert state.newton <= 30
        energies.append(state.energies["total"] + state.energies["potential"])
        nearest.append(state.numbers["smallest_distance_skin"])
    assert min(nearest) < 0.95 * term.reach
    # Implicit Euler loses energy; what a step gains is round-off of its equations, 1e-8.
    assert max(np.diff(energies)) <= 1e-6 * np.ptp(energies)


def test_sliding_over_teeth_makes_no_energy():
    """Where a tooth jumps over another one the barrier alone would make 2.5 % of it in a step."""
    body = stacked(size=(1.0, 1.0), lower=(9, 2), upper=(4, 2), gap=0.08, shift=0.05, width=0.5)
    x = body.mesh.geometry.x
    under, over = (np.abs(x[:, 1] - y) < 1e-9 for y in (0.5, 0.58))
    x[under, 1] -= 0.04 * (np.round(9 * x[under, 0]) % 2)
    x[over, 1] += 0.04 * (np.round(8 * (x[over, 0] - 0.05)) % 2 == 0)
    problem = Problem(
        body,
        RUBBER,
        supports=[Fixed(on="bottom")],
        loads=[Gravity(value=[0.0, -G])],
        contacts=[SelfContact(all=True, name="skin")],
    )
    v = ["where(y > 0.53, 3, 0)", "0"]
    states = list(Dynamics(problem, end=0.4, dt=0.02, initial_velocity=v).steps())
    energies = [s.energies["total"] + s.energies["potential"] for s in states]
    assert max(np.diff(energies)) <= 1e-12 * np.ptp(energies)
    assert min(s.numbers["smallest_distance_skin"] for s in states) < barrier(problem).reach


@pytest.mark.parametrize("dim", [2, 3])
def test_a_gain_is_taken_out_without_a_change_of_momenta(dim):
    """Of two bodies that touch, linear and angular ones: up to round-off."""
    problem = blocks(dim, 1, fixed=False)
    press(problem, 0.01)
    moving, v = DynamicResidual(problem), fem.Function(problem.V)
    mass, book = NodalMass(problem, v, moving.inertia.mass.times), EnergyBook(problem, ("contact",))
    removal = GainRemoval(moving, book, EnergyBalance(moving, v), v)
    x = problem.places[:, :dim]
    v.x.array[:] = (np.cos(3 * x) - 0.2 * x[:, ::-1]).ravel()
    contact = moving.contact_forces()
    square = problem.body.comm.allreduce(float(np.sum(contact**2)))
    removal.begin()
    slow = mass.measure()[0]
    v.x.array[:] *= 1.5
    fast = mass.measure()
    assert not removal.end(contact, 0.0 * contact[0])  # the barrier has no part in it
    v.x.array[:] /= 1.5
    removal.begin()
    v.x.array[:] *= 1.5
    gain = 0.25 * (fast[0] - slow)
    assert removal.end(contact, gain / square * contact[0])
    after = mass.measure()
    assert after[0] == pytest.approx(fast[0] - gain, rel=1e-12)
    for now, before in zip(after[1:], fast[1:], strict=True):
        np.testing.assert_allclose(now, before, rtol=0, atol=1e-12 * np.abs(before).max())
    moving.destroy()


def upper_momentum(problem: Problem, v: np.ndarray) -> np.ndarray:
    """Of the upper block, of linear elements [kg m/s]."""
    body = problem.body
    cells = body.owned_cells("upper")
    volumes = np.abs(signed_volumes(cell_corners(body.mesh, cells)))
    rows = v.reshape(-1, body.dim)[problem.V.dofmap.list[cells]].mean(axis=1)
    return np.asarray(body.comm.allreduce(1000.0 * volumes @ rows))


def test_friction_is_the_coefficient_times_the_push():
    """A block that bounces off another in sliding: impulses, when it is over.

    Limits are those of a step ago, so the sums over all steps agree; what does not is the turn of
    the faces within a step.
    """
    problem = blocks(2, 1, gap=0.03, fixed=False, friction=0.3)
    v = ["where(y > 0.51, 0.4, 0)", "where(y > 0.51, -0.1, 0)"]
    momenta, numbers, lost = [], [], []
    for state in Dynamics(problem, end=0.3, dt=2e-3, initial_velocity=v).steps():
        momenta.append(upper_momentum(problem, state.v.x.array))
        numbers.append(state.numbers["smallest_distance_skin"])
        lost.append(state.energies["friction"])
    change = np.diff(np.array(momenta)[[0, -1]], axis=0)[0]
    assert numbers[-1] == barrier(problem).reach
    assert change[1] > 10.0
    assert -change[0] == pytest.approx(0.3 * change[1], rel=0.01)
    assert lost[-1] > 0.0
    assert min(np.diff(lost)) >= 0.0


def test_a_run_goes_on():
    """From a state on the way, with another problem, as if it had not ended: bodies that stick."""

    def begun() -> Dynamics:
        problem = Problem(
            stacked(**MESHES[2], gap=0.012, shift=0.05, width=0.8),
            RUBBER,
            supports=[Fixed(on="bottom")],
            loads=[Gravity(value=[0.2 * G, -G])],
            contacts=[SelfContact(all=True, name="skin", friction=0.8)],
        )
        return Dynamics(problem, end=0.07, dt=0.01)

    whole = [(state.u.x.array.copy(), state.energies) for state in begun().steps()]
    first = begun()
    for count, _ in enumerate(first.steps()):
        if count == 4:
            saved = StateCopy(first.restart_state())
            break
    rest = [(state.u.x.array.copy(), state.energies) for state in begun().steps(saved)]
    assert len(rest) == len(whole) - 5
    assert whole[5][1]["friction"] > whole[4][1]["friction"] > 0.0
    for again, before in zip(rest, whole[5:], strict=True):
        np.testing.assert_allclose(again[0], before[0], rtol=0, atol=1e-14)
        assert again[1] == pytest.approx(before[1], rel=1e-10)


@pytest.mark.parametrize("scheme", ["implicit-euler", "newmark"])
def test_momentum_is_that_of_before(scheme):
    """Two blocks that fly at each other: linear momentum to round-off of Newton's method.

    The trapezoidal rule makes energy in the barrier, 2 %, and in the strains, 1e-4.
    """
    problem = blocks(2, 1, fixed=False, friction=0.3)
    v = ["where(y > 0.51, 0.3, 0)", "where(y > 0.51, -1, 0)"]
    states = list(Dynamics(problem, end=0.08, dt=4e-3, initial_velocity=v, scheme=scheme).steps())
    balance = [state.energies["balance"] for state in states]
    assert max(np.diff(balance)) < 2e-4 * states[0].energies["total"]
    momenta = np.array([state.momenta["linear"] for state in states])
    assert min(state.numbers["smallest_distance_skin"] for state in states) < barrier(problem).reach
    np.testing.assert_allclose(momenta, momenta[:1].repeat(len(momenta), 0), atol=1e-6 * 400)


def hairpin() -> Body:
    """A strip bent by half a turn: its arms 4 long, 0.2 thick and 0.3 apart."""
    arm, gap, thick = 4.0, 0.3, 0.2
    points, cells = grid((1.0, 1.0), (40, 2))
    first = MPI.COMM_WORLD.rank == 0
    body = Body(
        make_mesh(MPI.COMM_WORLD, *(part[: first * len(part)] for part in (cells, points)), 1)
    )
    x, facets = body.mesh.geometry.x, boundary_facets(body.mesh)
    at = x[facet_nodes(body.mesh, facets)]
    sides = {"outer": at[:, :, 1] == 0.0, "inner": at[:, :, 1] == 1.0, "hand": at[:, :, 0] == 1.0}
    outer, inner, hand = (np.all(on, axis=1) for on in sides.values())
    early, late = (at[:, :, 0].mean(axis=1) < 0.4, at[:, :, 0].mean(axis=1) > 0.6)
    mean = (gap + thick) / 2
    along = x[:, 0] * (2 * arm + np.pi * mean)
    turn, r = np.clip((along - arm) / mean, 0.0, np.pi), mean + thick * (0.5 - x[:, 1])
    straight = np.minimum(arm, np.minimum(along, 2 * arm + np.pi * mean - along))
    x[:, 0], x[:, 1] = straight + r * np.sin(turn), -r * np.cos(turn)
    return body.named(
        surfaces={
            "foot": facets[outer & early],
            "lower": facets[inner & early],
            "upper": facets[inner & late],
            "hand": facets[hand],
        }
    )


def test_a_strip_is_folded_onto_itself():
    """Its end is pressed down: the force is that of contact between its arms, a distance apart.

    Distances differ by a fifth along the contact, and with them the force by 8 %: 2.2 % remain if
    all are the smallest.
    """
    body, distance = hairpin(), 0.005

    def end(contact: SelfContact | Contact) -> tuple[Problem, list[State]]:
        supports = [Fixed(on="foot"), Support(on="hand", displacement=[0.0, -0.31])]
        problem = Problem(body, RUBBER, supports=supports, contacts=[contact])
        states = []
        for state in Statics(problem, steps=4).steps():
            states.append(state)
            for term in problem.terms:
                if isinstance(term, Barrier):
                    assert not ipctk.has_intersections(term.surface.mesh, term.surface.places())
        return problem, states

    _, states = end(SelfContact(all=True, name="skin", distance=distance))
    least = states[-1].numbers["smallest_distance_skin"]
    assert 0.7 * distance < least < 0.9 * distance
    assert sum(state.newton for state in states) <= 30
    _, others = end(Contact(between=["lower", "upper"], interference=least))
    force, other = states[-1].reactions["hand"], others[-1].reactions["hand"]
    assert force[1] == pytest.approx(other[1], rel=0.03)


def test_a_motion_starts_from_rest_in_contact():
    """What presses at t = 0 is in equilibrium then: up to round-off nothing moves."""
    problem = Problem(
        stacked(**MESHES[2], gap=0.002, shift=0.05, width=0.8),
        RUBBER,
        supports=[Fixed(on=["bottom", "top"])],
        loads=[Gravity(value=[0.0, -G])],
        contacts=[SelfContact(all=True, name="skin", distance=0.01)],
    )
    states = list(Dynamics(problem, end=0.02, dt=5e-3, preload=True).steps())
    assert states[0].numbers["smallest_distance_skin"] < 0.0095
    assert (
        max(state.energies["kinetic"] for state in states) < 1e-20 * states[-1].energies["strain"]
    )


def test_parts_of_a_sliver_do_not_repel_each_other():
    """A vertex that is close to the next face from the start: elements lie between them."""
    problem = blocks(2, 1, distance=0.3)
    term = barrier(problem)
    assert term.reach == 0.3
    places = term.surface.rest
    least = term.pairs_at(places)
    first = least.compute_minimum_distance(term.surface.mesh, places) if len(least) else 4e-4
    assert problem.body.comm.allreduce(first, op=MPI.MIN) == pytest.approx(0.02**2, rel=1e-9)


@pytest.mark.parametrize(("dim", "degree"), [(2, 1), (2, 2), (3, 1)])
def test_it_names_the_faces_that_meet_at_the_start(dim, degree):
    """By their reference places and regions; which ones they are depends on the numbering."""
    with pytest.raises(InputError, match="'skin' passes through itself at the start") as error:
        [*Dynamics(blocks(dim, degree, gap=-0.01), end=1.0, dt=0.1).steps()]
    assert error.value.where == "contact[0]"
    found = re.search(
        r"faces of '(\w+)' at \((.*)\) m and of '(\w+)' at \((.*)\) m meet", str(error.value)
    )
    assert found is not None
    assert {found[1], found[3]} == {"lower", "upper"}
    places = [np.array([float(x) for x in found[k].split(", ")])[:dim] for k in (2, 4)]
    assert abs(places[0][-1] - 0.5) < 0.3
    assert np.linalg.norm(places[0] - places[1]) < 0.9  # their edges are up to 0.7 long


def test_it_is_refused_by_name():
    with pytest.raises(InputError, match="in motion only") as error:
        Statics(blocks(2, 1, friction=0.3))
    assert error.value.where == "contact[0].friction"
    with pytest.raises(InputError, match="arc length"):
        contacts = [SelfContact(all=True)]
        held = Problem(hairpin(), RUBBER, supports=[Fixed(on="foot")], contacts=contacts)
        [*Statics(held, method="arc-length").steps()]
    with pytest.raises(InputError, match="generalized-alpha") as error:
        Dynamics(blocks(2, 1), end=1.0, dt=0.1, scheme="generalized-alpha")
    assert error.value.where == "dynamics.scheme"
    with pytest.raises(InputError, match="symplectic-euler"):
        Dynamics(blocks(2, 1), end=1.0, dt=0.1, scheme="symplectic-euler")
    with pytest.raises(InputError, match="unknown key 'intersection_free'; .* self = "):
        Contact(between=["below", "above"], intersection_free=True)
    with pytest.raises(InputError, match="no name is given"):
        SelfContact(friction=0.3)
    with pytest.raises(InputError, match="both names and all"):
        SelfContact(on="skin", all=True)
    with pytest.raises(InputError, match="on: a surface that may touch itself is given twice"):
        SelfContact(**{"on": "skin", "self": "top"})
    with pytest.raises(InputError, match="self: true is no name of a surface"):
        SelfContact(**{"self": True})
    with pytest.raises(InputError, match="on: no name is given.*`self` or `all`"):
        Contact(friction=0.3)
