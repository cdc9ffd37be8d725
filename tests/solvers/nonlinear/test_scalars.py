"""Scalar unknowns beside the fields: pressures of cavities, motions of rigid surfaces."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.bodies import turned
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic import (
    Cavity,
    Dynamics,
    LinearElastic,
    NeoHookean,
    NeoHookeanSplit,
    Normal,
    Pressure,
    Problem,
    Rigid,
    Rotation,
    Statics,
    StVenantKirchhoff,
    Support,
    Traction,
    box_body,
    read_body,
    rectangle_body,
)
from dolfin_elastic.case.case import Case
from dolfin_elastic.core.errors import ConvergenceError, InputError
from dolfin_elastic.model.amplitude import PROPORTIONAL, RAMP
from dolfin_elastic.problem.constraints.rigid_motion import cross_matrix, rotation, tangent
from dolfin_elastic.problem.terms.cavities import BodyCavity
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.nonlinear.bordered import Bordered, JoinedScalars
from dolfin_elastic.solvers.nonlinear.newton import scalar_unknowns
from dolfin_elastic.solvers.statics.arc_length import ArcLengthConstraint
from dolfin_elastic.solvers.statics.load_stepping import InitialGuess

FREE = "free"


def strip(length, thick, cells, **plate):
    """A strip along x, held at the left, with a rigid plate at its right end."""
    return Problem(
        rectangle_body(size=(length, thick), cells=cells, origin=(0.0, -thick / 2)),
        StVenantKirchhoff(E=1e6, nu=0.0),
        degree=2,
        supports=[Support(on="left", displacement=[0, 0]), Rigid(on="right", **plate)],
    )


# --- rigid surfaces ---


def test_a_strip_rolls_up_under_a_pure_moment():
    """M L/(EI) = pi/2 makes a quarter circle of radius 2 L/pi (Euler's elastica).

    What a solid adds is (h/L)^2 = 4e-4 times numbers near one.
    """
    L, h, E = 1.0, 0.02, 1e6
    M = np.pi / 2 * E * h**3 / 12 / L
    problem = strip(L, h, (16, 1), force=[0, 0], moment=M)
    *_, state = Statics(problem).steps()
    n, R = state.numbers, L / (np.pi / 2)
    found = [n["right_ux"] + L, n["right_uy"], n["right_rz"] / (np.pi / 2)]
    assert found == pytest.approx([R, R, 1.0], abs=5e-4)
    assert state.audit.verdict == "pass", state.audit.reasons
    # Equilibrium of the plate, to Newton's tolerance.
    assert n["moment_right_z"] == pytest.approx(M, rel=1e-6)
    assert np.linalg.norm(state.reactions["right"]) < 1e-6 * M / L


def test_newton_is_quadratic_with_scalars():
    """Forces out of balance are squared from one iteration to the next."""
    L, h, E = 1.0, 0.1, 1e6
    problem = strip(L, h, (6, 1), force=[0, 0], moment=0.3 * E * h**3 / 12 / L)
    *_, state = Statics(problem, steps=2, atol=1e-12, rtol=1e-14).steps()
    r = np.array(state.residuals)
    r = r[-3:]  # the last is above round-off still
    orders = np.log(r[2] / r[1]) / np.log(r[1] / r[0])
    assert orders > 1.7, state.residuals


@pytest.mark.long
def test_force_on_a_plate_is_the_traction_it_stands_for():
    """A plate moves alike whether its force is its own or comes as traction on its surface."""
    h, F = 0.2, np.array([3.0, -20.0, 10.0])
    found = []
    for loads, force in (
        ((), F.tolist()),
        ([Traction(on="right", value=(F / h**2).tolist())], [0, 0, 0]),
    ):
        problem = Problem(
            box_body(size=(1.0, h, h), cells=(4, 1, 1)),
            NeoHookean(E=1e5, nu=0.3),
            supports=[Support(on="left"), Rigid(on="right", force=force, moment=[0, 0, 0])],
            loads=loads,
            degree=1,
        )
        *_, state = Statics(problem, steps=1).steps()
        found.append(state)
    # Newton's tolerance, 1e-8 of the forces, for what bends a hundred times as easily.
    one, other = (
        [s.numbers[f"right_{k}"] for k in ("ux", "uy", "uz", "rx", "ry", "rz")] for s in found
    )
    assert one == pytest.approx(other, rel=1e-6, abs=1e-9)
    assert found[0].reactions["right"] == pytest.approx(F, rel=1e-7)
    assert found[0].reactions["left"] == pytest.approx(-F, rel=1e-6)
    assert found[1].reactions["right"] == pytest.approx(np.zeros(3), abs=1e-6)


def test_moment_and_rotation_are_a_pair():
    """What a prescribed turn needs as moment turns the plate as far; about a slanted axis, too."""
    body = box_body(size=(1.0, 0.4, 0.3), cells=(3, 1, 1))
    law = NeoHookean(E=1e5, nu=0.3)
    turn = [0.5, -0.2, 0.4]
    held = Problem(
        body,
        law,
        supports=[Support(on="left"), Rigid(on="right", rotation=turn, force=[0, 0, 0])],
        degree=1,
    )
    *_, first = Statics(held, steps=2).steps()
    motion = held.constraints.rigid_motions[0]
    spins = tangent(np.array(turn))
    vector = np.array([first.numbers[f"moment_right_{x}"] for x in "xyz"])
    free = Problem(
        body,
        law,
        supports=[
            Support(on="left"),
            Rigid(on="right", force=[0, 0, 0], moment=(spins.T @ vector).tolist()),
        ],
        degree=1,
    )
    *_, second = Statics(free, steps=2).steps()
    assert motion.names == ["ux", "uy", "uz", "rx", "ry", "rz"]
    for name in motion.names:
        # Newton's tolerance of both runs.
        value = first.numbers[f"right_{name}"]
        assert second.numbers[f"right_{name}"] == pytest.approx(value, rel=1e-6, abs=1e-8)


def test_rotation_vectors():
    """The spin of a rotation vector's change, against differences, also near zero."""
    for theta in (np.array([0.7, -1.1, 0.4]), np.array([1e-6, 2e-6, -1e-6])):
        R, T = rotation(theta), tangent(theta)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
        for i, e in enumerate(np.eye(3)):
            h = 1e-6
            dR = (rotation(theta + h * e) - rotation(theta - h * e)) / (2 * h)
            # Of central differences: h^2 and round-off over h.
            assert dR @ R.T == pytest.approx(cross_matrix(T[:, i]), abs=1e-9)
    quarter_turn = rotation(np.array([0, 0, np.pi / 2]))
    assert quarter_turn @ [1, 0, 0] == pytest.approx([0, 1, 0], abs=1e-15)


@pytest.mark.parametrize("dim", [2, 3])
def test_moments_balance_where_an_oblique_support_meets_a_plate(dim):
    """The slanted roller has no node but those that the plates take over.

    So the plates alone hold the body, and their forces and moments balance as those of the audit.
    """
    make = box_body if dim == 3 else rectangle_body
    body = make(size=(1.0, 0.8, 0.6)[:dim], cells=(1, 2, 1)[:dim])
    turned(body, [0.2, 0.3, 1.0] if dim == 3 else [0, 0, 1], 0.5)
    law = NeoHookean(E=1.0, nu=0.3)
    moved = {"displacement": [0.1, 0.05, 0.02][:dim], "rotation": [0.1, 0.2, 0.3][-(2 * dim - 3) :]}
    problem = Problem(
        body,
        law,
        supports=[Normal(on="bottom"), Rigid(on="left"), Rigid(on="right", **moved)],
        degree=1,
    )
    *_, state = Statics(problem, steps=1).steps()
    assert state.audit.verdict == "pass"
    left, size = np.zeros(3), 0.0
    for motion in problem.constraints.rigid_motions:
        force, moment = np.zeros(3), np.zeros(3)
        force[:dim] = state.reactions[motion.label]
        for i, axis in enumerate("xyz"):
            moment[i] = state.numbers.get(f"moment_{motion.label}_{axis}", 0.0)
        left += moment + np.cross(motion.place(1.0, RAMP), force)
        size += float(np.linalg.norm(moment))
    assert size > 1e-2
    # Newton's tolerance.
    assert np.linalg.norm(left) < 1e-7 * size


def two_squares(folder):
    """Squares of 1 m, half a metre apart: surfaces left, inner (both that face) and right."""
    geo = folder / "two.geo"
    if MPI.COMM_WORLD.rank == 0:
        geo.write_text("""
SetFactory("OpenCASCADE");
Rectangle(1) = {0, 0, 0, 1, 1};
Rectangle(2) = {1.5, 0, 0, 1, 1};
Physical Curve("left") = {4};
Physical Curve("inner") = {2, 8};
Physical Curve("right") = {6};
Physical Surface("both") = {1, 2};
""")
    MPI.COMM_WORLD.barrier()
    return read_body(geo, size=0.5)


def test_a_plate_that_is_turned_is_a_rotation():
    """With every component given it is that support, in motion, too."""
    body = box_body(size=(1.0, 0.4, 0.3), cells=(2, 1, 1))
    law = NeoHookean(E=1e5, nu=0.3, density=1e3)
    found = []
    for plate in (
        Rigid(on="right", rotation=[0, 0, "0.4*t"], displacement=["0.1*t", 0, 0], point=[1, 0, 0]),
        Rotation(
            on="right", axis=[0, 0, 1], angle="0.4*t", displacement=["0.1*t", 0, 0], point=[1, 0, 0]
        ),
    ):
        held = [Support(on="left"), plate]
        *_, state = Statics(Problem(body, law, supports=held, degree=1), steps=1).steps()
        *_, moving = Dynamics(
            Problem(body, law, supports=held, degree=1), end=0.02, dt=0.01
        ).steps()
        found.append(
            [state.energies["strain"], moving.energies["strain"], *state.reactions["right"]]
        )
    # Newton's tolerance.
    assert found[0] == pytest.approx(found[1], rel=1e-7, abs=1e-8)


def test_a_plate_holds_two_bodies_together(folder):
    """One body is held, the other by the plate only: springs in series."""
    two = two_squares(folder)
    plate = Rigid(on="inner", force=[0, 0], moment=0, name="plate")
    pull = Traction(on="right", value=[1e-3, 0])
    law = StVenantKirchhoff(E=1.0, nu=0.0)
    held = Support(on="left", displacement=[0, 0])
    problem = Problem(two, law, supports=[held, plate], loads=[pull], degree=1)
    *_, state = Statics(problem, steps=1).steps()
    # Of each body 1e-3 L/E, with an error of the strain's size.
    assert state.numbers["plate_ux"] == pytest.approx(1e-3, rel=2e-3)
    assert state.max_displacement == pytest.approx(2e-3, rel=2e-3)
    loose = Problem(two, law, supports=[plate], loads=[pull], degree=1)
    with pytest.raises(InputError, match="move and turn freely"):
        _ = [*Statics(loose).steps()]


def test_hinged_column_buckles_at_eulers_load():
    """Both ends turn freely: P = pi^2 EI/L^2, below which the column is stable and above not.

    Compression and shear change it by less than pi^2/12 (h/L)^2 times 4, 0.3 %.
    """
    L, h, E = 1.0, 0.03, 1e6
    P = 1.04 * np.pi**2 * E * h**3 / 12 / L**2
    body = rectangle_body(size=(L, h), cells=(12, 1), origin=(0.0, -h / 2))
    problem = Problem(
        body,
        StVenantKirchhoff(E=E, nu=0.0),
        degree=2,
        supports=[
            Rigid(on="left", displacement=[0, 0], rotation=FREE),
            Rigid(on="right", displacement=[FREE, 0], rotation=FREE, force=[-P, 0]),
        ],
    )
    run = Statics(problem, snap=False, times=[0.98 / 1.04], min_step=0.02)
    found = []
    with pytest.raises(ConvergenceError):
        for state in run.steps():
            found.append((1.04 * state.load_factor, state.negative))
    assert {negative for _, negative in found[1:]} == {0}
    # The last step below is at most twice 0.02 of a quarter of the load.
    assert 0.98 <= found[-1][0] <= 1.003


@pytest.mark.parametrize(
    ("plate", "said"),
    [
        ({"rotation": FREE, "point": [0, 0]}, "turn about"),
        ({"displacement": [FREE, 0]}, "move along x"),
        ({"force": [0, 0], "moment": 0}, "move and turn freely"),
    ],
)
def test_a_rigid_surface_holds_only_what_is_not_free(plate, said):
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2), origin=(0.0, -0.5))
    problem = Problem(
        body, NeoHookean(E=1.0, nu=0.3), supports=[Rigid(on="left", **plate)], degree=1
    )
    with pytest.raises(InputError, match=said):
        _ = [*Statics(problem).steps()]


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"displacement": [0, 0], "force": [1, 0]}, r"force\[0\].*prescribed"),
        ({"rotation": "0.1*x"}, "rotation: unknown name 'x'"),
        ({"displacement": [0, 0, 0]}, "3 components given"),
        ({"moment": [1, 2, 3]}, "3 components given"),
        ({"point": [0, "frree"]}, "point"),
        ({"rotaton": 1}, "rotation"),
    ],
)
def test_wrong_rigid_surfaces(keys, said):
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    with pytest.raises(InputError, match=said):
        Problem(body, NeoHookean(E=1.0, nu=0.3), supports=[Rigid(on="left", **keys)], degree=1)


