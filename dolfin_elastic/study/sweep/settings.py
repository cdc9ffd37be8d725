"""What a sweep varies: values that are listed, and values that scatter around a mean.

materials.rubber.E="1 MPa,2 MPa"            these two
materials.steel.E="normal(210 GPa, 3 %)"    mean and standard deviation
materials.steel.E="normal(3 %)"             around the value of the case
load[0].value[2]="uniform(-2 kN, -1 kN)"    anything from ... to ...
mesh.size="lognormal(2 mm, 10 %)"           never negative
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from statistics import NormalDist
from typing import TYPE_CHECKING, Literal, cast

import numpy as np

from dolfin_elastic.case.toml import key_parts
from dolfin_elastic.core.errors import InputError, nearest
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import number_and_unit

if TYPE_CHECKING:
    from dolfin_elastic.case.case import Case

Kind = Literal["normal", "lognormal", "uniform"]
KINDS = ("normal", "lognormal", "uniform")
_SPREAD = re.compile(r"\s*([a-z]+)\s*\((.*)\)\s*")
_EXAMPLE = 'for example "normal(210 GPa, 3 %)" or "uniform(1 MPa, 2 MPa)"'
SAMPLES = 20
"""Samples unless their number is given."""
DRAWN = 4
"""Digits that are shown of values that are drawn."""
_FEW = 500
"""Samples of which columns are permuted until they are hardly correlated: beyond, chance suffices,
and that takes seconds."""
MOST = 100_000
"""Runs of a sweep."""

Values = Mapping[str, object]
"""Dotted keys of a case to their values in one run."""


@dataclass(frozen=True)
class Spread:
    """A distribution of a number with a unit.

    Attributes:
        kind: Of the distribution.
        first: Mean, of "uniform" the lower end; nan: the value of the case.
        second: Standard deviation, of "uniform" the upper end, in `unit`, or relative.
        relative: `second` is a fraction of the mean, of "uniform" on both sides of it.
        unit: Of both; empty of pure numbers, and where the case gives it.
    """

    kind: Kind
    first: float
    second: float
    relative: bool
    unit: str

    def around(self, given: object, key: str) -> Spread:
        """The distribution around the value of a case, where it has no mean of its own.

        Raises:
            InputError: The case has no number there.
        """
        if not math.isnan(self.first):
            return self
        read = number_and_unit(given)
        if read is None:
            raise InputError(
                f"the case has {given!r} there, which is no number to vary around",
                where=key,
                expected=_EXAMPLE,
            )
        spread = Spread(self.kind, read[0], self.second, self.relative, read[1])
        if self.kind == "uniform":
            half = abs(self.second * read[0])
            if half:
                spread = Spread(self.kind, read[0] - half, read[0] + half, False, read[1])
        return spread._checked(key)

    def _checked(self, key: str) -> Spread:
        wrong = ""
        if self.relative and self.first == 0.0:
            wrong = "a percentage of 0 is no deviation"
        elif self.kind == "uniform" and not self.relative and not self.first < self.second:
            wrong = f"the range from {self.first:g} to {self.second:g} is empty"
        elif self.second <= 0.0 and (self.kind != "uniform" or self.relative):
            wrong = "the standard deviation is not positive"
        elif self.kind == "lognormal" and self.first <= 0.0:
            wrong = "a lognormal distribution has a positive mean"
        if wrong:
            raise InputError(wrong, where=key, expected=_EXAMPLE)
        return self

    def at(self, q: FloatArray) -> list[object]:
        """Values below which fractions q of all lie, as a case takes them.

        Source: the lognormal's parameters by its mean and deviation, N. L. Johnson, S. Kotz &
        N. Balakrishnan, Continuous Univariate Distributions 1 (1994), (14.8).
        """
        if self.kind == "uniform":
            x = self.first + (self.second - self.first) * q
        else:
            deviation = abs(self.first) * self.second if self.relative else self.second
            if self.kind == "normal":
                x = self.first + deviation * _normal(q)
            else:
                s2 = math.log1p((deviation / self.first) ** 2)
                x = np.exp(math.log(self.first) - s2 / 2 + math.sqrt(s2) * _normal(q))
        return [float(f"{v:.7g}") if not self.unit else f"{v:.7g} {self.unit}" for v in x]


def _normal(q: FloatArray) -> FloatArray:
    """Values below which fractions q of a standard normal distribution lie.

    A fraction of 0 or 1, which Sobol's points may have, lies eight deviations away.
    """
    inverse = NormalDist().inv_cdf
    return np.array([inverse(x) for x in np.clip(q, 1e-16, 1 - 1e-16)])


@dataclass(frozen=True)
class Setting:
    """A key of the case, and what it takes in the runs.

    Attributes:
        key: Dotted, as it was written.
        values: One after the other; none where it scatters.
        spread: How it scatters; None of listed values.
    """

    key: str
    values: tuple[object, ...] = ()
    spread: Spread | None = None


def read_setting(key: str, value: object) -> Setting:
    """A setting from a text of the command line, or from a list or a text in Python.

    Raises:
        InputError: It is no value, or no distribution.
    """
    if not key_parts(key):
        raise InputError(f"'{key}' is no key", expected='for example "materials.steel.E"')
    if isinstance(value, str):
        match = _SPREAD.fullmatch(value)
        if match is not None and match[1] in KINDS:
            return Setting(key, spread=_spread(key, match[1], match[2]))
        known = "" if match is None else nearest(match[1], KINDS)
        if match is not None and ("%" in match[2] or known.startswith("did you")):
            raise InputError(f"there is no distribution '{match[1]}'", where=key, expected=known)
        if value.count("(") != value.count(")") or value.count("[") != value.count("]"):
            what = f"a bracket is not closed in '{value}'"
            raise InputError(what, where=key, expected=_EXAMPLE)
        values = tuple(map(_value, _pieces(value)))
    elif isinstance(value, Sequence | np.ndarray):
        values = tuple(v.item() if isinstance(v, np.generic) else v for v in value)
    else:
        values = (value.item() if isinstance(value, np.generic) else value,)
    if not values or "" in values:
        raise InputError("a value is missing", where=key, expected='for example "1 MPa,2 MPa"')
    return Setting(key, values)


def _pieces(text: str) -> list[str]:
    """A list in one line, split at the commas outside brackets and quotes."""
    pieces, depth, quote = [""], 0, ""
    for letter in text:
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        elif letter in "([{":
            depth += 1
        elif letter in ")]}":
            depth -= 1
        elif letter == "," and depth == 0:
            pieces.append("")
            continue
        pieces[-1] += letter
    return [piece.strip() for piece in pieces]


def _value(text: str) -> object:
    """A value as TOML has it; anything else is a text, which needs no quotes here."""
    try:
        value = tomllib.loads(f"x = {text}")["x"] if "\n" not in text else text
    except tomllib.TOMLDecodeError:
        return text
    return value if isinstance(value, bool | int | float | str | list | dict) else text


def _spread(key: str, kind: str, inner: str) -> Spread:
    """A distribution by what stands in its brackets."""
    words = [word.strip() for word in inner.split(",")]
    read = [number_and_unit(word) for word in words]
    if len(read) not in (1, 2) or None in read:
        raise InputError(f"'{kind}({inner})' is no distribution", where=key, expected=_EXAMPLE)
    numbers, of = [one for one in read if one is not None], cast(Kind, kind)
    last, unit = numbers[-1]
    relative = unit == "%"
    scale = 0.01 if relative else 1.0
    if len(numbers) == 1:
        if not relative:
            what = f"'{inner.strip()}' is no percentage of the value that the case has"
            raise InputError(what, where=key, expected=_EXAMPLE)
        return Spread(of, math.nan, scale * last, True, "")._checked(key)
    first, own = numbers[0]
    if kind == "uniform" or not relative:
        if own != unit:
            what = f"'{words[0]}' and '{words[1]}' have different units"
            raise InputError(what, where=key, expected=_EXAMPLE)
        return Spread(of, first, last, False, own)._checked(key)
    return Spread(of, first, scale * last, True, own)._checked(key)


def with_means(case: Case, settings: Sequence[Setting]) -> list[Setting]:
    """Settings of which those that scatter do so around the case's own value, if they say no other.

    Raises:
        InputError: The case has no number there.
    """
    return [
        one
        if one.spread is None
        else replace(one, spread=one.spread.around(case.value_at(one.key), one.key))
        for one in settings
    ]


# --- all together ---


@dataclass(frozen=True)
class Design:
    """The runs of a sweep, before one is computed.

    Attributes:
        settings: What varies.
        rows: Of each run its values.
        base: Of Sobol's indices N, whose runs stand in the order A, B, A with column i of B for
            each i; 0 of other sweeps.
        together: First values stand with first ones, so one setting tells the others.
    """

    settings: tuple[Setting, ...]
    rows: tuple[Values, ...]
    base: int = 0
    together: bool = False

    @property
    def scatter(self) -> tuple[Setting, ...]:
        """What scatters."""
        return tuple(one for one in self.settings if one.spread is not None)


def design(
    settings: Sequence[Setting],
    *,
    together: bool = False,
    samples: int | None = None,
    sobol: int | None = None,
    seed: int = 0,
) -> Design:
    """All runs: every value with every other, and samples of what scatters.

    Samples are a Latin hypercube (M. D. McKay, R. J. Beckman & W. J. Conover, Technometrics 21
    (1979) 239), those of Sobol's indices the matrices of A. Saltelli et al., Comput. Phys. Commun.
    181 (2010) 259.

    Args:
        settings: From `with_means`.
        together: The first values of all lists, then the second ones, and so on.
        samples: Of what scatters; by default `SAMPLES`.
        sobol: N of Sobol's indices, a power of 2: N (d + 2) runs of d settings.
        seed: Of the samples, which are the same with the same one.

    Raises:
        InputError: Lists have different lengths, there is nothing to sample, or too much.
    """
    listed = [one for one in settings if one.spread is None]
    scatter = [one for one in settings if one.spread is not None]
    _check(listed, scatter, together=together, samples=samples, sobol=sobol)
    combined = zip if together else product
    lists: list[Values] = [
        dict(zip((one.key for one in listed), row, strict=True))
        for row in combined(*(one.values for one in listed))
    ]
    drawn: list[Values] = [{}]
    if scatter:
        q = _fractions(len(scatter), samples or SAMPLES, sobol, seed)
        columns = [one.spread.at(q[:, i]) for i, one in enumerate(scatter) if one.spread]
        keys = [one.key for one in scatter]
        drawn = [dict(zip(keys, row, strict=True)) for row in zip(*columns, strict=True)]
    if not lists:
        lists = [{}]
    if len(lists) * len(drawn) > MOST:
        what = f"{len(lists) * len(drawn)} runs are too many"
        raise InputError(what, expected=f"at most {MOST}: fewer values or samples")
    rows = tuple({**row, **sample} for row in lists for sample in drawn)
    return Design(tuple(settings), rows, sobol or 0, together)


def _check(
    listed: Sequence[Setting],
    scatter: Sequence[Setting],
    *,
    together: bool,
    samples: int | None,
    sobol: int | None,
) -> None:
    keys = [one.key for one in (*listed, *scatter)]
    if not keys:
        raise InputError(
            "nothing varies", where="--set", expected='for example --set mesh.size="4 mm,2 mm"'
        )
    if twice := next((key for key in keys if keys.count(key) > 1), None):
        raise InputError("this key varies twice", where=twice, expected="all its values in one")
    lengths = {len(one.values) for one in listed}
    if together and len(lengths) > 1:
        each = ", ".join(f"{one.key}: {len(one.values)}" for one in listed)
        raise InputError(
            "the lists have different lengths", where="--zip", expected=f"the same of all: {each}"
        )
    if together and len(listed) < 2:
        what = "one list of values has nothing to go together with"
        raise InputError(what, where="--zip", expected="two lists at least, or no --zip")
    asked = "--samples" if samples is not None else "--sobol" if sobol is not None else ""
    if asked and not scatter:
        raise InputError("nothing scatters", where=asked, expected=_EXAMPLE)
    if sobol is not None and (sobol < 2 or sobol & (sobol - 1)):
        near = 2 ** max(1, round(math.log2(max(sobol, 2))))
        raise InputError(f"{sobol} is no power of 2", where="--sobol", expected=str(near))
    if sobol is not None and listed:
        raise InputError(
            f"Sobol's indices are of what scatters, but {listed[0].key} has a list of values",
            where="--sobol",
            expected=_EXAMPLE,
        )


def _fractions(d: int, samples: int, sobol: int | None, seed: int) -> FloatArray:
    """Points of the unit cube, shape (runs, d)."""
    from scipy.stats import qmc

    rng = np.random.default_rng(seed)
    if sobol is None:
        optimization = "random-cd" if d > 1 and samples <= _FEW else None
        cube = qmc.LatinHypercube(d, rng=rng, optimization=optimization)
        return np.asarray(cube.random(samples))
    both = qmc.Sobol(2 * d, rng=rng).random(sobol)
    A, B = both[:, :d], both[:, d:]
    mixed = []
    for i in range(d):
        one = A.copy()
        one[:, i] = B[:, i]
        mixed.append(one)
    return np.concatenate([A, B, *mixed])


def short_names(keys: Sequence[str]) -> dict[str, str]:
    """Keys to their last parts, with as many before as tell them apart."""

    def endings(key: str) -> list[str]:
        result, text = [], ""
        for part in reversed(key_parts(key)):
            if part.isdigit():
                text = f"[{part}]" + (text if text[:1] in ("", "[") else f".{text}")
            else:
                text = part + (text if text[:1] in ("", "[") else f".{text}")
                result.append(text)
        return result or [key]

    every = [ending for key in keys for ending in endings(key)]
    return {key: next((e for e in endings(key) if every.count(e) == 1), key) for key in keys}


def worded(value: object, setting: Setting) -> str:
    """A value of a setting for people: as it was written, and of what scatters four digits."""
    if setting.spread is not None and (read := number_and_unit(value)) is not None:
        return f"{read[0]:.{DRAWN}g} {read[1]}".rstrip()
    return f"{value:.7g}" if isinstance(value, float) else str(value)
