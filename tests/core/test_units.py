"""Numbers with units."""

from __future__ import annotations

import math
import re
import subprocess
import sys

import pytest

from dolfin_elastic.core import units
from dolfin_elastic.core.errors import UnitError
from dolfin_elastic.core.units import (
    COMMON_UNITS,
    _registry,
    is_quantity,
    metres,
    reading,
    to_base,
    to_si,
)

FINITE = "a number up to 1e308, no nan and no inf"


@pytest.mark.parametrize(
    ("written", "unit", "value"),
    [
        ("210 GPa", "Pa", 210e9),
        ("0.3 MPa", "Pa", 0.3e6),
        ("0.3MPa", "Pa", 0.3e6),
        ("1 N/mm^2", "Pa", 1e6),
        ("1 N/mm**2", "Pa", 1e6),
        ("210000 N/(mm^2)", "Pa", 210e9),
        ("2 kN/(m s^-1)", "N*s/m", 2e3),
        ("1 N/(mm)^2", "Pa", 1e6),
        ("3 1/(ms)", "1/s", 3e3),
        (2, "m", 2.0),
        (2.5, "Pa", 2.5),
        ("2e-3", "m", 2e-3),
        ("-2 mm", "m", -2e-3),
        ("  1 cm ", "m", 1e-2),
        (".5 m", "m", 0.5),
        ("1100 kg/m^3", "kg/m^3", 1100.0),
        ("1.1 g/cm^3", "kg/m^3", 1100.0),
        ("9.81 m/s^2", "m/s^2", 9.81),
        ("10 kN/m^3", "N/m^3", 1e4),
        ("1 ms", "s", 1e-3),
        ("1 psi", "Pa", 6894.757293168361),
        ("1 inch", "m", 0.0254),
        ("5 %", "", 0.05),
        ("12e-6 1/K", "1/K", 12e-6),
        ("12e-6 1/degC", "1/K", 12e-6),
        ("12e-6/K", "1/K", 12e-6),
        ("1e-3 / °C", "1/K", 1e-3),
        ("3 1/s", "1/s", 3.0),
        ("18 1 / degF", "1/K", 32.4),
        ("80 celsius", "K", 80.0),
        ("-9 degF", "K", -5.0),
        ("4 degR", "K", 4 / 1.8),
    ],
)
def test_to_si(written: float | str, unit: str, value: float) -> None:
    """Any compatible unit is taken, a bare number as it stands."""
    # Round-off of 273.15 K, from which changes of temperature are taken.
    assert to_si(written, unit) == pytest.approx(value, rel=1e-14 if unit != "K" else 1e-12)


