"""Jaiem et al. 2021, Pioneer 3DX: every figure from the robot file and the shipped missions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Any

import numpy as np

from missionsim.effects.model import PowerModel
from missionsim.inputs.power import build_power_model
from missionsim.physics import motion
from missionsim.published import patrol
from missionsim.published.figures import Figure, Ours, load_figures, load_table, mission, run, shipped_robot

PAPER = "jaiem2021"
SCHEMES = {
    "FM": "forward_motion",
    "SPF-OA": "path_following",
    "CM-OA": "centring_motion",
    "RVT": "rotational_visual_tracking",
    "IA": "image_analysis",
}
NAVIGATION = {"none": None, "ODO": "odometry", "QRCN": "qr_code", "GBL": "grid_based_localisation"}
CORRIDOR = {
    "fm": "corridor_forward_motion",
    "cm": "corridor_centring_motion",
    "qr1": "corridor_qr_code_4_markers",
    "qr2": "corridor_qr_code_8_markers",
}
Row = dict[str, str]


def ours() -> dict[str, Ours]:
    """What we compute for each figure, by key."""
    figures = load_figures(PAPER)
    robot = shipped_robot("pioneer3dx")
    model = build_power_model(robot)
    rows = [table4_row(model, row) for row in load_table("jaiem2021_table4_rows")]
    parts = (_inputs(robot), _equations(model), _table1(robot), _table4(rows), _ranges(rows), _table5(figures))
    return dict(chain(*parts, patrol.figures()))


def table4_row(model: PowerModel, row: Row) -> dict[str, float]:
    """One row of Table 4: battery powers and their parts (W), shares (%)."""
    cov: dict[str, Any] = {
        "speed_m_s": float(row["speed_m_s"]),
        "accel_m_s2": 0.0,
        "scheme": row["scheme"],
        "navigation": row["navigation"],
        **{f"on_{name}": float(row[name]) for name in ("sonar", "laser", "kinect")},
    }
    power = model.evaluate(cov)
    laptop: dict[str, float] = {}
    for key, watts in power["laptop"].items():
        laptop[key.component] = laptop.get(key.component, 0.0) + float(watts)
    screen = float(model.total({**cov, "on_screen": 1.0}, "laptop")) - sum(laptop.values())
    p_r = sum(float(w) for w in power["robot"].values())
    p_l = sum(laptop.values())
    total = p_r + p_l
    return {
        "row": float(row["row"]),
        "speed": float(row["speed_m_s"]),
        "P_R": p_r,
        "P_L_kinect": laptop["kinect"],
        "P_L_laser": laptop["laser"],
        "P_L_watt": laptop["wattmeter"] + laptop["robot_controller"],
        "P_L_switch1": laptop["switchboard1"],
        "P_L_switch2": laptop["switchboard2"],
        "P_L_screen": screen,
        "P_L_proc": laptop["processor"],
        "P_L": p_l,
        "pct_screen": 100.0 * screen / (p_l + screen),
        "P_total": total,
        "pct_P_R": 100.0 * p_r / total,
        "pct_P_L": 100.0 * p_l / total,
        "delta_P": 100.0 * abs(p_r - p_l) / total,
    }


def _table4(rows: list[dict[str, float]]) -> Iterator[tuple[str, Ours]]:
    for row in rows:
        for name in row.keys() - {"row", "speed"}:
            yield f"table4.r{int(row['row']):02d}.{name}", Ours(row[name])
    yield "sec322.row2_speed", Ours(rows[2]["speed"], "velocity of path following in every other row")


def _inputs(robot: Any) -> Iterator[tuple[str, Ours]]:
    laser, boards = robot.components["laser"], robot.switchboards
    yield "switch_channels", Ours(float(len(boards["switchboard1"].power) - 1), "relays of switchboard 1")
    yield "sec311.two_lasers", Ours(laser.units * float(laser.loads[0].power))
    speeds = {row["scheme"]: float(row["speed_m_s"]) for row in load_table("jaiem2021_table4_rows")}
    yield "speed.rvt", Ours(speeds["rotational_visual_tracking"])
    yield "speed.others", Ours(speeds["forward_motion"])
    usb_volts = 5.0  # USB bus voltage, Universal Serial Bus specification
    figures = load_figures(PAPER)
    for port in ("usb2", "usb3"):
        yield f"{port}.power", Ours(figures[f"{port}.current"].value * usb_volts)


def _equations(model: PowerModel) -> Iterator[tuple[str, Ours]]:
    rest = model.total({"speed_m_s": 0.0, "accel_m_s2": 0.0, "scheme": ""}, "robot")
    yield "sec312.at_rest", Ours(float(rest))
    values = {name: p.value for name, p in model.parameters.items()}
    best = float(motion.optimal_speed(values["robot/c2"], values["robot/c4"]))
    top = float(shipped_robot("pioneer3dx").body.max_speed)
    yield "eq10.vopt", Ours(best)
    yield "zone2", Ours(top - best)
    still = {"speed_m_s": 0.0, "accel_m_s2": 0.0, "scheme": ""}
    sonar = model.total({**still, "on_sonar": 1.0}, "robot") - rest
    yield "sonar.power", Ours(float(sonar))


def _table1(robot: Any) -> Iterator[tuple[str, Ours]]:
    for key in load_figures(PAPER):
        if key.startswith("table1."):
            _, scheme, navigation, what = key.split(".")
            required, _ = robot.schemes[SCHEMES[scheme]].sensor_rules(NAVIGATION[navigation])
            yield key, Ours(float(required.get("laser" if what == "lasers" else "kinect", 0)))


def _ranges(rows: list[dict[str, float]]) -> Iterator[tuple[str, Ours]]:
    named = list(zip(load_table("jaiem2021_table4_rows"), rows, strict=True))
    fm = [row for config, row in named if config["scheme"] == "forward_motion"]
    moving = [row for config, row in named if float(config["speed_m_s"]) > 0.0]

    def least(of: list[dict[str, float]], name: str) -> float:
        return min(row[name] for row in of)

    def most(of: list[dict[str, float]], name: str) -> float:
        return max(row[name] for row in of)

    def span(of: list[dict[str, float]], name: str) -> float:
        return 100.0 * (most(of, name) / least(of, name) - 1.0)

    largest = max(fm, key=lambda row: row["delta_P"])
    others = [row for config, row in named if config["scheme"] not in ("image_analysis", "rotational_visual_tracking")]
    shares = {config["scheme"]: row["pct_P_L"] for config, row in named}
    values = {
        "fm.min": least(fm, "P_R"),
        "fm.max": most(fm, "P_R"),
        "fm.count": float(len(fm)),
        "fm.range": span(fm, "P_R"),
        "all.min": least(moving, "P_R"),
        "all.max": most(rows, "P_R"),
        "proc.fm.min": least(fm, "P_L_proc"),
        "proc.fm.max": most(fm, "P_L_proc"),
        "proc.fm.range": span(fm, "P_L_proc"),
        "proc.all.min": least(rows, "P_L_proc"),
        "proc.all.max": most(rows, "P_L_proc"),
        "total.fm.min": least(fm, "P_total"),
        "total.fm.max": most(fm, "P_total"),
        "share.max_difference": largest["delta_P"],
        "share.pr": largest["pct_P_R"],
        "share.pl": largest["pct_P_L"],
        "share.all": most(others, "delta_P"),
        "laptop.rvt": shares["rotational_visual_tracking"],
        "laptop.ia": shares["image_analysis"],
    }
    for name, value in values.items():
        yield f"sec34.{name}", Ours(value)


def corridor_energy(experiment: str, velocity: str) -> float:
    """Energy (Wh) of the robot battery in a corridor run of Table 5, simulated."""
    name = f"pioneer3dx/{CORRIDOR[experiment]}_{round(float(velocity) * 100)}cm_s"
    return run(name).batteries["robot"].energy_wh


def runs_of_table5(figures: Mapping[str, Figure]) -> dict[tuple[str, str], tuple[float, float]]:
    """Predicted (simulated) and measured energy (Wh) of the twelve runs; the two interchanged values are put right. The
    paper cuts digits, so half of the last one is added to a measured value."""
    result = {}
    for key, figure in figures.items():
        if key.startswith("table5.") and key.endswith(".experiment"):
            experiment, velocity = key[len("table5.") : -len(".experiment")].split(".", 1)
            source = figure
            if figure.basis == "contradiction":
                source = figures[key.replace(".experiment", ".predicted")]
            measured = source.value + source.last_digit / 2.0
            result[experiment, velocity] = (corridor_energy(experiment, velocity), measured)
    return result


def stretch_left_out(runs: Mapping[tuple[str, str], tuple[float, float]]) -> dict[tuple[str, str], float]:
    """Path stretch of each run from the other runs of its scheme (it does not see the run itself)."""
    result = {}
    for experiment, velocity in runs:
        others = [m / p for (e, v), (p, m) in runs.items() if e == experiment and v != velocity]
        result[experiment, velocity] = float(np.mean(others))
    return result


def _table5(figures: Mapping[str, Figure]) -> Iterator[tuple[str, Ours]]:
    runs = runs_of_table5(figures)
    stretch = stretch_left_out(runs)
    errors: dict[str, list[float]] = {}
    for (experiment, velocity), (predicted, _) in runs.items():
        key = f"table5.{experiment}.{velocity}"
        yield f"{key}.predicted", Ours(predicted)
        k = stretch[experiment, velocity]
        note = f"predicted with a path stretch of {k:.3f} from the scheme's other two velocities"
        yield f"{key}.experiment", Ours(predicted * k, note)
        printed = figures[f"{key}.experiment"].value
        # the errors of the QR-code runs follow from the cut predictions, those of the others from the uncut ones
        cut = experiment.startswith("qr")
        used = math.floor(predicted * 100.0 + 1e-9) / 100.0 if cut else predicted
        error = 100.0 * abs(printed - used) / printed
        errors.setdefault(experiment, []).append(error)
        note = "from the printed experiment and our prediction" + " cut to two digits" * cut
        yield f"{key}.error", Ours(error, note)
    for velocity in dict.fromkeys(velocity for _, velocity in runs):
        driven: Any = mission(f"pioneer3dx/{CORRIDOR['fm']}_{round(float(velocity) * 100)}cm_s").defaults.speed
        yield f"table5.velocity.{velocity}", Ours(float(driven))
    corridor: Any = mission("pioneer3dx/" + CORRIDOR["fm"] + "_10cm_s").segments[0]
    length = float(corridor.distance)
    yield "sec341.d2", Ours(length)
    yield "sec341.fm_limit", Ours(max(errors["fm"]))
    yield "sec341.cm_limit", Ours(min(errors["cm"]))
    yield "sec341.qr2_error", Ours(float(np.mean(errors["qr2"])))
    markers = figures["sec341.qr_markers2"].value
    yield "sec341.qr_spacing_low", Ours(length / markers)
    yield "sec341.qr_spacing_high", Ours(length / markers)
