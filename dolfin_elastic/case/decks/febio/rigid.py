"""Rigid bodies of FEBio as rigid surfaces: their parts of the mesh, and nodes joined to them.

A part of a rigid material keeps its place in the mesh: its boundary is a rigid surface.  Sources:
FEBio User Manual, version 4, section 3.9 (rigid constraints and loads), for the words "fix",
"prescribe" and "force" that of version 3; section 4.1.6 (rigid body).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from dolfin_elastic.case.decks.coupling import ALL, Coupling
from dolfin_elastic.case.decks.deck import Deck, Entry, Quantity, Step
from dolfin_elastic.case.decks.febio.materials import RIGID
from dolfin_elastic.case.decks.febio.values import (
    Amount,
    Clock,
    flag,
    named_part,
    numbers,
    place,
)
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.febio.reader import read_febio
from dolfin_elastic.mesh.formats.febio.tags import Tag
from dolfin_elastic.mesh.formats.raw import boundary

_MOTIONS: dict[str, int | None] = {"rigid_displacement": 1, "rigid_rotation": 4, "prescribe": None}
_FORCES: dict[str, int | None] = {"rigid_force": 1, "rigid_moment": 4, "force": None}
"""Word to the first of its directions, 1 to 6; None: x to z and u to w name all six."""
_AXES = "xyzuvw"


@dataclass
class _Body:
    """One rigid body.

    Attributes:
        tag: Its material.
        parts: Names of its parts of the mesh.
        sets: Names of the sets of nodes that are joined to it.
        motion: Direction, 1 to 6, to its displacement or rotation.
        forces: Direction to its force or moment.
    """

    tag: Tag
    parts: list[str]
    sets: list[str] = field(default_factory=list)
    motion: dict[int, Amount] = field(default_factory=dict)
    forces: dict[int, Amount] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """That of its material."""
        return self.tag.attributes.get("name") or f"material {self.tag.attributes.get('id', '')}"


class Bodies:
    """All rigid bodies of a model.

    Args:
        path: The file of the model, whose mesh has the centres of mass.
        parts: Name or number of a material to the names of its parts.
    """

    def __init__(self, root: Tag, path: Path, deck: Deck, parts: Mapping[str, list[str]]) -> None:
        self._path, self._deck = path, deck
        self._named = [name for every in parts.values() for name in every]
        self._bodies = dict[str, _Body]()
        for section in root.all("Material"):
            for tag in section.all("material"):
                if tag.attributes.get("type") == RIGID:
                    keys = [tag.attributes.get(key, "") for key in ("name", "id")]
                    one = _Body(tag, [p for key in dict.fromkeys(keys) for p in parts.get(key, ())])
                    self._bodies |= dict.fromkeys(filter(None, keys), one)

    def _leave_out(self, tag: Tag, text: str) -> None:
        self._deck.leave_out(place(tag), text, "changes the answer")

    def _of(self, tag: Tag) -> _Body | None:
        word = tag.attributes.get("rb") or tag.content("rb")
        if word not in self._bodies:
            self._leave_out(tag, f"there is no material '{word[:40]}' of type '{RIGID}'")
        return self._bodies.get(word)

    def attach(self, tag: Tag) -> None:
        """Joins a set of nodes to a body."""
        if (body := self._of(tag)) is not None:
            body.sets.append(named_part(tag, "node_set"))

    def take(self, section: Tag, clock: Clock) -> None:
        """Takes in a section <Rigid>."""
        for tag in section.children:
            kind = tag.attributes.get("type", "")
            if kind in ("rigid_fixed", "fix"):
                self._fix(tag, kind)
            elif kind in _MOTIONS or kind in _FORCES:
                self._prescribe(tag, kind, clock)
            elif kind == "rigid_rotation_vector":
                if (body := self._of(tag)) is not None:
                    for i, name in enumerate(("vx", "vy", "vz"), start=4):
                        value = tag.first(name)
                        amount = clock.amount(tag, [(value, 1)]) if value else _ZERO
                        self._hold(tag, body, i, amount)
            else:
                self._leave_out(tag, f"'{kind[:40]}' of rigid bodies is not known here")

    def _fix(self, tag: Tag, kind: str) -> None:
        if (body := self._of(tag)) is None:
            return
        words = tag.content("dofs").replace(",", " ").split()
        if kind == "rigid_fixed":
            switches = [child.name for child in tag.children if child.name.endswith("_dof")]
            words = [name.removesuffix("_dof") for name in switches if flag(tag, name)]
        for word in words:
            self._hold(tag, body, self._direction(tag, word, None), _ZERO)

    def _hold(self, tag: Tag, body: _Body, i: int, amount: Amount) -> None:
        """Prescribes a displacement or rotation, once."""
        if body.motion.setdefault(i, amount) != amount:
            text = f"direction R{_AXES[i - 1]} of '{body.name[:40]}' is prescribed twice"
            self._leave_out(tag, f"{text}, in different ways")

    def _direction(self, tag: Tag, word: str, first: int | None) -> int:
        """Number of a direction, such as Rx, x or Ru.

        Args:
            first: Of three directions; None: all six are possible.
        """
        letter = word.removeprefix("R")
        if letter not in tuple(_AXES):
            raise tag.error(f"'{word[:40]}' is no direction", "Rx, Ry, Rz, Ru, Rv or Rw")
        i = _AXES.index(letter)
        return i + 1 if first is None else first + i % 3

    def _prescribe(self, tag: Tag, kind: str, clock: Clock) -> None:
        body = self._of(tag)
        if flag(tag, "relative") or tag.content("load_type", "0") not in ("0", "LOAD"):
            self._leave_out(tag, "a value that is relative, or that turns with the body")
        elif body is not None:
            first = {**_MOTIONS, **_FORCES}[kind]
            i = self._direction(tag, tag.content("dof"), first)
            amount = clock.amount(tag, [(tag.first("value"), 1), (tag.first("scale"), 1)])
            if kind in _MOTIONS:
                self._hold(tag, body, i, amount)
                return
            before = body.forces.get(i, Amount([0.0], amount.ramp))
            if before.ramp != amount.ramp:
                self._leave_out(tag, "its forces change over time in different ways")
            body.forces[i] = Amount([before.values[0] + amount.values[0]], amount.ramp)

    # --- what they are in a case ---

    def finish(self, step: Step | None) -> None:
        """Adds the rigid surfaces to the analysis of the model."""
        for body in {id(one): one for one in self._bodies.values()}.values():
            if step is None and body.parts:
                self._leave_out(body.tag, "a rigid body without an analysis")
            elif step is not None and (body.parts or body.sets):
                self._add(body, step)

    def _add(self, body: _Body, step: Step) -> None:
        on, where = list(body.sets), place(body.tag)
        if any(part not in self._cells[1] for part in body.parts):
            self._leave_out(body.tag, "a rigid part without tetrahedra")
            return
        if body.parts:
            on.append(f"{body.name} surface")
            selectors = [one for part in body.parts for one in self._boundary(part)]
            self._deck.surfaces[on[-1]] = Entry(where, {"any": selectors})
            self._fill(body)
        one = Coupling(where, on[0] if len(on) == 1 else on, None, kind="KINEMATIC")
        one.moved = {i: a.values[0] for i, a in body.motion.items()}
        if not one.still:
            self._move(body, step, one)
        step.supports += filter(None, [one.support()])

    def _move(self, body: _Body, step: Step, one: Coupling) -> None:
        """Forces, the point where they act, and the change over time of a body that moves."""
        if step.kind != "statics" and len(body.motion) < ALL:
            self._leave_out(body.tag, "a rigid body that moves freely exists in statics only")
        acting = {i: a for i, a in body.forces.items() if i not in body.motion}
        ramps = {a.ramp for a in (*body.motion.values(), *acting.values()) if any(a.values)}
        if len(ramps) > 1:
            self._leave_out(body.tag, "its motions and forces change over time in different ways")
        one.forces = {i: a.values[0] for i, a in acting.items()}
        one.ramp = next(iter(ramps), None)
        if any(one.moved.get(i, 1.0) for i in (4, 5, 6)):
            one.point = self._centre(body)

    def _fill(self, body: _Body) -> None:
        """A law for the elements of a body: none of them is strained."""
        others = [one.keys for one in self._deck.materials.values()]
        if not others:
            self._leave_out(body.tag, "a rigid body alone, without one that deforms")
            return
        density = body.tag.first("density")
        value = Quantity(1.0 if density is None else numbers(density, 1)[0], "density")
        on = body.parts[0] if len(body.parts) == 1 else body.parts
        keys = {**others[0], "density": value, "on": on}
        remark = "rigid by its surface; the law is that of another part, and has no strain"
        self._deck.materials[body.name] = Entry(place(body.tag), keys, remark)

    @cached_property
    def _cells(self) -> tuple[FloatArray, dict[str, IntArray]]:
        """Coordinates of the nodes, and name of each part to the rows of its corners."""
        mesh, result = read_febio(self._path), dict[str, IntArray]()
        for block in mesh.blocks:
            if block.dim == 3:
                result |= {n: block.nodes[rows, :4] for n, rows in block.parts.items()}
        return mesh.points, result

    @cached_property
    def _faces(self) -> dict[str, set[tuple[int, ...]]]:
        """Name of each part to the faces that it does not share with itself, by their corners."""
        _, cells = self._cells
        return {
            name: {tuple(map(int, face)) for face in boundary([cells[name]])}
            for name in self._named
            if name in cells
        }

    def _boundary(self, part: str) -> Iterator[Mapping[str, object]]:
        """Selectors of the faces of a part: outer ones, and those to parts that deform."""
        faces = dict(self._faces)
        own = faces.pop(part)
        rigid = {name for body in self._bodies.values() for name in body.parts}
        touching = [name for name in faces if name not in rigid and faces[name] & own]
        yield from ({"between": [part, name]} for name in touching)
        if not touching or own.difference(*faces.values()):
            yield {"of": part, "all": True}

    def _centre(self, body: _Body) -> list[float]:
        """Its centre of mass, about which it turns and on which forces act."""
        if (given := body.tag.first("center_of_mass")) is not None:
            return numbers(given, 3)
        if not body.parts:
            raise body.tag.error("the body has no elements and no <center_of_mass>")
        points, cells = self._cells
        x = points[np.concatenate([cells[part] for part in body.parts])]
        volumes = np.abs(np.linalg.det(x[:, 1:] - x[:, :1]))
        return [float(c) for c in volumes @ x.mean(axis=1) / volumes.sum()]


_ZERO = Amount([0.0], None)
