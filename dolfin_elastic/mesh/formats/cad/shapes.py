"""STEP, IGES and BREP files in Gmsh: faces are sewn into solids, bodies joined and named."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from types import ModuleType

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.formats.cad.face_names import face_names
from dolfin_elastic.mesh.formats.raw import format_points

Entity = tuple[int, int]
"""Dimension and tag in Gmsh."""

_FORMATS = {
    ".step": "step",
    ".stp": "step",
    ".iges": "iges",
    ".igs": "iges",
    ".brep": "brep",
}
_GAPS = 1e-6, 1e-4
"""Gaps that sewing closes, over the diagonal: round-off, and then those of careless export."""
_ALMOST = 0.01
"""Distance over the diagonal up to which bodies almost touch, where a gap may be a mistake."""
_NEAR = 1e-6
"""Distance over the diagonal below which two faces are the same."""
_NAMELESS = ("Open CASCADE STEP translator", "COMPOUND", "SOLID", "SHELL")
"""Begin of the names that OpenCASCADE gives to parts without one."""


@dataclass(frozen=True)
class Lengths:
    """Lengths of Gmsh's model in messages: in the unit that the user knows.

    Attributes:
        name: The user's unit.
        factor: User's units per unit of the model.
    """

    name: str
    factor: float

    def text(self, value: float, dim: int) -> str:
        """A length, area or volume.

        Args:
            value: In units of the model.
            dim: 1, 2 or 3.
        """
        power = f"^{dim}" if dim > 1 else ""
        return f"{value * self.factor**dim:.3g} {self.name}{power}"

    def near(self, coordinates: Sequence[Sequence[float]]) -> str:
        """Places of the model, shape (n, 3)."""
        return format_points(np.multiply(coordinates, self.factor), len(coordinates), self.name)


@dataclass
class Remarks:
    """What is worth saying about a file.

    Attributes:
        information: How its shapes were taken.
        notes: What is doubtful.
    """

    information: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def import_shapes(gmsh: ModuleType, path: Path, *, join: bool, lengths: Lengths) -> Remarks:
    """Loads a file into the current model, and names its bodies as physical groups. Local.

    Args:
        gmsh: Gmsh with an empty model.
        join: Bodies that touch share their faces afterwards.

    Raises:
        MeshError: Its faces enclose no solid.
    """
    remarks = Remarks()
    load_shapes(gmsh, path)
    faces, lost = face_names(gmsh, path, 1 / lengths.factor)
    remarks.notes += lost
    if not gmsh.model.getEntities(3) and gmsh.model.getEntities(2) and not _is_flat(gmsh):
        remarks.information += _sew(gmsh, path.name, lengths)
    bodies = gmsh.model.getEntities(3) or gmsh.model.getEntities(2)
    names = {body: _name(gmsh, body) for body in bodies}
    if len(bodies) > 1:
        names = {body: name or f"body{body[1]}" for body, name in names.items()}
        if join:
            names, faces = _join(gmsh, names, faces, remarks, lengths)
        else:
            remarks.notes += touching(gmsh, lengths, "mesh.join = true joins them")
    _add_groups(gmsh, names)
    _add_groups(gmsh, faces)
    return remarks


def _add_groups(gmsh: ModuleType, names: Mapping[Entity, str]) -> None:
    """Makes physical groups of entities of one dimension by their names, one in each line."""
    for name in dict.fromkeys(n for lines in names.values() for n in lines.split("\n") if n):
        entities = [entity for entity, lines in names.items() if name in lines.split("\n")]
        gmsh.model.addPhysicalGroup(entities[0][0], [tag for _, tag in entities], name=name)


def load_shapes(gmsh: ModuleType, path: Path) -> None:
    """Loads a file into the current model as it is. Local.

    Args:
        gmsh: Gmsh with an empty model.
    """
    gmsh.model.occ.importShapes(
        str(path), highestDimOnly=False, format=_FORMATS[path.suffix.lower()]
    )
    gmsh.model.occ.synchronize()


def _name(gmsh: ModuleType, body: Entity) -> str:
    """The part's name: the last of "Shapes/assembly/instance/part"; empty without one."""
    name = str(gmsh.model.getEntityName(*body)).rpartition("/")[2]
    return "" if name.startswith(_NAMELESS) else name


