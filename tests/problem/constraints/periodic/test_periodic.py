"""Periodic faces: homogeneous cells, laminates, holes, free strains, work."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from conftest import displacement_at
from helpers.states import last
from mpi4py import MPI

from dolfin_elastic import (
    Case,
    Contact,
    Dynamics,
    Gravity,
    LinearElastic,
    NeoHookean,
    NeoHookeanSplit,
    Periodic,
    Problem,
    Selector,
    Statics,
    StVenantKirchhoff,
    Support,
    box_body,
    name_parts,
    rectangle_body,
)
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.core.errors import ConvergenceError, InputError, MeshError
from dolfin_elastic.mesh import Body
from dolfin_elastic.mesh.distribute import make_mesh
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.diagnostics.rigid_body import free_bodies
from dolfin_elastic.solvers.linear.choice import LinearSettings, choose
from dolfin_elastic.solvers.nonlinear.bordered import Bordered
from dolfin_elastic.solvers.nonlinear.convergence import Tolerance
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.solvers.nonlinear.scalars import FreeStrains

PAIRS = [["left", "right"], ["bottom", "top"]]
PAIRS3 = [["left", "right"], ["front", "back"], ["bottom", "top"]]
FREE = "free"
E, NU = 1e6, 0.3
SHEARED = [[1.3, 0.2, 0.0], [0.1, 0.9, 0.05], [0.0, -0.1, 1.1]]
PLANE = [[1.2, 0.1], [0.0, 0.95]]
STRESS = [[FREE, FREE], [FREE, 2e4]]


def stress(state: Any, dim: int) -> np.ndarray:
    dims = range(1, dim + 1)
    return np.array([[state.numbers[f"P{i}{j}"] for j in dims] for i in dims])


def neo_hooke(F: Any) -> np.ndarray:
    """P = mu (F - F^-T) + lmbda ln J F^-T: Bonet & Wood (2008), (6.28)."""
    F = np.array(F)
    if len(F) == 2:
        F = np.block([[F, np.zeros((2, 1))], [np.zeros((1, 2)), np.ones((1, 1))]])
    mu, lmbda = E / 2 / (1 + NU), E * NU / (1 + NU) / (1 - 2 * NU)
    inverse = np.linalg.inv(F).T
    return mu * (F - inverse) + lmbda * np.log(np.linalg.det(F)) * inverse


def layered(layers: int = 4, across: int = 2) -> Body:
    """A unit square whose lower half is one region, its upper half the other."""
    body = rectangle_body(size=(1, 1), cells=(across, layers))
    return name_parts(
        body,
        regions={
            "lower": Selector(box=[[0, 0], [1, 0.5]]),
            "upper": Selector(box=[[0, 0.5], [1, 1]]),
        },
    )


def rubber(core: float, low: float = 0.0, dim: int = 3) -> NeoHookean:
    """Neo-Hookean, in a core of half the side `core` times as stiff; as one form for all tests."""
    sides = [f"heaviside({c} - {low})*heaviside({low} + 0.5 - {c})" for c in "xyz"[:dim]]
    return NeoHookean(E=f"{E}*(1 - {1 - core}*{'*'.join(sides)})", nu=NU, density=1)


def cored(body: Body, low: float = 0.0, **fields: Any) -> Problem:
    """A unit cell with a soft core, a quarter of its side off the middle unless `low` is 0.25."""
    return Problem(body, rubber(0.1, low, body.dim), **{"degree": 1, **fields})


# --- a homogeneous cell: P is that of the law, whatever the mesh ---


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("dim", [2, 3])
def test_homogeneous(dim, degree):
    F = PLANE if dim == 2 else SHEARED
    make, pairs = (rectangle_body, PAIRS) if dim == 2 else (box_body, PAIRS3)
    # One cell across: a node of it is merged with another of the same cell.
    body = make(size=(1, 2, 1.5)[:dim], cells=(2, 1, 3)[:dim], origin=(3, 4, 5)[:dim])
    problem = Problem(
        body, rubber(1, dim=dim), degree=degree, periodic=Periodic(pairs=pairs, gradient=F)
    )
    state = last(problem, steps=2)
    P = neo_hooke(F)
    # Everything is exact but for round-off in Newton's method.
    np.testing.assert_allclose(stress(state, dim), P[:dim, :dim], rtol=1e-10)
    if dim == 2:
        assert state.numbers["P33"] == pytest.approx(P[2, 2], rel=1e-10)
    assert state.numbers["F12"] == pytest.approx(F[0][1], rel=1e-14)
    # The displacement that is shown is the whole one, and the first corner is at rest.
    far = np.array((4, 6, 6.5)[:dim])
    moved = displacement_at(problem, tuple(far))
    wanted = (np.array(F) - np.eye(dim)) @ (far - np.array((3, 4, 5)[:dim]))
    np.testing.assert_allclose(moved, wanted, rtol=0, atol=1e-12)


def test_thickness_and_plane_stress():
    """P is per area, so the thickness drops out; sigma33 = 0 leaves P11 = E eps / (1 - nu^2)."""
    body = rectangle_body(size=(2, 1), cells=(2, 2))
    periodic = Periodic(pairs=PAIRS, gradient=[[1.001, 0], [0, 1]])
    problem = Problem(
        body,
        LinearElastic(E=E, nu=NU),
        geometry="plane-stress",
        thickness=0.02,
        periodic=periodic,
        degree=1,
    )
    numbers = last(problem).numbers
    # A linear problem in one step; the mean is exact but for round-off.
    assert numbers["P11"] == pytest.approx(1e-3 * E / (1 - NU**2), rel=1e-9)
    assert numbers["P22"] == pytest.approx(1e-3 * E * NU / (1 - NU**2), rel=1e-9)
    assert abs(numbers["P33"]) < 1e-9 * E * 1e-3


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
def test_mixed(degree):
    """A pressure beside the displacement is periodic, too."""
    F = [[1.2, 0.1, 0.0], [0.0, 0.95, 0.0], [0.0, 0.0, 1 / 1.2 / 0.95]]
    law = NeoHookeanSplit(E=E, nu=0.49)
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2))
    periodic = Periodic(pairs=PAIRS3, gradient=F)
    P = [
        stress(last(Problem(body, law, degree=degree, formulation=kind, periodic=periodic)), 3)
        for kind in ("displacement", "mixed")
    ]
    # The homogeneous state is in both spaces; K is 50 times the shear modulus.
    np.testing.assert_allclose(P[1], P[0], rtol=0, atol=1e-8 * E)


# --- laminates ---


def test_laminate():
    """Layers of Hooke's law with nu = 0: a mean across the layers, another one along.

    Across, the stress is the same in both and P22 = eps (2/(1/E1 + 1/E2)); along, the strain is,
    and P11 = eps (E1 + E2)/2.  Shear along layers is as across with G = E/2: P12 + P21 are of
    eps12 = g/2, P12 = 2 G eps12.  Source: A. Reuss (1929), W. Voigt (1889).
    """
    E1, E2, eps = 1e6, 5e6, 1e-2
    laws = {"lower": LinearElastic(E=E1, nu=0), "upper": LinearElastic(E=E2, nu=0)}
    harmonic, mean = 2 / (1 / E1 + 1 / E2), (E1 + E2) / 2
    for gradient, place, wanted in (
        ([[1, 0], [0, 1 + eps]], "P22", harmonic * eps),
        ([[1 + eps, 0], [0, 1]], "P11", mean * eps),
        ([[1, eps], [0, 1]], "P12", harmonic * eps / 2),
    ):
        problem = Problem(
            layered(), laws, periodic=Periodic(pairs=PAIRS, gradient=gradient), degree=1
        )
        numbers = last(problem).numbers
        # The exact field is linear in each layer, so linear elements hold it.
        assert numbers[place] == pytest.approx(wanted, rel=1e-9)


def test_large_laminate():
    """Large strains across layers of St Venant-Kirchhoff, nu = 0: P = E/2 (s^3 - s) in each.

    Source: P11 = F11 S11 with S11 = E (s^2 - 1)/2, Bonet & Wood (2008), section 6.4.
    """
    E1, E2 = 1e6, 5e6
    laws = {"lower": StVenantKirchhoff(E=E1, nu=0), "upper": StVenantKirchhoff(E=E2, nu=0)}
    periodic = Periodic(pairs=PAIRS, gradient=[[1, 0], [0, 1.4]])
    numbers = last(Problem(layered(), laws, periodic=periodic, degree=1)).numbers
    low, high = 1.4, 1.8  # stretch of the soft layer, by halving; both share 2 x 1.4
    for _ in range(60):
        middle = (low + high) / 2
        soft, hard = (E / 2 * (s**3 - s) for E, s in ((E1, middle), (E2, 2.8 - middle)))
        low, high = (middle, high) if soft < hard else (low, middle)
    # Equal stress in both is met to Newton's tolerance, 1e-8.
    assert numbers["P22"] == pytest.approx(E1 / 2 * (low**3 - low), rel=1e-8)


@pytest.mark.parametrize("steps", [1, 4])
def test_work_of_the_neighbours(steps):
    """What the audit calls work is the energy that Hooke's law stores, V E/(1 - nu^2) e^2/2.

    Pulled by e and free across, in plane strain, through a cell of neither unit area nor unit
    length: forces grow linearly, and the trapezoidal rule of the audit is exact.
    """
    strain, volume = 1e-3, 6.0
    periodic = Periodic(pairs=PAIRS, gradient=[[1 + strain, 0], [0, FREE]])
    body = rectangle_body(size=(3, 2), cells=(2, 2))
    state = last(Problem(body, LinearElastic(E=E, nu=NU), periodic=periodic, degree=1), steps=steps)
    stored = volume * E / (1 - NU**2) * strain**2 / 2
    assert state.audit.verdict == "pass"
    assert state.audit.work == pytest.approx(stored, rel=1e-8)
    assert state.audit.energy == pytest.approx(stored, rel=1e-8)


@pytest.mark.parametrize("side", [0.01, 100.0])
def test_work_through_large_strains(side):
    """Forces times displacements add up to the energy, by the trapezoidal rule: slope 2.

    Neo-Hooke's psi = mu/2 (F:F - 3) - mu ln J + lmbda/2 (ln J)^2 at F = diag(1.3, 0.9), Bonet &
    Wood (2008), (6.27), in cells far smaller and far larger than a metre.
    """
    F, body = [[1.3, 0.0], [0.0, 0.9]], rectangle_body(size=(side, side), cells=(1, 1))
    J, mu, lmbda = 1.3 * 0.9, E / 2 / (1 + NU), E * NU / (1 + NU) / (1 - 2 * NU)
    psi = mu / 2 * (1.3**2 + 0.9**2 - 2) - mu * np.log(J) + lmbda / 2 * np.log(J) ** 2
    errors = []
    for steps in (2, 4, 8):
        problem = Problem(
            body, rubber(1, dim=2), periodic=Periodic(pairs=PAIRS, gradient=F), degree=1
        )
        audit = last(problem, steps=steps).audit
        assert audit.verdict == "pass"
        assert audit.energy == pytest.approx(psi * side**2, rel=1e-9)
        errors.append(abs(audit.work / (psi * side**2) - 1))
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx(2, abs=0.1)


# --- free strains ---


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
def test_uniaxial(degree):
    """Neo-Hookean, E = 1e6, nu = 0.3, pulled by half, free across: the reference of the bench."""
    gradient = [[1.5, 0, 0], [0, FREE, 0], [0, 0, FREE]]
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2))
    problem = Problem(
        body,
        rubber(1),
        degree=degree,
        periodic=Periodic(pairs=PAIRS3, gradient=gradient),
    )
    state = last(problem)
    F = np.diag([1.5, state.numbers["F22"], state.numbers["F33"]])
    P = neo_hooke(F)
    assert abs(P[1, 1]) < 1e-8 * P[0, 0]  # the closed form at the strains found
    assert abs(P[2, 2]) < 1e-8 * P[0, 0]
    assert state.numbers["P11"] == pytest.approx(P[0, 0], rel=1e-9)
    assert abs(state.numbers["P22"]) < 1e-8 * P[0, 0]


def test_prescribed_stress():
    """A stress that is prescribed comes out, with the strain of Hooke's law in plane strain."""
    sigma = 1e3
    periodic = Periodic(
        pairs=PAIRS,
        gradient=[[FREE, FREE], [0, FREE]],
        stress=[["1 kPa", 200], [0, 0]],
    )
    body = rectangle_body(size=(2, 1), cells=(2, 2))
    numbers = last(Problem(body, LinearElastic(E=E, nu=NU), periodic=periodic, degree=1)).numbers
    # eps11 = (1 - nu^2)/E sigma, eps22 = -nu (1 + nu)/E sigma, F12 = 200/G.
    assert numbers["P11"] == pytest.approx(sigma, rel=1e-8)
    assert numbers["F11"] - 1 == pytest.approx((1 - NU**2) / E * sigma, rel=1e-8)
    assert numbers["F22"] - 1 == pytest.approx(-NU * (1 + NU) / E * sigma, rel=1e-8)
    assert numbers["F12"] == pytest.approx(200 * 2 * (1 + NU) / E, rel=1e-8)


