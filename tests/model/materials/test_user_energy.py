"""Energies that users write: formulas in case files, functions in Python."""

from __future__ import annotations

import ast
import math
import tomllib
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
import ufl
from conftest import ROOT
from helpers.processes import PROGRAM, started
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dolfin_elastic import (
    Energy,
    Gravity,
    NeoHookean,
    Problem,
    SplitEnergy,
    Statics,
    Support,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.core.errors import FormulaError, InputError
from dolfin_elastic.core.formula_functions import FUNCTIONS
from dolfin_elastic.model.materials.isochoric import simo_taylor
from dolfin_elastic.model.materials.law import SplitLaw
from dolfin_elastic.model.materials.user import read_energy
from dolfin_elastic.model.materials.written import names as user_names
from dolfin_elastic.model.point.checks import check_energy
from dolfin_elastic.model.point.ufl_to_numpy import LawAtPoints

NEO = "mu/2*(I1 - 3) - mu*ln(J) + lmbda/2*ln(J)^2"
GEL = {"energy": NEO, "parameters": {"mu": "0.4 MPa", "lmbda": "2 MPa"}, "density": "1100 kg/m^3"}
I = np.eye(3)
F = I + 0.25 * np.random.default_rng(3).uniform(-1, 1, (6, 3, 3))


def case_of(material: dict[str, Any], file: str = "") -> Case:
    tables = {
        "mesh": {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}, "degree": 1},
        "materials": {"gel": material},
        "support": [{"on": "left"}],
        "load": [{"kind": "traction", "on": "right", "value": [1e3, 0, 0]}],
    }
    return Case.from_dict(tables, file=file)


# --- what a formula means ---


def test_reads_units_and_gives_the_law():
    law = case_of(GEL).materials["gel"].law
    assert law.parameters == {"mu": 0.4e6, "lmbda": 2e6}
    assert law.density == 1100
    twin = NeoHookean(mu=0.4e6, lmbda=2e6)
    for quantity in ("energy", "stress", "tangent"):
        ours, theirs = (getattr(LawAtPoints(one), quantity)(F) for one in (law, twin))
        np.testing.assert_allclose(ours, theirs, rtol=1e-13, atol=1e-13 * np.abs(theirs).max())


def test_any_unit_in_si():
    table = {
        "energy": "a*(I1 - 3)*b/d^2 - 2*a*b/d^2*ln(J) + c*ln(J)^2",
        "parameters": {"a": "2 kN", "b": 3, "c": "1.5 GPa", "d": "10 mm"},
    }
    law = read_energy(table)
    assert law.parameters == pytest.approx({"a": 2e3, "b": 3.0, "c": 1.5e9, "d": 0.01})


