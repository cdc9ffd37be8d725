"""Nearly and exactly incompressible bodies: pressure beside displacement.

References: a manufactured solution at nu = 0.5; Rivlin's torsion of an incompressible cylinder
(Phil. Trans. R. Soc. A 242 (1949)); Lame's tube; Cook's membrane by an independent high-order code
(6.962 +- 0.002 at nu = 0.4999, E = 240.565, load 6.25).
"""

from __future__ import annotations

import json
from functools import cached_property
from typing import Any

import gmsh
import numpy as np
import pytest
import ufl
from mpi4py import MPI

from dolfin_elastic import (
    Case,
    Dynamics,
    Gravity,
    LinearElastic,
    NeoHookean,
    Problem,
    Selector,
    Statics,
    StVenantKirchhoff,
    Support,
    Textbook,
    Traction,
    box_body,
    name_parts,
    read_body,
    rectangle_body,
    run,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.jit import compile_forms
from dolfin_elastic.mesh import Body
from dolfin_elastic.mesh.distribute import make_mesh
from dolfin_elastic.model.loads import Load, LoadContext
from dolfin_elastic.problem.material_regions import locking
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.fields import FIELDS
from dolfin_elastic.results.quantity import Extremes
from dolfin_elastic.solvers.assembly.assembler import integral
from dolfin_elastic.solvers.linear.choice import LinearSettings

FREE = "free"
MU = 2.0


def largest(comm: MPI.Comm, values: Any) -> float:
    return comm.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX)


# --- a manufactured solution at nu = 0.5 ---


def stream(X: Any) -> Any:
    """A displacement without change of volume, and its pressure, in the unit square."""
    x, y = X[0], X[1]
    psi = 0.05 * ufl.sin(2 * x) * ufl.cos(3 * y)
    p = ufl.cos(2 * x) * ufl.sin(y)
    return ufl.as_vector([psi.dx(1), -psi.dx(0)]), p


class Balancing(Load):
    """The body force that keeps them in equilibrium."""

    kind: str = "balancing"
    value: list[Any] = []  # noqa: RUF012  a pydantic field

    @cached_property
    def values(self) -> tuple[float, ...]:
        return ()

    def virtual_work(self, context: LoadContext) -> ufl.Form:
        mesh = ufl.domain.extract_unique_domain(context.v)
        u, p = stream(ufl.SpatialCoordinate(mesh))
        sigma = 2 * MU * ufl.sym(ufl.grad(u)) + p * ufl.Identity(2)
        rule = {"quadrature_degree": 6}
        return -ufl.inner(ufl.div(sigma), context.v) * context.volumes(())(metadata=rule)


WALLS = [
    "-0.15*sin(2*x)*sin(3*y)",
    "-0.1*cos(2*x)*cos(3*y)",
]


def errors(degree: int, n: int) -> np.ndarray:
    """Of u in L2, of grad u, and of p without its mean."""
    body = rectangle_body(size=(1.0, 1.0), cells=(n, n))
    problem = Problem(
        body,
        LinearElastic(mu=MU, nu=0.5),
        degree=degree,
        formulation="mixed",
        supports=[Support(on=["left", "right", "bottom"], displacement=WALLS)],
        # The top is pulled as the solution pulls, so that the pressure has no free constant.
        loads=[Balancing(), _Pull(on="top")],
    )
    [*_] = Statics(problem, rtol=1e-11).steps()
    u, p = stream(ufl.SpatialCoordinate(body.mesh))
    e = problem.u - u
    q = problem.unknowns.auxiliary("pressure", problem.w) - p
    dx = ufl.dx(domain=body.mesh, metadata={"quadrature_degree": 6})
    forms = [ufl.inner(e, e) * dx, ufl.inner(ufl.grad(e), ufl.grad(e)) * dx, q * q * dx]
    return np.sqrt([integral(problem, f) for f in compile_forms(body.comm, forms, problem.jit)])


