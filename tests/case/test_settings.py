"""Keys of the analyses that say nothing beside others: none is ignored without a word."""

from __future__ import annotations

import re
from itertools import pairwise
from typing import Any

import pytest

from dolfin_elastic import (
    Buckling,
    Case,
    Dynamics,
    Modal,
    NeoHookean,
    Problem,
    Statics,
    Support,
    Traction,
    rectangle_body,
    run,
)
from dolfin_elastic.case.check.report import report
from dolfin_elastic.case.tables import Output
from dolfin_elastic.core.errors import ConvergenceError, InputError
from dolfin_elastic.core.schema import known_keys
from dolfin_elastic.results.checkpoint.checkpoints import CheckpointSettings
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.solvers.dynamics.settings import DynamicsSettings
from dolfin_elastic.solvers.eigen.settings import BucklingSettings, ModalSettings
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.statics.settings import StaticsSettings

EULER, CENTRAL = {"scheme": "symplectic-euler"}, {"scheme": "central-differences"}
NEWMARK, IMPLICIT = {"scheme": "newmark"}, {"scheme": "implicit-euler"}
ARC = {"method": "arc-length"}


def case(**tables: Any) -> Case:
    """A square that is held and pulled."""
    tables = {
        "mesh": {"rectangle": {"size": [1, 1], "cells": [1, 1]}, "degree": 1},
        "materials": {"gel": {"law": "neo-hookean", "E": 1e6, "nu": 0.3, "density": 1000}},
        "support": [{"on": "left"}],
        "load": [{"kind": "traction", "on": "right", "value": [1e3, 0]}],
    } | tables
    return Case(**tables)


# --- motion ---

MOTION: list[tuple[dict[str, Any], str]] = [
    (NEWMARK | {"spectral_radius": 0.9}, "spectral_radius: the scheme 'newmark' has no spectral"),
    (IMPLICIT | {"spectral_radius": 0.5}, "spectral_radius: the scheme 'implicit-euler' has no"),
    (EULER | {"spectral_radius": 1.0}, "spectral_radius: the scheme 'symplectic-euler' has no"),
    ({"beta": 0.25}, "beta: the scheme 'generalized-alpha' has no beta; leave it out, or scheme ="),
    (EULER | {"gamma": 0.5}, "gamma: the scheme 'symplectic-euler' has no gamma"),
    ({"tolerance": 1e-3}, "tolerance: all steps are dt: .* leave it out, or adaptive = true"),
    ({"tolerance": 1e-3, "adaptive": False}, "tolerance: all steps are dt"),
    ({"safety": 0.9}, "safety: the scheme 'generalized-alpha' does not use the stable step"),
    ({"safety": 0.9, "adaptive": True}, "safety: the scheme 'generalized-alpha' does not use"),
    (EULER | {"adaptive": True}, "adaptive: the scheme 'symplectic-euler' has no estimate"),
    (CENTRAL | {"tolerance": 0.1}, "tolerance: the scheme 'central-differences' has no estimate"),
    (CENTRAL | {"rtol": 1e-6}, "rtol: the scheme 'central-differences' solves no equations"),
    (EULER | {"atol": "1 N"}, "atol: the scheme 'symplectic-euler' solves no equations"),
    (EULER | {"max_iterations": 9}, "max_iterations: the scheme 'symplectic-euler' solves no"),
    (EULER | {"rayleigh": [1, 0]}, "rayleigh: the scheme 'symplectic-euler' has no rayleigh"),
    (EULER | {"times": [0.5]}, "times: the scheme 'symplectic-euler' meets no times exactly"),
    (EULER | {"dt": "1 ms", "safety": 0.5}, r"safety: dt = 0.001 s is given, .* one of them"),
    ({"times": [0.5, 1.5]}, r"times\[1\]: 1.5 s lies beyond the end; at most dynamics.end = 1 s"),
    ({"dt": 2.0}, "dt: 2 s is longer than the motion; at most dynamics.end = 1 s"),
]