@pytest.mark.parametrize("name", sorted(user_names.known(fibre=True, fibre2=True)))
def test_every_name_is_what_it_says(name):
    """Against numpy, at random states."""
    a, b = np.array([1, 2, 2]) / 3, np.array([0, 3, 4]) / 5
    law = Energy(eval(f"lambda {name}: {name} + 0*{name}"), fibre=[1, 2, 2], fibre2=[0, 3, 4])
    C = F.transpose(0, 2, 1) @ F
    J = np.linalg.det(F)
    tensors = {"F": F, "C": C, "E": (C - I) / 2}
    second = (np.trace(C, axis1=1, axis2=2) ** 2 - np.trace(C @ C, axis1=1, axis2=2)) / 2
    stretches = np.linalg.svd(F, compute_uv=False)

    def along(M: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.einsum("nij,i,j->n", M, x, y)

    first = np.trace(C, axis1=1, axis2=2)
    expected = {
        "J": J,
        "I1": first,
        "I2": second,
        "I3": J**2,
        "I1bar": first * J ** (-2 / 3),
        "I2bar": second * J ** (-4 / 3),
        "I4": along(C, a, a),
        "I5": along(C @ C, a, a),
        "I4bar": along(C, a, a) * J ** (-2 / 3),
        "I6": along(C, b, b),
        "I7": along(C @ C, b, b),
        "I6bar": along(C, b, b) * J ** (-2 / 3),
        "I8": along(C, a, b) * (a @ b),
        **{f"lambda{k + 1}": stretches[:, k] for k in range(3)},
    }
    if name in user_names.COMPONENTS:
        expected[name] = tensors[name[0]][:, int(name[1]) - 1, int(name[2]) - 1]
    # The stretches are regularised by 1e-13 under a root.
    rtol = 1e-9 if name.startswith("lambda") else 1e-13
    np.testing.assert_allclose(LawAtPoints(law).energy(F), expected[name], rtol=rtol, atol=1e-14)


@pytest.mark.parametrize("places", [I, np.diag([1.3, 1.3, 0.8]), np.diag([1.5, 0.8, 0.8])])
def test_stretches_are_smooth_where_they_coincide(places):
    """Hencky's energy has the stress ln(U) terms, and I1 = sum of lambda^2 the tangent 2 I x I."""
    one = {"energy": "mu/2*(lambda1^2 + lambda2^2 + lambda3^2 - 3) - mu*ln(J)"}
    two = {"energy": "mu/2*(I1 - 3) - mu*ln(J)"}
    laws = [read_energy({**table, "parameters": {"mu": 1.0}}) for table in (one, two)]
    turned = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    at = np.array([places, turned @ places, places @ turned])
    for quantity, error in (("stress", 1e-11), ("tangent", 1e-8)):
        a, b = (getattr(LawAtPoints(law), quantity)(at) for law in laws)
        np.testing.assert_allclose(a, b, rtol=0, atol=error)


# --- Python ---


def test_a_function_of_what_its_arguments_say():
    def by_invariants(I1, J, mu, k):
        return mu / 2 * (I1 - 3) - mu * ufl.ln(J) + k / 2 * ufl.ln(J) ** 2

    def by_tensor(C, mu, k=2e6):
        lnJ = ufl.ln(ufl.det(C)) / 2
        return mu / 2 * (ufl.tr(C) - 3) - mu * lnJ + k / 2 * lnJ**2

    laws = [
        Energy(by_invariants, mu="0.4 MPa", k=2e6, density=1100),
        Energy(by_tensor, mu=0.4e6),
        Energy(
            lambda F, mu, k: (
                mu / 2 * (ufl.inner(F, F) - 3)
                - mu * ufl.ln(ufl.det(F))
                + k / 2 * ufl.ln(ufl.det(F)) ** 2
            ),
            mu=0.4e6,
            k=2e6,
        ),
    ]
    assert laws[0].density == 1100
    reference = LawAtPoints(NeoHookean(mu=0.4e6, lmbda=2e6)).tangent(F)
    for law in laws:
        np.testing.assert_allclose(
            LawAtPoints(law).tangent(F), reference, rtol=1e-12, atol=1e-12 * np.abs(reference).max()
        )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Energy(lambda F, mu: mu, nu=1), "the energy has no parameter 'nu'; known: mu"),
        (lambda: Energy(lambda F, mu: mu), "'mu' has no value; give it, as in Energy(..., mu=1e6)"),
        (lambda: Energy(lambda F, mu: mu, mu="1 foo"), "parameters.mu: unknown unit 'foo'"),
        (lambda: check_energy(Energy(lambda F: F)), "returned no scalar expression"),
        (lambda: check_energy(Energy(lambda F: 3.0)), "returned no scalar expression"),
        (lambda: Energy(lambda I4, c: c * I4, c=1.0), "'I4' has no value"),
    ],
)
def test_functions_refused(make, message):
    with pytest.raises(InputError, match="") as caught:
        make()
    assert message in str(caught.value)


# --- volumetric parts ---


