"""Cavities of a body: enclosed volumes, whose pressure or volume is prescribed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import ufl

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.amplitude import CONSTANT, Amplitude
from dolfin_elastic.model.loads import Cavity, Load
from dolfin_elastic.problem.context import FormContext


@dataclass
class BodyCavity:
    """A cavity: its volume, and its pressure where that is an unknown.

    Attributes:
        label: What results call it.
        volume: Its present volume [m^3], a form without arguments; linear in u if all laws are.
        exact: Its present volume on the deformed surface, also of linear laws.
        push: Virtual work of a unit pressure on the deformed surface [m^3].
        cavity: What is prescribed.
        context: The body; it has the pressure where that is an unknown.
        where: Key of its surfaces in the case.
        t: Time [s], or load parameter.
        default: Amplitude of a cavity that names none.
    """

    label: str
    volume: ufl.Form
    exact: ufl.Form
    push: ufl.Form
    cavity: Cavity
    context: FormContext
    where: str = "load"
    t: float = 0.0
    default: Amplitude = CONSTANT

    def set_time(self, t: float, default: Amplitude) -> None:
        """Sets the time at which what is prescribed is evaluated. Not collective.

        Args:
            t: Time [s], or load parameter.
            default: Amplitude of a cavity that names none.
        """
        self.t, self.default = t, default

    @property
    def volume_controlled(self) -> bool:
        """The volume is prescribed, so the pressure is an unknown."""
        return self.cavity.volume_controlled

    def prescribed_volume(self, initial: float) -> float:
        """The prescribed volume [m^3], from that of the undeformed cavity [m^3]."""
        assert self.volume_controlled
        return self.cavity.prescribed_value(self.t, self.default, initial)

    @property
    def pressure(self) -> float:
        """The present pressure [Pa]."""
        if self.volume_controlled:
            return float(self.context.unknown(self.label).value)
        return self.cavity.prescribed_value(self.t, self.default, initial=0.0)

    def set_pressure(self, value: float) -> None:
        """Sets the pressure [Pa] where it is an unknown."""
        self.context.unknown(self.label).value = value


def make_cavities(loads: Sequence[Load], context: FormContext) -> Iterator[BodyCavity]:
    """The cavities among the loads.

    Args:
        loads: All loads of the body.

    Raises:
        InputError: Two have the same name, or the body has none in three dimensions.
    """
    labels: set[str] = set()
    for index, load in enumerate(loads):
        if not isinstance(load, Cavity):
            continue
        if load.label in labels:
            raise InputError(
                f"there is another cavity '{load.label}'",
                where=f"load[{index}].name",
                expected="a name of its own",
            )
        if context.geometry == "plane-stress":
            raise InputError(
                "in plane stress the thickness changes, and no cavity has a volume",
                where=f"load[{index}].kind",
                expected='"pressure"',
            )
        labels.add(load.label)
        try:
            volume, exact = (load.enclosed(context, linear) for linear in (context.linear, False))
        except InputError as error:
            raise error.at(f"load[{index}]" if error.where else f"load[{index}].on") from None
        push = load.work(context, context.constant(1.0), linear=False)
        yield BodyCavity(load.label, volume, exact, push, load, context, f"load[{index}].on")
