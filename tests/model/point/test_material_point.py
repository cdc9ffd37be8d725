"""Tests of materials at a point: pointwise programs, checks, curves, growth, ellipticity, files."""

from __future__ import annotations

import csv
import json
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from helpers import laws as gate
from helpers.processes import PROGRAM
from helpers.processes import started as launched
from mpi4py import MPI

from dolfin_elastic import (
    Energy,
    LinearElastic,
    NeoHookean,
    StVenantKirchhoff,
)
from dolfin_elastic.case.material_report import (
    law_table,
    read_constants,
    read_laws,
    write,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.model.materials.user import SplitEnergy, read_energy
from dolfin_elastic.model.point.checks import check_energy, checks
from dolfin_elastic.model.point.ellipticity import acoustic_eigenvalues, directions
from dolfin_elastic.model.point.homogeneous_tests import DEFORMATION_MODES, response_curve
from dolfin_elastic.model.point.report import MaterialReport, material_report
from dolfin_elastic.model.point.tested import LawUnderTest, with_finite_moduli
from dolfin_elastic.model.point.ufl_to_numpy import LawAtPoints

# A material at a point has no ranks; commands on two are tried in processes of their own.
pytestmark = pytest.mark.usefixtures("serial_only")

E, NU = gate.E, gate.NU
MU, LMBDA = gate.MU, gate.LMBDA
I = np.eye(3)
MODE = {mode.name: mode for mode in DEFORMATION_MODES}
ALONE = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes of its own")


def verdicts(found: MaterialReport) -> dict[str, str]:
    return {finding.check: finding.verdict for finding in found.findings}


def own(energy: str, **more: Any) -> Law:
    numbers = {name: 1e6 for name in ("mu", "k") if name in re.findall(r"\w+", energy)}
    return read_energy({"energy": energy, "parameters": numbers, **more})


# --- expressions at points ---


@pytest.mark.sample(6)
@pytest.mark.parametrize("name", MATERIALS)
def test_programs_agree_with_ufl(name):
    """Energy, stress and tangent, against UFL's own evaluation at a point."""
    at = np.array([gate.random_F(seed) for seed in range(3)])
    ours, theirs = LawAtPoints(gate.make(name)), gate.point(name)
    for quantity in ("energy", "stress", "tangent"):
        if quantity == "energy" and not gate.make(name).has_energy:
            continue
        expected = np.array([getattr(theirs, quantity)(F) for F in at])
        found = getattr(ours, quantity)(at)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(expected).max())


def test_programs_know_what_ufl_can_say():
    """Functions, conditions, indices, derivatives of all of them; inputs at one place only."""
    at = I + 0.1 * np.random.default_rng(0).uniform(-1, 1, (7, 3, 3))
    i, j, k = ufl.indices(3)

    def odd(F: Any) -> Any:
        C = F.T * F
        chosen = ufl.conditional(
            ufl.And(ufl.gt(C[0, 0], 0.9), ufl.Not(ufl.lt(C[1, 1], 0.5))), C[0, 1], 7.0
        )
        return (
            ufl.exp(C[i, i] / 9) * F[j, k] * F[j, k]
            + ufl.atan2(F[0, 1], F[0, 0])
            + ufl.max_value(F[2, 2], 1.0) * abs(F[1, 0])
            + ufl.sign(F[0, 2]) * ufl.erf(F[0, 0])
            + chosen
            + ufl.tanh(ufl.inner(ufl.dev(C), ufl.skew(F)))
        )

    point = LawAtPoints(Energy(odd))
    energy = point.energy(at)
    np.testing.assert_allclose(point.energy(at[3:4]), energy[3:4], rtol=1e-15)
    h = 1e-6
    for a, b in np.ndindex(3, 3):
        D = np.zeros((3, 3))
        D[a, b] = h
        slope = (point.energy(at + D) - point.energy(at - D)) / (2 * h)
        np.testing.assert_allclose(point.stress(at)[:, a, b], slope, rtol=1e-7, atol=1e-7)


# --- checks ---


@pytest.mark.sample(2)
@pytest.mark.parametrize("name", MATERIALS)
def test_every_law_passes(name):
    begin = time.monotonic()
    assert material_report(gate.make(name)).failed == ()
    # Two seconds on a shared machine is slow; minutes would be a fault.
    assert time.monotonic() - begin < 30


