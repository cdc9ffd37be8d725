"""`CadFace`: what a face of a CAD model is, as Gmsh tells it in its process.

The kind is what OpenCASCADE says; of splines it follows from the principal curvatures: none is a
plane, one that is the same everywhere a cylinder, two equal ones a sphere.  Centres lie on the
normals, at the radius of curvature.  Gmsh's own surfaces are planes, or of no kind.

Source: M. P. do Carmo, Differential Geometry of Curves and Surfaces (1976), sections 3.2 and 3.3.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import numpy as np

from dolfin_elastic.core.types import FloatArray

_KINDS = ("plane", "cylinder", "cone", "sphere", "torus")
_OF_CURVES = {"line": "plane", "circle": "cylinder"}
_ON_CURVES = {"plane": "line", "cylinder": "circle", "surface": "curve"}
"""Names of kinds for the curves round a plane body, which are its faces."""
_SAMPLES = 5
"""Points along each parameter of a face at which it is looked at."""
_SAME = 1e-3
"""Relative difference of radii, and of unit normals, that are the same."""


@dataclass(frozen=True)
class CadFace:
    """A face of a CAD model; of a plane body a curve.

    Attributes:
        number: As Gmsh has it; the model of the same file has always the same.
        kind: "plane", "cylinder", "cone", "sphere", "torus" or "surface"; of a plane body a line is
            a "plane" and a circle a "cylinder".
        form: "hole" or "shaft" of whole cylinders, "fillet" or "round" of what joins its neighbours
            without an edge, inside or outside; else empty.
        area: [m^2], in a plane body length [m]; None: Gmsh does not know it.
        centroid: [m]; empty as above.
        radius: Of a cylinder or sphere, and of a torus' tube [m].
        major: Distance of that tube from its axis [m].
        angle: Between axis and surface of a cone [degrees].
        axis: Unit vector along a cylinder, cone or torus; empty of others.
        samples: Points of the face [m], shape (n, 3); none once there is a mesh.
        normals: Outward unit normals there, or NaN.
        names: In the file.
    """

    number: int
    kind: str
    form: str
    area: float | None
    centroid: tuple[float, ...]
    radius: float | None
    major: float | None
    angle: float | None
    axis: tuple[float, ...]
    samples: tuple[tuple[float, ...], ...]
    normals: tuple[tuple[float, ...], ...]
    names: tuple[str, ...]

    @staticmethod
    def read(data: Mapping[str, Any], scale: float, dim: int) -> CadFace:
        """From an answer of `describe_faces`.

        Args:
            scale: Metres per unit of the model.
            dim: Of the body: an area is one of dimension dim - 1.
        """

        def number(key: str, power: int) -> float | None:
            return None if data[key] is None else float(data[key]) * scale**power

        def row(values: Sequence[Any], factor: float = 1.0) -> tuple[float, ...]:
            return tuple(factor * float(x) for x in values)

        return CadFace(
            number=int(data["number"]),
            kind=str(data["kind"]),
            form=str(data["form"]),
            area=number("area", dim - 1),
            centroid=row(data["centroid"], scale),
            radius=number("radius", 1),
            major=number("major", 1),
            angle=number("angle", 0),
            axis=row(data["axis"]),
            samples=tuple(row(values, scale) for values in data["samples"]),
            normals=tuple(row(values) for values in data["normals"]),
            names=tuple(str(name) for name in data["names"]),
        )

    def description(self, unit: str, metres: float, dim: int = 3) -> str:
        """Its kind with its numbers in words: "cylinder r 5 mm, hole".

        Args:
            unit: Unit of length.
            metres: Metres per unit.
        """
        text = self.kind if dim == 3 else _ON_CURVES.get(self.kind, self.kind)
        if self.major is not None and self.radius is not None:
            text += f" r {self.major / metres:.4g} and {self.radius / metres:.4g} {unit}"
        elif self.radius is not None:
            text += f" r {self.radius / metres:.4g} {unit}"
        if self.angle is not None:
            text += f" {self.angle:.4g} deg"
        return f"{text}, {self.form}" if self.form else text


def describe_faces(gmsh: ModuleType, dim: int) -> list[dict[str, object]]:
    """All faces of the current model, or the curves of a plane one, in its unit of length. Local.

    Args:
        dim: Of the body, 2 or 3.

    Returns:
        The fields of `CadFace`; of what Gmsh cannot tell the kind is "surface", the form empty, and
        the numbers are absent.
    """
    known = set(gmsh.model.occ.getEntities(dim - 1))
    shapes = {}
    for entity in gmsh.model.getEntities(dim - 1):
        if len(gmsh.model.getAdjacencies(*entity)[0]):  # of a body
            exact = entity in known or dim == 2
            # What a face is must not keep a body from being meshed.
            shapes[entity[1]] = _Shape("surface", np.empty((0, 3)), np.empty((0, 3)))
            with suppress(Exception):
                shapes[entity[1]] = _Shape.of(gmsh, entity, exact=exact)
    result = []
    for tag, shape in shapes.items():
        entity = (dim - 1, tag)
        form, area, centroid = "", None, list[float]()
        with suppress(Exception):  # as above
            form = _form(gmsh, tag, shapes) if dim == 3 else shape.whole
        with suppress(Exception):
            if entity in known:
                area = float(gmsh.model.occ.getMass(*entity))
                centroid = list(gmsh.model.occ.getCenterOfMass(*entity))
        groups = gmsh.model.getPhysicalGroupsForEntity(*entity)
        names = [gmsh.model.getPhysicalName(dim - 1, int(group)) for group in groups]
        own = {key: getattr(shape, key) for key in ("kind", "radius", "major", "angle")}
        own |= {key: np.nan_to_num(getattr(shape, key)) for key in ("axis", "samples", "normals")}
        own |= {"number": tag, "form": form, "area": area, "centroid": centroid}
        result.append({**own, "names": [name for name in names if name]})
    return result


def face_curvature(gmsh: ModuleType, tag: int) -> float:
    """Largest curvature of a face in the middle of its samples; 0 where it is not known. Local."""
    _, _, curvatures, _, _ = _sampled(gmsh, 2, tag)
    return float(np.median(np.abs(curvatures).max(axis=1))) if len(curvatures) else 0.0


def named_bodies(gmsh: ModuleType, dim: int) -> dict[str, list[int]]:
    """Names of the model's bodies, to their numbers. Local."""
    model = gmsh.model
    groups = [(model.getPhysicalName(*group), group) for group in model.getPhysicalGroups(dim)]
    return {
        name: [int(tag) for tag in model.getEntitiesForPhysicalGroup(*group)]
        for name, group in groups
        if name
    }


