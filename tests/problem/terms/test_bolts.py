"""Preloaded bolts: the force in the shank is the preload, and loads are shared by stiffness."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx.mesh import locate_entities
from mpi4py import MPI

from dolfin_elastic import (
    Body,
    LinearElastic,
    NeoHookean,
    Problem,
    Rigid,
    Selector,
    Statics,
    Support,
    box_body,
    name_parts,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.mesh.distribute import make_mesh
from dolfin_elastic.model.loads import LOADS
from dolfin_elastic.problem.state import StateCopy
from dolfin_elastic.results.derived.sections import Section, SectionForces
from dolfin_elastic.solvers.statics.load_stepping import InitialGuess

STEEL, SLEEVE = 210e9, 70e9
PRELOAD, LOAD = 1e4, 3e3
FREE = "free"


def clamped(**bolt: Any) -> Problem:
    """A shank beside a sleeve, between a plate that is held and one that moves along the axis.

    Without Poisson's ratio both are bars: stiffnesses 210e6 and 140e6 N/m.
    """
    body = name_parts(
        box_body(size=(0.03, 0.01, 0.1), cells=(3, 1, 2)),
        regions={
            "shank": Selector(box=([0, 0, 0], [0.01, 0.01, 0.1])),
            "sleeve": Selector(box=([0.01, 0, 0], [0.03, 0.01, 0.1])),
        },
    )
    return Problem(
        body,
        {"shank": LinearElastic(E=STEEL, nu=0.0), "sleeve": LinearElastic(E=SLEEVE, nu=0.0)},
        supports=[
            Support(on="bottom"),
            Rigid(
                on="top",
                displacement=[0, 0, FREE],
                force=[0, 0, LOAD],
                curve=[[0, 0], [0.5, 0], [1, 1]],
            ),
        ],
        loads=[LOADS["bolt"](on="shank", axis="z", value=PRELOAD, **bolt)],
        degree=1,
    )


def forces(problem: Problem) -> dict[float, tuple[float, float]]:
    """Load parameter to the force in the shank and the shortening."""
    result = {}
    for state in Statics(problem, steps=2).steps():
        values = {key: float(value) for key, value in state.numbers.items()}
        result[round(state.t, 9)] = values["bolt_force_shank"], values["shortening_shank"]
    return result


@pytest.mark.long
def test_load_is_shared_by_stiffness_once_the_bolt_is_locked() -> None:
    """Then its force is F + P kb/(kb + kc): VDI 2230, without eccentricity."""
    kb, kc = STEEL * 1e-4 / 0.1, SLEEVE * 2e-4 / 0.1
    found = forces(clamped(locked_at=0.5))
    tight, loaded = found[0.5], found[1.0]
    assert tight[0] == pytest.approx(PRELOAD, rel=1e-8)
    assert tight[1] == pytest.approx(PRELOAD / kb + PRELOAD / kc, rel=1e-7)
    assert loaded[0] == pytest.approx(PRELOAD + LOAD * kb / (kb + kc), rel=1e-7)
    assert loaded[1] == pytest.approx(tight[1], rel=1e-9)


def test_a_bolt_that_is_not_locked_keeps_its_force() -> None:
    assert forces(clamped(curve=[[0, 0], [0.5, 1]]))[1.0][0] == pytest.approx(PRELOAD, rel=1e-8)


def test_a_locked_bolt_keeps_its_length_where_another_problem_goes_on() -> None:
    """As after a restart: the length of the lock is that of the state that is restored."""
    first, second = (Statics(clamped(locked_at=0.5), steps=4) for _ in range(2))
    for state in first.steps():
        if 0.7 < state.t < 0.8:
            saved = StateCopy(first.restart_state())
        whole = dict(state.numbers)
    *_, end = second.steps(saved)
    for key in ("bolt_force_shank", "shortening_shank"):
        assert end.numbers[key] == pytest.approx(whole[key], rel=1e-8)


def test_a_locked_bolt_is_tightened_whatever_the_guess_of_the_end_is() -> None:
    """As where modes follow on statics: its length is that at the lock, not that at the start."""
    problem = clamped(locked_at=0.5)
    *_, end = (solver := Statics(problem, steps=2)).steps()
    scalars = tuple(solver.restart_state().numbers["scalars"])
    guess = InitialGuess(problem.w.x.array.copy(), scalars)
    *_, again = Statics(clamped(locked_at=0.5), steps=2).steps(near=guess)
    assert again.numbers["bolt_force_shank"] == pytest.approx(
        end.numbers["bolt_force_shank"], rel=1e-8
    )


def frame() -> Body:
    """A plane frame of squares: three legs between two beams; the middle one is the shank."""
    comm, n = MPI.COMM_WORLD, 6
    here = [(i, j) for i in range(5) for j in range(n) if j in (0, n - 1) or i in (0, 2, 4)]
    corner = {
        p: k
        for k, p in enumerate(
            sorted({(i + a, j + b) for i, j in here for a in (0, 1) for b in (0, 1)})
        )
    }
    cells = []
    for i, j in here:
        a, b, c, d = (corner[i + p, j + q] for p, q in ((0, 0), (1, 0), (1, 1), (0, 1)))
        cells += [[a, b, c], [a, c, d]]
    root = comm.rank == 0
    triangles = np.array(cells if root else np.empty((0, 3)), dtype=np.int64)
    x = np.array(list(corner), dtype=float) if root else np.empty((0, 2))
    body = name_parts(
        Body(make_mesh(comm, triangles, x, 1)),
        surfaces={"foot": Selector(plane="y", at="min"), "head": Selector(plane="y", at="max")},
        regions={"shank": Selector(box=([2, 1], [3, n - 1]))},
    )
    body.mesh.topology.create_connectivity(1, 2)
    cut = locate_entities(
        body.mesh, 1, lambda x: (np.abs(x[1] - 3) < 1e-9) & (x[0] > 1.9) & (x[0] < 3.1)
    )
    return body.named(surfaces={"cut": np.sort(cut).astype(np.int32)})


@pytest.mark.long
def test_each_section_of_a_shank_has_the_preload() -> None:
    """Of a frame at large strains, whose beams bend: by the nodal forces across a section."""
    problem = Problem(
        frame(),
        NeoHookean(E=1e6, nu=0.3),
        supports=[Support(on="foot")],
        loads=[LOADS["bolt"](on="shank", axis="y", value=3e4)],
        degree=2,
    )
    *_, state = Statics(problem).steps()
    assert state.numbers["bolt_force_shank"] == pytest.approx(3e4, rel=1e-8)
    section = SectionForces(problem, {"cut": Section(on="cut")})(state)["cut"]
    assert abs(section.force[1]) == pytest.approx(3e4, rel=1e-6)
    assert state.numbers["shortening_shank"] > 0.05


@pytest.mark.long
@pytest.mark.parametrize("at", [0.04, 0.05])
@pytest.mark.parametrize("degree", [1, 2])
def test_a_cut_bar_is_shortened_by_what_its_force_needs(at: float, degree: int) -> None:
    """F L/(E A), exactly: the two sides overlap by as much, and the stress is uniform.

    The cut is one of nodes, or of the facets nearest to it, which are no plane.
    """
    bar = box_body(size=(0.01, 0.01, 0.1), cells=(2, 1, 5))
    problem = Problem(
        name_parts(bar, surfaces={"neck": Selector(cut=True, plane="z", at=at)}),
        LinearElastic(E=STEEL, nu=0.0),
        supports=[Support(on="bottom"), Support(on="top")],
        loads=[LOADS["bolt"](on="neck", axis=[0, 0, -1], value=PRELOAD)],
        degree=degree,
    )
    *_, state = Statics(problem).steps()
    assert state.numbers["bolt_force_neck"] == pytest.approx(PRELOAD, rel=1e-9)
    assert state.numbers["shortening_neck"] == pytest.approx(
        PRELOAD * 0.1 / (STEEL * 1e-4), rel=1e-7
    )
    sections = {"other": Section(plane="z", at=0.071), "itself": Section(on="neck")}
    for section in SectionForces(problem, sections)(state).values():
        assert abs(section.force[2]) == pytest.approx(PRELOAD, rel=1e-9)


@pytest.mark.long
def test_a_cut_equals_a_shank_at_large_strains() -> None:
    """Of slender legs: what a section is shortened by, the whole leg is, to the strain squared."""
    found = {}
    for on in ("shank", "cut"):
        problem = Problem(
            frame(),
            NeoHookean(E=1e6, nu=0.3),
            supports=[Support(on="foot")],
            loads=[LOADS["bolt"](on=on, axis="y", value=3e3, name="bolt")],
            degree=2,
        )
        *_, state = Statics(problem).steps()
        assert state.numbers["bolt_force_bolt"] == pytest.approx(3e3, rel=1e-8)
        found[on] = float(state.numbers["shortening_bolt"])
        section = SectionForces(problem, {"up": Section(plane="y", at=4.1)})
        assert section(state)["up"].force[1] == pytest.approx(0.0, abs=1.0)
    assert found["cut"] == pytest.approx(found["shank"], rel=2e-2)


@pytest.mark.parametrize(
    ("keys", "where", "said"),
    [
        ({"on": "neck"}, "load[0].on", "two sides that cannot"),
        ({"on": "bottom"}, "load[0].on", "on the boundary"),
        ({"on": ["cut", "neck"]}, "load[0].on", "cut once"),
        ({"on": "cut", "axis": "x"}, "load[0].axis", "lies in the surface"),
        ({"on": "nck"}, "load[0].on", "no surface 'nck'"),
    ],
)
def test_surfaces_that_cut_no_shank(keys: dict[str, Any], where: str, said: str) -> None:
    """The neck ends in the sleeve, which is one body with the shank."""
    body = name_parts(
        box_body(size=(0.03, 0.01, 0.1), cells=(3, 1, 2)),
        regions={"shank": Selector(box=([0, 0, 0], [0.01, 0.01, 0.1]))},
        surfaces={
            "neck": Selector(cut=True, plane="z", at=0.05, of="shank"),
            "cut": Selector(cut=True, plane="z", at=0.05),
        },
    )
    with pytest.raises(InputError, match=said) as caught:
        Problem(
            body,
            LinearElastic(E=STEEL, nu=0.0),
            supports=[Support(on="bottom"), Support(on="top")],
            loads=[LOADS["bolt"](**{"axis": "z", "value": PRELOAD, **keys})],
        )
    assert caught.value.where == where


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"axis": [0, 0, 0]}, "axis: a direction cannot be zero"),
        ({"axis": [1]}, r"axis: \[1\] is wrong; expected"),
        ({"axis": [0, 0, 1, 5]}, r"axis: \[0, 0, 1, 5\] is wrong; expected"),
        ({"locked_at": 0.5, "curve": "ramp"}, "given together"),
        ({"value": "x"}, "one preload"),
        ({"value": "3 MPa"}, "N"),
    ],
)
def test_what_is_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        LOADS["bolt"](**{"on": "shank", "axis": "z", "value": 1.0, **keys})


def test_a_path_along_which_the_load_may_fall_does_not_lock() -> None:
    """It would unlock the bolt where the load falls below."""
    with pytest.raises(InputError, match="along a path may fall"):
        next(iter(Statics(clamped(locked_at=0.5), method="arc-length").steps()))


def test_a_plane_body_has_no_bolt_across_it() -> None:
    with pytest.raises(InputError, match="no length") as caught:
        Problem(
            frame(),
            NeoHookean(E=1e6, nu=0.3),
            supports=[Support(on="foot")],
            loads=[LOADS["bolt"](on="shank", axis="z", value=3e4)],
            degree=1,
        )
    assert caught.value.where == "load[0].axis"
