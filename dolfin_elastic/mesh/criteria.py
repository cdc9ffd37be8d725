"""Criteria by which parts of a body are selected: planes, boxes, spheres, cylinders."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import smallest, total
from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.core.units import MeshLength, metres
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.selectors import Cylinder, Place

TOLERANCE = 1e-6
"""Share of the body's diagonal by which a corner may be off."""


@dataclass(frozen=True)
class BoundingBox:
    """Bounding box of the body [m], and metres per unit of bare numbers in selectors."""

    low: FloatArray
    high: FloatArray
    scale: float

    @staticmethod
    def of(body: Body, scale: float) -> BoundingBox:
        """Of a body. Collective.

        Args:
            body: The body.
            scale: Metres per unit of bare numbers.
        """
        low, high = bounding_box(body.mesh)
        return BoundingBox(low, high, scale)

    @property
    def diagonal(self) -> float:
        """Its length [m]."""
        return float(np.linalg.norm(self.high - self.low))

    def metres(self, value: MeshLength) -> float:
        """A length of a selector in metres."""
        return metres(value, self.scale)

    def point(self, values: Sequence[MeshLength], key: str) -> FloatArray:
        """A point of a selector [m], with as many coordinates as the body has.

        Args:
            values: Two or three coordinates.
            key: Where they stand, for messages.

        Raises:
            MeshError: There are too few.
        """
        dim = len(self.low)
        if len(values) < dim:
            raise MeshError(
                f"the body is three-dimensional, {list(values)} is not",
                where=key,
                expected="3 coordinates",
            )
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
class Criterion:
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


def not_found(
    comm: MPI.Comm,
    space: BoundingBox,
    tests: Sequence[Criterion],
    owned: BoolArray,
    searched_in: str,
) -> MeshError:
    """Error of a selector that finds nothing: counts, and the smallest distances. Collective.

    Args:
        comm: The ranks of the mesh.
        space: Of the body.
        tests: The selector's criteria, each evaluated for all n facets, edges, nodes or cells.
        owned: Which of them this rank owns, shape (n,).
        searched_in: What was searched, in the plural: "facets of the surface".
    """
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


def _distance_text(test: Criterion, near: float, space: BoundingBox) -> str:
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


def allowed_distance(selector: Place, space: BoundingBox) -> float:
    """Tolerance for the distance of a corner from the selected place [m].

    Args:
        selector: Its tolerance.
        space: Of the body.
    """
    if selector.tolerance is None:
        return TOLERANCE * space.diagonal
    return space.metres(selector.tolerance)


def plane_position(selector: Place, space: BoundingBox) -> tuple[int, float]:
    """Number of the axis across a selector's plane, and the plane's coordinate [m].

    Args:
        selector: Its plane.
        space: Of the body.

    Raises:
        MeshError: A plane body has no such axis.
    """
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


def distance_from_box(selector: Place, space: BoundingBox) -> Callable[[FloatArray], FloatArray]:
    """Function from points, shape (n, dim), to how far outside of a box each lies [m].

    Args:
        selector: Its box.
        space: Of the body.
    """
    assert selector.box is not None
    one, two = (space.point(corner, "box") for corner in selector.box)
    low, high = np.minimum(one, two), np.maximum(one, two)
    return lambda x: np.maximum(np.maximum(low - x, x - high).max(axis=1), 0)


def curved_tests(
    selector: Place, space: BoundingBox
) -> list[tuple[str, Callable[[FloatArray], FloatArray]]]:
    """Signed distance [m] from the sphere and the cylinder of a selector, negative inside.

    Args:
        selector: Its sphere and cylinder.
        space: Of the body.

    Returns:
        For each of them its name, and a function from points [m], shape (n, dim), to shape (n,).
    """
    found = []
    if (sphere := selector.sphere) is not None and sphere.center is not None:
        center, radius = space.point(sphere.center, "sphere.center"), space.metres(sphere.radius)
        found.append(("sphere", lambda x: np.linalg.norm(x - center, axis=1) - radius))
    if (cylinder := selector.cylinder) is not None and cylinder.point is not None:
        point = space.point(cylinder.point, "cylinder.point")
        found.append(("cylinder", _distance_from_cylinder(cylinder, point, space)))
    return found


def _distance_from_cylinder(
    cylinder: Cylinder, point: FloatArray, space: BoundingBox
) -> Callable[[FloatArray], FloatArray]:
    dim, radius = len(space.low), space.metres(cylinder.radius)
    along = np.array(cylinder.direction)[:dim]
    if dim == 2 and along.any():
        raise MeshError(
            "the body is plane: the axis of a cylinder must be z",
            where="cylinder.axis",
            expected='"z"',
        )

    def distance(x: FloatArray) -> FloatArray:
        arm = x - point
        arm = arm - (arm @ along)[:, None] * along
        return np.asarray(np.linalg.norm(arm, axis=1) - radius)

    return distance


def place_criteria(selector: Place, space: BoundingBox, corners: FloatArray) -> list[Criterion]:
    """Whether all corners of facets, edges or nodes lie where a selector says.

    Args:
        selector: Its plane, box, sphere and cylinder.
        space: Of the body.
        corners: Shape (n, corners, dim) [m].
    """
    limit = allowed_distance(selector, space)

    def test(label: str, distance: Callable[[FloatArray], FloatArray]) -> Criterion:
        flat = np.abs(distance(corners.reshape(-1, corners.shape[2])))
        return Criterion(label, flat.reshape(corners.shape[:2]).max(axis=1), limit, space.scale)

    tests = []
    if selector.plane is not None:
        axis, value = plane_position(selector, space)
        label = f"on the plane {selector.plane} = {value / space.scale:.6g}"
        tests.append(test(label, lambda x: x[:, axis] - value))
    if selector.box is not None:
        tests.append(test("in the box", distance_from_box(selector, space)))
    for label, distance in curved_tests(selector, space):
        tests.append(test(f"on the {label}", distance))
    return tests


def fulfilled(tests: Sequence[Criterion], count: int) -> BoolArray:
    """Which facets, edges, nodes or cells fulfil all criteria.

    Args:
        tests: The criteria; without any, all fulfil them.
        count: Number n of facets, edges, nodes or cells.

    Returns:
        Shape (n,).
    """
    inside = np.ones(count, dtype=bool)
    for test in tests:
        inside &= test.distance <= test.limit
    return inside
