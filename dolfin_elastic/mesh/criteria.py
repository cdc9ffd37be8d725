"""Criteria by which parts of a body are selected: planes, boxes, spheres, cylinders."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import smallest, total
from dolfin_elastic.core.shapes.box import Box, point_of
from dolfin_elastic.core.shapes.directions import Axis
from dolfin_elastic.core.shapes.shapes import Plane
from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.core.units import LENGTHS, MeshLength, metres
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.selectors import Place

TOLERANCE = 1e-6
"""Share of the body's diagonal by which a corner may be off."""


@dataclass(frozen=True)
class BoundingBox(Box):
    """Bounding box of the body [m], and metres per unit of bare numbers in selectors."""

    scale: float

    @staticmethod
    def of(body: Body, scale: float) -> BoundingBox:
        """Of a body. Collective.

        Args:
            scale: Metres per unit of bare numbers.
        """
        low, high = bounding_box(body.mesh)
        return BoundingBox(low, high, scale)

    def plane(self, axis: Axis, at: MeshLength) -> tuple[int, float]:
        """Number of the axis across a plane, and the plane's coordinate [m].

        Args:
            at: The coordinate, or "min", "middle" or "max" of the body.

        Raises:
            MeshError: A plane body has no such axis.
        """
        number = "xyz".index(axis)
        if number >= len(self.low):
            raise MeshError(
                f"the body is plane, it has no {axis}", where="plane", expected="x or y"
            )
        low, high = float(self.low[number]), float(self.high[number])
        known = {"min": low, "middle": (low + high) / 2, "max": high}
        return number, known[at] if at in known else self.metres(at)

    def metres(self, value: MeshLength) -> float:
        """A length of a selector in metres."""
        return metres(value, self.scale)

    def point(self, values: Sequence[MeshLength], key: str) -> FloatArray:
        """A point of a selector [m], of which `key` is the key. See `point_of`."""
        return np.array(point_of(values, self.scale, len(self.low), key))

    @property
    def unit(self) -> str:
        """The unit behind lengths, such as " mm"; empty where it has no name."""
        return next((f" {name}" for name, length in LENGTHS.items() if length == self.scale), "")

    def __str__(self) -> str:
        text = [
            f"{axis} from {low:.6g} to {high:.6g}{self.unit}"
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
    turned = test.key == "angle"
    unit, worth = (" degrees", near < 180) if turned else (space.unit, near < 0.1 * space.diagonal)
    off, limit = (f"{value / test.unit:.3g}{unit}" for value in (near, test.limit))
    text = f" (the nearest is off by {off}, allowed is {limit}"
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
    """Tolerance for the distance of a corner from the selected place [m]."""
    if selector.tolerance is None:
        return TOLERANCE * space.diagonal
    return space.metres(selector.tolerance)


def _shapes(
    selector: Place, space: BoundingBox
) -> Iterator[tuple[str, Callable[[FloatArray], FloatArray]]]:
    """Shapes of a selector in words, and how far points are: signed, of a box 0 inside."""
    dim, scale = len(space.low), space.scale
    if selector.plane is not None:
        _, at = space.plane(selector.plane, selector.at or 0.0)
        # Nobody has written it: of faces without samples "min" is infinite.
        plane = Plane.model_construct(axis=selector.plane, at=at)
        yield f"plane {selector.plane} = {at / scale:.6g}", plane.off
    if selector.box is not None:
        # The tolerance moves each face by itself.
        box = Box.between(selector.box, scale, dim, "box")
        yield "box", lambda x: np.asarray(box.beyond(x).max(axis=-1))
    for key, shape in selector.shapes.items():
        if shape.placed:
            yield key, shape.selecting(scale, dim, key).off


def place_criteria(
    selector: Place, space: BoundingBox, corners: FloatArray, *, filled: bool = False
) -> list[Criterion]:
    """Whether all corners of facets, edges or nodes lie where a selector says.

    Args:
        corners: Shape (n, corners, dim) [m].
        filled: They may lie inside of spheres and cylinders.
    """
    limit, tests = allowed_distance(selector, space), []
    for label, off in _shapes(selector, space):
        distance = np.maximum(off(corners), 0.0) if filled else np.abs(off(corners))
        text = f"{'in' if filled or label == 'box' else 'on'} the {label}"
        tests.append(Criterion(text, distance.max(axis=1), limit, space.scale))
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