@pytest.mark.parametrize("volumetric", ["quadratic", "log", "simo-taylor"])
def test_volumetric_part(volumetric):
    K = 3e6
    shape = {"energy": "mu/2*(I1bar - 3)", "parameters": {"mu": 0.4e6}}
    law = read_energy({**shape, "volumetric": volumetric, "K": "3 MPa"})
    assert isinstance(law, SplitLaw)
    J = np.array([0.3, 0.85, 0.899, 0.901, 1 - 1e-9, 1.0, 1.0001, 1.0999, 1.1001, 2.0])
    at = np.cbrt(J)[:, None, None] * I
    energy = {
        "quadratic": K / 2 * (J - 1) ** 2,
        "log": K / 2 * np.log(J) ** 2,
        "simo-taylor": K / 4 * (J**2 - 1 - 2 * np.log(J)),
    }[volumetric]
    np.testing.assert_allclose(LawAtPoints(law).energy(at), energy, rtol=1e-9, atol=1e-9)
    split = SplitEnergy(
        lambda I1bar, mu: mu / 2 * (I1bar - 3), mu=0.4e6, volumetric=volumetric, K=K
    )
    np.testing.assert_allclose(LawAtPoints(split).energy(F), LawAtPoints(law).energy(F), rtol=1e-13)
    check_energy(law)
    A = LawAtPoints(law).tangent(I[None])[0]
    assert np.einsum("iijj", A) / 9 == pytest.approx(K, rel=1e-12)


def test_moduli_in_units_of_ones_own():
    """Any positive number is a bulk modulus."""
    law = SplitEnergy(lambda I1bar, mu: mu / 2 * (I1bar - 3), mu=0.1, K=0.5)
    assert law.K == 0.5
    with pytest.raises(ValueError, match="K"):
        SplitEnergy(lambda I1bar, mu: mu / 2 * (I1bar - 3), mu=0.1, K=0.0)


def test_simo_taylor_has_no_seam():
    """Series and closed form meet at |J - 1| = 0.1 with three derivatives."""
    law = Energy(lambda J: simo_taylor(J, J - 1))
    for J in (0.9, 1.1):
        inside, outside = (
            [
                getattr(LawAtPoints(law), q)(np.cbrt(J + d) * I[None]).ravel()
                for q in ("energy", "stress", "tangent")
            ]
            for d in (-1e-13, 1e-13)
        )
        for a, b in zip(inside, outside, strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-11)


