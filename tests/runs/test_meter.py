"""A late and sluggish meter: closed form against small steps; compare and the diagnosis show the model through it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from missionsim.errors import InputError
from missionsim.inputs.loading import load_robot
from missionsim.inputs.power import build_power_model
from missionsim.interface import add_effect, compare, diagnose
from missionsim.logs import read_logs
from missionsim.physics.lag import Meter, metered
from missionsim.runs.drive import assume, drive, drive_blocks

pytestmark = pytest.mark.usefixtures("examined_once")


def by_small_steps(power_w, edges_s, meter, step_s):
    """Means over rows of ``lag dy/dt + y = p(t − delay)``, by Euler's method, begun a second before the first row."""
    count = round((edges_s[-1] - edges_s[0] + 1.0) / step_s)
    time_s = edges_s[0] - 1.0 + (np.arange(count) + 0.5) * step_s
    row = np.clip(np.searchsorted(edges_s, time_s - meter.delay_s, side="right") - 1, 0, len(power_w) - 1)
    shown, y = np.empty(count), power_w[0]
    for i, p in enumerate(power_w[row]):
        y += (p - y) * step_s / meter.lag_s if meter.lag_s else p - y
        shown[i] = y
    own = np.searchsorted(edges_s, time_s, side="right")
    return (np.bincount(own, shown) / np.bincount(own))[1:]


@pytest.mark.parametrize("meter", [Meter(0.23, 0.0), Meter(0.0, 0.4), Meter(0.31, 0.37), Meter(-0.17, 0.2)])
def test_rows_show_what_small_steps_give(meter: Meter) -> None:
    rng = np.random.default_rng(3)
    time_s = np.cumsum(rng.choice([0.08, 0.1, 0.3], 60))
    power_w = rng.uniform(5.0, 60.0, 60)
    middle = 0.5 * (time_s[1:] + time_s[:-1])
    edges_s = np.r_[2 * time_s[0] - middle[0], middle, 2 * time_s[-1] - middle[-1]]
    expected = by_small_steps(power_w, edges_s, meter, 1e-4)
    assert metered(power_w, time_s, meter) == pytest.approx(expected, abs=0.08)


def test_a_constant_stays_and_a_meter_at_once_changes_nothing() -> None:
    time_s = np.arange(20) * 0.1
    power_w = np.linspace(3.0, 9.0, 20)
    assert metered(power_w, time_s, Meter()) is power_w
    assert metered(np.full(20, 7.0), time_s, Meter(0.4, 0.3)) == pytest.approx(7.0, rel=1e-12)


def test_what_ends_within_the_log_keeps_its_energy() -> None:
    time_s = np.arange(400) * 0.05
    power_w = np.where((time_s > 4.0) & (time_s < 6.0), 80.0, 12.0)
    for meter in (Meter(0.3, 0.4), Meter(-0.3, 0.1)):
        assert metered(power_w, time_s, meter).sum() == pytest.approx(power_w.sum(), rel=1e-9)


def drives(folder: Path, count: int) -> list[Path]:
    """Runs of a little world: a robot of 60 kg stops and goes; its meter has a lag of 0.5 s and is 0.2 s late."""
    paths = []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        fine_s, rows = 0.01, 2000
        time_s = np.arange(rows * 10) * fine_s
        wanted = np.repeat(rng.choice([0.0, 0.5, 1.0], 40), 500)
        speed = np.empty(len(time_s))
        v = 0.0
        for i, w in enumerate(wanted.tolist()):
            v += min(max(w - v, -0.006), 0.006)
            speed[i] = v
        accel = np.gradient(speed, fine_s)
        power = 14.0 + (speed > 0.0) * (6.0 + 20.0 * speed) + np.maximum(1.3 * 60.0 * accel * speed, -26.0 * speed)
        late = np.r_[np.full(20, power[0]), power[:-20]]
        shown, y = np.empty(len(late)), late[0]
        for i, p in enumerate(late):
            y += (p - y) * fine_s / 0.5
            shown[i] = y
        table = np.column_stack(
            [time_s[5::10], speed.reshape(-1, 10).mean(1), shown.reshape(-1, 10).mean(1) + rng.normal(0, 0.3, rows)]
        )
        path = folder / f"run{seed}.csv"
        np.savetxt(path, table, delimiter=",", header="time_s,speed_m_s,power_main_w", comments="", fmt="%.4f")
        paths.append(path)
    return paths


ROBOT = """kind: robot
name: own
body: {drive: differential, mass: 60 kg, max_speed: 1.5 m/s}
batteries:
  main: {capacity: 500 Wh}
motion:
  battery: main
  model: polynomial
  parameters:
    c2: 1e-6 W s^2/m^2
    c3: {value: 20 W s/m, sd: 0.6}
    c4: {value: 20 W, sd: 0.6}
    standing: {value: 14 W, sd: 0.4}
"""


@pytest.mark.long
@pytest.mark.usefixtures("effects_alone")
def test_the_meter_that_was_found_stands_in_the_file_and_compare_shows_the_model_through_it(tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text(ROBOT)
    runs = drives(tmp_path, 6)
    add_effect(tmp_path / "own.yaml", "acceleration", runs[:4], battery="main").save(tmp_path / "new.yaml")
    meter = load_robot(tmp_path / "new.yaml").batteries["main"].meter
    assert meter is not None
    assert meter.delay.value + meter.lag.value == pytest.approx(0.7, abs=0.12)
    before, after = (
        compare(tmp_path / name, runs[4:]).to_json()["batteries"]["main"] for name in ("own.yaml", "new.yaml")
    )
    (told,) = [note for note in compare(tmp_path / "new.yaml", runs[4:]).notes if "meter" in note]
    assert f"lag {meter.lag.value:.2f} s" in told
    assert after["power_rmse_w"] < 0.3 * before["power_rmse_w"]
    held = diagnose(tmp_path / "own.yaml", runs[:4], holdout=runs[4:]).to_json()["batteries"]["main"]["heldout"]
    assert held["power_rmse_w"]["nominal"] == pytest.approx(before["power_rmse_w"], rel=1e-9)
    assert held["power_rmse_w"]["with_effects"] == pytest.approx(after["power_rmse_w"], rel=1e-4)


def test_a_run_in_blocks_shows_what_it_shows_whole(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(ROBOT.replace("capacity: 500 Wh", "capacity: 500 Wh, meter: {delay: 0.2 s, lag: 0.5 s}"))
    model, (run,) = build_power_model(load_robot(path)), read_logs(drives(tmp_path, 1))
    blocks = [run.rows_where(slice(a, b)) for a, b in ((0, 700), (700, 900), (900, None))]
    whole = drive(model, run, "main")
    parts = drive_blocks(assume(model, run.columns, ["main"]), blocks)
    shown = np.concatenate([part.model_w["main"] for part in parts])
    assert shown == pytest.approx(whole.model_w["main"], abs=1e-3)
    assert np.max(np.abs(whole.model_w["main"] - whole.row_w("main"))) > 5.0


def test_a_meter_that_cannot_be_is_refused_where_it_stands(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(ROBOT.replace("capacity: 500 Wh", "capacity: 500 Wh, meter: {delay: 2 h, lag: -1 s}"))
    with pytest.raises(InputError) as told:
        load_robot(path)
    assert [(fault.line, "impossible" in fault.message) for fault in told.value.faults] == [(5, True), (5, True)]
