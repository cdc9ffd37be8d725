"""Quality of a mesh: empty parts, surfaces inside the body, thin cells."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from dolfinx.mesh import exterior_facet_indices

from dolfin_elastic.core.parallel import total
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.geometry.quality import worst_cells
from dolfin_elastic.mesh.geometry.simplices import cell_corners, prepare_facets, qualities

THIN = 0.05
"""Quality (1 is regular) below which results near a cell are poor: a needle of one to twenty."""
_SHOWN = 5
"""Thin cells that are listed with their places."""


def part_notes(body: Body) -> Iterator[str]:
    """Empty regions and surfaces, and surfaces with facets inside the body. Collective."""
    for name in sorted(body.regions):
        if not int(total(body.comm, len(body.owned_cells(name)))):
            yield f"the region '{name}' is empty: no cell carries it"
    prepare_facets(body.mesh)
    outside = exterior_facet_indices(body.mesh.topology)
    for name in sorted(body.surfaces):
        facets = body.owned_facets(name)
        inside = int(np.count_nonzero(~np.isin(facets, outside)))
        count, inside = total(body.comm, np.array([len(facets), inside]))
        if not count:
            yield f"the surface '{name}' is empty: no facet carries it"
        elif inside:
            yield (
                f"{inside} of {count} facets of the surface '{name}' lie inside the body, "
                "not on its boundary"
            )


def cell_notes(body: Body) -> Iterator[str]:
    """The number of thin cells, the worst of them with places. Collective."""
    own = body.owned_cells()
    shape = qualities(cell_corners(body.mesh, own))
    count = int(total(body.comm, int(np.count_nonzero(shape < THIN))))
    if count:
        worst = [cell for cell in worst_cells(body, _SHOWN) if cell.quality < THIN]
        places = ", ".join(f"{c.quality:.2g} at {_place(c.middle)}" for c in worst)
        more = ", ..." if count > len(worst) else ""
        yield (
            f"{count} of {body.num_cells} cells are thin (quality below {THIN:g}; 1 is regular): "
            f"{places}{more} m"
        )


def _place(point: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in point) + ")"
