"""The stress-free state of each material, changed by temperature and growth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError, keyed
from dolfin_elastic.core.ghosts import marked
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.mesh.body import cell_size
from dolfin_elastic.mesh.inner_surfaces import CellFacets, outward_areas, sides_of_surface
from dolfin_elastic.model.kinematics import deformation_from, displacement_gradient
from dolfin_elastic.model.loads import Eigenstrain, Load
from dolfin_elastic.model.loads.bolt import Bolt
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.material_regions import MaterialRegion

_THROUGH = 0.1
"""Least cosine of the angle between the axis of a bolt and the normal of its section."""


def eigenstrains(
    context: FormContext, loads: Sequence[Load], shanks: Mapping[int, Shank]
) -> dict[str, Expr]:
    """Material's name to its growth Fg; those that do not grow are left out. Collective.

    Args:
        loads: All loads; those that are no eigenstrains are passed over.
        shanks: From `shanks_of`.

    Raises:
        InputError: A material that is warmed has no coefficient of expansion, or times of one
            temperature.
    """
    result: dict[str, Expr] = {}
    for index, load in enumerate(loads):
        if not isinstance(load, Eigenstrain):
            continue
        cells: fem.Function | None = None
        share: Expr | None = None
        if (shank := shanks.get(index)) is not None:
            cells, share = shank.cells, shank.g
        elif load.parts:
            cells = share = indicator(context, load.parts)
        for region in context.regions:
            if cells is not None and not _meets(context, region, cells):
                continue
            if load.kind == "thermal" and region.law.expansion is None:
                raise InputError(
                    f"load[{index}] ({load.kind}) needs a coefficient of expansion",
                    where=f"{region.table}.expansion",
                    expected='for example "12 ppm/K"',
                )
            if load.kind == "thermal" and region.law.viscous_shift is not None:
                raise InputError(
                    f"load[{index}] (thermal) changes the temperature, and the relaxation times "
                    "are those of one",
                    where=f"{region.table}.viscous_shift",
                    expected="one of both",
                )
            growth = load.growth(context, region.law.expansion, share)
            result[region.name] = _joined(region, growth, result.get(region.name))
    return result


@dataclass(frozen=True)
class Shank:
    """Where a bolt is shortened.

    Attributes:
        cells: 1 in the cells that are strained, else 0.
        g: The field of `Bolt`, shape (3,).
        length: L [m].
    """

    cells: fem.Function
    g: Expr
    length: float


def shanks_of(context: FormContext, loads: Sequence[Load]) -> dict[int, Shank]:
    """Number of each bolt among the loads to its shank. Collective.

    Raises:
        InputError: See `_shank`.
    """
    result = {}
    for index, load in enumerate(loads):
        if isinstance(load, Bolt):
            with keyed(f"load[{index}]"):
                result[index] = _shank(context, load)
    return result


def _shank(context: FormContext, bolt: Bolt) -> Shank:
    """The shank of a bolt: a region, or one side of an inner surface. Collective.

    Raises:
        InputError: The shank has no length along the axis, or the surface does not cut it.
    """
    body, a = context.body, bolt.direction
    if all(name in body.regions for name in bolt.parts):
        cells = np.concatenate([body.owned_cells(name) for name in bolt.parts])
        along = body.mesh.geometry.x[body.mesh.geometry.dofmap[cells]] @ a
        high, low = (largest(body.comm, float((s * along).max(initial=-np.inf))) for s in (1, -1))
        if not high + low > 0.0:
            raise InputError(
                "the shank has no length along it",
                where="axis",
                expected="an axis in the plane of the body",
            )
        share = indicator(context, bolt.parts)
        return Shank(share, share * ufl.as_vector([*map(float, a)]), high + low)
    with keyed("on"):
        body.surface(bolt.parts[0])
        if len(bolt.parts) > 1:
            raise InputError("a bolt is cut once", expected="one inner surface for each bolt")
    return _pretension_section(context, bolt)


def _pretension_section(context: FormContext, bolt: Bolt) -> Shank:
    """The elements on one side of an inner surface. Collective."""
    body, (name,) = context.body, bolt.parts
    try:
        sides = sides_of_surface(body, name)
    except InputError as error:
        raise InputError(
            error.what,
            where="on",
            expected='a surface that cuts the shank through, as {cut = true, plane = "z", at = 20, '
            'of = "shank"} in [surfaces]',
        ) from None
    local, beside = np.nonzero(np.isin(CellFacets(body).of_cells, body.surface(name)))
    ahead = sides[local] == 1
    N, _ = outward_areas(body, local[ahead], beside[ahead])
    through, area = total(
        body.comm,
        np.array([(N @ bolt.direction[: body.dim]).sum(), np.linalg.norm(N, axis=1).sum()]),
    )
    if abs(through) < _THROUGH * area:
        raise InputError(
            f"the axis lies in the surface '{name}'", where="axis", expected="one that crosses it"
        )
    one, cells = (
        fem.Function(fem.functionspace(body.mesh, element)) for element in (("P", 1), ("DG", 0))
    )
    cells.x.array[: len(sides)] = sides == 1
    cells.x.scatter_forward()
    S, facets = one.function_space, body.surface(name)
    nodes = fem.locate_dofs_topological(S, body.dim - 1, facets)
    one.x.array[:] = marked(S.dofmap.index_map, nodes)
    length = cell_size(body)
    gradient = float(np.sign(through)) * length * cells * ufl.grad(one)
    return Shank(cells, ufl.as_vector([*gradient, 0.0][:3]), length)


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
