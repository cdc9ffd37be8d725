"""Materials of FEBio as laws with the same energy.

Sources: FEBio User Manual, version 4, chapter 4, and the energies of its classes.  Energies of the
volume of uncoupled materials: k/2 (ln J)^2 ("default"), k/4 (J^2 - 1 - 2 ln J) ("NIKE3D" and
"Abaqus (GOH)"), k/2 (J - 1)^2 ("Abaqus").  "isotropic elastic" is Hooke's law between second
Piola-Kirchhoff stress and Green strain.  "Arruda-Boyce" is not that of its authors there: term i is
multiplied by i.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from dolfin_elastic.case.decks.deck import Deck, Entry, Quantity
from dolfin_elastic.case.decks.febio.values import numbers, place
from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.mesh.formats.febio.tags import Tag

_VOLUMETRIC = {
    **dict.fromkeys(("default", "0"), "log"),
    **dict.fromkeys(("nike3d", "1", "abaqus (goh)", "3"), "simo-taylor"),
    **dict.fromkeys(("abaqus", "2"), "quadratic"),
}
Keys = dict[str, object]
RIGID = "rigid body"
"""Type of the material of rigid bodies."""


class _Constants:
    """Constants of a material, each of which is to be asked for."""

    def __init__(self, tag: Tag) -> None:
        self.tag = tag
        self._rest = {child.name: child for child in tag.children}
        self._rest.pop("density", None)

    def number(self, name: str, default: float | None = None) -> float:
        """A constant.

        Args:
            default: Where it is left out; None: it is needed.
        """
        child = self._rest.pop(name, None)
        if child is None:
            if default is None:
                raise self.tag.error(f"the material has no <{name}>")
            return default
        if "lc" in child.attributes or child.attributes.get("type", "const") != "const":
            raise child.error(f"<{name}> changes over time or in space")
        return numbers(child, 1)[0]

    def stress(self, name: str, default: float | None = None, factor: float = 1.0) -> Quantity:
        """A modulus."""
        return Quantity(factor * self.number(name, default), "stress")

    def volume(self, default: str = "default") -> Keys:
        """Bulk modulus and energy of the volume of an uncoupled material."""
        child = self._rest.pop("pressure_model", None)
        model = (child.text if child is not None else default).lower()
        if child is not None and model not in _VOLUMETRIC:
            raise child.error(f"the pressure model '{child.text[:40]}' is not known")
        return {"K": self.stress("k"), "volumetric": _VOLUMETRIC[model]}

    def axes(self) -> tuple[list[float], list[float]]:
        """The first two axes of the material, orthonormal."""
        child = self._rest.pop("mat_axis", None)
        if child is None:
            return [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]
        a, d = child.first("a"), child.first("d")
        if child.attributes.get("type", "vector") != "vector" or a is None or d is None:
            raise child.error("axes of the material other than vectors are not read")
        first, second = numbers(a, 3), numbers(d, 3)
        size = math.hypot(*first)
        first = [x / size for x in first] if size else first
        along = sum(x * y for x, y in zip(first, second, strict=True))
        second = [y - along * x for x, y in zip(first, second, strict=True)]
        across = math.hypot(*second)
        if not size or not across > 1e-12 * size:
            raise child.error("the axes of the material are parallel")
        return first, [x / across for x in second]

    def unread(self) -> list[str]:
        """Names of what was not asked for and is not zero."""
        return [n for n, child in self._rest.items() if child.text not in ("", "0", "0.0")]


def _hooke(law: str) -> Callable[[_Constants], Keys]:
    return lambda c: {"law": law, "E": c.stress("E"), "nu": c.number("v")}


def _mooney_rivlin(c: _Constants) -> Keys:
    constants = {"c10": c.stress("c1"), "c01": c.stress("c2", 0.0)}
    return {"law": "mooney-rivlin", **constants, **c.volume()}


def _coupled_mooney_rivlin(c: _Constants) -> Keys:
    """With c2 = 0 it is c1 (I1 - 3 - 2 ln J) + k/2 (ln J)^2."""
    if c.number("c2", 0.0):
        raise c.tag.error("no law here has its energy with c2 other than 0")
    return {"law": "neo-hookean", "mu": c.stress("c1", factor=2.0), "lmbda": c.stress("k")}


def _incompressible_neo_hookean(c: _Constants) -> Keys:
    return {"law": "neo-hookean-split", "mu": c.stress("G"), **c.volume()}


def _ogden(c: _Constants) -> Keys:
    """Its terms are c_i/m_i^2 (sum of stretches^m_i - 3)."""
    terms = [(c.number(f"c{i}", 0.0), c.number(f"m{i}", 1.0)) for i in range(1, 7)]
    used = [(modulus, m) for modulus, m in terms if modulus]
    mu = [Quantity(modulus / m, "stress") for modulus, m in used]
    return {"law": "ogden", "mu": mu, "alpha": [m for _, m in used], **c.volume()}


def _yeoh(c: _Constants) -> Keys:
    if any(c.number(f"c{i}", 0.0) for i in (4, 5, 6)):
        raise c.tag.error("the law here has three terms, without c4, c5 and c6")
    constants = {f"c{i}0": c.stress(f"c{i}", 0.0) for i in (1, 2, 3)}
    return {"law": "yeoh", **constants, **c.volume()}


def _holzapfel(c: _Constants) -> Keys:
    """Fibres at the angles gamma and -gamma to the first axis, towards the second one."""
    first, second = c.axes()
    angle = math.radians(c.number("gamma", 0.0))
    along, across = math.cos(angle), math.sin(angle)
    fibres = {
        name: [along * a + sign * across * b for a, b in zip(first, second, strict=True)]
        for name, sign in (("fibre", 1), ("fibre2", -1))
    }
    return {
        "law": "holzapfel-gasser-ogden",
        "mu": c.stress("c"),
        "k1": c.stress("k1"),
        "k2": c.number("k2"),
        "kappa": c.number("kappa", 0.0),
        **c.volume("Abaqus (GOH)"),
        **fibres,
    }


LAWS: Mapping[str, Callable[[_Constants], Keys]] = {
    "neo-Hookean": _hooke("neo-hookean"),
    "isotropic elastic": _hooke("st-venant-kirchhoff"),
    "St.Venant-Kirchhoff": _hooke("st-venant-kirchhoff"),
    "natural neo-Hookean": _hooke("hencky"),
    "Mooney-Rivlin": _mooney_rivlin,
    "coupled Mooney-Rivlin": _coupled_mooney_rivlin,
    "incomp neo-Hookean": _incompressible_neo_hookean,
    "Ogden": _ogden,
    "Yeoh": _yeoh,
    "Holzapfel-Gasser-Ogden": _holzapfel,
}
"""Type of a material to what makes keys of its constants."""


def take_materials(root: Tag, deck: Deck, parts: Mapping[str, list[str]]) -> None:
    """Writes all materials that parts of the mesh have, but for rigid ones.

    Args:
        parts: Name or number of a material to the names of its parts.
    """
    for section in root.all("Material"):
        for tag in section.all("material"):
            keys = (tag.attributes.get("name", ""), tag.attributes.get("id", ""))
            on = [part for key in dict.fromkeys(keys) for part in parts.get(key, ())]
            if on and tag.attributes.get("type") != RIGID:
                _take(tag, deck, keys[0] or f"material {keys[1]}", on)


def keys_of(tag: Tag) -> Keys:
    """Law and constants of a material.

    Raises:
        MeshError: No law has the same energy, with the line.
    """
    kind = tag.attributes.get("type", "")
    if kind not in LAWS:
        raise tag.error(f"no law here has the energy of '{kind[:60]}'")
    constants = _Constants(tag)
    keys = LAWS[kind](constants)
    if unread := constants.unread():
        raise tag.error(f"constants of '{kind}' that are not known: {', '.join(unread)}")
    return keys


def _take(tag: Tag, deck: Deck, name: str, on: list[str]) -> None:
    try:
        keys = keys_of(tag)
    except MeshError as error:
        deck.leave_out(place(tag), f"material '{name}': {error.what}", "changes the answer")
        return
    density = tag.first("density")
    value = 1.0 if density is None else numbers(density, 1)[0]
    remark = "" if density is not None else "density 1 is FEBio's default"
    keys |= {"density": Quantity(value, "density"), "on": on[0] if len(on) == 1 else on}
    deck.materials[name] = Entry(place(tag), keys, remark)
