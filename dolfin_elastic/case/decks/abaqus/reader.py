"""`read`: a deck of Abaqus or CalculiX, by a second table of words over the cards of its mesh.

Every keyword is carried over, is one of the mesh or of results, or is listed with its line.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from difflib import get_close_matches
from pathlib import Path

from dolfin_elastic.case.decks.abaqus import conditions, couplings, equations, steps
from dolfin_elastic.case.decks.abaqus.materials import (
    OTHER_LAWS,
    WITHOUT_EFFECT,
    Material,
    Use,
    floats,
    material_entry,
)
from dolfin_elastic.case.decks.abaqus.state import Reading
from dolfin_elastic.case.decks.abaqus.transforms import take_transform
from dolfin_elastic.case.decks.deck import Deck, Entry, Place
from dolfin_elastic.core.errors import MeshError, nearest
from dolfin_elastic.mesh.formats.abaqus.cards import Card, read_cards
from dolfin_elastic.mesh.formats.abaqus.deck import Deck as MeshDeck
from dolfin_elastic.mesh.formats.abaqus.deck import Scope
from dolfin_elastic.mesh.formats.abaqus.elements import element_kind, stem
from dolfin_elastic.mesh.formats.abaqus.reader import MESH_WORDS, read_abaqus, with_parts
from dolfin_elastic.mesh.formats.abaqus.words import SILENT
from dolfin_elastic.mesh.formats.raw import kind_name

PROGRAM = "Abaqus or CalculiX"
_OF_MATERIALS = frozenset(
    ("ELASTIC", "HYPERELASTIC", "PLASTIC", "DENSITY", "EXPANSION", *OTHER_LAWS, *WITHOUT_EFFECT)
)
_NOTES = {
    "CONTROLS": "settings of the solver are the case's own",
    "SOLVER": "settings of the solver are the case's own",
    "SOLUTION CONTROLS": "settings of the solver are the case's own",
    "TIME POINTS": "times of output are keys of [output] and [statics]",
    "PHYSICAL CONSTANTS": "solids have no need of them",
    "VALUES AT INFINITY": "solids have no need of them",
    "NODAL THICKNESS": "solids have none",
    "DISTRIBUTION TABLE": "it is of *DISTRIBUTION",
    "SURFACE INTERACTION": "it is of contact",
    "SURFACE BEHAVIOR": "it is of contact",
    "FRICTION": "it is of contact",
    "CLEARANCE": "it is of contact",
    "CONTACT OUTPUT": "it is of results",
    "FILTER": "it is of results",
    "INTEGRATED OUTPUT SECTION": "it is of results",
}
"""Keywords without which the answer is the same."""
_FAULTS = {
    "CONTACT PAIR": "state it as [[contact]] with `between`",
    "CONTACT": "state it as [[contact]]",
    "MPC": "equations between nodes are not there; where parts are joined, [[tie]]",
    "DISTRIBUTING COUPLING": 'state it as a load of kind "remote-force"',
    "DASHPOT": 'state it as a support of kind "dashpot"',
    "MASS": "a mass at a node: [[mass]] spreads one over a surface",
    "GAP": "state it as [[contact]]",
    "PRE-TENSION SECTION": 'state it as a load of kind "bolt"',
    "CYCLIC SYMMETRY MODEL": "cyclic symmetry is not there",
    "REFINE MESH": "CalculiX computes again on a finer mesh; here `converge` does so",
    "SUBMODEL": "driving nodes by another run is not there",
    "MODEL CHANGE": "parts that come or go are not there",
    "BASE MOTION": 'state it as a load of kind "base-acceleration"',
    "MODAL DAMPING": "it is of *MODAL DYNAMIC",
    "DFLUX": "heat is not computed",
    "FILM": "heat is not computed",
    "RADIATE": "heat is not computed",
    "CFLUX": "heat is not computed",
    "CHANGE MATERIAL": "materials that change in time are not there",
    "CHANGE PLASTIC": "materials that change in time are not there",
}
"""Keywords that change the answer, and what takes their place."""


def read(path: Path) -> Deck:
    """A deck of Abaqus or CalculiX. Not collective.

    Raises:
        MeshError: It is damaged, or its elements are none of the program's.
    """
    mesh = read_abaqus(path)
    for block in mesh.blocks:
        if stem(block.kind) in ("hexahedron", "wedge", "pyramid", "quad"):
            raise MeshError(
                f"{kind_name(block.kind)} are not supported",
                where=path.name,
                expected="mesh with tetrahedra, or with triangles in 2D",
            )
    state = Reading(Deck(PROGRAM, path.name), mesh, path.name)
    cards = list(_with_instances(path))
    for first in (True, False):  # *BOUNDARY may stand above the *COUPLING of its reference node
        for instance, card in cards:
            state.instance = instance
            if (card.word in _FOLLOWING) is first:
                _take_whole(state, card)
    state.finish_step()
    equations.tie(state)
    _finish(state)
    return state.deck


def _with_instances(path: Path) -> Iterator[tuple[str, Card]]:
    """The keywords of a deck, each with the instance in which it stands."""
    parts, instance = MeshDeck(), ""
    for card in with_parts(parts, read_cards(path)):
        if card.word == "INSTANCE":
            instance = card.option("NAME")
            parts.instances[instance.upper()] = Scope(instance)
        elif card.word in ("END INSTANCE", "END ASSEMBLY"):
            instance = ""
        yield instance, card


def _take_whole(state: Reading, card: Card) -> None:
    try:
        _take(state, card)
    except MeshError:
        raise
    except (ValueError, IndexError, OverflowError):
        raise card.error("one of its lines cannot be read") from None


def _take(state: Reading, card: Card) -> None:
    if card.word in _OF_MATERIALS or (card.word == "DAMPING" and state.material):
        if state.material is None:
            raise card.error("it stands outside of a material", expected="*MATERIAL above it")
        state.material.cards.append(card)
        _damping(state, card)
        return
    if card.word in _TAKE:
        _TAKE[card.word](state, card)
    elif card.word in _NOTES:
        state.note(card, _NOTES[card.word])
    elif card.word in _FAULTS:
        state.fault(card, _FAULTS[card.word])
    elif card.word.endswith(" SECTION"):
        state.fault(card, "these elements and their stiffness are left out")
    elif card.word not in SILENT and card.word not in MESH_WORDS:
        alike = get_close_matches(card.word, [*_TAKE, *_OF_MATERIALS], n=1)
        hint = f"; did you mean *{alike[0]}?" if alike else ""
        state.fault(card, f"this keyword is not known{hint}")


def _damping(state: Reading, card: Card) -> None:
    if card.word == "DAMPING" and state.material is not None:
        try:
            factors = [float(card.options.get(key, "0") or "0") for key in ("ALPHA", "BETA")]
        except ValueError:
            raise card.error("ALPHA or BETA is no number") from None
        if not all(map(math.isfinite, factors)):
            raise card.error("ALPHA or BETA is no finite number")
        state.damping[state.material.name] = factors[0], factors[1]
        if others := sorted(card.options.keys() - {"ALPHA", "BETA"}):
            state.fault(card, f"{', '.join(others)} is not understood")


# --- words of the model ---


def _heading(state: Reading, card: Card) -> None:
    state.deck.title = state.deck.title or (card.lines[0].strip() if card.lines else "")


def _elements(state: Reading, card: Card) -> None:
    state.types[card.option("TYPE").upper()] += len(card.lines)
    if card.option("TYPE").upper() == "SPRING1":
        state.grounded.setdefault(card.options.get("ELSET", "").upper(), []).append(card)
        return
    known = element_kind(card.option("TYPE").upper())
    if known is None or not card.lines:
        return
    low = stem(known[0]) in ("line", "vertex", "triangle") and state.dim == 3
    if low and not card.option("TYPE").upper().startswith(("SFM3D", "M3D", "S3", "R3D")):
        state.fault(card, f"elements {card.option('TYPE')}, which have no stiffness in the case")


def _material(state: Reading, card: Card) -> None:
    name = card.option("NAME")
    state.material = state.materials.setdefault(name.upper(), Material(name, card))


def _section(state: Reading, card: Card) -> None:
    for key in card.options.keys() - {"ELSET", "MATERIAL", "ORIENTATION", "CONTROLS"}:
        state.fault(card, f"{key} is not understood")
    region = state.name(card, "region", card.option("ELSET"))
    state.sections.append((card, region))
    thickness = floats(card, 0)[0] if card.lines and card.lines[0].strip(", ") else 0.0
    if state.dim == 2 and thickness:
        state.deck.mesh["thickness"] = thickness


def _orientation(state: Reading, card: Card) -> None:
    state.orientations[card.option("NAME").upper()] = card


def _amplitude(state: Reading, card: Card) -> None:
    state.amplitudes[card.option("NAME").upper()] = card


_TAKE: dict[str, Callable[[Reading, Card], None]] = {
    "HEADING": _heading,
    "ELEMENT": _elements,
    "MATERIAL": _material,
    "SOLID SECTION": _section,
    "ORIENTATION": _orientation,
    "AMPLITUDE": _amplitude,
    "TIE": conditions.take_tie,
    "SPRING": conditions.take_spring,
    "COUPLING": couplings.take_coupling,
    "TRANSFORM": take_transform,
    "EQUATION": equations.take_equation,
    "RIGID BODY": couplings.take_rigid_body,
    "KINEMATIC": couplings.take_kind,
    "DISTRIBUTING": couplings.take_kind,
    "INITIAL CONDITIONS": conditions.take_initial,
    "STEP": steps.begin_step,
    "END STEP": steps.end_step,
    **dict.fromkeys(
        ("BOUNDARY", "CLOAD", "DLOAD", "DSLOAD", "TEMPERATURE"), conditions.take_condition
    ),
    **dict.fromkeys((*steps.PROCEDURES, *steps.OTHER_ANALYSES), steps.take_procedure),
}
_FOLLOWING = frozenset(("COUPLING", "KINEMATIC", "DISTRIBUTING", "RIGID BODY", "EQUATION"))
"""Keywords that say which nodes are reference nodes."""


# --- what the whole deck says ---


def _assign(state: Reading) -> None:
    """Materials to sections, which may stand before them.

    Raises:
        MeshError: There is no such material or orientation.
    """
    for card, region in state.sections:
        name, orientation = card.option("MATERIAL"), card.options.get("ORIENTATION", "").upper()
        if name.upper() not in state.materials:
            known = [one.name for one in state.materials.values()]
            hint = nearest(name, known) if known else ""
            raise card.error(f"there is no material '{name[:60]}'", expected=hint)
        if orientation and orientation not in state.orientations:
            raise card.error(f"there is no *ORIENTATION '{orientation[:60]}'")
        state.materials[name.upper()].sections.append((region, orientation))


def _finish(state: Reading) -> None:
    """Elements and materials, which depend on all keywords."""
    _assign(state)
    for card in (card for cards in state.grounded.values() for card in cards):
        state.fault(card, "no *SPRING below it has its ELSET, and so its springs no stiffness")
    hybrid = _mesh(state)
    large = any(step.nonlinear or step.preloaded for step in state.deck.steps)
    rubber = any(c.word == "HYPERELASTIC" for m in state.materials.values() for c in m.cards)
    if rubber:
        for step in state.deck.steps:
            if step.kind in ("statics", "dynamics") and not step.nonlinear:
                text = "without NLGEOM; hyperelastic bodies have large strains, as in CalculiX"
                state.deck.leave_out(step.place, text)
                step.nonlinear = large = True
    for material in state.materials.values():
        if not material.sections:
            state.note(material.card, f"no section has the material {material.name[:60]}")
            continue
        entry = material_entry(state.deck, material, Use(large, hybrid))
        _place_material(state, material, entry)
    if not any(material.sections for material in state.materials.values()):
        text = "no *SOLID SECTION gives elements a material"
        state.deck.leave_out(Place(state.file, 0), text, "changes the answer")


def _mesh(state: Reading) -> bool:
    """Keys of [mesh] that follow from the types of elements; whether these are hybrid."""
    solid = [name for name in state.types if _is_solid(name, state.dim)]
    hybrid = [name for name in solid if "H" in name[3:].lstrip("D")]
    quadratic = any(element_kind(name) in _QUADRATIC for name in solid)
    state.deck.mesh |= {
        "degree": 2 if quadratic else 1,
        "formulation": "mixed" if hybrid and quadratic else "displacement",
    }
    if hybrid and len(hybrid) < len(solid):
        text = f"{', '.join(hybrid)} beside others: all elements have a pressure of their own"
        state.deck.leave_out(Place(state.file, 0), text)
    for name in solid:
        if "M" in name[3:]:
            text = f"{name}: {name.replace('M', '')} is used, a quadratic element without lumping"
            state.deck.leave_out(Place(state.file, 0), text)
        if name.endswith("H") and not quadratic:
            text = f"{name}: linear elements have no pressure of their own here"
            state.deck.leave_out(Place(state.file, 0), text, "changes the answer")
    planes = {_PLANES[name[:3]] for name in solid if name[:3] in _PLANES}
    if state.dim == 2 and planes:
        state.deck.mesh["geometry"] = sorted(planes)[0]
        if len(planes) > 1:
            text = f"{', '.join(sorted(planes))} in one body"
            state.deck.leave_out(Place(state.file, 0), text, "changes the answer")
    return bool(hybrid)


_PLANES = {"CPS": "plane-stress", "CPE": "plane-strain", "CAX": "axisymmetric"}
_QUADRATIC = (("tetra10", 10), ("triangle6", 6))


def _is_solid(name: str, dim: int) -> bool:
    known = element_kind(name)
    return known is not None and stem(known[0]) == ("tetra" if dim == 3 else "triangle")


def _place_material(state: Reading, material: Material, entry: Entry) -> None:
    """The material where its sections are, one table for each orientation."""
    by_axes: dict[str, list[str]] = {}
    for region, orientation in material.sections:
        turned = orientation if entry.keys.get("law") == "orthotropic" else ""
        by_axes.setdefault(turned, []).append(region)
    for orientation, regions in by_axes.items():
        axes = _axes(state, state.orientations[orientation]) if orientation else {}
        on = list(dict.fromkeys(regions))
        keys = {**entry.keys, **axes, "on": on[0] if len(on) == 1 else on}
        name = material.name if len(by_axes) == 1 else f"{material.name} {orientation}".strip()
        state.deck.materials[name] = Entry(entry.place, keys, entry.remark)


def _axes(state: Reading, card: Card) -> dict[str, object]:
    """Directions of the material's axes: rectangular, by two points a and b."""
    system = card.options.get("SYSTEM", card.options.get("DEFINITION", "RECTANGULAR")).upper()
    numbers = floats(card, 0) if card.lines else []
    others = set(card.options) - {"NAME", "SYSTEM"}
    turned = len(card.lines) > 1 and any(floats(card, 1)[1:2])
    if system != "RECTANGULAR" or others or turned or len(numbers) < 6 or any(numbers[6:]):
        state.fault(card, "only rectangular axes by two points are read")
        return {}
    return {"axis1": numbers[:3], "axis2": numbers[3:6]}
