"""Which cells share one continuous pressure.

Where two nearly incompressible materials meet, the pressure jumps: the traction is continuous, and
so are the tangential strains, but what moduli and growth make of them is not.  A continuous field
can only take the mean of both sides, an error that no refinement removes next to the interface.  So
each material has a pressure of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from dolfinx import la

from dolfin_elastic.core.types import IntArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.loads import Load
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.problem.material_regions import MaterialRegion

_WITHOUT_STRESS = {"density": None, "allowable": None}
"""Constants of a law that have no part in the stress of a body at rest."""


def pressure_groups(
    body: Body, regions: Sequence[MaterialRegion], laws: Mapping[str, Law], loads: Sequence[Load]
) -> IntArray | None:
    """The group of each local cell, ghosts too; None where there is one only. Collective.

    The cells of a group have the same law with the same constants, and the same growth.  Those
    without a pressure are one more group: the field is zero there.

    Args:
        laws: Material's name to its law, with what varies in space as it was written.
        loads: Those that change the natural state of parts of the body separate groups.
    """
    codes: list[object] = []
    cells = body.mesh.topology.index_map(body.dim)
    code = np.zeros(cells.size_local + cells.num_ghosts, dtype=np.int64)
    for region in regions:
        key = None if region.compliance is None else _relevant(laws[region.name])
        if key not in codes:
            codes.append(key)
        code[region.cells] = codes.index(key)
    growing = {load.parts: None for load in loads if load.is_eigenstrain and load.parts}
    if len(codes) == 1 and not growing:
        return None
    carried = np.array([key is not None for key in codes])[code]
    for parts in growing:
        inside = np.zeros(len(code), dtype=bool)
        for name in set(parts) & body.regions.keys():  # others are refused where they are used
            inside[body.owned_cells(name)] = True
        code = 2 * code + (inside & carried)
    known = np.unique(code[: cells.size_local])
    known = np.unique(np.concatenate(body.comm.allgather(known)))
    if len(known) == 1:
        return None
    result = la.vector(cells, 1, dtype=np.int64)
    result.array[:] = np.searchsorted(known, code)
    result.scatter_forward()
    return np.asarray(result.array.copy())


def _relevant(law: Law) -> Law:
    return law.model_copy(update=_WITHOUT_STRESS)
