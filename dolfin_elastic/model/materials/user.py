"""Materials whose energy the user writes: a formula in a case file, a function in Python."""

from __future__ import annotations

import inspect
import re
from abc import abstractmethod
from collections.abc import Callable, Collection, Mapping
from typing import Any, ClassVar, Self, TypeVar, cast

from pydantic import Field, PrivateAttr, field_serializer, field_validator, model_validator
from ufl import Coefficient, as_ufl, replace
from ufl.algorithms import extract_coefficients
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import FormulaError, InputError, keyed, nearest
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.formula_functions import CONSTANTS, FUNCTIONS
from dolfin_elastic.core.schema import quoted
from dolfin_elastic.core.units import SpatialValue, Stress, to_base
from dolfin_elastic.model.kinematics import gradient_symbol
from dolfin_elastic.model.materials import spatial
from dolfin_elastic.model.materials.isochoric import Volumetric
from dolfin_elastic.model.materials.memory import Memory
from dolfin_elastic.model.materials.spatial import Direction
from dolfin_elastic.model.materials.written import names as user_names
from dolfin_elastic.model.materials.written.history import (
    DT,
    Remembering,
    UserMemory,
    check_names,
    old,
    which,
)
from dolfin_elastic.model.materials.written.implicit import EvolutionMemory

T = TypeVar("T")

_SMALL = re.compile(rf"\b{user_names.SMALL}\b")
FOLLOWING = ("next", "rate", "residual")
"""Keys that say how a history follows; one of them is given."""


class UserEnergy(Remembering):
    """Base of energies that users write: parameters and fibres, which are constants of the forms.

    Attributes:
        parameters: Name to value [SI]; in a case file numbers or texts with any unit, and what
            varies in space as in `materials.spatial`.
        fibre: Direction a of fibres in the undeformed body; its length does not matter.
        fibre2: Direction b of a second family of fibres.
    """

    parameters: dict[str, Any] = Field(default={})
    fibre: Direction | None = None
    fibre2: Direction | None = None

    directions: ClassVar[tuple[str, ...]] = ("fibre", "fibre2")
    written: ClassVar[bool] = True
    limited: ClassVar[bool] = True  # as far as is known

    _checked: bool = PrivateAttr(default=False)
    _symmetric: bool = PrivateAttr(default=False)

    @field_validator("parameters", mode="before")
    @classmethod
    def _values_or_varying(cls, table: object) -> dict[str, float | SpatialValue]:
        if not isinstance(table, Mapping):
            raise InputError(f"{quoted(table)} is wrong", expected='expected {mu = "1 MPa", ...}')
        result = {}
        for name, value in table.items():
            with keyed(str(name)):
                read = spatial.constant(value, None)
                result[name] = (
                    read if isinstance(read, SpatialValue) else to_base(cast("float | str", read))
                )
        return result

    @model_validator(mode="after")
    def _one_before_two(self) -> Self:
        if self.fibre2 is not None and self.fibre is None:
            raise InputError("there is no first fibre", where="fibre2", expected="name it fibre")
        return self

    @field_serializer("parameters")
    def _as_written(self, table: Mapping[str, object]) -> dict[str, object]:
        return {name: getattr(value, "written", value) for name, value in table.items()}

    @property
    def checked(self) -> bool:
        """The energy has passed `model.point.checks.check_energy`."""
        return self._checked

    def mark_checked(self, *, symmetric: bool) -> None:
        """Records that the energy has passed the checks, which are made once.

        Args:
            symmetric: See `symmetric_steps`.
        """
        self._checked, self._symmetric = True, symmetric

    @property
    def own_memory(self) -> Memory | None:
        """See `Law`."""
        if not self.history:
            return None
        return EvolutionMemory(self) if self.evolves else UserMemory(self)

    @property
    def symmetric_steps(self) -> bool:
        """See `Law`: what is not known is not."""
        return self._symmetric or not self.evolves

    def constants(self) -> dict[str, float | list[float]]:
        """See `Law.constants`; parameters have a dot in their names."""
        result = super().constants()
        result |= {
            f"parameters.{name}": value
            for name, value in self.parameters.items()
            if not isinstance(value, SpatialValue)
        }
        return result

    def spatial_constants(self) -> dict[str, SpatialValue]:
        """See `Law.spatial_constants`; parameters have a dot in their names."""
        constants = super().spatial_constants()
        constants |= {
            f"parameters.{name}": value
            for name, value in self.parameters.items()
            if isinstance(value, SpatialValue)
        }
        return constants

    def with_values(self, values: Mapping[str, Any]) -> Self:
        """See `Law.with_values`."""
        inner = {n: values.get(f"parameters.{n}", value) for n, value in self.parameters.items()}
        plain = {name: value for name, value in values.items() if "." not in name}
        return super().with_values({**plain, "parameters": inner})

    @abstractmethod
    def written_energy(self, F: Expr) -> Expr:
        """The part of the energy that the user wrote [J/m^3]."""

    def energy(self, F: Expr) -> Expr:
        """See the class."""
        return self.written_energy(F)

    def _values(self, F: Expr, wanted: Collection[str]) -> dict[str, Expr]:
        named = set(wanted) - set(self.parameters)
        of_F = user_names.values(F, named, fibre=self.fibre, fibre2=self.fibre2)
        return of_F | self.past_values(named)


