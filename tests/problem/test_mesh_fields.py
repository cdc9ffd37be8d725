"""Fields of the mesh as values of loads and supports: those of the formula that they follow."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import Body, Case, Problem, Statics, box_body, rectangle_body
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.mesh.fields import MeshField
from dolfin_elastic.model.loads import LOADS
from dolfin_elastic.model.materials.laws.linear_elastic import LinearElastic
from dolfin_elastic.model.supports.springs import SUPPORTS

LAW = LinearElastic(E=1e6, nu=0.3, density=1000.0, expansion=1e-4)
TEXTS = {"p": "2 + x - 0.5*y", "vx": "x - y", "vy": "1 + 0.1*x", "vz": "0.3*y"}
"""Linear in the place, so that nodes and shape functions give them exactly."""


def body(dim: int) -> Body:
    """With the fields p, q = 1000 p, v of three components as ParaView has them, and of cells."""
    made = (box_body if dim == 3 else rectangle_body)(size=(1,) * dim, cells=(2,) * dim)
    x, y, _ = made.mesh.geometry.x.T
    p = (2 + x - 0.5 * y)[:, None]
    v = np.stack([x - y, 1 + 0.1 * x, 0.3 * y], axis=1)
    middle = made.mesh.geometry.x[made.mesh.geometry.dofmap].mean(axis=1)
    half = (middle[:, :1] > 0.5).astype(float)
    gap = np.where(p > 2.9, np.nan, p)
    fields = {"p": MeshField("point", p), "q": MeshField("point", 1e3 * p)}
    fields |= {"v": MeshField("point", v), "half": MeshField("cell", half)}
    return replace(made, fields={**fields, "gap": MeshField("point", gap)}, source="part.vtu")


def moved(on: Body, fields: bool, degree: int) -> np.ndarray:
    """The displacement under loads and supports of every kind that takes fields."""
    p: Any = {"field": "p"} if fields else TEXTS["p"]
    thousand: Any = {"field": "q", "unit": "mPa"} if fields else TEXTS["p"]
    v: Any = {"field": "v"} if fields else [TEXTS[f"v{c}"] for c in "xyz"[: on.dim]]
    mixed = [p, *["0.2*x"] * (on.dim - 1)]
    loads = [
        LOADS["traction"](on="right", value=v, curve="t^2"),
        LOADS["pressure"](on="top", value=thousand),
        LOADS["body-force"](value=mixed),
        LOADS["gravity"](value=v),
        LOADS["point-force"](at=[0.8] * on.dim, value=v, curve="t"),
        LOADS["line-force"](start=[0.1] * on.dim, end=[0.9, *[0.2] * (on.dim - 1)], value=v),
        LOADS["thermal"](value=p),
        LOADS["growth"](value=[p, 1.0, 1.0], curve="1e-3*t"),
    ]
    supports = [
        SUPPORTS["displacement"](on="left", displacement=v, curve="1e-3*t"),
        SUPPORTS["normal"](on="bottom", displacement=p, curve="1e-3*t"),
        SUPPORTS["spring"](on="top", normal=p, tangential=3.0, displacement=v, curve="1e-3*t"),
        SUPPORTS["spring"](on="right", stiffness=[p] * on.dim),
    ]
    problem = Problem(on, LAW, loads=loads, supports=supports, degree=degree)
    *_, state = Statics(problem).steps()
    return np.array(state.u.x.array)


@pytest.mark.long
@pytest.mark.parametrize(("dim", "degree"), [(2, 2), (3, 1)])
def test_a_linear_field_is_the_formula(dim: int, degree: int) -> None:
    """To round-off: the same values at the same points of the same integrals."""
    on = body(dim)
    found, known = moved(on, True, degree), moved(on, False, degree)
    size = on.comm.allreduce(float(np.abs(known).max(initial=0.0)), op=MPI.MAX)
    assert size > 1e-3
    np.testing.assert_allclose(found, known, rtol=0, atol=1e-11 * size)


def case(key: str = "load", **row: Any) -> Case:
    tables: dict[str, Any] = {
        "mesh": {"rectangle": {"size": [1, 1], "cells": [2, 2]}, "degree": 1},
        "materials": {"one": {"law": "linear-elastic", "E": "1 MPa", "nu": 0.3, "expansion": 1e-5}},
        "support": [{"on": "left"}],
        "load": [{"kind": "pressure", "on": "right", "value": 1.0}],
    }
    tables[key] = [*tables["support"] * (key == "support"), row]
    return Case.from_dict(tables)


@pytest.mark.long
def test_vectors_of_a_plane_body_may_have_two_components() -> None:
    """As those of DOLFINx and of scripts; ParaView's have three."""
    on = body(2)
    fields = {**on.fields, "v": MeshField("point", on.fields["v"].values[:, :2])}
    found = moved(replace(on, fields=fields), True, 1)
    np.testing.assert_allclose(found, moved(on, True, 1), rtol=0, atol=1e-14)


