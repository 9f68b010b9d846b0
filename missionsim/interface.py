"""The commands as Python functions of the same names: ``missionsim.whatif``, ``missionsim.diagnose`` and so on.

Each gives an `Answer`: the command's result (`Answer.value`, whose attributes the answer has too), as a table
(`to_frame`), a picture (`plot`), JSON (`to_json`), and short in a notebook.
"""

from __future__ import annotations

import functools
import html
import inspect
import os
import tempfile
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, ParamSpec, TypeVar

from missionsim.files import Json, PathLike, fields_of, write_text
from missionsim.identify.settings import ALPHA, Settings
from missionsim.numerals import counted, in_wh, rounded, watts

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from missionsim.compare.comparison import Comparison
    from missionsim.diagnose.adopt import Adopted
    from missionsim.diagnose.improve import Improved
    from missionsim.diagnose.split import Split
    from missionsim.engine.outcome import RunResult
    from missionsim.exchange.site import Site, SiteOptions
    from missionsim.fit.calibrate import Calibration
    from missionsim.identify.findings import Diagnosis
    from missionsim.planner.answer import Answer as PlanAnswer
    from missionsim.results.whatif import WhatIf
    from missionsim.runs.run import Run

T = TypeVar("T")
P = ParamSpec("P")
Logs = PathLike | Sequence[PathLike]
Values = Mapping[str, object]
_ROWS = 20


def _in_one_thread(command: Callable[P, T]) -> Callable[P, T]:
    """Its linear algebra in one thread, as on the command line: the matrices are small, so that threads cost many times
    what they give, and sums repeat to the last bit."""

    @functools.wraps(command)
    def alone(*arguments: P.args, **options: P.kwargs) -> T:
        import scipy.linalg  # noqa: F401 (has a library of its own; one that is loaded later has threads again)
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1, user_api="blas"):
            return command(*arguments, **options)

    return alone


@dataclass(frozen=True, repr=False)
class Answer(Generic[T]):
    """What a command found."""

    value: T
    """The result itself; its attributes are the answer's, too."""
    line: str
    """It in one line."""
    _rows: Callable[[], Any] = field(compare=False)
    _json: Callable[[], Json] = field(compare=False)
    _drawn: tuple[str, ...] = ("", "")
    text: str = ""
    """A robot or mission file that came of it; empty where none did. `save` writes it."""

    def to_frame(self) -> pd.DataFrame:
        """As a table."""
        import pandas as pd

        return pd.DataFrame(self._rows())

    def to_json(self) -> Json:
        """As the command's ``--json`` has it."""
        return self._json()

    def plot(self) -> Figure:
        """A picture of the table: bars, or steps over time where it has a column ``time_s``."""
        import matplotlib.pyplot as plt

        frame, (label, *columns) = self.to_frame(), self._drawn
        figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
        if "term" in frame:
            frame = frame[frame["term"] == "total"]
            frame[label] = frame[label] + ", " + frame["battery"]
        for name in columns if label in ("start_s", "") else ():
            if label:
                axes.step(frame[label], frame[name].to_numpy(float), where="post", label=name)
            else:
                axes.hist(frame[name].to_numpy(float), bins=40, alpha=0.6, label=name)
            axes.legend()
        if label not in ("start_s", ""):
            axes.barh(range(len(frame)), frame[columns[0]].to_numpy(float))
            axes.set_yticks(range(len(frame)), frame[label].astype(str).tolist())
            axes.invert_yaxis()
        axes.set_xlabel("time in s" if label == "start_s" else columns[0] if label else "energy in Wh")
        axes.set_ylabel({"start_s": "power in W", "": "runs"}.get(label, ""))
        axes.set_title(self.line, fontsize="medium", loc="left")
        return figure

    def save(self, path: PathLike) -> Path:
        """Write the robot or mission file that came of it.

        Raises
        ------
        ValueError
            Nothing came of it that could be written.
        """
        from missionsim.inputs.edit import for_folder

        if not self.text:
            raise ValueError("this answer has no file to write")
        is_robot = "kind: robot" in self.text
        write_text(path, for_folder(self.text, Path(path).parent) if is_robot else self.text)
        return Path(path)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "value":
            raise AttributeError(name)
        return getattr(self.value, name)

    def __repr__(self) -> str:
        return f"<{type(self.value).__name__}: {self.line}>"

    def _repr_html_(self) -> str:
        frame = self.to_frame()
        more = f"<p>… {len(frame)} rows in all</p>" if len(frame) > _ROWS else ""
        return f"<p><b>{html.escape(self.line)}</b></p>{frame.head(_ROWS).to_html(index=False)}{more}"


