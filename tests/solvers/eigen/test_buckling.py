"""Load factors of buckling against Euler, Engesser, and the path of equilibria itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers.buckling import arch, bedded, cylinder, ring
from mpi4py import MPI

from dolfin_elastic import (
    Body,
    BodyForce,
    Buckling,
    Centrifugal,
    Force,
    LinearElastic,
    Modal,
    NeoHookean,
    NeoHookeanSplit,
    PointForce,
    Pressure,
    Problem,
    Selector,
    StVenantKirchhoff,
    Support,
    Symmetry,
    Traction,
    box_body,
    name_parts,
    rectangle_body,
)
from dolfin_elastic.core.errors import ConvergenceError, InputError
from dolfin_elastic.model.loads import Load
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.problem.state import Mode, State
from dolfin_elastic.solvers.eigen.buckling import Perturbation
from dolfin_elastic.solvers.eigen.mode_shapes import at_rest
from dolfin_elastic.solvers.eigen.settings import ModalSettings
from dolfin_elastic.solvers.statics.settings import StaticsSettings

EULER = np.pi**2 * 1e7 / 12 / (1 - 0.3**2) / 400
"""B-11: pi^2 E/(1 - nu^2) I/(4 L^2) of a clamped column, L = 10, h = 1 [N/m]."""
ENGESSER = 22437.073
"""The same with shear, k = 5/6 [N/m]."""
SOFT = {"E": 1e7, "nu": 0.3, "density": 1000}


def factors(problem: Problem, **settings: Any) -> list[float]:
    return [mode.load_factor for mode in Buckling(problem, **settings).modes()]


def strip(comm: MPI.Comm, cells: tuple[int, int] = (40, 4)) -> Body:
    return rectangle_body(size=[10, 1], cells=cells, comm=comm)


def column(body: Body, law: Law | None = None, load: float = -EULER, **keys: Any) -> Problem:
    return Problem(
        body,
        law or StVenantKirchhoff(**SOFT),
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[load, 0])],
        degree=2,
        **keys,
    )


def test_along_the_path(comm: MPI.Comm) -> None:
    """About a loaded state the factor is that of the path, in proportion to what is left.

    Linear buckling leaves out what displacements do to the stiffness, of first order in the strain
    before, 0.2 %, times a number of the law.  At 0.99 of the load hardly anything is left out.
    """
    problem = column(strip(comm, (20, 2)), NeoHookean(**SOFT))
    linear, half, near = (
        factors(problem, count=1, preload=s, statics=StaticsSettings(steps=1))[0]
        for s in (0.0, 0.5, 0.99)
    )
    assert linear == pytest.approx(near, rel=1e-2)
    assert (half - near) / (linear - near) == pytest.approx(0.5, abs=0.07)
    # Frequencies vanish at the same load, by another eigenvalue problem.
    loaded = column(strip(comm, (20, 2)), NeoHookean(**SOFT), load=-0.97 * EULER * near)
    rest, mode = (
        next(iter(Modal(loaded, at, statics=StaticsSettings(steps=1)).modes()))
        for at in (ModalSettings(count=1), ModalSettings(count=1, preload=True))
    )
    # omega^2 falls in proportion, but for some 0.3 % of it.
    assert mode.eigenvalue / rest.eigenvalue == pytest.approx(0.03, abs=3e-3)
    assert mode.kind == "elastic"


@pytest.mark.parametrize("preload", [0.9, 1.3, 2.0, 4.4])
def test_preloads_beyond_the_full_load(preload: float, comm: MPI.Comm) -> None:
    """A tenth of the load has ten times the factor, at whatever share of it is linearised.

    By 0.2 % of the factor strains change it on the way, see above.
    """
    body = rectangle_body(size=[10, 1], cells=(10, 1), comm=comm)
    found = factors(column(body, load=-EULER / 5), count=1, preload=preload)[0]
    assert found == pytest.approx(factors(column(body), count=1)[0] * 5, rel=3e-3)


def test_preload_is_yielded(comm: MPI.Comm) -> None:
    """States on the way first; modes about the last of them; a state beyond is refused."""
    problem = column(strip(comm, (10, 1)))
    steps = StaticsSettings(steps=1)
    found = list(Buckling(problem, count=1, preload=0.5, statics=steps).steps())
    assert isinstance(found[0], State)
    assert isinstance(found[-1], Mode)
    assert [step.load_factor for step in found if isinstance(step, State)][-1] == 0.5


def test_reversed(comm: MPI.Comm) -> None:
    """A load the other way: the column is pulled, and buckles under its opposite only."""
    pushed = factors(column(strip(comm, (10, 1))), count=1)
    pulled = column(strip(comm, (10, 1)), load=EULER)
    assert factors(pulled, count=1, negative=True) == pytest.approx([-pushed[0]], rel=1e-7)


@pytest.mark.parametrize("preload", [0.9, 0.98])
def test_reversed_is_linearised_at_rest(preload: float, comm: MPI.Comm) -> None:
    """Whatever the preload: about it the stiffness vanishes elsewhere, too, and that says nothing.

    Both ends are clamped, and a force between them presses one half and pulls the other: by
    symmetry both directions of the load have one factor.
    """
    problem = Problem(
        rectangle_body(size=[30, 1], cells=(12, 1), comm=comm),
        StVenantKirchhoff(**SOFT),
        supports=[Support(on=["left", "right"])],
        loads=[BodyForce(value=[-EULER / 30, 0])],
        degree=2,
    )
    pushed, pulled = factors(problem, count=1, negative=True)
    assert pulled == pytest.approx(-pushed, rel=1e-2)  # the triangles are not symmetric
    share = preload * pushed
    steps = StaticsSettings(steps=1)
    modes = list(Buckling(problem, count=1, negative=True, preload=share, statics=steps).modes())
    assert modes[0].load_factor == pytest.approx(pushed, rel=5e-2)
    assert modes[1].load_factor == pytest.approx(pulled, rel=1e-7)
    tops = [comm.allreduce(np.abs(m.base.x.array).max(initial=0.0), op=MPI.MAX) for m in modes]
    assert tops[0] > 0  # about the pressed column
    assert tops[1] == 0  # about the one at rest


def test_pressed_by_displacement(comm: MPI.Comm) -> None:
    """A prescribed shortening is a load, too: strain at the same force as a free column's."""
    supports = [
        Support(on="left"),
        Support(on="right", displacement=[-0.01, "free"]),
    ]
    problem = Problem(strip(comm, (20, 2)), StVenantKirchhoff(**SOFT), supports=supports, degree=2)
    first = factors(problem, count=1)[0]
    # One end can move sideways but not turn: a quarter wave twice, 4 times Euler's load.
    force = 1e7 / (1 - 0.3**2) * 0.001 * first
    shear = 4 * EULER / (5 / 6 * 1e7 / 2.6)
    assert force == pytest.approx(4 * EULER / (1 + shear), rel=1.5e-2)


