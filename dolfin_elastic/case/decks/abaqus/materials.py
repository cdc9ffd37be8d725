"""Materials of Abaqus and CalculiX as laws: constants, and what their constants of volume mean."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from dolfin_elastic.case.decks.deck import Deck, Entry, Place, Quantity
from dolfin_elastic.mesh.formats.abaqus.cards import Card

OTHER_LAWS = {
    "CYCLIC HARDENING": "this kind of hardening is not there",
    "DEFORMATION PLASTICITY": "this law is not there",
    "MOHR COULOMB": "this law is not there",
    "CREEP": "creep is not there",
    "VISCOELASTIC": "state it as `viscous` of the material, see the guide on materials",
    "HYPERFOAM": "this law is not there",
    "USER MATERIAL": "its subroutine cannot be read",
    "CONCRETE DAMAGED PLASTICITY": "this law is not there",
    "MULLINS EFFECT": "this law is not there",
    "DAMAGE INITIATION": "damage is not there",
    "NO COMPRESSION": "this law is not there",
}
"""Keywords of laws that the program lacks, and why."""
WITHOUT_EFFECT = (
    *("CONDUCTIVITY", "SPECIFIC HEAT", "DEPVAR", "FLUID CONSTANTS", "SPECIFIC GAS CONSTANT"),
    *("ELECTRICAL CONDUCTIVITY", "USER OUTPUT VARIABLES", "MAGNETIC PERMEABILITY"),
)
"""Keywords of materials that no displacement depends on."""
_INCOMPRESSIBLE = "D1 = 0: {}"
_ORDERS = {"NEO HOOKE": 1, "YEOH": 3}


@dataclass
class Material:
    """A material of the deck, and where it fills the body.

    Attributes:
        name: As the deck spells it.
        cards: Its keywords.
        sections: Regions and names of orientations of its *SOLID SECTION.
    """

    name: str
    card: Card
    cards: list[Card] = field(default_factory=list)
    sections: list[tuple[str, str]] = field(default_factory=list)


def place(card: Card, row: int | None = None) -> Place:
    """Where a keyword, or one of its data lines, stands."""
    return Place(card.file, card.line if row is None else card.at[row], f"*{card.word}")


def floats(card: Card, row: int | None = None) -> list[float]:
    """The numbers of a data line, or of all; what is blank is zero.

    Raises:
        MeshError: One is no number.
    """
    result = []
    for i, line in enumerate(card.lines):
        if row is not None and i != row:
            continue
        words = [word.strip() for word in line.rstrip().rstrip(",").split(",")]
        for word in words:
            try:
                value = float(word.upper().replace("D", "E", 1) or "0")
            except ValueError:
                raise card.error(f"'{word[:40]}' is no number", row=i) from None
            if not np.isfinite(value):
                raise card.error(f"'{word[:40]}' is no finite number", row=i)
            result.append(value)
    return result


def stress(value: float) -> Quantity:
    """A number of the deck as a stress."""
    return Quantity(float(value), "stress")


@dataclass(frozen=True)
class Use:
    """What the analyses and elements ask of laws.

    Attributes:
        large: There are large displacements.
        hybrid: The elements have a pressure of their own.
    """

    large: bool
    hybrid: bool


def material_entry(deck: Deck, material: Material, use: Use) -> Entry:
    """The table of a material, without `on`; what it lacks is in `left_out`."""
    keys: dict[str, object] = {}
    remarks: list[str] = []
    where, plastic = place(material.card), list[Card]()
    for card in material.cards:
        if card.word in ("ELASTIC", "HYPERELASTIC"):
            take = _elastic if card.word == "ELASTIC" else _hyperelastic
            keys = {**take(deck, card, use, remarks), **keys}
            where = place(card)
        elif card.word == "DENSITY":
            keys["density"] = Quantity(_one(deck, card)[0], "density")
        elif card.word == "EXPANSION":
            if card.options.get("TYPE", "ISO").upper() != "ISO":
                deck.leave_out(place(card), "it is not the same everywhere", "changes the answer")
                continue
            keys["expansion"] = Quantity(_one(deck, card)[0], "expansion")
        elif card.word == "DAMPING":
            continue  # of the motion, see steps.py
        elif card.word == "PLASTIC":
            plastic.append(card)
        elif card.word in OTHER_LAWS:
            deck.leave_out(place(card), OTHER_LAWS[card.word], "changes the answer")
        elif card.word in WITHOUT_EFFECT:
            deck.leave_out(place(card), "no displacement depends on it")
        else:
            deck.leave_out(place(card), "this keyword is not known", "changes the answer")
    if "law" not in keys:
        text = f"the material {material.name} has no *ELASTIC or *HYPERELASTIC"
        deck.leave_out(place(material.card), text, "changes the answer")
    elif plastic:
        keys = _plastic(deck, plastic, keys, use)
        remarks.append(f"*PLASTIC of line {plastic[0].line}")
    return Entry(where, keys, "; ".join(remarks))


def _one(deck: Deck, card: Card) -> list[float]:
    """The constants, which must not depend on the temperature.

    Raises:
        MeshError: There are none.
    """
    if not card.lines:
        raise card.error("there are no constants")
    if len(card.lines) > 1 or _whole(card, "DEPENDENCIES", 0):
        text = "constants that depend on the temperature; those of the first line hold"
        deck.leave_out(place(card, min(1, len(card.lines) - 1)), text, "changes the answer")
    return floats(card, 0)


def _whole(card: Card, key: str, default: int) -> int:
    """A parameter that is a small whole number.

    Raises:
        MeshError: It is none.
    """
    word = card.options.get(key) or str(default)
    if not word.isdecimal() or len(word) > 2:
        raise card.error(f"{key}={word[:40]} is no whole number below 100")
    return int(word)


def _elastic(deck: Deck, card: Card, use: Use, remarks: list[str]) -> dict[str, object]:
    kind = card.options.get("TYPE", "ISO").upper()
    if kind in ("ISO", "ISOTROPIC"):
        E, nu = [*_one(deck, card), 0.0][:2]
        if use.large:
            remarks.append(
                "law of CalculiX with NLGEOM; that of Abaqus differs by the order of the strain"
            )
        law = "st-venant-kirchhoff" if use.large else "linear-elastic"
        return {"law": law, "E": stress(E), "nu": nu}
    constants = floats(card)[:9]
    if kind in ("ENGINEERING CONSTANTS", "ORTHO", "ORTHOTROPIC") and len(constants) == 9:
        if len(card.lines) > 2:
            text = "constants that depend on the temperature; the first nine hold"
            deck.leave_out(place(card, 2), text, "changes the answer")
        if use.large:
            text = "an orthotropic law for large displacements (NLGEOM) is not there"
            deck.leave_out(place(card), text, "changes the answer")
        return {"law": "orthotropic", **_orthotropic(card, kind, constants)}
    deck.leave_out(place(card), f"TYPE={kind} is not there", "changes the answer")
    return {}


def _plastic(
    deck: Deck, cards: list[Card], elastic: dict[str, object], use: Use
) -> dict[str, object]:
    """The keys of an elastic material with those of its yield stress.

    Rows of the table are the yield stress and the plastic strain, beyond the last it is constant.
    """
    card = cards[0]
    for other in cards[1:]:
        text = "a second table, as for another rate; the first one holds"
        deck.leave_out(place(other), text, "changes the answer")
    kind = card.options.get("HARDENING", "ISOTROPIC").upper()
    rows = [[*floats(card, i), 0.0, 0.0][:3] for i in range(len(card.lines))]
    table = [(a, s) for s, a, temperature in rows if temperature == rows[0][2]]
    if why := _no_plastic(card, kind, table, elastic, use):
        deck.leave_out(place(card), why, "changes the answer")
        return elastic
    if len(table) < len(rows):
        text = "constants that depend on the temperature; those of the first line's hold"
        deck.leave_out(place(card, len(table)), text, "changes the answer")
    keys = {**elastic, "law": "j2-logarithmic" if use.large else "j2"}
    if len(table) == 1:
        return {**keys, "yield": stress(table[0][1])}
    if kind == "KINEMATIC":
        (a, low), (b, high) = table
        return {**keys, "yield": stress(low), "kinematic": stress((high - low) / (b - a))}
    return {**keys, "hardening": [[a, stress(s)] for a, s in table]}


def _no_plastic(
    card: Card,
    kind: str,
    table: list[tuple[float, float]],
    elastic: dict[str, object],
    use: Use,
) -> str:
    """Why a table of plastic strain and yield stress is no law here; empty: it is one."""
    if others := sorted(set(card.options) - {"HARDENING"}):
        return f"{', '.join(others)} is not there"
    if not table or "E" not in elastic:
        return "beside another law than *ELASTIC, TYPE=ISO" if table else "it has no table"
    if kind not in ("ISOTROPIC", "KINEMATIC") or (kind == "KINEMATIC" and len(table) > 2):
        return f"HARDENING={kind} is not there but for a straight line"
    if kind == "KINEMATIC" and use.large:
        return "its back stress turns with large strains (NLGEOM) otherwise than here"
    if table[0][0] != 0.0 or table[0][1] <= 0.0:
        return "its first row needs a yield stress above 0 at a plastic strain of 0"
    rises = all(b > a and high >= low for (a, low), (b, high) in pairwise(table))
    return "" if rises else "plastic strains must grow from row to row, and stresses not fall"


def _orthotropic(card: Card, kind: str, c: list[float]) -> dict[str, object]:
    """Engineering constants, of stiffnesses D1111, D1122, D2222, D1133, D2233, D3333 too."""
    if kind == "ENGINEERING CONSTANTS":
        moduli, ratios = c[:3], c[3:6]
    else:
        D = np.array([[c[0], c[1], c[3]], [c[1], c[2], c[4]], [c[3], c[4], c[5]]])
        try:
            S = np.linalg.inv(D)
        except np.linalg.LinAlgError:
            raise card.error("the stiffnesses have no inverse") from None
        moduli = [float(1 / S[i, i]) for i in range(3)]
        ratios = [float(-S[i, j] / S[i, i]) for i, j in ((0, 1), (0, 2), (1, 2))]
    result: dict[str, object] = {f"E{i + 1}": stress(E) for i, E in enumerate(moduli)}
    result |= dict(zip(("nu12", "nu13", "nu23"), ratios, strict=True))
    return result | {name: stress(c[6 + i]) for i, name in enumerate(("G12", "G13", "G23"))}


def _hyperelastic(deck: Deck, card: Card, use: Use, remarks: list[str]) -> dict[str, object]:
    """Laws of rubber.

    Their volumetric energy is (J - 1)^2/D1, "quadratic" with K = 2/D1; that of Arruda and Boyce
    is ((J^2 - 1)/2 - ln J)/D, "simo-taylor" with K = 2/D.
    """
    flags = {key for key, value in card.options.items() if not value}
    known = ("NEO HOOKE", "MOONEY-RIVLIN", "YEOH", "OGDEN", "ARRUDA-BOYCE")
    kind = next((k for k in (*known, "REDUCED POLYNOMIAL", "POLYNOMIAL") if k in flags), "")
    others = flags - {kind, "ISOTROPIC", "ALL"}
    if others or (not kind and "N" not in card.options and flags):
        text = f"{', '.join(sorted(others)) or 'this kind'} is not there"
        deck.leave_out(place(card), text, "changes the answer")
        return {}
    order = _whole(card, "N", 1)
    c = floats(card)
    if kind == "OGDEN":
        keys, D, shear = _ogden(c, order)
    elif kind == "ARRUDA-BOYCE":
        mu, limit, D1 = (*c, 0.0, 0.0, 0.0)[:3]
        keys, D, shear = {"law": "arruda-boyce", "mu": stress(mu), "limit": limit}, [D1], mu
    elif kind in ("NEO HOOKE", "YEOH", "REDUCED POLYNOMIAL"):
        keys, D, shear = _reduced(c, _ORDERS.get(kind, order))
    else:
        keys, D, shear = _polynomial(c, 1 if kind == "MOONEY-RIVLIN" else order)
    if not keys:
        deck.leave_out(place(card), f"{kind} with N = {order} is not there", "changes the answer")
        return {}
    if any(D[1:]):
        text = "D2 and further ones: the volume has one constant, D1"
        deck.leave_out(place(card), text, "changes the answer")
    keys["volumetric"] = "simo-taylor" if kind == "ARRUDA-BOYCE" else "quadratic"
    if D[0]:
        keys["K"] = stress(2 / D[0])
        remarks.append(f"K = 2/D1 with D1 = {D[0]:g}")
    elif use.hybrid:
        keys["nu"] = 0.5
        remarks.append(_INCOMPRESSIBLE.format("incompressible"))
    else:
        keys["K"] = stress(20 * shear)
        text = "CalculiX takes 0.1/mu, nu = 0.475, and so does the case; Abaqus is incompressible"
        deck.leave_out(place(card), _INCOMPRESSIBLE.format(text))
    return keys


Kept = tuple[dict[str, object], list[float], float]
"""Keys of a law, its constants D, and its shear modulus as CalculiX has it for D1 = 0."""


def _padded(c: list[float], count: int) -> list[float]:
    return [*c, *[0.0] * count][:count]


def _reduced(c: list[float], order: int) -> Kept:
    """C10, C20, ..., D1, D2, ..."""
    c = _padded(c, 2 * order)
    C, D = c[:order], c[order:]
    if order == 1:
        return {"law": "neo-hookean-split", "mu": stress(2 * C[0])}, D, 2 * C[0]
    if order > 3:
        return {}, D, 0.0
    names = ("c10", "c20", "c30")
    moduli = {name: stress(value) for name, value in zip(names, _padded(C, 3), strict=True)}
    return {"law": "yeoh", **moduli}, D, 2 * C[0]


def _polynomial(c: list[float], order: int) -> Kept:
    """C10, C01, for N = 2 also C20, C11, C02; then D1, D2."""
    count = {1: 2, 2: 5}.get(order, 0)
    if not count:
        return {}, [0.0], 0.0
    c = _padded(c, count + order)
    C, D = c[:count], c[count:]
    if any(C[2:]):
        return ({}, D, 0.0) if C[1] or any(C[3:]) else _reduced([C[0], C[2], *D], 2)
    keys: dict[str, object] = {"law": "mooney-rivlin", "c10": stress(C[0]), "c01": stress(C[1])}
    return keys, D, 2 * (C[0] + C[1])


def _ogden(c: list[float], order: int) -> Kept:
    """mu1, alpha1, ..., D1, ...: with 2 mu/alpha^2 where ours is mu/alpha."""
    c = _padded(c, 3 * order)
    mu, alpha, D = c[0 : 2 * order : 2], c[1 : 2 * order : 2], c[2 * order :]
    if not all(alpha):
        return {}, D, 0.0
    terms = [stress(2 * m / a) for m, a in zip(mu, alpha, strict=True)]
    return {"law": "ogden", "mu": terms, "alpha": alpha}, D, sum(mu)
