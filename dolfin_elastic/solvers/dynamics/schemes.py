"""`SCHEMES`: the time schemes by name.  A new scheme is one class and one row here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal

from dolfin_elastic.solvers.dynamics.explicit.scheme import (
    CentralDifferences,
    ExplicitScheme,
    SymplecticEuler,
)
from dolfin_elastic.solvers.dynamics.implicit.generalized_alpha import GeneralizedAlphaParameters
from dolfin_elastic.solvers.dynamics.implicit.petsc_alpha2 import PetscAlpha2
from dolfin_elastic.solvers.dynamics.implicit.scheme import ImplicitScheme
from dolfin_elastic.solvers.dynamics.implicit.ts_scheme import GeneralizedAlphaScheme


@dataclass(frozen=True)
class ImplicitRow:
    """An implicit scheme.

    Attributes:
        scheme: Its class.
        parameters: Its coefficients from the values of `keys`, given by keyword.
        keys: Fields of `DynamicsSettings` that this scheme has and others need not have.
        overshoots: The parameters are changed where stiff material damping would let the first
            steps overshoot, see `GeneralizedAlphaParameters.without_overshoot`.
        conserves: As the midpoint rule it takes the stress whose work is the change of the strain
            energy, see `discrete_gradient`: energy and momenta are conserved.
    """

    scheme: type[ImplicitScheme]
    parameters: Callable[..., GeneralizedAlphaParameters]
    keys: tuple[str, ...] = ()
    overshoots: bool = False
    conserves: bool = False
    implicit: ClassVar[Literal[True]] = True


@dataclass(frozen=True)
class ExplicitRow:
    """An explicit scheme, with lumped mass.

    Attributes:
        scheme: Its class.
        keys: Fields of `DynamicsSettings` that only some schemes have: none of them yet.
    """

    scheme: type[ExplicitScheme]
    keys: tuple[str, ...] = ()
    implicit: ClassVar[Literal[False]] = False


SCHEMES: dict[str, ImplicitRow | ExplicitRow] = {
    "generalized-alpha": ImplicitRow(
        GeneralizedAlphaScheme,
        GeneralizedAlphaParameters.generalized_alpha,
        keys=("spectral_radius",),
        overshoots=True,
        conserves=True,
    ),
    "energy-momentum": ImplicitRow(
        GeneralizedAlphaScheme, GeneralizedAlphaParameters.midpoint_rule, conserves=True
    ),
    "newmark": ImplicitRow(
        GeneralizedAlphaScheme, GeneralizedAlphaParameters.newmark, keys=("beta", "gamma")
    ),
    "implicit-euler": ImplicitRow(
        GeneralizedAlphaScheme, GeneralizedAlphaParameters.implicit_euler
    ),
    "alpha2": ImplicitRow(
        PetscAlpha2, GeneralizedAlphaParameters.generalized_alpha, keys=("spectral_radius",)
    ),
    "symplectic-euler": ExplicitRow(SymplecticEuler),
    "central-differences": ExplicitRow(CentralDifferences),
}
"""Name in case files to row.  The order is that of messages: the first row that has a key is the
scheme that is recommended to whoever gives the key."""
