"""Fields of the mesh as values of loads and supports."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.compat import interpolation_points
from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import smallest
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.values import Component, FieldsAt, fields_of


def check_fields(body: Body, values: Iterable[Component]) -> None:
    """Checks that the body has the fields among some values, with as many components. Local.

    Raises:
        MeshError: On all ranks.
    """
    for value in fields_of(values):
        columns = body.mesh_field(value.field).columns
        scalar = value.column is None
        if columns not in ((1,) if scalar else (body.dim, 3)):
            raise MeshError(
                f"the field '{value.field}' has {columns} component{'s' * (columns > 1)}",
                expected="expected a scalar, with 1"
                if scalar
                else f"expected a vector, with {body.dim}",
            )


def check_finite(body: Body, values: Iterable[Component], table: FloatArray) -> None:
    """Checks that fields have values where they are used. Collective.

    Args:
        values: Some of them may be fields.
        table: What they are at the places of this rank.

    Raises:
        MeshError: One is not finite somewhere.
    """
    names = dict.fromkeys(f"'{value.field}'" for value in fields_of(values))
    if names and not smallest(body.comm, float(np.isfinite(table).all())):
        raise MeshError(
            f"the field {', '.join(names)} of {body.source or 'the mesh'} has no finite value "
            "somewhere",
            expected="a number wherever the load or support acts",
        )


def fields_at_nodes(body: Body, V: fem.FunctionSpace) -> FieldsAt:
    """Gives fields at all local nodes of a space of displacements. Local."""

    def values(name: str) -> FloatArray:
        field = body.mesh_field(name)
        if field.centre == "cell":
            raise MeshError(
                f"the field '{name}' has values in elements",
                expected="a field with values at points, for displacements are those of nodes",
            )
        rows = V.dofmap.list
        result = np.zeros((int(rows.max(initial=-1)) + 1, field.columns))
        cells = np.arange(len(rows), dtype=np.int32)
        result[rows] = field.at(body.mesh, cells, interpolation_points(V.element))
        return result

    return cache(values)
