"""What laws say about constants that cannot be, and what they make of directions and lists."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from conftest import ROOT
from dolfinx import fem
from helpers.law_at_points import Point
from helpers.laws import make, random_F
from ufl.algorithms import expand_derivatives

import dolfin_elastic
from dolfin_elastic import Problem, box_body
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.materials import pages
from dolfin_elastic.model.materials.law import SplitLaw
from dolfin_elastic.model.materials.registry import MATERIALS, Isotropic
from dolfin_elastic.model.materials.spatial import direction, frame
from dolfin_elastic.model.point.ufl_to_numpy import (
    LawAtPoints,
    NumpyProgram,
    gradient_symbol,
)

FOLDER = ROOT / "docs" / "laws"


@pytest.mark.parametrize(
    ("name", "given", "says"),
    [
        ("orthotropic", {"nu12": 2}, ["nu12", "sqrt(E1/E2) = 1.29099"]),
        ("orthotropic", {"nu12": 1.2, "nu13": 1.5, "nu23": 1.2}, ["positive definite"]),
        ("orthotropic", {"axis2": [-2, -2, 0]}, ["axis2", "parallel"]),
        ("orthotropic", {"axis1": [0, 0, 0]}, ["axis1", "needs a length"]),
        ("guccione", {"fibre": [1]}, ["fibre", "not a direction", "[1, 0, 0]"]),
        ("guccione", {"fibre": 3}, ["fibre", "not a direction"]),
        ("mooney-rivlin", {"c10": "-50 kPa"}, ["shear modulus", "-20000", "positive"]),
        ("mooney-rivlin", {"K": 1e6}, ["K and nu given together"]),
        ("gent", {"nu": 0.6}, ["nu", "0.6"]),
        ("gent", {"limit": 0}, ["limit"]),
        ("ogden", {"alpha": [1.0]}, ["3 moduli", "one of each"]),
        ("ogden", {"alpha": [1.0, 0.0, 2.0]}, ["alpha is not 0"]),
        ("ogden", {"mu": ["1 kg", 1, 1]}, ["mu[0]", "wrong unit"]),
        ("blatz-ko", {"nu": 0.0}, ["nu", "above 0 and below 0.5"]),
        ("yeoh", {"volumetric": "cubic"}, ["volumetric", "known: log, quadratic"]),
        ("holzapfel-gasser-ogden", {"kappa": 0.4}, ["kappa"]),
    ],
)
def test_what_cannot_be_is_refused(name: str, given: dict[str, Any], says: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        make(name, **given)
    for part in says:
        assert part in str(caught.value)


def test_volume_needs_a_constant() -> None:
    with pytest.raises(InputError, match="neither K nor nu is given"):
        MATERIALS["gent"](mu=1.0, limit=30)


@pytest.mark.parametrize("name", ["mooney-rivlin", "yeoh", "ogden", "arruda-boyce", "gent"])
def test_bulk_modulus_or_poissons_ratio(name: str) -> None:
    """Either gives the other; mu at small strains follows from the law's own constants."""
    by_nu = make(name)
    example = {k: v for k, v in MATERIALS[name].example.items() if k != "nu"}
    by_K = MATERIALS[name](**example, K=by_nu.K)
    a, b = by_nu.small_strain(), by_K.small_strain()
    assert a is not None
    assert vars(b) == pytest.approx(vars(a), rel=1e-12)
    assert by_nu.nu == a.nu


@pytest.mark.parametrize("name", MATERIALS)
def test_shape_does_not_know_the_volume_modulus(name: str) -> None:
    """So that it may be infinite where a pressure takes its place."""
    law = make(name)
    if not isinstance(law, SplitLaw):
        return
    law = law.model_copy(update={law.volume_modulus: np.nan})
    F = ufl.as_matrix(random_F(0).tolist())
    for part in (law.shape_energy(F), law.shape_stress(F), law.volume_strain(F)):
        assert not np.isnan([float(x) for x in ufl_numbers(part)]).any()


@pytest.mark.parametrize("name", MATERIALS)
def test_stress_is_that_of_shape_and_of_volume(name: str) -> None:
    """Also where a law writes the whole of it anew, and mixed forms take the parts."""
    law = make(name)
    if not isinstance(law, SplitLaw):
        return
    at, F = LawAtPoints(law), gradient_symbol()
    whole = at.stress(random_F(0)[None])
    parts = NumpyProgram(expand_derivatives(SplitLaw.stress(law, F)), F)(random_F(0)[None])
    np.testing.assert_allclose(parts, whole, rtol=0, atol=1e-12 * np.abs(whole).max())


