"""Comparison of a robot's model with measured logs, from files to the result."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.compare.axes import LabelAxis
from missionsim.compare.behaviour import MissionGap, split_behaviour
from missionsim.compare.comparison import BatteryComparison, Comparison, RunComparison
from missionsim.compare.where import Accumulator, RunSums, Series, dependences
from missionsim.effects.model import PowerModel
from missionsim.effects.timeline import integrate
from missionsim.errors import Fault, InputError
from missionsim.files import PathLike
from missionsim.inputs import load_mission, load_robot
from missionsim.inputs.power import build_power_model
from missionsim.logs import find_logs, iter_blocks, read_logs
from missionsim.logs.raw import Remark, merge
from missionsim.logs.read import distinct_logs, same_content
from missionsim.numerals import meter_clock
from missionsim.physics import Array
from missionsim.runs.admit import admit, odd_runs
from missionsim.runs.drive import assume, drive_blocks
from missionsim.runs.error import Errors, cumulative_at, error_curve, error_statistics, progress_grid
from missionsim.runs.motion import still_of
from missionsim.runs.run import Run, coarser

if TYPE_CHECKING:
    from missionsim.engine.outcome import RunResult
    from missionsim.inputs.robot import RobotSpec


def mission_progress(series: Series, names: Sequence[str], mission: RunResult) -> Array:
    """Progress of a run along a plan at the end of each bucket, 0 to 1, shape (n,).

    Where the log names its segments, a segment takes the share of the progress that it has of the planned time, and
    progress within it runs with the time driven in it. Without them progress is the share of the run's time. `series`:
    the run; its ``segment`` column holds indices into `names`. `names`: segments as the logs name them: numbers counted
    from 0 as in the plan, or names. `mission`: simulated.
    """
    plan = mission.timeline
    if not names or not len(plan.segment):
        return series.progress
    number = {segment.name: i for i, segment in enumerate(mission.segments)}
    planned = {int(i) for i in plan.segment}
    table = np.array([number.get(name, _whole(name)) for name in names] + [-1])
    own = table[series.columns["segment"].astype(int)]
    if not set(own.tolist()) <= planned or np.any(np.diff(own) < 0):
        return series.progress
    seconds = series.columns["seconds"]
    share = {i: float(plan.duration_s[plan.segment == i].sum()) for i in sorted(planned)}
    total = sum(share.values())
    progress = np.zeros(len(own))
    done = 0.0
    for i, planned_s in share.items():
        rows = own == i
        if rows.any() and seconds[rows].sum() > 0.0:
            progress[rows] = done + planned_s * np.cumsum(seconds[rows]) / seconds[rows].sum()
        done += planned_s
    return np.asarray(np.maximum.accumulate(progress) / total)


def _whole(name: str) -> int:
    try:
        return int(float(name))
    except (ValueError, OverflowError):
        return -1


LARGE_FILE_BYTES = 32_000_000
"""Files from this size on are read in blocks, so that memory stays bounded."""
BLOCK_ROWS = 65_536
COMPARED = "unlike the others beside this model, and in the numbers, since every model is compared on the same runs"


def compare(
    model: PowerModel,
    logs: Iterable[Run | PathLike] | PathLike,
    *,
    robot: RobotSpec | None = None,
    mission: RunResult | None = None,
    by: Iterable[str] = (),
    on_run: Callable[[str], None] | None = None,
) -> Comparison:
    """Replay logs through a model and compare with what was measured.

    Parameters
    ----------
    logs : Runs, files or folders
        One run each; large files are read in blocks.
    robot : RobotSpec, optional
        Sharpens the checks of the logs and names the robot in the result.
    mission : RunResult, optional
        The simulated mission that every log is a run of.
    by : iterable of str
        Further log columns along which the error is looked at.
    on_run : callable, optional
        Called with the name of each run when it is done.

    Raises
    ------
    missionsim.errors.InputError
        Faults of the logs, or nothing to compare.
    """
    by = tuple(by)
    sums = Accumulator(by, still=None if mission is None else still_of(mission.timeline))
    notes: dict[Any, tuple[str, list[str]]] = {}
    sources: list[tuple[str, str]] = []
    items = [logs] if isinstance(logs, (str, os.PathLike)) else list(logs)
    refused: list[str] = []
    given = _runs(items, robot, refused)
    # runs that are handed over were admitted by whoever read them
    handed = [item for item in items if isinstance(item, Run)]
    admitted, left_out = admit([sample for _, sample, _ in given if not any(sample is run for run in handed)])
    kept = {id(run) for run in (*admitted, *handed)}
    for source, sample, blocks_of in given:
        if id(sample) not in kept:
            continue
        run, blocks = sample.run, blocks_of()
        first = next(blocks, None)
        if first is None:
            raise InputError.single("the log has no rows", file=source)
        for name in by:
            if name not in first.columns:
                raise InputError.unknown(f"the log has no column '{name}'", name, first.columns, file=first.source)
        replay = assume(model, first.columns, first.batteries, source=source or run)
        for note in replay.notes:
            notes.setdefault(note, (note, []))[1].append(run)
        remarks: list[Remark] = []
        for block in drive_blocks(replay, chain([first], blocks)):
            remarks = merge([*remarks, *block.run.remarks])
            sums.add(run, block)
        for remark in merge(remarks):
            # the numbers in a remark differ from run to run, the finding does not
            notes.setdefault((remark.kind, remark.column, remark.action), (str(remark), []))[1].append(run)
        sources.append((run, source))
        if on_run is not None:
            on_run(run)
    batteries = [name for name in model.batteries if any(name in run for run in sums.runs.values())]
    meters = [
        f"the model is shown as the meter of '{name}' shows it: {meter_clock(meter.delay_s, meter.lag_s)} (robot file)"
        for name, meter in model.meters.items()
        if name in batteries
    ]
    alike: dict[str, list[str]] = {}
    for name, why in odd_runs(admitted, model).items():
        alike.setdefault(why, []).append(name)
    odd = "; ".join(f"{', '.join(names)}: {why}" for why, names in alike.items())
    told = [f"{COMPARED}: {odd}"] if odd else []
    if mission is not None and not mission.feasible:
        meters.insert(0, f"the simulated mission is not feasible: {mission.reason}")
    for note, of in notes.values():
        everywhere = len(of) == len(sources) and note.startswith(("no column", "battery"))
        more = f" and {len(of) - 1} more" if len(of) > 1 else ""
        told.append(note if everywhere else f"{of[0]}{more}: {note}")
    return Comparison(
        getattr(robot, "name", ""),
        tuple(run for run, _ in sources),
        {name: _battery(name, sums, model, mission) for name in batteries},
        (*meters, *told),
        tuple(sources),
        sums.rows,
        "" if mission is None else mission.mission,
        (*left_out, *refused),
    )


def compare_files(
    robot: PathLike | RobotSpec,
    logs: Sequence[PathLike] | PathLike,
    *,
    mission: PathLike | None = None,
    by: Iterable[str] = (),
    on_run: Callable[[str], None] | None = None,
) -> Comparison:
    """Compare a robot (name, path or `RobotSpec`) with logs, and with a simulated mission if one is given.

    Parameters
    ----------
    mission : path-like, optional
        Mission file that every log is a run of; it is simulated with `robot`.
    by, on_run
        See `compare`.
    """
    logs = [logs] if isinstance(logs, (str, os.PathLike)) else list(logs)
    loaded: list[Any] = []
    faults: list[Fault] = []
    for load in (
        lambda: load_robot(robot) if isinstance(robot, (str, os.PathLike)) else robot,
        lambda: find_logs(logs),
        lambda: None if mission is None else load_mission(mission, robot=robot),
    ):
        try:
            loaded.append(load())
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(faults)
    spec, _, driven = loaded
    simulated = None
    if driven is not None:
        from missionsim.engine.simulate import simulate

        simulated = simulate(driven)
    return compare(build_power_model(spec), logs, robot=spec, mission=simulated, by=by, on_run=on_run)


def _runs(
    logs: Sequence[Run | PathLike], robot: Any, refused: list[str]
) -> list[tuple[str, Run, Callable[[], Iterator[Run]]]]:
    """Source of each run, the run or the start of a long one, and its blocks; faults of small files all at once."""
    paths = [item for item in logs if not isinstance(item, Run)]
    tables = [item for item in logs if isinstance(item, Run)]
    files = distinct_logs(paths) if paths or not logs else {}
    large = [path for path in files if path.stat().st_size >= LARGE_FILE_BYTES]
    small = [file for path, twins in files.items() if path not in large for file in (path, *twins)]
    read = [*tables, *(read_logs(small, robot=robot, left_out=refused) if small else [])]
    found: list[tuple[str, Run, Callable[[], Iterator[Run]]]] = [(t.source, t, partial(iter, [t])) for t in read]
    for path in large:
        twins = files[path]

        def blocks(path: Path = path, twins: Sequence[Path] = twins) -> Iterator[Run]:
            told = (same_content(twins),) if twins else ()
            for block in _ahead(iter_blocks(path, rows=BLOCK_ROWS, robot=robot)):
                yield replace(block, remarks=(*block.remarks, *told)) if told else block

        found.append((str(path), coarser(next(iter_blocks(path, rows=BLOCK_ROWS, robot=robot))), blocks))
    return found


def _ahead(blocks: Iterator[Run]) -> Iterator[Run]:
    """The same blocks; the next one is read and checked in a thread while this one is compared."""
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(1) as reader:
        coming = reader.submit(next, blocks, None)
        while (block := coming.result()) is not None:
            coming = reader.submit(next, blocks, None)
            yield block


def _battery(battery: str, sums: Accumulator, model: PowerModel, mission: RunResult | None) -> BatteryComparison:
    found = {run: of[battery] for run, of in sums.runs.items() if battery in of}
    grid = progress_grid()
    every = [
        [cumulative_at(one.series.progress, one.series.columns[name], grid) for one in found.values()]
        for name in ("measured_j", "model_j")
    ]
    measured, predicted = (np.sum(curves, axis=0) for curves in every)
    curve = error_curve(measured, predicted)
    return BatteryComparison(
        **vars(Errors(tuple(one.error for one in found.values())).total),
        battery=battery,
        runs=tuple(
            RunComparison(
                **vars(one.error),
                battery=battery,
                error_statistics=error_statistics(own),
                progress=grid,
                error_curve_pct=own,
                series=one.series,
                by_term_wh={key: joules / 3600.0 for key, joules in one.terms.items()},
            )
            for one, own in zip(found.values(), map(error_curve, *every), strict=True)
        ),
        error_statistics=error_statistics(curve),
        error_statistics_predicted=error_statistics(error_curve(measured, predicted, "predicted")),
        progress=grid,
        error_curve_pct=curve,
        dependences=tuple(dependences(sums, battery)),
        places=tuple(sums.places.cells(battery)),
        mission=None if mission is None else _mission(battery, sums, model, mission, found),
    )


def _mission(
    battery: str, sums: Accumulator, model: PowerModel, mission: RunResult, found: dict[str, RunSums]
) -> MissionGap:
    driven, plan = [sums.motion[run] for run in found], mission.timeline
    schemes = split_behaviour(model, plan, driven, battery)
    simulated = sum(integrate(model, plan)[battery].values(), start=np.zeros(len(plan)))
    grid, axis = progress_grid(), sums.axes.get("segment")
    names = axis.names if isinstance(axis, LabelAxis) else ()
    spent = np.cumsum(plan.duration_s)
    measured, predicted = np.zeros(len(grid)), np.zeros(len(grid))
    for one in found.values():
        own = one.series.progress
        progress = np.interp(grid, own, mission_progress(one.series, names, mission))
        measured += cumulative_at(own, one.series.columns["measured_j"], grid)
        predicted += cumulative_at(spent / spent[-1], simulated, progress)
    replayed = sum(one.error.model_j for one in found.values())
    total = len(found) * float(simulated.sum())
    return MissionGap(
        battery,
        len(found),
        total / 3600.0,
        (replayed - total) / 3600.0,
        schemes,
        error_statistics(error_curve(measured, predicted)),
        error_statistics(error_curve(measured, predicted, "predicted")),
    )