class _Pull(Balancing):
    kind: str = "pull"
    on: str

    def virtual_work(self, context: LoadContext) -> ufl.Form:
        mesh = ufl.domain.extract_unique_domain(context.v)
        u, p = stream(ufl.SpatialCoordinate(mesh))
        sigma = 2 * MU * ufl.sym(ufl.grad(u)) + p * ufl.Identity(2)
        area = context.areas([self.on])(metadata={"quadrature_degree": 6})
        return ufl.inner(sigma * ufl.FacetNormal(mesh), context.v) * area


@pytest.mark.long
@pytest.mark.parametrize(
    ("degree", "cells", "expected"), [(1, (10, 20, 40), (2, 1, 1.5)), (2, (6, 12, 24), (3, 2, 2))]
)
def test_rates_of_an_incompressible_body(degree, cells, expected):
    """Brezzi & Fortin (1991), VI.3; Bochev, Dohrmann & Gunzburger (2006), theorem 5.1."""
    table = np.array([errors(degree, n) for n in cells])
    rates = np.polyfit(np.log(1 / np.array(cells)), np.log(table), 1)[0]
    print(table.tolist(), rates)
    assert np.all(rates >= np.array(expected) - 0.1)


# --- Cook's membrane ---


def cook(n: int) -> Body:
    side = np.linspace(0, 1, n + 1)
    points = np.array([[48 * a, 44 * a + b * (44 - 28 * a)] for b in side for a in side])
    corners = [j * (n + 1) + i for j in range(n) for i in range(n)]
    cells = [c for a in corners for c in ([a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1])]
    comm = MPI.COMM_WORLD
    mine = comm.rank == 0
    mesh = make_mesh(
        comm,
        np.array(cells if mine else np.empty((0, 3)), dtype=np.int64),
        points if mine else np.empty((0, 2)),
        1,
    )
    ends = {"left": Selector(plane="x", at=0), "right": Selector(plane="x", at=48)}
    return name_parts(Body(mesh), surfaces=ends)


def middle_of_the_end(n: int, load: float = 6.25, **how: Any) -> float:
    problem = Problem(
        cook(n),
        NeoHookean(E=240.565, nu=0.4999),
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[0, load])],
        **{"degree": 1, **how},
    )
    [*_] = Statics(problem).steps()
    x = problem.V.tabulate_dof_coordinates()
    near = np.flatnonzero(np.linalg.norm(x[:, :2] - [48, 52], axis=1) < 1e-9)
    mine = problem.u.x.array[2 * near[0] + 1] if len(near) else -np.inf
    return problem.body.comm.allreduce(float(mine), op=MPI.MAX)


COOK = 6.962


@pytest.mark.long
def test_cook_membrane_locks_and_does_not_lock():
    """Both linear elements on one mesh; then Taylor-Hood towards the reference.

    The clamped corner is singular, which leaves first order in the tip's displacement.
    """
    assert middle_of_the_end(16, degree=1, formulation="displacement") < 0.4 * COOK
    assert middle_of_the_end(16, degree=1, formulation="mixed") > 0.9 * COOK
    found = np.array([middle_of_the_end(n, degree=2) for n in (8, 16, 32)])
    first, second = np.diff(found)
    limit = found[2] + second**2 / (first - second)  # Aitken
    assert limit == pytest.approx(COOK, rel=2e-3)
    assert found[2] == pytest.approx(COOK, rel=6e-3)
    assert 1.8 < first / second < 2.6


def test_cook_membrane_far_up():
    """Three times the load: 17.70 +- 0.03, by the same code."""
    found = np.array([middle_of_the_end(n, 20.0, degree=2) for n in (8, 16, 32)])
    first, second = np.diff(found)
    assert found[2] + second**2 / (first - second) == pytest.approx(17.70, rel=5e-3)


# --- torsion ---