@pytest.mark.parametrize(("keys", "message"), MOTION, ids=[message[:30] for _, message in MOTION])
def test_keys_of_motion_beside_each_other(keys, message):
    """The key, why, and what to do; in a case with its table in front."""
    dt = {} if keys.get("scheme") in (EULER["scheme"], CENTRAL["scheme"]) else {"dt": 0.1}
    with pytest.raises(InputError, match=f"^{message}"):
        DynamicsSettings(end=1.0, **(dt | keys))
    with pytest.raises(InputError, match=f"^dynamics.{message}"):
        case(dynamics={"end": 1.0, **dt, **keys})


@pytest.mark.parametrize(
    "keys",
    [
        {"spectral_radius": 0.5},
        {"scheme": "alpha2", "spectral_radius": 0.5, "rtol": 1e-9},
        NEWMARK | {"beta": 0.25, "gamma": 0.5},
        {"adaptive": True, "tolerance": 1e-2},
        {"every": "0.7 ms"},
        {"adaptive": False, "beta": None, "times": [], "rayleigh": None},
        CENTRAL | {"safety": 0.5, "every": 3, "adaptive": False, "times": [], "dt": None},
        EULER | {"dt": 1e-3},
    ],
    ids=str,
)
def test_keys_of_motion_that_go_together(keys):
    """What says nothing, as nothing was written into it, is no fault; and it is written back."""
    dt = {} if "safety" in keys else {"dt": 0.1}
    read = case(dynamics={"end": 1.0, **dt, **keys})
    assert Case(**read.to_dict()).dynamics == read.dynamics


def test_an_implicit_scheme_needs_a_step():
    with pytest.raises(InputError, match=r"^dynamics.dt: this key is missing; 'newmark' needs a"):
        case(dynamics={"end": 1.0, **NEWMARK})


# --- where a fault lies ---

PLACES: list[tuple[dict[str, Any], str]] = [
    ({"every": "2 mm"}, "dynamics.every: '2 mm' has the wrong unit; expected a whole number or a"),
    ({"every": [1]}, r"dynamics.every: \[1\] is wrong; expected a whole number or a number in s"),
    (
        {"every": 2.0},
        "dynamics.every: 2.0 is wrong; expected a whole number of steps, at least",
    ),
    (
        {"every": "7"},
        'dynamics.every: "7" is wrong; expected a whole number of steps, at least',
    ),
    ({"every": "2 s"}, "dynamics.every: 2 s lies beyond the end; at most dynamics.end = 1 s"),
    (
        {"every": -1},
        "dynamics.every: -1 is wrong; expected a whole number of steps, at least 1, or",
    ),
    (
        {"every": 0},
        "dynamics.every: 0 is wrong; expected a whole number of steps, at least 1, or "
        r'\(implicit schemes\) a time above 0 with a unit, for example "10 ms"',
    ),
    ({"every": "0 s"}, "dynamics.every: 0 s is wrong; expected a whole number of steps, at least"),
    ({"every": "-2 ms"}, "dynamics.every: -0.002 s is wrong; expected a whole number of steps, at"),
    ({"every": True}, "dynamics.every: true is wrong; expected a whole number of steps, at least"),
    ({"times": ["x"]}, r"dynamics.times\[0\]: 'x' is not a number; expected a number in s"),
    ({"rayleigh": [1]}, r"dynamics.rayleigh: 1 factor given; expected two, \[alpha, beta\], or"),
    ({"rayleigh": 50}, r"dynamics.rayleigh: 50 is wrong; expected \[alpha, beta\], .* or a table"),
    ({"bulk_viscosity": False}, "dynamics.bulk_viscosity: false is wrong; expected true, .* table"),
    ({"bulk_viscosity": "yes"}, "dynamics.bulk_viscosity: ['\"]yes['\"] is wrong; expected true,"),
    ({"mass_scaling": True}, 'dynamics.mass_scaling: true is wrong; expected a fraction .* "1 %"'),
    ({"mass_scaling": "yes"}, "dynamics.mass_scaling: ['\"]yes['\"] is wrong; expected a fraction"),
    ({"mass_scaling": [1]}, r"dynamics.mass_scaling: \[1\] is wrong; expected a fraction"),
    ({"rayleigh": [1, "2 m"]}, "dynamics.rayleigh.stiffness: '2 m' has the wrong unit; expected"),
    ({"rayleigh": {"mas": 1}}, "dynamics.rayleigh: unknown key 'mas'; did you mean 'mass'"),
    ({"initial_velocity": [0, "q"]}, r"dynamics.initial_velocity\[1\]: unknown name 'q'"),
    ({"initial_velocity": [0, "2 m"]}, r"dynamics.initial_velocity\[1\]: '2 m' has the wrong un"),
    ({"initial_displacement": [0]}, r"dynamics.initial_displacement: \[0\] is not a vector"),
    (
        {"initial_displacement": ["t", 0]},
        "dynamics.initial_displacement: an initial value",
    ),
    ({"scheme": 3}, "dynamics.scheme: 3 is wrong; expected 'generalized-alpha', "),
    ({"max_iterations": True}, "dynamics.max_iterations: true is wrong; expected a whole number"),
]


