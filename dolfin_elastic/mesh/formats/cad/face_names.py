"""Names of faces in STEP files, which OpenCASCADE does not hand on to Gmsh.

The faces of a body have the same order in the file and in Gmsh's model.  That is verified: the
distances between the corners of each face and those between the middles of the faces' corners,
which no placement of a part changes, must agree.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType

import numpy as np

from dolfin_elastic.core.types import FloatArray

Entity = tuple[int, int]
_NEAR = 1e-5
"""Difference of distances over the diagonal, for faces that are the same."""
_NUMBERS = r"[-+]?[\d.]+(?:[Ee][-+]?\d+)?"


def face_names(gmsh: ModuleType, path: Path, scale: float) -> tuple[dict[Entity, str], list[str]]:
    """Names of the faces of Gmsh's model of a STEP file. Local.

    Args:
        gmsh: Gmsh with the file's shapes as they are in it.
        scale: Units of the model per unit of the file.

    Returns:
        Face to name, and a note if the file has names that cannot be assigned.
    """
    text = path.read_bytes().decode("latin-1")
    if path.suffix.lower() not in (".step", ".stp") or not re.search(
        r"ADVANCED_FACE\s*\(\s*'[^']", text
    ):
        return {}, []
    step = _Step(text)
    known = [(names, [scale * d for d in sizes]) for names, sizes in step.bodies() if any(names)]
    box = np.array(gmsh.model.getBoundingBox(-1, -1))
    near = _NEAR * float(np.linalg.norm(box[3:] - box[:3]))
    result: dict[Entity, str] = {}
    for body in gmsh.model.getEntities(3):
        faces = [(2, int(tag)) for tag in sorted(gmsh.model.getAdjacencies(*body)[1])]
        sizes = _sizes([_corners(gmsh, face) for face in faces])
        fitting = {tuple(names) for names, other in known if _same(sizes, other, near)}
        if len(fitting) == 1:
            result |= {f: n for f, n in zip(faces, next(iter(fitting)), strict=True) if n}
    lost = {name for names, _ in known for name in names if name} - set(result.values())
    note = f"names of faces that cannot be assigned (left out): {', '.join(sorted(lost))}"
    return result, [note] if lost else []


def _same(sizes: Sequence[FloatArray], other: Sequence[FloatArray], near: float) -> bool:
    """Whether two bodies have the same distances on each face."""
    return len(sizes) == len(other) and all(
        len(a) == len(b) and bool(np.all(np.abs(a - b) <= near))
        for a, b in zip(sizes, other, strict=True)
    )


def _sizes(faces: Sequence[FloatArray]) -> list[FloatArray]:
    """Distances between the different corners of each face, sorted, and between the faces."""
    corners = [np.unique(np.round(face, 12), axis=0) for face in faces]
    away = [np.linalg.norm(x[:, None] - x[None], axis=2) for x in corners]
    within_faces = [np.sort(d[np.triu_indices(len(d), 1)]) for d in away]
    middles = np.array([x.mean(axis=0) if len(x) else np.zeros(3) for x in corners])
    return [*within_faces, np.linalg.norm(middles[:, None] - middles[None], axis=2).ravel()]


def _corners(gmsh: ModuleType, face: Entity) -> FloatArray:
    points = gmsh.model.getBoundary([face], combined=False, oriented=False, recursive=True)
    coordinates = [gmsh.model.getValue(0, tag, []) for _, tag in dict.fromkeys(points)]
    return np.array(coordinates, dtype=np.float64).reshape(-1, 3)


class _Step:
    """The entities of a STEP file (ISO 10303-21) that describe faces."""

    def __init__(self, text: str) -> None:
        match = re.finditer(r"#(\d+)\s*=\s*([A-Z_]+)\s*\(((?:'[^']*'|[^';])*)\)\s*;", text)
        self._entities: Mapping[str, tuple[str, str]] = {m[1]: (m[2], m[3]) for m in match}

    def bodies(self) -> Iterator[tuple[list[str], list[FloatArray]]]:
        """For each solid the names of its faces, and their sizes, see `_sizes`."""
        for kind, content in self._entities.values():
            if kind in ("MANIFOLD_SOLID_BREP", "BREP_WITH_VOIDS"):
                faces = [
                    face
                    for shell in self._of(content, ("CLOSED_SHELL", "ORIENTED_CLOSED_SHELL"))
                    for face in self._of(self._entities[shell][1], ("ADVANCED_FACE",))
                ]
                names = [self._name(face) for face in faces]
                yield names, _sizes([self._face_corners(face) for face in faces])

    def _of(self, content: str, kinds: Sequence[str]) -> list[str]:
        """Numbers of the entities of some kinds that a content refers to."""
        numbers = re.findall(r"#(\d+)", content)
        return [n for n in numbers if self._entities.get(n, ("",))[0] in kinds]

    def _name(self, face: str) -> str:
        name = re.match(r"\s*'([^']*)'", self._entities[face][1])
        return name[1] if name else ""

    def _face_corners(self, face: str) -> FloatArray:
        """Places of the vertices of a face's edges, shape (n, 3)."""
        numbers = [face]
        for kinds in (
            ("FACE_BOUND", "FACE_OUTER_BOUND"),
            ("EDGE_LOOP",),
            ("ORIENTED_EDGE",),
            ("EDGE_CURVE",),
            ("VERTEX_POINT",),
            ("CARTESIAN_POINT",),
        ):
            numbers = [n for number in numbers for n in self._of(self._entities[number][1], kinds)]
        coordinates = [
            re.findall(_NUMBERS, self._entities[n][1].rpartition("'")[2]) for n in numbers
        ]
        return np.array(coordinates, dtype=np.float64).reshape(-1, 3)
