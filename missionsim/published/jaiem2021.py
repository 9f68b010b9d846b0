"""Jaiem et al. 2021, Pioneer 3DX: every figure from the robot file and the shipped missions."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from missionsim.effects.model import PowerModel
from missionsim.inputs.power import build_power_model
from missionsim.physics import Array, motion
from missionsim.published.figures import Figure, Ours, load_figures, load_table, mission, run, shipped_robot
from missionsim.results.write import segments_table
from missionsim.runs import error

PAPER, ROWS = "jaiem2021", "jaiem2021_table4_rows"
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


def ours() -> dict[str, Ours]:
    """What we compute for each figure, by key."""
    figures, robot, configurations = load_figures(PAPER), shipped_robot("pioneer3dx"), load_table(ROWS)
    model = build_power_model(robot)
    found: dict[str, Ours] = {}
    relays = len(robot.switchboards["switchboard1"].power) - 1
    found["switch_channels"] = Ours(float(relays), "relays of switchboard 1")
    laser = robot.components["laser"]
    found["sec311.two_lasers"] = Ours(laser.units * float(laser.loads[0].power or 0.0))
    speeds = {row["scheme"]: float(row["speed_m_s"]) for row in configurations}
    found["speed.rvt"] = Ours(speeds["rotational_visual_tracking"])
    found["speed.others"] = Ours(speeds["forward_motion"])
    usb_volts = 5.0  # USB bus voltage, Universal Serial Bus specification
    for port in ("usb2", "usb3"):
        found[f"{port}.power"] = Ours(figures[f"{port}.current"].value * usb_volts)
    still: dict[str, Any] = {"speed_m_s": 0.0, "accel_m_s2": 0.0, "scheme": ""}
    rest = model.total(still, "robot")
    found["sec312.at_rest"] = Ours(float(rest))
    found["sonar.power"] = Ours(float(model.total({**still, "on_sonar": 1.0}, "robot") - rest))
    best = float(motion.optimal_speed(*(model.parameters[f"robot/{name}"].value for name in ("c2", "c4"))))
    found["eq10.vopt"] = Ours(best)
    found["zone2"] = Ours(float(robot.body.max_speed) - best)
    for key in figures:
        if key.startswith("table1."):
            _, scheme, navigation, what = key.split(".")
            required, _ = robot.schemes[SCHEMES[scheme]].sensor_rules(NAVIGATION[navigation])
            found[key] = Ours(float(required.get("laser" if what == "lasers" else "kinect", 0)))
    rows = [table4_row(model, row) for row in configurations]
    for row in rows:
        for name in row.keys() - {"row", "speed"}:
            found[f"table4.r{int(row['row']):02d}.{name}"] = Ours(row[name])
    found["sec322.row2_speed"] = Ours(rows[2]["speed"], "velocity of path following in every other row")
    found |= _ranges([row["scheme"] for row in configurations], rows)
    return found | dict(_table5(figures)) | dict(_patrol())


def table4_row(model: PowerModel, row: dict[str, str]) -> dict[str, float]:
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


def _ranges(schemes: list[str], rows: list[dict[str, float]]) -> dict[str, Ours]:
    """Section 3.4: ranges over rows of Table 4."""
    named = list(zip(schemes, rows, strict=True))
    fm = [row for scheme, row in named if scheme == "forward_motion"]
    moving = [row for row in rows if row["speed"] > 0.0]
    others = [row for scheme, row in named if scheme not in ("image_analysis", "rotational_visual_tracking")]
    shares = {scheme: row["pct_P_L"] for scheme, row in named}
    largest = max(fm, key=lambda row: row["delta_P"])

    def span(values: list[float]) -> float:
        return 100.0 * (max(values) / min(values) - 1.0)

    values = {
        name: of([row[column] for row in chosen])
        for name, of, column, chosen in (
            ("fm.min", min, "P_R", fm),
            ("fm.max", max, "P_R", fm),
            ("fm.count", len, "P_R", fm),
            ("fm.range", span, "P_R", fm),
            ("all.min", min, "P_R", moving),
            ("all.max", max, "P_R", rows),
            ("proc.fm.min", min, "P_L_proc", fm),
            ("proc.fm.max", max, "P_L_proc", fm),
            ("proc.fm.range", span, "P_L_proc", fm),
            ("proc.all.min", min, "P_L_proc", rows),
            ("proc.all.max", max, "P_L_proc", rows),
            ("total.fm.min", min, "P_total", fm),
            ("total.fm.max", max, "P_total", fm),
            ("share.all", max, "delta_P", others),
        )
    }
    columns = {"max_difference": "delta_P", "pr": "pct_P_R", "pl": "pct_P_L"}
    values |= {f"share.{name}": largest[column] for name, column in columns.items()}
    values |= {"laptop.rvt": shares["rotational_visual_tracking"], "laptop.ia": shares["image_analysis"]}
    return {f"sec34.{name}": Ours(float(value)) for name, value in values.items()}


def corridor(experiment: str, velocity: str) -> str:
    """The shipped mission of a run of Table 5."""
    return f"pioneer3dx/{CORRIDOR[experiment]}_{round(float(velocity) * 100)}cm_s"


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
            simulated = run(corridor(experiment, velocity)).batteries["robot"].energy_wh
            result[experiment, velocity] = (simulated, measured)
    return result


def stretch_left_out(runs: Mapping[tuple[str, str], tuple[float, float]]) -> dict[tuple[str, str], float]:
    """Path stretch of each run from the other runs of its scheme (it does not see the run itself)."""
    return {
        (of, at): float(np.mean([m / p for (e, v), (p, m) in runs.items() if e == of and v != at])) for of, at in runs
    }


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
        yield f"table5.velocity.{velocity}", Ours(float(mission(corridor("fm", velocity)).defaults.speed or 0.0))
    driven: Any = mission(corridor("fm", "0.1")).segments[0]
    length = float(driven.distance)
    yield "sec341.d2", Ours(length)
    yield "sec341.fm_limit", Ours(max(errors["fm"]))
    yield "sec341.cm_limit", Ours(min(errors["cm"]))
    yield "sec341.qr2_error", Ours(float(np.mean(errors["qr2"])))
    markers = figures["sec341.qr_markers2"].value
    yield "sec341.qr_spacing_low", Ours(length / markers)
    yield "sec341.qr_spacing_high", Ours(length / markers)


def _patrol() -> Iterator[tuple[str, Ours]]:
    """Our values for the figures of section 3.4.2."""
    plan, driven = run(PLAN), run(DRIVEN)
    yield "sec24.length", Ours(plan.distance_m)
    yield "sec342.length", Ours(plan.distance_m, f"as driven {driven.distance_m:.1f} m")
    note = f"as driven; the plan takes {plan.duration_s / 60.0:.2f} min"
    yield "sec342.duration", Ours(driven.duration_s / 60.0, note)
    stops = [segment for segment in plan.segments if segment.kind == "inspect"]
    yield "valves", Ours(float(len(stops)))
    segments: Any = mission(PLAN).segments
    speeds = {float(s.speed) for s in segments if s.speed is not None}
    for speed in sorted(speeds):
        yield f"sec342.speed{speed:g}", Ours(speed)
    gaps = velocity_gaps()
    yield "sec342.gap.v1", Ours(gaps["V1_area"])
    yield "sec342.gap.turns", Ours(gaps["V2_area"])
    yield "sec342.gap.h2", Ours(gaps["H2_out"])
    for battery in ("robot", "laptop"):
        found = error_curve(battery)
        for suffix, relative in (("", "predicted"), (".measured", "measured")):
            for name, value in found.statistics(relative).items():
                yield f"sec342.{battery}.{name}{suffix}", Ours(value)


# section 3.4.2: the plan of the valve patrol against the robot as it drove
PLAN, DRIVEN = "pioneer3dx/valve_patrol", "pioneer3dx/valve_patrol_as_driven"
SAMPLE_S = 1.0


class ErrorCurve(NamedTuple):
    """Error of the planned energy over the mission as driven, at equal progress."""

    time_s: Array
    """Time of the run as driven, one sample a second. Shape (n,)."""
    predicted_wh: Array
    measured_wh: Array
    """Both: cumulative energy of the plan at the same place, and of the run as driven. Shape (n,)."""

    def percent(self, relative_to: str = "predicted") -> Array:
        """What the plan is short of, in % of the ``predicted`` or the ``measured`` energy."""
        return -error.error_curve(self.measured_wh, self.predicted_wh, relative_to, begins=0.0)  # as printed

    def statistics(self, relative_to: str = "predicted") -> dict[str, float]:
        """Peak, final value, mean and standard deviation over the samples, %."""
        found = error.error_statistics(self.percent(relative_to)).to_json()
        return {name.removesuffix("_pct"): value for name, value in found.items()}


def error_curve(battery: str) -> ErrorCurve:
    """The curve of one battery from two simulations. Both runs have the same segments and hold their speed within one,
    so equal progress is an equal share of a segment."""
    return curve(_of_segments(DRIVEN, "duration_s"), *(run(name).by_segment_wh(battery) for name in (PLAN, DRIVEN)))


def curve(driven_s: Array, plan_wh: Array, driven_wh: Array) -> ErrorCurve:
    """Error curve from durations as driven and energies of each segment, planned and as driven."""
    ends = np.concatenate([[0.0], np.cumsum(driven_s)])
    time = np.append(np.arange(SAMPLE_S, ends[-1], SAMPLE_S), ends[-1])
    predicted, measured = (
        np.interp(time, ends, np.concatenate([[0.0], np.cumsum(energy)])) for energy in (plan_wh, driven_wh)
    )
    return ErrorCurve(time, predicted, measured)


@functools.cache
def _of_segments(name: str, column: str) -> Array:
    """A column of the table of segments of a mission's run."""
    return np.array(segments_table(run(name))[column], dtype=float)


