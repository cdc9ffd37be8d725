"""The audit of equilibria: what balances is let pass, and every verdict can fail."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from mpi4py import MPI

from dolfin_elastic import (
    BodyForce,
    Case,
    Dynamics,
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
    rectangle_body,
)
from dolfin_elastic.cli.console import _end_rows
from dolfin_elastic.core.parallel import on_root, total
from dolfin_elastic.problem.state import Audit, State
from dolfin_elastic.results.outputs import History, Summary
from dolfin_elastic.solvers.assembly.assembler import Assembler, Reactions
from dolfin_elastic.solvers.audit.equilibrium import EquilibriumAuditor
from dolfin_elastic.solvers.nonlinear.jacobian import JacobianWatch

COMM = MPI.COMM_WORLD
E, NU = 1e6, 0.3
PULL = Traction(on="right", value=[1e4, 0, 3e4])
EXACT = 1e-9
"""Newton's method leaves 1e-8 of the norm of forces at most, in its last step far less."""


def block(law: Any = None, **more: Any) -> Problem:
    """A block that is held on the left and pulled on the right."""
    defaults: dict[str, Any] = {"supports": [Support(on="left")], "loads": [PULL]}
    body = more.pop("body", None) or box_body(size=(2, 1, 1), cells=(2, 1, 1))
    return Problem(body, law or NeoHookean(E=E, nu=NU), **{"degree": 1, **defaults, **more})


def bar(force: float = 1e4) -> Problem:
    """A bar of Hooke's material, 2 m long and 1 m^2 thick, pulled and free to contract."""
    sliding = [
        Support(on=name, displacement=["free" if i != k else 0 for i in range(3)])
        for k, name in enumerate(("left", "front", "bottom"))
    ]
    pull = Traction(on="right", value=[force, 0, 0])
    return block(LinearElastic(E=E, nu=NU), supports=sliding, loads=[pull])


def audits(problem: Problem, **settings: Any) -> list[Audit]:
    """The audit of each state of statics. Collective."""
    found = [state.audit for state in Statics(problem, **settings).steps()]
    assert all(audit is not None for audit in found)
    return [audit for audit in found if audit is not None]


@pytest.fixture
def said() -> Iterator[list[str]]:
    """What the audit says in the log: on rank 0 only."""
    lines: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: lines.append(record.getMessage())  # type: ignore[method-assign]
    log = logging.getLogger("dolfin_elastic")
    log.addHandler(handler)
    yield lines
    log.removeHandler(handler)


# --- what is right is let pass ---


@pytest.mark.parametrize(("load", "far"), [(0.9e5, False), (1.2e5, True)])
def test_small_strain_law_at_large_strains(load, far, said):
    """The bar's |grad u| is e (1 + 2 nu^2)^(1/2): it is told once, from 0.1 on."""
    problem = bar(load)
    last = audits(problem, steps=3)[-1]
    told = [line for line in said if "is for small strains" in line]
    assert bool(last.notes) is far
    assert COMM.allreduce(len(told)) in ((1, COMM.size) if far else (0,))
    if far:
        size = load / E * np.sqrt(1 + 2 * NU**2)
        assert (
            f"linear-elastic is for small strains and rotations, but |grad u| is {size:.2g}"
            in (last.notes[0])
        )
        assert last.verdict == "pass"


@pytest.mark.parametrize("scheme", ["generalized-alpha", "central-differences"])
def test_small_strain_law_at_large_strains_in_motion(scheme, said):
    """Both corners of u = 0.12 x say so at once, those of 0.09 x do so never."""
    for size, many in ((0.09, 0), (0.12, 1)):
        said.clear()
        problem = Problem(
            rectangle_body(size=(1.0, 1.0), cells=(2, 2)),
            LinearElastic(E=E, nu=NU, density=1000.0),
            degree=1,
        )
        start = {"initial_displacement": [f"{size}*x", 0]}
        dt = 1e-5 if scheme == "generalized-alpha" else None
        for state in Dynamics(problem, scheme=scheme, end=5e-5, dt=dt, **start).steps():
            notes = state.audit.notes if state.audit is not None else ()
            assert sum("is for small strains" in note for note in notes) in (0, many)
        told = [line for line in said if f"|grad u| is {size}" in line and "(t = 0 s)" in line]
        assert COMM.allreduce(len(told)) in ((1, COMM.size) if many else (0,))