def cylinder(path: Any, size: float, comm: MPI.Comm) -> Body:
    """Radius 1, length 1, quadratic cells that follow the round surface."""
    file = path / f"cylinder{size}.msh"
    if comm.rank == 0:
        gmsh.initialize(interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.occ.addCylinder(0, 0, 0, 0, 0, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(3, [1], name="rubber")
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(2)
        gmsh.write(str(file))
        gmsh.finalize()
    comm.barrier()
    ends = {"low": Selector(plane="z", at=0), "high": Selector(plane="z", at=1)}
    return name_parts(read_body(file, comm=comm), surfaces=ends)


def twisted(body: Body, angle: float, degree: int) -> tuple[float, float, float]:
    """Torque, axial force and largest |det F - 1|."""
    turned = [
        f"x*(cos({angle}*t) - 1) - y*sin({angle}*t)",
        f"x*sin({angle}*t) + y*(cos({angle}*t) - 1)",
    ]
    problem = Problem(
        body,
        NeoHookean(mu=1.0, nu=0.5),
        degree=degree,
        formulation="mixed",
        supports=[Support(on="low"), Support(on="high", displacement=[*turned, 0])],
    )
    *_, state = Statics(problem, steps=2).steps()
    force = Evaluator(problem, ["reaction"])(state)["reaction"]
    place = problem.V.tabulate_dof_coordinates()[: len(force)]
    now = place + problem.u.x.array[: 3 * len(force)].reshape(-1, 3)
    top = place[:, 2] > 1 - 1e-9
    moment = np.sum(np.cross(now[top], force[top])[:, 2])
    found = Extremes(problem).of(state)
    change = max(abs(found["min_jacobian"].value - 1), abs(found["max_jacobian"].value - 1))
    return float(body.comm.allreduce(moment)), float(state.reactions["high"][2]), change


@pytest.mark.long
def test_torsion_of_an_incompressible_cylinder(comm, folder):
    """T = pi mu a^4 psi/2 and N = -pi mu a^4 psi^2/4 at psi = 1: Poynting's effect.

    The ends are turned as plane discs, which the exact solution does too.
    """
    off, cells = [], []
    for size in (0.5, 0.18):
        body = cylinder(folder, size, comm)
        torque, axial, change = twisted(body, 1.0, 2)
        off.append([abs(torque / (np.pi / 2) - 1), abs(axial / (-np.pi / 4) - 1), change])
        cells.append(body.num_cells)
    print(cells, off)
    # Energies and reactions converge twice as fast as strains, which are of second order.
    rates = np.log(np.divide(*off)) / np.log(cells[1] / cells[0]) * 3
    assert np.all(rates > [3.5, 3.5, 2.0])
    assert off[1][0] < 1e-4
    assert off[1][1] < 1e-3


# --- the same answer by other ways ---


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("law", [LinearElastic, StVenantKirchhoff, NeoHookean])
def test_a_homogeneous_state_is_exact(law, degree):
    """Where both formulations are exact they agree: stretched by a tenth, nu = 0.4."""
    answers = []
    for formulation in ("displacement", "mixed"):
        body = box_body(size=(1.0, 1.0, 1.0), cells=(2, 2, 2))
        problem = Problem(
            body,
            law(E=1e3, nu=0.4),
            degree=degree,
            formulation=formulation,
            supports=[
                Support(on="left", displacement=[0, FREE, FREE]),
                Support(on="front", displacement=[FREE, 0, FREE]),
                Support(on="bottom", displacement=[FREE, FREE, 0]),
                Support(on="right", displacement=[0.1, FREE, FREE]),
            ],
        )
        *_, state = Statics(problem, rtol=1e-12).steps()
        answers.append(
            [state.reactions["right"][0], state.energies["strain"], state.max_displacement]
        )
        stress = Evaluator(problem, ["cauchy_stress"])(state)["cauchy_stress"]
        assert largest(body.comm, stress[:, [1, 4, 8]]) < 1e-8 * 1e3
    assert answers[0] == pytest.approx(answers[1], rel=1e-10)


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
def test_iterations_give_the_factorisation_answer(degree):
    found = []
    for method in ("direct", "iterative"):
        problem = Problem(
            box_body(size=(2.0, 1.0, 1.0), cells=(6, 3, 3)),
            NeoHookean(E=1e6, nu=0.5),
            degree=degree,
            formulation="mixed",
            supports=[Support(on="left")],
            loads=[Traction(on="right", value=[0, 0, 2e4])],
        )
        linear = LinearSettings(method=method)
        *_, state = Statics(problem, steps=1, linear=linear, rtol=1e-10).steps()
        found.append((state.max_displacement, state.energies["strain"]))
        assert state.krylov <= 30 * state.newton
    assert found[0] == pytest.approx(found[1], rel=1e-8)


@pytest.mark.long
def test_only_the_part_that_needs_it_has_a_pressure():
    """Rubber on foam: the foam's cells keep their own volumetric energy, and its stress."""
    body = name_parts(
        box_body(size=(1.0, 1.0, 1.0), cells=(2, 2, 4)),
        regions={
            "foam": Selector(box=[[0, 0, 0], [1, 1, 0.5]]),
            "rubber": Selector(box=[[0, 0, 0.5], [1, 1, 1]]),
        },
    )
    laws = {"foam": NeoHookean(E=1e3, nu=0.2), "rubber": NeoHookean(E=1e6, nu=0.4999)}
    walls = [
        Support(on=["left", "right"], displacement=[0, FREE, FREE]),
        Support(on=["front", "back"], displacement=[FREE, 0, FREE]),
        Support(on="bottom", displacement=[FREE, FREE, 0]),
        Support(on="top", displacement=[FREE, FREE, -0.1]),
    ]
    problem = Problem(body, laws, degree=2, supports=walls)
    assert problem.mixed
    *_, state = Statics(problem, steps=2, rtol=1e-11).steps()
    # Laterally held, each layer is a spring: P(J) = mu (J - 1/J) + lmbda ln(J)/J, in series.
    foam, rubber = laws["foam"], laws["rubber"]

    def pressure(law: Any, J: float) -> float:
        return law.mu * (J - 1 / J) + law.lmbda * np.log(J) / J

    low, high = 0.5, 1.0
    for _ in range(200):
        J = (low + high) / 2
        other = (0.9 - J / 2) * 2
        low, high = (J, high) if pressure(foam, J) < pressure(rubber, other) else (low, J)
    assert state.reactions["top"][2] == pytest.approx(pressure(foam, J), rel=2e-6)


@pytest.mark.long
def test_motion_of_an_incompressible_body():
    """Free fall is exact, and a body that swings keeps its energy."""
    body = rectangle_body(size=(2.0, 0.5), cells=(8, 2))
    law = NeoHookean(E=1e5, nu=0.5, density=1000.0)
    falling = Problem(body, law, degree=2, loads=[Gravity()])
    *_, state = Dynamics(falling, end=0.5, dt=0.1, rtol=1e-11).steps()
    exact = [0.0, -9.81 / 8]
    assert largest(body.comm, falling.u.x.array.reshape(-1, 2) - exact) < 1e-8
    hung = Problem(body, law, degree=2, loads=[Gravity()], supports=[Support(on="left")])
    for state in Dynamics(hung, end=0.3, dt=0.01, spectral_radius=1.0).steps():
        gained, given = state.energies["total"], state.energies["external"]
        assert abs(gained - given) < 2e-3 * max(given, 10.0)
    assert state.energies["external"] > 1000.0


# --- what is chosen, and what is refused ---


def block(law: Any, degree: int = 1, **how: Any) -> Problem:
    body = rectangle_body(size=(1.0, 1.0), cells=(4, 4))
    return Problem(body, law, degree=degree, supports=[Support(on="left")], **how)


@pytest.mark.parametrize(
    ("nu", "degree", "formulation", "mixed"),
    [
        (0.44, 2, "auto", False),
        (0.46, 2, "auto", True),
        (0.5, 2, "auto", True),
        (0.49, 1, "auto", False),
        (0.5, 1, "mixed", True),
        (0.3, 1, "mixed", True),
        (0.4999, 2, "displacement", False),
    ],
)
def test_the_choice(nu, degree, formulation, mixed):
    assert block(NeoHookean(E=1e6, nu=nu), degree, formulation=formulation).mixed is mixed


def test_locking_is_warned_of(caplog):
    with caplog.at_level("INFO", logger="dolfin_elastic"):
        problem = block(NeoHookean(E=1e6, nu=0.4999))
        said = " ".join(r.getMessage() for r in caplog.records)
        caplog.clear()
        block(NeoHookean(E=1e6, nu=0.4999), 2)
        chosen = " ".join(r.getMessage() for r in caplog.records)
    said, chosen = problem.body.comm.bcast((said, chosen))  # only rank 0 speaks
    assert "linear elements lock at nu = 0.4999 ('body')" in said
    assert "times too stiff on this mesh" in said
    assert "displacement P2 and pressure P1 (nearly incompressible: body)" in chosen


@pytest.mark.parametrize("other", [0.49, 0.46, 0.3])
def test_materials_that_meet_are_nothing_to_tell(other, caplog):
    """Each has a pressure of its own: there was a note that one field for both is not accurate."""
    half = {
        "a": Selector(box=[[0, 0, 0], [0.5, 1, 1]]),
        "b": Selector(box=[[0.5, 0, 0], [1, 1, 1]]),
    }
    body = name_parts(box_body(size=(1, 1, 1), cells=(2, 2, 2)), regions=half)
    laws = {"a": NeoHookean(E=1e6, nu=0.46), "b": NeoHookean(E=1e6, nu=other)}
    with caplog.at_level("WARNING", logger="dolfin_elastic"):
        Problem(body, laws, degree=2)
    assert body.comm.bcast([r.getMessage() for r in caplog.records]) == []  # only rank 0 speaks


def test_what_locking_costs():
    """At nu = 0.4 lmbda is 4 mu: with cells of half the body x = 4/2^2 = 1, of a quarter 1/4."""
    assert locking(0.4, 2.0) == pytest.approx((1.013, 3.0), rel=1e-12)
    assert locking(0.4, 4.0) == pytest.approx((1.00325, 1.5), rel=1e-12)


@pytest.mark.parametrize(
    ("law", "how", "message"),
    [
        (NeoHookean(E=1e6, nu=0.5), {}, "needs a pressure beside the displacement"),
        (NeoHookean(E=1e6, nu=0.5), {"formulation": "displacement"}, "needs a pressure"),
        (Textbook(E=1e6, nu=0.5), {"formulation": "mixed"}, "'textbook' cannot be incompressible"),
        (Textbook(E=1e6, nu=0.3), {"formulation": "mixed"}, "no material has a volumetric part"),
    ],
)
def test_refusals(law, how, message):
    with pytest.raises(InputError, match=message):
        block(law, **how)


def test_the_explicit_scheme_has_no_pressure():
    problem = block(NeoHookean(E=1e6, nu=0.4, density=1.0), formulation="mixed")
    with pytest.raises(InputError, match="displacements only"):
        next(Dynamics(problem, scheme="symplectic-euler", end=1.0).steps())


@pytest.mark.long
def test_the_volume_change_is_reported(folder):
    """|J - 1| below 1e-3 where nothing is singular: a block sheared between plates."""
    tables = {
        "mesh": {"box": {"size": [1, 1, 1], "cells": [3, 3, 3]}, "degree": 2},
        "materials": {"rubber": {"law": "neo-hookean", "E": 1e6, "nu": 0.4999}},
        "support": [
            {"on": ["left", "right", "front", "back"], "displacement": ["0.2*z*t", 0, 0]},
            {"on": "bottom"},
            {"on": "top", "displacement": [0.2, 0, 0]},
        ],
    }
    [*_] = run(Case.from_dict(tables), output=folder / "out")
    summary = json.loads((folder / "out" / "summary.json").read_text())
    assert summary["volume_change"] < 1e-3
    assert summary["extremes"]["von_mises"]["part"] == "rubber"


# --- what goes together with it ---


def strip(degree: int = 2, nu: float = 0.4999, **how: Any) -> Problem:
    """A clamped strip pulled by a sudden traction."""
    return Problem(
        rectangle_body(size=(1.0, 0.25), cells=(8, 2)),
        NeoHookean(E=1e6, nu=nu, density=1000.0),
        degree=degree,
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[1e4, 0])],
        **how,
    )