def _nothing() -> FloatArray:
    return np.empty(0)


@dataclass(frozen=True)
class _Shape:
    """Shape of a face: see `CadFace`.

    Attributes:
        sweep: Angle over which a cylinder goes round; 0 of others.
        concave: Its centre lies outside of the body.
        centre: Of a sphere, or the point of a cylinder's axis nearest to the origin.
    """

    kind: str
    samples: FloatArray
    normals: FloatArray
    radius: float | None = None
    major: float | None = None
    angle: float | None = None
    axis: FloatArray = field(default_factory=_nothing)
    centre: FloatArray = field(default_factory=_nothing)
    concave: bool = False
    sweep: float = 0.0

    @property
    def whole(self) -> str:
        """What a cylinder is that goes all the way round."""
        if self.kind != "cylinder" or self.sweep < 2 * np.pi - _SAME:
            return ""
        return "hole" if self.concave else "shaft"

    @staticmethod
    def of(gmsh: ModuleType, entity: tuple[int, int], *, exact: bool) -> _Shape:
        """Of a face or curve of the model.

        Args:
            exact: Points and curvatures are asked for: not of surfaces of Gmsh's own kernel.
        """
        dim, tag = entity
        if not exact:
            edges = _edge_samples(gmsh, entity)
            kind = "plane" if str(gmsh.model.getType(dim, tag)) == "Plane" else "surface"
            return _Shape(kind, edges, np.full(edges.shape, np.nan))
        samples, normals, curvatures, directions, sweep = _sampled(gmsh, dim, tag)
        edges = _edge_samples(gmsh, entity)
        every = np.concatenate([samples, edges])
        outward = np.concatenate([normals, np.full(edges.shape, np.nan)])
        kind = str(gmsh.model.getType(dim, tag)).lower()
        kind = _OF_CURVES.get(kind, kind) if dim == 1 else kind
        if len(samples) < 2:
            return _Shape(kind if kind in _KINDS else "surface", every, outward)
        if kind not in _KINDS:
            kind = _kind_by_curvature(curvatures, samples)
        more = _measured(kind, samples, normals, curvatures, directions)
        return _Shape(kind, every, outward, sweep=sweep if kind == "cylinder" else 0.0, **more)