# --- what is refused ---


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"energy": "mue*(I1-3) + lmbda*J"}, "materials.gel.energy: unknown name 'mue'; did you"),
        ({"energy": "mu*I1br + lmbda"}, "did you mean 'I1bar'?\n    mu*I1br + lmbda\n       ^"),
        ({"energy": "mu*(I1-3)"}, "materials.gel.parameters.lmbda: the energy does not use this"),
        ({"energy": "mu*lmbda"}, "materials.gel.energy: the energy does not depend on the deform"),
        ({"law": "neo-hookean"}, "materials.gel.energy: law and energy given together"),
        ({"energy": 3}, "materials.gel.energy: 3 is wrong; expected a text"),
        ({"energi": "J"}, "materials.gel: unknown key 'energi'; did you mean 'energy'?"),
        ({"formula": "J"}, "materials.gel: unknown key 'formula'"),
        ({"parameters": {"mu": "1 foo", "lmbda": 1}}, "materials.gel.parameters.mu: unknown unit"),
        *(
            (
                {"parameters": {"mu": formula, "lmbda": 1}},
                f"materials.gel.parameters.mu: {said}",
            )
            for formula, said in (
                ("1e3*(z", "this parenthesis is never closed"),
                ("2*3*", "a value is missing at the end"),
                ("x y", "an operator is missing"),
                ("1e3*zz(x)", "'zz' is not a function"),
            )
        ),
        (
            {"parameters": {"mu": True, "lmbda": 1}},
            "materials.gel.parameters.mu: True is not a num",
        ),
        ({"parameters": 3}, "materials.gel.parameters: 3 is wrong; expected {mu"),
        ({"parameters": {"J": 1}}, "materials.gel.parameters.J: the name 'J' is in use"),
        ({"parameters": {"exp": 1}}, "materials.gel.parameters.exp: the name 'exp' is in use"),
        ({"parameters": {"a b": 1}}, "cannot be a name"),
        ({"K": "1 MPa"}, "materials.gel.K: a bulk modulus without a volumetric part"),
        ({"volumetric": "log"}, "materials.gel.K: this key is missing"),
        ({"volumetric": "cubic", "K": 1}, "materials.gel.volumetric: "),
        ({"fibre": [1]}, "materials.gel.fibre: [1] is not a direction"),
        ({"fibre": [0, 0, 0]}, "materials.gel.fibre: a direction needs a length"),
        ({"fibre2": [1, 0, 0]}, "materials.gel.fibre2: there is no first fibre"),
        ({"energy": "mu*I4 + lmbda"}, "materials.gel.energy: unknown name 'I4'"),
        ({"energy": "mu*__import__ + lmbda"}, "unknown name '__import__'"),
        ({"energy": "mu*J.real + lmbda"}, "unexpected '.'"),
        ({"energy": "mu*lmbda*zzzz"}, "known: lmbda, mu, F11..F33, C11..C33, E11..E33, J, I1"),
    ],
)
def test_refused_with_the_place(change, message):
    with pytest.raises(InputError, match="gel.toml: materials.gel") as caught:
        case_of({**GEL, **change}, file="gel.toml")
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("energy", "reason"),
    [
        (
            "mu/2*(I1bar - 2) + k*ln(J)^2",
            "no energy at rest: psi(I) = 5e+05 J/m^3; subtract 500000",
        ),
        ("mu/2*(I1 - 3) + k*ln(J)^2", "it is the pressure -1e+06 Pa: subtract 1000000*ln(J)"),
        ("mu*(F11 - 1)^2 + k*ln(J)^2", "frame indifference: largest difference"),
        ("mu*sqrt(I1 - 3) + k*ln(J)^2", "finite values: the energy is not finite at strains"),
        ("mu*ln(2 - I1) + k*ln(J)^2", "finite values: the energy is not finite at rest"),
        ("mu/2*(I1bar - 3) + 0*k*J", "a change of volume is not resisted: add a term that grows"),
        ("-mu/2*(I1bar - 3) + k*ln(J)^2", "a small strain is not resisted: has a term or a para"),
        ("mu*(J - 1)^2 + k*J/(1 - 1)", "a part of 'mu*(J - 1)^2 + k*J/(1 - 1)' is not finite"),
    ],
)
def test_no_run_starts_with_it(comm, energy, reason):
    """On every rank, before anything is written, also without a case."""
    material = {"energy": energy, "parameters": {"mu": "1 MPa", "k": "5 MPa"}}
    case = case_of(material, file="gel.toml")
    body = case.read_body(comm)
    with pytest.raises(InputError) as caught:
        check(case, body)
    assert str(caught.value).startswith("gel.toml: materials.gel.energy: ")
    assert reason in str(caught.value)
    with pytest.raises(InputError):
        Problem(body, read_energy(material), supports=[Support(on="left")], degree=1)


def test_case_reads_back():
    case = case_of({**GEL, "volumetric": "log", "K": "1 GPa", "fibre": [0, 3, 4]})
    assert Case.from_dict(tomllib.loads(case.to_toml())) == case
    assert "law" not in case.to_dict()["materials"]["gel"]
    assert case.to_dict()["materials"]["gel"]["energy"] == NEO


@pytest.mark.sample(2)
@pytest.mark.usefixtures("serial_only")
@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("command", ["run", "check"])
def test_the_command_line_stops_at_once(command, ranks, tmp_path):
    """Exit code 2, one message, nothing written."""
    text = """\
[mesh]
box = {size = [1, 1, 1], cells = [2, 2, 2]}
degree = 1
[materials.gel]
energy = "mu/2*(I1 - 3) + k/2*ln(J)^2"
parameters = {mu = "0.4 MPa", k = "2 MPa"}
[[support]]
on = "left"
"""
    (tmp_path / "gel.toml").write_text(text)
    process = started([*PROGRAM, command, "gel.toml"], tmp_path, ranks)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 2
    said = "error: gel.toml: materials.gel.energy: no stress at rest: largest of P(I) = 400 kPa"
    assert errors.count(said) == 1
    assert "subtract 400000*ln(J)" in errors
    assert [path.name for path in tmp_path.iterdir()] == ["gel.toml"]