def test_smaller_steps(caplog):
    """A step that fails leaves the strains where they were, and smaller ones get there."""
    gradient = [[0.6, 0.4], [0, FREE]]
    found = []
    for settings in ({"steps": 1, "max_iterations": 4}, {"steps": 8}):
        body = rectangle_body(size=(1, 1), cells=(4, 4))
        problem = cored(body, degree=2, periodic=Periodic(pairs=PAIRS, gradient=gradient))
        with caplog.at_level("INFO"):
            *_, state = Statics(problem, rtol=1e-11, **settings).steps()
        found.append([*stress(state, 2).reshape(-1), E * state.numbers["F22"]])
    if MPI.COMM_WORLD.rank == 0:  # which logs for all
        assert "a smaller step" in caplog.text
    # The same equilibrium, to Newton's tolerance.
    np.testing.assert_allclose(found[0], found[1], rtol=0, atol=1e-8 * E)


def test_bordered_tangent():
    """The derivative of fields and strains together is that of differences."""
    gradient = [[1.2, FREE], [0, FREE]]
    problem = cored(
        rectangle_body(size=(1, 1), cells=(2, 2)),
        degree=2,
        periodic=Periodic(pairs=PAIRS, gradient=gradient),
    )
    assembler = Assembler(problem)
    strains = FreeStrains(assembler.cell)
    newton = Newton(
        assembler, choose(problem, LinearSettings()), Tolerance(1e-8, 0, 30), scalars=strains
    )
    system: Bordered = newton.bordered
    problem.set_time(1.0)
    rng = np.random.default_rng(3)
    x, y, f, g, z = (system.create_vector() for _ in range(5))
    start, _ = system.matrix.getOwnershipRange()
    rows, size = len(x.array_r), x.getSize()
    everything = rng.standard_normal((2, size))
    x.array_w[:] = 0.02 * everything[0, start : start + rows]
    y.array_w[:] = everything[1, start : start + rows]
    # Where the vertex is held rows and columns are replaced: stay there.
    y.array_w[assembler.prescribed_dofs] = x.array_w[assembler.prescribed_dofs] = 0.0
    system.renew(x)
    system.matrix.mult(y, z)
    h = 1e-5
    for sign, side in ((1, f), (-1, g)):
        w = x.copy()
        w.axpy(sign * h, y)
        system.residual(w, side)
        w.destroy()
    difference = (f - g) / (2 * h)
    # Central differences: h^2 of truncation, 1e-16/h of round-off.
    assert (difference - z).norm() < 1e-7 * z.norm()
    newton.destroy()
    assembler.destroy()