@pytest.mark.sample(4)
@pytest.mark.parametrize(
    ("law", "check", "verdict"),
    [
        (own("mu/2*(I1 - 3)"), "no stress at rest", "fail"),
        (own("mu/2*(I1bar - 2) + k*(J-1)^2"), "no energy at rest", "fail"),
        (own("mu/2*(I1bar - 3)"), "stable at rest", "fail"),
        (own("mu*(J - 1)^2"), "stable at rest", "fail"),
        (own("mu*(F11 - 1)^2"), "frame indifference", "fail"),
        (own("mu*(F12 - F21)^2 + k*(J-1)^2"), "symmetric Cauchy stress", "fail"),
        (own("mu*sqrt(I1 - 3)"), "finite values", "fail"),
        (own("mu/2*(C11 - 1)^2 + k/2*(I1 - 3 - 2*ln(J))"), "isotropy", "note"),
        (own("mu/2*(I4 - 1)^2 + k/2*(I1 - 3 - 2*ln(J))", fibre=[1, 2, 3]), "isotropy", "pass"),
    ],
)
def test_what_is_wrong_is_found(law, check, verdict):
    assert verdicts(material_report(law))[check] == verdict


def test_a_wrong_derivative_is_found():
    class Wrong(NeoHookean):
        def stress(self, F: Any) -> Any:
            return super().stress(F) * (1 + 1e-4 * ufl.tr(F))

    found = {f.check: f.verdict for f in checks(LawUnderTest(Wrong(E=E, nu=NU)))}
    assert found["stress is dpsi/dF"] == "fail"
    assert found["tangent is dP/dF"] == "pass"
    assert found["small strains"] == "fail"


def test_small_strains_of_a_neo_hookean_typed_by_hand():
    law = read_energy(
        {
            "energy": "mu/2*(I1 - 3) - mu*ln(J) + lmbda/2*ln(J)^2",
            "parameters": {"mu": MU, "lmbda": LMBDA},
        }
    )
    values = next(f.values for f in material_report(law).findings if f.check == "small strains")
    assert values["E"] == pytest.approx(E, rel=1e-12)
    assert values["nu"] == pytest.approx(NU, rel=1e-12)


@pytest.mark.long
def test_infinite_moduli_are_tried_as_large_ones():
    law = SplitEnergy(lambda I1bar, mu: mu / 2 * (I1bar - 3), mu=1e6, K=1e6, volumetric="log")
    endless = law.model_copy(update={"K": float("inf")})
    assert np.isfinite(with_finite_moduli(endless).constants()["K"])
    found = material_report(endless)
    assert found.failed == ()
    assert any("infinite modulus" in note for note in found.notes)


def test_python_functions_are_tried_once():
    calls = []

    def energy(I1: Any, J: Any) -> Any:
        calls.append(1)
        return I1 - 3 - 2 * ufl.ln(J)

    law = Energy(energy)
    check_energy(law)
    first = len(calls)
    check_energy(law)
    assert len(calls) == first > 0


# --- curves ---


@pytest.mark.parametrize(
    ("kind", "mode", "stretch", "lateral", "P11"),
    [
        # The numbers of test_laws.py, from an independent code.
        (StVenantKirchhoff, "uniaxial", 0.8, 1.052615789355, -1.440000000000e5),
        (StVenantKirchhoff, "uniaxial", 1.5, 0.790569415042, 9.375000000000e5),
        (NeoHookean, "uniaxial", 0.8, 1.067338369279, -2.400053819880e5),
        (NeoHookean, "uniaxial", 1.5, 0.880174591807, 3.782801763943e5),
        (NeoHookean, "equibiaxial", 1.5, 0.652018518357, 4.679158594152e5),
        (StVenantKirchhoff, "planar", 1.5, 0.681385143869, 1.030219780220e6),
        (NeoHookean, "planar", 0.8, 1.094876055994, -2.686315278790e5),
    ],
)
def test_curves_against_closed_forms(kind, mode, stretch, lateral, P11):
    values = np.sort([1.0, stretch])
    found = response_curve(LawAtPoints(kind(E=E, nu=NU)), MODE[mode], values)
    at = int(np.argmin(np.abs(found.values - stretch)))
    assert found.F[at, 2, 2] == pytest.approx(lateral, rel=1e-11)
    assert found.P[at, 0, 0] == pytest.approx(P11, rel=1e-10)
    assert np.abs(found.P[at, 2, 2]) < 1e-9 * E


def test_shear_and_volume():
    point = LawAtPoints(NeoHookean(E=E, nu=NU))
    shear = response_curve(point, MODE["simple-shear"], np.array([0.0, 1.0]))
    assert shear.cauchy[-1, 0, 1] == pytest.approx(MU, rel=1e-12)
    volume = response_curve(point, MODE["volumetric"], np.array([1.0, 2.0]))
    pressure = (MU * (2 ** (2 / 3) - 1) + LMBDA * np.log(2)) / 2
    np.testing.assert_allclose(volume.cauchy[-1], pressure * I, rtol=1e-12, atol=1e-6)


