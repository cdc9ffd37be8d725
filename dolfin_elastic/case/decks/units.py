"""Consistent systems of units: decks have numbers alone."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from dolfin_elastic.case.decks.deck import Dimension, Quantity
from dolfin_elastic.core.errors import InputError, nearest


@dataclass(frozen=True)
class System:
    """A system of units in which no equation has factors.

    Attributes:
        units: Dimension to the unit as a case has it.
        second: Units of time in a second.
        pascal: Pascals of its unit of stress.
    """

    units: dict[Dimension, str]
    second: float
    pascal: float

    def text(self, number: Quantity) -> str | float:
        """A number as a case has it; 0 stays bare."""
        return f"{plain(number.value)} {self.units[number.dimension]}" if number.value else 0


def _system(
    length: str, force: str, mass: str, time: str, stress: str, *, second: float, pascal: float
) -> System:
    speed = f"{length}/{time}"
    return System(
        {
            "length": length,
            "force": force,
            "mass": mass,
            "time": time,
            "stress": stress,
            "moment": f"{force}*{length}",
            "density": f"{mass}/{length}^3",
            "acceleration": f"{speed}^2",
            "velocity": speed,
            "frequency": {1.0: "Hz", 1e3: "kHz"}[second],
            "rotation": f"rad/{time}",
            "temperature": "K",
            "expansion": "1/K",
            "body force": f"{force}/{length}^3",
            "stiffness": f"{force}/{length}",
            "viscosity": f"{force}*{time}/{length}",
        },
        second,
        pascal,
    )


SYSTEMS = {
    "mm-t-s": _system("mm", "N", "t", "s", "MPa", second=1.0, pascal=1e6),
    "m-kg-s": _system("m", "N", "kg", "s", "Pa", second=1.0, pascal=1.0),
    "mm-kg-ms": _system("mm", "kN", "kg", "ms", "GPa", second=1e3, pascal=1e9),
    "in-lbf-s": _system(
        "in", "lbf", "lbf*s^2/in", "s", "psi", second=1.0, pascal=6894.757293168361
    ),
}
"""Name to system, the usual one of metal parts first."""
# Of these, mass is a product: its density is no quotient of two names.
SYSTEMS["in-lbf-s"].units["density"] = "lbf*s^2/in^4"

_STIFF = (3e9, 1.5e12)
"""Young's moduli [Pa] of engineering plastics, metals and ceramics."""
_SOFT = (1e4, 3e9)
"""Those of gels, tissue and rubber."""


def system(name: str, stresses: Iterable[float]) -> System:
    """The system of a name.

    Args:
        stresses: Moduli of the deck, for what there is to say where the name is missing.

    Raises:
        InputError: It is missing or unknown; with what each would make of the moduli.
    """
    if name in SYSTEMS:
        return SYSTEMS[name]
    if name:
        raise InputError(
            f"the system of units '{name}' is unknown",
            where="--units",
            expected=nearest(name, SYSTEMS),
        )
    raise InputError(
        "the deck does not say what its units are",
        where="--units",
        expected=_advice(sorted({s for s in stresses if s > 0})),
    )


def _advice(moduli: list[float]) -> str:
    """What each system makes of the largest modulus, the likeliest first."""
    if not moduli:
        return f"one of {', '.join(SYSTEMS)}"
    largest = moduli[-1]

    def rank(name: str) -> int:
        pascal = largest * SYSTEMS[name].pascal
        return 0 if _STIFF[0] <= pascal <= _STIFF[1] else 1 if _SOFT[0] <= pascal < _SOFT[1] else 2

    names = sorted(SYSTEMS, key=rank)
    rows = [f"{name} ({_shown(largest * SYSTEMS[name].pascal)})" for name in names]
    likely = f"its largest modulus is {largest:g}: --units {rows[0]} is the most plausible one"
    return f"{likely}; or {', '.join(rows[1:])}"


def _shown(pascal: float) -> str:
    factor, unit = next(
        ((f, u) for f, u in ((1e9, "GPa"), (1e6, "MPa"), (1e3, "kPa")) if pascal >= f), (1, "Pa")
    )
    return f"{pascal / factor:.4g} {unit}"


def plain(value: float) -> str:
    """A number with all its digits, and no decimals where it is whole."""
    return repr(float(value)).removesuffix(".0")