def run(mission: PathLike, *, set: Values | None = None, robot: PathLike | None = None) -> Answer[RunResult]:
    """Simulate one mission file; see ``missionsim run``.

    Parameters
    ----------
    set : mapping
        Path → value, such as ``{"defaults.speed": "0.5 m/s"}``.
    robot : str or path-like, optional
        In place of the mission's own.
    """
    from missionsim.engine.simulate import simulate
    from missionsim.inputs.loading import load_mission
    from missionsim.results.write import tables

    result = simulate(load_mission(mission, _pairs(set), robot))
    used = ", ".join(f"{name} {in_wh(b.energy_wh)} Wh" for name, b in result.batteries.items())
    verdict = "feasible" if result.feasible else f"not feasible: {result.reason}"
    line = f"{result.mission} with {result.robot}, {result.duration_s:.0f} s, {used}, {verdict}"
    drawn = ("start_s", *(f"power_{name}_w" for name in result.batteries))
    return Answer(result, line, lambda: tables(result)["intervals"], result.summary, drawn)


def whatif(
    mission: PathLike,
    vary: Mapping[str, Sequence[object]],
    *,
    set: Values | None = None,
    robot: PathLike | None = None,
    workers: int = 1,
) -> Answer[WhatIf]:
    """Run alternatives of a mission; see ``missionsim whatif``.

    Parameters
    ----------
    vary : mapping
        Path → values; several paths give all combinations.
    """
    from missionsim.results.whatif import BASELINE, Alternative, run_alternatives, varied

    base, other = _pairs(set), None if robot is None else str(robot)
    pairs = [(path, [str(value) for value in values]) for path, values in vary.items()]
    alternatives = [Alternative(BASELINE, base, other), *varied(pairs, base, other)]
    found = run_alternatives(mission, alternatives, workers=workers)
    line = f"{found.mission}: {len(found.results)} alternatives, {sum(r.feasible for r in found.runs)} feasible"
    return Answer(found, line, found.table, found.to_json, ("alternative", "energy_wh"))


def monte_carlo(
    mission: PathLike,
    runs: int = 1000,
    seed: int = 0,
    *,
    set: Values | None = None,
    robot: PathLike | None = None,
    workers: int = 1,
    engine: str = "auto",
    sobol: int | None = None,
) -> Answer[Mapping[str, object]]:
    """Draw the uncertain values many times; see ``missionsim montecarlo``. The table has one row a run."""
    from missionsim.uncertainty.batch import Task, answer_batch
    from missionsim.uncertainty.store import BlockStore

    task = Task(str(mission), _pairs(set), None if robot is None else str(robot), seed, engine)
    with tempfile.TemporaryDirectory(prefix="missionsim-", ignore_cleanup_errors=True) as folder:
        store = BlockStore(Path(folder) / "batch")
        answer, firsts = answer_batch(task, runs, store, workers=workers, sobol=sobol)
        columns = {n: c for n in store.names() if (c := store.column(n, firsts)).ndim == 1}
    p = answer["p_feasible"]
    share = f"{p['value']:.3g} ({p['low']:.3g} to {p['high']:.3g})"
    line = f"{answer['mission']}: {answer['runs']} runs, feasible with probability {share}"
    drawn = ("", *(f"energy_{name}_wh" for name in answer["batteries"]))
    return Answer(answer, line, lambda: columns, lambda: answer, drawn)


