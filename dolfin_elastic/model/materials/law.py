"""Base of all material laws: a frozen record with `energy(F)` or `stress(F)`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import wraps
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, TypeVar

import numpy as np
import ufl
from pydantic import AliasChoices, Field, field_validator, model_validator
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.schema import WhenGiven
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import (
    Density,
    Expansion,
    SpatialValue,
    Viscosity,
)
from dolfin_elastic.model.kinematics import (
    cofactor,
    green_strain,
    infinitesimal_strain,
    variables,
    volume_change,
)
from dolfin_elastic.model.materials import spatial
from dolfin_elastic.model.relaxation import SUM_BELOW_ONE, InFile, Shift, ViscousTerm
from dolfin_elastic.model.strength import Allowable, Strength

if TYPE_CHECKING:
    from dolfin_elastic.model.materials.memory import Memory

S = TypeVar("S")
T = TypeVar("T")


def as_floats(value: object) -> float | list[float] | None:
    """A number, or a list of numbers, as floats; None for anything else."""
    if isinstance(value, list | tuple):
        result = [x for item in value if isinstance(x := as_floats(item), float)]
        return result if result and len(result) == len(value) else None
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if is_number else None  # type: ignore[arg-type]


def negative(**values: object) -> tuple[str, ...]:
    """The numbers below 0 among constants [Pa], as `Law.destabilising` names them."""
    return tuple(
        f"{name} = {value:.4g} Pa"
        for name, value in values.items()
        if isinstance(value, int | float) and value < 0
    )


@dataclass(frozen=True)
class Moduli:
    """All five constants: Young's E, Poisson's nu, bulk K, Lame's lmbda, shear mu [Pa, 1]."""

    E: float
    nu: float
    K: float
    lmbda: float
    mu: float


@dataclass(frozen=True)
class BoundLaw:
    """A law whose numbers have become UFL constants.

    Attributes:
        given: The law as it was written.
        constants: By name; a new `value` of one needs no new compilation.
        law: The law with these, and with functions of what varies in space, in their places.
        means: Numbers that stand for what varies in space.
        largest_nu: Of a Poisson's ratio that varies; else None.
    """

    given: Law
    constants: Mapping[str, Any]
    law: Law
    means: Mapping[str, Any]
    largest_nu: float | None

    @property
    def typical(self) -> Law:
        """The law with its present numbers, the means of what varies, but the largest nu."""
        numbers = {name: constant.value.tolist() for name, constant in self.constants.items()}
        law = self.given.with_values({**numbers, **self.means})
        return law if self.largest_nu is None else law.model_copy(update={"nu": self.largest_nu})

    @property
    def moduli(self) -> Moduli | None:
        """UFL expressions of `Law.small_strain`, with means of what varies."""
        return self.given.with_values({**self.constants, **self.means}).small_strain()


