"""Why a solve failed: each cause produced in reality, its place, its advice, on any ranks alike."""

from __future__ import annotations

import json
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from mpi4py import MPI

from dolfin_elastic import (
    Body,
    BodyForce,
    Contact,
    Dynamics,
    Energy,
    LinearElastic,
    MooneyRivlin,
    NeoHookean,
    Normal,
    Pressure,
    Problem,
    Rigid,
    Selector,
    Spring,
    Statics,
    StVenantKirchhoff,
    Support,
    Symmetry,
    Traction,
    box_body,
    name_parts,
    read_case,
    rectangle_body,
    run,
)
from dolfin_elastic.core.errors import ConvergenceError, Diagnosis
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.units import LengthUnit, coordinates
from dolfin_elastic.mesh.distribute import build_body
from dolfin_elastic.mesh.formats.raw import RawMesh
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.model.point.domain import undefined_operation
from dolfin_elastic.problem.connectivity import ConnectedBodies
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.diagnostics import instability
from dolfin_elastic.solvers.diagnostics.evidence import TrialStates
from dolfin_elastic.solvers.diagnostics.rigid_body import find_loose_part
from dolfin_elastic.solvers.diagnostics.stability import FactorisedTangent, Mode, curvature
from dolfin_elastic.solvers.linear.choice import LinearSettings

FREE = "free"
E, NU = 1e6, 0.3
COMM = MPI.COMM_WORLD


def failure(problem: Problem, **settings: Any) -> ConvergenceError:
    with pytest.raises(ConvergenceError) as caught:
        _ = [*Statics(problem, **settings).steps()]
    error = caught.value
    assert error.exit_code == 3
    assert isinstance(error.diagnosis, Diagnosis)
    same_everywhere(error.diagnosis)
    assert error.diagnosis.text in str(error)
    assert f"\n  try: {error.diagnosis.advice}" in str(error)
    return error


def diagnosis(problem: Problem, **settings: Any) -> Diagnosis:
    found = failure(problem, **settings).diagnosis
    assert found is not None
    return found


def same_everywhere(found: Diagnosis) -> None:
    """Plain data, the same on every rank."""
    for other in COMM.allgather(found):
        # By text: not a number is not equal to itself.
        assert repr(other) == repr(found)
    assert 1 <= len(found.cells) <= 10


def held(law: Any, right: list[Any], **more: Any) -> Problem:
    """A square held on the left and moved on the right."""
    body = rectangle_body(size=(1.0, 1.0), cells=(4, 4))
    supports = [Support(on="left", displacement=[0, 0]), Support(on="right", displacement=right)]
    return Problem(body, law, supports=supports, **{"degree": 1, **more})


# --- inverted ---


def test_solutions_that_are_inside_out():
    """Hooke's square pushed through itself: refused from 2/3 of the load on, everywhere."""
    problem = held(LinearElastic(E=E, nu=0.0), [-1.5, 0])
    error = failure(problem, min_step=1 / 64)
    found, state = error.diagnosis, error.state
    assert found is not None
    assert found.cause == "inverted"
    assert isinstance(state, State)
    # Uniform strain without lateral contraction: det F = 1 - 1.5 t in all 32 cells at once, but
    # for round-off.
    J = 1 - 1.5 * state.load_factor
    assert -0.1 < J < 0
    assert "det F = -" in found.text
    assert "such elements in the body" in found.text
    assert "refused" in found.text
    # Neither steps nor a finer mesh change the solution of a linear problem.
    assert found.advice.startswith("a smaller load or displacement, or stiffer materials")
    assert len(found.cells) == 10
    np.testing.assert_allclose([cell.jacobian for cell in found.cells], J, rtol=1e-12)


def test_steps_that_turn_cells_inside_out():
    """Crushed to 3 % in one step without a retry: no step of Newton's method stays upright."""
    found = diagnosis(held(NeoHookean(E=E, nu=NU), [-0.97, 0]), min_step=1)
    assert found.cause == "inverted"
    assert "trial states of Newton's method refused" in found.text
    assert "(det F = -" in found.text
    assert len(found.place) == 2
    assert "more load steps" in found.advice


# --- nan ---


def rubber_with_a_limit() -> Energy:
    """Gent's law with the limit I1 - 3 < 1/2, in its compressible form."""
    return Energy(
        lambda I1, J: -E / 2 * ufl.ln(1 - (I1 - 3) / 0.5) - 2 * E * ufl.ln(J) + E * ufl.ln(J) ** 2
    )