# --- cells with something in them ---


@pytest.mark.parametrize("dim", [2, 3])
def test_work(dim):
    """Hill's lemma: the energy grows by V P : dF, to second order in the step."""
    pairs = PAIRS if dim == 2 else PAIRS3
    rest = np.eye(dim).tolist()
    rest[0][0], rest[0][1] = "1 + 0.3*t", "0.2*t"
    make, cells = (rectangle_body, 4) if dim == 2 else (box_body, 2)
    body = make(size=(1,) * dim, cells=(cells,) * dim)
    problem = cored(body, periodic=Periodic(pairs=pairs, gradient=rest))
    states = list(Statics(problem, times=[0.8, 0.82], max_step=0.4).steps())
    one, two = (next(s for s in states if abs(s.t - t) < 1e-12) for t in (0.8, 0.82))
    F = [
        np.array([[s.numbers[f"F{i}{j}"] for j in range(1, dim + 1)] for i in range(1, dim + 1)])
        for s in (one, two)
    ]
    mean = (stress(one, dim) + stress(two, dim)) / 2
    work = float(np.sum(mean * (F[1] - F[0])))
    gained = two.energies["strain"] - one.energies["strain"]
    # The trapezoidal rule's error is (dt)^2/12 P''/P = 3e-5 P''/P.
    assert gained == pytest.approx(work, rel=3e-5)