class Branched(spatial.SpatialRecord):
    """Keys of the stress that relaxes.

    Attributes:
        viscous: Branches of stress that relaxes, each with a ratio and a time: it fades as
            exp(-t/time) after a sudden strain. In statics the load factor is the time in seconds.
            Or the name of a CSV file with these columns. `prony`, a list of g and tau, is the same
            with instantaneous constants.
        viscous_on: What relaxes: "isochoric", the stress of a change of shape, the default of laws
            with a volumetric part of their own; or "whole", the default of all others.
        viscous_constants: What the law's other constants are: "long-term", the stress after a
            sudden strain is 1 + sum of the ratios times theirs; or "instantaneous", after a long
            time 1 - sum of the ratios is left.
        viscous_shift: Temperature of the material, and how its relaxation times depend on it, by
            the law "wlf" or "arrhenius".
        viscous_deviation: How far the isochoric stress of a branch may be from that after a long
            time. "small": the branches are linear in the history of the stress (Simo); "large": one
            branch, an elastic and a viscous deformation in series (Reese and Govindjee).
    """

    viscous: Annotated[tuple[WhenGiven[ViscousTerm], ...], InFile()] = Field(
        default=(), validation_alias=AliasChoices("viscous", "prony")
    )
    viscous_on: Literal["isochoric", "whole"] | None = None
    viscous_constants: Literal["long-term", "instantaneous"] = "long-term"
    viscous_shift: WhenGiven[Shift] | None = None
    viscous_deviation: Literal["small", "large"] = "small"

    @model_validator(mode="before")
    @classmethod
    def _other_name(cls, table: object) -> object:
        if not isinstance(table, Mapping):
            return table
        if "prony" not in table:
            rows = table.get("viscous")
            rows = rows if isinstance(rows, list | tuple) else ()
            named = any(isinstance(row, Mapping) and "g" in row for row in rows)
            if named and "viscous_constants" not in table:
                raise InputError(
                    "`g` is a ratio to the stress of a sudden strain",
                    where="viscous",
                    expected='prony = [{g = 0.3, tau = "1 s"}]; or viscous_constants, which says '
                    "what the law's other constants are",
                )
            return table
        if "viscous" in table:
            raise InputError(
                "`viscous` and `prony` are two names of one key",
                where="prony",
                expected="leave one of them out",
            )
        return {"viscous_constants": "instantaneous", **table}

    @field_validator("viscous", mode="before")
    @classmethod
    def _is_a_list(cls, terms: object) -> object:
        if isinstance(terms, str | Mapping):
            raise InputError(
                "no branches: the file has not been read",
                expected='a list [{ratio = 0.3, time = "1 s"}, ...]; only a case file may name a '
                "file of branches",
            )
        return terms

    @field_validator("viscous")
    @classmethod
    def _has_terms(cls, terms: tuple[ViscousTerm, ...]) -> tuple[ViscousTerm, ...]:
        if not terms:
            raise InputError(
                "a series without terms: nothing would relax",
                expected='expected for example [{ratio = 0.3, time = "1 s"}], or no such key',
            )
        return terms

    @model_validator(mode="after")
    def _relaxes(self) -> Self:
        for key in ("viscous_on", "viscous_constants", "viscous_shift", "viscous_deviation"):
            if key in self.model_fields_set and not self.viscous:
                raise InputError(
                    "nothing relaxes without `viscous`", where=key, expected="leave it out"
                )
        if self.viscous and self.lasting <= 0:
            ratios = sum(term.ratio for term in self.viscous)
            raise InputError(
                f"the ratios sum up to {ratios:.6g}: nothing would hold the shape for long",
                where="viscous",
                expected=SUM_BELOW_ONE,
            )
        return self

    @property
    def series(self) -> tuple[FloatArray, FloatArray]:
        """Ratios, and times at the temperature of the material [s], of the branches."""
        factor = 1.0 if self.viscous_shift is None else self.viscous_shift.factor
        terms = self.viscous
        return np.array([t.ratio for t in terms]), factor * np.array([t.time for t in terms])

    @property
    def lasting(self) -> float:
        """Stress after a long time over that of the constants."""
        ratios = sum(term.ratio for term in self.viscous)
        return 1.0 - ratios if self.viscous_constants == "instantaneous" else 1.0

    @property
    def sudden(self) -> float:
        """Stress after a sudden strain over that of the constants."""
        return self.lasting + sum(term.ratio for term in self.viscous)

    @property
    def relaxes_whole(self) -> bool:
        """The whole stress relaxes, not only that of a change of shape."""
        usual = "isochoric" if self.viscous_deviation == "large" else self._usually_relaxes
        return bool(self.viscous) and (self.viscous_on or usual) == "whole"

    @property
    def _usually_relaxes(self) -> Literal["isochoric", "whole"]:
        return "whole"

    @property
    def symmetric_steps(self) -> bool:
        """The tangent is symmetric over a time step, too, where there is an energy."""
        return True

    @property
    def isochoric_shape(self) -> bool:
        """The energy without volumetric part depends on J^-1/3 F alone."""
        return False


