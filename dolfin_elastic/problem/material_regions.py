"""The material regions of a body, and which unknowns their laws need beside the displacement."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from dolfinx.fem import Constant
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import OF_MATERIAL, InputError, MeshError, keyed, nearest
from dolfin_elastic.core.parallel import on_root, total
from dolfin_elastic.core.types import IndexArray
from dolfin_elastic.mesh.body import Body, cell_size, span
from dolfin_elastic.model.kinematics import GEOMETRIES, Geometry
from dolfin_elastic.model.materials.law import BoundLaw, Law, SplitLaw
from dolfin_elastic.problem.pressure.graded import stiffness_step
from dolfin_elastic.problem.spaces import AuxiliaryField

log = logging.getLogger("dolfin_elastic")
WHOLE = "body"
Formulation = Literal["auto", "displacement", "mixed"]

UNEVEN = 1.1
"""Ratio of the stiffness of two neighbouring cells from which on the error of a continuous pressure
is told: 4 % of the stress."""

STIFF_IN_VOLUME = 0.45
"""Poisson's ratio above which displacements alone lose accuracy."""


@dataclass(frozen=True)
class Plan:
    """Auxiliary unknowns beside the displacement.

    Attributes:
        mixed: Names of the materials whose volumetric part a pressure carries.
        auxiliary_fields: The scalar fields.
    """

    mixed: frozenset[str]
    auxiliary_fields: tuple[AuxiliaryField, ...]


def plan(
    parts: Mapping[str, BoundLaw],
    formulation: Formulation,
    degree: int,
    *,
    plane_stress: bool,
) -> Plan:
    """Decides from the materials which unknowns there are beside the displacement.

    The pressure of quadratic elements is linear (Taylor & Hood, Computers & Fluids 1 (1973));
    with linear elements it is linear too, and stabilised.  In plane stress the volume can change
    through the thickness, and everything beside the displacement belongs to one cell.

    Args:
        parts: By the name of the material.
        formulation: As the user chose.

    Raises:
        InputError: A material cannot be computed so.
    """
    laws = {name: part.typical for name, part in parts.items()}
    nearly = {name for name, law in laws.items() if poisson(law) > STIFF_IN_VOLUME}
    exactly = {name for name, law in laws.items() if not math.isfinite(volume_modulus(law))}
    _check(laws, exactly, formulation, degree)
    split = {name for name, law in laws.items() if _carried(law)}
    mixed: set[str] = set()
    if formulation == "mixed":
        mixed = nearly & split or split
    elif formulation == "auto" and (
        exactly or (degree > 1 and nearly & split and not plane_stress)
    ):
        mixed = exactly | (nearly & split)
    auxiliary_fields = []
    if plane_stress:
        auxiliary_fields.append(AuxiliaryField("stretch", degree - 1, continuous=False))
    if mixed:
        auxiliary_fields.append(
            AuxiliaryField("pressure", degree - 1, continuous=False)
            if plane_stress
            else AuxiliaryField("pressure", 1, continuous=True)
        )
    return Plan(frozenset(mixed), tuple(auxiliary_fields))


def _carried(law: Law) -> bool:
    """A pressure can carry the volumetric part; it remembers nothing."""
    return isinstance(law, SplitLaw) and volume_modulus(law) > 0 and not law.relaxes_whole


def _check(
    laws: Mapping[str, Law], exactly: set[str], formulation: Formulation, degree: int
) -> None:
    for name in sorted(exactly):
        if not isinstance(laws[name], SplitLaw):
            raise InputError(
                f"the law '{laws[name].name()}' cannot be incompressible",
                where=f"materials.{name}.nu",
                expected="nu must lie below 0.5: it has no volumetric part",
            )
        if not _carried(laws[name]):
            raise InputError(
                "the whole stress relaxes, but the pressure of an incompressible material cannot",
                where=f"materials.{name}.viscous_on",
                expected='"isochoric", or nu below 0.5',
            )
        if formulation == "displacement" or (formulation == "auto" and degree == 1):
            raise InputError(
                "an incompressible material needs a pressure beside the displacement",
                where=f"materials.{name}.nu",
                expected='mesh.formulation = "mixed" or mesh.degree = 2, or nu below 0.5',
            )
    if formulation == "mixed" and not any(_carried(law) for law in laws.values()):
        raise InputError(
            "no material has a volumetric part that a pressure could carry",
            where="mesh.formulation",
            expected='"displacement"',
        )