@pytest.mark.long
def test_mixed(comm: MPI.Comm) -> None:
    """With a pressure as an unknown: the same factors where both formulations are good.

    At fixed pressure, not at fixed stress, they differ by the strain, 0.2 and 1.7 %.
    """
    law = NeoHookeanSplit(**SOFT)
    both = [
        factors(column(strip(comm, (20, 2)), law, formulation=kind), count=2)
        for kind in ("displacement", "mixed")
    ]
    assert both[1] == pytest.approx(both[0], rel=2e-2)
    assert both[1][0] == pytest.approx(both[0][0], rel=2e-3)


@pytest.mark.parametrize("formulation", ["displacement", "mixed"])
def test_small_strain_laws(formulation: str, comm: MPI.Comm) -> None:
    """Linear buckling needs no more than Hooke's law: equal to St Venant and Kirchhoff's."""
    hooke, large = (
        factors(column(strip(comm, (10, 1)), law(**SOFT), formulation=formulation), count=2)
        for law in (LinearElastic, StVenantKirchhoff)
    )
    assert hooke == pytest.approx(large, rel=1e-8)


@pytest.mark.long
def test_a_stiff_layer_in_rubber_that_is_held_all_around(comm: MPI.Comm) -> None:
    """A layer buckles in an incompressible matrix whose pressure is known up to a constant.

    All sides slide on planes, two of which come nearer, the others give way: nothing else says what
    the mean pressure is, nor does it matter, for its work is that of the volume.  The factors are
    the limit of compressible ones: the difference falls by ten with 1 - 2 nu.
    """
    body = name_parts(
        rectangle_body(size=[3, 1], cells=[12, 8], comm=comm),
        regions={
            "matrix": Selector(all=True),
            "layer": Selector(box=[[0, 0.375], [3, 0.625]]),
        },
    )
    matrix = np.setdiff1d(body.regions["matrix"], body.regions["layer"]).astype(np.int32)
    body = body.named(regions={"matrix": matrix, "layer": body.regions["layer"]})
    squeezed = [
        Support(on="left", displacement=[0, "free"]),
        Support(on="right", displacement=[-0.003, "free"]),
        Support(on="bottom", displacement=["free", 0]),
        Support(on="top", displacement=["free", 0.001]),
    ]

    def first(nu: float) -> float:
        laws = {
            name: NeoHookeanSplit(mu=mu, nu=nu, volumetric="quadratic")
            for name, mu in (("matrix", 1e4), ("layer", 1e6))
        }
        problem = Problem(body, laws, supports=squeezed, degree=2, formulation="mixed")
        return factors(problem, count=1)[0]

    exact, *near = (first(nu) for nu in (0.5, 0.4999, 0.49999))
    off = np.array(near) / exact - 1
    print(exact, off)
    assert exact > 1
    assert abs(off[1]) < 1e-3
    assert abs(off[1]) < 0.2 * abs(off[0])


