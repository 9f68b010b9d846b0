"""Tables beside the published figures: what the papers plot or leave out, computed from our robots."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from missionsim.published import hou2019, jaiem2021, parasuraman2012, patrol, rover2025
from missionsim.published.figures import load_figures, shipped_robot

Rows = list[dict[str, Any]]
SEED, DRAWS = 20210426, 2000


def optimal_velocities() -> Rows:
    """Speed of least robot energy per metre for each set of sensors (Jaiem 2021, Eq. 11)."""
    from missionsim.inputs.power import build_power_model
    from missionsim.physics import motion

    robot = shipped_robot("pioneer3dx")
    model = build_power_model(robot)
    c2, c4 = (model.parameters[f"robot/{name}"].value for name in ("c2", "c4"))
    still: dict[str, Any] = {"speed_m_s": 0.0, "accel_m_s2": 0.0, "scheme": ""}
    rest = float(model.total(still, "robot"))
    rows: Rows = []
    for units in itertools.product((0, 1), (0, 1, 2), (0, 1)):
        on = dict(zip(("sonar", "laser", "kinect"), units, strict=True))
        extra = float(model.total({**still, **{f"on_{name}": float(n) for name, n in on.items()}}, "robot")) - rest
        best = float(motion.optimal_speed(c2, c4, extra))
        reachable = "yes" if best <= float(robot.body.max_speed) else "no"
        rows.append({**on, "sensors_w": extra, "v_opt_m_s": best, "reachable": reachable})
    return rows


def stretch_test() -> Rows:
    """Table 5: path stretch of each run, of the other two of its scheme, and the run predicted with the latter."""
    figures = load_figures("jaiem2021")
    runs = jaiem2021.runs_of_table5(figures)
    left_out = jaiem2021.stretch_left_out(runs)
    return [
        {
            "scheme": experiment,
            "speed_m_s": float(velocity),
            "plan_wh": predicted,
            "measured_wh": measured,
            "stretch_of_run": measured / predicted,
            "stretch_of_others": left_out[experiment, velocity],
            "predicted_wh": predicted * left_out[experiment, velocity],
            "error_without_pct": 100.0 * (predicted / measured - 1.0),
            "error_with_pct": 100.0 * (predicted * left_out[experiment, velocity] / measured - 1.0),
        }
        for (experiment, velocity), (predicted, measured) in runs.items()
    ]


def stretch_summary() -> Rows:
    """Root mean square error of predicting Table 5, by what was left out of the fit of the stretch."""
    rows = stretch_test()
    schemes = list(dict.fromkeys(row["scheme"] for row in rows))
    result: Rows = []
    for scheme in [*schemes, "all"]:
        of = [row for row in rows if scheme in (row["scheme"], "all")]
        errors = ("error_without_pct", "error_with_pct")
        rms = {f"rms_{name}": float(np.sqrt(np.mean(np.square([row[name] for row in of])))) for name in errors}
        result.append({"scheme": scheme, "mean_stretch": float(np.mean([row["stretch_of_run"] for row in of])), **rms})
    return result


def patrol_errors() -> Rows:
    """Error statistics of the patrol by both definitions, beside the published ones."""
    figures = load_figures("jaiem2021")
    rows: Rows = []
    for battery in ("robot", "laptop"):
        curve = patrol.error_curve(battery)
        for relative in ("predicted", "measured"):
            for name, value in curve.statistics(relative).items():
                row = {"battery": battery, "relative_to": relative, "statistic": name, "ours_pct": value}
                rows.append({**row, "published_pct": figures[f"sec342.{battery}.{name}"].value})
    return rows


def patrol_uncertainty() -> Rows:
    """The same statistics when the behaviour is drawn from its causes instead of calibrated."""
    drawn = patrol.uncertain_statistics(patrol.Causes(), DRAWS, SEED)
    figures = load_figures("jaiem2021")
    rows: Rows = []
    for battery, statistics in drawn.items():
        for name, values in statistics.items():
            low, median, high = (float(q) for q in np.quantile(values, (0.05, 0.5, 0.95)))
            row = {"battery": battery, "statistic": name, "q05_pct": low, "median_pct": median, "q95_pct": high}
            rows.append({**row, "published_pct": figures[f"sec342.{battery}.{name}"].value})
    return rows


def components() -> Rows:
    """Khepera III: component powers found by the sequence of operations on a noisy record, against the robot file."""
    clean, noisy = (parasuraman2012.identified_components(noise) for noise in (0.0, 0.05))
    return [{"component": name, "robot_file_w": clean[name], "found_with_noise_w": noisy[name]} for name in clean]


def static_powers() -> Rows:
    """Khepera III: the one solution of the four percentages."""
    found = parasuraman2012.static_powers(load_figures("parasuraman2012"))
    return [
        {"quantity": "static power without radio", "value": found.without_radio_w, "unit": "W"},
        {"quantity": "Bluetooth", "value": found.bluetooth_w, "unit": "W"},
        {"quantity": "WiFi", "value": found.wifi_w, "unit": "W"},
        {"quantity": "standing time per metre", "value": found.standing_s_m, "unit": "s/m"},
    ]


def model_errors() -> Rows:
    """Mecanum robot: errors of the paper's own model and of the robot file over the moving samples."""
    figures = load_figures("hou2019")
    rows: Rows = []
    for name, found in (("paper", hou2019.paper_errors(figures)), ("mecanum4.yaml", hou2019.robot_errors(figures))):
        for table, (rmse, mape, most) in found.items():
            rows.append({"model": name, "table": table, "rmse_w": rmse, "mape_pct": mape, "max_pct": most})
    return rows


def identifiability() -> Rows:
    """Mecanum robot: the same data under different starts give masses far apart."""
    return list(hou2019.identifiability(load_figures("hou2019")))


def directions() -> Rows:
    """Mecanum robot: power by direction for three friction ratios of rollers to wheels."""
    angles = np.arange(0.0, 181.0, 3.0)
    threshold = hou2019.threshold_ratio()
    ratios = (0.1, threshold, 2.0 * threshold)
    curves = [hou2019.direction_power(np.radians(angles), ratio) for ratio in ratios]
    return [
        {"angle_deg": float(angle), **{f"ratio_{r:.3f}_w": float(c[i]) for r, c in zip(ratios, curves, strict=True)}}
        for i, angle in enumerate(angles)
    ]


def fidelity() -> Rows:
    """Rover: error of each fidelity level (times depend on the machine: `FidelityModel.measure`)."""
    from missionsim.fidelity import LEVELS, FidelityModel

    model = FidelityModel(rover2025.predictor(), (0.5, 9.0))
    rows: Rows = []
    for level in LEVELS:
        mean, most = model.error_pct(level)
        best = model.optimum(level)
        row = {"level": level.name, "speed_step_m_s": level.speed_step_m_s, "clock_step_hz": level.clock_step_hz}
        row |= {"evaluations": best.evaluations, "mean_error_pct": mean, "max_error_pct": most}
        row |= {"best_speed_m_s": best.speed_m_s, "best_clock_ghz": best.freq_hz / 1e9}
        rows.append({**row, "energy_j_m": best.energy_j_m})
    return rows


_MADE: list[Callable[[], Rows]] = [optimal_velocities, stretch_test, stretch_summary, patrol_errors, patrol_uncertainty]
_MADE += [static_powers, components, model_errors, identifiability, directions, rover2025.optima, fidelity]
TABLES: dict[str, Callable[[], Rows]] = {function.__name__: function for function in _MADE}
"""Name of a table → the function that makes it."""