# --- cavities ---


def quarter(folder, cells=(3, 8)):
    """A quarter of a ring of radii 1 and 2, with curved quadratic cells."""
    geo = folder / "quarter.geo"
    if MPI.COMM_WORLD.rank == 0:
        geo.write_text(f"""
Point(1) = {{0, 0, 0}};
Point(2) = {{1, 0, 0}};
Point(3) = {{2, 0, 0}};
Point(4) = {{0, 2, 0}};
Point(5) = {{0, 1, 0}};
Line(1) = {{2, 3}};
Circle(2) = {{3, 1, 4}};
Line(3) = {{4, 5}};
Circle(4) = {{5, 1, 2}};
Curve Loop(1) = {{1, 2, 3, 4}};
Plane Surface(1) = {{1}};
Transfinite Curve {{1, 3}} = {cells[0] + 1};
Transfinite Curve {{2, 4}} = {cells[1] + 1};
Transfinite Surface {{1}};
Mesh.ElementOrder = 2;
Physical Curve("bottom") = {{1}};
Physical Curve("outside") = {{2}};
Physical Curve("axis") = {{3}};
Physical Curve("inside") = {{4}};
Physical Surface("body") = {{1}};
""")
    MPI.COMM_WORLD.barrier()
    return read_body(geo)