# --- through the whole solver ---


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
def test_same_answer_as_the_built_in_law(comm, degree):
    laws = [
        NeoHookean(mu=0.4e6, lmbda=2e6, density=1100),
        read_energy(GEL),
        Energy(
            lambda I1, J, mu, k: mu / 2 * (I1 - 3) - mu * ufl.ln(J) + k / 2 * ufl.ln(J) ** 2,
            mu=0.4e6,
            k=2e6,
            density=1100,
        ),
    ]
    found = []
    for law in laws:
        problem = Problem(
            box_body(size=[2, 1, 1], cells=[2, 1, 1], comm=comm),
            law,
            supports=[Support(on="left")],
            loads=[Gravity(), Traction(on="right", value=[2e4, 0, 1e4])],
            degree=degree,
        )
        *_, state = Statics(problem, steps=2, rtol=1e-12).steps()
        found.append([state.max_displacement, state.energies["strain"], *state.reactions["left"]])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-12, atol=1e-12 * np.abs(found[0]).max())
    np.testing.assert_allclose(found[2], found[0], rtol=1e-12, atol=1e-12 * np.abs(found[0]).max())


def test_other_numbers_compile_nothing(comm):
    """Parameters, fibres and the bulk modulus are constants of the forms."""

    def forms(mu: float, K: float, fibre: list[float]) -> Problem:
        law = read_energy(
            {
                "energy": "mu/2*(I1bar - 3) + c*(I4 - 1)^2",
                "parameters": {"mu": mu, "c": 2 * mu},
                "fibre": fibre,
                "volumetric": "log",
                "K": K,
            }
        )
        body = rectangle_body(size=(1.0, 1.0), cells=(1, 1), comm=comm)
        return Problem(body, law, supports=[Support(on="left", displacement=[0, 0])], degree=1)

    one, two = forms(1e6, 1e7, [1, 0, 0]), forms(3.0, 8.0, [1, 1, 0])
    for name in ("residual", "tangent", "strain_energy"):
        first, second = (getattr(problem.weak_form, name) for problem in (one, two))
        assert first.signature() == second.signature()


# --- any text at all ---

NAMES = ["mu", "J", "I1", "F12", "C33", "lambda2", "x", "import", "None", "__class__", "I9"]
ODD = ["**", "1e3", "1e999", "()", "lambda:", "eval(", "é", "²", "\x00", "𝒙"]
PIECES = st.sampled_from(
    [*NAMES, *FUNCTIONS, *"+-*/^(),.<>=[]{}\"'`;:@%&|~!\\ \n\t0123456789", *ODD]
)
TEXTS = st.one_of(st.lists(PIECES, max_size=25).map("".join), st.text(max_size=60))


@settings(max_examples=400, deadline=None, derandomize=True)
@given(TEXTS)
@example("__import__('os').system('echo owned')")
@example("(lambda: 1)()")
@example("mu" + "+mu" * 300)
@example("(" * 500)
@example("J^" * 200 + "J")
@example("mu*1e308*1e308*J")
@example("abs(abs(J))")
@example("J + (0*J + 9)^9^9^9^9^9")
def test_no_text_does_anything_but_arithmetic(text):
    """Read, tried as a material: an answer or one of our own messages, never anything else."""
    table = {"energy": text, "parameters": {"mu": 2.0} if "mu" in text else {}}
    try:
        law = read_energy(table)
    except FormulaError:
        return
    except InputError as error:  # a text without deformation, or without its parameter
        refused = str(error)
    else:
        refused = ""
    assert not refused or "the energy does not" in refused
    if refused:
        return
    tree = ast.parse("(" + text.strip().replace("^", "**").replace("\n", " ") + ")")
    allowed = ast.Call | ast.Name | ast.Load | ast.BinOp | ast.UnaryOp | ast.Constant | ast.Compare
    operators = ast.operator | ast.unaryop | ast.cmpop | ast.Module | ast.Expr
    assert all(isinstance(node, allowed | operators) for node in ast.walk(tree))
    with suppress(InputError):
        check_energy(law)