class UserVolumetric(Volumetric):
    """Adds K/2 g(J)^2 to the energy that a user writes, so that a pressure can be an unknown.

    Attributes:
        K: Bulk modulus [Pa].
    """

    K: Stress = Field(gt=0)

    @property
    def isochoric_shape(self) -> bool:
        """See `Law`: nobody knows what a user has written."""
        return False

    def shape_energy(self, F: Expr) -> Expr:
        """The energy that the user wrote, without volumetric part [J/m^3]."""
        return self.written_energy(F)  # type: ignore[attr-defined]

    def energy(self, F: Expr) -> Expr:
        """See the class."""
        return Volumetric.energy(self, F)

    def stress(self, F: Expr) -> Expr:
        """See the class."""
        return Volumetric.stress(self, F)


class FormulaEnergy(UserEnergy):
    """An energy that is written down as a formula.

        energy = "mu/2*(I1 - 3) - mu*ln(J) + lmbda/2*ln(J)^2"
        parameters = {mu = "0.4 MPa", lmbda = "2 MPa"}

    Attributes:
        formula: Energy per reference volume [J/m^3]; the key is `energy`.
        next: Name of history to a formula of its value at the end of a time step, of values at its
            start; the energy, too, has values at the start then.
        rate: Name of history to a formula of its derivative by time.
        residual: Name of history to a formula that is zero at the end of a time step; h is a value
            at its end, h_old at its start, as with `rate`.
    """

    formula: str = Field(validation_alias="energy", serialization_alias="energy")
    next: dict[str, str] = Field(default={})
    rate: dict[str, str] = Field(default={})
    residual: dict[str, str] = Field(default={})

    @property
    def _following(self) -> tuple[str, dict[str, str]] | None:
        """The key that says how the history follows, and its formulas."""
        tables = {"next": self.next, "rate": self.rate, "residual": self.residual}
        key = which(tables, history=bool(self.history))
        return None if key is None else (key, tables[key])

    @model_validator(mode="after")
    def _follows(self) -> Self:
        if self._following is not None:
            key, formulas = self._following
            check_names(self.history, formulas, key)
            for name in formulas:
                self._of_shape(key, name)
        return self

    def _of_shape(self, key: str, name: str) -> None:
        """Checks that a formula of the history has the shape of the variable."""
        tensor = self.history[name].shape != "scalar"
        if self._following_parsed[name].tensor != tensor:
            raise InputError(
                "a number" if tensor else "a tensor",
                where=f"{key}.{name}",
                expected=f"a {'tensor' if tensor else 'number'}, as {name} is in history",
            )

    @model_validator(mode="after")
    def _understood(self) -> Self:
        read = self.parsed
        if read.tensor:
            raise InputError("a tensor", where="energy", expected="a number, for example tr(C)")
        if self.evolves and not read.names & set(self.history):
            raise InputError(
                "the energy does not use the history",
                where="energy",
                expected=f"a term of {', '.join(self.history)}; or `next`, where it only counts",
            )
        names = read.names.union(*(one.names for one in self._following_parsed.values()))
        for name in self.parameters:
            if name not in names:
                raise InputError(
                    "the energy does not use this parameter",
                    where=f"parameters.{name}",
                    expected=f"it uses {', '.join(sorted(names)) or 'no name at all'}",
                )
        if not self._of_F:
            raise InputError(
                "the energy does not depend on the deformation",
                where="energy",
                expected=f"known: {self._known()}",
            )
        return self

    @property
    def rounds(self) -> bool:
        """See `Law.rounds`."""
        return any(not name.startswith("E") for name in self._of_F)

    @property
    def blind_to_inversion(self) -> bool:
        """See `Law.blind_to_inversion`."""
        if isinstance(self, UserVolumetric):  # a function of J
            return False
        return self._of_F <= user_names.OF_STRAIN

    @property
    def parsed(self) -> Formula:
        """The parsed formula.

        Raises:
            FormulaError: With the column, a caret under the fault, and what would be right.
        """
        return self._parsed(self.formula, "energy")

    @property
    def _following_parsed(self) -> dict[str, Formula]:
        """The parsed formulas of `next`, `rate` or `residual`, as `parsed` is."""
        if self._following is None:
            return {}
        key, formulas = self._following
        return {name: self._parsed(text, f"{key}.{name}") for name, text in formulas.items()}

    def _parsed(self, text: str, where: str) -> Formula:
        fibres = {"fibre": self.fibre is not None, "fibre2": self.fibre2 is not None}
        names = user_names.known(**fibres)
        _check_names(self.parameters, self.history, names)
        own = {name for name, v in self.history.items() if v.shape != "scalar"}
        tensors = self.of_history & {*own, *map(old, own)}
        tensors |= user_names.OF_TENSORS - set(self.parameters)
        allowed = names | set(self.parameters) | self.of_history
        try:
            return Formula.parse(text, allowed=allowed | tensors, tensors=tensors)
        except FormulaError as error:
            raise self._shorter_list(error).at(where) from None

    @property
    def _of_F(self) -> frozenset[str]:
        """Names of the energy that are functions of the deformation."""
        return self.parsed.names - set(self.parameters) - self.of_history

    def _known(self) -> str:
        fibres = {"fibre": self.fibre is not None, "fibre2": self.fibre2 is not None}
        own = sorted({*self.parameters, *self.of_history})
        return ", ".join([*own, user_names.summary(**fibres)])

    def _shorter_list(self, error: InputError) -> InputError:
        """The error with a short list of names in place of all forty."""
        first, *picture = error.expected.split("\n")
        if not first.startswith("known: J") and not first.startswith("known: C11"):
            return error
        text = "\n".join([f"known: {self._known()}", *picture])
        return type(error)(error.what, where=error.where, expected=text)

    def written_energy(self, F: Expr) -> Expr:
        """The formula with the expressions of `user_names` for its names."""
        read = self.parsed
        return read.ufl(**self._values(F, read.names), **self.parameters)

    @property
    def timed(self) -> bool:
        """See `Remembering`."""
        formulas = (self.parsed, *self._following_parsed.values())
        return bool(self.rate) or (
            bool(self.history) and any(DT in formula.names for formula in formulas)
        )

    @property
    def follows_by(self) -> str | None:
        """See `Remembering`."""
        return None if self._following is None else self._following[0]

    def following(self, F: Expr) -> dict[str, Expr]:
        """See `Remembering`."""
        return {
            name: as_ufl(read.ufl(**self._values(F, read.names), **self.parameters))
            for name, read in self._following_parsed.items()
        }


