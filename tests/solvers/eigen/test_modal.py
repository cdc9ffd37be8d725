"""Natural frequencies against exact and converged ones, rigid modes, and masses that add up."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import (
    Body,
    Contact,
    LinearElastic,
    Modal,
    NeoHookean,
    NeoHookeanSplit,
    Periodic,
    Pressure,
    Problem,
    Spring,
    Statics,
    StVenantKirchhoff,
    Support,
    Symmetry,
    Textbook,
    Thermal,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.errors import ConvergenceError, InputError
from dolfin_elastic.problem.state import Mode
from dolfin_elastic.solvers.eigen import lobpcg
from dolfin_elastic.solvers.eigen.modal import Vibration
from dolfin_elastic.solvers.linear import choice
from dolfin_elastic.solvers.linear.choice import LinearSettings

SOFT = {"E": 1e7, "nu": 0.3, "density": 1000}
STEEL = {"E": 200e9, "nu": 0.3, "density": 8000}
LEFT = [Support(on="left")]


def modes(problem: Problem, **settings: Any) -> list[Mode]:
    return list(Modal(problem, **settings).modes())


def elastic(found: list[Mode]) -> np.ndarray:
    return np.array([mode.frequency for mode in found if mode.kind == "elastic"])


def errors(found: list[Mode], exact: list[float]) -> np.ndarray:
    return elastic(found)[: len(exact)] / np.array(exact) - 1


def bent(body: Body, place: Any) -> Body:
    """A body whose points are moved."""
    x = body.mesh.geometry.x
    x[:, : body.dim] = place(*x[:, : body.dim].T)
    return body


def strip(comm: MPI.Comm, cells: tuple[int, int] = (20, 2)) -> Body:
    return rectangle_body(size=[10, 1], cells=cells, comm=comm)


def test_rigid_modes_are_orthonormal(comm: MPI.Comm) -> None:
    """In the mass, also about a centre and axes of inertia that are no edges of the body."""
    body = bent(
        box_body(size=[1, 2, 3], cells=[1, 2, 2], comm=comm),
        lambda x, y, z: np.stack([x + y, y + z / 2, z], axis=1),
    )
    vibration = Vibration(Modal(Problem(body, LinearElastic(**STEEL), degree=1), count=1))
    try:
        V = np.stack([mode.vector for mode in vibration.rigid], axis=1)
        gram = comm.allreduce(V.T @ vibration.mass.times(V))
    finally:
        vibration.destroy()
    np.testing.assert_allclose(gram, np.eye(6), rtol=0, atol=1e-9)


# --- against exact and converged frequencies ---


def test_cantilever(comm: MPI.Comm) -> None:
    """C-1: converged frequencies to 1e-5 are known; this mesh is 0.08 to 0.12 % too stiff."""
    problem = Problem(strip(comm, (40, 4)), LinearElastic(**SOFT), supports=LEFT, degree=2)
    found = modes(problem, count=6)
    off = errors(found, [0.1682806, 1.006599, 2.626554, 2.642169, 4.783753, 7.27138])
    # Rayleigh and Ritz: from above.
    assert np.all((off > 0) & (off < 1.5e-3)), off
    assert [mode.number for mode in found] == [1, 2, 3, 4, 5, 6]
    # First bending mode of a beam: 61.31 % (Clough and Penzien); shear takes some of it.
    assert found[0].effective["y"] / found[0].whole["y"] == pytest.approx(0.6131, rel=2e-3)
    assert found[0].whole["x"] == pytest.approx(1e4, rel=1e-12)
    assert found[0].whole["rz"] == pytest.approx(1e4 * 101 / 12, rel=1e-12)
    # Its generalised mass is a quarter of the beam's, wherever that comes from.
    assert found[0].mass == pytest.approx(2500, rel=1e-2)


@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_square_without_pressure(nu: float, comm: MPI.Comm) -> None:
    """Lame's mode of a free square has frequency c_s/sqrt(2) whatever nu; pressure has no mass.

    R. Mindlin, J. Appl. Mech. 23 (1956): divergence-free and without traction on its sides.
    """
    body = rectangle_body(size=[1, 1], cells=[8, 8], comm=comm)
    law = NeoHookeanSplit(mu=1, nu=nu, density=1)
    found = modes(Problem(body, law, degree=2, formulation="mixed"), count=6)
    assert [mode.kind for mode in found[:4]] == ["rigid", "rigid", "rigid", "elastic"]
    near = elastic(found) * np.sqrt(2) - 1
    # Fourth order in h; one of them, and nothing else so near.
    assert np.min(np.abs(near)) < 3e-4, near
    assert np.sum(np.abs(near) < 1e-2) == 1


@pytest.mark.parametrize(
    ("held", "there"),
    [
        (["bottom"], 2 * 20 - 9),
        # Only differences of pressures matter: one of them takes nothing away.
        (["bottom", "top", "left", "right"], 2 * 9 - 8),
    ],
)
def test_all_modes_without_change_of_volume(
    held: list[str], there: int, comm: MPI.Comm, caplog: pytest.LogCaptureFixture
) -> None:
    """Each pressure takes away a motion; none of the infinite eigenvalues comes back as a mode."""
    body = rectangle_body(size=[1, 1], cells=(2, 2), comm=comm)

    def problem(nu: float) -> Problem:
        law = NeoHookeanSplit(E=1e6, nu=nu, density=1000)
        supports = [Support(on=name) for name in held]
        return Problem(body, law, supports=supports, degree=2, formulation="mixed")

    for count in (there - 3, there, there + 9):
        found = modes(problem(0.5), count=count)
        assert len(found) == min(count, there)
    if comm.rank == 0:
        assert f"{there + 9} modes asked for, there are only {there}" in caplog.text
    # The rest are those of a body that is nearly so, up to a multiple of 1 - 2 nu.
    near = [mode.frequency for mode in modes(problem(0.5 - 1e-7), count=there)]
    assert [mode.frequency for mode in found] == pytest.approx(near, rel=1e-4)


def test_nothing_is_free(comm: MPI.Comm) -> None:
    body = rectangle_body(size=[1, 1], cells=(1, 1), comm=comm)
    with pytest.raises(InputError, match="supports hold every node"):
        modes(Problem(body, NeoHookean(**SOFT), supports=[Support(on=["left", "right"])], degree=1))


def test_unstable(comm: MPI.Comm, caplog: pytest.LogCaptureFixture) -> None:
    """A straight column under twice its load does not vibrate but falls, and that is said.

    omega^2/omega_0^2 = -1.2100 of a beam, by Ritz with polynomials; what is short of a straight
    line through 1 and 0, -1, is the mode's change of shape.
    """
    problem = Problem(strip(comm), StVenantKirchhoff(**SOFT), supports=LEFT, degree=2)
    rest = modes(problem, count=1)[0].eigenvalue
    strain = np.pi**2 / 12 / 400  # of Euler's load
    # Free to become thicker: by nu/(1 - nu) of it in plane strain.
    problem.u.interpolate(lambda x: 2 * strain * np.stack([-x[0], 3 / 7 * (x[1] - 0.5)]))
    mode, other = Modal(problem, count=2, preload=True).about_this_state()
    assert (mode.kind, mode.frequency, other.kind) == ("unstable", 0.0, "elastic")
    assert mode.eigenvalue / rest == pytest.approx(-1.21, rel=1.5e-2)  # strained by 0.4 %
    if comm.rank == 0:
        assert "the state is unstable" in caplog.text


# --- supports ---


def test_springs(comm: MPI.Comm) -> None:
    """A hard block on soft springs: closed form, and all masses add up."""
    body = rectangle_body(size=[2, 1], cells=[2, 1], comm=comm)
    springs = [Spring(on=["left", "right"], stiffness=[3e3, 1e3], kind="spring")]
    problem = Problem(body, LinearElastic(E=1e10, nu=0.3, density=500), supports=springs, degree=1)
    found = modes(problem, count=12)  # every mode there is
    m, inertia = 1000.0, 1000.0 * 5 / 12
    turning = 2 * 3e3 / 12 + 2 * 1e3 * 1.0  # springs along x at y, and across at x = +-1
    exact = np.sqrt([2e3 / m, turning / inertia, 6e3 / m]) / (2 * np.pi)
    # Soft by 1e-7 of the block: so much it gives.
    assert elastic(found)[:3] == pytest.approx(exact, rel=1e-6)
    assert {mode.kind for mode in found} == {"elastic"}  # rigid motions, but not free ones
    assert len(found) == problem.num_dofs
    for name, whole in found[0].whole.items():
        assert sum(mode.effective[name] for mode in found) == pytest.approx(whole, rel=1e-9)


def test_fewer_cells_than_ranks(comm: MPI.Comm) -> None:
    """All modes of two triangles; more than there are is said."""
    body = rectangle_body(size=[1, 1], cells=[1, 1], comm=comm)
    found = modes(Problem(body, LinearElastic(**SOFT), degree=1), count=9)
    assert [mode.kind for mode in found] == 3 * ["rigid"] + 5 * ["elastic"]
    several = elastic(found)
    assert several[0] == pytest.approx(several[1], rel=1e-9)  # a double one
    assert np.all(np.diff(several[1:]) > 1)
    assert sum(mode.effective["x"] for mode in found) == pytest.approx(1000, rel=1e-9)


def test_rollers(comm: MPI.Comm) -> None:
    """One free motion along a roller, straight and tilted: the same frequencies."""
    c, s = np.cos(0.4), np.sin(0.4)
    straight, tilted = (
        modes(Problem(body, NeoHookean(**SOFT), supports=[Symmetry(on="left")], degree=2), count=3)
        for body in (
            strip(comm),
            bent(strip(comm), lambda x, y: np.stack([c * x - s * y, s * x + c * y], axis=1)),
        )
    )
    assert [mode.kind for mode in tilted] == ["rigid"] + 3 * ["elastic"]
    assert straight[0].name == "move along y"
    assert tilted[0].name == "move along (0.3894, -0.9211)"
    assert elastic(tilted) == pytest.approx(elastic(straight), rel=1e-8)


def test_body_of_revolution(comm: MPI.Comm) -> None:
    """It is free along its axis only; torsion is no motion of its section."""
    body = rectangle_body(size=[1, 1], cells=[4, 4], comm=comm)
    problem = Problem(body, NeoHookean(**SOFT), degree=2, geometry="axisymmetric")
    found = modes(problem, count=1)
    assert [mode.name for mode in found] == ["move along y", ""]
    assert found[0].whole == {"y": pytest.approx(1000 * np.pi, rel=1e-9)}


def test_iterations(comm: MPI.Comm) -> None:
    """CG with multigrid, which options of the user ask for, finds what factors find."""
    body = box_body(size=[2, 2, 1], cells=[2, 2, 1], comm=comm)
    for degree, supports in ((1, []), (2, LEFT)):
        problem = Problem(body, LinearElastic(**SOFT), supports=supports, degree=degree)
        direct = modes(problem, count=2)
        iterative = LinearSettings(method="iterative", petsc={"eps_type": "krylovschur"})
        slow = modes(problem, count=2, linear=iterative)
        assert elastic(slow) == pytest.approx(elastic(direct), rel=1e-7)
        assert [mode.kind for mode in slow] == [mode.kind for mode in direct]


def test_loads_at_rest(comm: MPI.Comm) -> None:
    """Without preload they do nothing, not even one that follows the body from the start."""
    body, law = strip(comm, (4, 1)), NeoHookean(**SOFT)
    constant = Pressure(on="right", value=1e5, curve="constant")
    pressed = Problem(body, law, supports=LEFT, loads=[constant], degree=1)
    bare = Problem(body, law, supports=LEFT, degree=1)
    first, second = (elastic(modes(problem, count=2)) for problem in (pressed, bare))
    assert first == pytest.approx(second, rel=1e-9)


# --- what is wrong ---


REFUSED: Mapping[str, tuple[dict[str, Any], dict[str, Any], str]] = {
    "no density": ({"law": LinearElastic(E=1, nu=0)}, {}, "weight and motion need a density"),
    "no energy": (
        {"law": Textbook(**SOFT)},
        {},
        "materials.body.law: 'textbook' has no strain energy",
    ),
    "follower": (
        {"law": NeoHookean(**SOFT), "loads": [Pressure(on="right", value=1)]},
        {"preload": True},
        r"load\[0\]: the pressure follows a surface whose edge is free",
    ),
    "warm": (
        {
            "law": NeoHookean(**SOFT, expansion=1e-5),
            "loads": [Thermal(value=10, curve="constant")],
        },
        {},
        r"load\[0\]: thermal acts at rest, too: .* modal.preload = true",
    ),
    "free": (
        {"law": NeoHookean(**SOFT), "supports": [], "loads": [Traction(on="right", value=[1, 0])]},
        {"preload": True},
        "there is no support: as a rigid body it can move and turn freely",
    ),
    "contact": (
        {
            "law": NeoHookean(**SOFT),
            "contacts": [Contact(on="top", plane={"axis": "-y", "at": 2})],
        },
        {},
        "contact: contact opens and closes, so the body has no modes",
    ),
    "cell": (
        {
            "law": NeoHookean(**SOFT),
            "supports": [],
            "periodic": Periodic(
                pairs=[["left", "right"], ["bottom", "top"]], gradient=[[1, 0], [0, 1]]
            ),
        },
        {},
        "periodic: a periodic cell has no modes of its own",
    ),
    "below": (
        {"law": NeoHookean(**SOFT)},
        {"below": 1, "linear": LinearSettings(method="iterative")},
        "modal.below: modes below a frequency are counted by a factorisation",
    ),
}


@pytest.mark.parametrize("key", REFUSED)
def test_refused(key: str, comm: MPI.Comm) -> None:
    """One message that says where, what and what else."""
    made, settings, text = REFUSED[key]
    keys = {"supports": LEFT, **{k: v for k, v in made.items() if k != "law"}}
    with pytest.raises(InputError, match=text):
        modes(Problem(strip(comm, (4, 1)), made["law"], degree=1, **keys), **settings)


def test_options_of_the_user(comm: MPI.Comm, caplog: pytest.LogCaptureFixture) -> None:
    """SLEPc takes them; what nothing takes is said."""
    problem = Problem(strip(comm, (4, 1)), LinearElastic(**SOFT), supports=LEFT, degree=1)
    first = elastic(modes(problem, count=2))
    found = modes(problem, count=2, petsc={"eps_type": "arnoldi", "nonsense": 1})
    assert elastic(found) == pytest.approx(first, rel=1e-8)
    if comm.rank == 0:
        assert "'-nonsense' was not used" in caplog.text
        assert "eps_type" not in caplog.text


def test_not_found(comm: MPI.Comm, monkeypatch: pytest.MonkeyPatch) -> None:
    """Too few iterations, and a solver that fails: one message each, with what to try.

    Also after an error within another solve, after which PETSc itself passes over such failures.
    """
    problem = Problem(strip(comm), LinearElastic(**SOFT), supports=LEFT, degree=1)
    found = r"of 10 modes only \d were found: .*eps_max_it"
    with pytest.raises(ConvergenceError, match=found) as caught:
        modes(problem, petsc={"eps_max_it": 1, "eps_ncv": 12})
    assert "fewer modes" in caught.value.advice
    # Under a load: what small strains need no step for is not factorised.
    pull = [Traction(on="right", value=[1.0, 0.0])]
    steel = Problem(strip(comm), LinearElastic(**SOFT), supports=LEFT, loads=pull, degree=1)
    with pytest.raises(InputError, match="mat_mumps_icntl_14"):
        list(Statics(steel, petsc={"mat_mumps_icntl_14": "x"}).steps())
    # CG that may do one iteration and is to be exact, with options of the user and without.
    inner = {"st_ksp_max_it": 1, "st_ksp_rtol": 1e-30}
    with pytest.raises(ConvergenceError, match="the eigenvalue solver has failed"):
        modes(problem, linear=LinearSettings(method="iterative"), petsc=inner)
    monkeypatch.setattr(lobpcg, "STEPS", 0)
    for name, value in inner.items():
        monkeypatch.setitem(choice.BLOCKS, name.removeprefix("st_"), value)
    with pytest.raises(ConvergenceError, match="the eigenvalue solver has failed"):
        modes(problem, linear=LinearSettings(method="iterative"))
