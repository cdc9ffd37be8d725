"""What a field is, and its components in local axes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, Literal, Protocol

from ufl.core.expr import Expr

from dolfin_elastic.core.errors import nearest
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.model.axes import JOINT, MATERIAL
from dolfin_elastic.model.materials.law import Law

if TYPE_CHECKING:
    from dolfin_elastic.mesh.fields import MeshField

SHAPES = {"scalar": 1, "vector": 3, "tensor": 9}

RecoveredField = Literal[
    "von_mises",
    "cauchy_stress",
    "pressure",
    "safety_factor",
    "principal_stresses",
    "max_principal_stress",
    "min_principal_stress",
    "principal_direction_1",
    "principal_direction_2",
    "principal_direction_3",
    "tresca",
]


class FieldSource(Protocol):
    """One state on this rank, as fields without a formula read it.

    All methods give the rows of the points or cells that this rank owns, and all are collective.
    """

    def nodal(self, name: Literal["u", "v", "a"]) -> AnyArray:
        """A vector of the state at the points, shape (points, 3)."""

    def reaction(self) -> AnyArray:
        """Nodal residual of an equilibrium [N], shape (points, 3)."""

    def residual(self) -> AnyArray:
        """The same with zeros where supports prescribe the displacement."""

    def recovered(self, name: RecoveredField) -> AnyArray:
        """A field of the recovered stress at the points."""

    def component(self, component: Component, rows: AnyArray) -> AnyArray:
        """A component in local axes of rows of its field at the points, shape (points, 1)."""

    def friction_traction(self) -> AnyArray:
        """Tangential traction of obstacles at the points [Pa], shape (points, 3)."""

    def contact_status(self) -> AnyArray:
        """Whether points are open (0), stick (1) or slide (2), shape (points, 1)."""

    def contact_gap(self) -> AnyArray:
        """Distance of points from the nearest obstacle they may touch [m], shape (points, 1)."""

    def contact_pressure(self) -> AnyArray:
        """Pressure of the obstacles on the body [Pa] at the points, shape (points, 1)."""

    def normal(self) -> AnyArray:
        """Outward unit normals of the deformed surface at the points, shape (points, 3)."""

    def stress_error(self) -> AnyArray:
        """Estimated error of each cell's stress [Pa], shape (cells, 1)."""

    def region(self) -> AnyArray:
        """Number of each cell's region, shape (cells, 1)."""

    def material(self) -> AnyArray:
        """Number of each cell's material, shape (cells, 1)."""

    def rank(self) -> AnyArray:
        """This rank for each cell, shape (cells, 1)."""

    def of_body(self, name: str) -> AnyArray:
        """A field of the body at the points or cells, vectors with three components."""


@dataclass(frozen=True)
class Component:
    """A component of a vector or tensor in local axes, such as "cauchy_stress_rr_in_bore".

    Attributes:
        field: Name of the vector or tensor.
        letters: Of the directions, one of a vector, two of a tensor.
        axes: Name of the axes; "material": those of the law.
    """

    field: str
    letters: str
    axes: str

    @property
    def indices(self) -> list[int]:
        """Numbers of the directions."""
        known = next(row for row in LETTERS if set(self.letters) <= set(row))
        return [known.index(letter) for letter in self.letters]