def half_and_half() -> Body:
    return name_parts(
        rectangle_body(size=(2.0, 1.0), cells=(6, 3)),
        regions={
            "gel": Selector(box=((1, 0), (2, 1))),
            "core": Selector(box=((0, 0), (1, 1))),
        },
    )


@pytest.mark.long
def test_an_energy_is_left_behind():
    """Beyond the pole of its energy the stress of the gel is finite again, but not the energy."""
    problem = Problem(
        half_and_half(),
        {"gel": rubber_with_a_limit(), "core": NeoHookean(E=1e6 * E, nu=NU)},
        supports=[
            Support(on="left", displacement=[0, 0]),
            Support(on="right", displacement=[3.0, FREE]),
        ],
        degree=1,
    )
    found = diagnosis(problem, steps=4, min_step=1 / 16)
    assert found.cause == "nan"
    assert "material 'gel'" in found.text
    assert "ln of a negative number, -" in found.text
    assert "m" in found.text
    assert found.place[0] > 1.0  # in the gel
    assert "smaller load" in found.advice


def test_a_term_without_a_value_is_named():
    """The state itself has no value: 1 - (I1 - 3)/0.5 = -0.2 where F = diag(sqrt(1.6), 1, 1)."""
    law = rubber_with_a_limit()
    F = np.diag([np.sqrt(1.6), 1.0, 1.0])[None]
    assert undefined_operation(law, F) == "ln of a negative number, -0.2"
    assert undefined_operation(law, np.eye(3)[None]) == ""
    power = Energy(lambda I1, J: (2 - J) ** 1.5 * (I1 - 3))
    assert undefined_operation(power, 4 * F) == "broken power of a negative number, -79"
    root = Energy(lambda I1: ufl.sqrt(4 - I1))
    assert (
        undefined_operation(root, np.sqrt(2) * np.eye(3)[None])
        == "square root of a negative number, -2"
    )
    pole = Energy(lambda I1: 1 / (I1 - 3))
    assert undefined_operation(pole, np.eye(3)[None]) == "division by zero"


# --- rigid motions ---


def two_boxes(gap: float) -> Body:
    """Unit squares "a" and "b" side by side, b not joined to a; "left" is that of a."""

    def grid(x0: float, first: int) -> tuple[np.ndarray, np.ndarray]:
        n = 3
        x, y = np.meshgrid(np.linspace(x0, x0 + 1, n), np.linspace(0, 1, n), indexing="ij")
        at = lambda i, j: first + n * i + j  # noqa: E731
        squares = [(i, j) for i in range(n - 1) for j in range(n - 1)]
        cells = [[at(i, j), at(i + 1, j), at(i + 1, j + 1)] for i, j in squares]
        cells += [[at(i, j), at(i + 1, j + 1), at(i, j + 1)] for i, j in squares]
        return np.stack([x.ravel(), y.ravel()], axis=1), np.array(cells)

    def read() -> RawMesh:
        (xa, ca), (xb, cb) = grid(0.0, 0), grid(1.0 + gap, 9)
        regions = {"a": np.arange(8), "b": np.arange(8, 16)}
        surfaces = {
            "left": np.array([[0, 1], [1, 2]]),
            "end": np.array([[15, 16], [16, 17]]),
            "foot": np.array([[9, 12], [12, 15]]),
        }
        points = np.concatenate([xa, xb])
        return RawMesh(points, np.concatenate([ca, cb]), 1, regions, surfaces)

    return build_body(read, comm=COMM, unit=LengthUnit(), source="two boxes")


@pytest.fixture
def unchecked(monkeypatch):
    """Without the check that would refuse a free piece before anything is solved."""
    monkeypatch.setattr(
        "dolfin_elastic.solvers.statics.statics.check_no_rigid_motion", lambda problem: None
    )


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("law", [LinearElastic, NeoHookean])
def test_a_piece_that_nothing_holds(law):
    """The body as a whole is held, the piece that is pulled is not."""
    problem = Problem(
        two_boxes(0.25),
        law(E=E, nu=NU),
        supports=[Support(on="left", displacement=[0, 0])],
        loads=[Traction(on="end", value=[1e3, 0])],
        degree=1,
    )
    found = diagnosis(problem, min_step=1 / 2)
    assert found.cause == "rigid-motion"
    assert "region 'b'" in found.text
    assert "can move and turn freely" in found.text
    np.testing.assert_allclose(found.place, (1.75, 0.5), atol=0.2)
    assert "a support on that piece" in found.advice