def test_audit():
    """What V P : dF has done is stored, to second order in the step by the trapezoidal rule."""
    errors = []
    for steps in (4, 8, 16):
        body = rectangle_body(size=(1, 1), cells=(4, 4))
        periodic = Periodic(pairs=PAIRS, gradient=[[1.3, 0.2], [0, FREE]], stress=STRESS)
        *_, state = Statics(cored(body, periodic=periodic), steps=steps).steps()
        assert state.audit.verdict == "pass", state.audit.reasons
        assert np.isnan([state.audit.force, state.audit.moment]).all()
        errors.append(abs(state.audit.work / state.audit.energy - 1))
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    # Asymptotically 2; half steps of a tenth of the size are not quite there.
    np.testing.assert_allclose(slopes, 2, atol=0.15)


def test_audit_sees_the_whole_deformation():
    """A homogeneous cell has no displacement but the macroscopic one: det F is that of F."""
    body = rectangle_body(size=(1, 1), cells=(2, 2))
    F = [[0.6, 0], [0, 1.1]]
    problem = Problem(body, rubber(1, dim=2), periodic=Periodic(pairs=PAIRS, gradient=F), degree=1)
    audits = [state.audit for state in Statics(problem, steps=2).steps()]
    assert [audit.min_jacobian for audit in audits] == pytest.approx([1, 0.8 * 1.05, 0.6 * 1.1])