@pytest.mark.parametrize(("keys", "message"), PLACES, ids=[message[:40] for _, message in PLACES])
def test_messages_name_the_key_that_was_written(keys, message):
    """None of pydantic's own names of what it tried."""
    with pytest.raises(InputError, match=f"^{message}"):
        case(dynamics={"end": 1.0, "dt": 0.1, **keys})


OTHERS: list[tuple[dict[str, Any], str]] = [
    (
        {
            "dynamics": {"end": 1.0, "dt": 0.1},
            "contact": [
                {"on": "left", "plane": {"axis": "x", "at": -1}, "gap_tolerance": "1 um"},
            ],
        },
        r"contact\[0\].gap_tolerance: in motion the penalty decides",
    ),
    ({"output": {"checkpoint": "5 mum"}}, "output.checkpoint.time: '5 mum' has the wrong unit"),
    ({"output": {"probes": {"tip": {"at": 3}}}}, "output.probes.tip.at: "),
    (
        {"output": {"every": 0}},
        "output.every: 0 is wrong; expected a whole number of steps, at least",
    ),
    (
        {"output": {"checkpoint": {"every": 0}}},
        "output.checkpoint.every: 0 is wrong; expected a whole number of steps, at least 1",
    ),
    ({"modal": {"preload": "yes"}}, 'modal.preload: "yes" is wrong; expected true or false'),
    ({"modal": {"preload": "no"}}, 'modal.preload: "no" is wrong; expected true or false'),
    ({"modal": {"preload": 1}}, "modal.preload: 1 is wrong; expected true or false"),
    ({"buckling": {"negative": "on"}}, 'buckling.negative: "on" is wrong; expected true or false'),
    (
        {"support": [{"kind": "rotation", "on": "left", "point": [0, 0], "angle": 1, "axis": "w"}]},
        r"support\[0\].axis: \"w\" is wrong; ",
    ),
    ({"output": {"fields": [3]}}, r"output.fields\[0\]: 3 is wrong; expected a text"),
    ({"solver": {"petsc": {"ksp_type": []}}}, r"solver.petsc.ksp_type: \[\] is wrong; expected t"),
    ({"load": [{"kind": "pressure", "on": [3], "value": 1}]}, r"load\[0\].on\[0\]: 3 is wrong"),
    ({"load": [{"kind": "gravity", "value": [0]}]}, r"load\[0\].value: \[0\] is not a vector"),
    ({"support": [{"on": "left", "displacement": [0]}]}, r"support\[0\].displacement: \[0\] is"),
    ({"support": [{"on": "left", "displacement": ["q", 0]}]}, r"support\[0\].displacement\[0\]: "),
    (
        {"support": [{"kind": "rotation", "on": "left", "point": [0, 0], "angle": "x y"}]},
        r"support\[0\].angle: an operator is missing",
    ),
    (
        {"mesh": {"rectangle": {"size": [1, "q"], "cells": [1, 1]}, "degree": 1}},
        r"mesh.rectangle.size\[1\]: ",
    ),
    ({"surfaces": {"a": {"plane": "y", "at": []}}}, "surfaces.a.at: "),
    ({"statics": {"times": [True]}}, r"statics.times\[0\]: True is not a number; expected a nu"),
    (
        {"mesh": {"rectangle": {"size": [1, 1], "cells": [1, True]}, "degree": 1}},
        r"mesh.rectangle.cells\[1\]: true is wrong; expected a whole number",
    ),
    (
        {"mesh": {"rectangle": {"size": [1, True], "cells": [1, 1]}, "degree": 1}},
        r"mesh.rectangle.size\[1\]: a number is needed, or a length",
    ),
    ({"output": {"probes": {"tip": [1, True]}}}, r"output.probes.tip.at\[1\]: "),
    ({"statics": {"steps": True}}, "statics.steps: true is wrong; expected a whole number"),
]


