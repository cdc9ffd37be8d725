"""The table `FIELDS` of the fields that can be written and drawn.

The Cauchy stress and what follows from it are recovered at the nodes, see `results/recovery`.
Fields of cells are evaluated once per cell: they are constant in linear elements, and taken at the
barycentre of quadratic ones.  Tensors are 3x3 also in a plane body, with the stress across the
plane.  A component in local axes is a field of its own, see `Component`.  A law that is linear in
the displacement gradient H has one stress, its Cauchy stress, and one strain, sym H: reference and
current configuration coincide, and others would show the square of a rotation, of which such a law
knows nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Literal

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.model import kinematics
from dolfin_elastic.model.materials.growth import GrownLaw
from dolfin_elastic.model.materials.law import Law, ModifiedLaw, once
from dolfin_elastic.model.materials.spatial import direction
from dolfin_elastic.model.materials.spectral import polar
from dolfin_elastic.model.strength import Strength
from dolfin_elastic.results.derived import spectral
from dolfin_elastic.results.derived.remembered import REMEMBERED, remembered_by
from dolfin_elastic.results.field import Field, FieldTable, RecoveredField
from dolfin_elastic.results.verdict import SAFEST

if TYPE_CHECKING:
    from dolfin_elastic.mesh.body import Body
    from dolfin_elastic.mesh.fields import MeshField
    from dolfin_elastic.problem.problem import Problem


@once
def cauchy_stress(law: Law, F: Expr) -> Expr:
    """Cauchy stress [Pa], 3x3; of a linear law its only stress.

    Args:
        F: Deformation gradient, 3x3.
    """
    P = law.stress(F)
    return P if law.linear else kinematics.cauchy_from_first(P, F)


def _pressure(law: Law, F: Expr) -> Expr:
    return -ufl.tr(cauchy_stress(law, F)) / 3


def _safety_factor(law: Law, F: Expr) -> Expr | None:
    allowable = law.allowable
    if allowable is None:
        return None
    sigma = cauchy_stress(law, F)
    if isinstance(allowable, Strength):
        used = allowable.used(judged_tensor(law, F, sigma), axis_of(law))
        return 1 / ufl.max_value(used, 1 / SAFEST)
    return allowable / ufl.max_value(kinematics.von_mises(sigma), allowable / SAFEST)


def _von_mises(law: Law, F: Expr) -> Expr:
    return kinematics.von_mises(cauchy_stress(law, F))


def _second_piola(law: Law, F: Expr) -> Expr:
    P = law.stress(F)
    return P if law.linear else kinematics.second_from_first(P, F)


def _kirchhoff(law: Law, F: Expr) -> Expr:
    P = law.stress(F)
    return P if law.linear else kinematics.kirchhoff_from_first(P, F)


FIBRE_FIELDS = {"fibre": 0, "fibre_strain": 0, "fibre_stretch": 0, "fibre2": 1, "fibre2_strain": 1}
"""Fields of a material direction, and which one."""


def _written_fibre(law: Law | ModifiedLaw, number: int) -> Expr | Sequence[float] | None:
    """A material direction as it was given; None without one."""
    inner: Law | ModifiedLaw = law
    while isinstance(inner, ModifiedLaw):
        inner = inner.law
    names = inner.directions[number : number + 1]
    return getattr(inner, names[0], None) if names else None


def has_fibre(law: Law, number: int) -> bool:
    """Whether a material has a direction.

    Args:
        number: 0 or 1: the first or second of its directions.
    """
    return _written_fibre(law, number) is not None


def fibre_of(law: Law | ModifiedLaw, number: int) -> Expr | None:
    """Unit vector of a material direction in the reference configuration; None without one.

    Args:
        number: 0 or 1: the first or second of its directions.
    """
    value = _written_fibre(law, number)
    return None if value is None else direction(value)


def axis_of(law: Law | ModifiedLaw) -> Expr | None:
    """Unit vector of a material's strengths, undeformed body; None where they have no direction."""
    strength = law.allowable
    if not isinstance(strength, Strength) or not strength.directed:
        return None
    return fibre_of(law, 0) if strength.axis is None else direction(strength.axis)