def ufl_numbers(expression: Any) -> list[Any]:
    nodes = ufl.corealg.traversal.unique_pre_traversal(expression)
    return [node for node in nodes if isinstance(node, ufl.classes.ScalarValue)]


def test_directions() -> None:
    """Lists of numbers and UFL vectors alike, of any length; two components lie in the plane."""

    def value(vector: Any) -> list[float]:
        return [float(vector[i](())) for i in range(3)]

    assert value(direction([0, 3])) == [0, 1, 0]
    assert value(direction(ufl.as_vector([0.0, 0.0, 2.0]))) == [0, 0, 1]
    axes = np.array([value(axis) for axis in frame([1, 1, 0], [0, 1, 1])])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(axes) == pytest.approx(1)
    assert axes[1] @ [0, 1, 1] > 0


def test_a_direction_in_the_plane_has_no_third_component() -> None:
    """Among the constants of a form, where all have three."""
    law = make("holzapfel-gasser-ogden", fibre=[0.6, 0.8], fibre2=[0.0, 0.0, 1.0])
    found = law.constants()
    assert (found["fibre"], found["fibre2"]) == ([0.6, 0.8, 0.0], [0.0, 0.0, 1.0])


@pytest.mark.parametrize("name", ["guccione", "holzapfel-gasser-ogden", "orthotropic"])
def test_turned_material(name: str) -> None:
    """P(F Q) = P'(F) Q, P' of the material turned by Q: nothing but the directions is special."""
    law = make(name)
    if law.linear:
        F, Q = 0.1 * random_F(1), np.linalg.qr(random_F(2))[0]
        strain, turned = np.eye(3) + F, np.eye(3) + Q.T @ F @ Q
        others = {k: (Q @ law.constants()[k]).tolist() for k in law.directions}
        P = Point(make(name, **others)).stress(strain)
        np.testing.assert_allclose(Point(law).stress(turned), Q.T @ P @ Q, rtol=0, atol=1e-9)
        return
    F, Q = random_F(1), np.linalg.qr(random_F(2))[0]
    others = {k: (Q @ law.constants()[k]).tolist() for k in law.directions}
    P = Point(make(name, **others)).stress(F)
    np.testing.assert_allclose(
        Point(law).stress(F @ Q), P @ Q, rtol=0, atol=1e-11 * np.abs(P).max()
    )


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("ogden", {"mu": [1.0, 2.0, 3.0], "alpha": [2.0, 1.0, 3.0]}),
        ("guccione", {"fibre": [0, 0, 1], "C": 1.0}),
        ("orthotropic", {"axis1": [0, 0, 1], "E1": 1e7}),
    ],
)
def test_values_do_not_recompile(name: str, other: dict[str, Any], comm: Any) -> None:
    """The form of a law does not hold its numbers, its lists or its directions."""
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1), comm=comm)
    forms = [Problem(body, make(name, **more), degree=1).weak_form.tangent for more in ({}, other)]
    signatures = [form.signature() for form in forms]
    assert signatures[0] == signatures[1]
    assert not any(isinstance(c, fem.Function) for c in forms[0].constants())


def test_names_of_the_table_are_those_of_the_laws():
    """The row says which class a law has before it is imported; the package has the same."""
    assert [kind.name() for kind in MATERIALS.values()] == list(MATERIALS)
    assert all(getattr(dolfin_elastic, kind.__name__) is kind for kind in MATERIALS.values())


@pytest.mark.parametrize("kind", MATERIALS.values(), ids=MATERIALS)
def test_every_law_says_what_it_is(kind: type[Any]) -> None:
    """An example, a source, and a description of every key."""
    said = pages.descriptions(kind)
    assert not [name for name in kind.model_fields if not said.get(name)]
    assert "Source:" in kind.__doc__
    assert kind(**kind.example)
    assert issubclass(kind, Isotropic) <= (kind(**kind.example).small_strain() is not None)


def test_pages_are_up_to_date() -> None:
    """If not: python3 -m dolfin_elastic.model.materials.pages."""
    found = {path.name: path.read_text(encoding="utf-8") for path in FOLDER.glob("*.md")}
    assert found == pages.pages()