def compare(
    robot: PathLike, logs: Logs, *, mission: PathLike | None = None, by: Sequence[str] = ()
) -> Answer[Comparison]:
    """Model against measurements; see ``missionsim compare``."""
    from missionsim.compare.core import compare_files

    found = compare_files(robot, logs, mission=mission, by=by)
    _warn(found.left_out)
    told = [f"{name} {b.energy_error_pct:+.2f} %, {watts(b.power_rmse_w)}" for name, b in found.batteries.items()]
    rows = [{"battery": name, **run.to_json()} for name, b in found.batteries.items() for run in b.runs]
    line = f"{found.robot}: error {'; '.join(told)}"
    return Answer(found, line, lambda: rows, found.to_json, ("run", "energy_error_pct"))


@_in_one_thread
def diagnose(
    robot: PathLike,
    logs: Logs,
    *,
    holdout: str | Sequence[str | Path] | None = None,
    mission: PathLike | None = None,
    battery: str | None = None,
    alpha: float = ALPHA,
    align: bool = True,
) -> Answer[Diagnosis]:
    """Find which physical effect is missing; see ``missionsim diagnose``.

    `alpha` is the family-wise rate of false alarms; `align` finds the delay of the meter.
    """
    from missionsim.diagnose.diagnosis import diagnose_files

    settings = Settings(alpha=alpha, align=align)
    path = None if mission is None else Path(mission)
    found = diagnose_files(str(robot), _paths(logs), holdout=holdout, mission=path, battery=battery, settings=settings)
    _warn(found.left_out)
    data = found.to_json()["batteries"]
    told = [f"{n}: {b['verdict']} {' '.join(e['effect'] for e in b['effects'])}".strip() for n, b in data.items()]
    keys = ("effect", "energy_share", "p_value", "heldout_rmse_before_w", "heldout_rmse_after_w")
    rows = [{"battery": n, **{k: e.get(k) for k in keys}} for n, b in data.items() for e in b["effects"]]
    return Answer(found, "; ".join(told), lambda: rows, found.to_json, ("effect", "energy_share"))


@_in_one_thread
def add_effect(
    robot: PathLike, effect: str, logs: Logs, *, battery: str, holdout: str = "none", force: bool = False
) -> Answer[Adopted]:
    """Fit an effect and get the robot file that has it (`Answer.save`); see ``missionsim add-effect``.

    Raises
    ------
    missionsim.diagnose.adopt.NotSignificant
        The logs do not support it, and `force` is not set.
    """
    from missionsim.diagnose.adopt import adopt
    from missionsim.inputs.edit import robot_text

    split = _split(robot, logs, holdout)
    made = adopt(robot_text(robot), split, effect, battery, Settings(), force=force)
    parameters = {name: estimate.to_json() for name, estimate in made.effect.parameters.items()}
    told = ", ".join(f"{name} = {p['value']:.4g}" for name, p in parameters.items())
    rows = [{"parameter": name, **p} for name, p in parameters.items()]
    line, data = f"{effect} on {battery}: {told}", made.to_json() | {"battery": battery}
    return Answer(made, line, lambda: rows, lambda: data, ("parameter", "value"), made.text)


@_in_one_thread
def improve(
    robot: PathLike, logs: Logs, *, battery: str, holdout: str | Sequence[str | Path] | None = None
) -> Answer[Improved]:
    """Compare, diagnose, add, until nothing is left to find, for one battery; see ``missionsim improve --yes``."""
    from missionsim.diagnose.improve import improve as run_improve
    from missionsim.inputs.edit import robot_text

    split = _split(robot, logs, holdout)
    done = run_improve(robot_text(robot), split, battery, Settings(), lambda finding, diagnosis: True)
    steps = [fields_of(s, "step=name power_rmse_w energy_error_pct") for s in done.steps]
    line = f"{battery}: added {done.told}; {done.stopped}"
    data = {"schema": "missionsim.improvement/1", "holdout": split.how, "batteries": {battery: done.to_json()}}
    return Answer(done, line, lambda: steps, lambda: data, ("step", "power_rmse_w"), done.text)


