"""Ties: surfaces with different meshes move together.

Patch test: a state of constant stress passes a flat interface exactly, whatever the two meshes are,
because the same quadrature points of the common pieces serve both sides.  Source: M. A. Puso, Int.
J. Numer. Meth. Engng 59 (2004) 315, section 5.1.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.bodies import turned
from helpers.ranks import SIZES, on_ranks
from helpers.stacked import quarter_rings, stacked
from mpi4py import MPI

from dolfin_elastic import (
    Buckling,
    Dynamics,
    LinearElastic,
    Modal,
    NeoHookean,
    NeoHookeanSplit,
    Normal,
    Pressure,
    Problem,
    Statics,
    StVenantKirchhoff,
    Support,
    Tie,
    Traction,
    box_body,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.problem.constraints.ties import segments
from dolfin_elastic.solvers.linear.choice import LinearSettings

COMM = MPI.COMM_WORLD
E, NU = 1e6, 0.3
STEEL = LinearElastic(E=E, nu=NU, density=1000.0)
MESHES: dict[int, dict[str, Any]] = {
    2: {"size": (1.0, 0.6), "lower": (3, 2), "upper": (5, 2)},
    3: {"size": (1.0, 0.8, 0.6), "lower": (3, 2, 2), "upper": (4, 3, 2)},
}


def pulled(dim: int, degree: int, tie: Tie, **solver: Any) -> tuple[Problem, Any]:
    """Two boxes on planes of symmetry, pulled at the top."""
    size = [*["free"] * (dim - 1)]
    supports = [
        Support(on="bottom", displacement=[*size, 0]),
        Support(on="left", displacement=[0, *size]),
    ]
    if dim == 3:
        supports.append(Support(on="front", displacement=["free", 0, "free"]))
    problem = Problem(
        stacked(**MESHES[dim]),
        STEEL,
        supports=supports,
        loads=[Traction(on="top", value=[0.0] * (dim - 1) + [1e4])],
        ties=[tie],
        degree=degree,
    )
    return problem, list(Statics(problem, steps=1, **solver).steps())[-1]


@pytest.mark.parametrize("on", ["above", "below"])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("dim", [2, 3])
def test_patch_test(dim: int, degree: int, on: str) -> None:
    """Round-off of displacements of 1e-2 is the only error; supports cross the interface."""
    problem, state = pulled(dim, degree, Tie(on=on, to={"above": "below", "below": "above"}[on]))
    across = -NU / E if dim == 3 else -NU * (1 + NU) / E  # plane strain
    along = 1 / E if dim == 3 else (1 - NU**2) / E
    x = problem.V.tabulate_dof_coordinates()[:, :dim]
    exact = 1e4 * x * np.array([across] * (dim - 1) + [along])
    u = problem.u.x.array.reshape(-1, dim)
    assert np.abs(u - exact).max(initial=0.0) < 1e-11 * 1e-2
    area = np.prod(MESHES[dim]["size"][:-1])
    assert state.reactions["bottom"][-1] == pytest.approx(-1e4 * area, rel=1e-10)


@pytest.mark.parametrize("degree", [1, 2])
def test_patch_test_by_multigrid(degree: int) -> None:
    """The same with conjugate gradients, whose tolerance is the error; they take few iterations."""
    problem, state = pulled(
        3, degree, Tie(on="above", to="below"), linear=LinearSettings(method="iterative")
    )
    x = problem.V.tabulate_dof_coordinates()
    exact = 1e4 / E * x * np.array([-NU, -NU, 1.0])
    assert np.abs(problem.u.x.array.reshape(-1, 3) - exact).max(initial=0.0) < 1e-8 * 1e-2
    assert state.krylov < 40


def sheared(law: Any, H: np.ndarray) -> Problem:
    """All of the outer boundary follows u = H X; the interface inside is tied."""
    rows = [" + ".join(f"({float(h)!r})*{c}" for h, c in zip(r, "xyz", strict=True)) for r in H]
    outside = ["bottom", "top", "left", "right", "front", "back"]
    return Problem(
        stacked((1.0, 0.8, 0.6), (3, 2, 2), (2, 3, 2)),
        law,
        supports=[Support(on=outside, displacement=rows)],
        ties=[Tie(on="below", to="above")],
        degree=2,
    )


def test_patch_test_of_large_strains() -> None:
    """An affine motion with 30 % strain and shear, prescribed outside, goes on through the tie."""
    H = np.array([[0.2, 0.3, -0.1], [0.1, -0.1, 0.2], [-0.2, 0.1, 0.1]])
    problem = sheared(NeoHookean(E=E, nu=NU), H)
    list(Statics(problem, steps=1).steps())
    x = problem.V.tabulate_dof_coordinates()
    assert np.abs(problem.u.x.array.reshape(-1, 3) - x @ H.T).max(initial=0.0) < 1e-9


def cantilever(tied: bool, degree: int = 2, **keys: Any) -> Problem:
    """A beam of 4 x 0.5 x 0.5, one mesh or two halves that are tied along its middle plane."""
    if tied:
        body = stacked((4.0, 0.5, 0.5), (16, 2, 1), (11, 3, 1))
        ties = [Tie(on="above", to="below")]
    else:
        body, ties = box_body(size=(4.0, 0.5, 0.5), cells=(16, 3, 2)), []
    return Problem(
        body,
        keys.pop("law", STEEL),
        supports=[Support(on="left", displacement=[0, 0, 0])],
        ties=ties,
        degree=degree,
        **keys,
    )


def test_bending_of_a_beam_in_two_halves() -> None:
    """The work of the load is that of the joined beam within what the coarser mesh makes (1 %)."""
    found = []
    for tied in (False, True):
        problem = cantilever(tied, loads=[Traction(on="right", value=[0.0, 0.0, 10.0])])
        state = list(Statics(problem, steps=1).steps())[-1]
        assert state.reactions["left"][2] == pytest.approx(-10.0 * 0.25, rel=1e-8)
        found.append(state.energies["strain"])
    assert found[1] == pytest.approx(found[0], rel=0.01)


def strain_energy(comm: MPI.Comm) -> float:
    """Of the two halves under shear at the end, on some ranks."""
    problem = Problem(
        stacked((2.0, 0.5, 0.5), (5, 2, 1), (4, 3, 1), comm=comm),
        STEEL,
        supports=[Support(on="left", displacement=[0, 0, 0])],
        loads=[Traction(on="right", value=[0.0, 0.0, 10.0])],
        ties=[Tie(on="above", to="below")],
    )
    return float(list(Statics(problem, steps=1).steps())[-1].energies["strain"])


def test_the_same_on_any_number_of_ranks() -> None:
    """Both sides of a tie may belong to any ranks: round-off of sums is the only difference."""
    energies = [on_ranks(count, strain_energy) for count in SIZES]
    assert energies[0] > 0.0
    np.testing.assert_allclose(energies, energies[0], rtol=1e-10)


def test_natural_frequencies_of_a_beam_in_two_halves() -> None:
    """Those of the joined beam within 1 %; modes carry the mass of the whole body."""
    both = [list(Modal(cantilever(tied), count=4).steps()) for tied in (False, True)]
    joined, tied = ([mode.frequency for mode in modes] for modes in both)
    np.testing.assert_allclose(tied, joined, rtol=0.01)
    whole = [sum(mode.effective["z"] for mode in modes) for modes in both]
    assert whole[1] == pytest.approx(whole[0], rel=0.02)


def test_buckling_of_a_column_in_two_halves() -> None:
    """The critical load of the joined column within 1 %."""
    factors = []
    for tied in (False, True):
        loads = [Traction(on="right", value=[-100.0, 0.0, 0.0])]
        problem = cantilever(tied, loads=loads, law=StVenantKirchhoff(E=E, nu=NU))
        (mode,) = (m for m in Buckling(problem, count=1).steps() if hasattr(m, "eigenvalue"))
        factors.append(mode.eigenvalue)
    assert factors[1] == pytest.approx(factors[0], rel=0.01)


def test_motion_conserves_energy_and_momentum() -> None:
    """A block in two halves is thrown and swings freely: Newmark's method keeps its energy."""
    problem = Problem(
        stacked((1.0, 0.8, 0.6), (2, 2, 1), (3, 2, 1)),
        STEEL,
        ties=[Tie(on="above", to="below")],
        degree=1,
    )
    motion = Dynamics(
        problem,
        scheme="newmark",
        dt=2e-3,
        end=0.04,
        initial_velocity=["1 + 0.5*z*x", "0.3*z", "-0.2*x"],
    )
    states = list(motion.steps())
    energies = [sum(state.energies[k] for k in ("strain", "kinetic")) for state in states]
    assert max(state.energies["strain"] for state in states) > 1e-3 * energies[0]
    np.testing.assert_allclose(energies, energies[0], rtol=1e-8)


