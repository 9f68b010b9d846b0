"""Real motion, power made by known laws: ``python -m tests.rough.semi_real [--sets NAME ...] [--seeds a:b]``
``[--hidden TERM ...] [--train RUNS]``.

The motion of real logs has what made worlds lack: rows at uneven times, quantities that go together, noise of real
sensors. Power is a base, up to three hidden terms and a meter (lag, gain, noise), in NumPy alone. One line a case:
what was hidden, what `improve` adds, and errors on the held-out half before, after, and of least squares with the terms
that are there (which knows no lag).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from missionsim.diagnose.improve import improve
from missionsim.diagnose.split import choose_split
from missionsim.fit.calibrate import NewRobot, calibrate_new
from missionsim.identify.settings import Settings
from missionsim.importer.mapping import import_source
from missionsim.inputs.loading import load_map
from missionsim.labels import Labels
from missionsim.logs import read_logs
from missionsim.runs.error import Errors, RunError
from missionsim.runs.run import Run

ROOT = Path(__file__).parents[2]
SHARED = ROOT.parent / "shared" / "data"
Array = np.ndarray
SETS = {
    "warthog": ("590 kg", "skid_steer", 900.0),
    "husky": ("50 kg", "skid_steer", 150.0),
    "car": ("1270 kg", "ackermann", 6000.0),
}
"""Mass, drive and usual power [W] of the robots whose motion it is."""


@dataclass
class Drive:
    """One run: what is logged, hidden terms at coefficient 1 [W], true power as the meter shows it [W]."""

    name: str
    columns: dict[str, Array]
    terms: dict[str, list[Array]]
    power: Array


def motion(name: str) -> list[Run]:
    """Runs of a set."""
    if name == "warthog":
        return list(import_source(SHARED / "warthog_drive", load_map(ROOT / "docs" / "maps" / "warthog.yaml")))
    folder = SHARED / {"husky": "husky_floors", "car": "i3_trips"}[name]
    return list(read_logs([folder / "train", folder / "heldout"]))


def plain(run: Run) -> dict[str, Array]:
    """Columns of a run as arrays, texts as texts; nothing of its power."""
    held = {n: x.texts() if isinstance(x, Labels) else np.asarray(x, dtype=float) for n, x in run.columns.items()}
    wanted = ("speed_m_s", "accel_m_s2", "yaw_rate_rad_s", "slope_rad", "surface")
    return {"time_s": run.time_s, **{n: held[n] for n in wanted if n in held}}


def hidden(
    kind: str, columns: dict[str, Array], floors: Sequence[str], scale_w: float, rng: np.random.Generator
) -> list[Array]:
    """Parts of a hidden term at coefficient 1; what it needs logged is put into `columns`."""
    v, t = np.abs(columns["speed_m_s"]), columns["time_s"]
    yaw = np.abs(columns.get("yaw_rate_rad_s", 0.0 * v))
    if kind.startswith("inertia"):
        pull = columns["accel_m_s2"] * columns["speed_m_s"]
        return [np.maximum(pull, 0.0), *([np.minimum(pull, 0.0)] if kind == "inertia both ways" else [])]
    if kind == "grade":
        lift = v * np.sin(columns["slope_rad"])
        return [np.maximum(lift, 0.0), np.minimum(lift, 0.0)]
    if kind == "floor":
        return [v * (columns["surface"] == floor) for floor in floors]
    if kind == "payload":
        columns["payload_kg"] = np.full(len(v), float(rng.choice([0, 10, 20, 40])))
        return [v * columns["payload_kg"]]
    if kind == "cold":
        columns["temp_ambient_c"] = np.full(len(v), round(float(rng.normal(15.0, 8.0)), 1))
        return [v * np.maximum(25.0 - columns["temp_ambient_c"], 0.0)]
    if kind == "logged load":
        on = np.cumsum(rng.random(len(v)) < np.gradient(t) / 40.0) % 2
        columns["heater_w"] = np.round(on * 0.2 * scale_w * rng.uniform(0.8, 1.2, len(v)), 1)
        return [columns["heater_w"]]
    form: Mapping[str, Array] = {
        "scrub": yaw,
        "scrub that saturates": np.tanh(yaw / 0.7),
        "turning at speed": yaw * v,
        "cubic": v**3,
    }
    return [form[kind]]


def make(name: str, seed: int, asked: Sequence[str] = ()) -> tuple[list[Drive], list[str]]:
    """The drives of a case, and what is hidden in them with its share of the base's energy: `asked`, or drawn."""
    rng = np.random.default_rng([seed, list(SETS).index(name)])
    runs, scale = [(run.run, plain(run)) for run in motion(name)], SETS[name][2]
    every = set.intersection(*(set(columns) for _, columns in runs))
    speed = np.concatenate([np.abs(columns["speed_m_s"]) for _, columns in runs])
    usual = float(np.mean(speed[speed > 0.05 * speed.max()]))
    pool = ["cubic", "payload", "logged load", "cold"]
    # the slope of a speed that hardly changes is the noise of its encoder
    pool += ["inertia both ways", "inertia"] if "accel_m_s2" in every else []
    pool += ["scrub", "scrub that saturates", "turning at speed"] if "yaw_rate_rad_s" in every else []
    pool += [kind for kind, column in (("grade", "slope_rad"), ("floor", "surface")) if column in every]
    kinds = [
        str(k) for k in rng.choice(pool, size=int(rng.choice([0, 1, 2, 3], p=[0.15, 0.3, 0.35, 0.2])), replace=False)
    ]
    alike = [[k for k in kinds if k.startswith(word)] for word in ("inertia", "scrub")]
    kinds = [*asked] or [k for k in kinds if not any(k in same[1:] for same in alike)]
    b = scale * np.array([rng.uniform(0.03, 0.3), rng.uniform(0.3, 0.8) / usual, rng.uniform(0.0, 0.4) / usual**2])
    share = {kind: rng.uniform(0.08, 0.5) for kind in kinds}
    floors = sorted({str(text) for _, columns in runs for text in columns.get("surface", [])})
    drives = []
    for run, columns in runs:
        v = np.abs(columns["speed_m_s"])
        terms = {kind: hidden(kind, columns, floors, scale, rng) for kind in kinds}
        drives.append(Drive(run, columns, terms, b[0] + b[1] * v + b[2] * v**2))
    seconds = [np.gradient(one.columns["time_s"]) for one in drives]
    base_j = sum(float(one.power @ dt) for one, dt in zip(drives, seconds, strict=True))
    lag_s, gain = float(rng.choice([0.0, 0.0, 0.5, 1.0])), float(rng.choice([0.0, 0.01, 0.03]))
    slow, white, tau_s = rng.uniform(0.01, 0.08), rng.uniform(0.0, 0.05), rng.uniform(3.0, 60.0)
    for kind in kinds:
        parts = len(drives[0].terms[kind])
        size = rng.uniform(0.0, 2.0, parts) if kind == "floor" else np.append(1.0, rng.uniform(0.3, 0.9, parts - 1))
        whole = sum(
            float(s * np.abs(x) @ dt)
            for one, dt in zip(drives, seconds, strict=True)
            for s, x in zip(size, one.terms[kind], strict=True)
        )
        for one in drives:
            one.power = one.power + share[kind] * base_j / max(whole, 1e-9) * (size @ np.vstack(one.terms[kind]))
    for one in drives:
        t, level = one.columns["time_s"], float(np.mean(np.abs(one.power)))
        shown, drift = one.power.copy(), np.zeros(len(t))
        for i in range(1, len(t)):
            if lag_s > 0.0:
                shown[i] = shown[i - 1] + (1.0 - np.exp(-(t[i] - t[i - 1]) / lag_s)) * (one.power[i] - shown[i - 1])
            r = np.exp(-(t[i] - t[i - 1]) / tau_s)
            drift[i] = r * drift[i - 1] + np.sqrt(1.0 - r * r) * slow * level * rng.standard_normal()
        one.power = shown * (1.0 + gain * rng.standard_normal()) + drift + white * level * rng.standard_normal(len(t))
    return drives, [f"{kind} {share[kind]:.2f}" for kind in kinds]