@pytest.mark.parametrize("law", [LinearElastic, NeoHookean, Textbook])
def test_equilibrium_passes(law, said):
    """Forces and moments balance in the places where the law's stress is symmetric."""
    found = audits(block(law(E=E, nu=NU)), steps=2)
    assert [audit.verdict for audit in found] == ["pass"] * 3
    assert max(audit.force for audit in found) < EXACT
    assert max(audit.moment for audit in found) < EXACT
    assert found[-1].so_far == ()
    assert not [line for line in said if line.startswith("audit")]


def test_bar_in_tension():
    """Hooke's bar of length L, area A: work F^2 L/(2 E A), det F = (1 + e)(1 - nu e)^2."""
    last = audits(bar(), steps=3)[-1]
    strain = 1e4 / E
    # The trapezoidal rule is exact where forces grow in proportion: only round-off is left.
    assert last.work == pytest.approx(0.5 * 1e4 * 2 * strain, rel=1e-11)
    assert last.energy == pytest.approx(last.work, rel=1e-11)
    J = (1 + strain) * (1 - NU * strain) ** 2
    assert (last.min_jacobian, last.max_jacobian) == pytest.approx((J, J), rel=1e-12)


def test_where_det_f_is_no_number_a_cell_is_named() -> None:
    """The origin is no place of a body that lies beside it."""
    body = box_body(size=(2, 1, 1), cells=(2, 1, 1), origin=(5, 5, 5))
    problem = block(body=body)
    problem.u.x.array[:] = np.nan
    for value, place in JacobianWatch(problem).extremes():
        assert value == -np.inf
        assert ((place > 5) & (place < (7, 6, 6))).all()


def test_load_that_is_on_from_the_start(said):
    """The undeformed body is no equilibrium then, which is nobody's fault."""
    load = Traction(on="right", value=[1e4, 0, 3e4], curve="constant")
    for law in (LinearElastic(E=E, nu=NU), NeoHookean(E=E, nu=NU)):
        found = audits(block(law, loads=[load]), steps=2)
        assert [audit.verdict for audit in found] == ["pass"] * 3
    assert not [line for line in said if line.startswith("audit")]


SHAFT = {"axis": "y", "point": [0, 0], "radius": "20.0025 mm"}
WALLS = {"left": [1, 0, 0], "right": [-1, 0, 0]}
PRESSED = {
    "ring on a shaft": {
        "mesh": {
            "rectangle": {"size": [10, 20], "cells": [6, 4], "origin": [20, 0]},
            "geometry": "axisymmetric",
        },
        "support": [{"on": "bottom", "kind": "normal"}],
        "contact": [{"on": "left", "cylinder": SHAFT}],
    },
    "block between walls": {
        "mesh": {"box": {"size": [20, 20, 20], "cells": [2, 2, 2], "origin": [-10, 0, 0]}},
        "support": [{"on": name, "kind": "normal"} for name in ("bottom", "front")],
        "contact": [
            {"on": name, "plane": {"normal": n, "point": [-9.9975 * n[0], 0, 0]}}
            for name, n in WALLS.items()
        ],
    },
}
"""Bodies of steel that begin 2.5 um deep in rigid obstacles, whose forces cancel in sum."""


