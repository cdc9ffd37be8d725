"""Criteria of strength against their closed forms, and what a table of strengths may be."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering

from dolfin_elastic import LinearElastic, Orthotropic
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.strength import Strength

X, Y, S = (30.0, 45.0), (42.0, 60.0), 25.0
AXIS = np.array([1.0, 0.0, 0.0])
PLY: dict[str, Any] = {
    "along": {"tension": X[0], "compression": X[1]},
    "across": {"tension": Y[0], "compression": Y[1]},
    "shear": S,
    "axis": "x",
}
EVERY = [
    Strength(**PLY),
    Strength(**PLY, criterion="hoffman"),
    Strength(**PLY, criterion="largest-stress"),
    Strength(tension=30.0, compression=70.0, shear=21.0),
    Strength(criterion="hoffman", tension=30.0, compression=70.0),
    Strength(criterion="largest-strain", tension=30.0, compression=70.0, shear=60.0),
]


def pulled(degrees: float, stress: float = 1.0) -> FloatArray:
    """Stress of a bar that is pulled at an angle to the axis of its material, shape (1, 3, 3)."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return stress * np.outer([c, s, 0], [c, s, 0])[None]


def random_stresses(count: int) -> FloatArray:
    a = np.random.default_rng(7).normal(size=(count, 3, 3)) * 20
    return np.asarray(a + np.swapaxes(a, 1, 2))


def axis_of(strength: Strength) -> FloatArray | None:
    return AXIS if strength.directed else None


@pytest.mark.parametrize("degrees", [0, 10, 25, 45, 60, 80, 90])
@pytest.mark.parametrize("sign", [1, -1])
def test_bar_off_its_axis(degrees: float, sign: int) -> None:
    """Strength of a ply against the angle: Tsai-Hill in R. M. Jones, Mechanics of Composite
    Materials (1999), (2.129), Hoffman's two roots in plane stress.  To round-off.
    """
    c2, s2 = np.cos(np.radians(degrees)) ** 2, np.sin(np.radians(degrees)) ** 2
    x, y = (p[0 if sign > 0 else 1] for p in (X, Y))
    hill = (c2**2 / x**2 + (1 / S**2 - 1 / x**2) * c2 * s2 + s2**2 / y**2) ** -0.5
    used = Strength(**PLY).used_at(pulled(degrees, sign), AXIS)[0]
    assert 1 / used == pytest.approx(hill, rel=1e-12)
    xx, yy = X[0] * X[1], Y[0] * Y[1]
    A = c2**2 / xx - c2 * s2 / xx + s2**2 / yy + c2 * s2 / S**2
    B = (1 / X[0] - 1 / X[1]) * c2 + (1 / Y[0] - 1 / Y[1]) * s2
    root = max(r * sign for r in np.roots([A, B, -1]))  # the one of this sign
    used = Strength(**PLY, criterion="hoffman").used_at(pulled(degrees, sign), AXIS)[0]
    assert 1 / used == pytest.approx(root, rel=1e-12)
    each = max(c2 / x, s2 / y, np.sqrt(c2 * s2) / S)
    used = Strength(**PLY, criterion="largest-stress").used_at(pulled(degrees, sign), AXIS)[0]
    assert used == pytest.approx(each, rel=1e-12)