class SmallStrainEnergy(FormulaEnergy):
    """A formula of the infinitesimal strain eps, with a history, for small strains and rotations.

    For example energy = "K/2*tr(eps)^2 + mu*inner(dev(eps) - ep, dev(eps) - ep)", with
    history = {ep = "0"}.
    """

    linear: ClassVar[bool] = True
    frame_indifferent: ClassVar[bool] = False
    follows_large: ClassVar[str] = "formulas of C or E follow large ones"

    @model_validator(mode="after")
    def _remembers(self) -> Self:
        if not self.history:
            raise InputError(
                f"a formula of {user_names.SMALL} without a history",
                where="energy",
                expected="E, which is the same at small strains and right at large rotations; or "
                'law = "linear-elastic"',
            )
        return self


class SplitFormulaEnergy(UserVolumetric, FormulaEnergy):
    """A formula and a volumetric part."""

    @property
    def isochoric_shape(self) -> bool:
        """See `Law`."""
        return self._of_F <= user_names.ISOCHORIC


def _check_names(
    parameters: Collection[str], history: Collection[str], taken: frozenset[str]
) -> None:
    """Checks that parameters and history have names of their own."""
    before = set(map(old, history))
    for name in parameters:
        others = taken | {*history, *before, DT} if history else taken
        _check_name(name, others, f"parameters.{name}")
    for name in history:
        _check_name(name, taken | {*before, DT, user_names.SMALL}, f"history.{name}")