def test_surfaces_too_far_apart_are_refused() -> None:
    """With the distance, the place and the tolerance that would do."""
    body = stacked((1.0, 0.6), (3, 2), (5, 2), gap=0.1)
    hold = [Support(on="bottom", displacement=[0, 0])]
    with pytest.raises(InputError, match=r'are 0\.1 m apart.*tolerance = "0\.12 m" or more'):
        Problem(body, STEEL, supports=hold, ties=[Tie(on="above", to="below")])
    problem = Problem(
        body, STEEL, supports=hold, ties=[Tie(on="above", to="below", tolerance=0.12)]
    )
    assert problem.constraints.ties is not None
    assert problem.constraints.ties.surfaces[0].gap == pytest.approx(0.1)


def test_of_large_surfaces_few_pairs_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """To say how far apart they are; all pairs of fine meshes would take all memory."""
    pairs = [0]
    found = segments._candidates

    def counted(*arguments: Any, **keys: Any) -> Any:
        i, j = found(*arguments, **keys)
        pairs.append(len(i))
        return i, j

    monkeypatch.setattr(segments, "_candidates", counted)
    body = stacked((1.0, 0.6), (60, 1), (60, 1), gap=0.1)
    with pytest.raises(InputError, match=r"are 0\.1 m apart"):
        Problem(body, STEEL, ties=[Tie(on="above", to="below")])
    assert max(pairs) < 60 * 60 / 2


