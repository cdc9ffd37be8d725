"""`read`: an FEBio model as a `Deck`; the sections that it does not understand are listed."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from dolfin_elastic.case.decks.deck import Deck, Quantity, Step
from dolfin_elastic.case.decks.febio.actions import (
    take_boundary,
    take_constraints,
    take_contact,
    take_loads,
)
from dolfin_elastic.case.decks.febio.materials import take_materials
from dolfin_elastic.case.decks.febio.rigid import Bodies
from dolfin_elastic.case.decks.febio.values import Clock, curves, numbers, place
from dolfin_elastic.mesh.formats.febio.reader import elements_of, name_of
from dolfin_elastic.mesh.formats.febio.tags import Tag, read_tags

_OF_THE_MESH = ("Mesh", "Geometry", "MeshDomains")
_NOTHING = ("Module", "Globals", "LoadData", "Output", "Material", "Control", "Step", *_OF_THE_MESH)
_UNITS = {"SI": "m-kg-s", "mm-N-s": "mm-t-s"}
_ACTIONS = ("Boundary", "Loads", "Contact", "Constraints", "Rigid")


def read(path: Path) -> Deck:
    """An FEBio model of the module "solid". Not collective.

    Raises:
        MeshError: It is damaged, or of a specification that is not read.
    """
    root = read_tags(path)
    deck = Deck("FEBio", path.name)
    _module(root, deck)
    parts = _parts(root, deck)
    take_materials(root, deck, parts)
    _steps(root, deck, Bodies(root, path, deck, parts))
    return deck


def _module(root: Tag, deck: Deck) -> None:
    module = root.first("Module")
    kind = "solid" if module is None else module.attributes.get("type", "solid")
    if module is not None and kind != "solid":
        text = f"the module '{kind[:40]}': here solids alone are computed"
        deck.leave_out(place(module), text, "changes the answer")
    if module is not None and (units := module.content("units")):
        deck.units = _UNITS.get(units, "")
        if not deck.units:
            deck.leave_out(place(module), f"the units '{units[:40]}' are not known: give --units")
    for section in root.children:
        if section.name not in (*_NOTHING, *_ACTIONS) and section.children:
            text = f"the section <{section.name[:40]}>"
            deck.leave_out(place(section), text, "changes the answer")


def _parts(root: Tag, deck: Deck) -> dict[str, list[str]]:
    """Name or number of each material to the parts of the mesh that have it."""
    result = dict[str, list[str]]()
    lists = [e for s in root.all("Mesh", "Geometry") for e in s.all("Elements")]
    kinds = {kind: tag for tag in lists for kind, _ in elements_of(tag)}
    for tag in lists:
        if (material := tag.attributes.get("mat")) is not None:
            result.setdefault(material, []).append(name_of(tag))
    for section in root.all("MeshDomains"):
        for tag in section.children:
            name, material = (tag.attributes.get(key, "") for key in ("name", "mat"))
            result.setdefault(material, []).append(name)
            if tag.name != "SolidDomain":
                text = f"'{name}' is no solid: it has no stiffness here"
                deck.leave_out(place(tag), text, "changes the answer")
            if tag.attributes.get("type", "") == "ut4-solid":
                kinds["ut4"] = tag
    _displacements(deck, kinds)
    return result


def _displacements(deck: Deck, kinds: dict[str, Tag]) -> None:
    """Elements as FEBio has them: their answer is another one than that of finer ones.

    Args:
        kinds: Type of the elements that there are, "ut4" for the averaged ones, to a tag.
    """
    if (averaged := kinds.get("ut4")) is not None:
        text = "nodally averaged strains (ut4); here displacements are quadratic on the same mesh"
        deck.leave_out(place(averaged), text, "changes the answer")
        return
    deck.mesh["formulation"] = "displacement"
    if (linear := kinds.get("tet4")) is not None:
        deck.mesh["degree"] = 1
        deck.leave_out(
            place(linear),
            "linear tetrahedra are too stiff: without the keys degree and formulation of [mesh] "
            "displacements are quadratic",
        )


def _pairs(root: Tag) -> dict[str, tuple[str, str]]:
    """Name of each pair of surfaces to both of them."""
    result = dict[str, tuple[str, str]]()
    for section in root.all("Mesh", "Geometry"):
        for tag in section.all("SurfacePair"):
            names = [
                child.text or child.attributes.get("surface", "")
                for words in (("primary", "master"), ("secondary", "slave"))
                for child in tag.all(*words)
            ]
            if len(names) == 2:
                result[tag.attributes.get("name", "")] = names[0], names[1]
    return result


def _steps(root: Tag, deck: Deck, bodies: Bodies) -> None:
    """One analysis from all steps, whose supports and loads must act in each of them."""
    stages = [s for section in root.all("Step") for s in (*section.all("step"), section)]
    idle = [s for s in stages if s.first("Control") is None and s.first("step") is None]
    for stage in idle:
        if any(section.children for section in stage.all(*_ACTIONS)):
            text = "a step without <Control>, and what it states"
            deck.leave_out(place(stage), text, "changes the answer")
    stages = [s for s in stages if s.first("Control") is not None]
    controls = [c for owner in (root, *stages) for c in owner.all("Control")]
    if not controls:
        bodies.finish(None)
        return
    spans = [_span(control) for control in controls]
    kinds = {_kind(control, deck) for control in controls}
    if len(kinds) > 1:
        deck.leave_out(place(controls[0]), "statics and motion in one model", "changes the answer")
    motion, end = "dynamics" in kinds, sum(spans)
    clock = Clock(deck, curves(root, deck), end, motion)
    step = Step("dynamics" if motion else "statics", place(controls[0]), nonlinear=True)
    if motion:
        step.settings |= _motion(controls[0], end)
    pairs = _pairs(root)
    _take_actions(root.children, clock, step, pairs, bodies)
    for stage in stages:
        if len(stages) == 1:
            _take_actions(stage.children, clock, step, pairs, bodies)
        for section in stage.children:
            of_one = section.name in _ACTIONS and len(stages) > 1 and section.children
            if of_one or section.name not in (*_ACTIONS, "Control"):
                text = f"<{section.name[:40]}> in one of several steps"
                deck.leave_out(place(section), text, "changes the answer")
    bodies.finish(step)
    deck.steps.append(step)


def _take_actions(
    sections: Iterable[Tag],
    clock: Clock,
    step: Step,
    pairs: dict[str, tuple[str, str]],
    bodies: Bodies,
) -> None:
    for section in sections:
        if section.name == "Boundary":
            take_boundary(section, clock, step, bodies)
        elif section.name == "Loads":
            take_loads(section, clock, step)
        elif section.name == "Contact":
            take_contact(section, clock, pairs)
        elif section.name == "Constraints":
            take_constraints(section, clock, step)
        elif section.name == "Rigid":
            bodies.take(section, clock)


def _span(control: Tag) -> float:
    """How long a step is."""
    count, size = control.first("time_steps"), control.first("step_size")
    if count is None or size is None:
        raise control.error("there is no <time_steps> or no <step_size>")
    span = numbers(count, 1)[0] * numbers(size, 1)[0]
    if not span > 0:
        raise control.error("the analysis has no length")
    return span


def _kind(control: Tag, deck: Deck) -> str:
    tag = control.first("analysis")
    word = "" if tag is None else (tag.text or tag.attributes.get("type", ""))
    if word.lower() in ("", "static", "0", "steady-state"):
        return "statics"
    if word.lower() not in ("dynamic", "1"):
        deck.leave_out(place(control), f"the analysis '{word[:40]}'", "changes the answer")
    return "dynamics"


def _motion(control: Tag, end: float) -> dict[str, object]:
    size = control.first("step_size")
    assert size is not None
    solver = control.first("solver")
    rho = (solver or control).first("rhoi")
    radius = numbers(rho, 1)[0] if rho is not None else -1.0
    return {
        "end": Quantity(end, "time"),
        "dt": Quantity(numbers(size, 1)[0], "time"),
        "spectral_radius": radius if 0 <= radius <= 1 else 1.0,
    }