def _group(gmsh: ModuleType, body: Entity) -> str:
    """The first physical group of a script that a body is in; empty without one that has a name."""
    groups = gmsh.model.getPhysicalGroupsForEntity(*body)
    return next(filter(None, (gmsh.model.getPhysicalName(body[0], int(g)) for g in groups)), "")


# --- faces into solids ---


def diagonal(gmsh: ModuleType) -> float:
    """Diagonal of the model's bounding box."""
    box = np.array(gmsh.model.getBoundingBox(-1, -1))
    return float(np.linalg.norm(box[3:] - box[:3]))


def _is_flat(gmsh: ModuleType) -> bool:
    box = gmsh.model.getBoundingBox(-1, -1)
    return bool(box[5] - box[2] <= 1e-6 * diagonal(gmsh))


def _sew(gmsh: ModuleType, source: str, lengths: Lengths) -> list[str]:
    """Sews faces into solids, or refuses those that enclose none; how it was done."""
    occ, faces = gmsh.model.occ, gmsh.model.getEntities(2)
    edges = _edges(gmsh)
    groups = _connected(faces, edges.values())
    if len(groups) > 1:
        # Bodies that touch have edges between more than two faces, where sewing would fail.
        for group in groups:
            with suppress(Exception):  # what remains open is found below
                occ.addVolume([occ.addSurfaceLoop([tag for _, tag in group], sewing=True)])
                occ.remove(group, recursive=True)
        occ.synchronize()
    closed = ""
    for gap in _GAPS:
        if not gmsh.model.getEntities(3):
            closed = f", gaps of up to {lengths.text(gap * diagonal(gmsh), 1)} closed"
            occ.healShapes(
                [],
                gap * diagonal(gmsh),
                fixSmallEdges=False,
                fixSmallFaces=False,
                sewFaces=True,
                makeSolids=True,
            )
            occ.synchronize()
    solids = len(gmsh.model.getEntities(3))
    loose = sum(not len(gmsh.model.getAdjacencies(*face)[0]) for face in gmsh.model.getEntities(2))
    if not solids or loose:
        free = [place[:3] for place, around in edges.items() if len(around) == 1]
        near = _NEAR * diagonal(gmsh)
        where = lengths.near([[n * near for n in place] for place in free])
        raise MeshError(
            f"its {len(faces)} faces enclose no solid"
            + (f": {len(free)} edges belong to one face only, {where}" if free else ""),
            where=source,
            expected="add the missing faces in the CAD program, or save the solid as STEP",
        )
    return [f"{len(faces)} faces sewn into {solids} solid{'s' if solids > 1 else ''}{closed}"]


def _edges(gmsh: ModuleType) -> dict[tuple[int, ...], list[Entity]]:
    """Place (middle and extent, over the tolerance) of each edge, to the faces that have one there.

    The seam of a cylinder is there twice.
    """
    near = _NEAR * diagonal(gmsh)
    result: dict[tuple[int, ...], list[Entity]] = {}
    for face in gmsh.model.getEntities(2):
        for edge in gmsh.model.getBoundary([face], combined=False, oriented=False):
            box = np.array(gmsh.model.occ.getBoundingBox(*edge))
            place = (*gmsh.model.occ.getCenterOfMass(*edge), *(box[3:] - box[:3]))
            result.setdefault(tuple(np.round(np.array(place) / near).astype(int)), []).append(face)
    return result