def sphere(folder, load, cells=(3, 8)):
    """A thick sphere, A = 1 and B = 2, as a body of revolution cut at its equator."""
    return Problem(
        quarter(folder, cells),
        NeoHookeanSplit(E=3.0, nu=0.5),
        degree=2,
        geometry="axisymmetric",
        supports=[Support(on="bottom", displacement=[FREE, 0])],
        loads=[load],
    )


HALF = 2 * np.pi / 3
"""Volume inside half a sphere of radius 1."""

STATES = {
    1.1: 0.287154845934,
    1.25: 0.551868541979,
    1.5: 0.755433118712,
    2.0: 0.806926603107,
    3.0: 0.634506675236,
}


def exact(a):
    """Pressure at the inner radius a = A times a stretch: cases.md, B-7."""

    def g(stretch):
        return 1 / stretch + 1 / (4 * stretch**4)

    return 2 * (g(np.cbrt(7 + a**3) / 2) - g(a))


def stretch(state):
    """Inner radius of the sphere, from the volume in it."""
    return float(np.cbrt(state.numbers["volume_inside"] / HALF))


@pytest.mark.long
def test_sphere_by_its_volume(folder):
    """Beyond the limit point, at a stretch near 1.8, the pressure falls while the volume grows.

    Quadratic cells, 3 across the wall, have an error of a few 1e-4; volume control is stable.
    """
    problem = sphere(folder, Cavity(on="inside", volume_ratio="1 + 26*t"))
    times = [(a**3 - 1) / 26 for a in STATES]
    states = [*Statics(problem, times=times[:-1], first_step=times[0]).steps()]
    found = {round(stretch(s), 3): s.numbers["pressure_inside"] for s in states}
    for a, p in STATES.items():
        assert exact(a) == pytest.approx(p, rel=1e-10)
        assert found[a] == pytest.approx(p, rel=2e-3)
    assert {s.negative for s in states[1:]} == {0}
    # Forces, moments, and the work of the pressure against the stored energy.
    assert states[-1].audit.verdict == "pass", states[-1].audit.reasons


