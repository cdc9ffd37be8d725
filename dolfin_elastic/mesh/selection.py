"""`name_parts`: names for surfaces and regions that the mesh file does not name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import smallest, total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.geometry.simplices import (
    boundary_facets,
    cell_corners,
    facet_corners,
    outward_normals,
    prepare_facets,
)
from dolfin_elastic.mesh.selectors import (
    Cylinder,
    MeshLength,
    Selector,
    metres,
)

Choice = Selector | Sequence[Selector]
_TOLERANCE = 1e-6  # of the body's diagonal
_ANGLE = 20.0  # degrees


def name_parts(
    body: Body,
    *,
    surfaces: Mapping[str, Choice] | None = None,
    regions: Mapping[str, Choice] | None = None,
    scale: float = 1.0,
) -> Body:
    """The body with further named parts, selected by geometry.

    Collective.  Later selectors may refer (`of`) to the names of earlier ones.

    Args:
        body: The body.
        surfaces: Name to a selector, or to several whose facets are joined.
        regions: Name to a selector, or to several whose cells are joined.
        scale: Metres per unit of length of the mesh, for bare numbers in selectors.

    Raises:
        MeshError: A name exists already, or a selector finds nothing.
    """
    space = _BoundingBox.of(body, scale)
    for kind, choices in (("surface", surfaces or {}), ("region", regions or {})):
        for name, choice in choices.items():
            found = _named(body, space, kind, name, choice)
            body = body.named(**{f"{kind}s": {name: found}})
    return body


@dataclass(frozen=True)
class _BoundingBox:
    """Bounding box of the body [m], and metres per unit of bare numbers in selectors."""

    low: FloatArray
    high: FloatArray
    scale: float

    @staticmethod
    def of(body: Body, scale: float) -> _BoundingBox:
        """The bounding box of a body. Collective.

        Args:
            body: The body.
            scale: Metres per unit of bare numbers in selectors.
        """
        low, high = bounding_box(body.mesh)
        return _BoundingBox(low, high, scale)

    @property
    def diagonal(self) -> float:
        return float(np.linalg.norm(self.high - self.low))

    def metres(self, value: MeshLength) -> float:
        return metres(value, self.scale)

    def point(self, values: Sequence[MeshLength], key: str) -> FloatArray:
        """A place of a selector, of shape (gdim,) [m].

        Args:
            values: Its components, in the mesh's unit or as texts with a unit.
            key: The selector's key, for the message.

        Raises:
            MeshError: There are too few.
        """
        dim = len(self.low)
        if len(values) < dim:
            raise MeshError(f"the body is three-dimensional, {list(values)} is not", where=key)
        return np.array([self.metres(v) for v in values[:dim]])

    def __str__(self) -> str:
        text = [
            f"{axis} from {low:.6g} to {high:.6g}"
            for axis, low, high in zip(
                "xyz", self.low / self.scale, self.high / self.scale, strict=False
            )
        ]
        return "the body lies in " + ", ".join(text)


@dataclass(frozen=True)
class _Criterion:
    """One criterion of a selector, evaluated for facets or cells.

    Attributes:
        label: The criterion in words.
        distance: Of each facet or cell from fulfilling it [m, or degrees], shape (n,).
        limit: Largest admissible distance.
        unit: Unit of length in which distances are reported [m]; 1 for degrees.
        key: Key of the selector that sets the limit.
    """

    label: str
    distance: FloatArray
    limit: float
    unit: float = 1.0
    key: str = "tolerance"


def bounding_box(mesh: Mesh) -> tuple[FloatArray, FloatArray]:
    """Smallest and largest coordinates of the mesh, in metres. Collective."""
    x = mesh.geometry.x[:, : mesh.geometry.dim]
    low = x.min(axis=0, initial=np.inf)
    high = x.max(axis=0, initial=-np.inf)
    lows, highs = np.empty_like(low), np.empty_like(high)
    mesh.comm.Allreduce(low, lows, op=MPI.MIN)
    mesh.comm.Allreduce(high, highs, op=MPI.MAX)
    return lows, highs


def _named(body: Body, space: _BoundingBox, kind: str, name: str, choice: Choice) -> IndexArray:
    if name in (body.surfaces if kind == "surface" else body.regions):
        raise MeshError(
            f"the mesh has a {kind} '{name}' already",
            where=f"{kind}s.{name}",
            expected="choose another name",
        )
    choices = [choice] if isinstance(choice, Selector) else list(choice)
    found: list[IndexArray] = []
    for i, selector in enumerate(choices):
        where = f"{kind}s.{name}" + (f"[{i}]" if len(choices) > 1 else "")
        try:
            found.append(_pick(body, space, kind, selector))
        except MeshError as error:
            raise error.at(where) from None
    if not found:
        raise MeshError("an empty list of selectors", where=f"{kind}s.{name}")
    return np.unique(np.concatenate(found)).astype(np.int32)


def _pick(body: Body, space: _BoundingBox, kind: str, selector: Selector) -> IndexArray:
    mesh = body.mesh
    if kind == "surface":
        prepare_facets(mesh)
        parts = body.surface(selector.of) if selector.of else boundary_facets(mesh)
        tests = _surface_criteria(mesh, parts, selector, space)
        size = mesh.topology.index_map(mesh.topology.dim - 1).size_local
    else:
        size = mesh.topology.index_map(mesh.topology.dim).size_local
        parts = body.region(selector.of) if selector.of else np.arange(size, dtype=np.int32)
        tests = _region_criteria(mesh, parts, selector, space)
    inside = np.ones(len(parts), dtype=bool)
    for test in tests:
        inside &= test.distance <= test.limit
    if total(body.comm, int(np.count_nonzero(inside))) == 0:
        things = "facets of the boundary" if kind == "surface" else "cells"
        if selector.of:
            things = f"{things.split(maxsplit=1)[0]} of '{selector.of}'"
        raise _not_found(body.comm, space, tests, parts < size, things)
    return np.asarray(parts[inside])


def _not_found(
    comm: MPI.Comm,
    space: _BoundingBox,
    tests: Sequence[_Criterion],
    owned: BoolArray,
    searched_in: str,
) -> MeshError:
    """Error of a selector that finds nothing: counts, and the smallest distances. Collective."""
    findings = []
    for test in tests:
        count = int(total(comm, int(np.count_nonzero((test.distance <= test.limit) & owned))))
        near = smallest(comm, float(test.distance.min(initial=np.inf)))
        text = f"{test.label}: {count}"
        if count == 0:
            text += _distance_text(test, near, space)
        findings.append(text)
    searched = int(total(comm, int(np.count_nonzero(owned))))
    return MeshError(
        "; ".join([f"found 0 of {searched} {searched_in}", *findings]), expected=str(space)
    )


def _distance_text(test: _Criterion, near: float, space: _BoundingBox) -> str:
    text = (
        f" (the nearest is off by {near / test.unit:.3g}, allowed is {test.limit / test.unit:.3g}"
    )
    worth = near < (180 if test.key == "angle" else 0.1 * space.diagonal)
    return text + (
        f"; {test.key} = {_rounded_up(near / test.unit):g} would find it)" if worth else ")"
    )


def _rounded_up(value: float) -> float:
    """The value rounded up to two digits."""
    if not 0 < value < np.inf:
        return value
    step = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(np.ceil(value * 1.01 / step) * step)


def _limit(selector: Selector, space: _BoundingBox) -> float:
    if selector.tolerance is None:
        return _TOLERANCE * space.diagonal
    return space.metres(selector.tolerance)


def _surface_criteria(
    mesh: Mesh, facets: IndexArray, selector: Selector, space: _BoundingBox
) -> list[_Criterion]:
    corners = facet_corners(mesh, facets)
    limit = _limit(selector, space)

    def test(label: str, distance: Callable[[FloatArray], FloatArray]) -> _Criterion:
        """How far the farthest corner of each facet is off.

        Args:
            label: Where facets are looked for, for the message.
            distance: From places of shape (n, gdim) [m] to distances of shape (n,) [m].
        """
        flat = np.abs(distance(corners.reshape(-1, corners.shape[2])))
        return _Criterion(label, flat.reshape(corners.shape[:2]).max(axis=1), limit, space.scale)

    tests = []
    if selector.plane is not None:
        axis, value = _plane_position(selector, space)
        label = f"on the plane {selector.plane} = {value / space.scale:.6g}"
        tests.append(test(label, lambda x: x[:, axis] - value))
    if selector.box is not None:
        tests.append(test("in the box", _distance_from_box(selector, space)))
    for label, distance in _curved_tests(selector, space):
        tests.append(test(f"on the {label}", distance))
    if selector.normal is not None:
        tests.append(_normal_test(mesh, facets, selector, space))
    return tests


def _region_criteria(
    mesh: Mesh, cells: IndexArray, selector: Selector, space: _BoundingBox
) -> list[_Criterion]:
    wrong = [key for key in ("plane", "normal") if getattr(selector, key) is not None]
    if wrong:
        raise MeshError(
            f"a {wrong[0]} picks surfaces, not regions",
            expected="regions are picked by box, sphere, cylinder, of, or all",
        )
    middle = cell_corners(mesh, cells).mean(axis=1)
    limit = _limit(selector, space)
    tests = []
    if selector.box is not None:
        tests.append(
            _Criterion(
                "in the box", _distance_from_box(selector, space)(middle), limit, space.scale
            )
        )
    for label, distance in _curved_tests(selector, space):
        tests.append(
            _Criterion(f"in the {label}", np.maximum(distance(middle), 0), limit, space.scale)
        )
    return tests


def _plane_position(selector: Selector, space: _BoundingBox) -> tuple[int, float]:
    axis = "xyz".index(selector.plane or "x")
    if axis >= len(space.low):
        raise MeshError(
            f"the body is plane, it has no {selector.plane}", where="plane", expected="x or y"
        )
    if selector.at == "min":
        return axis, float(space.low[axis])
    if selector.at == "max":
        return axis, float(space.high[axis])
    return axis, space.metres(selector.at or 0.0)


def _distance_from_box(
    selector: Selector, space: _BoundingBox
) -> Callable[[FloatArray], FloatArray]:
    assert selector.box is not None
    one, two = (space.point(corner, "box") for corner in selector.box)
    low, high = np.minimum(one, two), np.maximum(one, two)
    return lambda x: np.maximum(np.maximum(low - x, x - high).max(axis=1), 0)


def _curved_tests(
    selector: Selector, space: _BoundingBox
) -> list[tuple[str, Callable[[FloatArray], FloatArray]]]:
    """Name and signed distance function of the sphere and the cylinder, negative inside."""
    found = []
    if (sphere := selector.sphere) is not None:
        center, radius = space.point(sphere.center, "sphere.center"), space.metres(sphere.radius)
        found.append(("sphere", lambda x: np.linalg.norm(x - center, axis=1) - radius))
    if (cylinder := selector.cylinder) is not None:
        found.append(("cylinder", _distance_from_cylinder(cylinder, space)))
    return found


def _distance_from_cylinder(
    cylinder: Cylinder, space: _BoundingBox
) -> Callable[[FloatArray], FloatArray]:
    point, radius = space.point(cylinder.point, "cylinder.point"), space.metres(cylinder.radius)
    dim, axis = len(space.low), cylinder.axis
    along = np.eye(3)["xyz".index(axis)] if isinstance(axis, str) else np.array([*axis, 0.0][:3])
    along = (along / np.linalg.norm(along))[:dim]
    if dim == 2 and along.any():
        raise MeshError(
            "the body is plane: the axis of a cylinder must be z", where="cylinder.axis"
        )

    def distance(x: FloatArray) -> FloatArray:
        arm = x - point
        arm = arm - (arm @ along)[:, None] * along
        return np.asarray(np.linalg.norm(arm, axis=1) - radius)

    return distance


def _normal_test(
    mesh: Mesh, facets: IndexArray, selector: Selector, space: _BoundingBox
) -> _Criterion:
    assert selector.normal is not None
    dim = len(space.low)
    wanted = np.array(selector.normal[:dim])
    if len(wanted) < dim or not wanted.any():
        raise MeshError(
            f"a direction in {dim}D is needed, not {list(selector.normal)}", where="normal"
        )
    cosine = outward_normals(mesh, facets) @ (wanted / np.linalg.norm(wanted))
    angles = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    text = ", ".join(f"{n:g}" for n in wanted)
    return _Criterion(f"facing ({text})", angles, selector.angle or _ANGLE, key="angle")