@dataclass(frozen=True)
class Field:
    """One row of `FIELDS`; fields of cells have a `formula` or `values`, those of nodes `values`.

    Attributes:
        shape: Scalar, vector (3 components also in 2D) or tensor (9, row by row).
        centre: Whether there is a value for each node or for each cell.
        unit: SI unit.
        description: One line for listings.
        formula: Law and 3x3 deformation gradient to a UFL expression; None for a law without such
            a quantity, whose cells get NaN.  Of a field of nodes it gives the value inside a cell.
        of_tensor: Where `formula` gives a tensor from which the field follows in NumPy: rows of the
            tensor, shape (n, 9), to rows of the field.
        values: Of a field of nodes, and of cells without a formula: this rank's rows from a
            `FieldSource`.
        recovered: It follows from the recovered stress.
        motion: Exists in motion only.
        statics: Exists in statics only.
        fixed: The same at every step: written once.
        current: How many of its indices, the first ones, belong to the current configuration.
        component: What it is a component of; `formula` is then that of the whole.
        of_body: The field of the body that it is, or a component of that; None: of the results.
    """

    shape: Literal["scalar", "vector", "tensor"]
    centre: Literal["node", "cell"]
    unit: str
    description: str
    formula: Callable[[Law, Expr], Expr | None] | None = None
    of_tensor: Callable[[AnyArray], AnyArray] | None = None
    values: Callable[[FieldSource], AnyArray] | None = None
    recovered: bool = False
    motion: bool = False
    statics: bool = False
    fixed: bool = False
    current: int = 0
    component: Component | None = None
    of_body: MeshField | None = field(default=None, compare=False)

    @property
    def whole(self) -> str:
        """Name of the vector or tensor of which it is a component; empty: of none."""
        return "" if self.component is None else self.component.field

    @property
    def columns(self) -> int:
        """Number of components."""
        return SHAPES[self.shape]

    @property
    def evaluated(self) -> int:
        """Number of components of `formula`."""
        return self.columns if self.of_tensor is None else SHAPES["tensor"]

    def finished(self, rows: AnyArray) -> AnyArray:
        """Rows of the field from rows of `formula`."""
        return rows if self.of_tensor is None else self.of_tensor(rows)

    def of_cell(self, law: Law, F: Expr) -> Expr | None:
        """Value of `formula`, which the field has.

        Args:
            F: Deformation gradient, 3x3.
        """
        assert self.formula is not None
        return self.formula(law, F)


# --- components in local axes ---

LETTERS = ("xyz", "rtz", "123")
"""Directions of rectangular, cylindrical and the material's axes."""
_NAME = re.compile(rf"(\w+)_([{''.join(LETTERS)}]{{1,2}}){JOINT}(\w+)", re.ASCII)


class FieldTable(Mapping[str, Field]):
    """Name to field.

    Components in local axes, "cauchy_stress_rr_in_bore", are found by their names, whether a
    problem has these axes or not, see `results/components.py`; they are not listed.

    Args:
        rows: Name to field, all but components in local axes.
    """

    def __init__(self, rows: Mapping[str, Field]) -> None:
        self._rows, self._component = rows, cache(self._made)

    def __getitem__(self, name: str) -> Field:
        found = self._rows.get(name) or self._component(name)
        if found is None:
            raise KeyError(name)
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    def _made(self, name: str) -> Field | None:
        match = _NAME.fullmatch(name)
        whole = self._rows.get(match[1]) if match else None
        if match is None or whole is None or len(match[2]) != _indices_of(whole):
            return None
        known = LETTERS[2:] if match[3] == MATERIAL else LETTERS[:2]
        if not any(set(match[2]) <= set(row) for row in known):
            return None
        return _in_axes(whole, Component(*match.groups()))

    def nearest(self, name: str, known: Iterable[str] = ()) -> str:
        """What a wrong name may have meant, for messages.

        Args:
            known: Names without axes that may be meant; by default all.
        """
        axes = name.rpartition(JOINT)[2]
        every = [
            f"{one}_{a}{b}{JOINT}{axes}"
            for one, field in self._rows.items()
            if _indices_of(field)
            for row in (LETTERS[2:] if axes == MATERIAL else LETTERS[:2])
            for a in row
            for b in (row if _indices_of(field) == 2 else [""])
        ]
        return nearest(
            name, [one for one in every if one in self] if JOINT in name else known or self
        )


def _indices_of(row: Field) -> int:
    """Number of indices of a tensor or vector; 0 of what has no components in local axes."""
    if row.centre == "cell" and row.formula is None:
        return 0
    vector = row.shape == "vector" and row.of_tensor is None  # principal values are none
    return 2 if row.shape == "tensor" else int(vector)


def _in_axes(whole: Field, component: Component) -> Field | None:
    values, follows = whole.values, whole.of_tensor
    i, *j = component.indices
    result = replace(
        whole,
        shape="scalar",
        description=f"{component.letters} of {component.field} in the axes '{component.axes}'",
        of_tensor=follows and (lambda rows: follows(rows)[:, 3 * i + j[0], None]),
        values=values and (lambda source: source.component(component, values(source))),
        component=component,
    )
    if component.axes != MATERIAL:
        return result
    # Materials meet at nodes: what is in their axes belongs to cells.
    of_cells = replace(result, centre="cell", values=None, recovered=False)
    return of_cells if whole.formula else None
