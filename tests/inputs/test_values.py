"""Numbers with spread: written forms, distributions, impossible ones."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from missionsim.errors import InputError
from missionsim.inputs.loading import load_environment
from missionsim.inputs.parameter import Distribution, Parameter
from missionsim.inputs.values import EffectNumber, Fraction, Power, QuantityOf, Slope, Temperature

POWER: TypeAdapter[Parameter] = TypeAdapter(Power)


def read(raw: Any, folder: Path | None = None) -> Parameter:
    return POWER.validate_python(raw, context={"folder": folder})


def messages(raw: Any, adapter: TypeAdapter[Any] = POWER) -> list[tuple[str, tuple[Any, ...]]]:
    with pytest.raises(ValidationError) as caught:
        adapter.validate_python(raw)
    return [(entry["message"], entry["at"]) for error in caught.value.errors() for entry in error["ctx"]["entries"]]


def test_plain_numbers_and_texts_are_certain() -> None:
    assert read(2.34) == Parameter(2.34, unit="W")
    assert read("2340 mW").value == pytest.approx(2.34)
    assert read("2.34 W").distribution is None


def test_sd_absolute_and_relative() -> None:
    given_sd = read({"value": "2.34 W", "sd": "50 mW", "status": "published", "source": "Table 2"})
    assert (given_sd.value, given_sd.sd, given_sd.status, given_sd.source) == (2.34, 0.05, "published", "Table 2")
    assert given_sd.distribution == Distribution("truncated_normal", 2.34, 0.05, 0.0, 1e6)
    assert read({"value": "2 W", "sd": "3 %"}).sd == pytest.approx(0.06)


def test_low_and_high_mean_uniform() -> None:
    parameter = read({"low": "2 W", "high": "3 W"})
    assert parameter.value == 2.5
    assert parameter.distribution == Distribution("uniform", low=2.0, high=3.0)
    assert parameter.sd == pytest.approx(1 / math.sqrt(12))


def test_bounds_of_an_effect_are_no_distribution() -> None:
    parameter = TypeAdapter(EffectNumber).validate_python({"value": 1, "low": 0, "high": 10, "unit": "W s/kg"})
    assert (parameter.low, parameter.high, parameter.distribution, parameter.unit) == (0.0, 10.0, None, "W s/kg")


def test_unit_beside_a_plain_number_is_converted() -> None:
    assert TypeAdapter(EffectNumber).validate_python({"value": 2, "unit": "mW"}).value == pytest.approx(0.002)


@pytest.mark.parametrize(
    ("raw", "expected"),
    [
        ({"kind": "normal", "sd": "0.1 W"}, Distribution("normal", 2.0, 0.1)),
        ({"kind": "lognormal", "sd": "5 %"}, Distribution("lognormal", 2.0, 0.1)),
        ({"kind": "triangular", "low": "1 W", "high": "4 W"}, Distribution("triangular", low=1.0, high=4.0, mode=2.0)),
        ({"kind": "truncated_normal", "sd": 1, "low": 0.5}, Distribution("truncated_normal", 2.0, 1.0, 0.5)),
        (
            {"kind": "discrete", "values": ["1 W", "3 W"], "weights": [1, 3]},
            Distribution("discrete", values=(1.0, 3.0), weights=(0.25, 0.75)),
        ),
        (
            {"kind": "empirical", "values": [1, 2, 3, 4]},
            Distribution("empirical", values=(1.0, 2.0, 3.0, 4.0), weights=(0.25,) * 4),
        ),
    ],
)
def test_named_distributions(raw: dict[str, Any], expected: Distribution) -> None:
    assert read({"value": "2 W", "distribution": raw}).distribution == expected


def test_empirical_from_a_csv_column(tmp_path: Path) -> None:
    (tmp_path / "measured.csv").write_text("t,power_w\n0,1.5\n1,2.5\n2,\n", encoding="utf-8")
    parameter = read({"distribution": {"kind": "empirical", "file": "measured.csv", "column": "power_w"}}, tmp_path)
    assert parameter.distribution is not None
    assert parameter.distribution.values == (1.5, 2.5)
    assert parameter.value == 2.0


@pytest.mark.parametrize("bounds", [{}, {"distribution": {"kind": "uniform"}}])
def test_rounding_of_a_unit_puts_no_value_outside_its_bounds(bounds: dict[str, Any]) -> None:
    """350 mW are 0.35000000000000003 W."""
    assert 350 * 1e-3 > 0.35
    ends = {"low": 0.1, "high": 0.35}
    given = {"distribution": bounds["distribution"] | ends} if bounds else ends
    assert read({"value": "350 mW"} | given).value == pytest.approx(0.35)


@pytest.mark.parametrize(
    ("raw", "expected"),
    [
        (True, [("not a number", ())]),
        ("3 V", [("wrong unit: V is a unit of voltage", ())]),
        (float("nan"), [("not a finite number", ())]),
        (-1, [("impossible value", ())]),
        ({"value": "-1 W"}, [("impossible value", ("value",))]),
        ({"value": 1, "sd": -1}, [("standard deviation below zero", ("sd",))]),
        ({"value": 1, "sdd": 1}, [("unknown key 'sdd'", ("sdd",))]),
        (
            {"value": "1 kg", "status": "guessed", "x": 1},
            [
                ("unknown key 'x'", ("x",)),
                ("unknown status", ("status",)),
                ("wrong unit: kg is a unit of mass", ("value",)),
            ],
        ),
        ({"low": 3, "high": 2}, [("low above high", ("low",))]),
        ({"value": 5, "low": 1, "high": 2}, [("value outside its own low and high", ("value",))]),
        (
            {"value": 5, "distribution": {"kind": "uniform", "low": 10, "high": 20}},
            [("value outside its own distribution", ("value",))],
        ),
        (
            {"value": "1 kW", "distribution": {"kind": "discrete", "values": [1, 2], "weights": [1, 1]}},
            [("value outside its own distribution", ("value",))],
        ),
        ({"sd": 1}, [("no value", ())]),
        ({"value": 1, "distribution": {"kind": "gauss"}}, [("unknown kind of distribution", ("distribution", "kind"))]),
        (
            {"value": 1, "distribution": {"kind": "uniform", "low": 1}},
            [("a uniform distribution needs 'high'", ("distribution",))],
        ),
        (
            {"value": 1, "distribution": {"kind": "uniform", "low": -1, "high": 2}},
            [("impossible value", ("distribution",))],
        ),
        (
            {"distribution": {"kind": "discrete", "values": [1, 2], "weights": [1]}},
            [("weights do not fit the values", ("distribution", "weights"))],
        ),
        ([1], [("not a number", ())]),
        (None, [("not a number", ())]),
        (10**400, [("number too large", ())]),
    ],
)
def test_impossible_numbers(raw: Any, expected: list[tuple[str, tuple[Any, ...]]]) -> None:
    assert messages(raw) == expected


def test_fraction_above_one_suggests_percent() -> None:
    with pytest.raises(ValidationError) as caught:
        TypeAdapter(Fraction).validate_python(15)
    assert caught.value.errors()[0]["ctx"]["entries"][0]["hint"] == "15 %"


def test_slope_in_percent_and_temperature() -> None:
    assert TypeAdapter(Slope).validate_python("10 %").value == pytest.approx(math.atan(0.1))
    assert TypeAdapter(Temperature).validate_python("300 K").value == pytest.approx(26.85)


DISTRIBUTIONS = [
    Distribution("normal", 2.0, 0.3),
    Distribution("truncated_normal", 0.1, 0.3, 0.0, 5.0),
    Distribution("truncated_normal", -3.0, 0.5, 0.0, 1.0),
    Distribution("truncated_normal", 9.0, 0.5, 0.0, 1.0),
    Distribution("lognormal", 2.0, 0.5),
    Distribution("uniform", low=1.0, high=4.0),
    Distribution("triangular", low=1.0, high=4.0, mode=1.5),
    Distribution("discrete", values=(1.0, 2.0, 7.0), weights=(0.2, 0.5, 0.3)),
    Distribution("empirical", values=(3.0, 1.0, 2.0, 2.0), weights=(0.25,) * 4),
]


@pytest.mark.parametrize("distribution", DISTRIBUTIONS, ids=lambda item: item.kind)
def test_quantiles_have_the_stated_moments(distribution: Distribution) -> None:
    # the midpoints of 200 000 equal slices of probability: an integral over the quantile function
    values = distribution.quantile((np.arange(200_000) + 0.5) / 200_000)
    assert np.mean(values) == pytest.approx(distribution.mean, rel=1e-4)
    assert np.std(values) == pytest.approx(distribution.sd, rel=2e-3)
    assert np.all(np.diff(values) >= 0)
    if distribution.low is not None:
        assert values.min() >= distribution.low
    if distribution.high is not None:
        assert values.max() <= distribution.high


@given(st.floats(1e-3, 1e3), st.floats(1e-3, 0.5))
def test_scaled_parameter_scales_its_distribution(value: float, share: float) -> None:
    adapter = TypeAdapter(Annotated[Parameter, QuantityOf("power")])
    parameter = adapter.validate_python({"value": value, "sd": share * value}).scaled(3.0, "W")
    assert parameter.distribution is not None
    assert parameter.distribution.mean == pytest.approx(3 * value)
    assert parameter.distribution.sd == pytest.approx(3 * share * value)


@pytest.mark.parametrize("kind", ["lognorm", "{q: 1}", "[normal]"])
def test_a_kind_of_distribution_that_is_none_is_a_fault_of_the_file(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "site.yaml"
    text = (
        "kind: environment\nname: site\nplaces:\n  tank: {x: 60 m, y: {value: 2, distribution: {kind: %s, sd: 5 %%}}}\n"
    )
    path.write_text(text % kind, encoding="utf-8")
    with pytest.raises(InputError, match="unknown kind of distribution"):
        load_environment(path)
