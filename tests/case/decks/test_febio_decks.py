"""FEBio models as cases: energies, load curves, supports, loads, and what is named as missing."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
from helpers.decks import box
from helpers.febio_text import febio_text
from helpers.law_at_points import Program, tensor

from dolfin_elastic.case.decks.deck import Deck
from dolfin_elastic.case.decks.febio.materials import LAWS
from dolfin_elastic.case.decks.reading import read_deck
from dolfin_elastic.case.decks.writer import case_texts
from dolfin_elastic.case.tables import Material
from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import AnyArray

POINTS, CELLS = box((2, 1, 1), (2, 1, 1))
END = np.flatnonzero(POINTS[:, 0] == 2)[None, :3]
STATIC = (
    "<Control><analysis>STATIC</analysis><time_steps>10</time_steps>"
    "<step_size>0.2</step_size></Control>"
)
RAMP = (
    '<load_controller id="1" type="loadcurve"><interpolate>LINEAR</interpolate>'
    "<points>{}</points></load_controller>"
)
STEEL = (
    '<material id="1" name="steel" type="neo-Hookean"><density>8</density>'
    "<E>200</E><v>0.3</v></material>"
)


def read(folder: Path, more: str, material: str = STEEL, version: str = "4.0") -> Deck:
    """A bar of the parts a and b, with sections below its mesh."""
    text = febio_text(
        POINTS,
        {"a": CELLS[:6], "b": CELLS[6:]},
        sets={"wall": np.flatnonzero(POINTS[:, 0] == 0)},
        surfaces={"end": END},
        version=version,
        more=f"<Material>{material}</Material>{more}",
    )
    if version >= "3":
        domains = "".join(f'<SolidDomain name="{n}" mat="steel"/>' for n in "ab")
        text = text.replace("</Mesh>", f"</Mesh>\n<MeshDomains>{domains}</MeshDomains>")
    (folder / "model.feb").write_text(text)
    return read_deck(folder / "model.feb")


def tables(deck: Deck) -> dict[str, Any]:
    """Tables of its one case file, in SI units."""
    (text,) = case_texts(deck, "model", "m-kg-s").values()
    return tomllib.loads(text)


# --- energies: typed from the manual of FEBio, apart from its import ---


def volume(model: str, k: float, J: AnyArray) -> AnyArray:
    return (
        k
        * {
            "default": np.log(J) ** 2 / 2,
            "NIKE3D": (J**2 - 2 * np.log(J) - 1) / 4,
            "Abaqus": (J - 1) ** 2 / 2,
            "Abaqus (GOH)": ((J**2 - 1) / 2 - np.log(J)) / 2,
        }[model]
    )


def lame(E: float, v: float) -> tuple[float, float]:
    return v * E / ((1 + v) * (1 - 2 * v)), E / (2 * (1 + v))


def invariants(C: AnyArray) -> tuple[AnyArray, AnyArray]:
    I1 = np.trace(C, axis1=1, axis2=2)
    return I1, (I1**2 - np.trace(C @ C, axis1=1, axis2=2)) / 2


def neo_hookean(C: AnyArray, J: AnyArray, E: float, v: float) -> AnyArray:
    lam, mu = lame(E, v)
    return mu * ((invariants(C)[0] - 3) / 2 - np.log(J)) + lam * np.log(J) ** 2 / 2


def green(C: AnyArray, J: AnyArray, E: float, v: float) -> AnyArray:
    lam, mu = lame(E, v)
    e = (C - np.eye(3)) / 2
    return lam * np.trace(e, axis1=1, axis2=2) ** 2 / 2 + mu * (e**2).sum(axis=(1, 2))


def natural(C: AnyArray, J: AnyArray, E: float, v: float) -> AnyArray:
    lam, mu = lame(E, v)
    h = np.log(np.linalg.eigvalsh(C)) / 2
    deviator = h - h.mean(axis=1, keepdims=True)
    return (lam + 2 * mu / 3) * h.sum(axis=1) ** 2 / 2 + mu * (deviator**2).sum(axis=1)


def isochoric(C: AnyArray, J: AnyArray) -> tuple[AnyArray, AnyArray]:
    return invariants(C / np.cbrt(J**2)[:, None, None])


def mooney_rivlin(C: AnyArray, J: AnyArray, c1: float, c2: float) -> AnyArray:
    I1, I2 = isochoric(C, J)
    return c1 * (I1 - 3) + c2 * (I2 - 3)


def coupled(C: AnyArray, J: AnyArray, c1: float, c2: float, k: float) -> AnyArray:
    I1, I2 = invariants(C)
    lnJ = np.log(J)
    return c1 * (I1 - 3) + c2 * (I2 - 3) - 2 * (c1 + 2 * c2) * lnJ + k * lnJ**2 / 2


def ogden(C: AnyArray, J: AnyArray, **c: float) -> AnyArray:
    stretch = np.sqrt(np.linalg.eigvalsh(C)) / np.cbrt(J)[:, None]
    terms = [
        c[f"c{i}"] / c[f"m{i}"] ** 2 * ((stretch ** c[f"m{i}"]).sum(axis=1) - 3) for i in (1, 2)
    ]
    return np.sum(terms, axis=0)


def yeoh(C: AnyArray, J: AnyArray, c1: float, c2: float, c3: float) -> AnyArray:
    x = isochoric(C, J)[0] - 3
    return c1 * x + c2 * x**2 + c3 * x**3


def holzapfel(C: AnyArray, J: AnyArray, **given: float) -> AnyArray:
    c, k1, k2, kappa, gamma = (given[name] for name in ("c", "k1", "k2", "kappa", "gamma"))
    Cb = C / np.cbrt(J**2)[:, None, None]
    I1, g = np.trace(Cb, axis1=1, axis2=2), np.radians(gamma)
    first, second = np.array([0, 0.6, 0.8]), np.array([1.0, 0, 0])
    energy = c / 2 * (I1 - 3)
    for sign in (1, -1):
        f = np.cos(g) * first + sign * np.sin(g) * second
        e = kappa * (I1 - 3) + (1 - 3 * kappa) * (np.einsum("i,nij,j->n", f, Cb, f) - 1)
        energy = energy + np.where(e >= 0, k1 / (2 * k2) * (np.exp(k2 * e**2) - 1), 0)
    return energy


AXES = '<mat_axis type="vector"><a>0,3,4</a><d>2,3,4</d></mat_axis>'
HOOKE = {"E": 200.0, "v": 0.3}
ENERGIES: dict[str, tuple[Callable[..., AnyArray], dict[str, float], str]] = {
    "neo-Hookean": (neo_hookean, HOOKE, ""),
    "isotropic elastic": (green, HOOKE, ""),
    "St.Venant-Kirchhoff": (green, HOOKE, ""),
    "natural neo-Hookean": (natural, HOOKE, ""),
    "coupled Mooney-Rivlin": (coupled, {"c1": 3.0, "c2": 0.0, "k": 40.0}, ""),
    "Mooney-Rivlin": (mooney_rivlin, {"c1": 3.0, "c2": 0.5}, "default"),
    "incomp neo-Hookean": (lambda C, J, G: G / 2 * (isochoric(C, J)[0] - 3), {"G": 3.0}, "NIKE3D"),
    "Ogden": (ogden, {"c1": 3.0, "m1": 2.5, "c2": 0.2, "m2": -2.0}, "Abaqus"),
    "Yeoh": (yeoh, {"c1": 3.0, "c2": -0.1, "c3": 0.2}, "Abaqus (GOH)"),
    "Holzapfel-Gasser-Ogden": (
        holzapfel,
        {"c": 3.0, "k1": 2.0, "k2": 0.5, "kappa": 0.1, "gamma": 40.0},
        "Abaqus (GOH)",
    ),
}


def material_text(kind: str, constants: dict[str, float], more: str = "") -> str:
    inside = "".join(f"<{name}>{value!r}</{name}>" for name, value in constants.items())
    return f'<material id="1" name="steel" type={quoteattr(kind)}>{inside}{more}</material>'


@pytest.mark.parametrize("kind", LAWS)
def test_energies_at_random_deformations(tmp_path: Path, kind: str) -> None:
    """The same to rounding, which the laws of principal stretches lose digits to at equal ones."""
    formula, constants, model = ENERGIES[kind]
    given = dict(constants) | ({"k": 40.0} if model else {})
    named = f"<pressure_model>{model}</pressure_model>" if model != "default" and model else ""
    axes = AXES if kind.startswith("Holz") else ""
    if kind.startswith("Holz"):
        named = ""  # it is its default
    deck = read(tmp_path, "", material_text(kind, given, named + axes))
    law = Material.read(tables(deck)["materials"]["steel"]).law
    F = np.eye(3) + 0.35 * np.random.default_rng(1).uniform(-1, 1, (50, 3, 3))
    F = F[np.linalg.det(F) > 0.2]
    C, J = np.swapaxes(F, 1, 2) @ F, np.linalg.det(F)
    expected = formula(C, J, **constants)
    if model:
        expected = expected + volume(model, 40.0, J)
    symbol = tensor()
    found = Program(law.energy(symbol))({symbol: F})
    assert found == pytest.approx(expected, rel=1e-10, abs=1e-11 * np.abs(expected).max())


NOT_CARRIED = {
    "other law": (
        '<material id="1" name="steel" type="Fung"/>',
        "no law here has the energy of 'F",
    ),
    "c2": (material_text("coupled Mooney-Rivlin", {"c1": 1, "c2": 2, "k": 3}), "c2 other than 0"),
    "constant": (material_text("neo-Hookean", {"E": 1, "v": 0, "eta": 3}), "not known: eta"),
    "curve": (STEEL.replace("<E>", '<E lc="1">'), "<E> changes over time or in space"),
    "missing": (material_text("neo-Hookean", {"E": 1}), "the material has no <v>"),
    "pressure": (
        material_text("Mooney-Rivlin", {"c1": 1, "k": 9}, "<pressure_model>x</pressure_model>"),
        "the pressure model 'x' is not known",
    ),
}


@pytest.mark.parametrize("fault", NOT_CARRIED)
def test_materials_without_an_equal_are_named(tmp_path: Path, fault: str) -> None:
    material, said = NOT_CARRIED[fault]
    deck = read(tmp_path, "", material)
    assert [f"{one.place.file}" for one in deck.faults] == ["model.feb"]
    assert said in deck.faults[0].text and deck.faults[0].place.line > 30


# --- supports, loads and curves ---

ACTIONS = {
    "4.0": (
        '<Boundary><bc type="zero displacement" node_set="wall"><x_dof>1</x_dof><y_dof>1</y_dof>'
        '<z_dof>1</z_dof></bc><bc type="prescribed displacement" node_set="@surface:end">'
        '<dof>x</dof><value lc="1">0.5</value></bc></Boundary>'
        '<Loads><surface_load type="pressure" surface="end"><pressure lc="1">3</pressure>'
        "</surface_load>"
        '<nodal_load type="nodal_force" node_set="wall"><value>0,0,7</value></nodal_load>'
        '<body_load type="body force"><force lc="1">0,0,9.81</force></body_load></Loads>'
    ),
    "3.0": (
        '<Boundary><bc type="fix" node_set="wall"><dofs>x,y,z</dofs></bc>'
        '<bc type="prescribe" node_set="@surface:end"><dof>x</dof><scale lc="1">0.5</scale></bc>'
        '</Boundary><Loads><surface_load type="pressure" surface="end">'
        '<pressure lc="1">3</pressure></surface_load><nodal_load type="nodal_load" '
        'node_set="wall"><dof>z</dof><scale>7</scale></nodal_load>'
        '<body_load type="const"><z lc="1">9.81</z></body_load></Loads>'
    ),
    "2.5": (
        '<Boundary><fix bc="x,y,z" node_set="wall"/>'
        '<prescribe bc="x" node_set="end"><scale lc="1">0.5</scale></prescribe></Boundary>'
        '<Loads><surface_load type="pressure" surface="end"><pressure lc="1">3</pressure>'
        '</surface_load><nodal_load bc="z" node_set="wall"><scale>7</scale></nodal_load>'
        '<body_load type="const"><z lc="1">9.81</z></body_load></Loads>'
    ),
}
CURVES = {
    "2.5": '<loadcurve id="1" type="smooth"><point>0,0</point><point>2,4</point></loadcurve>',
    "3.0": RAMP.format("<point>0,0</point><point>2,4</point>"),
    "4.0": RAMP.format("<pt>0,0</pt><pt>2,4</pt>").replace("LINEAR", "SMOOTH"),
}


@pytest.mark.parametrize("version", ACTIONS)
def test_supports_and_loads(tmp_path: Path, version: str) -> None:
    """FEBio's body force acts against its vector; a smooth curve of two points is a line."""
    curve = f"<LoadData>{CURVES[version]}</LoadData>"
    more = STATIC + ACTIONS[version] + curve
    deck = read(tmp_path, more, version=version)
    assert deck.faults == []
    found = tables(deck)
    on = found["materials"]["steel"].pop("on")
    assert on == ("a" if version == "2.5" else ["a", "b"])  # there it is by number
    assert found["materials"]["steel"] == {
        "law": "neo-hookean",
        "E": "200 Pa",
        "nu": 0.3,
        "density": "8 kg/m^3",
    }
    assert found["support"] == [
        {"on": "wall", "kind": "fixed"},
        {"on": "end", "displacement": ["2 m", "free", "free"]},
    ]
    assert found["load"] == [
        {"kind": "pressure", "on": "end", "value": "12 Pa"},
        {"kind": "point-force", "on": "wall", "value": [0, 0, "7 N"]},
        {"kind": "gravity", "value": [0, 0, "-39.24 m/s^2"]},
    ]
    assert found["mesh"] == {
        "file": "model.feb",
        "unit": "m",
        "formulation": "displacement",
        "degree": 1,
    }