@pytest.mark.parametrize("name", PRESSED)
def test_begins_in_an_obstacle(name: str, said: list[str]) -> None:
    """The work of the obstacle is the stored energy: the law is linear, and the forces begin at 0.

    As far as the last Newton step, which brings the nodes to 1 nm from the obstacle.
    """
    tables: dict[str, Any] = PRESSED[name]
    case = Case.from_dict(
        {
            "materials": {"steel": {"law": "linear-elastic", "E": "210 GPa", "nu": 0.3}},
            **tables,
            "mesh": {**tables["mesh"], "unit": "mm"},
            "contact": [{**row, "gap_tolerance": "1 nm"} for row in tables["contact"]],
        }
    )
    problem = case.make_problem(case.read_body(COMM))
    *_, state = case.make_solver(problem).steps()
    assert state.audit is not None
    assert state.audit.verdict_so_far == "pass", state.audit.so_far
    assert state.audit.work == pytest.approx(state.energies["strain"], rel=1e-3)
    assert not said


def test_path_over_a_maximum_passes():
    """A St Venant-Kirchhoff bar is softest at the stretch 1/sqrt(3): past it forces fall.

    With its sides held, P = (lmbda + 2 mu)/2 (s^3 - s) and psi = (lmbda + 2 mu)/8 (s^2 - 1)^2.
    """
    sides = [
        Support(on=name, displacement=["free" if i != k else 0 for i in range(3)])
        for name, k in (("front", 1), ("back", 1), ("bottom", 2), ("top", 2))
    ]
    law = StVenantKirchhoff(E=E, nu=NU)
    ends = [
        Support(on="left", displacement=[0, 0, 0]),
        Support(on="right", displacement=[-1, 0, 0]),
    ]
    body = box_body(size=(2, 1, 1), cells=(1, 1, 1))  # no part of it can give way alone
    found = audits(block(law, body=body, supports=[*sides, *ends], loads=[]), steps=10)
    assert {audit.verdict for audit in found} == {"pass"}
    stiff, s = law.lmbda + 2 * law.mu, 0.5
    stored = 2 * stiff / 8 * (s**2 - 1) ** 2
    assert found[-1].energy == pytest.approx(stored, rel=1e-9)
    # Error of the trapezoidal rule with n steps: (P'(end) - P'(start)) du^2/12 for each length.
    error = stiff / 2 * (3 * s**2 - 3) * (0.5 / 10) ** 2 / 12 * 2
    assert found[-1].work - stored == pytest.approx(error, rel=2e-2)


def test_tiny_loads_pass():
    """Where round-off of the stress is larger than the load, nothing can be said against it."""
    found = audits(block(loads=[Traction(on="right", value=[1e-5, 0, 3e-6])]), steps=2)
    assert {audit.verdict for audit in found} == {"pass"}


def test_held_by_springs():
    """Forces that hold the body by springs count as forces from outside."""
    problem = block()
    stiffness = problem.constant(1e5)
    springs = -stiffness * ufl.inner(problem.context.u, problem.v)
    springs = springs * problem.context.areas(("right",))
    problem.weak_form.restraint_works["bed"] = springs
    states = list(Statics(problem, steps=2).steps())
    assert np.linalg.norm(states[-1].reactions["bed"]) > 1.0
    found = [state.audit for state in states]
    assert {audit.verdict for audit in found} == {"pass"}
    assert max(audit.force for audit in found) < EXACT


def test_axisymmetric():
    """Radial forces need not sum up to anything; axial ones do."""
    body = rectangle_body(size=(1, 1), cells=(2, 2))
    problem = block(
        body=body,
        geometry="axisymmetric",
        supports=[Support(on="bottom")],
        loads=[Traction(on="top", value=[0, 1e5])],
    )
    last = audits(problem, steps=2)[-1]
    assert last.verdict == "pass"
    assert last.force < EXACT
    assert np.isnan(last.moment)
    assert last.notes == ("no balance of moments and radial forces: they cancel round the axis",)