def test_a_curve_ends_where_there_is_no_state():
    """St. Venant-Kirchhoff: a sheet stretched both ways gets thin as 1 - 2nu/(1-nu)(s^2-1)/..."""
    found = material_report(StVenantKirchhoff(E=E, nu=NU))
    last = found.curves["equibiaxial"].values[-1]
    limit = np.sqrt(1 + (1 - NU) / (2 * NU))  # where the thickness vanishes
    assert 0.94 * limit < last < limit
    assert any(note.startswith("equibiaxial ends at stretch 1.4") for note in found.notes)


def test_fibres_bend_a_sheet_out_of_its_axes():
    """Stretched at an angle to its fibre, a strip with free sides shears."""
    law = SplitEnergy(
        lambda I1bar, I4, mu: mu / 2 * (I1bar - 3) + mu * (I4 - 1) ** 2,
        mu=1e6,
        K=1e7,
        volumetric="log",
        fibre=[1, 1, 0],
    )
    found = response_curve(LawAtPoints(law), MODE["uniaxial"], np.linspace(1, 1.5, 6))
    assert not found.ends
    assert abs(found.F[-1, 0, 1]) > 0.05
    others = np.abs(found.P[-1]) - np.diag([np.inf, 0, 0])
    assert others[np.isfinite(others)].max() < 1e-8 * 1e7


# --- ranges ---


def test_acoustic_tensor_of_hooke():
    """Wave moduli of an isotropic solid: mu twice and lmbda + 2 mu, in every direction."""
    least = acoustic_eigenvalues(LawAtPoints(LinearElastic(E=E, nu=NU)), I[None])
    assert least[0] == pytest.approx(MU, rel=1e-12)
    N = directions()
    np.testing.assert_allclose(np.linalg.norm(N, axis=1), 1, rtol=1e-14)


@pytest.mark.long
def test_st_venant_kirchhoff_loses_ellipticity():
    """In a bar that is pressed at fixed sides the wave modulus along it is 0 at s^2 = 1/3."""
    point = LawAtPoints(StVenantKirchhoff(E=E, nu=NU))
    s = np.array([np.sqrt(1 / 3) * 1.01, np.sqrt(1 / 3) * 0.99])
    A = point.tangent(s[:, None, None] * np.diag([1.0, 0, 0]) + np.diag([0, 1.0, 1.0]))
    assert A[0, 0, 0, 0, 0] > 0 > A[1, 0, 0, 0, 0]
    found = material_report(StVenantKirchhoff(E=E, nu=NU))
    assert verdicts(found)["elliptic, uniaxial"] == "note"
    assert verdicts(material_report(NeoHookean(E=E, nu=NU)))["elliptic, uniaxial"] == "pass"


@pytest.mark.parametrize(
    ("law", "text"),
    [
        (NeoHookean(E=E, nu=NU), "grows without bound"),
        (StVenantKirchhoff(E=E, nu=NU), "does not resist inversion"),
        (own("mu*((I1bar - 3) + 1/J^2 + J^2 - 2)"), "grows without bound"),
        (own("mu*(I1bar - 3) + k*(J-1)^2"), "does not resist inversion"),
    ],
)
def test_growth_as_the_volume_vanishes(law, text):
    finding = next(f for f in material_report(law).findings if f.check == "energy as J -> 0")
    assert finding.verdict == "note"
    assert text in finding.text


@pytest.mark.long
@pytest.mark.parametrize(
    ("law", "text"),
    [
        *(
            (own("mu*(I1bar - 3)", volumetric=volumetric, K=1e8), "grows")
            for volumetric in ("log", "quadratic", "simo-taylor")
        ),
        (own("mu*(I1bar - 3) + k*(1 - 1/J)^2"), "does not resist a change of volume"),
    ],
    ids=["log", "quadratic", "simo-taylor", "bounded"],
)
def test_growth_as_the_volume_grows(law, text):
    finding = next(f for f in material_report(law).findings if f.check == "energy as J -> inf")
    assert text in finding.text


# --- lists and files ---


def test_the_list_tells_every_law():
    rows = {row["law"]: row for row in law_table()}
    assert list(rows) == list(MATERIALS)
    for name, row in rows.items():
        assert row["what"]
        assert "=" in row["formula"], name
        assert row["source"], name
        assert all(row["parameters"].values()), name
    assert rows["neo-hookean"]["formula"].startswith("psi = mu/2 (tr F^T F - 3)")