@pytest.mark.long
def test_a_body_that_is_lifted_off():
    """It rests on a floor only, and its load turns up on the way: nothing holds it any more."""
    problem = Problem(
        rectangle_body(size=(1, 1), cells=(2, 2)),
        NeoHookean(E=E, nu=NU),
        supports=[Support(on="left", displacement=[0, "free"])],
        loads=[Traction(on="top", value=[0, 1e3], curve=[[0, 0], [0.5, -1], [1, 1]])],
        contacts=[Contact(on="bottom", plane={"axis": "y", "at": 0}, name="floor")],
        degree=1,
    )
    with pytest.raises(ConvergenceError) as caught:
        _ = [*Statics(problem).steps()]
    found = caught.value.diagnosis
    assert found.cause == "rigid-motion"
    assert found.text.startswith(
        "the load pulls it off its obstacles, and then nothing holds the body: as a rigid body it "
        "can move along y"
    )


def test_a_body_that_slides_off_its_support(caplog):
    """A block is pushed over the edge of a table: the first trial beyond it is told so."""
    caplog.set_level("INFO", logger="dolfin_elastic")
    problem = Problem(
        rectangle_body(size=(1, 0.4), cells=(3, 1)),
        NeoHookean(E=E, nu=NU),
        supports=[Support(on="left", displacement=[1.5, "free"])],
        loads=[Traction(on="top", value=[0, -1e3])],
        contacts=[Contact(on="bottom", box={"center": [0.2, -0.5], "size": [1, 1]}, name="table")],
        degree=1,
    )
    found = diagnosis(problem, steps=3, min_step=1 / 2, snap=False)
    assert found.cause == "rigid-motion"
    what = "contact no longer holds the body"
    assert found.text == f"{what}: as a rigid body it can move along y"
    trials = [line for line in caplog.messages if "trying a smaller step" in line]
    if MPI.COMM_WORLD.rank == 0:
        assert what in trials[0]


def pressed(left: Support | Rigid | Symmetry, by: float = 0.3) -> Problem:
    """A square whose lid a plate presses down; the lid's left end is held."""
    foot = Support(on="bottom", displacement=[0, 0])
    plate = Contact(on="top", plane={"axis": "-y", "at": 1}, motion=[0, -by], name="plate")
    body = rectangle_body(size=(1, 1), cells=(4, 4))
    law = NeoHookean(E=E, nu=NU)
    return Problem(body, law, supports=[foot, left], contacts=[plate], degree=1)


def test_an_obstacle_that_pushes_into_held_nodes():
    found = diagnosis(pressed(Support(on="left", displacement=[0, 0]), by=1.0), min_step=1 / 16)
    assert found.cause == "obstacle"
    assert re.fullmatch(
        r"the obstacle of contact\[0\] 'plate' pushes 0\.\d+ m deep into nodes that the support "
        r"'left' holds, at \(0, 1\) m",
        found.text,
    )
    assert found.place == (0, 1)
    assert "a support that moves with it" in found.advice


def test_an_audit_names_held_nodes_that_an_obstacle_is_pushed_into():
    """More load steps, which are the advice elsewhere, do not help."""
    *_, last = Statics(pressed(Support(on="left", displacement=[0, 0]))).steps()
    assert isinstance(last, State)
    assert last.audit is not None
    (reason,) = [text for text in last.audit.reasons if "'plate'" in text]
    assert "pushes 0.3 m deep into nodes that the support 'left' holds, at (0, 1) m" in reason
    assert "load steps" not in reason


@pytest.mark.parametrize(
    ("left", "holds"),
    [
        (Support(on="left", displacement=[0, "0.1*t"]), True),
        (Rigid(on="left", displacement=[0, 0], rotation=[0]), True),
        (Rigid(on="left", displacement=[0, FREE], rotation=[0]), False),
        (Support(on="left", displacement=[0, "-0.3*t"]), False),
        (Support(on="left", displacement=[0, FREE]), False),
        (Symmetry(on="left"), False),
    ],
)
def test_nodes_that_are_held_along_the_normal(left, holds):
    problem = pressed(left)
    problem.set_time(1.0)
    found = problem.contact_pairs[0].conflict(problem.constraints)
    assert (found is not None) == holds
    assert found is None or found[1] == (0, 1)