def _check_name(name: str, taken: frozenset[str], where: str) -> None:
    if not (name.isascii() and name.isidentifier()):
        raise InputError(
            f"{quoted(name)} cannot be a name", where=where, expected="letters, digits and _"
        )
    if name in taken or name in FUNCTIONS or name in user_names.TENSORS:
        raise InputError(f"the name '{name}' is in use", where=where, expected="choose another")
    if name in CONSTANTS and name == "pi":
        raise InputError("pi is a number already", where=where, expected="choose another name")


def read_energy(table: Mapping[str, object]) -> FormulaEnergy:
    """The law of a case-file table with the key `energy`."""
    if "law" in table:
        raise InputError(
            "law and energy given together",
            where="energy",
            expected="a material has one of them; leave the other out",
        )
    split = "volumetric" in table
    if "K" in table and not split:
        raise InputError(
            "a bulk modulus without a volumetric part",
            where="K",
            expected='add volumetric = "quadratic", "log" or "simo-taylor", or put K into '
            "parameters",
        )
    own = table.get("parameters")
    named = isinstance(own, Mapping) and user_names.SMALL in own
    if named or not _SMALL.search(str(table.get("energy"))):
        return (SplitFormulaEnergy if split else FormulaEnergy)(**table)
    if split:
        raise InputError(
            f"a volumetric part, which is of J, beside a formula of {user_names.SMALL}",
            where="volumetric",
            expected=f"leave it out, and add K/2*tr({user_names.SMALL})^2 to the energy",
        )
    return SmallStrainEnergy(**table)


# --- in Python ---


