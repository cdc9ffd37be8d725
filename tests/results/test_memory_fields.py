"""Fields of what materials remember: written, probed, drawn and reduced by their names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.damaged import Damaged
from helpers.runs import history
from mpi4py import MPI

from dolfin_elastic import (
    Case,
    CylindricalAxes,
    LinearElastic,
    Problem,
    Selector,
    Statics,
    Support,
    box_body,
    name_parts,
    run,
)
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.model.materials.laws.j2 import J2
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.probes import Probe
from dolfin_elastic.results.quantity import Quantity
from dolfin_elastic.results.scene.pictures import picture

E, YIELD, SLOPE = 200.0, 0.2, 10.0
STRAIN = 0.01
FREE = "free"
PLASTIC = (E * STRAIN - YIELD) / (E + SLOPE)
"""Of sigma = yield + slope a = E (strain - a)."""
FIELDS = ["plastic_strain", "plastic_strain_tensor"]
METAL = {"E": E, "nu": 0.3, "yield": YIELD, "hardening": SLOPE}


def pulled() -> Problem:
    """Two cubes side by side, strained alike along x alone: one yields, the other cannot."""
    body = box_body(size=(1, 2, 1), cells=(1, 2, 1))
    regions = {
        "metal": Selector(box=[[0, 0, 0], [1, 1, 1]]),
        "ceramic": Selector(box=[[0, 1, 0], [1, 2, 1]]),
    }
    laws = {"metal": J2(**METAL), "ceramic": LinearElastic(E=E, nu=0.3)}
    supports = [
        Support(on="left", displacement=[0, 0, 0]),
        Support(on="right", displacement=[STRAIN, 0, 0]),
        Support(on=["front", "back", "top", "bottom"], displacement=[FREE, 0, 0]),
    ]
    return Problem(name_parts(body, regions=regions), laws, supports=supports, degree=1)


def confined() -> float:
    """Plastic strain where nothing can move across: 3 mu (strain - 3/2 a) = yield + slope a."""
    mu = E / 2 / 1.3
    return (2 * mu * STRAIN - YIELD) / (3 * mu + SLOPE)


@pytest.mark.long
def test_each_state_has_what_was_committed() -> None:
    """0 at the start, and in the other material."""
    problem = pulled()
    evaluate, found = Evaluator(problem, FIELDS), []
    metal = next(part.cells for part in problem.regions if part.name == "metal")
    others = next(part.cells for part in problem.regions if part.name == "ceramic")
    for state in Statics(problem, steps=4).steps():
        rows = evaluate(state)
        assert not np.any(rows["plastic_strain"][others])
        assert not np.any(rows["plastic_strain_tensor"][others])
        a = rows["plastic_strain"][metal]
        found.append(largest(MPI.COMM_WORLD, float(a.max(initial=0.0))))
        # the plastic strain is a for the direction of the stress, and keeps the volume
        tensor = np.diag([1, -0.5, -0.5]).reshape(9)
        assert rows["plastic_strain_tensor"][metal] == pytest.approx(a * tensor, abs=1e-12)
        assert a == pytest.approx(np.full_like(a, found[-1]), rel=1e-9, abs=1e-12)
    assert found[0] == 0.0
    assert found[-1] == pytest.approx(confined(), rel=1e-9)


def test_a_component_and_a_reduction() -> None:
    problem = pulled()
    biggest = Quantity("plastic_strain").on(problem)
    along = Quantity("plastic_strain_tensor_xx", reduction="mean").on(problem)
    *_, last = Statics(problem, steps=2).steps()
    assert biggest.of(last).value == pytest.approx(confined(), rel=1e-9)
    assert along.of(last).value == pytest.approx(confined() / 2, rel=1e-9)


@pytest.mark.long
def test_any_variable_is_a_field(folder: Path) -> None:
    """Of a law of one's own, by the names of its variables; the start is a state, too."""
    supports = [
        Support(on="left", displacement=[0, 0, 0]),
        Support(on="right", displacement=[STRAIN, 0, 0]),
        Support(on=["front", "back", "top", "bottom"], displacement=[FREE, 0, 0]),
    ]
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2))
    law = Damaged(E=E, nu=0, limit=1.0)
    problem = Problem(body, law, supports=supports, axes={"bore": CylindricalAxes(axis="x")})
    names = ["kappa", "count", "strain_before", "strain_before_zz_in_bore"]
    evaluate = Evaluator(problem, names)
    probe = Probe(problem, {"p": (0.3, 0.4, 0.5)}, fields=["kappa", "strain_before"])
    for state in Statics(problem, steps=3).steps():
        rows, strain = evaluate(state), STRAIN * state.t
        kappa = E * strain**2 / 2
        assert rows["count"] == pytest.approx(np.full_like(rows["count"], state.step), rel=1e-12)
        assert rows["kappa"] == pytest.approx(np.full_like(rows["kappa"], kappa), abs=1e-12)
        tensor = np.tile(np.diag([strain, 0, 0]).reshape(9), (len(rows["kappa"]), 1))
        assert rows["strain_before"] == pytest.approx(tensor, abs=1e-12)
        assert rows["strain_before_zz_in_bore"] == pytest.approx(tensor[:, :1], abs=1e-12)
        values = probe(state)
        assert values["p_kappa"] == pytest.approx([kappa], abs=1e-12)
        assert values["p_strain_before"][0] == pytest.approx(strain, abs=1e-12)
        picture(problem, state, folder / "kappa.png", field="kappa")
    assert (folder / "kappa.png").stat().st_size > 1000


def case(**output: Any) -> Case:
    return Case(
        mesh={"box": {"size": [1, 1, 1], "cells": [2, 2, 2]}, "degree": 2},
        materials={"metal": {"law": "j2", **METAL}},
        support=[
            {"on": "left", "displacement": [0, FREE, FREE]},
            {"on": "front", "displacement": [FREE, 0, FREE]},
            {"on": "bottom", "displacement": [FREE, FREE, 0]},
            {"on": "right", "displacement": [STRAIN, FREE, FREE]},
        ],
        statics={"steps": 3},
        output=output,
    )


@pytest.mark.long
def test_a_run_writes_and_probes_them(folder: Path) -> None:
    """A bar in simple tension: a of the closed form."""
    probes = {
        "p": {"at": [0.4, 0.4, 0.4], "fields": FIELDS},
        "q": {"on": "right", "fields": ["plastic_strain"], "values": ["mean"]},
    }
    given = case(fields=["displacement", *FIELDS], probes=probes)
    check(given, given.read_body())
    list(run(given, output=folder))
    last = history(folder)[-1]
    columns = [n for n in last if "plastic_strain" in n and not n.startswith("max_")]
    assert len(columns) == 11
    for name in columns:
        wanted = -PLASTIC / 2 if name.endswith(("yy", "zz")) else PLASTIC
        wanted = 0.0 if name.endswith(("xy", "xz", "yx", "yz", "zx", "zy")) else wanted
        assert last[name] == pytest.approx(wanted, rel=1e-7, abs=1e-12)


def test_a_case_without_metals_is_told() -> None:
    given = case(fields=["plastic_strain"])
    elastic = Case(
        mesh={"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}},
        materials={"soft": {"law": "linear-elastic", "E": 1, "nu": 0}},
        support=[{"on": "left", "displacement": [0, 0, 0]}],
        output={"fields": ["plastic_strain_tensor"]},
    )
    with pytest.raises(InputError, match="no material yields") as error:
        check(elastic, elastic.read_body())
    assert error.value.where == "output.fields[0]"
    check(given, given.read_body())