def curve_of(folder: Path, curve: str, analysis: str = STATIC) -> tuple[Any, list[str]]:
    load = (
        '<Loads><surface_load type="pressure" surface="end"><pressure lc="1">2</pressure>'
        "</surface_load></Loads>"
    )
    deck = read(folder, f"{analysis}{load}<LoadData>{curve}</LoadData>")
    (one,) = tables(deck)["load"]
    return (one["value"], one.get("curve")), [f.text for f in deck.faults]


def test_curves_over_the_steps(tmp_path: Path) -> None:
    """Values at the end of the analysis, at 2 s; in motion as the deck has them."""
    points = "<pt>0,1</pt><pt>1,5</pt><pt>2,2</pt>"
    rows = [[0, 0.5], [0.5, 2.5], [1, 1]]
    assert curve_of(tmp_path, RAMP.format(points)) == (("4 Pa", rows), [])
    smooth = RAMP.format(points).replace("LINEAR", "SMOOTH")
    assert curve_of(tmp_path, smooth) == (("4 Pa", rows), [])
    early = RAMP.format("<pt>0,0</pt><pt>1,3</pt>")
    assert curve_of(tmp_path, early) == (("6 Pa", [[0, 0], [0.5, 1], [1, 1]]), [])
    on = early.replace("</interpolate>", "</interpolate><extend>EXTRAPOLATE</extend>")
    assert curve_of(tmp_path, on) == (("12 Pa", [[0, 0], [0.5, 0.5], [1, 1]]), [])
    beyond = RAMP.format("<pt>0,0</pt><pt>1,3</pt><pt>5,5</pt>").replace("LINEAR", "SMOOTH")
    assert "between points that are no line" in curve_of(tmp_path, beyond)[1][0]
    motion = STATIC.replace("STATIC", "DYNAMIC")
    value, faults = curve_of(tmp_path, early, motion)
    assert value == ("6 Pa", [[0, 0], [1, 1], [2, 1]]) and not faults