def test_strains_are_told_of_either_way(comm: MPI.Comm, caplog: Any) -> None:
    """That the reversed loads buckle the body sooner says nothing of these.

    A force along a strip between clamps presses one half or the other; one half is on rollers.
    """
    body = name_parts(strip(comm, (20, 1)), surfaces={"rolled": Selector(box=[[0, 0], [5, 0]])})
    body.mesh.geometry.x[:, 0] *= 3
    problem = Problem(
        body,
        NeoHookean(**SOFT),
        supports=[Support(on=["left", "right"]), Support(on="rolled", displacement=["free", 0])],
        loads=[BodyForce(value=[-1e4, 0])],
        degree=2,
    )
    found = factors(problem, count=1, negative=True)
    assert abs(found[1]) < 0.5 * found[0]
    mine = [r.message for r in caplog.records if "strained by" in r.message]
    told = comm.bcast(mine)  # rank 0 says it
    assert len(told) == 1
    assert f"load factor {found[0]:.6g} " in told[0]


def test_strains_count_from_the_preload(comm: MPI.Comm, caplog: Any) -> None:
    """A stocky column is strained much where it buckles, little from nine tenths of the load on."""
    problem = Problem(
        rectangle_body(size=[1.6, 1], cells=(4, 2), comm=comm),
        NeoHookean(**SOFT),
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[-1e5, 0])],
        degree=2,
    )
    told, load, first = [], 0.0, 0.0
    for share in (0.0, 0.9):
        caplog.clear()
        load = share * first
        (first,) = factors(problem, count=1, preload=load)
        mine = [r.message for r in caplog.records if "strained by" in r.message]
        told.append(comm.bcast(len(mine)))
    assert told == [1, 0]