@pytest.mark.long
def test_adaptive_steps_judge_the_displacement_only():
    """As many steps as with displacements alone at nu = 0.3, and the same end at that nu."""
    found = []
    for formulation in ("displacement", "mixed"):
        problem = strip(nu=0.3, formulation=formulation)
        states = Dynamics(problem, end=0.02, dt=1e-3, adaptive=True).steps()
        *_, state = states
        found.append((state.step, state.max_displacement))
    assert found[1][0] == pytest.approx(found[0][0], rel=0.2)
    assert found[1][1] == pytest.approx(found[0][1], rel=2e-2)
    *_, state = Dynamics(strip(), end=0.02, dt=1e-3, adaptive=True).steps()
    assert state.max_displacement > 1e-3


@pytest.mark.long
def test_the_pressure_does_not_swing_from_step_to_step():
    """It follows the waves in the strip; extrapolated from the stage it would double and vanish."""
    problem = strip()
    low = []
    for state in Dynamics(problem, end=0.01, dt=5e-4, spectral_radius=1.0).steps():
        if state.step:
            values = Evaluator(problem, ["pressure_cell"])(state)["pressure_cell"]
            comm = problem.body.comm
            low.append(comm.allreduce(float(values.min(initial=np.inf)), op=MPI.MIN))
    assert np.ptp(low) < 0.6 * abs(np.median(low))


