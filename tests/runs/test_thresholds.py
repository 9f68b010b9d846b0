"""What makes a run odd, in cases just on both sides of each number."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from missionsim.logs import LogTable
from missionsim.runs import admit, alike
from missionsim.runs.covariates import repeated
from missionsim.runs.drive import filled
from missionsim.runs.run import larger, mended


def run(name: str, watts: np.ndarray | None = None, **columns: np.ndarray) -> LogTable:
    count = len(next(iter(columns.values())))
    power = np.ones(count) if watts is None else watts
    own = {"time_s": np.arange(count) + 0.5, **columns}
    return LogTable(name, own, np.ones(count), {"robot": power}, {"robot": None}, {"robot": "power"})


@pytest.mark.parametrize(
    ("others", "times", "told"),
    [
        ((0.0, 0.0, 0.0, 0.0), 1.45, ""),
        ((0.0, 0.0, 0.0, 0.0), 1.55, "which agree"),
        ((0.0, 0.0, 0.0, 0.0), 5.7, "which agree"),
        ((0.0, 0.0, 0.0, 0.0), 6.3, "another unit?"),
        ((-0.1, -0.1, -0.1, 0.0, 0.1, 0.1), np.exp(1.15), ""),  # far, but the others do not agree either
        ((-0.1, -0.1, -0.1, 0.0, 0.1, 0.1), np.exp(1.25), "which agree"),
        ((-0.5, -0.5, -0.5, 0.0, 0.5, 0.5), np.exp(1.95), ""),
        ((-0.5, -0.5, -0.5, 0.0, 0.5, 0.5), np.exp(2.05), "another unit?"),
    ],
)
def test_a_level_that_is_far_from_the_others(others: tuple[float, ...], times: float, told: str) -> None:
    """Logarithms of measured over expected energy in the other runs, and the ratio of the last."""
    runs = [SimpleNamespace(run=f"{i}", columns={}) for i in range(len(others) + 1)]
    found = admit._factors(runs, [*np.exp(others), times], lambda _: 1.0, "robot")
    words = {**found[0], **found[1]}
    assert words.keys() == ({runs[-1].run} if told else set())
    assert all(text.partition(told)[1] for text in words.values())


@pytest.mark.parametrize(("left", "explained"), [(1.2, True), (1.3, False), (0.84, True), (0.76, False)])
def test_another_unit_of_the_speed_explains_what_it_mends(left: float, explained: bool) -> None:
    speeds = [np.linspace(0.0, top, 50) for top in (1.0, 1.0, 1.0, 3.6)]
    runs = [run(f"{i}", speed_m_s=speed) for i, speed in enumerate(speeds)]
    found, doubtful = admit._factors(runs, [1.0, 1.0, 1.0, 3.0], lambda _: left, "robot")
    assert ("km/h" in found.get("3", "")) is explained
    assert ("3" in doubtful) is not explained


@pytest.mark.parametrize(
    ("rows", "spread", "late", "beside", "told"),
    [
        (4000, 0.2, 8, 0.0, False),  # a meter may be late
        (4000, 0.2, 12, 0.0, True),
        (110, 0.2, 20, 0.0, True),
        (90, 0.2, 20, 0.0, False),  # too few rows to tell
        (4000, 0.16, 20, 0.0, True),
        (4000, 0.14, 20, 0.0, False),
        (4000, 0.2, 20, 0.72, False),  # correlated by 0.58 and 0.81
        (4000, 0.2, 20, 0.58, True),  # 0.5 and 0.87
    ],
)
def test_power_that_lies_long_before_or_after_the_motion(
    rows: int, spread: float, late: int, beside: float, told: bool
) -> None:
    rng, driven = np.random.default_rng(1), []
    for i in range(2):
        wave = rng.normal(size=rows)
        measured = 10.0 + np.roll(wave, late) + beside * wave
        model = 10.0 + 10.0 * spread * wave / wave.std()
        driven.append(SimpleNamespace(run=SimpleNamespace(run=f"{i}"), dt_s=np.ones(rows)))
        driven[-1].measured_w, driven[-1].model_w = {"robot": measured}, {"robot": model}
    assert len(admit._of_another_time(driven, "robot")) == 2 * told


@pytest.mark.parametrize(("part", "told"), [(0.12, True), (0.165, False)])
def test_power_of_which_the_motion_explains_next_to_nothing(part: float, told: bool) -> None:
    """Of its variance 1.4 or 2.7 per cent."""
    rng, driven = np.random.default_rng(1), []
    for i in range(3):
        wave, other = rng.normal(size=(2, 20_000))
        driven.append(SimpleNamespace(run=SimpleNamespace(run=f"{i}"), dt_s=np.ones(20_000)))
        driven[-1].measured_w, driven[-1].model_w = {"robot": 9.0 + part * wave + other}, {"robot": 9.0 + 3.0 * wave}
    assert len(admit._of_another_time(driven, "robot")) == 3 * told


@pytest.mark.parametrize(
    ("usual", "high", "told"), [(0.01, 0.28, False), (0.01, 0.32, True), (0.05, 0.57, False), (0.05, 0.63, True)]
)
def test_a_slope_that_no_robot_climbs(usual: float, high: float, told: bool) -> None:
    runs = [run(f"{i}", slope_rad=np.full(50, slope)) for i, slope in enumerate((usual, usual, usual, high))]
    assert ("3" in admit._units(runs)) is told


@pytest.mark.parametrize(("median", "elsewhere"), [(121.0, []), (124.0, ["humidity"]), (-24.0, ["humidity"])])
def test_a_run_that_is_where_no_other_is(median: float, elsewhere: list[str]) -> None:
    """The others lie between 2 and 98, and a quarter of that range further on they still say what is usual."""
    others = [run(f"{i}", humidity=np.linspace(0.0, 100.0, 101)) for i in range(3)]
    assert alike.beyond(run("3", humidity=np.full(50, median)), others) == elsewhere


@pytest.mark.parametrize(
    ("down", "noise_w", "lasts_s", "told"),
    [
        ((1, 1), 1.0, 1, False),
        ((1, 1, 1), 1.0, 1, True),
        ((1, 1, 1, 1, 0), 1.0, 1, True),
        ((1, 1, 1, 0, 0), 1.0, 1, False),
        ((1, 1, 1, 1, 1), 4.5, 1, True),
        ((1, 1, 1, 1, 1), 5.2, 1, False),  # 4 % of the variance of the power
        ((1, 1, 1, 1, 1), 1.7, 20, True),  # t = 6.9
        ((1, 1, 1, 1, 1), 2.3, 20, False),  # t = 5.3
    ],
)
def test_a_slope_with_its_sign_turned(down: tuple[int, ...], noise_w: float, lasts_s: int, told: bool) -> None:
    """Runs in which going down costs 20 N on slopes of 0.1 rad at 0.5 m/s; in the others going up costs 4 N."""
    assert bool(admit._downwards(on_slopes(down, noise_w, lasts_s), "robot")) is told


@pytest.mark.parametrize(("slowest", "told"), [(0.03, False), (0.055, True)])
def test_a_speed_that_is_none_says_nothing_of_a_slope(slowest: float, told: bool) -> None:
    """Up to 1.5 times as fast."""
    runs = on_slopes((1, 1, 1, 1), 0.1, 1, (slowest, 1.5 * slowest))
    assert bool(admit._downwards(runs, "robot")) is told


def on_slopes(
    down: tuple[int, ...], noise_w: float, lasts_s: int, speeds: tuple[float, float] = (0.3, 0.7)
) -> list[LogTable]:
    rng, runs = np.random.default_rng(1), []
    for i, one in enumerate(down):
        speed, count = rng.uniform(*speeds, 400), 400 // lasts_s
        slope, noise = (np.repeat(x, lasts_s) for x in (0.1 * rng.choice([-1.0, 1.0], count), rng.normal(size=count)))
        watts = 20.0 - (20.0 if one else -4.0) * speed * slope + noise_w * noise
        runs.append(run(f"{i}", watts, speed_m_s=speed, slope_rad=slope))
    return runs


@pytest.mark.parametrize(("noise", "copy"), [(0.0026, True), (0.0034, False)])
def test_powers_that_differ_by_less_than_noise_are_one_measurement(noise: float, copy: bool) -> None:
    side = np.tile([-1.0, 1.0], 100)
    runs = [run("a", np.full(200, 10.0), load=side), run("b", 10.0 + 10.0 * noise * side, load=side)]
    assert bool(admit.copies(runs)) is copy


@pytest.mark.parametrize(
    ("own", "shared", "again", "copy"),
    [
        (0, 63, 0, False),  # fewer than 60 places to tell by
        (0, 70, 0, True),
        (540, 460, 0, False),  # less than half of the run is the other's
        (480, 520, 0, True),
        (0, 1000, 80, True),
        (0, 1000, 140, False),  # a commanded speed comes again
    ],
)
def test_speeds_that_are_another_runs_to_the_last_digit(own: int, shared: int, again: int, copy: bool) -> None:
    rng = np.random.default_rng(1)
    first = rng.random(1000)
    second = np.concatenate([rng.random(own), first[1000 - shared :]])
    speeds = [np.concatenate([one, one[:again]]) for one in (first, second[: len(second) - (shared == 1000)])]
    runs = [run(f"{i}", rng.random(len(speed)), speed_m_s=speed) for i, speed in enumerate(speeds)]
    assert bool(admit.copies(runs)) is copy


@pytest.mark.parametrize(("dwell_s", "copy"), [((40, 25, 60), False), ((30, 30, 30), True)])
def test_ramps_that_a_drive_makes_alike_come_at_times_of_their_own(dwell_s: tuple[int, ...], copy: bool) -> None:
    """A boat's cruise control: 8 to 10 of 16 runs were left out as copies of others."""
    ramps = [np.linspace(low, high, 30) for low, high in ((0.0, 0.97), (0.97, 1.6), (1.6, 0.013))]
    speeds = [
        np.concatenate([np.append(ramp, np.full(seconds, ramp[-1])) for ramp, seconds in zip(ramps, held, strict=True)])
        for held in ((30, 30, 30), dwell_s)
    ]
    rng = np.random.default_rng(1)
    runs = [run(f"{i}", rng.random(len(speed)), speed_m_s=speed) for i, speed in enumerate(speeds)]
    assert bool(admit.copies(runs)) is copy