def velocity_gaps() -> dict[str, float]:
    """Velocity gap of each segment that moves, %: 1 − mean speed as driven / planned, from the simulated runs."""
    planned, driven = (_of_segments(name, "distance_m") / _of_segments(name, "duration_s") for name in (PLAN, DRIVEN))
    return {
        segment.name: float(100.0 * (1.0 - driven[index] / planned[index]))
        for index, segment in enumerate(run(PLAN).segments)
        if planned[index] > 0.0
    }


# what makes a robot's path longer and slower than planned, each with its spread (assumed)
DRIFT, DRIFT_SD = 0.15, 0.03
"""Sideways, per metre."""
SETTLE_M, SETTLE_SD_M = 1.0, 0.2
"""Length on which an offset or a heading settles."""
AMPLITUDE_M, AMPLITUDE_SD_M, WAVELENGTH_M = 0.12, 0.04, 3.0
"""Irregular walls that centring follows."""
HEADING_ERROR_RAD = 0.5
"""After a turn."""
TURNS = {"ER_out": 4, "V1_area": 5, "V2_area": 2, "ER_in": 4}
"""By segment of the patrol."""
GAP_SD = 0.02
"""Spread of the speed reached over the speed asked."""


def behaviour_draws(draws: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Path stretch and speed ratio of each segment of the patrol, drawn from their causes. Gives an array of shape
    (draws, segments): stretch (≥ 1) and speed over speed asked; 1 in the stops."""
    spec, names = mission(DRIVEN), [segment.name for segment in run(DRIVEN).segments]
    stretch = np.ones((draws, len(spec.segments)))
    ratio = np.ones_like(stretch)
    drift = np.abs(rng.normal(DRIFT, DRIFT_SD, draws))
    settle = np.clip(rng.normal(SETTLE_M, SETTLE_SD_M, draws), 0.2, None)
    amplitude = np.abs(rng.normal(AMPLITUDE_M, AMPLITUDE_SD_M, draws))
    lengths = _of_segments(PLAN, "distance_m")
    printed = load_figures("jaiem2021")
    spacing = printed["sec341.d2"].value / printed["sec341.qr_markers2"].value
    for index, segment in enumerate(spec.segments):
        if segment.kind != "drive":
            continue
        if spec.navigation_of(segment) == "qr_code":
            stretch[:, index] *= motion.relocalisation_stretch(spacing, drift=drift, settle_m=settle)
        if spec.scheme_of(segment) == "centring_motion":
            stretch[:, index] *= motion.centring_stretch(amplitude, WAVELENGTH_M)
        if turns := TURNS.get(names[index]):
            stretch[:, index] *= motion.settling_stretch(
                turns, lengths[index], heading_error_rad=HEADING_ERROR_RAD, settle_m=settle
            )
        asked = float((segment.behaviour and segment.behaviour.speed_tracking) or 1.0)
        ratio[:, index] = np.clip(rng.normal(asked, GAP_SD, draws), 0.3, 1.0)
    return stretch, ratio


def uncertain_statistics(draws: int, seed: int) -> dict[str, dict[str, Array]]:
    """The four error statistics of each battery for drawn behaviours, shape (draws,) each. Every draw is the patrol of
    the plan with other stretches and speeds; powers come from the robot's power model."""
    stretch, ratio = behaviour_draws(draws, np.random.default_rng(seed))
    plan = run(PLAN)
    model = build_power_model(mission(PLAN).robot)
    first = np.array([int(np.flatnonzero(plan.timeline.segment == i)[0]) for i in range(len(plan.segments))])
    cov = {name: column[first] for name, column in plan.timeline.columns.items()}
    driven = {**cov, "speed_m_s": np.asarray(cov["speed_m_s"]) * ratio}
    driven_s = _of_segments(PLAN, "duration_s") * stretch / ratio
    result: dict[str, dict[str, Array]] = {}
    for battery in plan.batteries:
        power = np.broadcast_to(np.asarray(model.total(driven, battery)), driven_s.shape)
        energy = power * driven_s / 3600.0
        rows = [curve(driven_s[i], plan.by_segment_wh(battery), energy[i]).statistics() for i in range(draws)]
        result[battery] = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return result
