"""A shallow arch as a solid, whose load passes two limit points."""

from __future__ import annotations

import numpy as np

from dolfin_elastic import (
    Problem,
    StVenantKirchhoff,
    Support,
    Traction,
    rectangle_body,
)

E, SPAN, THICK = 1e6, 10.0, 0.05
FREE = "free"


def arch(rise: float, force: float, cells: tuple[int, int]) -> Problem:
    """The left half of the arch as a solid; the force acts on its section at midspan."""
    body = rectangle_body(size=(SPAN / 2, THICK), cells=cells, origin=(0.0, -THICK / 2))
    x = body.mesh.geometry.x
    slope = 4 * rise / SPAN - 8 * rise / SPAN**2 * x[:, 0]
    height = 4 * rise / SPAN * x[:, 0] - 4 * rise / SPAN**2 * x[:, 0] ** 2
    along = np.sqrt(1 + slope**2)
    x[:, 0], x[:, 1] = x[:, 0] - x[:, 1] * slope / along, height + x[:, 1] / along
    return Problem(
        body,
        StVenantKirchhoff(E=E, nu=0.0),
        degree=2,
        supports=[
            Support(on="left", displacement=[0, 0]),
            Support(on="right", displacement=[0, FREE]),
        ],
        loads=[Traction(on="right", value=[0, -force / 2 / THICK])],
    )


RISE, FULL = 0.15, 0.4
"""Six times the thickness; a load beyond both limit points."""