@pytest.mark.parametrize(
    ("written", "unit", "message"),
    [
        (
            "10 MPaa",
            "Pa",
            "unknown unit 'MPaa' in '10 MPaa' (did you mean 'MPa'?); expected a number in Pa, for "
            'example "210 GPa"',
        ),
        (
            "10 quux",
            "Pa",
            "unknown unit 'quux' in '10 quux'; expected a number in Pa, for example \"210 GPa\"",
        ),
        (
            "1 Mpa",
            "Pa",
            "unknown unit 'Mpa' in '1 Mpa' (did you mean 'MPa'?); expected a number in Pa, "
            'for example "210 GPa"',
        ),
        (
            "1.1 g/cm3",
            "kg/m^3",
            "unknown unit 'g/cm3' in '1.1 g/cm3' (did you mean 'g/cm^3'?); expected a number in "
            'kg/m^3, for example "1100 kg/m^3"',
        ),
        (
            "10 mm",
            "Pa",
            "'10 mm' has the wrong unit; expected a number in Pa, for example \"210 GPa\"",
        ),
        (
            "3 dB",
            "",
            "'3 dB' is on a scale whose steps are not equal; a unit that is proportional to SI "
            "units",
        ),
        ("31/s", "1/s", "'31/s' is not a number; expected a number in 1/s"),
        ("10 mm", "", "'10 mm' has the wrong unit; expected a pure number"),
        ("ten", "m", "'ten' is not a number; expected a number in m, for example \"2 mm\""),
        ("", "m", "'' is not a number; expected a number in m, for example \"2 mm\""),
        (True, "m", 'True is not a number; expected a number in m, for example "2 mm"'),
        ([1], "m", '[1] is not a number; expected a number in m, for example "2 mm"'),
        (float("nan"), "m", "nan is not a finite number; " + FINITE),
        (float("inf"), "m", "inf is not a finite number; " + FINITE),
        ("1e999", "m", "'1e999' is not a finite number; " + FINITE),
        (
            "20 degC",
            "m",
            "'20 degC' has the wrong unit; expected a number in m, for example \"2 mm\"",
        ),
    ],
)
def test_refused(written: float | str, unit: str, message: str) -> None:
    """Each message says what was written and what is expected."""
    with pytest.raises(UnitError) as caught:
        to_si(written, unit)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("written", "unit", "meant"),
    [
        ("1 Mpaa", "Pa", "MPa"),
        ("1 mpa", "Pa", "MPa"),
        ("3 kNm", "N*m", "kN*m"),
        ("3 kNm", "N/m", "kN/m"),
        ("3 kNm", "N", "kN"),
        ("3 kNs", "N", "kN"),
        ("2 mmm", "m", "mm"),
        ("2 kg/m3", "kg/m^3", "kg/m^3"),
        ("2 rmp", "rad/s", "rpm"),
        ("2 m/ss", "m/s^2", "m/s^2"),
        ("2 MPaa", None, "MPa"),
        ("2 kNm", "Pa", "kN/m^2"),
        ("2 furlang", "K", ""),
        ("2 m", "s", ""),  # a length, and not ms
        ("10 mm", "m/s", ""),
    ],
)
def test_misspelt_units(written: str, unit: str | None, meant: str) -> None:
    """The nearest unit of the right dimension is named, none where none is near."""
    with pytest.raises(UnitError, match="unknown unit|the wrong unit") as caught:
        to_base(written) if unit is None else to_si(written, unit)
    found = re.findall(r"\(did you mean '(.*)'\?\)", str(caught.value))
    assert found == [meant] * bool(meant)


@pytest.mark.parametrize("unit", sorted({*units.COMMON_UNITS, *units._OTHER_UNITS}))
def test_proposed_units_are_read(unit: str) -> None:
    """Every unit that a message may propose is one of its dimension."""
    for name in (*units.COMMON_UNITS.get(unit, ()), *units._OTHER_UNITS.get(unit, ())):
        assert math.isfinite(to_si(f"1 {name}", unit)), name


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2", True),
        ("2 mm", True),
        ("2mm", True),
        ("-1e3 N/m^3", True),
        ("5 %", True),
        ("2*t", False),
        ("2 - t", False),
        ("3/t", False),
        ("5/s", False),
        ("51/s", False),
        ("5 1/s", True),
        ("5 1/t^2*x", False),
        ("2 ^ t", False),
        ("2 mmm", False),
        ("x", False),
        ("", False),
        ("free", False),
        ("0.1*x*t", False),
    ],
)
def test_quantity_or_formula(text: str, expected: bool) -> None:
    """No formula begins with a number and a word, so the two never meet."""
    assert is_quantity(text) is expected


@pytest.mark.parametrize(
    ("si", "name"), [(si, name) for si in COMMON_UNITS for name in COMMON_UNITS[si]]
)
def test_common_units(si: str, name: str) -> None:
    """The short table says what pint says."""
    assert COMMON_UNITS[si][name] == pytest.approx(_registry().Quantity(1.0, name).to(si).magnitude)


