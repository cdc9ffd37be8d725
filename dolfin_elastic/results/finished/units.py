"""SI units of the columns of `history.csv` and of fields."""

from __future__ import annotations

import re

_EXACT = {
    "max_displacement": "m",
    "external_work": "J",
    "frequency": "Hz",
    "omega": "rad/s",
    "mass": "kg",
}
_BEGINNINGS = {
    "reaction_": "N",
    "momentum_": "kg m/s",
    "angular_momentum_": "kg m^2/s",
    "moment_": "N m",
    "section_force_": "N",
    "section_moment_": "N m",
    "torque_": "N m",
    "penetration_": "m",
    "contact_area_": "m^2",
    "pressure_": "Pa",
    "volume_": "m^3",
}
_VECTORS = (
    "reaction_",
    "momentum_",
    "angular_momentum_",
    "moment_",
    "section_force_",
    "section_moment_",
)
_WITHOUT = ("step", "load_factor", "newton", "krylov", "balance_force", "balance_moment")
_WITHOUT_UNIT = (*_WITHOUT, "min_jacobian", "max_jacobian")
_AXES, _TURNS = ("x", "y", "z"), ("rx", "ry", "rz")
_SHIFTS = ("ux", "uy", "uz")
_STRESS = re.compile(r"P[1-3]{2}")
"""Of a periodic cell."""


_NUMBER = re.compile(r"(_length)?_(max|min|mean|area_integral|volume_integral)(_[xyz]{1,2})?$")
"""What follows the field in columns of numbers over a surface or region."""


def column_unit(column: str, *, moving: bool) -> str:
    """Unit of a column of `history.csv`; empty of a pure number.

    Probes are told by the end of the name, see [output] probes: a name and axis are a displacement,
    a name and a field have the field's unit.

    Args:
        moving: The run was a motion, so that t is a time.
    """
    exact = {**_EXACT, **dict.fromkeys(_WITHOUT_UNIT, ""), "t": "s" if moving else ""}
    if column in exact:
        return exact[column]
    if column.endswith("_energy"):
        return "J"
    if _STRESS.fullmatch(column):
        return "Pa"
    last = column.rpartition("_")[2]
    begin = next((unit for begin, unit in _BEGINNINGS.items() if column.startswith(begin)), None)
    # A support may be called as a field is.
    if begin is not None and column.startswith(_VECTORS) and last in _AXES:
        return begin
    if (unit := _field_unit(column)) is not None:
        return unit
    by_end = "m" if last in (*_AXES, *_SHIFTS) else "rad" if last in _TURNS else ""
    return by_end if begin is None else begin


def _field_unit(column: str) -> str | None:
    """Unit of the longest name of a field that a column ends in, but for components."""
    from dolfin_elastic.results.fields import FIELDS

    if (number := _NUMBER.search(column)) is not None:
        unit = _field_unit(column[: number.start()] + (number.group(3) or ""))
        over = {"area_integral": "m^2", "volume_integral": "m^3"}.get(number.group(2), "")
        return None if unit is None else f"{unit} {over}".strip()
    name, _, last = column.rpartition("_")
    vector, tensor = last in _AXES, len(last) == 2 and set(last) <= set(_AXES)
    text = name if vector or tensor else column
    found = [field for field in FIELDS if text.endswith(f"_{field}")]
    return FIELDS[max(found, key=len)].unit if found else None
