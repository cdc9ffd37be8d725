"""`Equation`: the difference of two nodes; `cell_of`: all of them as a periodic cell."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.case.decks.coupling import Coupling
from dolfin_elastic.case.decks.deck import Quantity
from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray
from dolfin_elastic.mesh.formats.abaqus.cards import Card

NEAR = 1e-6
"""Distance of coincident nodes, over the diagonal of the body."""
Form = dict[tuple[int, int], float]
"""Row of a node and direction from 1 to the coefficient of its displacement."""


@dataclass(frozen=True)
class Equation:
    """u_i of one node less u_i of another one is a sum of displacements of reference nodes.

    Attributes:
        card: Its *EQUATION.
        row: Index of its first line.
        nodes: Rows of both nodes.
        direction: i, from 0.
        form: The sum.
    """

    card: Card
    row: int
    nodes: tuple[int, int]
    direction: int
    form: Form


class OtherEquationError(Exception):
    """An equation that is none of a periodic cell.

    Args:
        equation: The one to whose line a message points.
        text: Why no periodic cell has it, for people.
    """

    def __init__(self, equation: Equation, text: str) -> None:
        super().__init__(text)
        self.equation = equation
        self.text = f"equations between nodes, which are no periodic cell: {text}"


@dataclass(frozen=True)
class Cell:
    """Keys of [periodic].

    Attributes:
        pairs: Names of opposite surfaces: an axis, and "min" or "max".
        gradient: Rows of F; "free" where the stress is given.
        stress: Rows of P; "free" where F is given.
    """

    pairs: list[list[str]]
    gradient: list[list[object]]
    stress: list[list[object]]

    @property
    def keys(self) -> dict[str, object]:
        """All of them."""
        return {"pairs": self.pairs, "gradient": self.gradient, "stress": self.stress}


@dataclass(frozen=True)
class Nodes:
    """The nodes of a deck.

    Attributes:
        points: Coordinates, shape (n, dim).
        body: Whether they are in the body.
        still: Whether their displacements are 0, shape (n, dim).
    """

    points: FloatArray
    body: BoolArray
    still: BoolArray


def cell_of(
    nodes: Nodes,
    thickness: float,
    equations: Sequence[Equation],
    masters: Mapping[int, Coupling],
) -> Cell:
    """The periodic cell of u+ - u- = (F - I)(X+ - X-), whose F is linear in the reference nodes.

    The force at a reference node does work on F: f dq = V P : dF.

    Args:
        nodes: Those of the body, and reference nodes.
        thickness: Of a plane body, in the unit of its coordinates.
        equations: All of them.
        masters: Row of a reference node to what is prescribed there.

    Raises:
        OtherEquationError: They are none, or say more or less.
    """
    dim, sizes = nodes.points.shape[1], np.ptp(nodes.points[nodes.body], axis=0)
    forms = _forms(nodes, sizes, equations)
    _check_linked(nodes, sizes, equations)
    used = Counter(key for form in forms.values() for key in form)
    volume = float(np.prod(sizes)) * (thickness if dim == 2 else 1.0)
    gradient: list[list[object]] = [[float(i == k) for k in range(dim)] for i in range(dim)]
    stress: list[list[object]] = [["free"] * dim for _ in range(dim)]
    for (i, k), form in forms.items():
        known = {key: masters[key[0]].moved.get(key[1]) for key in form}
        free = [key for key, value in known.items() if value is None]
        if not free:
            values = (c * (known[key] or 0.0) for key, c in form.items())
            gradient[i][k] = float(i == k) + sum(values)
        elif len(form) == 1 and used[free[0]] == 1 and gradient[k][i] != "free":
            node, direction = free[0]
            force = masters[node].forces.get(direction, 0.0)
            gradient[i][k] = "free"
            stress[i][k] = Quantity(force / (form[free[0]] * volume), "stress")
        else:
            text = f"its reference nodes leave F{i + 1}{k + 1} free beside another component"
            raise OtherEquationError(equations[0], text)
    pairs = [[f"{axis} min", f"{axis} max"] for axis in "xyz"[:dim]]
    return Cell(pairs, gradient, stress)


def _forms(
    nodes: Nodes, sizes: FloatArray, equations: Sequence[Equation]
) -> dict[tuple[int, int], Form]:
    """Indices of a component of F - I to it, linear in the reference nodes."""
    result, oblique = dict[tuple[int, int], Form](), list[tuple[Equation, IntArray, Form]]()
    for one in equations:
        offset = nodes.points[one.nodes[0]] - nodes.points[one.nodes[1]]
        steps = np.round(offset / sizes).astype(np.int64)
        if np.abs(offset - steps * sizes).max() > NEAR * np.linalg.norm(sizes) or not steps.any():
            raise OtherEquationError(one, "its nodes are not opposite on a box along x, y and z")
        form = {q: c for q, c in one.form.items() if not nodes.still[q[0], q[1] - 1]}
        axes = np.flatnonzero(steps)
        if len(axes) > 1:
            oblique.append((one, steps, form))
            continue
        k = int(axes[0])
        own = {q: c / float(steps[k] * sizes[k]) for q, c in form.items()}
        if not _same(result.setdefault((one.direction, k), own), own):
            raise OtherEquationError(one, "others prescribe another deformation along this axis")
    for i, k in np.ndindex(len(sizes), len(sizes)):
        if (i, k) not in result:
            text = f"none holds direction {i + 1} of nodes opposite along {'xyz'[k]}"
            raise OtherEquationError(equations[0], text)
    for one, steps, form in oblique:
        total: Form = {}
        for k in np.flatnonzero(steps):
            for q, c in result[one.direction, int(k)].items():
                total[q] = total.get(q, 0.0) + c * float(steps[k] * sizes[k])
        if not _same(total, form):
            raise OtherEquationError(one, "it is not the sum of those of the faces")
    return result


def _same(one: Form, other: Form) -> bool:
    size = max(map(abs, (*one.values(), *other.values())), default=0.0)
    return all(
        math.isclose(one.get(q, 0.0), other.get(q, 0.0), rel_tol=0.0, abs_tol=1e-6 * size)
        for q in one.keys() | other.keys()
    )


def _check_linked(nodes: Nodes, sizes: FloatArray, equations: Sequence[Equation]) -> None:
    """Refuses faces some of whose nodes no equation joins with those opposite.

    A corner that is a reference node moves with the face if the one opposite is at rest.
    """
    from scipy.spatial import cKDTree

    x, near = nodes.points, NEAR * float(np.linalg.norm(sizes))
    low, masters = x[nodes.body].min(axis=0), np.zeros(x.shape, dtype=bool)
    for one in equations:
        for node, direction in one.form:
            masters[node, direction - 1] = True
    faces = list[tuple[IntArray, IntArray, FloatArray]]()
    for k, size in enumerate(sizes):
        minus = np.flatnonzero(nodes.body & (x[:, k] < low[k] + near))
        plus = np.flatnonzero(nodes.body & (x[:, k] > low[k] + size - near))
        distance, at = cKDTree(x[minus]).query(x[plus] - size * np.eye(len(sizes))[k])
        faces.append((plus, minus[at], distance))
    for i in range(len(sizes)):
        pairs = [e.nodes for e in equations if e.direction == i]
        for plus, other, _ in faces:
            rows = np.flatnonzero(masters[plus, i] & nodes.still[other, i])
            pairs += [(int(plus[row]), int(other[row])) for row in rows]
        labels = _labels(len(x), pairs)
        for k, (plus, other, distance) in enumerate(faces):
            if (lost := (distance > near) | (labels[plus] != labels[other])).any():
                text = f"none joins {np.count_nonzero(lost)} nodes with those opposite along "
                raise OtherEquationError(equations[0], f"{text}{'xyz'[k]}, in direction {i + 1}")


def _labels(count: int, pairs: list[tuple[int, int]]) -> IntArray:
    """A number for each node, the same for those that pairs join."""
    labels, both = np.arange(count), np.array(pairs, dtype=np.int64).reshape(-1, 2)
    while True:
        least = labels[both].min(axis=1)
        before = labels.copy()
        for side in both.T:
            np.minimum.at(labels, side, least)
        if (labels == before).all():
            return labels
