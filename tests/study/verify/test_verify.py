"""The suite of `verify`: its results, what it says of wrong ones, and ranks compared."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from mpi4py import MPI

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.study.verify.compare import compare
from dolfin_elastic.study.verify.suite import SUITE, Verification, outcome

LONG = [pytest.param(one, marks=pytest.mark.long) if one.full else one for one in SUITE]
LAME = next(one for one in SUITE if one.name == "lame")


@pytest.mark.long
@pytest.mark.sample(2)
@pytest.mark.parametrize("one", LONG, ids=lambda one: one.name)
def test_result(one: Verification, comm: MPI.Comm) -> None:
    """Each is within its limit, and its limit would notice an error of 0.2 %."""
    found = outcome(one, comm)
    assert found.passed, found
    assert 0 < one.limit <= 2e-3
    assert found.ranks == comm.size


E, NU = 1e6, 0.3
LAMBDA, MU = E * NU / (1 + NU) / (1 - 2 * NU), E / 2 / (1 + NU)
SPEED, LENGTH = math.sqrt(210e9 / 7850), 0.1
OMEGA = math.pi / 2 * SPEED / LENGTH
STEP = 2 * math.pi / OMEGA / 40


def patch_energy() -> float:
    gradient = np.array([[1e-3, 2e-3, 0], [0, -5e-4, 1e-3], [5e-4, 0, 2e-3]])
    strain = (gradient + gradient.T) / 2
    return float(MU * np.sum(strain**2) + LAMBDA / 2 * np.trace(strain) ** 2)


def uniaxial(stretch: float) -> float:
    """Nominal stress of the neo-Hookean law of case files, free sideways."""
    low, high = 0.1, 2.0
    for _ in range(200):  # the stress across, mu (b - 1/b) + lambda ln(J)/b, grows with b
        across = (low + high) / 2
        if MU * (across - 1 / across) + LAMBDA * math.log(stretch * across**2) / across > 0:
            high = across
        else:
            low = across
    return MU * (stretch - 1 / stretch) + LAMBDA * math.log(stretch * across**2) / stretch


def tube_pressure(inner: float, outer: float, widened: float, mu: float) -> float:
    """Pressure that widens an incompressible neo-Hookean tube of fixed length.

    p = integral of mu (l^2 - 1/l^2)/r dr through the wall, l = r/R, r^2 - R^2 the same everywhere.
    """
    grown = widened**2 - inner**2
    x, w = np.polynomial.legendre.leggauss(40)
    outside = math.sqrt(outer**2 + grown)
    r = (widened + outside) / 2 + (outside - widened) / 2 * x
    square = r**2 / (r**2 - grown)
    return float(np.sum(w * mu * (square - 1 / square) / r) * (outside - widened) / 2)


CLOSED = {
    "patch": patch_energy(),
    "tetrahedron": 0.75 * MU,
    "lame": 50e6 * 0.02**2 * 1.3 / (210e9 * (0.03**2 - 0.02**2)) * (0.4 * 0.02 + 0.03**2 / 0.02),
    "uniaxial": uniaxial(1.5),
    "incompressible": 2 * (1.5 - 1 / 1.5**2) * (3e5 + 1e5 / 1.5),
    "tube": 0.003,
    "contact": E / 2 * (0.9 - 1 / 0.9),
    "laminate": 0.01 / (0.5 / 10 + 0.5) * (LAMBDA + 2 * MU),
    "frequency": SPEED / 4 / LENGTH,
    "oscillation": 1e-6 * math.cos(45 * 2 * math.atan(OMEGA * STEP / 2)),
    "column": math.pi**2 * 1e6 * 0.02**2 / 48,
    "iterative": uniaxial(1.5),
    "explicit": 1e-6 * math.cos(OMEGA * 45 * STEP),
}
PUBLISHED = {"cook": 23.96, "elastica": -0.30172, "cook-fine": 23.9677}


def test_references() -> None:
    """They are those of the closed forms and of the publications that the files name."""
    assert {one.name: one.reference for one in SUITE} == pytest.approx(
        CLOSED | PUBLISHED, rel=1e-12
    )
    text = {one.name: one.case for one in SUITE}
    assert f"value = {tube_pressure(0.01, 0.02, 0.013, 4e5)!r}" in text["tube"]
    for name in ("oscillation", "explicit"):
        assert f"end = {45 * STEP!r}" in text[name]
    assert f"dt = {STEP!r}" in text["oscillation"]


def test_wrong_results(comm: MPI.Comm) -> None:
    """An error beyond the limit fails, and so does a case that cannot be computed."""
    wrong = outcome(replace(LAME, reference=LAME.reference * (1 + 3e-5)), comm)
    assert not wrong.passed
    assert wrong.error == pytest.approx(3e-5 - 7.25e-6, rel=0.02)
    broken = outcome(replace(LAME, case=LAME.case.replace("nu = 0.3", "nu = 0.7")), comm)
    assert (broken.passed, broken.computed, broken.error) == (False, None, None)
    assert "materials.m.nu: 0.7 is not a possible Poisson's ratio" in broken.message
    nothing = replace(outcome(LAME, comm), computed=math.nan)
    assert not nothing.passed


@pytest.mark.usefixtures("serial_only")
def test_the_manual_has_them_all() -> None:
    """docs/verification.json is a table of this suite, on one rank and on two."""
    rows = json.loads((ROOT / "docs/verification.json").read_text())
    assert [(row["name"], row["ranks"]) for row in rows] == [
        (one.name, ranks) for ranks in (1, 2) for one in SUITE
    ]
    for row, one in zip(rows, (*SUITE, *SUITE), strict=True):
        assert row["passed"]
        assert row["reference"] == pytest.approx(one.reference, rel=1e-12)
        assert (row["limit"], row["what"], row["source"]) == (one.limit, one.what, one.source)


HEAD = (
    "step,t,newton,max_displacement,reaction_left_x,reaction_left_y,balance_force,verdict,"
    "strain_energy,reaction_roller_x,momentum_x,angular_momentum_x,torque_hub\n"
)
REST = ",6,1e-9,1e-9,1e-9,1e-9"


def written(folder: Path, *rows: str) -> Path:
    folder.mkdir()
    (folder / "history.csv").write_text(HEAD + "".join(f"{row}{REST}\n" for row in rows))
    return folder


@pytest.mark.usefixtures("serial_only")
def test_compared(tmp_path: Path) -> None:
    """Differences are relative to the largest of a vector's components, in the last row."""
    first = written(tmp_path / "1", "1,1,4,2.0,10,0,1e-12,pass", "2,2,4,2.0,5,1e-9,1e-12,pass")
    other = written(tmp_path / "2", "1,1,9,1.0,9,0,1e-9,pass", "2,2,7,2.1,5,-1e-9,3e-13,warn")
    found = {one.name: one for one in compare([first, other])}
    assert {"t", "max_displacement", "reaction_left_x", "reaction_left_y"} <= set(found)
    assert not {"step", "newton", "balance_force", "verdict"} & set(found)
    scales = {name: one.scale for name, one in found.items()}
    # Energy 6 J, largest displacement 2.1 m (2 m on the first), at most 2 s.
    assert scales["reaction_roller_x"] == pytest.approx(3)
    assert scales["momentum_x"] == pytest.approx(6)
    assert (scales["angular_momentum_x"], scales["torque_hub"]) == (12, 6)
    assert found["t"].relative == found["reaction_left_x"].relative == 0
    assert found["max_displacement"].relative == pytest.approx(0.1 / 2.1)
    assert found["reaction_left_y"].relative == pytest.approx(2e-10)
    for folder, frequency in ((first, 440.0), (other, 441.0)):
        (folder / "modes.csv").write_text(
            f"mode,kind,frequency,omega\n1,rigid,0,0\n2,elastic,{frequency},1\n"
        )
    found = {one.name: one for one in compare([first, other])}
    assert found["frequency of mode 1"].relative == 0
    assert found["frequency of mode 2"].relative == pytest.approx(1 / 441)
    (other / "modes.csv").unlink()
    with pytest.raises(InputError, match="other columns or modes"):
        compare([first, other])
