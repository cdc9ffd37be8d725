"""Bodies whose pressure is known up to a constant: which they are, and that all solvers agree."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx.mesh import locate_entities
from mpi4py import MPI

from dolfin_elastic import (
    BodyForce,
    Dynamics,
    Growth,
    LinearElastic,
    Modal,
    MooneyRivlin,
    NeoHookean,
    Problem,
    Rigid,
    Selector,
    Statics,
    StVenantKirchhoff,
    Support,
    box_body,
    name_parts,
    rectangle_body,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest, smallest, total
from dolfin_elastic.solvers.assembly.hydrostatic_constant import HydrostaticConstant
from dolfin_elastic.solvers.linear.choice import LinearSettings

COMM = MPI.COMM_WORLD
FREE = "free"
SIDES = ["left", "right", "front", "back", "bottom"]
LAW = NeoHookean(mu=1.0, nu=0.5, density=1.0)
ROLLERS = [
    Support(on=["left", "right"], displacement=[0, FREE, FREE]),
    Support(on=["front", "back"], displacement=[FREE, 0, FREE]),
    Support(on=["bottom", "top"], displacement=[FREE, FREE, 0]),
]


def block(
    supports: Any, law: Any = LAW, *, degree: int = 2, cells: int = 2, **more: Any
) -> Problem:
    body = box_body(size=(1.0, 1.0, 1.0), cells=(cells,) * 3)
    return Problem(body, law, degree=degree, formulation="mixed", supports=supports, **more)


def sheared(top: list[Any]) -> list[Support]:
    return [Support(on=SIDES), Support(on="top", displacement=top)]


SHEAR = sheared(["0.3*sin(pi*x)^2*sin(pi*y)^2", 0, 0])


def pressures(problem: Problem) -> tuple[float, float]:
    """The smallest and the largest."""
    dofs = np.unique(problem.W.sub(1).dofmap.list)
    values = problem.w.x.array[dofs] * float(problem.unknowns.scale["pressure"].value)
    return smallest(COMM, float(values.min())), largest(COMM, float(values.max()))


@pytest.mark.parametrize(
    ("supports", "law", "count"),
    [
        (SHEAR, LAW, 1),
        (ROLLERS, LAW, 1),
        (SHEAR[:1], LAW, 0),
        (ROLLERS[:2], LAW, 0),
        (SHEAR, LinearElastic(mu=1.0, nu=0.5), 1),
        (SHEAR, NeoHookean(mu=1.0, nu=0.4999), 0),
    ],
)
def test_which_bodies_have_one(supports, law, count):
    assert len(HydrostaticConstant(block(supports, law)).bodies) == count


def test_of_two_bodies_the_one_that_is_held():
    """Two blocks that share no node, of which one has a free surface."""
    body = name_parts(
        rectangle_body(size=(1.0, 1.0), cells=(4, 4)),
        regions={"all": Selector(all=True)},
        surfaces={"rim": Selector(all=True)},
    )
    held = Problem(body, NeoHookean(mu=1.0, nu=0.5), degree=2, supports=[Support(on="rim")])
    (found,) = HydrostaticConstant(held).bodies
    assert total(COMM, len(found.pinned[found.pinned < held.W.dofmap.index_map.size_local])) == 1
    assert total(COMM, float(found.weights.sum())) == pytest.approx(1.0, rel=1e-12)
    assert found.volume == pytest.approx(1.0, rel=1e-12)


def test_a_soft_part_leaves_no_constant():
    """Foam inside the held body gives way: the pressure of the rubber is known."""
    body = name_parts(
        box_body(size=(1.0, 1.0, 1.0), cells=(2, 2, 2)),
        regions={
            "foam": Selector(box=[[0, 0, 0], [1, 1, 0.5]]),
            "rubber": Selector(box=[[0, 0, 0.5], [1, 1, 1]]),
        },
    )
    laws = {"foam": NeoHookean(mu=1.0, nu=0.2), "rubber": LAW}
    problem = Problem(body, laws, degree=2, supports=ROLLERS)
    assert HydrostaticConstant(problem).bodies == []


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
def test_iterations_and_factors_agree(degree):
    """Fieldsplit with GMRES, and LDL^T, in space, where J is a cubic polynomial in each cell."""
    found = []
    for method in ("direct", "iterative"):
        problem = block(SHEAR, degree=degree, cells=3)
        linear = LinearSettings(method=method)
        *_, state = Statics(problem, rtol=1e-10, linear=linear).steps()
        found.append([state.energies["strain"], *pressures(problem)])
        assert state.negative == 0
        assert state.krylov <= 60 * max(state.newton, 1)
    assert found[0] == pytest.approx(found[1], rel=1e-6)


def test_a_body_force_that_has_a_potential_moves_nothing():
    """Rollers all around and b = grad phi: p = -phi up to its mean, and no displacement.

    phi = x^2 - 1/3 is not linear, so that the elements leave a small displacement.
    """
    problem = block(ROLLERS, loads=[BodyForce(value=[2.0, 0, 0])])
    *_, state = Statics(problem, rtol=1e-12).steps()
    assert state.max_displacement < 1e-10
    low, high = pressures(problem)
    assert (low, high) == pytest.approx((-1.0, 1.0), rel=1e-8)
    assert state.reactions["left+right"][0] == pytest.approx(-2.0, rel=1e-8)


@pytest.mark.parametrize("height", [-0.01, 0.2])
def test_supports_that_change_the_volume_are_refused(height):
    problem = block(sheared([0, 0, height]))
    with pytest.raises(InputError, match=r"support: the body is incompressible and constrained"):
        [*_] = Statics(problem).steps()


@pytest.mark.parametrize("stretches", [[1.1, 1, 1], [1.01, 1.01, 1.01]])
def test_growth_that_has_no_room_is_refused(stretches):
    """The second is as heat: nothing but the uniform pressure is out of balance from the start."""
    problem = block([Support(on=[*SIDES, "top"])], loads=[Growth(value=stretches)])
    with pytest.raises(InputError, match="or heat or growth, change its volume by"):
        [*_] = Statics(problem).steps()


def test_a_wave_between_nodes_is_spread(caplog):
    """Up here, down there: the volume is kept, in the program up to the error of its nodes."""
    problem = block(sheared([0, 0, "0.1*sin(2*pi*x)*sin(pi*y)^2"]), cells=3)
    *_, state = Statics(problem).steps()
    assert state.negative == 0
    assert state.energies["strain"] > 0.0


def test_a_law_that_does_not_keep_volumes_is_refused():
    law = StVenantKirchhoff(mu=1.0, nu=0.5)
    with pytest.raises(InputError, match=r"materials\.body\.nu: the law 'st-venant-kirchhoff'"):
        [*_] = Statics(block(SHEAR, law)).steps()


def test_a_platen_knows_the_pressure():
    """Only a rigid surface changes the volume: its force over its area, whatever is behind it."""
    platen = Rigid(on="top", displacement=[0, 0, FREE], rotation=[0, 0, 0], force=[0, 0, -2.0])
    problem = block([*ROLLERS[:2], Support(on="bottom", displacement=[FREE, FREE, 0]), platen])
    *_, state = Statics(problem).steps()
    assert pressures(problem) == pytest.approx((-2.0, -2.0), rel=1e-8)
    assert state.max_displacement < 1e-9
    assert state.negative == 0


@pytest.mark.long
def test_motion_of_a_held_body():
    """Stirred inside, it keeps energy and volume, and its pressure has no mean at any state."""
    problem = Problem(
        rectangle_body(size=(1.0, 1.0), cells=(4, 4)),
        LAW,
        degree=2,
        supports=[Support(on=["left", "right", "bottom", "top"])],
    )
    (body,) = HydrostaticConstant(problem).bodies
    swirl = ["0.3*sin(pi*x)^2*sin(2*pi*y)", "-0.3*sin(2*pi*x)*sin(pi*y)^2"]
    motion = Dynamics(problem, end=1.0, dt=0.05, spectral_radius=1.0, initial_velocity=swirl)
    first = None
    for state in motion.steps():
        first = first or state.energies["total"]
        assert state.energies["total"] == pytest.approx(first, rel=1e-3)
        own = float(np.sum(body.weights * problem.w.x.array[body.dofs]))
        assert abs(total(COMM, own)) < 1e-12
    low, high = pressures(problem)
    assert low < 0.0 < high
    assert high - low < 5.0


def test_modes_of_a_held_body():
    """As many as there are, and none of the constant pressure."""
    problem = Problem(
        rectangle_body(size=(1.0, 1.0), cells=(8, 8)),
        LAW,
        degree=2,
        supports=[Support(on=["left", "right", "bottom", "top"])],
    )
    modes = [mode.frequency for mode in Modal(problem, count=3).steps()]
    # The square's Stokes eigenvalues, 52.3447 the lowest (times mu/rho): omega^2.
    assert (2 * np.pi * modes[0]) ** 2 == pytest.approx(52.3447, rel=3e-3)


@pytest.mark.parametrize(
    ("law", "said"),
    [
        (MooneyRivlin(c10=0.5, c01=0.1, nu=0.4999), True),
        (MooneyRivlin(c10=0.5, c01=0.1, nu=0.4999, volumetric="quadratic"), False),
        (MooneyRivlin(c10=0.5, c01=0.1, nu=0.47), False),
        (NeoHookean(mu=1.0, nu=0.4999), True),
    ],
)
def test_the_mean_pressure_of_a_nearly_incompressible_body(law, said):
    """With K = 5e4 mu, U not quadratic and 8 x 8 cells it was a hundred times what it should be."""
    notes = HydrostaticConstant(block(SHEAR, law)).notes()
    assert any("nearly incompressible and has no free surface" in note for note in notes) is said


# --- several materials, each with a pressure of its own ---


def layered(supports: Any, low: float, high: float, **more: Any) -> Problem:
    """The unit square: two layers of rubber, of shear moduli 1 and 3."""
    body = name_parts(
        rectangle_body(size=(1.0, 1.0), cells=(4, 4)),
        regions={
            "soft": Selector(box=[(0, 0), (1, 0.5)]),
            "hard": Selector(box=[(0, 0.5), (1, 1)]),
        },
    )
    cut = locate_entities(body.mesh, 1, lambda x: np.isclose(x[1], 0.5))
    body = body.named(surfaces={"between": np.sort(cut)})
    laws = {"soft": NeoHookean(mu=1.0, nu=low), "hard": NeoHookean(mu=3.0, nu=high)}
    return Problem(body, laws, degree=2, supports=supports, **more)


RIM = ["left", "right", "bottom", "top"]


@pytest.mark.parametrize(
    ("held", "low", "high", "labels"),
    [
        (RIM, 0.5, 0.5, ["the body"]),
        (RIM, 0.5, 0.49, []),
        (RIM[:3], 0.5, 0.5, []),
        ([*RIM, "between"], 0.5, 0.5, ["'hard'", "'soft'"]),
        ([*RIM[:3], "between"], 0.5, 0.5, ["'soft'"]),
        ([*RIM, "between"], 0.49, 0.5, ["'hard'"]),
        (["between"], 0.5, 0.5, []),
    ],
)
def test_which_materials_have_one(held, low, high, labels):
    """Through an interface that is free the uniform pressures are one; a held one parts them."""
    level = HydrostaticConstant(layered([Support(on=held)], low, high))
    assert [body.label for body in level.bodies] == labels
    for body in level.bodies:
        assert total(COMM, float(body.weights.sum())) == pytest.approx(1.0, rel=1e-12)
        assert total(COMM, len(body.dofs)) == (30 if labels == ["the body"] else 15)
        assert body.volume == pytest.approx(1.0 if labels == ["the body"] else 0.5, rel=1e-12)


@pytest.mark.parametrize("method", ["direct", "iterative"])
def test_two_layers_that_are_held_apart(method):
    """Each has the pressure with the mean zero, as if it were alone: b = grad phi in each."""
    problem = layered(
        [Support(on=[*RIM, "between"])],
        0.5,
        0.5,
        loads=[BodyForce(value=[0, "2.0*y"])],
    )
    linear = LinearSettings(method=method)
    *_, state = Statics(problem, rtol=1e-11, linear=linear).steps()
    if method == "direct":
        assert state.negative == 0
    table = problem.W.sub(1).dofmap.list
    mesh, scale = problem.body.mesh, float(problem.unknowns.scale["pressure"].value)
    heights = mesh.geometry.x[mesh.geometry.dofmap][:, :, 1]
    for region, mean in zip(problem.regions, (1 / 12, 7 / 12), strict=True):
        found = scale * problem.w.x.array[table[region.cells]]
        # Linear pressures follow y^2 to the square of the size of cells; -p is the unknown's sign.
        off = np.abs(found + heights[region.cells] ** 2 - mean).max(initial=0.0)
        assert largest(COMM, float(off)) < 0.03


@pytest.mark.parametrize("nu", [0.5, 0.4999])
def test_thin_layers(nu):
    """Sheets of one cell each are not over-constrained: bent, they are those of two cells."""
    energies = []
    for rows in (1, 2):
        body = rectangle_body(size=(4.0, 1.0), cells=(24, 6 * rows))
        regions = {f"s{k}": Selector(box=[(0, k / 6), (4, (k + 1) / 6)]) for k in range(6)}
        body = name_parts(body, regions=regions)
        laws = {f"s{k}": NeoHookean(mu=10.0 if k % 2 else 1.0, nu=nu) for k in range(6)}
        problem = Problem(
            body,
            laws,
            degree=2,
            supports=[Support(on="left"), Support(on="right", displacement=[FREE, 0.1])],
        )
        *_, state = Statics(problem).steps()
        assert state.negative == 0
        energies.append(state.energies["strain"])
        low, high = pressures(problem)
        assert max(-low, high) < 30.0
    assert energies[0] == pytest.approx(energies[1], rel=0.02)