def test_common_units_do_not_load_the_unit_library() -> None:
    """Its import takes as long as a small solve."""
    code = (
        "import sys; from dolfin_elastic.core.units import is_quantity, to_si; to_si('2e3', 'm'); "
        "is_quantity('0.1*x'); is_quantity('2 mm'); to_si('2 MPa', 'Pa'); "
        "sys.exit('pint' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(
    "text", ["1 m^9^9^9", "1 m**9**9**9", "1 m^999999999", "1 m^(9^9^9)", "1 " + "m*" * 50 + "m"]
)
def test_no_unit_keeps_the_machine_busy(text: str) -> None:
    """Pint would work such powers out."""
    with pytest.raises(UnitError, match="unknown unit"):
        to_si(text, "m")


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("1 µm", "m", 1e-6),
        ("1 μm", "m", 1e-6),
        ("2 kg m^-3", "kg/m^3", 2),
        ("2 kg*m**-3", "kg/m^3", 2),
        ("3 N/mm²", "Pa", 3e6),
        ("1 lbf / inch ^ 2", "Pa", 6894.757293168361),
        ("5 %", "", 0.05),
        ("30 °", "", 0.5235987755982988),
    ],
)
def test_units_as_people_write_them(text: str, unit: str, value: float) -> None:
    assert to_si(text, unit) == pytest.approx(value, rel=1e-12)


def test_base_units():
    """Units of any kind; where a temperature might be a change of one, it is refused."""
    assert to_base("2 kN/mm") == pytest.approx(2e6, rel=1e-15)
    assert to_base("3 1/degF") == pytest.approx(5.4, rel=1e-12)
    assert to_base("20 K") == 20.0
    for text in ("20 degC", "80 celsius", "20 degF"):
        with pytest.raises(UnitError, match="a temperature or a change of one; the same in K"):
            to_base(text)


def test_units_of_forty_characters() -> None:
    """Longer ones are nobody's: Pint would work them out, however long."""
    assert to_si("2 " + "km*km/km" + "*m/m" * 8, "m") == pytest.approx(2000, rel=1e-12)
    with pytest.raises(UnitError, match="unknown unit"):
        to_si("2 m" + "*m/m" * 10, "m")


def test_scales_with_a_zero_of_their_own():
    """Equal steps from another zero are told from unequal steps, however large a step is."""
    # 80 C above the 0 C of 273.15 K, and as a change of temperature.
    assert to_si("80 celsius", "K") == pytest.approx(80, rel=1e-12)
    assert to_si("180 degF", "K") == pytest.approx(100, rel=1e-12)
    for unit in ("dB", "dBm", "dBu", "Np", "decade", "octave"):  # 1, 1 mW, 1 uW; e, 10, 2
        with pytest.raises(UnitError, match="on a scale whose steps are not equal"):
            to_base(f"3 {unit}")


def test_readings_on_a_scale():
    """Of a temperature the zero counts, of all else there is none."""
    for written, scale, value in (
        ("20 degC", "", 293.15),
        ("20 °C", "K", 293.15),
        ("20 degC", "degF", 68.0),
        ("300 K", "degC", 26.85),
        ("20", "degC", 20.0),
        (20.0, "", 20.0),
    ):
        assert reading(written, "K", scale) == pytest.approx(value, rel=1e-12)
    assert reading("2 kPa", "Pa", "MPa") == pytest.approx(2e-3)
    with pytest.raises(UnitError, match="wrong unit"):
        reading("20 m", "K", "degC")


def test_units_that_mean_more():
    """A turn is 2 pi, and a change of temperature knows no zero."""
    assert to_si("50 Hz", "rad/s") == pytest.approx(314.1592653589793, rel=1e-15)
    assert to_si("3000 rpm", "rad/s") == pytest.approx(314.1592653589793, rel=1e-15)
    assert to_si("1 kHz", "rad/s") == pytest.approx(6283.185307179586, rel=1e-15)
    assert to_si("1000 rad/s", "Hz") == pytest.approx(159.15494309189535, rel=1e-15)
    assert to_si("360 deg/s", "Hz") == pytest.approx(1.0, rel=1e-15)
    assert to_si("3000 rpm", "Hz") == pytest.approx(50.0, rel=1e-15)
    assert to_si("2 kHz", "Hz") == 2000.0
    assert to_si("80 degC", "K") == to_si("80 K", "K") == 80.0
    assert to_si("12 ppm/K", "1/K") == pytest.approx(12e-6, rel=1e-15)


def test_lengths_beside_a_mesh():
    """Numbers, also in quotes, are in its unit; texts with a unit are not."""
    assert [metres(value, 1e-3) for value in (3, "3", "3 mm", "3 m")] == [3e-3, 3e-3, 3e-3, 3.0]