@pytest.mark.usefixtures("unchecked")
def test_a_piece_that_can_slide():
    """Its foot is held across: what is left is the motion along."""
    problem = Problem(
        two_boxes(0.25),
        LinearElastic(E=E, nu=NU),
        supports=[
            Support(on="left", displacement=[0, 0]),
            Support(on="foot", displacement=[FREE, 0]),
        ],
        loads=[Traction(on="end", value=[1e3, 0])],
        degree=1,
    )
    found = diagnosis(problem, min_step=1 / 2)
    assert found.cause == "rigid-motion"
    assert found.text.endswith("as a rigid body it can move along x")


@pytest.mark.parametrize("law", [LinearElastic(E=E, nu=NU), LinearElastic(E=1e-6, nu=NU)])
def test_pieces_that_are_held_are_not_loose(law):
    """However soft the one is against the other."""
    problem = Problem(
        two_boxes(0.25),
        {"a": LinearElastic(E=E, nu=NU), "b": law},
        supports=[
            Support(on="left", displacement=[0, 0]),
            Support(on="foot", displacement=[0, 0]),
        ],
        degree=1,
    )
    assembler = Assembler(problem)
    try:
        assert TrialStates(assembler).tangent(problem.w.x.array)
        assert find_loose_part(assembler) is None
        own = problem.V.dofmap.index_map.size_local
        found = set().union(*COMM.allgather(set(ConnectedBodies(problem).of_node[:own].tolist())))
        assert found == {0, 1}
    finally:
        assembler.destroy()


def test_a_spring_holds_a_piece():
    """Soft as it is: 1e-6 of the body's stiffness."""
    problem = Problem(
        two_boxes(0.25),
        LinearElastic(E=E, nu=NU),
        supports=[
            Support(on="left", displacement=[0, 0]),
            Spring(on="foot", stiffness=[1.0, 1.0]),
        ],
        degree=1,
    )
    assembler = Assembler(problem)
    try:
        assert TrialStates(assembler).tangent(problem.w.x.array)
        assert find_loose_part(assembler) is None
    finally:
        assembler.destroy()


def leaning(surfaces: list[str], pushed: str = "") -> Problem:
    """A square turned by 30 degrees on rollers, of which a plate pushes 0.1 m into one side."""
    body = rectangle_body(size=(1.0, 1.0), cells=(3, 3))
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    x = body.mesh.geometry.x
    x[:, :2] = x[:, :2] @ np.array([[c, s], [-s, c]])
    n = {"left": [c, s], "bottom": [-s, c]}.get(pushed, [])
    plane = {"point": [0, 0], "normal": n}
    plate = [Contact(on=pushed, plane=plane, motion=[0.1 * one for one in n])] if n else []
    law, rollers = LinearElastic(E=E, nu=NU), [Symmetry(on=surfaces)]
    return Problem(body, law, supports=rollers, contacts=plate, degree=1)


@pytest.mark.parametrize(("pushed", "holds"), [("left", True), ("bottom", False)])
def test_leaning_rollers_hold_along_their_normal_alone(pushed, holds):
    """Of a plate that goes along them, none of its nodes is held, the corner's either."""
    problem = leaning(["left"], pushed)
    problem.set_time(1.0)
    assert (problem.contact_pairs[0].conflict(problem.constraints) is not None) == holds


@pytest.mark.parametrize(("surfaces", "motions"), [(["left"], 1), (["left", "bottom"], 0)])
def test_supports_that_lean(surfaces, motions):
    """A square turned by 30 degrees on rollers along its own sides is held as an upright one is."""
    problem = leaning(surfaces)
    assembler = Assembler(problem)
    assert TrialStates(assembler).tangent(problem.w.x.array)
    found = find_loose_part(assembler)
    stability = FactorisedTangent(assembler)
    try:
        assert (found is None) == (motions == 0)
        if found is not None:  # along the side, askew to the axes
            assert found.whole
            assert len(found.motions) == 1
        else:
            mode = stability.weakest()
            assert stability.negative == 0
            assert mode is not None
            assert mode.stiffness > 0
            full = assembler.create_vector()
            full.array_w[assembler.displacement_dofs] = mode.motion
            assembler.remove_constrained(full)
            # Nothing of the mode is along what is held; by a solve's round-off.
            assert full.norm() == pytest.approx(1.0, rel=1e-9)
            full.destroy()
    finally:
        stability.destroy()
        assembler.destroy()