@pytest.mark.parametrize("geometry", ["plane-strain", "plane-stress"])
def test_motion_starts_with_the_energy_of_its_shape(geometry):
    """An initial stretch has the energy of the static state of the same shape at once."""
    energies = []
    for formulation in ("displacement", "mixed"):
        problem = Problem(
            rectangle_body(size=(1.0, 1.0), cells=(2, 2)),
            NeoHookean(E=1e6, nu=0.49, density=1000.0),
            formulation=formulation,
            geometry=geometry,
            degree=1,
        )
        first = next(Dynamics(problem, end=1.0, dt=0.1, initial_displacement=["0.1*x", 0]).steps())
        energies.append(first.energies["strain"])
    assert energies[0] == pytest.approx(energies[1], rel=1e-8)
    if geometry == "plane-stress":  # free sides across the plane, held ones in it
        assert energies[0] < 0.5 * 1e6 / (1 - 0.49**2) * 0.1**2 * 1.1


@pytest.mark.parametrize(("degree", "nu"), [(1, 0.5), (2, 0.5), (1, 0.3)])
def test_axisymmetric_patch(degree, nu):
    """A cylinder pressed evenly has one pressure everywhere, also at the axis."""
    body = rectangle_body(size=(1.0, 1.0), cells=(4, 4))
    problem = Problem(
        body,
        LinearElastic(E=1e6, nu=nu),
        degree=degree,
        formulation="mixed",
        geometry="axisymmetric",
        supports=[
            Support(on="bottom", displacement=[FREE, 0]),
            Support(on="top", displacement=[FREE, -0.01]),
        ],
    )
    *_, state = Statics(problem, rtol=1e-12).steps()
    values = Evaluator(problem, ["pressure", "von_mises"])(state)
    assert largest(body.comm, values["pressure"] - 1e4 / 3) < 1e-6 * 1e4
    assert largest(body.comm, values["von_mises"] - 1e4) < 1e-6 * 1e4