def test_equal_strengths_are_those_of_von_mises() -> None:
    """Hill's criterion and Hoffman's with one strength, and sqrt(1/3) of it in shear."""
    one = {"tension": 40.0, "compression": 40.0}
    table = {"along": one, "across": one, "shear": 40 / np.sqrt(3), "axis": "x"}
    stresses = random_stresses(50)
    deviator = stresses - np.trace(stresses, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    mises = np.sqrt(1.5) * np.linalg.norm(deviator, axis=(1, 2)) / 40
    for strength in (
        Strength(**table),
        Strength(**table, criterion="hoffman"),
        Strength(**one, criterion="hoffman"),
    ):
        assert strength.used_at(stresses, axis_of(strength)) == pytest.approx(mises, rel=1e-12)


def test_isotropic_hoffman_is_a_paraboloid() -> None:
    """Q^2 + (C - T) 3 p = T C at failure, Q von Mises: R. Raghava et al., J. Mater. Sci. 8 (1973)
    225.  Where the root does not exist, under all-round pressure, nothing fails.
    """
    T, C = 30.0, 70.0
    strength = Strength(criterion="hoffman", tension=T, compression=C)
    stresses = random_stresses(50)
    used = strength.used_at(stresses, None)
    failing = stresses / used[:, None, None]
    I1 = np.trace(failing, axis1=1, axis2=2)
    deviator = failing - I1[:, None, None] / 3 * np.eye(3)
    assert 1.5 * (deviator**2).sum(axis=(1, 2)) + (C - T) * I1 == pytest.approx(T * C, rel=1e-10)
    assert strength.used_at(-5 * np.eye(3)[None], None) == 0


@pytest.mark.parametrize("strength", EVERY, ids=lambda s: f"{s.kind}-{s.directed}")
def test_scaled_turned_and_in_ufl(strength: Strength) -> None:
    """The load times the factor uses the strength up; turned with its axis a stress is the same;
    UFL gives the same number.  To round-off, of UFL's eigenvalues to a few more digits.
    """
    stresses = random_stresses(6)
    axis = axis_of(strength)
    used = strength.used_at(stresses, axis)
    assert (used > 0).all()
    assert strength.used_at(stresses / used[:, None, None], axis) == pytest.approx(1, rel=1e-12)
    Q = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turned = Q @ stresses @ Q.T
    assert strength.used_at(turned, None if axis is None else Q @ axis) == pytest.approx(used)
    for tensor, number in zip(stresses, used, strict=True):
        direction = None if axis is None else ufl.as_vector(axis.tolist())
        expression = strength.used(ufl.as_matrix(tensor.tolist()), direction)
        assert apply_algebra_lowering(expression)(()) == pytest.approx(number, rel=1e-9)
    unknown = strength.used_at(np.full((1, 3, 3), np.nan), axis)
    assert np.isnan(unknown).all()


def test_strain_of_a_bar() -> None:
    """Pulled, its strain along counts; pressed, with a large Poisson's ratio that across."""
    strength = Strength(criterion="largest-strain", tension="0.73 %", compression=0.0104)
    e = 1e-3 * np.diag([1, -0.3, -0.3])[None]
    assert strength.used_at(e, None) == pytest.approx(1e-3 / 0.0073, rel=1e-12)
    assert strength.used_at(-e, None) == pytest.approx(1e-3 / 0.0104, rel=1e-12)
    wide = 1e-3 * np.diag([-1, 0.9, 0.9])[None]
    assert strength.used_at(wide, None) == pytest.approx(0.9e-3 / 0.0073, rel=1e-12)
    sheared = Strength(criterion="largest-strain", shear=0.02)  # an angle: twice the component
    assert sheared.used_at(np.array([[[0, 4e-3, 0], [4e-3, 0, 0], [0, 0, 0]]]), None) == (
        pytest.approx(8e-3 / 0.02, rel=1e-12)
    )


WRONG: list[tuple[Any, str]] = [
    ({"tension": "3 kg"}, r"allowable\.tension: '3 kg' has the wrong unit"),
    ({"tension": -3}, r"allowable\.tension: -3\.?0? is wrong; expected a number above 0"),
    ({"tensoin": 3}, r"unknown key 'tensoin'; did you mean 'tension'"),
    ({}, r"allowable: no strength is given; tension, compression or shear"),
    ({"criterion": "tsai-hill", "tension": 3}, r"allowable\.criterion: Tsai-Hill without a dir"),
    ({"criterion": "hoffman", "tension": 3}, r"Hoffman needs compression; all of tension, comp"),
    (
        {"criterion": "hoffman", "tension": 3, "compression": 4, "shear": 2},
        r"allowable\.shear: without a direction the strength in shear follows",
    ),
    ({"tension": 3, "axis": "z"}, r"allowable\.axis: an axis, but the same strengths along and"),
    ({**PLY, "tension": 3}, r"allowable\.tension: strengths of all directions beside those"),
    ({**PLY, "shear": None}, r"Tsai-Hill needs shear|allowable\.shear"),
    ({**PLY, "axis": ["x", 0, 1]}, r"allowable\.axis: an axis that varies in space"),
    ({**PLY, "axis": None}, r"allowable\.axis: strengths along and across a direction, but the"),
    (
        {**PLY, "along": {"tension": 20, "compression": 20}},
        r"allowable\.along: Tsai-Hill has no limit for some stresses across the axis",
    ),
    (
        {"criterion": "largest-strain", "tension": "3 MPa"},
        r"allowable\.tension: '3 MPa' has the wrong unit; expected a pure number",
    ),
]


@pytest.mark.parametrize(("table", "message"), WRONG)
def test_what_cannot_be(table: dict[str, Any], message: str) -> None:
    given = {key: value for key, value in table.items() if value is not None}
    with pytest.raises(InputError, match=message):
        LinearElastic(E=1e3, nu=0.3, allowable=given)


def test_as_a_case_file_has_it() -> None:
    """Stresses in pascals, the direction of the law where none is given, a field as before."""
    ply = {**PLY, "along": {"tension": "30 MPa", "compression": "45 MPa"}, "shear": "25 MPa"}
    ply["across"] = {"tension": "42 MPa", "compression": "60 MPa"}
    law = LinearElastic(E="3 GPa", nu=0.3, allowable=ply)
    assert isinstance(law.allowable, Strength)
    assert law.allowable.stresses()["along.tension"] == 30e6
    assert "allowable" not in law.constants()
    again = LinearElastic(**law.model_dump(include={"E", "nu", "allowable"}, exclude_none=True))
    assert again.allowable == law.allowable
    del ply["axis"]
    wood = Orthotropic(**{**Orthotropic.example, "allowable": ply})
    assert isinstance(wood.allowable, Strength)
    field = LinearElastic(E=1.0, nu=0.3, allowable={"field": "s", "unit": "MPa"})
    assert "allowable" in field.spatial_constants()
