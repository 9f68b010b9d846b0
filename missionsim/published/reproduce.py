"""Reproduce the papers: items and tables beside them, CSV files, one Markdown page, pictures."""

from __future__ import annotations

import csv
import importlib
import io
import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from missionsim.errors import InputError
from missionsim.files import write_text
from missionsim.inputs.power import build_power_model
from missionsim.physics import motion
from missionsim.published import figures as printed
from missionsim.published import hou2019, jaiem2021, parasuraman2012, rover2025

SCHEMA = "missionsim.reproduction/1"
Rows = list[dict[str, Any]]
Tables = dict[str, Rows]
"""Name → rows."""
COLUMNS = ("item", "where", "published", "ours", "unit", "difference", "tolerance", "rule", "status", "note", "key")


def papers_of(robots: Sequence[str]) -> list[str]:
    """Papers of the named robots (all if none); a paper's own name counts too. Raises InputError: for a name without a
    paper."""
    known = {**printed.PAPERS, **{paper: paper for paper in printed.PAPERS.values()}}
    for name in robots:
        if name not in known:
            raise InputError.unknown(f"no published robot '{name}'", name, known, allowed=", ".join(printed.PAPERS))
    return list(dict.fromkeys(known[name] for name in robots)) or list(printed.PAPERS.values())


def reproduce_paper(paper: str) -> list[printed.Item]:
    """Every figure of a paper beside ours."""
    module: Any = importlib.import_module(f"missionsim.published.{paper}")
    return printed.judge_all(paper, {**printed.numbers_of_robot(paper), **module.ours()})


def side_tables(paper: str) -> Tables:
    """Tables beside the figures of a paper, by name."""
    return {name: TABLES[name]() for name in printed.ABOUT[paper].tables}


def to_json(items: Iterable[printed.Item], tables: dict[str, Tables] | None = None) -> dict[str, object]:
    """The contract's JSON, and beside the items the other tables by paper."""
    return {"schema": SCHEMA, "items": [item.to_json() for item in items], "tables": tables or {}}


def number(value: float | None) -> str:
    """A number as the tables show it: six significant digits, so that it is the same on every machine."""
    if value is None:
        return ""
    text = f"{value:.6g}"
    return "0" if float(text) == 0.0 or abs(value) < 1e-12 else text


def _csv(rows: Rows) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({k: number(v) if isinstance(v, float) or v is None else v for k, v in row.items()})
    return text.getvalue()


def counts(items: Sequence[printed.Item]) -> str:
    """How many items have which status, in words."""
    found = Counter(item.status for item in items)
    return f"{len(items)} figures: " + ", ".join(
        f"{found[status]} {status}" for status in printed.STATUSES if found[status]
    )


def footnotes(items: Sequence[printed.Item]) -> tuple[list[str], list[str]]:
    """Notes of the items as references ([1], [2] …) and the list of distinct notes."""
    notes: dict[str, int] = {}
    references = []
    for item in items:
        references.append(str(notes.setdefault(item.note, len(notes) + 1)) if item.note else "")
    return references, list(notes)


def files(items: dict[str, list[printed.Item]], tables: dict[str, Tables]) -> dict[str, str]:
    """Every text file of ``results/published``, by name: CSV tables and the Markdown page."""
    result: dict[str, str] = {}
    for paper, found in items.items():
        items_rows = []
        for item in found:
            row = {**item.to_json(), "published": item.figure.printed}
            close = item.difference is not None and abs(item.difference) < 1e-9 * max(1.0, abs(item.figure.value))
            row["difference"] = 0.0 if close else item.difference
            items_rows.append({name: row[name] for name in COLUMNS})
        result[f"{paper}.csv"] = _csv(items_rows)
        result |= {f"{paper}_{name}.csv": _csv(rows) for name, rows in tables[paper].items()}
    result["README.md"] = page(items, tables)
    return result


