"""What a check says of materials: up to which stretches they are stable, and where they round."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.toml import key_text
from dolfin_elastic.core.si_text import given, percent, quantity
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.spatial import units_of
from dolfin_elastic.model.strength import Strength


def stability_notes(case: Case) -> Iterator[str]:
    """Materials that constants of the wrong sign make unstable at moderate stretches. Local."""
    for where, law in _with_numbers(case):
        if (named := law.destabilising()) and (bounds := _limits(law)):
            words, span = bounds
            yield (
                f"{where}: with {' and '.join(named)} {words} is stable only for "
                f"{span}; a body that is strained further, and thin parts of it before, has no "
                "stable equilibrium"
            )


def material_information(case: Case) -> tuple[str, ...]:
    """Up to which stretches laws are stable whatever their constants, digits lost, what relaxes."""
    return (*_stable_ranges(case), *_rounded(case), *_relaxing(case), *_ageing(case))


def _ageing(case: Case) -> Iterator[str]:
    own = {name: m.law for name, m in case.materials.items() if m.law.memory and m.law.written}
    if not own:
        return
    from dolfin_elastic.model.point.history import changes_at_rest

    for name, law in own.items():
        if change := changes_at_rest(law):
            yield f"materials.{key_text(name)}.next: {change}"


def _relaxing(case: Case) -> Iterator[str]:
    for name, material in case.materials.items():
        if (law := material.law).viscous:
            what = "whole" if law.relaxes_whole else "isochoric"
            yield (
                f"materials.{key_text(name)}.viscous: the {what} stress relaxes to "
                f"{percent(law.lasting / law.sudden)} of that of a sudden load"
            )
            if (shift := law.viscous_shift) is not None:
                yield (
                    f"materials.{key_text(name)}.viscous_shift: at "
                    f"{quantity(shift.temperature, 'K')} all times are {shift.factor:.4g} times "
                    f"those of {quantity(shift.reference, 'K')}"
                )


_ERROR = 0.01
"""Of the stress, from which on the size of time steps is worth a note."""
_FINEST = 1e-6
"""Of a step: finer ones are not looked for."""


def step_notes(case: Case) -> Iterator[str]:
    """Time steps that are long beside the times in which a material relaxes. Local."""
    if case.gives_modes or (dt := _longest_step(case)) is None:
        return
    for name, material in case.materials.items():
        if not (law := material.law).viscous or (error := error_of_steps(law, dt)) <= _ERROR:
            continue
        finer, shortest = dt, law.series[1].min()
        while error_of_steps(law, finer) > _ERROR:
            finer /= 2
        yield (
            f"materials.{key_text(name)}.viscous: steps of {quantity(dt, 's')} beside a time of "
            f"{quantity(shortest, 's')}: where the strain changes as fast, the stress is off by "
            f"about {percent(error)}; steps of {quantity(finer, 's')} keep it below "
            f"{percent(_ERROR)}"
        )
    yield from _notes_of_rates(case, dt)


def _notes_of_rates(case: Case, dt: float) -> Iterator[str]:
    for name, material in case.materials.items():
        law = material.law
        if law.memory is None or not law.written or law.spatial_constants():
            continue
        from dolfin_elastic.model.point.history import error_of_rates

        error_of = error_of_rates(law)
        if (error := error_of(dt)) <= _ERROR:
            continue
        finer = dt / 2
        while error_of(finer) > _ERROR and finer > _FINEST * dt:
            finer /= 2
        yield (
            f"materials.{key_text(name)}.rate: the stress of a small strain that grows within a "
            f"step of {quantity(dt, 's')} is off by about {percent(error)}; steps of "
            f"{quantity(finer, 's')} keep it below {percent(_ERROR)}"
        )


def _longest_step(case: Case) -> float | None:
    """Of the case [s]; None where that is not known."""
    if case.dynamics is not None:
        return None if case.dynamics.adaptive else case.dynamics.dt
    if (statics := case.statics) is None:
        return None
    return statics.end * (statics.largest if statics.steps is None else 1 / statics.steps)


def error_of_steps(law: Law, dt: float) -> float:
    """Error of the stress of a strain that varies as fast as the branches, over the stress.

    Over a step the strain is taken as linear in time; of exp(t/tau) and sin(t/tau) the chords are
    off by (dt/tau)^2/12 in the mean.  Backward Euler of a branch far from equilibrium is off by
    dt/(4 tau) where the strain is exp(t/tau).

    Args:
        dt: Length of the steps [s].
    """
    ratios, times = law.series
    x = dt / times
    each = x / 4 if law.viscous_deviation == "large" else x**2 / 12
    return float(ratios @ np.minimum(each, 1.0)) / law.sudden


def material_constants(case: Case) -> Iterator[str]:
    """Name, law and constants of each material in a line, and its source in another. Local."""
    for name, material in case.materials.items():
        table, units = material.table(), units_of(type(material.law))
        keys = sorted(units.keys() & table.keys(), key=lambda k: (k in Law.model_fields, k))
        if isinstance(strength := material.law.allowable, Strength):
            unit = "" if strength.of_strain else units["allowable"]
            table = {**table, "allowable": _with_units(table["allowable"], unit)}
        values = (f"{k} = {given(table[k], units[k])}" for k in keys)
        law = "energy" if material.law.written else material.law.name()
        yield f"{name}: {', '.join((law, *values))}"
        if material.source:
            yield f"  source: {material.source}"


def _with_units(written: object, unit: str) -> object:
    """A table with its numbers, and those of tables in it, as texts with a unit."""
    if isinstance(written, Mapping):
        return {key: _with_units(value, unit) for key, value in written.items()}
    return given(written, unit) if isinstance(written, int | float) else written


def _stable_ranges(case: Case) -> Iterator[str]:
    for where, law in _with_numbers(case):
        if law.limited and (bounds := _limits(law)):
            yield f"{where}: {bounds[0]} is stable for {bounds[1]}"


def _limits(law: Law) -> tuple[str, str] | None:
    """A law in words, and for which stretches it is stable; None where it always is."""
    # Few cases need them, and they import all that tests a law at a point.
    from dolfin_elastic.model.point.alternatives import law_in_words
    from dolfin_elastic.model.point.stable_range import limits

    bounds = limits(law)
    return (law_in_words(law), bounds) if bounds else None


def _rounded(case: Case) -> Iterator[str]:
    for where, law in _with_numbers(case):
        if law.rounds:
            yield (
                f"{where}.energy: strains below about 1e-9 lose digits, for F and invariants are "
                "rounded to 1e-16; written in E11 ... E33 they keep them"
            )


def _with_numbers(case: Case) -> Iterator[tuple[str, Law]]:
    """Key and law of each material, but for those whose constants vary in space."""
    for name, material in case.materials.items():
        if not material.law.spatial_constants():
            yield f"materials.{key_text(name)}", material.law