@pytest.mark.parametrize(("top", "size"), [(1.45, 0), (1.55, 1), (0.7, 0), (0.63, -1)])
def test_a_column_that_is_larger_than_in_any_other_run(top: float, size: int) -> None:
    runs = [run(f"{i}", speed_m_s=np.full(50, speed)) for i, speed in enumerate((1.0, 1.0, top))]
    assert larger("speed_m_s", runs[2], runs[:2]) == size


@pytest.mark.parametrize(("part", "told"), [(0.14, False), (0.16, True), (0.94, True), (0.96, False)])
def test_a_column_that_stands_still(part: float, told: bool) -> None:
    speed = np.random.default_rng(1).random(1000)
    speed[20 : 20 + round(1000 * part)] = 0.5
    words = [words for words, _ in mended(run("a", speed_m_s=speed), [])]
    assert any(one.startswith("speed_m_s stands at 0.5 from 20.5 to ") for one in words) is told


@pytest.mark.parametrize(("missing", "kept"), [(19, True), (21, False)])
def test_missing_values_are_filled_where_they_are_few(missing: int, kept: bool) -> None:
    speed = np.where(np.arange(100) < missing, np.nan, 1.0)
    assert ("speed_m_s" in filled(run("a", speed_m_s=speed), ["robot"])) is kept


@pytest.mark.parametrize(("r", "other"), [(0.998, {}), (0.9995, {"reading": "speed_m_s"})])
def test_a_column_that_is_another_one_in_other_units(r: float, other: dict[str, str]) -> None:
    wave = np.arange(400) * 2.0 * np.pi / 400
    speed, reading = 2.0 + np.cos(wave), r * np.cos(wave) + np.sqrt(1.0 - r**2) * np.sin(wave)
    assert repeated([{"time_s": np.arange(400.0), "speed_m_s": speed, "reading": reading}]) == other