@pytest.mark.long
def test_sphere_by_arc_length(folder):
    """The same path under a given pressure that is scaled with the load factor."""
    problem = sphere(folder, Cavity(on="inside", pressure=1.0))
    run = Statics(problem, method="arc-length", first_step=0.3, max_displacement=1.0)
    states = [*run.steps()]
    assert stretch(states[-1]) > 1.99
    for state in states[1:]:
        assert state.numbers["pressure_inside"] == pytest.approx(exact(stretch(state)), rel=2e-3)
    a = np.linspace(1.5, 2.0, 501)
    # A parabola through three points of the path.
    assert states[-1].limit_points == pytest.approx([max(map(exact, a))], rel=5e-3)


def ring(folder):
    """A quarter of a tube with a given volume inside and a plate that is pushed at its foot."""
    return Problem(
        quarter(folder, (1, 3)),
        NeoHookean(E=3.0, nu=0.3),
        degree=2,
        supports=[
            Support(on="axis", displacement=[0, FREE]),
            Rigid(on="bottom", displacement=[FREE, 0], force=[-0.3, 0], name="foot"),
        ],
        loads=[Cavity(on="inside", volume_ratio=1.2)],
    )


class Leaking(BodyCavity):
    """A cavity that is filled at a rate and leaks in proportion to its pressure."""

    rate, leak = 0.2, 0.8

    def commit(self):
        super().commit()
        self._before = self.volume()

    def _prescribed(self):
        return self._before + self.dt * (self.rate - self.leak * self.get()[0])

    def add_results(self, result, forces):
        super().add_results(result, forces)
        if self.dt:
            result["growth"] = (self.volume() - self._before) / self.dt