def test_nothing_leaves_the_axis():
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    pushed = Support(on="left", displacement=[0.01, FREE])
    problem = Problem(
        body,
        NeoHookean(E=1e6, nu=0.3),
        geometry="axisymmetric",
        supports=[pushed, Support(on="bottom", displacement=[FREE, 0])],
        degree=1,
    )
    *_, state = Statics(problem).steps()
    assert state.max_displacement < 1e-12


def test_every_field_of_a_mixed_problem():
    """Constants of the material, its allowable stress, and what is made of the pressure.

    The law has no fibres, and there is no contact: their fields have no value.
    """
    law = NeoHookean(E=1e6, nu=0.5, density=1000.0, allowable=1e5)
    problem = block(law, 2, loads=[Traction(on="right", value=[1e3, 0])])
    *_, state = Statics(problem).steps()
    names = [name for name, field in FIELDS.items() if not field.motion]
    values = Evaluator(problem, names)(state)
    for name in names:
        bad = problem.body.comm.allreduce(int(np.count_nonzero(~np.isfinite(values[name]))))
        assert bool(bad) == name.startswith(("fibre", "contact_gap")), name
    assert largest(problem.body.comm, values["density"] - 1000) < 1e-9
    assert "safety_factor" in Extremes(problem).of(state)


