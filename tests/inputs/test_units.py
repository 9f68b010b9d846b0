"""Units in text, the small table against pint."""

from __future__ import annotations

import math
import subprocess
import sys

import pytest

from missionsim.inputs import units


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("14.8 V", "voltage", 14.8), ("2200 mAh", "charge", 7920.0), ("10 min", "duration", 600.0),
        ("259 Wh", "energy", 932400.0), ("30 deg/s", "yaw rate", math.pi / 6), ("1.8 km/h", "speed", 0.5),
        ("15 %", "fraction", 0.15), ("2.03 GHz", "frequency", 2.03e9), ("-3", "length", -3.0),
        ("7", "energy", 25200.0), ("2", "charge", 7200.0), ("68 degF", "temperature", 20.0),
        ("293.15 K", "temperature", 20.0), ("5 mph", "speed", 2.2352), ("3 metres", "length", 3.0),
        ("90°", "angle", math.pi / 2), ("5 1/min", "frequency", 5 / 60),
    ],
)  # fmt: skip
def test_quantities(text: str, dimension: str, value: float) -> None:
    assert units.parse(text, dimension)[0] == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "dimension", "message", "hint"),
    [
        ("3 kg", "length", "wrong unit: kg is a unit of mass", ""),
        ("3 acre", "length", "wrong unit", ""),
        ("50 Km", "length", "unknown unit", "km"),
        ("3 w", "power", "unknown unit", "W"),
        ("1:30", "duration", "unknown unit", ""),
        ("1 500 Wh", "energy", "unknown unit", ""),
        ("on", "speed", "not a number with a unit", ""),
        ("nan W", "power", "not a number with a unit", ""),
        ("3 __import__", "power", "unknown unit", ""),
        ("1 m^99999999", "length", "unknown unit", ""),
    ],
)
def test_wrong_units(text: str, dimension: str, message: str, hint: str) -> None:
    with pytest.raises(units.UnitError) as caught:
        units.parse(text, dimension)[0]
    assert (caught.value.message, caught.value.hint) == (message, hint)
    assert caught.value.allowed == str(units.DIMENSIONS[dimension])


@pytest.mark.parametrize(
    ("text", "value", "unit"),
    [
        ("6.25 W s^2/m^2", 6.25, "W s^2/m^2"),
        ("6.25 W/(m/s)^2", 6.25, "W/(m/s)^2"),
        ("2 W s/kg", 2.0, "W s/kg"),
        ("3 mW", 0.003, "W"),
        ("5", 5.0, ""),
        ("10 %", 0.1, "1"),
        ("4.0e-5 W/Hz^2", 4e-5, "W/Hz^2"),
        ("2 W/K", 2.0, "W/K"),
    ],
)
def test_any_unit(text: str, value: float, unit: str) -> None:
    assert units.parse(text) == (pytest.approx(value, rel=1e-12), unit)


def test_any_unit_converts_to_coherent_si() -> None:
    assert units.parse("3 Wh/km")[0] == pytest.approx(10.8, rel=1e-12)
    assert units.parse("2 mW s/kg")[0] == pytest.approx(0.002, rel=1e-12)


def test_table_agrees_with_pint() -> None:
    import pint

    registry = pint.UnitRegistry()
    checked = 0
    for name, told in units.DIMENSIONS.items():
        if name in ("fraction", "number", "temperature"):
            continue
        for unit, factor in told.units.items():
            spelled = (
                unit.replace("°", "degree")
                .replace("Ohm", "ohm")
                .replace("²", "**2")
                .replace("m/s2", "m/s**2")
                .replace("rad/s2", "rad/s**2")
            )
            expected = registry.Quantity(1.0, spelled).to(told.pint).magnitude
            assert factor == pytest.approx(expected, rel=1e-9), unit
            checked += 1
    assert checked > 60


def test_usual_files_do_not_load_pint_or_scipy() -> None:
    code = (
        "import sys; from missionsim.inputs import load_robot; load_robot('pioneer3dx');"
        "print([m for m in ('pint', 'scipy', 'pandas', 'networkx', 'ruamel') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("unit", "other", "same"),
    [
        ("N", "W s/m", True), ("kg", "W s^3/m^2", True), ("W s/rad", "J", True), ("kW", "W", True),
        ("W s/(rad kg)", "W s/kg", True), ("kg * m / s ** 2", "N", True), ("W s/(m K)", "N/K", True),
        ("kg", "W", False), ("W", "W s/m", False), ("J", "W", False), ("furlong", "kg", False),
    ],
)  # fmt: skip
def test_compound_units_of_one_dimension(unit: str, other: str, same: bool) -> None:
    assert units.same_dimension(unit, other) is same
    assert units.same_dimension(other, unit) is same