class Law(Branched):
    """A material: its fields are its constants and the keys of its case-file table.

    A subclass gives `energy(F)`, or `stress(F)` when it has no energy.  In both, F is the
    deformation gradient, a UFL tensor of shape (3, 3), also in plane strain, and the fields stand
    for numbers or UFL expressions alike: `self.mu` may be either.  Where a constant varies in space
    (see `materials.spatial`) the law is only used after it has been bound to a body.

    Attributes:
        law: The law's name in a case file.
        density: Mass per reference volume [kg/m^3]; required for gravity, dynamics and modes.
        expansion: Coefficient of thermal expansion, strain per change of temperature [1/K].
        allowable: Allowable von Mises stress [Pa], or a table of strengths in tension, compression
            and shear, see `Strength`; required for safety factors.
        viscosity: eta of the viscous stress S = 2 eta dE/dt [Pa s], in implicit dynamics.
    """

    law: str = ""
    density: Density | None = Field(
        default=None, gt=0, validation_alias=AliasChoices("density", "rho")
    )
    expansion: Expansion | None = None
    allowable: Allowable | None = Field(default=None, gt=0)
    viscosity: Viscosity | None = Field(default=None, gt=0)

    keys_beside: ClassVar[tuple[str, ...]] = ("on", "source", "material")
    linear: ClassVar[bool] = False
    """It is for small strains: geometry counts as unchanged, and elastic stress is linear in it."""
    follows_large: ClassVar[str] = "st-venant-kirchhoff or neo-hookean follow large ones"
    """What to take in place of a law for small strains."""
    barrier: ClassVar[bool] = False
    """The energy grows without bound as J falls to 0, so an inverted state is never finite."""
    survives_inversion: ClassVar[bool] = False
    """An inverted cell is told from its mirror image, has a finite stress and is turned back."""
    of_strain_alone: ClassVar[bool] = False
    """A function of C alone that is finite wherever F is: an inverted cell has the stress of its
    mirror image, the mirrored body that of one at rest, so that nothing turns it back."""
    frame_indifferent: ClassVar[bool] = True
    """Rotating the body rotates its stress and leaves its energy."""
    limited: ClassVar[bool] = False
    """With any constants the law loses its stability at some stretch between 1/2 and 2."""
    warning: ClassVar[str] = ""
    """Logged once in every run that uses the law."""
    directions: ClassVar[tuple[str, ...]] = ()
    """Fields that are vectors in the reference configuration; read them by `spatial.direction`."""
    written: ClassVar[bool] = False
    """A user has written it, so that it is checked before a run, see `model.point.checks`."""
    example: ClassVar[Mapping[str, object]] = {}
    """Constants as a case file gives them, for the law's page and for tests."""

    @model_validator(mode="after")
    def _strength_has_axis(self) -> Self:
        strength, own = self.allowable, [getattr(self, name) for name in self.directions[:1]]
        if not isinstance(strength, Strength) or not strength.directed:
            return self
        if strength.axis is None and own in ([], [None]):
            raise InputError(
                "strengths along and across a direction, but the law has none",
                where="allowable.axis",
                expected='the direction, for example axis = "z"',
            )
        return self

    @model_validator(mode="after")
    def _can_relax(self) -> Self:
        if self.viscous and not self.may_relax:
            raise InputError(
                f"the law '{self.name()}' cannot relax",
                where="viscous",
                expected="a law with an energy that remembers nothing else",
            )
        if self.viscous_deviation == "large":
            _check_deviation(self)
        return self

    @classmethod
    def name(cls) -> str:
        """The law's name in case files."""
        return str(cls.model_fields["law"].default)

    @property
    def rounds(self) -> bool:
        """Whether it is written in F, C, J or invariants, in which small strains are rounded."""
        return False

    @property
    def blind_to_inversion(self) -> bool:
        """Whether it cannot tell an inverted cell from its mirror image, see `of_strain_alone`."""
        return self.of_strain_alone

    @property
    def has_energy(self) -> bool:
        """True when the law derives from a strain energy, so its tangent is symmetric."""
        return type(self).energy is not Law.energy

    def energy(self, F: Expr) -> Expr:
        """Strain energy per reference volume, psi(F) [J/m^3]."""
        raise TypeError(f"{type(self).__name__} has no strain energy")

    def stress(self, F: Expr) -> Expr:
        """First Piola-Kirchhoff stress P = dpsi/dF [Pa], shape of F."""
        H, F = variables(F)
        return ufl.diff(self.energy(F), H)

    def strain(self, F: Expr) -> Expr:
        """The strain from which the stress is computed, shape of F: by default Green's."""
        return infinitesimal_strain(F) if self.linear else green_strain(F)

    def small_strain(self) -> Moduli | None:
        """Constants of the isotropic solid to which the law reduces at small strains; else None."""
        return None

    def destabilising(self) -> tuple[str, ...]:
        """Constants whose sign takes the law's stability at some stretch, "c10 = -2e+05 Pa"."""
        return ()

    @property
    def derived(self) -> list[str]:
        """Names of the constants that follow from those that were given."""
        fields = type(self).model_fields.items()
        given = self.model_fields_set
        return [n for n, field in fields if field.default_factory is placeholder and n not in given]

    def constants(self) -> dict[str, float | list[float]]:
        """Name and value of every number in the law, without those that follow from others.

        Lists are constants of several values: how many is the form's, what they are is not.
        """
        result = {name: as_floats(value) for name, value in self.__dict__.items()}
        derived = self.derived
        return {n: value for n, value in result.items() if value is not None and n not in derived}

    @property
    def memory(self) -> Memory | None:
        """What it remembers, where its stress depends on what has been before; else None."""
        return self.branches() if self.viscous else self.own_memory

    @property
    def may_relax(self) -> bool:
        """It takes `viscous`: it has an energy, and remembers nothing else."""
        kind = type(self)
        return kind.memory is Law.memory and kind.branches is not Law.branches and self.has_energy

    @property
    def own_memory(self) -> Memory | None:
        """What it remembers beside `viscous`; None: nothing."""
        return None

    def branches(self) -> Memory:
        """What `viscous` remembers."""
        raise TypeError(f"{type(self).__name__} cannot relax")

    @property
    def surely_stiff(self) -> bool:
        """The checks of its constants leave no negative stiffness in the undeformed body."""
        return False

    def spatial_constants(self) -> dict[str, SpatialValue]:
        """Name and value of everything in the law that varies in space, density included."""
        return {n: value for n, value in self.__dict__.items() if isinstance(value, SpatialValue)}

    @classmethod
    def ranges(cls) -> dict[str, spatial.Range]:
        """Admissible values of constants, for those that vary in space."""
        return {n: spatial.Range.of(info.metadata) for n, info in cls.model_fields.items()}

    def with_values(self, values: Mapping[str, Any]) -> Self:
        """A copy with other values of given constants, and of those that follow from them.

        Nothing is checked.

        Args:
            values: Numbers, arrays or UFL expressions, by the names of `constants` and
                `spatial_constants`.
        """
        result = self.model_copy()
        result.__dict__.update(values)  # `update=` would count what follows from them as given
        result.complete()
        return result

    def complete(self) -> None:
        """Computes the `derived` constants from those given: numbers, arrays or UFL expressions."""

    def bind(
        self,
        constant: Callable[[float | list[float]], Expr],
        functions: Mapping[str, Expr],
        means: Mapping[str, Any],
        largest_nu: float | None,
    ) -> BoundLaw:
        """The law for forms that do not depend on its numbers.

        Args:
            constant: Makes a UFL constant of a number, or of a list.
            functions: In place of `spatial_constants`; `means` stand for the same.
        """
        # Where nu is 0.5 there are other unknowns: it is no number that may change.
        given = {n: x for n, x in self.constants().items() if (n, x) != ("nu", 0.5)}
        constants = {name: constant(number) for name, number in given.items()}
        law = self.with_values({**constants, **functions})
        return BoundLaw(self, constants, law, means, largest_nu)

    def quadrature_degree(self, degree: int) -> int:
        """Degree of exactness that integrates the law on elements of `degree`.

        F is constant on a linear element: one point is exact.  On quadratic ones F is linear and
        degree 2 (four points on a tetrahedron) keeps the optimal convergence rates.
        """
        return 0 if degree == 1 else 2 * (degree - 1)