@pytest.mark.long
def test_what_is_not_judged():
    """No energy, a stabilised pressure, laws whose moments balance in different places."""
    assert "energy" in audits(block(Textbook(E=E, nu=NU)))[-1].notes[0]
    pressed = audits(block(NeoHookean(E=E, nu=0.49), formulation="mixed"), steps=4)[-1]
    assert pressed.verdict == "pass"
    assert "stabilised" in pressed.notes[0]
    body = name_parts(
        box_body(size=(2, 1, 1), cells=(2, 1, 1)),
        regions={
            "one": Selector(box=[[0, 0, 0], [1, 1, 1]]),
            "two": Selector(box=[[1, 0, 0], [2, 1, 1]]),
        },
    )
    laws = {"one": LinearElastic(E=E, nu=NU), "two": NeoHookean(E=E, nu=NU)}
    mixture = audits(block(laws, body=body))[-1]
    assert mixture.verdict == "pass"
    assert np.isnan(mixture.moment)
    assert mixture.force < EXACT


# --- what is wrong is not ---


def test_forces_that_do_not_balance(monkeypatch, said):
    """Applied forces that are wrong by 0.1 % are found, and said once.

    All nodal forces of the bar have one direction, so what is left is 0.001 of 1.001 F.
    """
    true = Reactions.loads
    monkeypatch.setattr(Reactions, "loads", lambda self: 1.001 * true(self))
    found = audits(bar(), steps=3)
    assert [audit.verdict for audit in found] == ["pass", "warn", "warn", "warn"]
    # Round-off of the stiffness, here 1e-8 of what is left, is taken off before.
    assert all(audit.force == pytest.approx(1e-3 / 1.001, rel=1e-6) for audit in found[1:])
    assert found[1].reasons[0].startswith("loads and reactions do not balance: 0.001 of their")
    assert found[1].reasons[1].startswith("the moments of loads and reactions about the origin")
    assert found[-1].so_far[0].endswith("(load factor 0.333333)")
    kinds = [line for line in said if line.startswith("audit: loads and reactions")]
    assert len(kinds) == (1 if COMM.rank == 0 else 0)


def test_load_that_is_missing(monkeypatch):
    """A load that the sum has forgotten is left over whole, and its work is missed."""
    monkeypatch.setattr(Reactions, "loads", lambda self: np.zeros(self._dofs.size))
    last = audits(bar(), steps=2)[-1]
    assert last.verdict == "warn"
    assert last.force == pytest.approx(1.0, rel=1e-8)
    assert last.reasons[-1].startswith("the work of the step, 0 J, and what it has stored")


def test_moments_that_do_not_balance(monkeypatch):
    """The same total force on other nodes: forces balance, moments do not."""
    true = Reactions.loads

    def spread(self: Reactions) -> Any:
        rows = true(self).reshape(-1, 3)
        sums = total(COMM, np.array([*rows.sum(axis=0), len(rows)]))
        return np.tile(sums[:3] / sums[3], len(rows))

    monkeypatch.setattr(Reactions, "loads", spread)
    last = audits(block(), steps=1)[-1]
    assert last.force < EXACT
    assert last.verdict == "warn"
    assert len([r for r in last.reasons if r.startswith("the moments")]) == 1


def test_jump():
    """A shallow arch under dead weight snaps through: the energy that is set free is missed."""
    body = rectangle_body(size=(10.0, 0.2), cells=(16, 1))
    x = body.mesh.geometry.x
    x[:, 1] += 0.6 * np.sin(np.pi * x[:, 0] / 10)
    problem = block(
        StVenantKirchhoff(E=E, nu=NU),
        body=body,
        degree=2,
        supports=[Support(on=["left", "right"])],
        loads=[BodyForce(value=[0, -800])],
    )
    found = audits(problem, steps=8)
    assert [audit.verdict for audit in found].count("warn") == 1
    jump = next(audit for audit in found if audit.verdict == "warn")
    assert jump.reasons[0].startswith("the work of the step")
    assert "has jumped to another equilibrium" in jump.reasons[0]
    assert jump.work > 1.5 * jump.energy
    assert found[-1].verdict == "pass"
    assert len(found[-1].so_far) == 1