def judged_tensor(law: Law | ModifiedLaw, F: Expr, sigma: Expr) -> Expr:
    """The stress or strain that a material's `Strength` judges, 3x3, turned back with the body.

    The Cauchy stress is turned back by R of F = R U, so that the axis stays that of the undeformed
    body; without an axis it need not be.  A strain is the elastic one: of a linear law its own, of
    others U - I, so that a strain of 1 % is an elongation of 1 %.

    Args:
        F: Deformation gradient, 3x3.
        sigma: Cauchy stress [Pa], 3x3.
    """
    strength = law.allowable
    assert isinstance(strength, Strength)
    if law.linear:
        return ufl.sym(law.strain(F) if strength.of_strain else sigma)
    if strength.of_strain:
        Fe = law.elastic(F) if isinstance(law, GrownLaw) else F
        turned = polar(Fe)
        return ufl.sym(turned.R.T * turned.stretching)
    if not strength.directed:
        return sigma
    R = polar(F).R
    return ufl.sym(R.T * sigma * R)


def _total_strain(law: Law, F: Expr) -> Expr:
    """Green strain; of a linear law its own measure sym H.

    Args:
        F: Deformation gradient, 3x3.
    """
    return kinematics.infinitesimal_strain(F) if law.linear else kinematics.green_strain(F)


def _almansi_strain(law: Law, F: Expr) -> Expr:
    return kinematics.infinitesimal_strain(F) if law.linear else kinematics.almansi_strain(F)


def _fibre_strain(number: int) -> Callable[[Law, Expr], Expr | None]:
    """Strain along a fibre, a.E a (Holzapfel, Nonlinear Solid Mechanics (2000), (2.75))."""

    def formula(law: Law, F: Expr) -> Expr | None:
        """See `Field.formula`.

        Args:
            F: Deformation gradient, 3x3.
        """
        a = fibre_of(law, number)
        return None if a is None else ufl.inner(a, _total_strain(law, F) * a)

    return formula


def _fibre_stretch(law: Law, F: Expr) -> Expr | None:
    strain = _fibre_strain(0)(law, F)
    if strain is None:
        return None
    return 1 + strain if law.linear else ufl.sqrt(1 + 2 * strain)


_FORMULAS: dict[RecoveredField, Callable[[Law, Expr], Expr | None]] = {
    "von_mises": _von_mises,
    "cauchy_stress": cauchy_stress,
    "pressure": _pressure,
    "safety_factor": _safety_factor,
}
_OF_STRESS: dict[RecoveredField, Callable[[AnyArray], AnyArray]] = {
    "principal_stresses": spectral.principal_values,
    "max_principal_stress": spectral.principal_value(0),
    "min_principal_stress": spectral.principal_value(2),
    "principal_direction_1": spectral.principal_direction(0),
    "principal_direction_2": spectral.principal_direction(1),
    "principal_direction_3": spectral.principal_direction(2),
    "tresca": spectral.tresca,
}
"""Fields that follow from the Cauchy stress in NumPy."""
_VECTORS = (
    "principal_stresses",
    "principal_direction_1",
    "principal_direction_2",
    "principal_direction_3",
)
_PURE = ("safety_factor", *_VECTORS[1:])
"""Fields of the recovered stress without a unit."""


def _recovered(name: RecoveredField, description: str) -> Field:
    return Field(
        "tensor" if name == "cauchy_stress" else "vector" if name in _VECTORS else "scalar",
        "node",
        "" if name in _PURE else "Pa",
        description,
        _FORMULAS.get(name, cauchy_stress),
        of_tensor=_OF_STRESS.get(name),
        current=2,
        values=lambda source: source.recovered(name),
        recovered=True,
    )


def _stretching(law: Law, F: Expr) -> Expr:
    """Displacement gradient H; of a linear law without the rotation, sym H.

    Args:
        F: Deformation gradient, 3x3.
    """
    H = kinematics.displacement_gradient(F)
    return ufl.sym(H) if law.linear else H


def _of_stretches(
    shape: Literal["scalar", "vector", "tensor"],
    description: str,
    of_tensor: Callable[[AnyArray], AnyArray],
    current: int = 0,
) -> Field:
    """A field of cells without a unit that follows from the displacement gradient in NumPy.

    Args:
        of_tensor: See `Field`.
        current: See `Field`.
    """
    return Field(shape, "cell", "", description, _stretching, of_tensor=of_tensor, current=current)