def test_words_of_the_command_line():
    assert read_constants(["--E", "10 MPa", "--nu=0.3"]) == {"E": "10 MPa", "nu": "0.3"}
    assert read_constants(["--a=[1, 2]"]) == {"a": [1, 2]}
    for words in (["E", "3"], ["--E"], ["--a=[1,"]):
        with pytest.raises(InputError):
            read_constants(words)
    (law,) = read_laws("neo-hookean", {"E": "10 MPa", "nu": "0.3"}).values()
    assert law == NeoHookean(E=1e7, nu=0.3)
    with pytest.raises(InputError, match="'neo-hooke' is neither a case file, nor .*'neo-hook"):
        read_laws("neo-hooke", {})
    ((name, law),) = read_laws("s235", {"E": "200 GPa"}).items()
    assert (name, law.E, law.nu) == ("steel S235", 200e9, 0.3)
    with pytest.raises(InputError, match='nor a material of the library; known: "steel S235", '):
        read_laws("steel", {})


def test_files(comm, folder):
    if comm.rank == 0:
        found = material_report(NeoHookean(E=E, nu=NU))
        paths = write("a gel", found, folder / "bench")
        assert {path.name for path in paths} == {
            *(f"a_gel_{mode}.csv" for mode in MODE),
            "a_gel.png",
        }
        rows = list(csv.DictReader((folder / "bench/a_gel_uniaxial.csv").open()))
        assert float(rows[0]["stretch"]) == pytest.approx(0.5)
        assert float(rows[-1]["P11"]) == pytest.approx(found.curves["uniaxial"].P[-1, 0, 0])
        picture = (folder / "bench/a_gel.png").read_bytes()
        assert picture.startswith(b"\x89PNG")
        assert len(picture) > 20_000


# --- the command line ---

FILE = """\
[materials.gel]
energy = "mu/2*(I1 - 3) - mu*ln(J) + lmbda/2*ln(J)^2"
parameters = {mu = "0.4 MPa", lmbda = "2 MPa"}
[materials."a b"]
energy = "mu/2*(I1 - 3)"
parameters = {mu = "0.4 MPa"}
"""


def started(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    (folder / "m.toml").write_text(FILE)
    command = [sys.executable, "-m", "dolfin_elastic", *words]
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )


@ALONE
@pytest.mark.sample(2)
@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("material", "m.toml", "--material", "gel"), 0, "elliptic, simple-shear"),
        (("material", "m.toml"), 2, "error: m.toml: a b: no stress at rest: largest of P(I)"),
        (("material", "m.toml", "--material", "gell"), 2, "did you mean 'gel'?"),
        (("material", "m.toml", "--E", "1"), 2, "--E is a constant of a law"),
        (("material", "neo-hookean", "--E", "10 MPa", "--nu", "0.3"), 0, "E = 10 MPa, nu = 0.3"),
        (("material", "neo-hookean", "--E", "10 m", "--nu", "0.3"), 2, "neo-hookean: E: '10 m'"),
        (("material", "neo-hookean", "--E", "1", "--nuu", "0.3"), 2, "unknown key 'nuu'"),
        (("material", "neo-hook"), 2, "did you mean 'neo-hookean'?"),
        (("material", "none.toml"), 2, "there is no such case file"),
        (("material", "neo-hookean", "--E=1", "--nu=0", "--stretch", "1"), 2, "no largest stretch"),
        (("materials",), 0, "Lindley"),
    ],
)
def test_commands(words, code, said, tmp_path):
    done = started(tmp_path, *words)
    assert done.returncode == code, done.stderr
    assert said in done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["m.toml"]


@pytest.mark.long
@ALONE
def test_on_two_ranks_it_is_said_once(tmp_path):
    (tmp_path / "m.toml").write_text(FILE)
    process = launched([*PROGRAM, "material", "m.toml"], tmp_path, 2)
    out, errors = process.communicate(timeout=120)
    assert process.returncode == 2
    assert out.count("elliptic, uniaxial") == 2  # two materials
    assert errors.count("error: m.toml: a b: no stress at rest") == 1
    process = launched([*PROGRAM, "materials"], tmp_path, 2)
    out, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    assert out.count("steel S235: E, nu") == 1


@pytest.mark.long
@ALONE
def test_commands_in_json(tmp_path):
    out = json.loads(started(tmp_path, "material", "m.toml", "--json", "-o", "b").stdout)
    assert out["gel"]["passed"] is True
    assert out["a b"]["passed"] is False
    assert len(out["gel"]["curves"]["uniaxial"]["P"]) == 61
    assert (tmp_path / "b/a_b.png").exists()
    out = json.loads(started(tmp_path, "materials", "--json").stdout)
    assert {row["law"] for row in out["laws"]} == set(MATERIALS)
    assert out["library"]["PLA"]["E"] == "3.6 GPa"
    assert started(tmp_path, "material").stdout.count("steel S355: E, nu") == 1
    shown = started(tmp_path, "material", "s355").stdout
    assert "355 MPa" in shown
    assert "elliptic, uniaxial" in shown


def test_constants_that_vary_in_space_are_refused():
    with pytest.raises(InputError, match="E: this constant varies in space"):
        material_report(NeoHookean(E="1e6*(1 + x)", nu=0.3))