def _sampled(
    gmsh: ModuleType, dim: int, tag: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float]:
    """Points inside of a face, outward normals, curvatures, their directions, and the sweep.

    Curvatures and directions (of the first curvature, then the second) have shapes (n, 2) and
    (n, 2, 3).
    """
    nothing = np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 2)), np.empty((0, 2, 3)), 0.0
    try:
        low, high = (np.array(b) for b in gmsh.model.getParametrizationBounds(dim, tag))
        steps = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
        axes = [a + (b - a) * steps for a, b in zip(low, high, strict=True)]
        uv: FloatArray = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, dim)
        if dim == 1:
            return _sampled_curve(gmsh, tag, uv[:, 0])
        inside = [bool(gmsh.model.isInside(2, tag, row.tolist(), True)) for row in uv]
        uv = uv[inside]
        if not len(uv):
            return nothing
        flat = uv.reshape(-1).tolist()
        x = np.array(gmsh.model.getValue(2, tag, flat)).reshape(-1, 3)
        n = np.array(gmsh.model.getNormal(tag, flat)).reshape(-1, 3)
        largest, least, first, second = gmsh.model.getPrincipalCurvatures(tag, flat)
    except Exception:  # Gmsh's own error: a surface without parameters
        return nothing
    k = np.stack([largest, least], axis=1)
    along = np.stack([np.reshape(first, (-1, 3)), np.reshape(second, (-1, 3))], axis=1)
    good = np.isfinite(k).all(axis=1) & (np.abs(np.linalg.norm(n, axis=1) - 1.0) < _SAME)
    return x[good], n[good], k[good], along[good], float(high[0] - low[0])


def _sampled_curve(
    gmsh: ModuleType, tag: int, t: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float]:
    """As `_sampled`, of a curve in the plane z = constant."""
    x = np.array(gmsh.model.getValue(1, tag, t.tolist())).reshape(-1, 3)
    along = np.array(gmsh.model.getDerivative(1, tag, t.tolist())).reshape(-1, 3)
    k = np.abs(np.array(gmsh.model.getCurvature(1, tag, t.tolist())))
    n = np.cross(along, [0.0, 0.0, 1.0])
    n /= np.linalg.norm(n, axis=1)[:, None]
    face = int(gmsh.model.getAdjacencies(1, tag)[0][0])
    step = 1e-4 * float(np.linalg.norm(np.ptp(x, axis=0)))
    if gmsh.model.isInside(2, face, (x[0] + step * n[0]).tolist()):
        n = -n
    low, high = (b[0] for b in gmsh.model.getParametrizationBounds(1, tag))
    upward = np.broadcast_to([0.0, 0.0, 1.0], n.shape)
    directions = np.stack([np.cross(upward, n), upward], axis=1)
    return x, n, np.stack([k, np.zeros_like(k)], axis=1), directions, float(high - low)


def _edge_samples(gmsh: ModuleType, entity: tuple[int, int]) -> FloatArray:
    """Points on the edges of a face, or the ends of a curve, shape (n, 3)."""
    result = [np.empty((0, 3))]
    for dim, tag in gmsh.model.getBoundary([entity], combined=False, oriented=False):
        with suppress(Exception):  # a degenerate edge, such as the tip of a cone
            if dim == 0:
                result.append(np.array([gmsh.model.getValue(0, tag, [])]))
                continue
            low, high = (b[0] for b in gmsh.model.getParametrizationBounds(1, tag))
            t = np.linspace(low, high, _SAMPLES).tolist()
            result.append(np.array(gmsh.model.getValue(1, tag, t)).reshape(-1, 3))
    return np.concatenate(result)


def _kind_by_curvature(k: FloatArray, x: FloatArray) -> str:
    size = float(np.linalg.norm(np.ptp(x, axis=0)))
    bent = np.abs(k) * size > _SAME
    if not bent.any():
        return "plane"
    high = np.abs(k).max(axis=1)
    constant = bool(np.ptp(high) < _SAME * high.max())
    if constant and bool((bent.sum(axis=1) == 1).all()):
        return "cylinder"
    if constant and bool((np.abs(k[:, 0] - k[:, 1]) < _SAME * high).all()):
        return "sphere"
    return "surface"


def _measured(
    kind: str, x: FloatArray, n: FloatArray, k: FloatArray, along: FloatArray
) -> dict[str, Any]:
    """Radii, angle, axis, and on which side the centre lies; arguments as `_sampled` returns."""
    sharp = np.abs(k).argmax(axis=1)
    if kind == "sphere":
        radius = 1.0 / float(np.median(np.abs(k)))
        centre, concave = _centres(x, n, radius)
        return {"radius": radius, "centre": centre.mean(axis=0), "concave": concave}
    if kind == "cylinder":
        radius = 1.0 / float(np.median(np.abs(k).max(axis=1)))
        axis = _oriented(along[0, 1 - sharp[0]])
        across = np.eye(3) - np.outer(axis, axis)
        centre, concave = _centres(x @ across, n, radius)
        return {
            "radius": radius,
            "axis": axis,
            "centre": centre.mean(axis=0),
            "concave": concave,
        }
    if kind == "cone":
        axis = _oriented(np.linalg.svd(n - n.mean(axis=0))[2][2])
        return {"axis": axis, "angle": float(np.degrees(np.arcsin(min(abs(n[0] @ axis), 1.0))))}
    if kind == "torus":
        return _measured_torus(x, n, k)
    return {}


