"""The stress-free state of each material, changed by temperature and growth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from dolfinx import fem
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.model.kinematics import deformation_from, displacement_gradient
from dolfin_elastic.model.loads import Eigenstrain, Load
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.material_regions import MaterialRegion


def eigenstrains(context: FormContext, loads: Sequence[Load]) -> dict[str, Expr]:
    """Material's name to its growth Fg; those that do not grow are left out. Collective.

    Args:
        loads: All loads; those that are no eigenstrains are passed over.

    Raises:
        InputError: A material that is warmed has no coefficient of expansion.
    """
    result: dict[str, Expr] = {}
    for index, load in enumerate(loads):
        if not isinstance(load, Eigenstrain):
            continue
        share = indicator(context, load.parts) if load.parts else None
        for region in context.regions:
            if share is not None and not _meets(context, region, share):
                continue
            if load.kind == "thermal" and region.law.expansion is None:
                raise InputError(
                    f"load[{index}] ({load.kind}) needs a coefficient of expansion",
                    where=f"materials.{region.name}.expansion",
                    expected='for example "12 ppm/K"',
                )
            growth = load.growth(context, region.law.expansion, share)
            result[region.name] = _joined(region, growth, result.get(region.name))
    return result


def _joined(region: MaterialRegion, growth: Expr, before: Expr | None) -> Expr:
    """Growth after growth: a product, but small strains add up."""
    if before is None:
        return growth
    second, first = displacement_gradient(growth), displacement_gradient(before)
    both = second + first
    return deformation_from(both if region.law.linear else both + second * first)


def indicator(context: FormContext, regions: Sequence[str]) -> fem.Function:
    """1 in the cells of regions, 0 in all others."""
    share = fem.Function(fem.functionspace(context.body.mesh, ("DG", 0)))
    for name in regions:
        share.x.array[context.body.region(name)] = 1.0
    return share


def _meets(context: FormContext, region: MaterialRegion, share: fem.Function) -> bool:
    return bool(total(context.body.comm, int(np.any(share.x.array[region.cells]))))
