"""Pictures that draw again from our models what the papers plot."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.files import atomic_write
from missionsim.inputs.power import build_power_model
from missionsim.physics import Array, electrical
from missionsim.published import hou2019, jaiem2021, parasuraman2012, reproduce, rover2025
from missionsim.published.figures import ABOUT, load_figures, run, shipped_robot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from missionsim.control import PowerPredictor

COLOURS = ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377")
"""Distinguishable without colour vision (P. Tol's bright scheme)."""
GREY = "#777777"


def draw(paper: str, out: Path) -> list[Path]:
    """Draw every picture of a paper into a folder as PNG; each has a function of its name below."""
    from matplotlib.figure import Figure

    written = []
    for name, title in ABOUT[paper].pictures.items():
        figure = Figure(figsize=(8.0, 4.0), layout="constrained")
        paint: Callable[[Figure], None] = globals()[f"_{name}"]
        paint(figure)
        figure.suptitle(title, fontsize=10)
        path = out / f"{paper}_{name}.png"
        with atomic_write(path) as temporary:
            figure.savefig(temporary, dpi=110, format="png", metadata={"Software": "missionsim"})
        written.append(path)
    return written


def _finish(axes: Axes, x: str, y: str, legend: bool = True) -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(True, color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    if legend:
        axes.legend(fontsize=8, framealpha=0.9, edgecolor="none")


def _pair(figure: Figure) -> tuple[Axes, Axes]:
    left, right = figure.subplots(1, 2)
    return left, right


def _power_velocity(figure: Figure) -> None:
    robot = shipped_robot("pioneer3dx")
    model = build_power_model(robot)
    speed = np.linspace(0.05, 1.2, 116)
    power = np.asarray(model.total({"speed_m_s": speed, "accel_m_s2": 0.0, "scheme": ""}, "robot"))
    rest = float(model.total({"speed_m_s": 0.0, "accel_m_s2": 0.0, "scheme": ""}, "robot"))
    left, right = _pair(figure)
    left.plot(speed, power, color=COLOURS[0], label="moving")
    left.plot(0.0, rest, "o", color=COLOURS[1], label=f"at rest {rest:.2f} W")
    _finish(left, "velocity (m/s)", "motion power (W)")
    for colour, distance in zip(COLOURS, (10.0, 20.0, 50.0, 100.0), strict=False):
        right.plot(speed, power * distance / speed / 3600.0, color=colour, label=f"{distance:.0f} m")
    p = model.parameters
    best = float(np.sqrt(p["robot/c4"].value / p["robot/c2"].value))
    right.axvline(best, color=GREY, linestyle=":", label=f"least energy, {best:.3f} m/s")
    right.axvline(float(robot.body.max_speed), color=GREY, linestyle="--", label="greatest velocity reached")
    right.set_ylim(0.0, 2.0)
    _finish(right, "velocity (m/s)", "motion energy (Wh)")


def _sonar(figure: Figure) -> None:
    law = shipped_robot("pioneer3dx").components["sonar"].loads[0].law
    assert law is not None
    rate = np.linspace(0.0, 40.0, 81)
    power = electrical.sonar_power(rate, float(law.parameters["p2"]), float(law.parameters["p1"]))
    axes = figure.subplots()
    axes.plot(rate, 1e3 * power, color=COLOURS[0], label="sonars (Eq. 12)")
    standard = float(law.rate or 0.0)
    axes.plot(standard, 1e3 * float(np.interp(standard, rate, power)), "o", color=COLOURS[1], label="standard rate")
    _finish(axes, "rate (Hz)", "power (mW)")


def _stretch(figure: Figure) -> None:
    rows = reproduce.stretch_test()
    axes = figure.subplots()
    x = np.arange(len(rows))
    for offset, key, colour, label in (
        (-0.2, "error_without_pct", COLOURS[4], "plan alone"),
        (0.2, "error_with_pct", COLOURS[1], "with the stretch of the scheme's other two velocities"),
    ):
        axes.bar(x + offset, [row[key] for row in rows], 0.38, color=colour, label=label)
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.set_ylim(-18.0, 10.0)
    axes.set_xticks(x, [f"{row['scheme']}\n{row['speed_m_s']:g} m/s" for row in rows], fontsize=8)
    _finish(axes, "", "error of the prediction (% of measured)")


def _patrol_velocity(figure: Figure) -> None:
    axes = figure.subplots()
    for name, label, style in ((jaiem2021.PLAN, "plan", "--"), (jaiem2021.DRIVEN, "as driven (calibrated)", "-")):
        line = run(name).timeline
        speed = np.asarray(line.columns["speed_m_s"])
        axes.stairs(speed, line.edges_s, baseline=None, linestyle=style, label=label, color=COLOURS[style == "--"])
    _finish(axes, "time (s)", "velocity (m/s)")


def _patrol_error(figure: Figure) -> None:
    figures = load_figures("jaiem2021")
    left, right = _pair(figure)
    for colour, battery in zip(COLOURS, ("robot", "laptop"), strict=False):
        found = jaiem2021.error_curve(battery)
        left.plot(found.time_s, found.measured_wh, color=colour, label=f"{battery}, as driven")
        left.plot(found.time_s, found.predicted_wh, color=colour, linestyle="--", label=f"{battery}, plan")
        for relative, style in (("predicted", "-"), ("measured", ":")):
            label = f"{battery}, of {relative}"
            right.plot(found.time_s, found.percent(relative), color=colour, linestyle=style, label=label)
        right.axhline(figures[f"sec342.{battery}.final"].value, color=colour, linewidth=0.7, alpha=0.6)
        right.axhline(figures[f"sec342.{battery}.peak"].value, color=colour, linewidth=0.7, alpha=0.6)
    _finish(left, "time as driven (s)", "energy (Wh)")
    small: dict[str, Any] = {"transform": right.transAxes, "ha": "right", "va": "bottom", "fontsize": 7, "color": GREY}
    right.text(0.98, 0.01, "thin lines: published peak and final value", **small)
    right.set_ylim(0.0, 38.0)
    _finish(right, "time as driven (s)", "error at equal progress (%)")


def _sequence(figure: Figure) -> None:
    result = run(parasuraman2012.IDENTIFY)
    line = result.timeline
    axes = figure.subplots()
    power = result.power_w("robot")
    axes.stairs(power, line.edges_s, baseline=None, color=COLOURS[0], label="power of the robot")
    before = 0.0
    for index, segment in enumerate(result.segments):
        end = result.segment_end_s[index]
        level = float(power[np.flatnonzero(line.segment == index)[0]])
        axes.text(0.5 * (before + end), level + 0.04, segment.name, ha="center", va="bottom", fontsize=7, rotation=30)
        before = end
    axes.set_ylim(0.0, 2.7)
    _finish(axes, "time (s)", "power (W)", legend=False)


def _energy_speed(figure: Figure) -> None:
    figures = load_figures("parasuraman2012")
    low, high = (figures[f"speed.{name}"].value / 1e3 for name in ("min", "max"))
    speed = np.linspace(low, high, 23)
    left, right = _pair(figure)
    for colour, payload in zip(COLOURS, (0.0, 0.25, 0.5), strict=False):
        watts = [parasuraman2012.motion_power(float(v), payload) for v in speed]
        left.plot(1e3 * speed, watts, color=colour, label=f"payload {payload:g} kg")
    _finish(left, "speed (mm/s)", "motion power (W)")
    for colour, radio in zip(COLOURS, ("wifi", "bluetooth", None), strict=False):
        joules = [3600.0 * parasuraman2012.crossing_energy(float(v), radio) for v in speed]
        right.plot(1e3 * speed, joules, color=colour, label=radio or "no radio")
    right.set_ylim(bottom=0.0)
    _finish(right, "speed (mm/s)", "energy from A to B, 5.6 m (J)")


def _start(figure: Figure) -> None:
    figures = load_figures("hou2019")
    fine = np.linspace(0.0, 1.3, 521)
    for axes, table, name in zip(_pair(figure), ("3", "4"), ("motion", "robot"), strict=True):
        time, measured = hou2019.table_series(figures, table, "measured")
        _, modelled = hou2019.table_series(figures, table, "modelled")
        axes.plot(fine, hou2019.start_powers(fine)[name], color=COLOURS[4], linewidth=0.9, label="ours, all times")
        axes.plot(time, hou2019.start_powers(time)[name], "s", color=COLOURS[0], markersize=4, label="ours, samples")
        axes.plot(time, measured, "o", color="black", markersize=4, fillstyle="none", label="measured (printed)")
        axes.plot(time, modelled, "x", color=COLOURS[1], markersize=4, label="paper's model (printed)")
        axes.set_title(f"Table {table}: {name}", fontsize=9)
        axes.set_ylim(0.0, 62.0)
        _finish(axes, "time (s)", "power (W)")


def _directions(figure: Figure) -> None:
    angles = np.arange(0.0, 181.0, 3.0)
    threshold = hou2019.threshold_ratio()
    axes = figure.subplots()
    for colour, ratio in zip(COLOURS, (0.1, threshold, 2.0 * threshold), strict=False):
        power = hou2019.direction_power(np.radians(angles), ratio)
        best = float(angles[angles <= 90.0][int(np.argmin(power[angles <= 90.0]))])
        label = f"roller over wheel friction {ratio:.3f}: least at {best:.0f}°"
        axes.plot(angles, power, ".-", color=colour, linewidth=0.8, label=label)
    axes.set_xticks(range(0, 181, 45))
    _finish(axes, "direction of travel from straight ahead (°)", "power at 1 m/s (W)")


def _least(robot: PowerPredictor, speeds: Array, complexity: float) -> Array:
    """Least energy per metre at each speed among the clocks that keep up; nan where none does."""
    speed, clock = np.meshgrid(speeds, robot.clocks(), indexing="ij")
    energy = robot.energy_per_metre(speed, clock, complexity)
    good = np.where(robot.meets_service(speed, clock, complexity), energy, np.inf).min(axis=1)
    return np.where(np.isfinite(good), good, np.nan)


def _complexities(figure: Figure) -> None:
    figures = load_figures("rover2025")
    names = {"field": "low", "orchard": "moderate", "slalom": "high"}
    for axes, scale, unit in zip(_pair(figure), (1.0, rover2025.KMH), ("m/s", "km/h"), strict=True):
        robot = rover2025.predictor() if scale == 1.0 else rover2025.predictor(rover2025.kmh_values(figures))
        grid = rover2025.speeds(12.0)
        for colour, (track, complexity) in zip(COLOURS, rover2025.complexity_of_tracks().items(), strict=False):
            least = _least(robot, grid * scale, complexity)
            axes.plot(grid, least, color=colour, label=f"{names[track]} complexity")
            axes.plot(grid[np.nanargmin(least)], np.nanmin(least), "o", color=colour, markersize=5)
        axes.set_ylim(0.0, 25.0 if scale == 1.0 else 30.0)
        axes.set_title("printed speeds in " + unit + (" (SI)" if scale == 1.0 else " (hypothesis)"), fontsize=9)
        _finish(axes, f"speed ({unit})", "energy per metre (J/m)")


def _granularity(figure: Figure) -> None:
    robot = rover2025.predictor(rover2025.kmh_values(load_figures("rover2025")))
    tracks = rover2025.complexity_of_tracks()
    for axes, track, name in zip(_pair(figure), ("field", "slalom"), ("low", "high"), strict=True):
        for colour, step in zip(COLOURS, (3.0, 1.5, 0.5), strict=False):
            grid = rover2025.speeds(12.0, step)
            least = _least(robot, grid * rover2025.KMH, tracks[track])
            best = float(grid[np.nanargmin(least)])
            axes.plot(grid, least, ".-", color=colour, label=f"step {step:g}: least at {best:g}")
        axes.set_title(f"{name} complexity", fontsize=9)
        axes.set_ylim(0.0, 30.0)
        _finish(axes, "printed speed (km/h reading)", "energy per metre (J/m)")


def _mechanical(figure: Figure) -> None:
    fine = rover2025.speeds(9.0, 0.05)
    axes = figure.subplots()
    for colour, constant, label in (
        (COLOURS[0], True, "with the fitted constant drive power"),
        (COLOURS[1], False, "Table 1 alone"),
    ):
        axes.plot(fine, rover2025.mechanical_power(fine, with_constant=constant) / fine, color=colour, label=label)
    axes.axvline(load_figures("rover2025")["mech.speed"].value, color=GREY, linestyle=":", label="published optimum")
    axes.set_ylim(0.0, 20.0)
    _finish(axes, "speed (m/s)", "mechanical energy per metre (J/m)")


def _service(figure: Figure) -> None:
    figures = load_figures("rover2025")
    low, high = figures["fig6.speed.min"].value, figures["fig6.speed.max"].value
    robot = rover2025.predictor(rover2025.kmh_values(figures))
    clocks = robot.clocks()
    clocks = clocks[clocks >= figures["freq.min"].value * 1e9 - 1.0]
    left, right = _pair(figure)
    twin = right.twinx()
    for colour, speed in zip(COLOURS, np.linspace(low, high, 4), strict=False):
        v = speed * rover2025.KMH
        rate = robot.throughput(v, clocks, 1.0)
        left.plot(rate, robot.energy_per_metre(v, clocks, 1.0), ".-", color=colour, label=f"printed speed {speed:g}")
        right.plot(clocks / 1e9, 1e3 * robot.loop_time(v, clocks, 1.0), color=colour)
        twin.plot(clocks / 1e9, rate, color=colour, linestyle="--")
    twin.set_ylabel("batches per second (dashed)")
    left.axvline(figures["batches"].value, color=GREY, linestyle=":")
    _finish(left, "throughput (batches per second)", "energy per metre (J/m)")
    _finish(right, "clock (GHz)", "time per batch, PLPT (ms)", legend=False)


def _fidelity(figure: Figure) -> None:
    rows = reproduce.fidelity()
    steps = [row["speed_step_m_s"] for row in rows]
    axes = figure.subplots()
    axes.loglog(steps, [row["mean_error_pct"] for row in rows], "o-", color=COLOURS[0], label="mean error")
    axes.loglog(steps, [row["max_error_pct"] for row in rows], "o:", color=COLOURS[0], label="greatest error")
    _finish(axes, "speed granularity (m/s)", "error of the energy per metre (%)", legend=False)
    twin = axes.twinx()
    # a count: times differ from run to run (`FidelityModel.measure` takes them), and so would the picture
    twin.semilogx(steps, [row["evaluations"] for row in rows], "s-", color=COLOURS[1], label="evaluations")
    twin.set_ylim(bottom=0.0)
    twin.set_ylabel("evaluations of the power model for the table")
    lines: list[Any] = [*axes.get_lines(), *twin.get_lines()]
    axes.legend(lines, [str(line.get_label()) for line in lines], fontsize=8, frameon=False, loc="upper center")