def test_surfaces_that_are_not_opposite_are_refused() -> None:
    """Side by side, or at right angles."""
    body = stacked((1.0, 0.6), (3, 2), (5, 2))
    with pytest.raises(InputError, match="lie nowhere opposite each other"):
        Problem(body, STEEL, ties=[Tie(on="above", to="left")])


def test_ties_in_a_circle_are_refused() -> None:
    """Each side would follow the other."""
    body = stacked((1.0, 0.6), (3, 2), (5, 2))
    ties = [Tie(on="above", to="below"), Tie(on="below", to="above")]
    with pytest.raises(InputError, match="in a circle"):
        Problem(body, STEEL, ties=ties)


def test_explicit_schemes_are_refused() -> None:
    """Their mass is lumped at nodes, of which tied ones have none."""
    problem = Problem(
        stacked((1.0, 0.6), (3, 2), (5, 2)), STEEL, ties=[Tie(on="above", to="below")], degree=1
    )
    with pytest.raises(InputError, match="explicit schemes have a mass at each node"):
        list(Dynamics(problem, scheme="central-differences", end=1e-3).steps())


def lame(n: int, degree: int, order: int) -> tuple[float, Any]:
    """Error of the displacement of a thick tube of two tied rings, and the state.

    Bore under pressure, plane strain.  Source: Timoshenko & Goodier, Theory of Elasticity, section
    28.
    """
    body = quarter_rings((1.0, 1.5, 2.0), (3 * n // 2, n // 2), (n, n // 2), order)
    problem = Problem(
        body,
        STEEL,
        supports=[
            Support(on="bottom", displacement=["free", 0]),
            Support(on="left", displacement=[0, "free"]),
        ],
        loads=[Pressure(on="bore", value=1e3)],
        ties=[Tie(on="outside", to="inside")],
        degree=degree,
    )
    state = list(Statics(problem, steps=1).steps())[-1]
    x = problem.V.tabulate_dof_coordinates()[:, :2]
    r = np.linalg.norm(x, axis=1)[:, None]
    exact = (1 + NU) / E * 1e3 / 3 * ((1 - 2 * NU) + 4 / r**2) * x
    off = np.abs(problem.u.x.array.reshape(-1, 2) - exact).max(initial=0.0)
    return COMM.allreduce(float(off), op=MPI.MAX) / ((1 + NU) / E * 1e3 / 3 * 4.4), state


@pytest.mark.parametrize(("degree", "order", "rate"), [(1, 1, 1.7), (2, 1, 1.8), (2, 2, 2.6)])
def test_cylinder_in_a_cylinder(degree: int, order: int, rate: float) -> None:
    """Lame's tube, whose interface is curved: facets that do not coincide leave gaps of h^2.

    Second order with straight cells.  Curved ones would have the third order in the largest error;
    biorthogonal multipliers, which reproduce constants only, cost up to half of it.
    """
    coarse, _ = lame(8, degree, order)
    fine, state = lame(16, degree, order)
    assert np.log2(coarse / fine) > rate
    assert fine < (0.02 if order == 1 else 1e-4)
    assert state.audit.verdict == "pass"
    assert np.linalg.norm(state.reactions["tie_outside"]) > 0.0


@pytest.mark.parametrize("dim", [2, 3])
def test_moments_balance_where_a_support_holds_one_component_of_tied_nodes(dim: int) -> None:
    """The rows of the others follow other nodes, to which large strains make levers."""
    problem = Problem(
        stacked(**MESHES[dim]),
        NeoHookean(E=E, nu=NU),
        supports=[
            Support(on="left", displacement=["free"] * (dim - 1) + [0]),
            Support(on="bottom", displacement=[0] * dim),
        ],
        loads=[Traction(on="top", value=[2e4] + [1e4] * (dim - 1))],
        ties=[Tie(on="below", to="above")],
        degree=1,
    )
    state = list(Statics(problem, steps=2).steps())[-1]
    assert state.audit.verdict == "pass"
    assert state.audit.moment < 1e-9


def test_axisymmetric_patch_test() -> None:
    """A tied bar of revolution: areas are those of rings, however small these are."""
    problem = Problem(
        stacked(**{**MESHES[2], "size": (1e-3, 6e-4)}),
        STEEL,
        supports=[Support(on="bottom", displacement=["free", 0])],
        loads=[Traction(on="top", value=[0.0, 1e4])],
        ties=[Tie(on="above", to="below")],
        geometry="axisymmetric",
    )
    list(Statics(problem, steps=1).steps())
    x = problem.V.tabulate_dof_coordinates()[:, :2]
    off = problem.u.x.array.reshape(-1, 2) - 1e4 / E * x * [-NU, 1.0]
    assert np.abs(off).max(initial=0.0) < 1e-14 * 1e-2


@pytest.mark.long
def test_incompressible_patch_test() -> None:
    """With a pressure beside the displacement, which each body has of its own."""
    problem = Problem(
        stacked(**MESHES[3]),
        NeoHookeanSplit(E=E, nu=0.5),
        supports=[
            Support(on="bottom", displacement=["free", "free", 0]),
            Support(on="left", displacement=[0, "free", "free"]),
            Support(on="front", displacement=["free", 0, "free"]),
            Support(on="top", displacement=["free", "free", 0.06]),
        ],
        ties=[Tie(on="above", to="below")],
    )
    state = list(Statics(problem, steps=2).steps())[-1]
    x = problem.V.tabulate_dof_coordinates()
    across = 1.1**-0.5 - 1
    off = problem.u.x.array.reshape(-1, 3) - x * [across, across, 0.1]
    assert np.abs(off).max(initial=0.0) < 1e-9
    force = E / 3 * (1.1 - 1.1**-2) * 0.8  # mu (a - a^-2) per undeformed area
    assert state.reactions["tie_above"][2] == pytest.approx(-force, rel=1e-8)


def test_rollers_across_the_interface() -> None:
    """Supports along directions that are no axes meet tied nodes: the patch test holds."""
    body = stacked(**MESHES[3])
    rotation = turned(body, [1, 2, 3], 0.7)
    problem = Problem(
        body,
        STEEL,
        supports=[Normal(on=on) for on in ("bottom", "left", "front")],
        loads=[Traction(on="top", value=list(1e4 * rotation[:, 2]))],
        ties=[Tie(on="above", to="below")],
    )
    list(Statics(problem, steps=1).steps())
    x = problem.V.tabulate_dof_coordinates()
    exact = 1e4 / E * (x @ rotation * [-NU, -NU, 1.0]) @ rotation.T
    assert np.abs(problem.u.x.array.reshape(-1, 3) - exact).max(initial=0.0) < 1e-10 * 1e-2