@pytest.mark.parametrize(("tables", "message"), OTHERS, ids=[message[:40] for _, message in OTHERS])
def test_so_do_those_about_other_tables(tables, message):
    """Of lists, tables by name, and unions in them."""
    with pytest.raises(InputError, match=f"^{message}"):
        case(**tables)


WRONG: list[Any] = ["x y", "1 parsec", [], [1], ["a", 2], {}, {"a": 1}, True, -1, 0.5, "", [[1]]]
OURS = "constrained|function|list\\[|tuple\\[|literal\\[|validat|union|Input should|\\[key\\]"


@pytest.mark.parametrize(
    ("table", "record", "more"),
    [
        ("dynamics", DynamicsSettings, {"end": 1.0, "dt": 0.1}),
        ("statics", StaticsSettings, {}),
        ("modal", ModalSettings, {}),
        ("buckling", BucklingSettings, {}),
        ("solver", LinearSettings, {}),
        ("output", Output, {}),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_whatever_is_wrong_the_key_is_named(table, record, more):
    """Every key of these tables with a dozen values, each right for few of them."""
    found = [
        (key, fault_of({table: {**more, key: w}})) for key in known_keys(record) for w in WRONG
    ]
    faults = [(key, fault) for key, fault in found if fault is not None]
    for key, fault in faults:
        assert re.fullmatch(rf"{table}\.{key}([.\[][^:]*)?", fault.where), fault
        assert not re.search(OURS, str(fault)), fault
    assert len(faults) > 4 * len(known_keys(record))


def fault_of(tables: dict[str, Any]) -> InputError | None:
    try:
        case(**tables)
    except InputError as error:
        return error
    return None


# --- statics, and the way to a preload ---

PATHS: list[tuple[dict[str, Any], str]] = [
    ({"steps": 4, "first_step": 0.1}, "steps and first_step given together"),
    ({"steps": 4, "max_step": 0.5}, "max_step: steps are equal where"),
    ({"first_step": 0.5, "max_step": 0.1}, "first_step: 0.5 is more than any step may be; at most"),
    (ARC | {"steps": 4}, "steps: steps along a path are measured by its length"),
    (ARC | {"max_step": 0.1}, "max_step: steps along a path are measured by its length"),
    (ARC | {"snap": True}, "snap: a path that is followed by its length"),
    (ARC | {"times": [0.5]}, "times: a path that is followed by its length meets no load"),
    ({"times": [0.5, 1.5]}, r"times\[1\]: 1.5 lies beyond the end; at most statics.end = 1$"),
    ({"end": "1 h", "times": ["2 h"]}, r"times\[0\]: 7200 s lies beyond the end; .* = 3600 s$"),
    ({"end": "0 s"}, 'end: "0 s" is wrong; expected a time above 0'),
    ({"end": "1e300 h"}, r"end: 3.6e\+303 s is wrong; at most 1e\+09 s"),
    ({"end": "3 kg"}, "end: '3 kg' has the wrong unit"),
    (
        {"end": 100, "max_step": "2 min"},
        "max_step: 120 s is wrong; from 0.0001 s to statics.end = ",
    ),
    (
        {"end": "1 h", "first_step": "10 min", "max_step": "5 min"},
        "first_step: 600 s is more than any step may be; at most statics.max_step = 300 s",
    ),
]


@pytest.mark.parametrize(("keys", "message"), PATHS, ids=[message[:30] for _, message in PATHS])
def test_keys_of_statics_beside_each_other(keys, message):
    with pytest.raises(InputError, match=f"^{message}"):
        StaticsSettings(**keys)
    with pytest.raises(InputError, match=r"^statics[.:]"):
        case(statics=keys)


TIMES = {"end": "1 h", "max_step": "15 min", "times": ["10 min", 2400, "0.9 h"]}


def test_times_of_statics_have_units(folder):
    """Where curves say what acts when: they are met, shown as times, and written back."""
    curve = [[0, 0], ["30 min", 1], ["1 h", 0]]
    load = {"kind": "traction", "on": "right", "value": [1e3, 0], "curve": curve}
    read = case(statics=TIMES, load=[load])
    again = Case(**read.to_dict())
    assert again.statics == read.statics
    assert again.timed
    found = list(run(again, output=folder / "out"))
    assert {600.0, 1800.0, 2400.0, 3240.0, 3600.0} <= {state.t for state in found}
    assert max(b.t - a.t for a, b in pairwise(found)) <= 900 * (1 + 1e-12)
    assert all(state.timed for state in found)
    assert FinishedRun(folder / "out").timed


@pytest.mark.parametrize(
    ("keys", "key"),
    [
        ({"end": "1 h"}, "end"),
        ({"times": [0.5, "1 s"]}, r"times\[1\]"),
        ({"max_step": "1 s"}, "max_"),
    ],
    ids=str,
)
def test_a_time_of_statics_is_refused_where_none_passes(keys, key):
    """The load would be 3600 times as large."""
    for attempt in (
        lambda: report(case(statics=keys)),
        lambda: list(Statics(square(), **keys).steps()),
    ):
        with pytest.raises(
            InputError, match=f"^statics.{key}.*: nothing depends on time: no curve"
        ):
            attempt()


WAYS: list[tuple[dict[str, Any], str]] = [
    ({"modal": {}, "output": {"fields": ["displacement"]}}, "output.fields: modes without a"),
    ({"modal": {}, "output": {"every": 2}}, "output.every: modes without a preload"),
    ({"modal": {}, "output": {"probes": {"a": [0, 0]}}}, "output.probes: modes without a preload"),
    ({"buckling": {}, "output": {"checkpoint": "5 min"}}, r"output.checkpoint: a run of \[buckl"),
    ({"statics": {}, "output": {"frames": 10}}, "output.frames: there are no modes in statics"),
    (
        {"dynamics": {"end": 1, "dt": 0.1}, "output": {"amplitude": 0.2}},
        "output.amplitude: there are no modes in dynamics",
    ),
    (
        {"dynamics": {"end": 1, **EULER}, "solver": {"method": "direct"}},
        "solver.method: the scheme 'symplectic-euler' solves no equations; leave it out",
    ),
    (
        {"dynamics": {"end": 1, **EULER}, "solver": {"petsc": {"ksp_type": "cg"}}},
        "solver.petsc: the scheme 'symplectic-euler' solves no equations; leave it out",
    ),
]


@pytest.mark.parametrize(("tables", "message"), WAYS, ids=[message[:30] for _, message in WAYS])
def test_check_and_run_say_the_same(tables, message, folder):
    """Of keys beside those of other tables, too; and nothing has been written."""
    for attempt in (
        lambda: report(case(**tables)),
        lambda: next(run(case(**tables), output=folder / "out")),
    ):
        with pytest.raises(InputError, match=f"^{message}"):
            attempt()
    assert not (folder / "out").exists()


def test_what_says_nothing_may_stay():
    """Of modes: no checkpoint; of an explicit scheme: a solver chosen by itself."""
    case(modal={}, output={"checkpoint": False, "frames": 10})
    assert report(case(dynamics={"end": 1, **EULER}, solver={"method": "auto"})).unknowns == 8
    assert report(case(modal={"below": "1 kHz"}, statics=None)).analysis == "modal"


def square() -> Problem:
    return Problem(
        rectangle_body(size=(1, 1), cells=(2, 2)),
        NeoHookean(E=1e6, nu=0.3, density=1000),
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[1e4, 0])],
        degree=1,
    )