def regressors(drive: Drive) -> Array:
    """Base and hidden terms, shape (rows, terms)."""
    v = np.abs(drive.columns["speed_m_s"])
    return np.column_stack([np.ones_like(v), v, v**2, *(x for parts in drive.terms.values() for x in parts)])


def least_squares(train: Sequence[Drive], heldout: Sequence[Drive]) -> tuple[float, float]:
    """Held-out power RMSE [W] and mean energy error [%] with the terms that are there."""
    x, y = np.vstack([regressors(one) for one in train]), np.concatenate([one.power for one in train])
    b = np.linalg.lstsq(x, y, rcond=None)[0]
    told = []
    for one in heldout:
        seconds = np.gradient(one.columns["time_s"])
        told.append(RunError.of(one.name, one.power, regressors(one) @ b, seconds))
    made = Errors(tuple(told))
    return made.power_rmse_w, made.run_energy_error_pct


def write(drives: Sequence[Drive], folder: Path) -> None:
    """Logs of some drives."""
    folder.mkdir()
    for one in drives:
        columns = {**one.columns, "power_robot_w": np.round(one.power, 3)}
        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        lines = [",".join(columns), *(",".join(map(str, row)) for row in rows)]
        (folder / f"{one.name}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def case(name: str, seed: int, asked: Sequence[str] = (), runs: int = 0) -> str:
    """One line of the table; so many `runs` are fitted, or half of them."""
    drives, kinds = make(name, seed, asked)
    order = np.random.default_rng(seed).permutation(len(drives))
    middle = runs or -(-len(drives) // 2)
    train, heldout = ([drives[i] for i in sorted(part)] for part in (order[:middle], order[middle:]))
    mass, drive, _ = SETS[name]
    with tempfile.TemporaryDirectory() as folder:
        write(train, Path(folder) / "train")
        write(heldout, Path(folder) / "heldout")
        split = choose_split(read_logs([Path(folder) / "train"]), [Path(folder) / "heldout"])
        made = calibrate_new(NewRobot("own", "c2*v**2 + c3*v + c4", mass=mass, drive=drive), split.train)
        done = improve(made.text, split, "robot", Settings(), lambda finding, diagnosis: True)
    before, after = done.steps[0], done.steps[-2] if done.added else done.steps[1]
    peer = least_squares(train, heldout)
    numbers = [(before.power_rmse_w, before.energy_error_pct), (after.power_rmse_w, after.energy_error_pct), peer]
    told = [name, str(seed), ", ".join(kinds) or "nothing", " ".join(done.added) or "-", "worse" if done.worse else ""]
    return " | ".join([*told, *(f"{w:.3g} W {e:.2g} %" for w, e in numbers), f"{after.power_rmse_w / peer[0]:.2f}"])


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", nargs="*", default=list(SETS), choices=list(SETS))
    parser.add_argument("--seeds", default="1:11", help="first:end")
    parser.add_argument("--hidden", nargs="*", default=[], help="terms that are hidden in every case")
    parser.add_argument("--train", type=int, default=0, help="runs that are fitted, half of them by default")
    given = parser.parse_args(arguments)
    print("set | seed | hidden | added | | before | after | least squares | ratio of the power errors")
    for name in given.sets:
        for seed in range(*map(int, given.seeds.split(":"))):
            print(case(name, seed, given.hidden, given.train), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
