"""Load factors of buckling against Euler, Engesser, and the path of equilibria itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import (
    Body,
    Buckling,
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
    Traction,
    name_parts,
    rectangle_body,
)
from dolfin_elastic.core.errors import ConvergenceError, InputError
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.problem.state import Mode, State
from dolfin_elastic.solvers.eigen.mode_shapes import at_rest
from dolfin_elastic.solvers.eigen.settings import ModalSettings
from dolfin_elastic.solvers.linear.choice import LinearSettings
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
    """About a loaded state the factor is that of the path, quadratically in what is left.

    Linear buckling leaves out terms of second order in the strain before, 0.2 %; they are the
    law's own.  At 0.95 of the load hardly anything is left out.
    """
    problem = column(strip(comm, (20, 2)))
    linear, half, near = (
        factors(problem, count=1, preload=s, statics=StaticsSettings(steps=1))[0]
        for s in (0.0, 0.5, 0.9)
    )
    assert linear == pytest.approx(near, rel=2e-3)
    # Left out: (near - s)^2 of a quadratic change of the tangent.
    assert (half - near) / (linear - near) == pytest.approx(0.25, abs=0.05)
    # Frequencies vanish at the same load, by another eigenvalue problem.
    loaded = column(strip(comm, (20, 2)), load=-0.97 * EULER * near)
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
    """A load the other way: the column is pulled, and buckles under its opposite."""
    pushed = factors(column(strip(comm, (10, 1))), count=1)
    pulled = factors(column(strip(comm, (10, 1)), load=EULER), count=1, negative=True)
    assert [f for f in pulled if f < 0] == pytest.approx([-f for f in pushed], rel=1e-7)
    assert len(pulled) == 2
    assert pulled[0] > 100  # where the material itself gives way, if at all


@pytest.mark.parametrize("preload", [0.9, 0.98])
def test_reversed_is_linearised_at_rest(preload: float, comm: MPI.Comm) -> None:
    """Whatever the preload: about it the stiffness vanishes elsewhere, too, and that says nothing.

    About 0.98 of its load the column would "buckle" at less of it, where it has been stable.
    """
    problem = column(strip(comm, (10, 1)))
    pushed, pulled = factors(problem, count=1, negative=True)
    share = preload * pushed
    steps = StaticsSettings(steps=1)
    modes = list(Buckling(problem, count=1, negative=True, preload=share, statics=steps).modes())
    assert [mode.load_factor for mode in modes] == pytest.approx([pushed, pulled], rel=3e-3)
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


def test_mixed(comm: MPI.Comm) -> None:
    """With a pressure as an unknown: the same factors where both formulations are good."""
    law = NeoHookeanSplit(**SOFT)
    both = [
        factors(column(strip(comm, (20, 2)), law, formulation=kind), count=2)
        for kind in ("displacement", "mixed")
    ]
    assert both[1] == pytest.approx(both[0], rel=4e-3)


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


def test_strains_that_are_too_large_are_told(comm: MPI.Comm, caplog: Any) -> None:
    """A bar that is pulled "buckles" where it is strained by a third; a column does at 0.3 %."""
    told = []
    for pull in (1e5, -1e5):
        load = Traction(on="right", value=[pull, 0])
        caplog.clear()
        found = factors(
            Problem(
                strip(comm, (8, 1)),
                NeoHookean(**SOFT),
                supports=[Support(on="left")],
                loads=[load],
                degree=1,
            ),
            count=1,
        )
        mine = any("strained by" in record.message for record in caplog.records)
        told.append(comm.bcast(mine))  # rank 0 says it
        assert found[0] > 0
    assert told == [True, False]


def test_strains_are_told_of_either_way(comm: MPI.Comm, caplog: Any) -> None:
    """That the reversed loads buckle the body sooner says nothing of these."""
    problem = Problem(
        strip(comm, (8, 1)),
        NeoHookean(**SOFT),
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[1e5, 0])],
        degree=1,
    )
    found = factors(problem, count=1, negative=True)
    assert abs(found[1]) < 0.1 * found[0]
    mine = [r.message for r in caplog.records if "strained by" in r.message]
    told = comm.bcast(mine)
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
        r"materials.body.law: 'linear-elastic' is a law of small rotations: .* st-venant-kirchhoff",
        law=LinearElastic(**SOFT),
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
        "solver.method: buckling needs a factorisation",
        settings={"linear": LinearSettings(method="iterative")},
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
