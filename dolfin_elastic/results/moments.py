"""Moments of supports, contacts and ties about points that are chosen: `[output] moments`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.errors import InputError, MeshError, nearest
from dolfin_elastic.core.schema import quoted
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import metres
from dolfin_elastic.mesh.body import middle_of
from dolfin_elastic.problem.problem import parts_held

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem
    from dolfin_elastic.problem.state import State

MIDDLE = "middle"
"""The point in the middle of what the support holds."""
POINTS = '"middle", [x, y, z], or the name of a surface, edge or point for its middle'
"""What a point of reference may be."""

ReferencePoints = Mapping[str, Mapping[str, Sequence[float] | str]]
"""Label, and name of each point of reference (empty of an only one), to coordinates [m] or name."""


def check_reference(value: object) -> None:
    """Checks what stands for the points of one support in a case file.

    Args:
        value: A point, or a table of names to points.

    Raises:
        InputError: It is neither; `where` is the name of the point in a table.
    """
    if not isinstance(value, Mapping):
        _check_point(value, f"{POINTS}; or a table of several such points, each with a name")
        return
    if not value:
        raise InputError("no point is given", expected=f"expected names, each with {POINTS}")
    for name, point in value.items():
        if not isinstance(name, str) or not name.strip() or not name.isprintable():
            raise InputError(
                f"{quoted(name)} is no name of a point",
                expected="a text that can stand in the names of columns of history.csv",
            )
        try:
            _check_point(point, POINTS)
        except InputError as error:
            raise error.at(name) from None


def _check_point(value: object, expected: str) -> None:
    if isinstance(value, str) and value.strip():
        return  # whether there is such a part is asked when the mesh is known
    if isinstance(value, list | tuple) and 2 <= len(value) <= 3:
        for index, x in enumerate(value):
            try:
                if isinstance(x, bool) or not isinstance(x, int | float | str):
                    raise InputError(f"{quoted(x)} is wrong", expected="expected a length")
                metres(x, 1.0)
            except InputError as error:
                raise error.at(f"[{index}]") from None
        return
    raise InputError(f"{quoted(value)} is no point", expected=f"expected {expected}")


@dataclass(frozen=True)
class ColumnsOfMoment:
    """The moment of one support about one point.

    Attributes:
        label: Of the support, contact or tie.
        names: Of its columns in the history.
        about: The point [m]; None: the middle of what it holds.
    """

    label: str
    names: tuple[str, ...]
    about: FloatArray | None

    def __call__(self, state: State) -> dict[str, float]:
        """Column to moment on the body [N m].

        Args:
            state: With the moments of all supports.
        """
        moment = state.moments[self.label]
        about = moment.about if self.about is None else self.about
        values = moment.about_point(about, state.reactions[self.label])
        return dict(zip(self.names, map(float, values), strict=True))


def columns_of_moments(points: ReferencePoints, problem: Problem) -> list[ColumnsOfMoment]:
    """Finds the points, and checks that there are such supports. Collective.

    Raises:
        InputError: There is no such support or part, its moment is a column in any case, the point
            has other components than the body, two columns have one name, or nothing has a moment.
    """
    result: list[ColumnsOfMoment] = []
    # Those of rigid surfaces are columns in any case.
    taken = {f"moment_{motion.label}" for motion in problem.constraints.rigid_motions}
    for label, named in points.items():
        _check_label(label, problem)
        for name, point in named.items():
            where = f"output.moments.{label}" + (f".{name}" if name else "")
            stem = f"moment_{label}_{name}" if name else f"moment_{label}"
            axes = "xyz" if problem.body.dim == 3 else "z"
            columns = tuple(f"{stem}_{axis}" for axis in axes)
            if stem in taken:
                raise InputError(
                    f"there are two moments called '{columns[0]}'",
                    where=where,
                    expected="give the point another name",
                )
            taken.add(stem)
            result.append(ColumnsOfMoment(label, columns, place_of(point, where, problem)))
    return result


def _check_label(label: str, problem: Problem) -> None:
    held, where = parts_held(problem), f"output.moments.{label}"
    if problem.geometry == "axisymmetric":
        raise InputError(
            "moments cancel round the axis of a body of revolution",
            where=where,
            expected="no output.moments",
        )
    if label not in held:
        raise InputError(
            f"there is no support or contact '{label}'",
            where=where,
            expected=nearest(label, held) if held else "nothing holds the body: write [[support]]",
        )
    if label in {motion.label for motion in problem.constraints.rigid_motions}:
        raise InputError(
            f"history.csv has moment_{label} of the rigid surface already",
            where=where,
            expected=f"'point' of the support '{label}' to choose about what",
        )


def place_of(point: Sequence[float] | str, where: str, problem: Problem) -> FloatArray | None:
    """Coordinates of a point of reference [m]; None: the middle of what is held. Collective.

    Args:
        point: Coordinates [m], "middle", or the name of a surface, edge or point.
        where: Key of the case file, for the message.

    Raises:
        InputError: There is no such part, or the point has other components than the body.
    """
    body = problem.body
    if isinstance(point, str):
        if point == MIDDLE:
            return None
        parts = {name for kind in ("surface", "edge", "point") for name in body.parts[kind]}
        if not set(body.kinds(point)) - {"region"}:
            raise InputError(
                f"there is no point '{point}'",
                where=where,
                expected=f"{nearest(point, {MIDDLE, *parts})} (a point is {POINTS})",
            )
        try:
            middle = middle_of(body, [point])
        except MeshError as error:
            raise error.at(where) from None
        if not np.isfinite(middle).all():
            raise InputError(f"'{point}' is empty", where=where, expected=f"expected {POINTS}")
        return middle
    if len(point) != body.dim:
        raise InputError(f"{len(point)} coordinates given, the body has {body.dim}", where=where)
    return np.array(point, dtype=np.float64)