def test_given_up():
    """A cell that comes to no equilibrium is diagnosed like any body."""
    body = rectangle_body(size=(1, 1), cells=(4, 4))
    periodic = Periodic(pairs=PAIRS, gradient=[["1 - 4.8*t*(1 - t)", 0], [0, FREE]])
    with pytest.raises(ConvergenceError) as caught:
        last(cored(body, periodic=periodic))
    # Its volume is gone at t = 0.295, unless it grows sideways first, and back from 0.7 on.
    assert 0.1 < caught.value.state.t < 0.5
    assert caught.value.diagnosis.cause not in ("rigid-motion", "round-off")


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("dim", [2, 3])
def test_place_of_a_node_with_several(dim, degree):
    """That nearest to the origin, of equally near ones the first along x, y and z."""
    make, pairs = (rectangle_body, PAIRS) if dim == 2 else (box_body, PAIRS3)
    size, origin = np.array([1.0, 2.0, 1.5])[:dim], np.array([-0.75, -1.0, 3.0])[:dim]
    body = make(size=size, cells=(4, 4, 3)[:dim], origin=origin)
    problem = Problem(
        body,
        rubber(1, dim=dim),
        degree=degree,
        periodic=Periodic(pairs=pairs, gradient=np.eye(dim)),
    )
    x = problem.unknowns.unknown_places[:, :dim]
    assert np.all(x < origin + size + 1e-9)
    shifts = np.array(list(itertools.product((-1, 0, 1), repeat=dim)))
    images = x[:, None] + shifts * size
    inside = ((images > origin - 1e-9) & (images < origin + size + 1e-9)).all(axis=2)
    away = np.where(inside, np.linalg.norm(images, axis=2), np.inf)
    wrong = 0
    for node, place in enumerate(x):
        nearest = images[node][away[node] < away[node].min() + 1e-9]
        wrong += not np.allclose(min(map(tuple, nearest.round(9))), place, rtol=0, atol=1e-8)
    assert MPI.COMM_WORLD.allreduce(wrong) == 0