# --- stability ---


def column(share: float, cells: tuple[int, int] = (1, 20)) -> Problem:
    """A column of L/h = 10, clamped below, under `share` of Euler's load at its free top.

    P = pi^2 E I/(4 L^2), in plane strain with E/(1 - nu^2).
    """
    L, h = 10.0, 1.0
    euler = np.pi**2 * E / (1 - NU**2) * h**3 / 12 / (4 * L**2)
    return Problem(
        rectangle_body(size=(h, L), cells=cells),
        NeoHookean(E=E, nu=NU),
        degree=2,
        supports=[Support(on="bottom", displacement=[0, 0])],
        loads=[Traction(on="top", value=[0, -share * euler / h])],
    )


def test_a_column_buckles():
    """Straight up to Euler's load, where few iterations do not find the way out sideways."""
    found = diagnosis(column(1.5), steps=6, max_iterations=3, min_step=1 / 4, snap=False)
    assert found.cause == "unstable"
    assert "buckles, sideways to the load" in found.text
    assert found.place[1] == pytest.approx(10.0)  # the top moves most
    assert "imperfection" in found.advice
    assert 'statics.method = "arc-length"' in found.advice


def arch() -> Problem:
    """A shallow arch, clamped at both ends, under its weight: it snaps through downwards."""
    body = rectangle_body(size=(10.0, 0.25), cells=(20, 1))
    x = body.mesh.geometry.x
    x[:, 1] += 0.5 * np.sin(np.pi * x[:, 0] / 10.0)
    return Problem(
        body,
        StVenantKirchhoff(E=E, nu=NU),
        degree=2,
        supports=[Support(on=["left", "right"], displacement=[0, 0])],
        loads=[BodyForce(value=[0, -300.0])],
    )


def test_an_arch_snaps_through():
    """A limit point: the mode goes where the load goes, down, most in the middle."""
    found = diagnosis(arch(), steps=10, max_iterations=5, min_step=0.1, snap=False)
    assert found.cause == "unstable"
    assert "a limit point of the load" in found.text
    assert found.place[0] == pytest.approx(5.0, abs=0.5)
    assert "along (" in found.text
    assert 'statics.method = "arc-length"' in found.advice


@pytest.mark.parametrize(("share", "negative"), [(0.9, 0), (1.1, 1), (7.0, 1), (9.6, 2)])
def test_eigenvalues_are_counted(share, negative):
    """The straight column has lost as many modes as loads (2k - 1)^2 Euler it has passed.

    Its strain is uniform, and it is free to widen.  Shear, shortening and the elements' stiffness
    move the loads: the first by a per cent, the second, 9 Euler, by ten.
    """
    problem = column(share)
    assembler = Assembler(problem)
    x, y, _ = problem.V.tabulate_dof_coordinates().T
    strain = share * np.pi**2 / 12 / 400
    problem.u.x.array[1::2] = -strain * y
    problem.u.x.array[::2] = NU / (1 - NU) * strain * (x - 0.5)
    assert TrialStates(assembler).tangent(problem.w.x.array)
    stability = FactorisedTangent(assembler)
    try:
        assert stability.sound
        assert stability.negative == negative
        mode = stability.weakest()
        assert mode is not None
        assert (mode.stiffness < 0) == (negative > 0)
        full = np.zeros(assembler.size)
        full[assembler.displacement_dofs] = mode.motion
        # An eigenvector's Rayleigh quotient is off by the square of its own error, 1e-3.
        assert curvature(assembler, full) == pytest.approx(mode.stiffness, rel=1e-4)
    finally:
        stability.destroy()
        assembler.destroy()