_FIELDS: dict[str, Field] = {
    "displacement": Field(
        "vector", "node", "m", "displacement", values=lambda source: source.nodal("u")
    ),
    "velocity": Field(
        "vector", "node", "m/s", "velocity", motion=True, values=lambda source: source.nodal("v")
    ),
    "acceleration": Field(
        "vector",
        "node",
        "m/s^2",
        "acceleration",
        motion=True,
        values=lambda source: source.nodal("a"),
    ),
    "reaction": Field(
        "vector",
        "node",
        "N",
        "nodal force of the supports on the body, from the residual; zero at free nodes",
        statics=True,
        values=lambda source: source.reaction(),
    ),
    "residual": Field(
        "vector",
        "node",
        "N",
        "nodal force out of balance; round-off in an equilibrium, zero where supports hold",
        statics=True,
        values=lambda source: source.residual(),
    ),
    "von_mises": _recovered("von_mises", "von Mises stress, from the recovered Cauchy stress"),
    "von_mises_nodal": _recovered("von_mises", "the same as von_mises"),
    "von_mises_cell": Field(
        "scalar", "cell", "Pa", "von Mises stress of the element, not recovered", _von_mises
    ),
    "cauchy_stress": _recovered(
        "cauchy_stress", "recovered Cauchy stress: force over current area"
    ),
    "cauchy_stress_cell": Field(
        "tensor",
        "cell",
        "Pa",
        "Cauchy stress of the element, not recovered",
        cauchy_stress,
        current=2,
    ),
    "first_piola": Field(
        "tensor",
        "cell",
        "Pa",
        "first Piola-Kirchhoff stress: force over reference area",
        lambda law, F: law.stress(F),
        current=1,
    ),
    "second_piola": Field(
        "tensor",
        "cell",
        "Pa",
        "second Piola-Kirchhoff stress, of the reference configuration",
        _second_piola,
    ),
    "kirchhoff_stress": Field(
        "tensor",
        "cell",
        "Pa",
        "Kirchhoff stress: J times the Cauchy stress",
        _kirchhoff,
        current=2,
    ),
    "principal_stresses": _recovered(
        "principal_stresses", "principal values of the recovered Cauchy stress, largest first"
    ),
    "max_principal_stress": _recovered(
        "max_principal_stress", "largest principal value of the recovered Cauchy stress"
    ),
    "min_principal_stress": _recovered(
        "min_principal_stress", "smallest principal value of the recovered Cauchy stress"
    ),
    "principal_direction_1": _recovered(
        "principal_direction_1", "unit direction of the largest principal stress"
    ),
    "principal_direction_2": _recovered(
        "principal_direction_2", "unit direction of the middle principal stress"
    ),
    "principal_direction_3": _recovered(
        "principal_direction_3", "unit direction of the smallest principal stress"
    ),
    "tresca": _recovered(
        "tresca", "Tresca stress: largest minus smallest principal stress, recovered"
    ),
    "pressure": _recovered("pressure", "pressure: minus the mean recovered Cauchy stress"),
    "pressure_cell": Field(
        "scalar", "cell", "Pa", "pressure of the element: minus its mean Cauchy stress", _pressure
    ),
    "strain": Field(
        "tensor",
        "cell",
        "",
        "strain from which the law computes the stress, without thermal strain and growth",
        lambda law, F: law.strain(F),
    ),
    "green_strain": Field(
        "tensor",
        "cell",
        "",
        "Green strain; of a small-strain law its strain, the symmetric displacement gradient",
        _total_strain,
    ),
    "deformation_gradient": Field(
        "tensor", "cell", "", "deformation gradient F, row by row", lambda law, F: F, current=1
    ),
    "log_strain": _of_stretches(
        "tensor", "logarithmic strain ln V (Hencky)", spectral.log_strain, current=2
    ),
    "almansi_strain": Field(
        "tensor",
        "cell",
        "",
        "Almansi strain, of the current configuration",
        _almansi_strain,
        current=2,
    ),
    "max_principal_strain": _of_stretches(
        "scalar", "largest principal strain: elongation over length", spectral.principal_strain(0)
    ),
    "min_principal_strain": _of_stretches(
        "scalar", "smallest principal strain: elongation over length", spectral.principal_strain(2)
    ),
    "principal_stretches": _of_stretches(
        "vector", "principal stretches, largest first", spectral.principal_stretches
    ),
    "stretch_direction_1": _of_stretches(
        "vector",
        "direction of the largest stretch, undeformed body",
        spectral.stretch_direction(0),
    ),
    "stretch_direction_2": _of_stretches(
        "vector", "direction of the middle stretch, undeformed body", spectral.stretch_direction(1)
    ),
    "stretch_direction_3": _of_stretches(
        "vector",
        "direction of the smallest stretch, undeformed body",
        spectral.stretch_direction(2),
    ),
    **REMEMBERED,
    "fibre": Field(
        "vector",
        "cell",
        "",
        "unit vector along the law's first direction, undeformed body",
        lambda law, F: fibre_of(law, 0),
        fixed=True,
    ),
    "fibre2": Field(
        "vector",
        "cell",
        "",
        "unit vector along the law's second direction, undeformed body",
        lambda law, F: fibre_of(law, 1),
        fixed=True,
    ),
    "fibre_strain": Field(
        "scalar", "cell", "", "green_strain along the law's first direction", _fibre_strain(0)
    ),
    "fibre2_strain": Field(
        "scalar", "cell", "", "green_strain along the law's second direction", _fibre_strain(1)
    ),
    "fibre_stretch": Field(
        "scalar", "cell", "", "stretch along the law's first direction", _fibre_stretch
    ),
    "jacobian": Field(
        "scalar",
        "cell",
        "",
        "current over reference volume, det F",
        lambda law, F: kinematics.jacobian(F),
    ),
    "energy_density": Field(
        "scalar",
        "cell",
        "J/m^3",
        "strain energy per reference volume",
        lambda law, F: law.energy(F),
    ),
    "safety_factor": _recovered(
        "safety_factor",
        "allowable stress of the material over the von Mises stress, or the factor on the stress "
        "at which its strength is used up; 1000 at most",
    ),
    "error": Field(
        "scalar",
        "cell",
        "Pa",
        "estimated error of the element's stress: of recovered minus raw, mean square",
        values=lambda source: source.stress_error(),
    ),
    "young_modulus": Field(
        "scalar",
        "cell",
        "Pa",
        "Young's modulus of the material",
        lambda law, F: getattr(law, "E", None),
        fixed=True,
    ),
    "density": Field(
        "scalar",
        "cell",
        "kg/m^3",
        "mass of the material per reference volume",
        lambda law, F: law.density,
        fixed=True,
    ),
    "normal": Field(
        "vector",
        "node",
        "",
        "outward unit normal of the deformed surface; zero inside",
        values=lambda source: source.normal(),
    ),
    "contact_pressure": Field(
        "scalar",
        "node",
        "Pa",
        "pressure of obstacles on the body, per reference area; zero without contact",
        values=lambda source: source.contact_pressure(),
    ),
    "contact_gap": Field(
        "scalar",
        "node",
        "m",
        "distance of the surfaces of contacts from the nearest obstacle, negative inside it",
        values=lambda source: source.contact_gap(),
    ),
    "friction_traction": Field(
        "vector",
        "node",
        "Pa",
        "tangential traction of obstacles on the body, per reference area; zero without friction",
        values=lambda source: source.friction_traction(),
    ),
    "contact_status": Field(
        "scalar",
        "node",
        "",
        "0: not in contact; 1: sticks to an obstacle; 2: slides along it",
        values=lambda source: source.contact_status(),
    ),
    "region": Field(
        "scalar",
        "cell",
        "",
        "number of the named region, in alphabetical order; -1: none",
        values=lambda source: source.region(),
        fixed=True,
    ),
    "material": Field(
        "scalar",
        "cell",
        "",
        "number of the material, in the order of the case",
        values=lambda source: source.material(),
        fixed=True,
    ),
    "rank": Field(
        "scalar",
        "cell",
        "",
        "MPI rank that owns the element",
        values=lambda source: source.rank(),
        fixed=True,
    ),
}