def leaking(folder):
    """A quarter of a tube."""
    load = Cavity(on="inside", volume_ratio=1.0, name="tube")
    problem = Problem(
        quarter(folder, (1, 3)),
        LinearElastic(E=3.0, nu=0.3),
        degree=2,
        supports=[
            Support(on="axis", displacement=[0, FREE]),
            Support(on="bottom", displacement=[FREE, 0]),
        ],
        loads=[load],
    )
    (at,) = (i for i, term in enumerate(problem.terms) if isinstance(term, BodyCavity))
    problem.terms[at] = Leaking(load, problem.context, problem.constraints, "load[0]")
    return problem


@pytest.mark.long
def test_a_term_of_ones_own_with_a_past(folder):
    """Filled at the rate q, a tube of compliance C that leaks p k obeys C dp/dt = q - k p.

    Backward Euler's: p (C + k dt) = C p0 + q dt.  The term needs its own class only.
    """
    states = list(Statics(leaking(folder), steps=5).steps())
    p, V = ([state.numbers[f"{name}_tube"] for state in states] for name in ("pressure", "volume"))
    C, k, q, dt = (V[1] - V[0]) / p[1], Leaking.leak, Leaking.rate, 0.2
    wanted = [0.0]
    for _ in range(5):
        wanted.append((C * wanted[-1] + q * dt) / (C + k * dt))
    # The error of a volume that Newton's method leaves, 1e-10 of it, over the compliance.
    assert p == pytest.approx(wanted, rel=1e-8, abs=1e-8)
    assert 0.01 < p[1] < p[5] < 0.99 * q / k
    # Results are those of the step that has ended there.
    growth = [state.numbers["growth"] for state in states[1:]]
    assert growth == pytest.approx([q - k * each for each in p[1:]], abs=1e-8)