def _connected(faces: Sequence[Entity], edges: Iterable[Sequence[Entity]]) -> list[list[Entity]]:
    """Groups of faces that are connected by edges, of which each is given by its faces."""
    group = {face: face for face in faces}

    def root(face: Entity) -> Entity:
        while group[face] != face:
            face = group[face]
        return face

    for around in edges:
        for face in around[1:]:
            group[root(face)] = root(around[0])
    members: dict[Entity, list[Entity]] = {}
    for face in faces:
        members.setdefault(root(face), []).append(face)
    return list(members.values())


# --- bodies that touch ---


def _join(
    gmsh: ModuleType,
    names: Mapping[Entity, str],
    faces: Mapping[Entity, str],
    remarks: Remarks,
    lengths: Lengths,
) -> tuple[dict[Entity, str], dict[Entity, str]]:
    """Makes the bodies share the faces where they touch (BooleanFragments).

    Returns:
        Names of bodies and of faces afterwards; what two had in common has both, in two lines.
    """
    parents, dim = list(names), next(iter(names))[0]
    result: dict[Entity, list[str]] = {}
    of_faces: dict[Entity, list[str]] = {}
    coordinates = {face: _place(gmsh, face) for face in faces}
    parts = _fragments(gmsh, parents, list(faces))
    for parent, children in zip(parents, parts, strict=False):
        for child in children:
            result.setdefault(child, []).append(names[parent])
    after = {face: _place(gmsh, face) for face in gmsh.model.getEntities(2)} if faces else {}
    near = _NEAR * diagonal(gmsh)
    for parent, children in zip(faces, parts[len(parents) :], strict=True):
        # Of a face that stays as it is Gmsh may say nothing: it is found where it was.
        same = [f for f, at in after.items() if np.abs(at - coordinates[parent]).max() <= near]
        for child in children or same:
            of_faces.setdefault(child, []).append(faces[parent])
    for child, owners in result.items():
        if len(owners) > 1:
            size = gmsh.model.occ.getMass(*child)
            remarks.notes.append(
                f"{_listed(owners)} overlap by {lengths.text(size, dim)}: that part belongs to both"
            )
    joined = [
        f"{_listed(pair)} ({lengths.text(area, dim - 1)})"
        for pair, area, _ in _shared(gmsh, result)
        if pair[0] != pair[1]  # a body and its part that overlaps another one
    ]
    if joined:
        remarks.information.append(f"bodies that touch are joined: {', '.join(joined)}")
    remarks.notes += _gaps(gmsh, result, lengths)
    return _lines(result), _lines(of_faces)


def _lines(result: Mapping[Entity, Sequence[str]]) -> dict[Entity, str]:
    return {entity: "\n".join(dict.fromkeys(names)) for entity, names in result.items()}


def _place(gmsh: ModuleType, face: Entity) -> FloatArray:
    """Middle of a face, and the root of its area."""
    occ = gmsh.model.occ
    return np.array([*occ.getCenterOfMass(*face), occ.getMass(*face) ** 0.5])


def _fragments(
    gmsh: ModuleType, bodies: Sequence[Entity], faces: Sequence[Entity] = ()
) -> list[list[Entity]]:
    """Splits bodies and faces at one another; for each of them its parts."""
    entities = [*bodies, *faces]
    _, parts = gmsh.model.occ.fragment(entities[:1], entities[1:])
    gmsh.model.occ.synchronize()
    return [
        [part for part in of_one if part[0] == entity[0]]
        for entity, of_one in zip(entities, parts, strict=True)
    ]