@_in_one_thread
def calibrate(robot: PathLike, logs: Logs, *, battery: str | None = None) -> Answer[Calibration]:
    """Refit a robot's parameters; see ``missionsim calibrate --robot``."""
    from missionsim.fit.files import calibration_json, refit_files

    done = refit_files(str(robot), _paths(logs), battery, tell=_warn)
    keys = "name value sd before unit"
    rows = [{"battery": f.battery, **fields_of(p, keys)} for f in done.fits for p in f.parameters.values()]
    line = "; ".join(
        f"{f.battery}: {rounded(f.before.power_rmse_w)} to {watts(f.after.power_rmse_w)}" for f in done.fits
    )
    return Answer(done, line, lambda: rows, lambda: calibration_json(done), ("name", "value"), done.text)


def plan(task: PathLike, *, set: Values | None = None, robot: PathLike | None = None) -> Answer[PlanAnswer]:
    """Plan a task: order, way, speed, scheme, charging; see ``missionsim plan``. `Answer.save` writes the mission."""
    from missionsim.inputs.loading import load_task
    from missionsim.planner.answer import mission_text
    from missionsim.planner.chance import plan_task

    found, _ = plan_task(load_task(task, _pairs(set), None if robot is None else str(robot)))
    data = found.summary()
    text = mission_text(found, Path.cwd() / "plan.yaml") if found.feasible else ""
    line = f"{Path(task).stem}: " + ("planned, " + " - ".join(found.order()) if found.feasible else "no plan")
    rows = []  # one column a battery, and the sum of them
    for leg in data.get("legs", []):
        parts = {f"energy_{name}_wh": wh for name, wh in leg["energy_wh"].items()}
        rows.append({**leg, "energy_wh": sum(parts.values()), **parts})
    return Answer(found, line, lambda: rows, lambda: data, ("to", "energy_wh"), text)


def import_log(source: Logs, map: PathLike) -> list[Run]:
    """Turn a bag, MCAP, ULog or table of any layout into runs, by a map; see ``missionsim import``."""
    from missionsim.importer.mapping import import_source
    from missionsim.inputs.loading import load_map

    return import_source(_paths(source), load_map(map))


def import_site(path: PathLike, options: SiteOptions | None = None) -> Answer[Site]:
    """Read a map, route graph, track or order of another tool; see ``missionsim import-site``."""
    from missionsim.exchange.formats import import_site as read

    site = read(Path(path), options)
    parts = (site.places, "place"), (site.edges, "way"), (site.chargers, "charger")
    line = f"{site.format}: {', '.join(counted(len(given), what) for given, what in parts)}"

    def rows() -> list[dict[str, Any]]:
        return [{**e, "length": e.get("length") or site.straight(e["from"], e["to"])} for e in site.edges]

    return Answer(site, line, rows, site.summary, ("to", "length"), site.environment_text())


def _warn(left_out: Sequence[str]) -> None:
    """Tell of runs that were left out, as the commands do, at the user's line."""
    level, frame = 1, inspect.currentframe()
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "missionsim":
        level, frame = level + 1, frame.f_back
    for line in left_out:
        warnings.warn(f"left out {line}", stacklevel=level)


def _split(robot: PathLike, logs: Logs, holdout: str | Sequence[str | Path] | None) -> Split:
    from missionsim.diagnose.split import read_split
    from missionsim.inputs.loading import load_robot

    split = read_split(load_robot(robot), _paths(logs), holdout)
    _warn(split.left_out)
    return split


def _pairs(values: Values | None) -> tuple[tuple[str, str], ...]:
    return tuple((path, str(value)) for path, value in (values or {}).items())


def _paths(paths: Logs) -> list[str | Path]:
    return [Path(path) for path in ([paths] if isinstance(paths, (str, os.PathLike)) else paths)]