def test_in_python_too():
    """Solvers made by hand refuse the same."""
    problem = square()
    with pytest.raises(InputError, match=r"^solver.method: the scheme 'central-differences'"):
        Dynamics(problem, end=1.0, linear=LinearSettings(method="iterative"), **CENTRAL)
    with pytest.raises(InputError, match=r"^statics.end: .* ends where buckling.preload says"):
        Buckling(problem, preload=0.5, statics=StaticsSettings(end=2.0))
    beyond = r"^statics.times\[1\]: 0.7 lies beyond the end; at most buckling.preload = 0.5"
    with pytest.raises(InputError, match=beyond):
        Buckling(problem, preload=0.5, statics=StaticsSettings(times=[0.2, 0.7]))
    with pytest.raises(InputError, match=r"^statics.max_displacement: a preload is reached in f"):
        Modal(problem, preload=True, statics=StaticsSettings(max_displacement="1 mm"))
    with pytest.raises(InputError, match="^modal.below: modes below a frequency are counted"):
        Modal(problem, below="1 kHz", linear=LinearSettings(method="iterative"))
    with pytest.raises(InputError, match="^count and below given together"):
        ModalSettings(count=3, below=10.0)
    with pytest.raises(InputError, match="^keep: there are no checkpoints with off = true"):
        CheckpointSettings(off=True, keep=3)