def test_motion(tmp_path: Path) -> None:
    deck = read(tmp_path, STATIC.replace("STATIC", "DYNAMIC"))
    assert tables(deck)["dynamics"] == {"end": "2 s", "dt": "0.2 s", "spectral_radius": 1}


LISTED = {
    "<Rigid><rigid_bc/></Rigid>": "'' of rigid bodies is not known here",
    '<Rigid><rigid_bc type="rigid_fixed"><rb>a</rb></rigid_bc></Rigid>': "no material 'a' of type",
    '<Loads><surface_load type="fluid"/></Loads>': "the load 'fluid' is not known here",
    '<Boundary><bc type="rigid" node_set="wall"/></Boundary>': "there is no material ''",
    '<Boundary><bc type="normal" node_set="wall"/></Boundary>': "the boundary condition 'normal'",
    '<Contact><contact type="sliding-elastic"/></Contact>': "the contact 'sliding-elastic'",
    '<Constraints><constraint type="volume"/></Constraints>': "the constraint 'volume'",
    '<Loads><surface_load type="traction" surface="end"><traction>0,1,0</traction></surface_load>'
    "</Loads>": "per undeformed area, which is the same at small strains",
    '<Step><step><Loads><body_load type="const"/></Loads></step></Step>': "a step without <Contr",
    '<LoadData><load_controller id="1" type="math"/></LoadData>': "is no curve of points",
}


