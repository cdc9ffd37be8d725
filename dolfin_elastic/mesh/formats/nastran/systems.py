"""Coordinate systems of Nastran: rectangular, cylindrical and spherical, in terms of each other.

Source: MSC Nastran 2021, Quick Reference Guide, entries CORD1R, CORD1C, CORD1S, CORD2R, CORD2C,
CORD2S: the origin A, a point B on the z axis and a point C in the half plane of positive x give
e_z = (B - A)/|B - A|, e_y = e_z x (C - A)/|e_z x (C - A)| and e_x = e_y x e_z.  Coordinates are
(x, y, z), (R, theta, z) or (R, theta, phi), with theta of the spherical system from the z axis;
angles are in degrees.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.formats.nastran.entries import Entry


def _rectangular(x: FloatArray) -> FloatArray:
    return x


def _cylindrical(x: FloatArray) -> FloatArray:
    radius, angle = x[:, 0], np.radians(x[:, 1])
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), x[:, 2]], axis=1)


def _spherical(x: FloatArray) -> FloatArray:
    radius, theta, phi = x[:, 0], np.radians(x[:, 1]), np.radians(x[:, 2])
    across = radius * np.sin(theta)
    return np.stack([across * np.cos(phi), across * np.sin(phi), radius * np.cos(theta)], axis=1)


_KINDS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "R": _rectangular,
    "C": _cylindrical,
    "S": _spherical,
}


@dataclass(frozen=True)
class System:
    """A coordinate system, as its entry defines it.

    Attributes:
        entry: The entry.
        kind: R, C or S.
        reference: Number of the system of its points, of CORD2.
        points: Coordinates of A, B and C there, shape (3, 3), of CORD2.
        grids: Numbers of A, B and C, of CORD1.
    """

    entry: Entry
    kind: str
    reference: int = 0
    points: FloatArray | None = None
    grids: tuple[int, int, int] | None = None


def systems_of(entry: Entry) -> dict[int, System]:
    """The systems that an entry CORD1x or CORD2x defines, by their numbers.

    Raises:
        MeshError: It cannot be read.
    """
    kind = entry.name[5:]
    if entry.name.startswith("CORD2"):
        x = np.array([entry.real(i) for i in range(2, 11)]).reshape(3, 3)
        return {_number(entry, 0): System(entry, kind, entry.integer(1, 0), x)}
    result = {}
    for at in (0, 4):
        if at == 0 or entry.text(at):
            first, second, third = (entry.integer(at + i) for i in (1, 2, 3))
            result[_number(entry, at)] = System(entry, kind, grids=(first, second, third))
    return result


def _number(entry: Entry, index: int) -> int:
    number = entry.integer(index)
    if number == 0:
        raise entry.error("the system 0 is the basic one", "a positive number")
    return number


class Systems:
    """All systems of a file, and where points in them are.

    Args:
        systems: By their numbers.
        point: Number of a GRID to its system and its coordinates there, shape (3,); None: there
            is none.
    """

    def __init__(
        self,
        systems: Mapping[int, System],
        point: Callable[[int], tuple[int, FloatArray] | None],
    ) -> None:
        self._systems, self._point = systems, point
        self._frames: dict[int, tuple[FloatArray, FloatArray]] = {
            0: (np.zeros(3), np.eye(3)),
        }

    def place(self, number: int, x: FloatArray, entry: Entry) -> FloatArray:
        """Basic coordinates of points.

        Args:
            number: Of the system; 0: they are basic ones.
            x: Their coordinates in it, shape (n, 3).

        Returns:
            Shape (n, 3).

        Raises:
            MeshError: The system does not exist, has no axes, or is defined by itself.
        """
        return self._placed(number, x, entry, ())

    def axes_at(self, number: int, x: FloatArray, entry: Entry) -> FloatArray:
        """Directions of a system at a point, as rows in basic components, shape (3, 3).

        Args:
            x: Basic coordinates of the point, shape (3,).

        Raises:
            MeshError: See `place`; or the point is on the axis of the system.
        """
        self.place(number, np.zeros((1, 3)), entry)
        origin, axes = self._frames[number]
        kind = self._systems[number].kind if number else "R"
        if kind == "R":
            return axes
        y = axes @ (x - origin)
        across = float(np.hypot(y[0], y[1]))
        if not across > 1e-12 * max(float(np.abs(y).max()), 1e-300):
            raise entry.error(f"the point is on the axis of the coordinate system {number}")
        c, s = y[:2] / across
        around = np.array([-s, c, 0.0])
        if kind == "C":
            return np.asarray(np.stack([[c, s, 0.0], around, [0.0, 0.0, 1.0]]) @ axes)
        radius = float(np.linalg.norm(y))
        out = y / radius
        down = np.array([c * y[2], s * y[2], -across]) / radius
        return np.asarray(np.stack([out, down, around]) @ axes)

    def _placed(
        self, number: int, x: FloatArray, entry: Entry, above: tuple[int, ...]
    ) -> FloatArray:
        if number in above:
            raise entry.error(f"the coordinate system {number} is defined by itself")
        if number and number not in self._systems:
            known = ", ".join(map(str, sorted(self._systems)[:8])) or "there are none"
            raise entry.error(f"there is no coordinate system {number}", f"known: {known}")
        if number not in self._frames:
            self._frames[number] = self._frame(number, above)
        origin, axes = self._frames[number]
        kind = _KINDS[self._systems[number].kind] if number else _rectangular
        return np.asarray(origin + kind(x) @ axes)

    def _frame(self, number: int, above: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
        """Origin and axes of a system in basic coordinates, the axes as rows."""
        system, inside = self._systems[number], (*above, number)
        if system.points is not None:
            three = self._placed(system.reference, system.points, system.entry, inside)
        else:
            three = np.array([self._of_grid(g, system.entry, inside) for g in system.grids or ()])
        origin, on_axis, in_plane = three
        size = np.abs(three - origin).max()
        z = on_axis - origin
        y = np.cross(z, in_plane - origin)
        if not size > 0 or np.linalg.norm(y) <= 1e-12 * size**2:
            raise system.entry.error(
                f"the points of the coordinate system {number} lie on one line"
            )
        z, y = z / np.linalg.norm(z), y / np.linalg.norm(y)
        return origin, np.stack([np.cross(y, z), y, z])

    def _of_grid(self, grid: int, entry: Entry, above: tuple[int, ...]) -> FloatArray:
        point = self._point(grid)
        if point is None:
            raise entry.error(f"there is no GRID {grid}")
        number, x = point
        return self._placed(number, x[None, :], entry, above)[0]