def test_cell_inside_out():
    """det F that is not positive is said with its place."""
    problem = block(LinearElastic(E=E, nu=NU), loads=[])
    assembler = Assembler(problem)
    worst = (-0.1, np.array([0.5, 0.25, 0.125])), (2.0, np.zeros(3))
    answers = {"extremes": lambda _: worst, "steepest": lambda _: (0.0, worst[1][1])}
    watch: Any = type("Watch", (), {**answers, "survives": False})()
    assembler.residual.assemble()
    audit = EquilibriumAuditor(problem, assembler, watch).audit(0.0, 0.0)
    assert audit.reasons == ("an element is inside out: det F = -0.1 at (0.5, 0.25, 0.125) m",)
    assert (audit.min_jacobian, audit.max_jacobian) == (-0.1, 2.0)
    assembler.destroy()


# --- where it is seen ---


def test_files(folder: Path, monkeypatch):
    """The audit is in history.csv and, the worst of all steps, in summary.json."""
    true = Reactions.loads

    def tampered(self: Reactions) -> Any:
        return true(self) * (1.01 if 0.4 < self._dofs.problem.t.value < 0.6 else 1.0)

    monkeypatch.setattr(Reactions, "loads", tampered)
    problem = block(Textbook(E=E, nu=NU))
    writers = [History().open(problem, folder), Summary().open(problem, folder)]
    for state in Statics(problem, steps=4).steps():
        for writer in writers:
            writer.write(state)
    for writer in writers:
        writer.close()
    lines = on_root(COMM, lambda: (folder / "history.csv").read_text().splitlines())
    names = lines[0].split(",")
    assert names[-6:] == [
        "balance_force",
        "balance_moment",
        "external_work",
        "min_jacobian",
        "max_jacobian",
        "verdict",
    ]
    assert [line.split(",")[-1] for line in lines[1:]] == ["pass", "pass", "warn", "pass", "pass"]
    summary = json.loads(on_root(COMM, (folder / "summary.json").read_text))["audit"]
    assert summary["verdict"] == "warn"
    assert 1e-3 < summary["balance_force"] < 1e-2
    assert len(summary["reasons"]) == 2
    assert summary["stored_energy"] is None
    assert summary["max_jacobian"]["value"] > 1 > summary["min_jacobian"]["value"]
    assert len(summary["min_jacobian"]["place"]) == 3


def test_screen():
    """The last lines of a run say that all is well, or what is not."""
    problem = block()
    *_, state = Statics(problem).steps()
    assert ("audit", "pass") in _end_rows(state, motion=False)
    bad = Audit(0.1, 0.0, 0.0, 0.0, 1.0, 1.0, verdict="warn", reasons=("x",), so_far=("x", "y"))
    rows = _end_rows(State(0, 1.0, problem.u, audit=bad), motion=False)
    assert [value for name, value in rows if name == "audit"] == ["x", "y"]
    forces = {"a": (5e4, 1e-6, 0.0), "b": (0.0, -1.7e-10, 2.6e-10)}  # b: round-off beside a
    shown = dict(_end_rows(State(1, 1.0, problem.u, reactions=forces), motion=False))
    assert shown["reaction of a"] == "(50000, 0, 0) N" and shown["reaction of b"] == "(0, 0, 0) N"
    shown = dict(_end_rows(State(1, 1.0, problem.u, reactions={"b": forces["b"]}), motion=False))
    assert shown["reaction of b"] == "(0, -1.7e-10, 2.6e-10) N"  # with nothing to compare it to
    more = {"reactions": {"b": forces["b"]}, "energies": {"strain": 1.0}, "max_displacement": 1e-3}
    balanced = State(1, 1.0, problem.u, **more)
    assert dict(_end_rows(balanced, motion=False))["reaction of b"] == "(0, 0, 0) N"