@pytest.mark.parametrize("solver", [Statics, Dynamics, Modal, Buckling])
def test_settings_or_keywords(solver):
    """Not both, for one of them would be ignored."""
    settings: Any = {
        Statics: StaticsSettings(),
        Dynamics: DynamicsSettings(end=1.0, dt=0.1),
        Modal: ModalSettings(),
        Buckling: BucklingSettings(),
    }[solver]
    with pytest.raises(TypeError, match="give settings or keywords, not both: tolerance"):
        solver(square(), settings, tolerance=1e-6)


def test_a_preload_that_is_not_reached():
    """The way to it has ended before: there are no modes about another state."""
    way = StaticsSettings(first_step=0.25, max_step=0.25, max_steps=2)
    with pytest.raises(ConvergenceError, match="has ended at the load factor 0.5, before 1"):
        list(Modal(square(), preload=True, statics=way).steps())


def test_petsc_options_that_an_explicit_scheme_does_not_take(caplog):
    """Of a command line, where they are no part of the case, as elsewhere: a warning."""
    motion = Dynamics(square(), end=1e-4, petsc={"ksp_type": "cg"}, **EULER)
    list(motion.steps())
    message = [r.getMessage() for r in caplog.records if "ksp_type" in r.getMessage()]
    if motion.problem.body.comm.rank == 0:
        assert message == [
            "PETSc option '-ksp_type' was not used: 'symplectic-euler' solves no equations"
        ]