def test_the_last_step_of_a_path_begins_at_the_point_before_it(folder):
    """The path goes beyond the end first: what is there is no past of the last point."""
    states = list(Statics(leaking(folder), method="arc-length", first_step=0.2).steps())
    assert len(states) > 3
    t = np.array([state.t for state in states])
    p, V = (
        np.array([state.numbers[f"{name}_tube"] for state in states])
        for name in ("pressure", "volume")
    )
    leaked = np.diff(t) * (Leaking.rate - Leaking.leak * p[1:])
    assert "growth" in states[-1].numbers
    np.testing.assert_allclose(np.diff(V), leaked, rtol=0.0, atol=1e-9)


def test_a_run_from_a_guess_begins_at_its_own_time(folder):
    """A second run of a problem goes on where the first one has ended, for another second."""
    problem = leaking(folder)
    *_, first = Statics(problem, steps=1).steps()
    p, V = first.numbers["pressure_tube"], first.numbers["volume_tube"]
    guess = InitialGuess(problem.w.x.array.copy(), (p,))
    (second,) = Statics(problem, steps=1).steps(near=guess)
    leaked = Leaking.rate - Leaking.leak * second.numbers["pressure_tube"]
    assert second.numbers["volume_tube"] - V == pytest.approx(leaked, abs=1e-9)
    assert second.numbers["pressure_tube"] > 1.05 * p


@pytest.mark.long
def test_arc_length_cavity_and_rigid_surface_together(folder):
    """A path by its length ends where the growing load does."""
    found = []
    for how in ({"method": "arc-length"}, {"steps": 2}):
        *_, state = Statics(ring(folder), **how).steps()
        found.append(state.numbers)
        assert state.numbers["volume_inside"] == pytest.approx(1.2 * np.pi / 4, rel=1e-3)
        assert state.reactions["foot"][0] == pytest.approx(-0.3, rel=1e-7)
    # Newton's tolerance.
    assert found[0] == pytest.approx(found[1], rel=1e-7, abs=1e-9)


def test_iterative_solvers_find_the_same(folder):
    """Block elimination leaves the choice of the fields' solver open."""
    found = []
    for method in ("direct", "iterative"):
        linear = LinearSettings(method=method)
        *_, state = Statics(ring(folder), linear=linear, steps=2).steps()
        found.append(state.numbers)
        assert (state.krylov > 0) == (method == "iterative")
    # Newton's tolerance.
    assert found[0] == pytest.approx(found[1], rel=1e-6, abs=1e-8)