@pytest.mark.parametrize("section", LISTED)
def test_what_is_not_carried_over_has_its_line(tmp_path: Path, section: str) -> None:
    deck = read(tmp_path, STATIC + section)
    (fault,) = deck.faults
    assert LISTED[section] in str(fault) and str(fault).startswith("model.feb:")


def test_ties_and_constraints(tmp_path: Path) -> None:
    pair = '<SurfacePair name="p"><primary>end</primary><secondary>foot</secondary></SurfacePair>'
    more = (
        '<Contact><contact type="tied-elastic" surface_pair="p"/></Contact><Constraints>'
        '<constraint type="symmetry plane" surface="end"/></Constraints>'
    )
    deck = read(tmp_path, STATIC + more)
    text = (tmp_path / "model.feb").read_text().replace("</Mesh>", f"{pair}</Mesh>")
    (tmp_path / "model.feb").write_text(text)
    deck = read_deck(tmp_path / "model.feb")
    assert [one.keys for one in deck.ties] == [{"on": "end", "to": "foot"}]
    assert [one.keys for one in deck.steps[0].supports] == [{"on": "end", "kind": "symmetry"}]


BROKEN = {
    "no curve": (
        '<Loads><surface_load type="pressure" surface="end"><pressure lc="7">1'
        "</pressure></surface_load></Loads>",
        "there is no load curve 7",
    ),
    "no number": (
        '<Loads><surface_load type="pressure" surface="end"><pressure>x</pressure>'
        "</surface_load></Loads>",
        "<pressure> contains 'x'; a number",
    ),
    "no set": (
        '<Boundary><bc type="zero displacement"><x_dof>1</x_dof></bc></Boundary>',
        "<bc> names no set of the mesh",
    ),
    "times": (f"<LoadData>{RAMP.format('<pt>1,0</pt><pt>1,1</pt>')}</LoadData>", "do not increase"),
    "direction": (
        '<Boundary><bc type="prescribed displacement" node_set="wall"><dof>r</dof></bc></Boundary>',
        "'r' is no direction",
    ),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_lines_that_cannot_be_read(tmp_path: Path, fault: str) -> None:
    more, said = BROKEN[fault]
    with pytest.raises(MeshError, match=rf"model.feb:\d+: .*{said}"):
        read(tmp_path, STATIC + more)


def test_units_that_the_file_states(tmp_path: Path) -> None:
    read(tmp_path, STATIC)
    path = tmp_path / "model.feb"
    text = path.read_text()
    whole = '<Module type="solid"><units>mm-N-s</units></Module>'
    path.write_text(text.replace('<Module type="solid"/>', whole))
    assert read_deck(path).units == "mm-t-s"
    assert "model.feb" in case_texts(read_deck(path), "model")["model"]
    path.write_text(text.replace('<Module type="solid"/>', whole.replace("solid", "biphasic")))
    assert "the module 'biphasic'" in read_deck(path).faults[0].text