def test_geometric_stiffness_by_hand() -> None:
    """In numpy, of linear tetrahedra: V grad N_a . sigma . grad N_b of the linear solution."""
    E, nu, load = 2.0e5, 0.25, np.array([-30.0, 20.0, 10.0])
    body = box_body(size=[2, 1, 1], cells=(2, 1, 1), comm=MPI.COMM_SELF)
    problem = Problem(
        body,
        StVenantKirchhoff(E=E, nu=nu),
        supports=[Support(on="left")],
        loads=[BodyForce(value=load.tolist())],
        degree=1,
    )
    at_rest(problem)
    perturbation = Perturbation(problem, 0.0)
    K, G = (
        np.array(matrix[:, :])
        for matrix in (perturbation.assembler.tangent.matrix, perturbation.rate)
    )
    perturbation.destroy()

    X, cells = problem.V.tabulate_dof_coordinates(), problem.V.dofmap.list
    lam, mu = E * nu / (1 + nu) / (1 - 2 * nu), E / 2 / (1 + nu)
    elements = [(c, np.linalg.inv(np.c_[np.ones(4), X[c]])[1:].T) for c in cells]
    volumes = [abs(np.linalg.det(np.c_[np.ones(4), X[c]])) / 6 for c in cells]
    free = np.repeat(X[:, 0] > 0.5, 3)
    stiffness, geometric, forces = np.zeros((len(X), 3) * 2), np.zeros_like(K), np.zeros_like(X)
    for (c, g), V in zip(elements, volumes, strict=True):
        forces[c] += V / 4 * load
        pairs = lam * np.einsum("ai,bj->aibj", g, g) + mu * np.einsum("aj,bi->aibj", g, g)
        pairs += mu * np.einsum("ak,bk,ij->aibj", g, g, np.eye(3))
        for a, at in enumerate(c):
            stiffness[at][:, c] += V * pairs[a]
    stiffness = stiffness.reshape(K.shape)
    u = np.zeros(len(free))
    u[free] = np.linalg.solve(stiffness[np.ix_(free, free)], forces.ravel()[free])
    for (c, g), V in zip(elements, volumes, strict=True):
        H = u.reshape(-1, 3)[c].T @ g
        sigma = lam * np.trace(H) * np.eye(3) + mu * (H + H.T)
        block = np.kron(V * g @ sigma @ g.T, np.eye(3))
        rows = (3 * c[:, None] + np.arange(3)).ravel()
        geometric[np.ix_(rows, rows)] += block
    both = np.ix_(free, free)
    np.testing.assert_allclose(K[both], stiffness[both], rtol=0, atol=1e-12 * abs(K).max())
    # Of the quotient across strains of 1e-6 at most.
    np.testing.assert_allclose(G[both], geometric[both], rtol=0, atol=1e-9 * abs(G).max())
    assert not G[~free].any()
    assert not G[:, ~free].any()


PULL = Traction(on="right", value=["-3*y", 0])
LIFT = Traction(on="top", value=[0, "2*x"])
SKEW = [
    Traction(on="right", value=["-3*y", 0, 0]),
    Traction(on="top", value=[0, 0, "2*x*y"]),
]
VIRIALS: list[tuple[str, list[Load], float]] = [
    ("plane-stress", [PULL, LIFT], -3 / 2 + 2 / 2),
    ("axisymmetric", [PULL], 2 * np.pi * -3 / 2),  # u = r: the radial and the hoop stress
    ("space", SKEW, -3 / 2 + 2 / 4),
    # With the load stiffness: of a pressure p d2V/V = 6 p beside 3 p, of what spins as much again.
    ("space", [Pressure(on=["right", "back", "top"], value=7)], -3 * 7 + 6 * 7),
    ("space", [*SKEW, Centrifugal(value=2, axis="z")], -3 / 2 + 2 / 4),
]


@pytest.mark.parametrize(("geometry", "loads", "exact"), VIRIALS)
def test_virial_of_the_stress(
    geometry: str, loads: list[Load], exact: float, comm: MPI.Comm
) -> None:
    """u K_sigma u with u = x is the integral of tr sigma, which equilibrium gives: of t . x.

    Tractions are formulas, so that the stress is not uniform.
    """
    if geometry == "space":
        body = box_body(size=[1, 1, 1], cells=(2, 1, 1), comm=comm)
        supports: list[Any] = [Symmetry(on=name) for name in ("left", "front", "bottom")]
        keys = {}
    else:
        body, keys = rectangle_body(size=[1, 1], cells=(3, 2), comm=comm), {"geometry": geometry}
        supports = [Symmetry(on="left"), Symmetry(on="bottom")]
    places = np.array([1.0, 1.0, 1.0])[: body.dim]
    if geometry == "axisymmetric":
        supports, places = [Support(on="bottom", displacement=["free", 0])], np.array([1.0, 0.0])
    law = StVenantKirchhoff(E=1e5, nu=0.3, density=5)
    problem = Problem(body, law, supports=supports, loads=loads, degree=2, **keys)
    at_rest(problem)
    perturbation = Perturbation(problem, 0.0)
    x, y = perturbation.rate.createVecs()
    dofs = problem.unknowns.displacement_dofs
    x.array_w[dofs] = (problem.places[:, : body.dim] * places).ravel()[: len(dofs)]
    perturbation.rate.mult(x, y)
    assert x.dot(y) == pytest.approx(exact, rel=1e-8)
    for thing in (x, y, perturbation):
        thing.destroy()