def test_place_of_equal_forces():
    """Forces alike on a cell's faces: the place that is told is the same on any ranks."""
    body = rectangle_body(size=(1, 1), cells=(4, 4), origin=(-0.9, -0.9))
    problem = Problem(body, rubber(1, dim=2), periodic=Periodic(pairs=PAIRS, gradient=np.eye(2)))
    assembler = Assembler(problem)
    forces = assembler.residual.owned.reshape(-1, 2)
    x = problem.unknowns.unknown_places[: len(forces), :2]
    forces[np.isclose(np.abs(x + 0.4), 0.5).any(axis=1)] = 1.0
    force, place = assembler.residual.largest()
    assembler.destroy()
    assert force == pytest.approx(np.sqrt(2))
    assert place == pytest.approx([-0.025, 0.1])  # (0.1, 0.1) is the fixed vertex


@pytest.mark.parametrize("degree", [1, 2])
def test_shifted_cell(degree):
    """The cell may be cut anywhere: a soft core in its corner is the same as one in its middle."""
    found = []
    for low in (0.0, 0.25, 0.5):
        body = rectangle_body(size=(1, 1), cells=(8, 8))
        periodic = Periodic(pairs=PAIRS, gradient=[[1.2, 0.1], [0.0, FREE]])
        state = last(cored(body, low, degree=degree, periodic=periodic), rtol=1e-11)
        found.append([*stress(state, 2).reshape(-1), E * state.numbers["F22"]])
    # The meshes are the same up to a shift of the lattice: only Newton's tolerance differs.
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=0, atol=1e-8 * E)


@pytest.mark.parametrize("dim", [2, 3])
def test_ranks(dim):
    """Several ranks find what one of them finds alone."""
    make, pairs = (rectangle_body, PAIRS) if dim == 2 else (box_body, PAIRS3)
    gradient: Any = np.eye(dim).tolist()
    gradient[0][:2], gradient[1][1] = [1.2, 0.1], FREE
    found = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        body = make(size=(1,) * dim, cells=(3,) * dim, comm=comm)
        problem = cored(body, degree=2, periodic=Periodic(pairs=pairs, gradient=gradient))
        state = last(problem, steps=1, rtol=1e-11)
        found.append([*stress(state, dim).reshape(-1), E * state.numbers["F22"]])
        found[-1].append(state.energies["strain"])
    # Only Newton's tolerance and the order of sums differ.
    np.testing.assert_allclose(found[0], found[1], rtol=0, atol=1e-9 * E)