def write(
    out: Path, items: dict[str, list[printed.Item]], tables: dict[str, Tables], pictures: bool = True
) -> list[Path]:
    """Write tables, page and pictures into a folder; each file whole or not at all. Gives what was written."""
    texts = files(items, tables)
    for name, text in texts.items():
        write_text(out / name, text)
    written = [out / name for name in texts]
    if pictures:
        from missionsim.published.pictures import draw

        for paper in items:
            written.extend(draw(paper, out))
    return written


def page(items: dict[str, list[printed.Item]], tables: dict[str, Tables]) -> str:
    """The page for some papers."""
    parts = [printed.HEAD]
    for paper, found in items.items():
        about = printed.ABOUT[paper]
        parts.append(f"## {about.robot}: {about.title}\n\n{about.reading}\n\n{counts(found)}.\n")
        parts += [f"![{title}]({paper}_{name}.png)\n*{title}*\n" for name, title in about.pictures.items()]
        for name, rows in tables[paper].items():
            parts.append(f"**{about.tables[name]}** ([CSV]({paper}_{name}.csv))\n")
            body = [[f"{v:.4g}" if isinstance(v, float) else str(v) for v in row.values()] for row in rows[:26]]
            parts.append(_table(list(rows[0]), body))
            if len(rows) > 26:
                parts.append(f"… and {len(rows) - 26} more rows in the CSV file.\n")
        references, notes = footnotes(found)
        body = [
            [f.item, f.where, f.printed, number(item.ours), f.unit, item.status, reference]
            for item, reference in zip(found, references, strict=True)
            for f in (item.figure,)
        ]
        parts.append(f"### Every figure of {paper} ([CSV]({paper}.csv))\n")
        parts.append(_table(["item", "where", "published", "ours", "unit", "status", "note"], body))
        parts.append("Notes\n")
        parts.append("\n".join(f"{i}. {note}" for i, note in enumerate(notes, start=1)) + "\n")
    return "\n".join(parts)


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


SEED, DRAWS = 20210426, 2000


def optimal_velocities() -> Rows:
    """Speed of least robot energy per metre for each set of sensors (Jaiem 2021, Eq. 11)."""
    robot = printed.shipped_robot("pioneer3dx")
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
    runs = jaiem2021.runs_of_table5(printed.load_figures("jaiem2021"))
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
    figures = printed.load_figures("jaiem2021")
    rows: Rows = []
    for battery in ("robot", "laptop"):
        curve = jaiem2021.error_curve(battery)
        for relative in ("predicted", "measured"):
            for name, value in curve.statistics(relative).items():
                row = {"battery": battery, "relative_to": relative, "statistic": name, "ours_pct": value}
                rows.append({**row, "published_pct": figures[f"sec342.{battery}.{name}"].value})
    return rows


def patrol_uncertainty() -> Rows:
    """The same statistics when the behaviour is drawn from its causes instead of calibrated."""
    drawn = jaiem2021.uncertain_statistics(DRAWS, SEED)
    figures = printed.load_figures("jaiem2021")
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
    found = parasuraman2012.static_powers(printed.load_figures("parasuraman2012"))
    names = ("static power without radio", "Bluetooth", "WiFi", "standing time per metre")
    units = ("W", "W", "W", "s/m")
    return [{"quantity": n, "value": v, "unit": u} for n, v, u in zip(names, found, units, strict=True)]


def model_errors() -> Rows:
    """Mecanum robot: errors of the paper's own model and of the robot file over the moving samples."""
    return [
        {"model": name, "table": table, "rmse_w": rmse, "mape_pct": mape, "max_pct": most}
        for name, found in hou2019.model_errors(printed.load_figures("hou2019")).items()
        for table, (rmse, mape, most) in found.items()
    ]


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
_MADE += [static_powers, components, model_errors, hou2019.identifiability, directions, rover2025.optima, fidelity]
TABLES: dict[str, Callable[[], Rows]] = {function.__name__: function for function in _MADE}
"""Name of a table → the function that makes it."""
