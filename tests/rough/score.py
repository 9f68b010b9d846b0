"""Real logs and rough worlds, with peers on the same runs: held-out errors of what `improve` writes, in one table.

``python -m tests.rough.score [--seeds a:b] [--halves a:b] [--only WORD ...] [--out FOLDER]``. Peers get the rows as
logged: least squares with the terms that the data are known to need (the car's, the Husky's and the Warthog's from
their README, a world's own), least squares stepwise with errors clustered by run, boosted trees on all columns.
`--halves`: the car's and the Husky's runs are also split anew at random, once with each of these seeds.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from missionsim.diagnose.improve import improve
from missionsim.diagnose.split import Split, choose_split
from missionsim.fit.calibrate import NewRobot, calibrate_new
from missionsim.identify.settings import Settings
from missionsim.importer.mapping import import_source
from missionsim.inputs.loading import load_map
from missionsim.labels import Labels
from missionsim.logs import read_logs
from missionsim.runs.error import Errors, RunError
from missionsim.runs.run import Run
from tests.rough.world import WORLDS, write

ROOT = Path(__file__).parents[2]
SHARED = ROOT.parent / "shared" / "data"
LEVEL = 0.01
MOST_TERMS = 8
Array = np.ndarray


@dataclass(frozen=True)
class Case:
    """Runs to fit, runs to predict, and the regressors that the truth (or the set's README) has."""

    name: str
    split: Split
    mass: str
    drive: str
    truth: tuple[str, ...]


def regressors(run: Run) -> dict[str, Array]:
    """Columns [W per coefficient] that a careful engineer would write down."""
    col = {n: np.asarray(x, dtype=float) for n, x in run.columns.items() if not isinstance(x, Labels)}
    v = np.abs(col["speed_m_s"])
    yaw = np.abs(col.get("yaw_rate_rad_s", 0.0 * v))
    moving = (v >= 0.005) | (yaw >= 0.02)
    found = {"moving": 1.0 * moving, "still": 1.0 * ~moving, "v": v, "v^2": v**2, "v^3": v**3}
    if "yaw_rate_rad_s" in col:
        found |= {"yaw": yaw, "yaw saturating": np.tanh(yaw / 0.9)}
    pull = col.get("accel_m_s2", np.gradient(v, run.time_s)) * v
    found |= {"speeding up": np.maximum(pull, 0.0), "braking": np.minimum(pull, 0.0)}
    if "slope_rad" in col:
        climb = v * np.sin(col["slope_rad"])
        found |= {"climbing": np.maximum(climb, 0.0), "descending": np.minimum(climb, 0.0), "climb": climb}
    for name, x in col.items():
        if name.startswith(("temp", "cpu", "memory", "wheel_temp", "heater", "heating", "aircon")):
            found |= {name: x, f"{name} v": x * v}
    floor = run.columns.get("surface")
    if isinstance(floor, Labels):
        for text in floor.names:
            on = floor.equals(text)
            found |= {f"{text} v": on * v, f"{text} yaw": on * yaw}
    return found


def halved(split: Split, seed: int) -> Split:
    """The same runs split in two at random, those of each floor for themselves."""
    draws = np.random.default_rng(seed)
    halves: tuple[list[int], list[int]] = ([], [])
    runs = [*split.train, *split.heldout]
    floors = ["".join(run.columns["surface"].names) if "surface" in run.columns else "" for run in runs]
    for floor in sorted(set(floors)):
        own = draws.permutation([i for i, name in enumerate(floors) if name == floor])
        middle = (len(own) + int(draws.integers(2))) // 2
        halves[0].extend(own[:middle])
        halves[1].extend(own[middle:])
    train, heldout = (tuple(runs[i] for i in sorted(half)) for half in halves)
    return Split(train, heldout, "a random half")


def cases(seeds: range, halves: range, only: list[str]) -> Iterator[Case]:
    """Real sets that are there, as they are split and anew, then each world with each seed."""
    speed = ("moving", "still", "v", "v^2")

    def wanted(name: str) -> bool:
        return not only or any(word in name for word in only)

    for name, mass, drive, truth in (
        ("i3_trips", "1270 kg", "ackermann", ("speeding up", "braking", "climb")),
        ("husky_floors", "50 kg", "skid_steer", ("floors", "turning by floor")),
    ):
        if (SHARED / name).is_dir() and wanted(name):
            split = choose_split(read_logs([SHARED / name / "train"]), [SHARED / name / "heldout"])
            yield Case(name, split, mass, drive, (*speed, *truth))
            for seed in halves:
                yield Case(f"{name}, half {seed}", halved(split, seed), mass, drive, (*speed, *truth))
    if (SHARED / "warthog_drive").is_dir():
        runs = import_source(SHARED / "warthog_drive", load_map(ROOT / "docs" / "maps" / "warthog.yaml"))
        truth = (*speed, "yaw saturating", "speeding up", "braking")
        for i, run in enumerate(runs):
            if wanted(name := f"warthog, {run.run} left out"):
                yield Case(name, Split((*runs[:i], *runs[i + 1 :]), (run,), "one drive"), "590 kg", "skid_steer", truth)
    car = ("speeding up", "braking", "climbing", "descending", "v^3")
    truths = {
        "recuperation": car,
        "heater": (*car, "heater_w"),
        "floors": ("floors", "yaw saturating"),
        "scrub": ("yaw saturating",),
        "cpu": ("cpu_load",),
        "wander": ("yaw saturating",),
    }
    for kind, world in WORLDS.items():
        for seed in seeds if wanted(kind) else ():
            with tempfile.TemporaryDirectory() as folder:
                train, heldout = write(kind, seed, Path(folder))
                split = choose_split(read_logs([train]), [heldout])
            yield Case(f"{kind} {seed}", split, f"{world.mass_kg} kg", world.drive, (*speed, *truths[kind]))


def predicted(case: Case, names: list[str]) -> tuple[float, float]:
    """Held-out power RMSE [W] and mean energy error of runs [%] of least squares on some regressors."""
    x, y, w, _ = rows(case.split.train, names)
    b = np.linalg.lstsq(x * np.sqrt(w)[:, None], y * np.sqrt(w), rcond=None)[0]
    return errors(case, [rows([run], names)[0] @ b for run in case.split.heldout])


def rows(runs: tuple[Run, ...] | list[Run], names: list[str]) -> tuple[Array, Array, Array, Array]:
    """Regressors, power, seconds and run number of all rows."""
    each = [regressors(run) for run in runs]
    x = np.vstack(
        [np.column_stack([own.get(n, np.zeros(run.rows)) for n in names]) for own, run in zip(each, runs, strict=True)]
    )
    run = np.repeat(np.arange(len(runs)), [one.rows for one in runs])
    y, w = (np.concatenate(parts) for parts in zip(*((one.power_w["robot"], one.dt_s) for one in runs), strict=True))
    good = np.isfinite(y) & np.isfinite(x).all(axis=1)
    return np.nan_to_num(x), np.where(good, y, 0.0), w * good, run


def errors(case: Case, powers: list[Array]) -> tuple[float, float]:
    """Power RMSE [W] and mean energy error of runs [%] of powers by row."""
    told = []
    for run, power in zip(case.split.heldout, powers, strict=True):
        seen = np.isfinite(run.power_w["robot"])
        told.append(RunError.of(run.run, run.power_w["robot"][seen], power[seen], run.dt_s[seen]))
    made = Errors(tuple(told))
    return made.power_rmse_w, made.run_energy_error_pct


def known(case: Case) -> list[str]:
    """The regressors of the truth, floors written out."""
    floors = sorted(
        {text for run in case.split.train if "surface" in run.columns for text in run.columns["surface"].names}
    )
    by_floor = {"floors": [f"{text} v" for text in floors], "turning by floor": [f"{text} yaw" for text in floors]}
    return [n for name in case.truth for n in by_floor.get(name, [name])]


def stepwise(case: Case) -> list[str]:
    """Forward selection: what lowers the squared error most enters while significant with errors clustered by run."""
    from scipy.stats import t as student

    every = sorted({name for run in case.split.train for name in regressors(run)})
    chosen = ["moving", "still", "v", "v^2"]
    x, y, w, run = rows(case.split.train, every)
    root = np.sqrt(w)[:, None]
    while len(chosen) < 4 + MOST_TERMS:
        best: tuple[float, str] | None = None
        for name in (n for n in every if n not in chosen):
            part = x[:, [every.index(n) for n in (*chosen, name)]] * root
            size = np.linalg.norm(part, axis=0)
            part = part / np.where(size > 0, size, 1.0)
            inverse = np.linalg.pinv(part.T @ part)
            b = inverse @ (part.T @ (y * root[:, 0]))
            left = y * root[:, 0] - part @ b
            scores = np.zeros((run.max() + 1, len(b)))
            np.add.at(scores, run, part * left[:, None])
            count = len(scores)
            sd = np.sqrt((inverse @ (scores.T @ scores) @ inverse)[-1, -1] * count / max(count - 1, 1))
            p = 2.0 * student.sf(abs(b[-1]) / max(sd, 1e-300), max(count - 1, 1))
            if p < LEVEL / len(every) and (best is None or left @ left < best[0]):
                best = (float(left @ left), name)
        if best is None:
            return chosen
        chosen.append(best[1])
    return chosen


def boosted_trees(case: Case) -> tuple[float, float]:
    """Gradient-boosted trees on every regressor."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    every = sorted({name for run in case.split.train for name in regressors(run)})
    x, y, w, _ = rows(case.split.train, every)
    model = HistGradientBoostingRegressor(max_iter=150, learning_rate=0.06, max_leaf_nodes=15, random_state=0)
    model.fit(x[w > 0], y[w > 0], sample_weight=w[w > 0])
    return errors(case, [model.predict(rows([run], every)[0]) for run in case.split.heldout])


PAIRS = ("before", "recalibrated", "missionsim", "least squares", "stepwise", "trees")
HEAD = ("case", "added", "said worse", "stepwise terms", *(f"{name} {unit}" for name in PAIRS for unit in ("W", "%")))


def row(case: Case) -> tuple[str, ...]:
    """One line of the table."""
    made = calibrate_new(NewRobot("own", "c2*v**2 + c3*v + c4", mass=case.mass, drive=case.drive), case.split.train)
    done = improve(made.text, case.split, "robot", Settings(), lambda finding, diagnosis: True)
    before, recalibrated, *_, after, _floor = done.steps if done.added else (*done.steps[:2], *done.steps[1:])
    terms = stepwise(case)
    numbers = [(s.power_rmse_w, s.energy_error_pct) for s in (before, recalibrated, after)]
    peers = [predicted(case, known(case)), predicted(case, terms), boosted_trees(case)]
    told = [f"{number:.3g}" for pair in (*numbers, *peers) for number in pair]
    worse = "yes" if done.worse else ""
    return (case.name, " ".join(done.added), worse, ", ".join(terms[4:]), *told)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="1:2", help="first:end")
    parser.add_argument("--halves", default="0:0", help="first:end of the seeds that split the real sets anew")
    parser.add_argument("--only", nargs="*", default=[], help="words of the cases")
    parser.add_argument("--out", type=Path, default=None, help="folder for rough.csv")
    given = parser.parse_args(arguments)
    seeds, halves = (range(*map(int, told.split(":"))) for told in (given.seeds, given.halves))
    lines = [HEAD]
    for case in cases(seeds, halves, given.only):
        lines.append(row(case))
        print("\n".join(f"{name:16} {value}" for name, value in zip(HEAD, lines[-1], strict=True)), "\n", flush=True)
    if given.out is not None:
        text = "\n".join(";".join(line) for line in lines) + "\n"
        given.out.mkdir(parents=True, exist_ok=True)
        (given.out / "rough.csv").write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