@pytest.mark.parametrize("degree", [1, 2])
def test_iterative(degree):
    """Multigrid on merged nodes finds what the factorisation does."""
    gradient = [[1.1, 0.1, 0], [0, FREE, 0], [0, 0, 1]]
    found = []
    for method in ("direct", "iterative"):
        body = box_body(size=(1, 1, 1), cells=(4, 4, 4))
        problem = cored(body, degree=degree, periodic=Periodic(pairs=PAIRS3, gradient=gradient))
        *_, state = Statics(problem, steps=1, linear=LinearSettings(method=method)).steps()
        found.append(stress(state, 3))
        iterations = state.krylov
    # Equilibrium holds to 1e-8 of the forces in both.
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-7 * np.abs(found[0]).max())
    assert 0 < iterations < 300


# --- what is refused ---


def refused(match: str, **fields: Any) -> None:
    body = rectangle_body(size=(1, 1), cells=(2, 2))
    solved = fields.pop("solved", False)
    given = {"pairs": PAIRS, "gradient": PLANE, **fields}
    more = {key: given.pop(key) for key in ("supports", "loads", "contacts") if key in given}
    with pytest.raises((InputError, MeshError), match=match):
        problem = Problem(
            body, rubber(1, dim=2), periodic=Periodic(**given), **{"degree": 1, **more}
        )
        if solved:
            last(problem)


def test_refused():
    refused("2 pairs: a cell", pairs=PAIRS[:1])
    refused("has no image on 'bottom'", pairs=[["left", "bottom"], ["right", "top"]])
    refused("do not span", pairs=[PAIRS[0], PAIRS[0]])
    refused("no surface 'up'", pairs=[PAIRS[0], ["bottom", "up"]])
    refused("has no image on 'top'", pairs=[["left", "top"], PAIRS[1]])
    refused("2-dimensional", gradient=SHEARED)
    refused("det F", gradient=[[0, 1], [1, 0]])
    refused("det F is not above 0", gradient=[[-0.2, 0.1], [0, FREE]])
    refused("the cell can turn", gradient=[[1, FREE], [FREE, 1]])
    refused("so its stress is a result", stress=[[1, 0], [0, 0]])
    refused("neither F11", gradient=[[FREE, 0], [0, 1]], stress=[[FREE, 0], [0, 0]])
    refused("is infinite at t = 0", gradient=[["1/t", 0], [0, 1]], solved=True)
    refused("same at all points", gradient=[["1 + x", 0], [0, 1]])
    refused("rows of", gradient=[[1, 0], [0]])
    refused("no supports", supports=[Support(on="left")])
    refused("no loads", loads=[Gravity()])
    refused("no contacts", contacts=[Contact(on="left", plane={"axis": "x", "at": -1})])