def test_a_material_is_judged_by_its_largest_poisson_ratio():
    problem = block(NeoHookean(E=1e6, nu="where(x < 0.7, 0.3, 0.499)"), 2)
    assert problem.mixed
    incompressible = NeoHookean(E="1e6*(1 + x)", nu=0.5)
    problem = block(incompressible, 2, loads=[Traction(on="right", value=[1e3, 0])])
    assert problem.mixed
    *_, state = Statics(problem).steps()
    assert state.max_displacement > 1e-4


def test_a_law_without_volumetric_stiffness_needs_no_pressure():
    with pytest.raises(InputError, match="no material has a volumetric part"):
        block(NeoHookean(E=1e6, nu=0.0), formulation="mixed")


# --- where a motion starts ---


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("how", [{"scheme": "newmark"}, {"spectral_radius": 1.0}])
def test_a_confined_body_carries_its_load_at_once(degree, how):
    """It cannot move: 100 Pa on 2 m are 200 N below, but for the round-off of the first solve.

    An acceleration that does not know of the constraint would swing for ever: 389 N, 11 N, ...
    """
    problem = Problem(
        rectangle_body(size=(2.0, 1.0), cells=(4, 2)),
        NeoHookean(E=1e5, nu=0.5, density=1000.0),
        degree=degree,
        formulation="mixed",
        supports=[
            Support(on=["left", "right"], displacement=[0, FREE]),
            Support(on="bottom", displacement=[FREE, 0]),
        ],
        loads=[Traction(on="top", value=[0, -100.0])],
    )
    states = list(Dynamics(problem, end=0.05, dt=0.01, **how).steps())
    found = [state.reactions["bottom"][1] for state in states]
    assert found == pytest.approx([200.0] * 6, rel=1e-9)
    assert [state.audit.verdict for state in states] == ["pass"] * 6  # no energy to speak of


@pytest.mark.long
def test_a_ring_that_is_opened_knows_its_acceleration():
    """r r' = C and free sides: C' = C^2 (1/a^2 - 1/b^2)/(2 ln(b/a)), r'' = C'/r - C^2/r^3.

    From Euler's equation integrated from a to b, like Rayleigh's of a bubble (Philosophical
    Magazine 34 (1917) 94), of a cylinder.  Without v . g'' v the acceleration would be zero.
    """
    off = []
    for n in (4, 8):
        problem = Problem(
            rectangle_body(size=(1.0, 0.25), cells=(n, n // 4), origin=(1.0, 0.0)),
            NeoHookean(E=1e5, nu=0.5, density=1000.0),
            degree=2,
            geometry="axisymmetric",
            supports=[Support(on=["bottom", "top"], displacement=[FREE, 0])],
        )
        motion = Dynamics(problem, end=1e-3, dt=1e-3, initial_velocity=["3/x", 0])
        state = next(motion.steps())
        x = problem.V.tabulate_dof_coordinates()[:, 0]
        exact = 9 * (1 - 1 / 4) / (2 * np.log(2)) / x - 9 / x**3
        square = (state.a.x.array.reshape(-1, 2)[:, 0] - exact) ** 2
        count = problem.V.dofmap.index_map.size_local
        sums = np.array([square[:count].sum(), float(count)])
        found = problem.body.comm.allreduce(sums, op=MPI.SUM)
        off.append(np.sqrt(found[0] / found[1]))
    print(off)
    # The acceleration is as good as the gradient of the linear pressure: of first order.
    assert np.log2(off[0] / off[1]) > 1.0
    assert off[1] < 0.05 * 4.13  # of what is at the inside