def _pair(text: str, value: Any) -> tuple[str, Any]:
    return text, value


LEAVES = st.one_of(
    st.sampled_from(["J", "I1", "I2", "F12", "C33", "E11", "mu"]).map(lambda n: _pair(n, n)),
    st.integers(0, 9).map(lambda n: _pair(str(n), float(n))),
    st.floats(0.01, 9, allow_nan=False).map(lambda x: _pair(repr(x), x)),
)


def _grown(parts: Any) -> Any:
    two = st.tuples(st.sampled_from("+-*/"), parts, parts).map(
        lambda t: _pair(f"({t[1][0]}) {t[0]} ({t[2][0]})", (t[0], t[1][1], t[2][1]))
    )
    power = st.tuples(parts, st.integers(0, 3)).map(
        lambda t: _pair(f"({t[0][0]})^{t[1]}", ("^", t[0][1], float(t[1])))
    )
    call = st.tuples(st.sampled_from(["exp", "ln", "sqrt", "tanh", "abs"]), parts).map(
        lambda t: _pair(f"{t[0]}({t[1][0]})", (t[0], t[1][1]))
    )
    return st.one_of(two, power, call)


def worked_out(tree: Any, at: dict[str, float]) -> float:
    """By the standard library alone."""
    if isinstance(tree, str):
        return at[tree]
    if isinstance(tree, float):
        return tree
    name, *rest = tree
    args = [worked_out(part, at) for part in rest]
    if name in "+-*/":
        a, b = args
        return {"+": a + b, "-": a - b, "*": a * b}[name] if name != "/" else a / b
    if name == "^":
        return args[0] ** args[1]
    known = {"exp": math.exp, "ln": math.log, "sqrt": math.sqrt, "tanh": math.tanh, "abs": abs}
    return known[name](args[0])


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.recursive(LEAVES, _grown, max_leaves=8))
def test_accepted_formulas_mean_what_they_say(pair):
    """The value at a point, against an evaluation that shares nothing with ours."""
    text, tree = pair
    f, C = F[0], F[0].T @ F[0]
    at = {
        "J": np.linalg.det(f),
        "I1": np.trace(C),
        "I2": (np.trace(C) ** 2 - np.trace(C @ C)) / 2,
        "F12": f[0, 1],
        "C33": C[2, 2],
        "E11": (C[0, 0] - 1) / 2,
        "mu": 0.7,
    }
    try:
        expected = worked_out(tree, {name: float(value) for name, value in at.items()})
    except (ValueError, ZeroDivisionError, OverflowError):
        return  # not a real number: our answer is nan, inf or a message
    try:
        law = read_energy({"energy": text, "parameters": {"mu": 0.7} if "mu" in text else {}})
        found = float(LawAtPoints(law).energy(F[:1])[0])
    except InputError:
        return  # no deformation in it, or an infinite constant
    size = max(abs(expected), 1.0)
    if size < 1e8:  # no cancellation of huge terms
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_own_names_are_in_the_guide():
    text = (ROOT / "docs/guide/materials.md").read_text(encoding="utf-8")
    for name in (*user_names.PLAIN, *user_names.ALONG, *user_names.ACROSS):
        assert f"`{name}`" in text, name


@pytest.mark.parametrize(
    ("energy", "blind"),
    [
        ("mu*(E11^2 + E22^2 + E33^2 + 2*E12^2 + 2*E13^2 + 2*E23^2)", True),
        ("mu*(I1 - 3)^2 + (I3 - 1)^2", True),
        ("mu/2*(lambda1^2 + lambda2^2 + lambda3^2 - 3 - ln(I3))", True),
        ("mu/2*(I1 - 3) - mu*ln(J)", False),
        ("mu*(F11 - 1)^2", False),
    ],
)
def test_formulas_that_do_not_see_inversion(energy: str, blind: bool) -> None:
    """Functions of C alone: those of J or F itself may."""
    assert read_energy({"energy": energy, "parameters": {"mu": 1.0}}).blind_to_inversion == blind