@pytest.mark.parametrize(
    ("shell", "within"), [(ring, 0.01), (arch, 0.01), (cylinder, 0.015), (bedded, 0.02)]
)
def test_closed_forms(shell: Callable[[float], Problem], within: float) -> None:
    """A ring and an arch under a pressure that follows; rings of a tube; a strip on springs."""
    assert factors(shell(1.0), count=1)[0] == pytest.approx(1.0, rel=within)


@pytest.mark.long
def test_loads_that_bend(comm: MPI.Comm) -> None:
    """A steel column of 10 x 10 x 200 mm under 2 kN buckles at Euler's load, whatever bends it.

    By symmetry the sign of what bends does not matter, so that the factor changes with its square:
    the bending stress couples both sides of the column, by 3e-7 at 10 N.
    """
    E, nu, b, L = 210e9, 0.3, 0.01, 0.2
    euler = np.pi**2 * E * b**4 / 12 / 4 / L**2
    engesser = euler / (1 + euler / (5 / 6 * E / 2 / (1 + nu) * b**2))

    def found(across: float) -> float:
        problem = Problem(
            rectangle_body(size=(L, b), cells=(40, 2), comm=comm),
            StVenantKirchhoff(E=E, nu=nu),
            geometry="plane-stress",
            thickness=b,
            degree=2,
            supports=[Support(on="left")],
            loads=[Force(on="right", value=[-2000, across])],
        )
        return factors(problem, count=1)[0]

    straight = found(0.0)
    assert straight == pytest.approx(engesser / 2000, rel=2e-3)  # the clamp holds the width, too
    change = np.array([found(across) for across in (10.0, 100.0)]) / straight - 1
    assert np.all(np.abs(change) < [1e-6, 1e-5])


def refused(comm: MPI.Comm, text: str, error: type[Exception] = InputError, **keys: Any) -> None:
    settings = keys.pop("settings", {})
    whole = {
        "law": NeoHookean(**SOFT),
        "supports": [Support(on="left")],
        "loads": [Traction(on="right", value=[-1, 0])],
        **keys,
    }
    law = whole.pop("law")
    with pytest.raises(error, match=text):
        factors(Problem(strip(comm, (4, 1)), law, degree=1, **whole), **settings)


def test_refused(comm: MPI.Comm) -> None:
    """What has no load factor."""
    refused(
        comm,
        r"materials.body.law: 'linear-elastic' is a law of small rotations: its stiffness .* "
        "st-venant-kirchhoff",
        law=LinearElastic(**SOFT),
        settings={"preload": 0.5},
    )
    refused(
        comm,
        "rotations: with it the load 'pressure' does not follow",
        law=LinearElastic(**SOFT),
        loads=[Pressure(on="top", value=1)],
    )
    refused(
        comm,
        r"load\[1\].curve: a curve or a formula in t is not multiplied",
        loads=[
            PointForce(at=[10, 0], value=[1, 0]),
            Traction(on="right", value=[1, 0], curve="ramp"),
        ],
    )
    refused(
        comm,
        r"support\[1\].curve: a curve or a formula in t",
        supports=[Support(on="left"), Support(on="right", displacement=["0.1*t^2", 0])],
    )
    refused(comm, "load: no load deforms the body", loads=[])
    refused(comm, "there is no support", supports=[])
    refused(
        comm,
        "the loads make it only stiffer",
        ConvergenceError,
        loads=[Traction(on="right", value=[1, 0])],
    )
    refused(
        comm,
        r"load\[0\]: the pressure follows a surface whose edge is free",
        loads=[Pressure(on="right", value=1)],
    )


def test_unstable_before(comm: MPI.Comm) -> None:
    """A straight column beyond its load is nothing to linearise about."""
    problem = column(strip(comm, (10, 1)))
    buckling = Buckling(problem, count=1)
    at_rest(problem)
    problem.u.interpolate(lambda x: np.stack([-0.006 * x[0], 0 * x[0]]))  # thrice Euler's strain
    with pytest.raises(ConvergenceError, match="the body is not stable under 0 times the loads"):
        next(buckling.about_this_state())