FIELDS = FieldTable(_FIELDS)
_AXES = "xyz"


def component_names(stem: str, size: int) -> list[str]:
    """Names of the columns of a field in tables.

    Args:
        size: Number of components: 1, 2 or 3 of a vector, 9 of a tensor, row by row.
    """
    if size == 1:
        return [stem]
    ends = _AXES[:size] if size < 4 else [a + b for a in _AXES for b in _AXES]
    return [f"{stem}_{end}" for end in ends]


DEFAULT = ("displacement", "von_mises", "cauchy_stress")
IN_MOTION = ("velocity",)


def default_fields(laws: Iterable[Law]) -> tuple[str, ...]:
    """Fields that are written where none are named.

    With a table of strengths the safety factor is among them: it does not follow from the others.
    """
    by_direction = any(isinstance(law.allowable, Strength) for law in laws)
    return (*DEFAULT, "safety_factor") if by_direction else DEFAULT


# --- fields of a body ---

_SHAPES: dict[int, Literal["scalar", "vector", "tensor"]] = {
    1: "scalar",
    2: "vector",
    3: "vector",
    9: "tensor",
}
"""Components of a field of a body to what they are."""
_TAKEN = {"points", "cells", "Points", "Connectivity", "Offsets", "Types", "vtkGhostType"}
_TAKEN |= {"node", "cell", *_AXES}
"""Arrays and columns that files of results have themselves."""
_NOT_IN_NAMES = "\"'<>&/:;,"
"""What separates names in HDF5, XML, CSV and the files of Gmsh."""