class Energy(UserEnergy):
    """An energy that is a Python function.

        Energy(lambda F, mu, k: mu/2*(ufl.tr(F.T*F) - 3) - mu*ufl.ln(ufl.det(F))
               + k/2*ufl.ln(ufl.det(F))**2, mu=1e6, k=1e7, density=1100)

    The names of the function's arguments say what it is given: F, C or E the tensors; J, I1, I2,
    I3, I1bar, I2bar, lambda1 to lambda3, with fibres I4, I5, I4bar, I6, I7, I6bar, I8, and the
    components F11 to E33 the scalars of case files; every other argument is a parameter and
    wants a value, a number or a text with a unit, or has a default.  A parameter may vary in space:
    a formula in x, y, z [m] and fields of the mesh, ``{"field": "mu", "unit": "MPa"}``, a scalar
    DOLFINx function on the mesh, or an array with a value for each cell of the rank.  Functions
    that the energy uses beside its arguments are treated alike.  All values are those where the
    problem is made.

    Attributes:
        function: Energy per reference volume [J/m^3] as a UFL expression.
        next: Of what is remembered, `history`, the values at the end of a time step by name.
        rate: Or their derivatives by time, see `FormulaEnergy`.
        residual: Or what is zero at the end of a time step.
    """

    function: Callable[..., Expr]
    next: Callable[..., Mapping[str, Expr]] | None = None
    rate: Callable[..., Mapping[str, Expr]] | None = None
    residual: Callable[..., Mapping[str, Expr]] | None = None

    _in_place: Mapping[Coefficient, Expr] = PrivateAttr(default={})

    own_keys: ClassVar[tuple[str, ...]] = (
        "density",
        "rho",
        "expansion",
        "allowable",
        "viscosity",
        "viscous",
        "viscous_on",
        "viscous_constants",
        "viscous_shift",
        "viscous_deviation",
        "prony",
        "fibre",
        "fibre2",
        "history",
        "rate_integration",
        *FOLLOWING,
    )

    def __init__(self, function: Callable[..., Expr], **given: Any) -> None:
        keys = {key: given.pop(key) for key in self.own_keys if key in given}
        written = {key: keys.get(key) for key in FOLLOWING}
        which(written, history=keys.get("history") is not None)
        super().__init__(
            function=function, parameters=_parameter_values(function, given, keys), **keys
        )

    def _used_beside(self) -> dict[str, Coefficient]:
        """Functions that the energy uses beside its arguments, by a name each."""
        if self._in_place:
            return {}
        numbers = dict.fromkeys(super().spatial_constants(), 1.0)
        law, F = UserEnergy.with_values(self, numbers), gradient_symbol()
        used = dict.fromkeys(extract_coefficients(law.energy(F)))
        for value in law.following(F).values():
            used |= dict.fromkeys(extract_coefficients(value))
        return {f"used.{i}": f for i, f in enumerate(used)}

    def spatial_constants(self) -> dict[str, SpatialValue]:
        """See `Law.spatial_constants`; functions that the energy uses have a dot in their names."""
        used = {name: spatial.constant(f, None) for name, f in self._used_beside().items()}
        return {**super().spatial_constants(), **used}  # type: ignore[dict-item]

    def with_values(self, values: Mapping[str, Any]) -> Self:
        """See `Law.with_values`."""
        used = {f: values[name] for name, f in self._used_beside().items() if name in values}
        law = super().with_values(values)
        law._in_place = used or self._in_place
        return law

    def written_energy(self, F: Expr) -> Expr:
        """The function's value [J/m^3], a UFL scalar."""
        result = self._called(self.function, F)
        if self._in_place and isinstance(result, Expr):
            result = replace(result, dict(self._in_place))
        if not isinstance(result, Expr) or result.ufl_shape:
            raise InputError(
                "the function of an energy returned no scalar expression",
                expected="expected a UFL expression, for example mu/2*(ufl.tr(F.T*F) - 3)",
            )
        return result

    def _called(self, function: Callable[..., T], F: Expr) -> T:
        """What a function of the user returns, with all that its arguments name."""
        wanted = inspect.signature(function).parameters
        values = {name: value for name, value in self.parameters.items() if name in wanted}
        return function(**self._values(F, wanted.keys() - values.keys()), **values)

    @property
    def timed(self) -> bool:
        """See `Remembering`."""
        functions = [self.function, *(f for _, f in self._following)]
        return self.by_rate or (
            bool(self.history) and any(DT in inspect.signature(one).parameters for one in functions)
        )

    @property
    def _following(self) -> list[tuple[str, Callable[..., Mapping[str, Expr]]]]:
        """The key that says how the history follows, with its function."""
        functions = ((key, getattr(self, key)) for key in FOLLOWING)
        return [(key, function) for key, function in functions if function is not None]

    @property
    def follows_by(self) -> str | None:
        """See `Remembering`."""
        return self._following[0][0] if self._following else None

    def following(self, F: Expr) -> dict[str, Expr]:
        """See `Remembering`.

        Raises:
            InputError: It returned no table of the names of history, or a value of another shape.
        """
        if not self._following:
            return {}
        ((key, function),) = self._following
        table = self._called(function, F)
        if not isinstance(table, Mapping):
            raise InputError(
                "the function returned no table of values",
                where=key,
                expected=f"{{'{next(iter(self.history))}': ..., ...}}",
            )
        check_names(self.history, table, key)
        values = {name: as_ufl(value) for name, value in table.items()}
        for name, value in values.items():
            wanted = () if self.history[name].shape == "scalar" else (3, 3)
            if value.ufl_shape != wanted:
                raise InputError(
                    f"a value of shape {value.ufl_shape}",
                    where=f"{key}.{name}",
                    expected=f"shape {wanted}, that of its start in history",
                )
        return {name: replace(value, dict(self._in_place)) for name, value in values.items()}


class SplitEnergy(UserVolumetric, Energy):
    """A Python function and a volumetric part: `Energy` with `volumetric` and `K`."""

    own_keys: ClassVar[tuple[str, ...]] = (*Energy.own_keys, "volumetric", "K")


def _parameter_values(
    function: Callable[..., Expr], given: dict[str, object], keys: Mapping[str, object]
) -> dict[str, object]:
    """A value for each parameter of the function, and of that of `next`."""
    fibres = {"fibre": "fibre" in keys, "fibre2": "fibre2" in keys}
    known = user_names.known(**fibres) | {*user_names.TENSORS}
    arguments = dict(inspect.signature(function).parameters)
    history = keys.get("history")
    following = next((keys[key] for key in FOLLOWING if keys.get(key) is not None), None)
    if callable(following) and isinstance(history, Mapping):
        arguments = {**inspect.signature(following).parameters, **arguments}
        _check_names((), history, known)
        known |= {*history, *map(old, history), DT}
    wanted = [name for name in arguments if name not in known]
    defaults = {
        name: arguments[name].default
        for name in wanted
        if arguments[name].default is not inspect.Parameter.empty
    }
    values = defaults | given
    for name in given:
        if name not in wanted:
            raise InputError(
                f"the energy has no parameter '{name}'", expected=nearest(name, wanted)
            )
    for name in wanted:
        if name not in values:
            raise InputError(
                f"'{name}' has no value", expected=f"give it, as in Energy(..., {name}=1e6)"
            )
    return values