@dataclass(frozen=True)
class MaterialRegion(BoundLaw):
    """The cells that one material fills, and its law with UFL expressions for its numbers.

    Attributes:
        name: Material's name.
        cells: Owned local cells of this rank, sorted.
        marker: The region's number in the volume measure.
        compliance: 1/k of the volumetric part [1/Pa] where a pressure carries it, or None.
        shear: Shear modulus at small strains [Pa], for scales of scalar fields; 1 without any.
    """

    name: str
    cells: IndexArray
    marker: int
    compliance: Expr | None = None
    shear: Expr = 1.0

    @property
    def material(self) -> str:
        """Name of the material in a case."""
        return self.name.removesuffix(OF_MATERIAL)

    @property
    def table(self) -> str:
        """Key of the material in a case, "materials.rubber"."""
        return f"materials.{self.material}"

    @property
    def incompressible(self) -> bool:
        """The compliance is exactly zero: the pressure is a Lagrange multiplier."""
        return isinstance(self.compliance, Constant) and float(self.compliance.value) == 0.0


def make_material_regions(
    body: Body,
    laws: Mapping[str, Law],
    formulation: Formulation,
    *,
    degree: int,
    order: int,
    geometry: Geometry,
) -> tuple[tuple[MaterialRegion, ...], Plan]:
    """Binds laws to their cells and chooses the auxiliary unknowns. Collective.

    Args:
        laws: Region's name to law; `WHOLE` is the whole body unless a region is called so.
        formulation: As the user chose.
        order: Degree of the displacement or of the mesh, whichever is higher.

    Raises:
        MeshError: A name does not exist, or the materials do not cover the body exactly once.
        InputError: A material that cannot be, or not so.
    """
    cells = {name: _cells(body, name) for name in laws}
    _check_cover(body, cells)
    bound = {name: _bound(body, order, name, law, cells[name]) for name, law in laws.items()}
    written = {
        f"materials.{name}": part.typical if part.means else part.given
        for name, part in bound.items()
    }
    check_user_energies(written, body.comm)
    fields = plan(bound, formulation, degree, plane_stress=geometry == "plane-stress")
    if fields.mixed:
        log.info("unknowns: %s", describe(fields, degree))
    for law in laws.values():
        if law.warning:
            log.warning("%s", law.warning)
    regions = tuple(
        MaterialRegion(
            **vars(part),
            **_scalars(body, name, part, fields),
            name=name,
            cells=cells[name],
            marker=i + 1,
        )
        for i, (name, part) in enumerate(bound.items())
    )
    for note in locking_notes(body, regions, degree, geometry):
        log.warning("%s", note)
    return regions, fields


def _is_whole(body: Body, name: str) -> bool:
    return name == WHOLE and name not in body.regions


def _cells(body: Body, name: str) -> IndexArray:
    return body.owned_cells(None if _is_whole(body, name) else name)


def _bound(body: Body, order: int, name: str, law: Law, cells: IndexArray) -> BoundLaw:
    functions, means, largest_nu = dict[str, Expr](), dict[str, Any](), None
    if law.spatial_constants():
        from dolfin_elastic.problem.coefficients import CoefficientBinder

        where = "" if _is_whole(body, name) else f"materials.{name}"
        binder = CoefficientBinder(body, order)
        functions, means, largest_nu = binder.functions(law, cells, where)
    return law.bind(partial(Constant, body.mesh), functions, means, largest_nu)


def _scalars(body: Body, name: str, part: BoundLaw, fields: Plan) -> dict[str, Expr]:
    """What the scalar fields of a region need, as it has them."""
    if not fields.auxiliary_fields:
        return {}
    moduli = part.moduli
    shear = moduli.mu if moduli else Constant(body.mesh, shear_modulus(part.typical))
    if name not in fields.mixed:
        return {"shear": shear}
    k = getattr(part.law, part.law.volume_modulus)  # type: ignore[attr-defined]
    compliance = Constant(body.mesh, 0.0) if isinstance(k, float) else 1.0 / k
    return {"shear": shear, "compliance": compliance}


def _check_cover(body: Body, cells: Mapping[str, IndexArray]) -> None:
    times = np.zeros(len(body.owned_cells()), dtype=np.int64)
    for filled in cells.values():
        times[filled] += 1
    bare, twice = total(body.comm, np.array([np.sum(times == 0), np.sum(times > 1)]))
    if bare:
        raise MeshError(
            f"{bare} of {body.num_cells} elements have no material",
            where="materials",
            expected="every element needs exactly one",
        )
    if twice:
        raise MeshError(
            f"{twice} elements have more than one material",
            where="materials",
            expected="every element needs exactly one",
        )


