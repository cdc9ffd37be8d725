"""The rest state of each material: what warmth and growth make of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.model.loads import Eigenstrain, Load
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.material_regions import MaterialRegion


def eigenstrains(site: FormContext, loads: Sequence[Load]) -> dict[str, Expr]:
    """Material's name to its growth Fg; those that do not grow are left out. Collective.

    Raises:
        InputError: A material that is warmed has no coefficient of expansion.
    """
    found: dict[str, Expr] = {}
    for index, load in enumerate(loads):
        if not isinstance(load, Eigenstrain):
            continue
        share = _share(site, load.parts) if load.parts else None
        for part in site.parts:
            if share is not None and not _meets(site, part, share):
                continue
            if load.kind == "thermal" and part.law.expansion is None:
                raise InputError(
                    f"load[{index}] ({load.kind}) needs a coefficient of expansion",
                    where=f"materials.{part.name}.expansion",
                    expected='for example "12 ppm/K"',
                )
            growth = load.growth(site, part.law.expansion, share)
            found[part.name] = _joined(part, growth, found.get(part.name))
    return found


def _joined(part: MaterialRegion, growth: Expr, before: Expr | None) -> Expr:
    """Growth after growth: a product, but small strains add up."""
    if before is None:
        return growth
    return growth + before - ufl.Identity(3) if part.law.linear else growth * before


def _share(site: FormContext, regions: Sequence[str]) -> fem.Function:
    """1 in the cells of regions, 0 in all others."""
    share = fem.Function(fem.functionspace(site.body.mesh, ("DG", 0)))
    for name in regions:
        share.x.array[site.body.region(name)] = 1.0
    return share


def _meets(site: FormContext, part: MaterialRegion, share: fem.Function) -> bool:
    return bool(total(site.body.comm, int(np.any(share.x.array[part.cells]))))
