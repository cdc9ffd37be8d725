"""The material regions of a body: which law fills which cells, with constants bound to them."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx.fem import Constant
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError, MeshError, nearest
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import IndexArray
from dolfin_elastic.material_point.checks import check_user_energies
from dolfin_elastic.mesh.body import Body, cell_size, span
from dolfin_elastic.model.dimension import GEOMETRIES, Geometry
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.user import UserEnergy
from dolfin_elastic.problem.coefficients import BoundLaw, CoefficientBinder
from dolfin_elastic.problem.formulation import (
    STIFF_IN_VOLUME,
    Formulation,
    Plan,
    describe,
    locking,
    plan,
    poisson,
    shear_modulus,
)

log = logging.getLogger("dolfin_elastic")
WHOLE = "body"


@dataclass(frozen=True)
class MaterialRegion:
    """The cells that one material fills.

    Attributes:
        name: Material's name.
        law: The law with UFL expressions in place of its numbers.
        cells: Owned local cells of this rank, sorted.
        marker: The region's number in the volume measure.
        density: UFL expression [kg/m^3], or None if not given.
        typical: The law with numbers only, the means of what varies in space.
        compliance: 1/k of the volumetric part [1/Pa] where a pressure carries it, or None.
        shear: Shear modulus at small strains [Pa], for scales of scalar fields; 1 without any.
    """

    name: str
    law: Law
    cells: IndexArray
    marker: int
    density: Expr | None
    typical: Law
    compliance: Expr | None
    shear: Constant


def make_material_regions(
    body: Body,
    laws: Mapping[str, Law],
    formulation: Formulation,
    *,
    degree: int,
    order: int,
    geometry: Geometry,
) -> tuple[tuple[MaterialRegion, ...], Plan]:
    """Binds laws to their cells and decides what is solved for. Collective.

    Args:
        body: The mesh and its names.
        laws: Region's name to law; `WHOLE` is the whole body unless a region is called so.
        formulation: What the user wants.
        degree: Degree of the displacement.
        order: Degree of the displacement or of the mesh, whichever is higher.
        geometry: Kind of a two-dimensional body.

    Raises:
        MeshError: A name does not exist, or the materials do not cover the body exactly once.
        InputError: A material that cannot be, or not so.
    """
    binder = CoefficientBinder(body, order)
    cells = {name: _cells(body, name) for name in laws}
    _check_cover(body, cells)
    bound = {
        name: binder.bind(law, cells[name], "" if _is_whole(body, name) else f"materials.{name}")
        for name, law in laws.items()
    }
    typical = {name: b.typical for name, b in bound.items()}
    written = {f"materials.{n}": law for n, law in typical.items() if isinstance(law, UserEnergy)}
    if written:
        check_user_energies(written, body.comm)
    fields = plan(typical, formulation, degree, plane_stress=geometry == "plane-stress")
    if fields.mixed:
        log.info("unknowns: %s", describe(fields, degree))
    for law in laws.values():
        if law.warning:
            log.warning("%s", law.warning)
    regions = tuple(
        _region(body, i + 1, name, cells[name], bound[name], fields) for i, name in enumerate(laws)
    )
    for note in locking_notes(body, regions, degree, geometry):
        log.warning("%s", note)
    return regions, fields


def _is_whole(body: Body, name: str) -> bool:
    return name == WHOLE and name not in body.regions


def _cells(body: Body, name: str) -> IndexArray:
    return body.owned_cells(None if _is_whole(body, name) else name)


def _region(
    body: Body, marker: int, name: str, cells: IndexArray, bound: BoundLaw, fields: Plan
) -> MaterialRegion:
    compliance = None
    if name in fields.mixed:
        # A number is written as one, so that an infinite modulus has the compliance 0.
        modulus = getattr(bound.law, bound.law.volume_modulus)  # type: ignore[attr-defined]
        number = modulus.value if isinstance(modulus, Constant) else modulus
        compliance = (
            1.0 / modulus if isinstance(number, Expr) else _constant(body, 1.0 / float(number))
        )
    return MaterialRegion(
        name,
        bound.law,
        cells,
        marker,
        bound.density,
        bound.typical,
        compliance,
        _constant(body, shear_modulus(bound.typical) if fields.auxiliary_fields else 1.0),
    )


def _constant(body: Body, value: float) -> Constant:
    return Constant(body.mesh, np.asarray(value, dtype=np.float64))


def _check_cover(body: Body, cells: Mapping[str, IndexArray]) -> None:
    times = np.zeros(len(body.owned_cells()), dtype=np.int64)
    for filled in cells.values():
        times[filled] += 1
    bare, twice = total(body.comm, np.array([np.sum(times == 0), np.sum(times > 1)]))
    if bare:
        raise MeshError(
            f"{bare} of {body.num_cells} cells have no material",
            where="materials",
            expected="every cell needs exactly one",
        )
    if twice:
        raise MeshError(
            f"{twice} cells have more than one material",
            where="materials",
            expected="every cell needs exactly one",
        )


def locking_notes(
    body: Body, regions: Sequence[MaterialRegion], degree: int, geometry: Geometry
) -> list[str]:
    """What to expect of linear elements of nearly incompressible materials. Collective."""
    if degree > 1 or geometry == "plane-stress":
        return []
    across = span(body) / cell_size(body)
    notes = []
    for region in regions:
        nu = poisson(region.typical)
        if region.compliance is None and nu > STIFF_IN_VOLUME:
            low, high = locking(nu, across)
            notes.append(
                f"linear elements lock at nu = {nu:g} ('{region.name}'): expect the body to be "
                f"{low:.2g} to {high:.3g} times too stiff on this mesh; use "
                'mesh.formulation = "mixed" or mesh.degree = 2'
            )
    return notes


def checked_geometry(geometry: Geometry, thickness: float, body: Body) -> Geometry:
    """The kind of a two-dimensional body; a three-dimensional one is what it is. Collective.

    Raises:
        InputError: There is no such kind, or the body cannot be of it.
    """
    if geometry not in GEOMETRIES:
        raise InputError(
            f"unknown geometry '{geometry}'",
            where="mesh.geometry",
            expected=nearest(geometry, GEOMETRIES),
        )
    if thickness != 1.0 and (body.dim == 3 or geometry == "axisymmetric"):
        raise InputError(
            "such a body has no thickness", where="mesh.thickness", expected="leave it out"
        )
    if not (np.isfinite(thickness) and thickness > 0):
        raise InputError(
            f"{thickness:g} is not a possible thickness",
            where="mesh.thickness",
            expected="a positive length",
        )
    if body.dim == 3 and geometry != "plane-strain":
        raise InputError(
            f"a three-dimensional body is not '{geometry}'",
            where="mesh.geometry",
            expected="leave it out",
        )
    if geometry == "axisymmetric":
        inside = body.mesh.geometry.x[:, 0] < -1e-9 * cell_size(body)
        if count := int(total(body.comm, int(inside.sum()))):
            raise InputError(
                f"{count} points of the mesh have a negative radius x",
                where="mesh.geometry",
                expected="an axisymmetric body lies at x >= 0 and turns about y",
            )
    return geometry