def test_tangent_of_the_whole_system(folder):
    """Fields, load factor, pressure and motion: against central differences."""
    problem = ring(folder)
    assembler = Assembler(problem)
    problem.terms.begin(moving=False)
    others, length = scalar_unknowns(assembler), ArcLengthConstraint(assembler)
    length.begin(length.displacement() - 0.01)
    problem.set_time(0.5, default=PROPORTIONAL)
    joined = JoinedScalars([length, others])
    ksp = PETSc.KSP().create(assembler.comm)
    system = Bordered(assembler, joined, ksp)
    x, f, y = (system.create_vector() for _ in range(3))
    joined.put(np.array([0.5, 0.2, -0.05]))
    X = problem.W.tabulate_dof_coordinates()
    u = 0.03 * np.column_stack([np.sin(3 * X[:, 1] + X[:, 0]) * X[:, 0], np.cos(2 * X[:, 0])])
    problem.u.x.array[:] = u.reshape(-1)
    held = problem.constraints.dofs
    problem.u.x.array[held] = problem.constraints.values.x.array[held]
    system.fill(x, problem.u.x.array[: assembler.size], joined.get())
    system.renew(x)
    v = system.create_vector()
    first = x.getOwnershipRange()[0] + np.arange(assembler.size)
    system.fill(
        v, np.sin(first % 7 + 0.1 * X[:, 0].repeat(2)[: assembler.size]), np.array([0.3, -0.7, 0.4])
    )
    system.mult(system.matrix, v, y)
    h, sides = 3e-6, []
    for sign in (1, -1):
        z = x.copy()
        z.axpy(sign * h, v)
        system.residual(z, f)
        sides.append(f.copy())
    sides[0].axpy(-1.0, sides[1])
    sides[0].scale(1 / (2 * h))
    sides[0].axpy(-1.0, y)
    # Of central differences: h^2 and round-off over h.
    assert sides[0].norm() < 1e-8 * y.norm()
    scalars = system.scalar_part(sides[0])
    assert np.abs(scalars).max() < 1e-8 * np.abs(system.scalar_part(y)).max()


@pytest.mark.long
def test_pressure_is_the_derivative_of_energy_by_volume():
    """dW/dV = p in a solid whose bottom, held at its rim, bulges; the cone below it has V = 1/3."""
    problem = Problem(
        box_body(size=(1, 1, 0.5), cells=(3, 3, 1), origin=(0, 0, 1)),
        NeoHookean(E=1e4, nu=0.3),
        supports=[Support(on=["left", "right", "front", "back"])],
        loads=[Cavity(on="bottom", added="-20 L", name="cone")],
        degree=1,
    )
    states = [*Statics(problem, times=[0.98, 0.99]).steps()]
    a, b, c = states[-3:]
    assert states[0].numbers["volume_cone"] == pytest.approx(1 / 3, rel=1e-12)
    assert c.numbers["volume_cone"] == pytest.approx(1 / 3 - 0.02, rel=1e-9)
    work = c.energies["strain"] - a.energies["strain"]
    grown = c.numbers["volume_cone"] - a.numbers["volume_cone"]
    # Of the central difference over 2 % of the change: some 1e-5.
    assert work / grown == pytest.approx(b.numbers["pressure_cone"], rel=1e-4)
    assert b.numbers["pressure_cone"] < 0.0


def test_given_pressure_is_a_pressure(folder):
    """A cavity with a pressure is that load, and tells the volume."""
    found = []
    for load in (Cavity(on="inside", pressure=0.2, name="bore"), Pressure(on="inside", value=0.2)):
        *_, state = Statics(sphere(folder, load), steps=1).steps()
        found.append(state)
    # Newton's tolerance.
    assert found[0].max_displacement == pytest.approx(found[1].max_displacement, rel=1e-8)
    assert found[0].numbers["pressure_bore"] == 0.2
    assert found[0].numbers["volume_bore"] > HALF
    assert found[1].numbers == {}


def test_pressure_in_an_open_cavity(caplog):
    """It acts, but there is no volume to be told; small strains see the rim move as well."""
    for law in (NeoHookean(E=1.0, nu=0.3), LinearElastic(E=1.0, nu=0.3)):
        caplog.clear()
        problem = Problem(
            rectangle_body(size=(1.0, 1.0), cells=(2, 2)),
            law,
            supports=[Support(on="bottom")],
            loads=[Cavity(on="right", pressure=1e-3, origin=[2, 0], name="air")],
            degree=1,
        )
        *_, state = Statics(problem, steps=1).steps()
        assert state.numbers == {"pressure_air": 1e-3}
        told = [line for line in caplog.messages if "cavity 'air' is open" in line]
        assert len(told) == (MPI.COMM_WORLD.rank == 0)