@pytest.mark.parametrize("degree", [1, 2])
def test_pressures_do_not_count_as_instabilities(degree):
    """A saddle point at rest has as many negative eigenvalues as pressures, and is stable."""
    body = rectangle_body(size=(1.0, 1.0), cells=(3, 3))
    problem = Problem(
        body,
        NeoHookean(E=E, nu=0.4999),
        degree=degree,
        formulation="mixed",
        supports=[Support(on="left", displacement=[0, 0])],
    )
    assembler = Assembler(problem)
    assert TrialStates(assembler).tangent(problem.w.x.array)
    stability = FactorisedTangent(assembler)
    try:
        assert stability.negative == 0
        mode = stability.weakest()
        assert mode is not None
        assert mode.stiffness > 0
    finally:
        stability.destroy()
        assembler.destroy()


def crushed(law: Any = None, load: float = 2.0) -> Problem:
    """St. Venant-Kirchhoff softens in compression: limit load 0.19 E, see test_newton.py."""
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    limit = E / (1 - NU**2) / (3 * np.sqrt(3))
    return Problem(
        body,
        law or StVenantKirchhoff(E=E, nu=NU),
        supports=[
            Support(on="left", displacement=[0, FREE]),
            Support(on="bottom", displacement=[FREE, 0]),
        ],
        loads=[Traction(on="right", value=[-load * limit, 0])],
        degree=1,
    )


def test_a_material_that_gives_way():
    """The tangent is lost at the limit load; so is the law's ellipticity, and that is told."""
    error = failure(crushed(load=2.1), steps=4, max_iterations=12, min_step=1 / 16)
    found = error.diagnosis
    assert found is not None
    assert found.cause == "unstable"
    assert "stiffness against one motion has fallen" in found.text or "negative" in found.text
    assert "load" in found.advice


@pytest.fixture(scope="module")
def shell() -> Body:
    """A slice of a hollow sphere of radii 1 and 2 m, 23 degrees of its meridian."""
    body = rectangle_body(size=(1.0, 0.4), cells=(6, 3))
    x = body.mesh.geometry.x
    r, angle = 1.0 + x[:, 0], x[:, 1].copy()
    x[:, 0], x[:, 1] = r * np.cos(angle), r * np.sin(angle)
    return body


def inflated(body: Body, law: Law) -> Problem:
    """It under an inner pressure of a fifth of E, on rollers that let it swell as a sphere."""
    return Problem(
        body,
        law,
        geometry="axisymmetric",
        supports=[Normal(kind="roller", on="bottom"), Normal(kind="roller", on="top")],
        loads=[Pressure(on="left", value=2e5)],
        degree=2,
    )


@pytest.mark.long
def test_st_venant_kirchhoff_beyond_its_limit_load(shell: Body) -> None:
    """A hollow sphere: its wall is squeezed below 1/sqrt(3), and the law gives way, not the mesh.

    It was told that a cell turns inside out, and to take a finer mesh.
    """
    error = failure(inflated(shell, StVenantKirchhoff(E=1e6, nu=0.3)), max_iterations=15)
    found = error.diagnosis
    assert found is not None
    assert found.cause == "unstable"
    assert found.text.startswith("material instability: near (")
    squeezed = re.search(r"is squeezed to (0\.\d+) of its length along \(([^)]*)\)", found.text)
    assert squeezed is not None
    assert float(squeezed[1]) < 1 / np.sqrt(3) + 0.02
    along = np.array([float(x) for x in squeezed[2].split(",")])
    place = np.array(found.place)
    assert np.linalg.norm(place) < 1.2  # at the inner side, and along the radius
    assert along @ place == pytest.approx(np.linalg.norm(along) * np.linalg.norm(place), rel=1e-2)
    assert "the law 'st-venant-kirchhoff' is" in found.text
    assert "its stress falls again below a stretch of 0.577" in found.text  # 1/sqrt(3)
    assert found.advice.startswith("law = 'neo-hookean' or 'hencky' with the same constants")
    assert "a finer mesh does not help" in found.advice
    assert re.search(r"at the end: \w.*, Newton iterations", str(error))


@pytest.mark.long
@pytest.mark.parametrize("law", ["hencky", "neo-hookean"])
def test_the_laws_that_go_on_do(shell: Body, law: str) -> None:
    """What the advice names reaches the whole load."""
    *_, state = Statics(inflated(shell, MATERIALS[law](E=1e6, nu=0.3))).steps()
    assert state.load_factor == 1.0
    assert state.audit is not None
    assert state.audit.verdict == "pass"