def locking_notes(
    body: Body, regions: Sequence[MaterialRegion], degree: int, geometry: Geometry
) -> list[str]:
    """What to expect of nearly incompressible materials. Collective."""
    if geometry == "plane-stress":
        return []
    notes = []
    for region in regions:
        step = 1.0 if region.compliance is None else stiffness_step(body, region.law, region.cells)
        if step > UNEVEN:
            notes.append(
                f"the stiffness of '{region.name}' changes by a factor of up to {step:.3g} from "
                "one element to the next, and its pressure is one continuous field: stress there "
                f"is off by up to about {(step - 1) / (step + 1):.2g} of itself; where the "
                "stiffness jumps, give each side a material of its own, where it is graded, "
                "refine the mesh"
            )
    if degree > 1:
        return notes
    across = span(body) / cell_size(body)
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

    Args:
        thickness: Of a plane body [m].

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
            "only a plane body has a thickness", where="mesh.thickness", expected="leave it out"
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


def locking(nu: float, cells_across: float) -> tuple[float, float]:
    """How many times too stiff a body of linear elements may be: from, to.

    Without a pressure of its own each linear cell keeps its volume, and a body of them can hardly
    bend or twist.  What this costs grows with x = lmbda/mu (h/L)^2, h the size of a cell and L that
    of the body.  Found at nu = 0.4999: a tube under pressure 0.013 x, Cook's membrane 0.06 x to
    0.8 x, a cylinder twisted 2 x.

    Args:
        cells_across: Size of the body over that of a cell.
    """
    x = 2 * nu / max(1 - 2 * nu, 1e-9) / cells_across**2
    return 1 + 0.013 * x, 1 + 2 * x


def describe(plan: Plan, degree: int) -> str:
    """The unknowns of a mixed problem in words, for the log."""
    pressure = next(extra for extra in plan.auxiliary_fields if extra.name == "pressure")
    kind = "P" if pressure.continuous else "DG"
    stabilised = ", stabilised" if pressure.continuous and degree == 1 else ""
    return (
        f"displacement P{degree} and pressure {kind}{pressure.degree}{stabilised} "
        f"(nearly incompressible: {', '.join(sorted(plan.mixed))})"
    )


def formulation_of(regions: Sequence[MaterialRegion]) -> str:
    """Which materials have a pressure: "displacement" (none), "mixed" (all) or "mixed in NAMES"."""
    mixed = [region.material for region in regions if region.compliance is not None]
    if not mixed:
        return "displacement"
    return "mixed" if len(mixed) == len(regions) else f"mixed in {', '.join(sorted(mixed))}"


def volume_modulus(law: Law) -> float:
    """Bulk modulus of a law with a volumetric part of its own [Pa]; 0 without one."""
    if isinstance(law, SplitLaw):
        return float(getattr(law, law.volume_modulus))
    return math.inf if poisson(law) == 0.5 else 0.0


def poisson(law: Law) -> float:
    """Poisson's ratio at small strains; 0 where a law has no volumetric part."""
    if (known := law.small_strain()) is not None:
        return known.nu
    if not isinstance(law, SplitLaw):
        return 0.0
    k, mu = volume_modulus(law), shear_modulus(law)
    return 0.5 if math.isinf(k) else (3 * k - 2 * mu) / (2 * (3 * k + mu))


def shear_modulus(law: Law) -> float:
    """Shear modulus at small strains, of anisotropic laws a mean [Pa]."""
    if (known := law.small_strain()) is not None:
        return known.mu
    from dolfin_elastic.model.point.checks import voigt
    from dolfin_elastic.model.point.tested import LawUnderTest

    with np.errstate(all="ignore"):
        stiffness = voigt(LawUnderTest(law).rest)
    mu = float(np.mean(np.diag(stiffness)[3:]))
    return mu if np.isfinite(mu) and mu > 0 else 1.0


def young(law: Law) -> float:
    """Young's modulus at small strains, of anisotropic laws about [Pa]."""
    return 2 * (1 + poisson(law)) * shear_modulus(law)


def check_user_energies(laws: Mapping[str, Law], comm: MPI.Comm) -> None:
    """Checks the energies that users wrote, each once, before a run starts. Collective.

    Args:
        laws: Dotted key of a material to its law.
        comm: All ranks of the run.

    Raises:
        InputError: On every rank, with the key and the first check that fails.
    """
    for key, law in laws.items():
        # Constants that vary in space have no values yet: after binding their means are checked.
        if not law.written or law.spatial_constants():
            continue
        from dolfin_elastic.model.materials.user import UserEnergy
        from dolfin_elastic.model.point.checks import check_energy

        assert isinstance(law, UserEnergy)
        with keyed(key):
            law.mark_checked(symmetric=on_root(comm, partial(check_energy, law)))