def squares(kept: str) -> Body:
    """A unit square of 5 x 5 squares, row by row from below; a dot is a hole, else a region."""
    root = MPI.COMM_WORLD.rank == 0
    x, y = np.meshgrid(np.arange(6), np.arange(6))
    points = np.column_stack([x.ravel(), y.ravel()]) / 5.0
    corners = [6 * (k // 5) + k % 5 for k, sign in enumerate(kept) if sign != "."]
    cells = np.array([[[c, c + 1, c + 7], [c, c + 7, c + 6]] for c in corners]).reshape(-1, 3)
    used, cells = np.unique(cells, return_inverse=True)
    if not root:
        used, cells = used[:0], cells[:0]
    mesh = make_mesh(MPI.COMM_WORLD, cells.reshape(-1, 3), points[used], 1)
    middles = mesh.geometry.x[mesh.geometry.dofmap].mean(axis=1)
    place = np.floor(5 * middles + 1e-9).astype(int)
    signs = np.array(list(kept))[place[:, 0] + 5 * place[:, 1]] if len(place) else np.array([])
    regions = {s: np.flatnonzero(signs == s).astype(np.int32) for s in sorted(set(kept) - {"."})}
    sides = {
        name: Selector(plane=axis, at=at)
        for (name, axis, at) in [
            ("left", "x", "min"),
            ("right", "x", "max"),
            ("bottom", "y", "min"),
            ("top", "y", "max"),
        ]
    }
    return name_parts(Body(mesh).named(regions=regions), surfaces=sides)


def test_a_loose_body_in_a_cell():
    """An island in a hole floats; two halves that hang together through the faces do not."""
    periodic = Periodic(pairs=PAIRS, gradient=PLANE)
    frame = "fffff" + "f...f" + "f.i.f" + "f...f" + "fffff"
    problem = Problem(squares(frame), rubber(1, dim=2), periodic=periodic, degree=1)
    assert [(b.name, bool(b.motions)) for b in free_bodies(problem)] == [("f", False), ("i", True)]
    with pytest.raises(InputError, match="periodic: `i` can float about: the cell has 2 bodies"):
        last(problem)
    halves = Problem(squares("l...r" * 5), rubber(1, dim=2), periodic=periodic, degree=1)
    assert [body.motions for body in free_bodies(halves)] == [()]


def test_unlike_meshes():
    """The first node without an image is named with its place."""
    body = rectangle_body(size=(1, 1), cells=(4, 4))
    x = body.mesh.geometry.x
    x[np.isclose(x[:, 0], 1) & np.isclose(x[:, 1], 0.5), 1] = 0.55
    periodic = Periodic(pairs=PAIRS, gradient=PLANE)
    with pytest.raises(InputError, match=r"periodic.pairs\[0\].*\(0, 0.5\).*0.05 m"):
        Problem(body, rubber(1, dim=2), periodic=periodic, degree=1)


def test_analyses_refused():
    body = rectangle_body(size=(1, 1), cells=(2, 2))
    law = rubber(1, dim=2)
    problem = Problem(body, law, periodic=Periodic(pairs=PAIRS, gradient=PLANE), degree=1)
    with pytest.raises(InputError, match="not followed by arc length"):
        list(Statics(problem, method="arc-length").steps())
    with pytest.raises(InputError, match="no motion"):
        list(Dynamics(problem, end=1.0, dt=0.1).steps())


# --- case files ---

CASE: dict[str, Any] = {
    "mesh": {"rectangle": {"size": [1, 1], "cells": [2, 2]}, "degree": 1},
    "materials": {"rubber": {"law": "neo-hookean", "E": "1 MPa", "nu": 0.3}},
    "periodic": {
        "pairs": PAIRS,
        "gradient": [["1 + 0.2*t", 0.1], [0, FREE]],
        "stress": [[FREE, FREE], [FREE, "2 kPa"]],
        "curve": [[0, 0], [1, 1]],
    },
}


def test_case():
    case = Case(**CASE)
    again = Case.from_dict(case.to_dict())
    assert again == case
    problem = again.make_problem(again.read_body())
    *_, state = again.make_solver(problem).steps()
    assert state.numbers["P22"] == pytest.approx(2e3, abs=1e-8 * E)
    assert state.numbers["F11"] == pytest.approx(1.2, rel=1e-14)
    bad = Case(**{**CASE, "periodic": {"pairs": [["left", "rigth"]], "gradient": PLANE}})
    with pytest.raises(InputError, match=r"periodic.pairs\[0\]\[1\].*'right'"):
        check(bad, bad.read_body())
    with pytest.raises(InputError, match=r"periodic.gradient\[0\]\[1\]"):
        Case(**{**CASE, "periodic": {"pairs": PAIRS, "gradient": [[1, "y"], [0, 1]]}})
    with pytest.raises(InputError, match="no motion"):
        Case(**CASE, dynamics={"end": 1, "dt": 0.1})