def test_a_large_body_is_judged_by_the_way_it_went(monkeypatch):
    """Without factors: the curvature along the way is told, and what was not looked at."""
    monkeypatch.setattr(instability, "LIMIT", {2: 0, 3: 0})
    found = diagnosis(crushed(load=2.1), steps=4, max_iterations=12, min_step=1 / 16)
    assert found.cause == "unstable"
    assert "negative stiffness along the way" in found.text
    assert "were not looked at" in found.text


@pytest.mark.parametrize(
    ("negative", "stiffness", "unstable"),
    [(2, 1.0, True), (0, -1.0, False), (None, -1.0, True), (None, 1.0, False), (None, None, False)],
)
def test_what_a_spectrum_says(negative, stiffness, unstable):
    """The count of negative eigenvalues, where there is one; else the weakest mode."""
    mode = None if stiffness is None else Mode(stiffness, np.zeros(2))
    assert instability.Spectrum(negative, mode).unstable is unstable


# --- solvers ---


def test_a_linear_solver_that_gives_up():
    body = rectangle_body(size=(1.0, 1.0), cells=(4, 4))
    problem = Problem(
        body,
        NeoHookean(E=E, nu=NU),
        supports=[Support(on="left", displacement=[0, 0])],
        loads=[Traction(on="right", value=[E / 100, 0])],
        degree=1,
    )
    found = diagnosis(
        problem,
        min_step=1,
        linear=LinearSettings(method="iterative"),
        petsc={"ksp_max_it": 2, "ksp_type": "cg", "pc_type": "none"},
    )
    assert found.cause == "linear-solver"
    assert "ksp_max_it" in found.text
    assert "DIVERGED_MAX_IT" not in found.text  # a name of PETSc, for -v
    assert 'solver.method = "direct"' in found.advice


def test_round_off():
    """Carried a million cells away, a body's strains keep six digits fewer."""
    body = rectangle_body(size=(1.0, 1.0), cells=(4, 4))
    problem = Problem(
        body,
        NeoHookean(E=E, nu=NU),
        supports=[Support(on="left", displacement=[1e6, 0])],
        loads=[Traction(on="right", value=[0.1, 0])],
        degree=1,
    )
    error = failure(problem, min_step=1)
    found = error.diagnosis
    assert found is not None
    assert found.cause == "round-off"
    assert "rtol is too tight" in found.text
    assert "rtol = " in found.advice


def test_too_few_iterations():
    body = rectangle_body(size=(4.0, 1.0), cells=(8, 2))
    problem = Problem(
        body,
        NeoHookean(E=E, nu=NU),
        supports=[Support(on="left", displacement=[0, 0])],
        loads=[Traction(on="right", value=[E / 10, 0])],
        degree=1,
    )
    found = diagnosis(problem, steps=1, min_step=1, max_iterations=3, rtol=1e-12, snap=False)
    assert found.cause == "iterations"
    assert "3 Newton iterations were not enough" in found.text
    assert "max_iterations" in found.advice


@pytest.mark.long
def test_motion():
    """A support that goes through the body within two steps: cells invert, whatever the step.

    What is said of a support that jumps, see test_dynamics.
    """
    problem = held(NeoHookean(E=E, nu=NU, density=1e3), ["-2 * min(t / 0.02, 1)", 0])
    with pytest.raises(ConvergenceError) as caught:
        _ = [*Dynamics(problem, end=0.1, dt=0.01).steps()]
    found = caught.value.diagnosis
    assert found is not None
    same_everywhere(found)
    assert found.cause in ("inverted", "stalled")
    assert found.text in str(caught.value)
    assert "a smaller dt" in found.advice


def test_a_law_that_gives_way_in_motion():
    """Crushed beyond the limit of its law: no step, however small; a smaller dt was advised."""
    problem = Problem(
        rectangle_body(size=(1.0, 1.0), cells=(2, 2)),
        StVenantKirchhoff(E=E, nu=NU, density=1e3),
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[-E, 0])],
        degree=1,
    )
    with pytest.raises(ConvergenceError) as caught:
        _ = [*Dynamics(problem, end=0.1, dt=1e-3).steps()]
    found = caught.value.diagnosis
    assert found is not None
    same_everywhere(found)
    assert found.text.startswith("material instability: near ")
    assert "'st-venant-kirchhoff' is not elliptic any more" in found.text
    assert "law = 'neo-hookean'" in found.advice