def test_a_case_sums_up_fields_and_writes_them_back(tmp_path: Any) -> None:
    """A field of cells is 1 in the right half; its force is that of the area."""
    from dolfin_elastic.case.check.integrals import Integrals
    from dolfin_elastic.case.check.loads import load_sums

    made = case(kind="body-force", on=None, value=[{"field": "half", "unit": "kN/m^3"}, 0])
    on = body(2)
    assert check(made, on) is not None
    problem = Problem(on, LAW, loads=made.load, supports=made.support, degree=1)
    (total,) = load_sums(made, Integrals(problem))
    assert total.force == pytest.approx((500.0, 0.0))
    assert made.load[0].model_dump()["value"] == [{"field": "half", "unit": "kN/m^3"}, 0]
    whole = case(kind="traction", on="right", value={"field": "v"})
    problem = Problem(on, LAW, loads=whole.load, supports=made.support, degree=1)
    (total,) = load_sums(whole, Integrals(problem))
    assert total.force == pytest.approx((0.5, 1.1))


def test_a_field_at_a_point_is_summed_up() -> None:
    """The force of a point and of a line: the field there, times the length."""
    from dolfin_elastic.case.check.integrals import Integrals
    from dolfin_elastic.case.check.loads import load_sums

    value, ends = {"field": "v"}, {"start": [0.0, 0.5], "end": [1.0, 0.5]}
    for row, force in (({"at": [0.75, 0.5]}, (0.25, 1.075)), (ends, (0.0, 1.05))):
        made = case(kind="point-force" if "at" in row else "line-force", value=value, **row)
        problem = Problem(body(2), LAW, loads=made.load, supports=made.support, degree=1)
        (total,) = load_sums(made, Integrals(problem))
        assert total.force == pytest.approx(force, abs=1e-14)


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ({"kind": "point-force", "at": [0.5, 0.5], "value": {"field": "p"}}, "a vector, with 2"),
        ({"kind": "gravity", "value": {"field": "pp"}}, "no field 'pp'"),
        ({"kind": "pressure", "on": "right", "value": {"field": "pp"}}, "no field 'pp'"),
        ({"kind": "pressure", "on": "right", "value": {"field": "v"}}, "has 3 components"),
        ({"kind": "traction", "on": "right", "value": {"field": "p"}}, "a vector, with 2"),
        ({"kind": "traction", "on": "right", "value": [0, {"field": "v"}]}, "a scalar, with 1"),
        ({"key": "support", "on": "top", "displacement": {"field": "p"}}, "has 1 component"),
        ({"key": "support", "kind": "spring", "on": "top", "normal": {"field": "k"}}, "field 'k'"),
        ({"key": "support", "kind": "normal", "on": "top", "displacement": {"field": "k"}}, "'k'"),
    ],
)
def test_what_does_not_fit_is_refused(row: dict[str, Any], said: str) -> None:
    """With the key, and the sizes of both."""
    with pytest.raises(InputError, match=said) as caught:
        check(case(**row), body(2))
    assert f"{row.get('key', 'load')}[" in str(caught.value)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ({"field": "p", "unit": "mm"}, "unit"),
        ({"field": "p", "column": 1}, "column"),
        ({"file": "p.vtu"}, "p.vtu: there is no such file"),
    ],
)
def test_what_is_no_field_is_refused(value: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        case(kind="pressure", on="right", value=value)


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ({"kind": "force", "on": "right", "value": {"field": "v"}}, "a total force is no field"),
        ({"kind": "force", "on": "right", "value": [{"field": "p"}, 0]}, "a total force is no"),
        ({"kind": "base-acceleration", "value": [{"field": "p"}, 0]}, "cannot stand here"),
    ],
)
def test_a_load_that_can_have_no_field_says_so(row: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        case(**row)


@pytest.mark.parametrize(
    ("kind", "keys", "said"),
    [
        ("load", {"kind": "pressure", "on": "right", "value": {"field": "gap"}}, "finite"),
        ("support", {"on": "right", "displacement": [{"field": "gap"}, 0]}, "finite"),
        ("support", {"on": "top", "displacement": [{"field": "half"}, 0]}, "values in elements"),
        ("support", {"on": "top", "displacement": [{"field": "none"}, 0]}, "no field 'none'"),
        ("load", {"kind": "thermal", "value": {"field": "v"}}, "has 3 components"),
    ],
)
def test_a_problem_refuses_what_has_no_values(kind: str, keys: dict[str, Any], said: str) -> None:
    """On all ranks, also where one of them has none of the gaps."""
    given = case(kind, **keys)
    with pytest.raises(InputError, match=said):
        problem = Problem(body(2), LAW, loads=given.load, supports=given.support, degree=1)
        _ = problem.weak_form.residual