def name_in_results(name: str, body: Body) -> str:
    """Name that a field of a body has in results: its own, unless results have one of this name.

    Then it is one that no other field of the body has, such as one of the results of another run.
    """
    if name not in _TAKEN and name not in FIELDS:
        return name
    while name in FIELDS or name in _TAKEN or name in body.fields:
        name = f"{name}_of_mesh"
    return name


def field_table(body: Body, laws: Iterable[Law] = ()) -> FieldTable:
    """`FIELDS`, the fields of a body that results can hold, and what laws remember. Local."""
    remembered = remembered_by(laws)
    if not (body.fields or remembered):
        return FIELDS
    rows = remembered | {
        name_in_results(name, body): _of_body(name, given)
        for name, given in body.fields.items()
        if not _unfit(name, given)
    }
    return FieldTable({**_FIELDS, **rows})


def laws_of(problem: Problem) -> list[Law]:
    """The laws of a problem's materials."""
    return [region.law for region in problem.regions]


def table_of(problem: Problem) -> FieldTable:
    """`field_table` of a problem. Local."""
    return field_table(problem.body, laws_of(problem))


def field_in_file(name: str) -> Field:
    """Row of a field that results hold; of one of the body no more is known than its name."""
    return FIELDS.get(name) or Field("scalar", "node", "", "field of the body")


def _of_body(name: str, given: MeshField) -> Field:
    return Field(
        _SHAPES[given.columns],
        "cell" if given.centre == "cell" else "node",
        "",
        "field of the body, in the unit in which it is given",
        values=lambda source: source.of_body(name),
        fixed=True,
        of_body=given,
    )


def _unfit(name: str, given: MeshField) -> str:
    """Why results cannot hold a field of a body; empty: they can."""
    if given.columns not in _SHAPES:
        return f"has {given.columns} components"
    plain = name.isprintable() and not {*name} & {*_NOT_IN_NAMES} and name.strip(". ")
    return "" if plain else "has a name that files of results cannot hold"


def check_field_names(
    names: Iterable[str], body: Body, laws: Iterable[Law] = ()
) -> tuple[str, ...]:
    """The names, each once, in their order. Local.

    Args:
        laws: Of the materials, for what they remember.

    Raises:
        InputError: Neither results nor the body have such a field, or results cannot hold it.
    """
    table, unique = field_table(body, laws), tuple(dict.fromkeys(names))
    for name in unique:
        if name not in table:
            if name in body.fields:
                raise InputError(
                    f"the field '{name}' of the body {_unfit(name, body.fields[name])}",
                    expected="1, 2, 3 or 9 components, and a name without any of "
                    + " ".join(_NOT_IN_NAMES),
                )
            raise InputError(f"there is no field '{name}'", expected=table.nearest(name))
    return unique