@pytest.mark.long
@pytest.mark.parametrize("back", [True, False])
def test_constants_that_make_a_material_unstable_are_named(back):
    """A fit with c10 < 0, drawn both ways or one: its constants, not buckling or a unit.

    A pressure carries the change of volume: it does not hide the material.
    """
    pulls = {"right": [8e-3, "free", "free"]} | ({"back": ["free", 8e-3, "free"]} if back else {})
    rollers = {"left": [0, "free", "free"], "front": ["free", 0, "free"]}
    problem = Problem(
        box_body(size=(10e-3, 10e-3, 2e-3), cells=(4, 4, 1)),
        MooneyRivlin(c10=-0.25e6, c01=0.9e6, nu=0.49),
        supports=[
            Support(on=name, displacement=values)
            for name, values in (rollers | {"bottom": ["free", "free", 0]} | pulls).items()
        ],
    )
    with pytest.raises(ConvergenceError) as caught:
        _ = [*Statics(problem).steps()]
    found = caught.value.diagnosis
    assert found is not None
    same_everywhere(found)
    assert found.text.startswith("material instability: near ")
    assert "'mooney-rivlin' is hardly elliptic any more (c10 = -2.5e+05 Pa)" in found.text
    assert "other constants than c10" in found.advice
    assert "unit" not in found.advice


# --- what becomes of it ---

CASE = """
[mesh]
rectangle = {size = [1, 1], cells = [2, 2]}
degree = 1
[materials.rubber]
law = "linear-elastic"
E = "1 MPa"
nu = 0.3
[[support]]
on = "left"
displacement = [0, 0]
[[support]]
on = "right"
displacement = [-1.5, 0]
[statics]
min_step = 0.25
"""


def test_summary_and_failed_state(folder: Path):
    """`summary.json` has the diagnosis, `failed_state.xdmf` what is needed to see it."""
    path = folder / "case.toml"
    on_root(COMM, lambda: path.write_text(CASE) and None)
    with pytest.raises(ConvergenceError) as caught:
        _ = [*run(read_case(path), output=folder / "out")]
    found = caught.value.diagnosis
    assert found is not None
    told = on_root(COMM, lambda: json.loads((folder / "out/summary.json").read_text()))
    assert told["status"] == "failed"
    assert told["diagnosis"]["cause"] == found.cause == "inverted"
    assert told["diagnosis"]["text"] == found.text
    assert told["diagnosis"]["advice"] == found.advice
    assert told["diagnosis"]["place"] == pytest.approx(list(found.place))
    first = told["diagnosis"]["cells"][0]
    assert set(first) == {"place", "material", "regions", "jacobian", "residual"}
    assert first["material"] == "rubber"
    text = on_root(COMM, (folder / "out/failed_state.xdmf").read_text)
    for name in ("displacement", "residual", "jacobian", "energy_density", "von_mises"):
        assert f'Name="{name}"' in text
    assert any("failed_state.xdmf" in note for note in caught.value.__notes__)


def test_the_field_of_forces_out_of_balance():
    """Before the first step it is minus the load at free nodes and zero where the body is held."""
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    problem = Problem(
        body,
        LinearElastic(E=E, nu=NU),
        supports=[Support(on="left", displacement=[0, 0])],
        loads=[Traction(on=["left", "right"], value=[1e3, 0])],
        degree=1,
    )
    evaluate = Evaluator(problem, ["residual", "reaction"])
    states = Statics(problem).steps()
    first = next(states)
    problem.set_time(1.0)  # the whole load
    fields = evaluate(first)
    sums = (
        COMM.allreduce(fields["residual"].sum(axis=0)),
        COMM.allreduce(fields["reaction"].sum(axis=0)),
    )
    np.testing.assert_allclose(sums[0], [-1e3, 0, 0], atol=1e-9)  # that of the right side
    np.testing.assert_allclose(sums[1], [-2e3, 0, 0], atol=1e-9)
    states.close()


def test_no_zero_of_a_place_has_a_sign():
    assert coordinates((-0.0, 0.0, -0.5)) == "(0, 0, -0.5)"


def test_an_error_travels_with_its_diagnosis():
    found = Diagnosis("stalled", "why", "what", (1.0, 2.0))
    error = pickle.loads(pickle.dumps(ConvergenceError("x", advice="y", diagnosis=found)))
    assert (error.what, error.advice, error.diagnosis) == ("x", "y", found)