def _gaps(gmsh: ModuleType, names: Mapping[Entity, Sequence[str]], lengths: Lengths) -> list[str]:
    """Notes on bodies that almost touch: no shared face joins them, nor one of others."""
    dim, most = next(iter(names))[0], _ALMOST * diagonal(gmsh)
    around = [
        [(dim, int(tag)) for tag in gmsh.model.getAdjacencies(*face)[0]]
        for face in gmsh.model.getEntities(dim - 1)
    ]
    groups = _connected(list(names), [[b for b in owners if b in names] for owners in around])
    of = {body: number for number, group in enumerate(groups) for body in group}
    boxes = {body: np.array(gmsh.model.getBoundingBox(*body)) for body in names}
    nearest: dict[tuple[int, int], tuple[float, list[str]]] = {}
    for a, b in combinations(names, 2):
        apart = np.maximum(boxes[a][:3] - boxes[b][3:], boxes[b][:3] - boxes[a][3:])
        if of[a] == of[b] or np.linalg.norm(np.maximum(apart, 0.0)) > most:
            continue
        distance = float(gmsh.model.occ.getDistance(*a, *b)[0])
        pair = (of[a], of[b])
        if distance <= most and distance < nearest.get(pair, (np.inf, []))[0]:
            nearest[pair] = distance, [names[a][0], names[b][0]]
    return [
        f"{_listed(pair)} are {lengths.text(distance, 1)} apart and not joined, so that each moves "
        "on its own: close the gap in the CAD program, or tie their surfaces by [[tie]]"
        for distance, pair in nearest.values()
    ]


def _listed(names: Sequence[str]) -> str:
    return " and ".join(f"'{name}'" for name in names)


def _shared(
    gmsh: ModuleType, names: Mapping[Entity, Sequence[str]]
) -> list[tuple[tuple[str, ...], float, tuple[float, ...]]]:
    """Pairs of bodies with the area that they share and a place on it."""
    areas: dict[tuple[str, ...], float] = {}
    coordinates: dict[tuple[str, ...], tuple[float, ...]] = {}
    dim = next(iter(names))[0]
    for face in gmsh.model.getEntities(dim - 1):
        owners = [(dim, tag) for tag in gmsh.model.getAdjacencies(*face)[0]]
        pair = tuple(sorted(names[owner][0] for owner in owners if owner in names))
        if len(pair) == 2:
            areas[pair] = areas.get(pair, 0.0) + gmsh.model.occ.getMass(*face)
            coordinates.setdefault(pair, tuple(gmsh.model.occ.getCenterOfMass(*face)))
    return [(pair, area, coordinates[pair]) for pair, area in areas.items()]


def touching(gmsh: ModuleType, lengths: Lengths, advice: str) -> list[str]:
    """Notes on bodies of the current model that touch without sharing a face. Local.

    A copy of the bodies is joined: what they share then and not before is where they touch.
    """
    bodies = gmsh.model.getEntities(3) or gmsh.model.getEntities(2)
    if len(bodies) < 2 or any(b not in gmsh.model.occ.getEntities(b[0]) for b in bodies):
        return []
    names = {body: [_group(gmsh, body) or _name(gmsh, body) or f"body{body[1]}"] for body in bodies}
    before = {pair: area for pair, area, _ in _shared(gmsh, names)}
    current = gmsh.model.getCurrent()
    with tempfile.TemporaryDirectory() as folder:
        copy = str(Path(folder) / "copy.brep")
        gmsh.write(copy)
        gmsh.model.add("copy")
        try:
            gmsh.model.occ.importShapes(copy, highestDimOnly=True, format="brep")
            gmsh.model.occ.synchronize()
            copies = gmsh.model.getEntities(bodies[0][0])
            parts = _fragments(gmsh, copies) if len(copies) == len(bodies) else []
            owners: dict[Entity, list[str]] = {}
            for body, of_body in zip(bodies, parts, strict=False):
                for part in of_body:
                    owners.setdefault(part, []).extend(names[body])
            shared = _shared(gmsh, owners) if owners else []
        finally:
            gmsh.model.remove()
            gmsh.model.setCurrent(current)
    dim = bodies[0][0]
    return [
        f"{_listed(pair)} touch on {lengths.text(area - before.get(pair, 0.0), dim - 1)} "
        f"{lengths.near([place])}, but their meshes are not joined there, so that "
        f"each moves on its own: {advice}, [[tie]] ties their surfaces"
        for pair, area, place in shared
        if area > (1 + _NEAR) * before.get(pair, 0.0)
    ]