def _check_deviation(law: Law) -> None:
    """Checks that a branch of a law may be far from equilibrium, see `viscous`."""
    if len(law.viscous) > 1:
        raise InputError(
            f"{len(law.viscous)} branches",
            where="viscous",
            expected='one; several have viscous_deviation = "small"',
        )
    if law.relaxes_whole:
        raise InputError(
            'the whole stress beside viscous_deviation = "large"',
            where="viscous_on",
            expected='"isochoric"',
        )
    if law.linear or law.written or law.directions:
        raise InputError(
            f"the law '{law.name() or 'energy'}' has no branch far from equilibrium",
            where="viscous_deviation",
            expected="an isotropic law of large strains by name; a formula has `rate`",
        )


class SplitLaw(Law):
    """A law with a volumetric part: psi = shape_energy(F) + k/2 volume_strain(F)^2.

    The modulus k is the field that `volume_modulus` names.  Where k is very large or infinite, a
    pressure p = k volume_strain(F) becomes an unknown of its own: psi is then
    shape_energy(F) + p volume_strain(F) - p^2/(2k), the perturbed Lagrangian.

    Source: Bonet & Wood (2008), sections 8.6.2 to 8.6.5.
    """

    volume_modulus: ClassVar[str] = "K"
    """Name of the field that multiplies the square of the volume strain [Pa]."""
    strain_of_volume: ClassVar[bool] = False
    """The volume strain depends on F through J = det F alone."""

    @abstractmethod
    def shape_energy(self, F: Expr) -> Expr:
        """Strain energy per reference volume without the volumetric part [J/m^3]."""

    def volume_strain(self, F: Expr) -> Expr:
        """Measure of the change of volume: 0 at F = I, with derivative I there."""
        return volume_change(F)

    def shape_stress(self, F: Expr) -> Expr:
        """Derivative of the shape energy with respect to F [Pa]."""
        H, F = variables(F)
        return ufl.diff(self.shape_energy(F), H)

    def volume_gradient(self, F: Expr) -> Expr:
        """Derivative of the volume strain with respect to F."""
        H, F = variables(F)
        return ufl.diff(self.volume_strain(F), H)

    def volume_stress(self, F: Expr) -> Expr:
        """Derivative of half the squared volume strain with respect to F."""
        return self.volume_strain(F) * self.volume_gradient(F)

    @property
    def curved_strain(self) -> bool:
        """The volume strain is a function g(J) that is not affine."""
        return self.strain_of_volume

    @property
    def _usually_relaxes(self) -> Literal["isochoric", "whole"]:
        # Where J < 0, which is finite in some laws, there is no J^-1/3 F.
        split = self.linear or (self.strain_of_volume and not self.survives_inversion)
        return "isochoric" if split else "whole"

    def incompressibility(self, F: Expr) -> Expr:
        """The constraint of a modulus k that is infinite: J - 1, or the volume strain.

        Where the volume strain is a function g(J), g = 0 and J = 1 are the same material, but not
        the same approximation.  A pressure whose level is free asks for the integral of g, and
        with the integral of J given by the supports only J - 1 leaves room for a J that is not 1
        at each point: a curved g makes the elements lock.
        """
        return volume_change(F) if self.strain_of_volume else self.volume_strain(F)

    def incompressibility_gradient(self, F: Expr) -> Expr:
        """Derivative of `incompressibility` with respect to F."""
        return cofactor(F) if self.strain_of_volume else self.volume_gradient(F)

    def energy(self, F: Expr) -> Expr:
        """See the class."""
        k = getattr(self, self.volume_modulus)
        return self.shape_energy(F) + k / 2 * self.volume_strain(F) ** 2

    def stress(self, F: Expr) -> Expr:
        """First Piola-Kirchhoff stress [Pa], part by part."""
        k = getattr(self, self.volume_modulus)
        return self.shape_stress(F) + k * self.volume_stress(F)