def test_a_cavity_of_revolution_is_cut_across_its_axis(folder):
    with pytest.raises(InputError, match=r"load\[0\].origin\[0\]: a body of revolution"):
        sphere(folder, Cavity(on="inside", pressure=0.2, origin=[0.1, 0]))


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({}, "nothing is prescribed"),
        ({"volume": 1, "pressure": 2}, "pressure and volume given together"),
        ({"volume": "1 MPa"}, "volume"),
        ({"pressure": "x*t"}, "pressure.*one pressure"),
        ({"value": 1}, "no value"),
        ({"added": 1, "origin": [0, 0, 0]}, r"load\[0\].origin.*3 components"),
        ({"added": 1, "on": "left"}, "enclose"),
        ({"added": 1, "on": "right", "origin": [2, 0]}, r"load\[0\].on: .*is open"),
    ],
)
def test_wrong_cavities(keys, said):
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    with pytest.raises(InputError, match=said):
        load = Cavity(**{"on": "right", **keys})
        problem = Problem(
            body, NeoHookean(E=1.0, nu=0.3), supports=[Support(on="bottom")], loads=[load], degree=1
        )
        _ = [*Statics(problem).steps()]


def test_motion_has_no_scalar_unknowns(folder):
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    law = NeoHookean(E=1.0, nu=0.3, density=1.0)
    load = Cavity(on="right", volume=1, origin=[2, 0])
    for more in ({"loads": [load]}, {"supports": [Rigid(on="left", force=[0, 0])]}):
        with pytest.raises(InputError, match="in statics only"):
            Dynamics(Problem(body, law, degree=1, **more), end=1.0, dt=0.1)


def test_case_files_have_both():
    """The tables read, and read back."""
    tables = {
        "mesh": {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}, "degree": 1},
        "materials": {"m": {"law": "neo-hookean", "E": "1 MPa", "nu": 0.3}},
        "support": [
            {"kind": "rigid", "on": "left", "rotation": [0, "5 deg", "free"], "moment": [0, 0, 2]}
        ],
        "load": [{"kind": "cavity", "on": "right", "added": "2 cm^3", "name": "c"}],
    }
    case = Case.from_dict(tables)
    assert case.load[0].values == pytest.approx((2e-6,), rel=1e-15)
    assert case.support[0].motion(3)[4:] == (pytest.approx(np.pi / 36), None)
    assert Case.from_dict(case.to_dict()) == case


# --- torques of turned surfaces ---


@pytest.mark.parametrize("dim", [2, 3])
def test_torque_of_a_rotation(dim: int) -> None:
    """The work of a support that only turns is the integral of its torque over the angle.

    Simpson's rule over 0.02 rad, whose error is of the fourth order in it: 1e-8 of the work.  The
    point moves along the axis' normal with constant displacement, which does no work.
    """
    make = box_body if dim == 3 else rectangle_body
    body = make(size=(1.0, 0.4, 0.3)[:dim], cells=(2, 1, 1)[:dim])
    axis: dict[str, Any] = {"axis": [1, 0.2, 0]} if dim == 3 else {}
    turn = Rotation(
        on="right",
        point=[1.0, 0.1, 0.2][:dim],
        angle="t",
        displacement=[0.05, 0, 0][:dim],
        curve="constant",
        **axis,
    )
    flat: dict[str, Any] = {"thickness": 0.2} if dim == 2 else {}
    held = [Support(on="left"), turn]
    problem = Problem(body, NeoHookean(E=1e6, nu=0.3), supports=held, degree=1, **flat)
    times = [0.29, 0.3, 0.31]
    found = {}
    for state in Statics(problem, end=0.31, times=times, rtol=1e-12).steps():
        found[round(state.t, 9)] = state.energies["strain"], state.numbers["torque_right"]
    (first, T0), (_, T1), (last, T2) = (found[t] for t in times)
    assert last - first == pytest.approx(0.01 / 3 * (T0 + 4 * T1 + T2), rel=1e-6)
    assert T1 > 0  # the support turns the body