def _measured_torus(x: FloatArray, n: FloatArray, k: FloatArray) -> dict[str, Any]:
    """The tube's curvature is the one that all points have; its centres lie on a circle."""
    best: tuple[float, dict[str, Any]] = (np.inf, {})
    for one in np.abs(k[0]):
        if one > 0:
            for sign in (1.0, -1.0):
                q = x + sign / one * n
                middle, axis = _circle(q)
                major = np.linalg.norm(q - middle, axis=1)
                off = float(np.ptp(major) + np.abs((q - middle) @ axis).max())
                if off < best[0] and major.mean() > _SAME / one:
                    result = {"radius": 1.0 / one, "major": float(major.mean())}
                    result |= {"axis": _oriented(axis), "centre": middle, "concave": sign > 0}
                    best = (off, result)
    return best[1]


def _circle(q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centre and axis of the circle through points, by least squares."""
    mean = q.mean(axis=0)
    axes = np.linalg.svd(q - mean)[2]
    flat = (q - mean) @ axes[:2].T
    system = np.column_stack([2 * flat, np.ones(len(flat))])
    centre = np.linalg.lstsq(system, (flat**2).sum(axis=1), rcond=None)[0][:2]
    return np.asarray(mean + centre @ axes[:2]), np.asarray(axes[2])


def _centres(x: FloatArray, n: FloatArray, radius: float) -> tuple[FloatArray, bool]:
    """Centres of curvature, which all points share, and whether they lie outside of the body."""
    outside, inside = x + radius * n, x - radius * n
    concave = bool(np.ptp(outside, axis=0).max() < np.ptp(inside, axis=0).max())
    return (outside if concave else inside), concave


def _oriented(axis: FloatArray) -> FloatArray:
    """The axis with its largest component positive, round-off removed."""
    axis = axis / np.linalg.norm(axis)
    axis = np.where(np.abs(axis) < 1e-9, 0.0, axis)
    return np.asarray(axis * np.sign(axis[np.argmax(np.abs(axis))]))


def _form(gmsh: ModuleType, tag: int, shapes: Mapping[int, _Shape]) -> str:
    """Whether a face is a hole, a shaft, a fillet or a round: see `CadFace`."""
    shape = shapes[tag]
    if shape.whole or shape.radius is None:  # of planes, cones, and what is not known
        return shape.whole
    smooth = _smooth_neighbours(gmsh, tag, shapes)
    if any(_continues(shape, shapes[other]) for other in smooth):
        return "hole" if shape.concave else "shaft"
    half = shape.kind == "cylinder" and shape.sweep > np.pi - _SAME  # the end of a slot
    if len(smooth) < 2 or half:
        return ""
    return "fillet" if shape.concave else "round"


def _continues(one: _Shape, other: _Shape) -> bool:
    """Whether two faces lie on the same cylinder."""
    if not one.kind == other.kind == "cylinder" or one.concave != other.concave:
        return False
    if one.radius is None or other.radius is None:
        return False
    near = _SAME * one.radius
    return (
        abs(one.radius - other.radius) < near
        and bool(np.abs(one.axis - other.axis).max() < _SAME)
        and bool(np.abs(one.centre - other.centre).max() < near)
    )


def _smooth_neighbours(gmsh: ModuleType, tag: int, shapes: Mapping[int, _Shape]) -> Sequence[int]:
    """Faces that a face joins without an edge: the normals agree in the middle of the curve."""
    result = []
    for curve in (abs(int(one)) for one in gmsh.model.getAdjacencies(2, tag)[1]):
        others = {int(f) for f in gmsh.model.getAdjacencies(1, curve)[0]} - {tag}
        with suppress(Exception):  # a degenerate edge, or a surface without parameters
            low, high = (b[0] for b in gmsh.model.getParametrizationBounds(1, curve))
            middle = list(gmsh.model.getValue(1, curve, [(low + high) / 2]))
            own = _normal_at(gmsh, tag, middle)
            for other in others & set(shapes):
                if own @ _normal_at(gmsh, other, middle) > 1 - _SAME:
                    result.append(other)
    return result


def _normal_at(gmsh: ModuleType, tag: int, place: Sequence[float]) -> FloatArray:
    uv = gmsh.model.getParametrization(2, tag, place)
    return np.array(gmsh.model.getNormal(tag, uv))