def once(method: Callable[[S, Expr], T]) -> Callable[[S, Expr], T]:
    """A method whose result for the last deformation gradient is kept as one expression.

    Of three equal expressions that are not one object, FFCx may compare every path through each
    with every path through the others: minutes, where one object takes a second.

    Args:
        method: Function of a deformation gradient and of nothing that may change.
    """
    name = f"_{method.__name__}_once"

    @wraps(method)
    def kept(self: S, F: Expr) -> T:
        last: tuple[Expr, T] | None = vars(self).get(name)
        if last is None or last[0] is not F:
            last = vars(self)[name] = (F, method(self, F))
        return last[1]

    return kept


class ModifiedLaw(ABC):
    """A law seen through something that changes its response: a pressure field, or growth.

    It gives what forms and fields of results ask of a law, and nothing else of it.
    """

    law: Law | ModifiedLaw
    """The law behind, possibly a modified one too."""

    @property
    def linear(self) -> bool:
        """Stress is linear in the displacement gradient."""
        return self.law.linear

    @property
    def has_energy(self) -> bool:
        """The law derives from a strain energy."""
        return self.law.has_energy

    @property
    def surely_stiff(self) -> bool:
        """The law behind is."""
        return self.law.surely_stiff

    @property
    def density(self) -> float | None:
        """Mass per reference volume [kg/m^3], or None."""
        return self.law.density

    @property
    def allowable(self) -> float | Strength | None:
        """Von Mises stress that the material may bear [Pa], its strengths, or None."""
        return self.law.allowable

    @property
    def E(self) -> float | None:
        """Young's modulus [Pa]; None where the law has no such constant."""
        return getattr(self.law, "E", None)

    @abstractmethod
    def energy(self, F: Expr) -> Expr:
        """Energy per reference volume [J/m^3] at a deformation gradient, shape (3, 3)."""

    @abstractmethod
    def stress(self, F: Expr) -> Expr:
        """First Piola-Kirchhoff stress [Pa] at a deformation gradient, shape (3, 3)."""

    def strain(self, F: Expr) -> Expr:
        """The strain from which the stress is computed, see `Law.strain`."""
        return self.law.strain(F)


def placeholder() -> float:
    """Placeholder of a constant that is computed from the given ones."""
    return float("nan")
