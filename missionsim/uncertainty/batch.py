"""A batch of runs: blocks over processes, resumable, the same bits for any number of workers; and batches compared."""

from __future__ import annotations

import functools
import hashlib
import itertools
import math
import os
import platform
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED as FIRST
from concurrent.futures import CancelledError, Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

import missionsim
from missionsim import __version__
from missionsim.errors import InputError
from missionsim.files import Json, sha256, to_json, write_text
from missionsim.inputs.loading import Override, load_mission
from missionsim.inputs.mission import MissionSpec
from missionsim.inputs.power import build_power_model
from missionsim.physics import Array, Int64s
from missionsim.plan.build import make_plan
from missionsim.uncertainty.answers import LEVEL, affordable_samples, proportion_interval, sobol_importance, summarise
from missionsim.uncertainty.arrays import ArrayMission, compile_arrays
from missionsim.uncertainty.draws import (
    Draws,
    Sampler,
    left_to_chance,
    make_sampler,
    run_generator,
    simulate_block,
    unread_values,
)
from missionsim.uncertainty.store import BlockStore
from missionsim.workers import interrupts_held, process_pool

T = TypeVar("T")
BLOCK_RUNS = {"simpy": 50, "arrays": 8192}
"""Runs in a block, at most; the mission alone decides, so that tables do not depend on the number of workers."""
BLOCK_NUMBERS = {"simpy": 200_000, "arrays": 8_000_000}
"""Runs × (intervals and uncertain values) in a block, at most: memory does not grow with a mission's length."""
MOST_RUNS, MOST_WORKERS = 10**9, 1024
MOST_LOST = 3
"""So often a lost worker process is replaced."""


@dataclass(frozen=True)
class Task:
    """What a worker needs to know; everything else it loads itself, once."""

    mission: str
    overrides: tuple[Override, ...] = field(hash=False)
    """A study may set mappings, which have no hash."""
    robot: str | None
    seed: int
    engine: str


@dataclass(frozen=True)
class Prepared:
    """A mission ready for many runs."""

    mission: MissionSpec
    model: Any
    sampler: Sampler
    arrays: ArrayMission | None
    why_not_arrays: str
    intervals: int
    files: tuple[tuple[str, int, int], ...] = ()
    """What it was read from, each as `_state_of` had it."""

    @property
    def engine(self) -> str:
        """``arrays`` where the mission allows them, else ``simpy``."""
        return "simpy" if self.arrays is None else "arrays"

    def block(
        self, seed: int, first: int, count: int, draws: Draws | None = None, runs: Int64s | None = None
    ) -> dict[str, NDArray[np.generic]]:
        """Columns of the runs ``first … first + count − 1``, or of others at their draws."""
        if self.arrays is not None:
            return self.arrays.block(seed, first, count, draws, runs)
        return simulate_block(self.mission, self.model, self.sampler, seed, first, count, draws, runs)


def block_runs(prepared: Prepared) -> int:
    """Runs in a block of a batch."""
    width = prepared.intervals + len(prepared.sampler.values)
    return max(1, min(BLOCK_RUNS[prepared.engine], BLOCK_NUMBERS[prepared.engine] // max(1, width)))


def blocks_of(prepared: Prepared, runs: int) -> dict[int, int]:
    """First run of each block of a batch, in order, and its number of runs."""
    size = block_runs(prepared)
    return {first: min(size, runs - first) for first in range(0, runs, size)}


def prepare(task: Task) -> Prepared:
    """Load what a task needs; a worker keeps it for all its blocks, until a file is another. Raises InputError: where
    files have faults, the nominal mission cannot be planned, or `arrays` is asked but impossible."""
    made = _prepared(task)
    if made.files != tuple(_state_of(path) for path, *_ in made.files):
        _prepared.cache_clear()
        made = _prepared(task)
    return made


def _state_of(path: str) -> tuple[str, int, int]:
    """A file with its time and size; zero where it is gone."""
    try:
        found = os.stat(path)
    except OSError:
        return path, 0, 0
    return path, found.st_mtime_ns, found.st_size


@functools.lru_cache(maxsize=4)
def _prepared(task: Task) -> Prepared:
    read = _state_of(task.mission)
    mission = load_mission(task.mission, overrides=task.overrides, robot=task.robot)
    paths = [str(part.path) for part in (mission.robot, mission.environment) if part is not None and part.path]
    files = (read, *(_state_of(path) for path in paths))
    model = build_power_model(mission.robot)
    sampler = make_sampler(mission)
    plan = make_plan(mission, rng=run_generator(0, "chance", 0))  # what no run could do is told once, where it stands
    intervals = sum(len(step.phases) for step in plan.steps)
    compiled = compile_arrays(mission, model, sampler) if task.engine != "simpy" else "SimPy was asked for"
    arrays, why = (None, compiled) if isinstance(compiled, str) else (compiled, "")
    if why and task.engine == "arrays":
        told, other = "this mission cannot be evaluated as arrays", "--engine simpy, or auto"
        raise InputError.single(told, file=task.mission, got=why, allowed=other)
    return Prepared(mission, model, sampler, arrays, why, intervals, files)


def compute_block(task: Task, first: int, count: int) -> dict[str, NDArray[np.generic]]:
    """Columns of the runs ``first … first + count − 1``; pure, so that any process may compute it."""
    return prepare(task).block(task.seed, first, count)


def identity(task: Task, runs: int) -> Json:
    """What makes a batch this batch: a resumed one must agree in all of it."""
    prepared = prepare(task)
    files = {"mission": sha256(task.mission)}
    for name, part in (("robot", prepared.mission.robot), ("environment", prepared.mission.environment)):
        path = getattr(part, "path", None)
        if path:
            files[name] = sha256(path)
    return {
        "missionsim": __version__,
        "code": _code(),
        "python": platform.python_version(),
        # another version may draw other numbers
        "numpy": np.__version__,
        "engine": prepared.engine,
        "seed": task.seed,
        "runs": runs,
        "block_runs": block_runs(prepared),
        "overrides": [list(pair) for pair in task.overrides],
        "files": files,
        # what is drawn from may lie in further files
        "distributions": hashlib.sha256(repr(prepared.sampler.values).encode()).hexdigest(),
    }


@functools.cache
def _code() -> str:
    """Hash of the package's sources: a version under development changes without its number."""
    folder, found = Path(missionsim.__file__).parent, hashlib.sha256()
    for path in sorted([*folder.rglob("*.py"), *folder.rglob("*.yaml")]):
        found.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return found.hexdigest()


def answer_batch(
    task: Task,
    runs: int,
    store: BlockStore,
    *,
    resume: bool = False,
    workers: int = 1,
    executor: Executor | None = None,
    until: float | None = None,
    sobol: int | None = None,
    advance: Callable[[int], None] = lambda runs: None,
    on_damaged: Callable[[list[int]], None] = lambda firsts: None,
) -> tuple[Json, list[int]]:
    """Begin a batch in a folder, or `resume` it, compute what is missing, and say all of it (also in ``summary.json``).

    `workers`: processes on this machine. `executor`: where to compute instead (a cluster's client). `until`: stop when
    the 95 % interval of the probability of success is at most this wide. `advance`: told the number of runs of each
    block that is done; `on_damaged`: the first runs of blocks that are computed again. Gives the answer, and the first
    runs of the blocks that count, in order.
    """
    prepared = prepare(task)
    with store.locked():
        store.begin(identity(task, runs), resume=resume)
        if resume:
            on_damaged(store.drop_damaged(blocks_of(prepared, runs)))
        firsts: list[int] = []
        good = total = 0
        # judged block by block in the order of runs, so that the answer does not depend on who computed what first
        for first, count in _finished(task, runs, store, workers, executor):
            advance(count)
            firsts.append(first)
            if until is not None:
                good, total = good + int(store.column("feasible", [first]).sum()), total + count
                low, high = proportion_interval(good, total)
                if high - low <= until:
                    break
        answer: Json = {
            "schema": "missionsim.montecarlo/1",
            "mission": prepared.mission.name,
            "robot": prepared.mission.robot.name,
            "seed": task.seed,
            "engine": prepared.engine,
            "why_not_arrays": prepared.why_not_arrays,
            "unread": list(unread_values(prepared.mission, prepared.model, prepared.sampler)),
            "chance": [name.removeprefix("chance.") for name in left_to_chance(prepared.mission)],
            **summarise(store, firsts, tuple(prepared.mission.robot.batteries)),
        }
        sobol = affordable_samples(prepared, task.seed) if sobol is None else sobol
        if sobol:
            answer["importance"] = sobol_importance(prepared, task.seed, sobol, answer["importance"])
        answer["sobol_samples"] = sobol
        write_text(store.folder / "summary.json", to_json(answer))
    return answer, firsts


def _finished(
    task: Task, runs: int, store: BlockStore, workers: int, executor: Executor | None
) -> Iterator[tuple[int, int]]:
    """Spans in order of runs, each after its block is on disk."""
    blocks = [*blocks_of(prepare(task), runs).items()]
    if executor is None and workers <= 1:
        for first, count in blocks:
            if not store.has(first):
                store.write(first, compute_block(task, first, count))
            yield first, count
        return
    decided = replace(task, engine=prepare(task).engine)  # so that no worker tries again what cannot be arrays
    if executor is not None:  # a cluster's workers may see other disks
        work = functools.partial(compute_block, decided)
        client: Any = executor
        try:  # twice its threads, as many as they are now
            yield from _pooled(executor, work, blocks, store, lambda: max(8, 2 * int(sum(client.nthreads().values()))))
        except (OSError, CancelledError) as error:
            if isinstance(error, OSError) and error.filename is not None:
                raise
            told = "the Dask scheduler was lost"
            allowed = "with --out, finished blocks are kept: --resume and a scheduler that runs"
            raise InputError.single(told, got=" ".join(str(error).split())[:100], allowed=allowed) from error
        return
    taken = lost = 0
    while taken < len(blocks):
        pool = process_pool(min(workers, len(blocks) - taken))
        write = functools.partial(_write_block, decided, store)
        try:
            for done in _pooled(pool, write, blocks[taken:], store, lambda: 2 * workers):
                taken += 1
                yield done
        except BrokenProcessPool:
            lost += 1
            if lost > MOST_LOST:
                raise InputError.single(
                    f"{lost} times a worker process ended unexpectedly (out of memory?)",
                    allowed="with --out, finished blocks are kept: --resume, perhaps with fewer --workers",
                ) from None
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _write_block(task: Task, store: BlockStore, first: int, count: int) -> None:
    """Compute a block and write it here, so that its numbers need not travel between processes."""
    store.write(first, compute_block(task, first, count))


def _pooled(
    pool: Any,
    work: Callable[[int, int], dict[str, NDArray[np.generic]] | None],
    blocks: Sequence[tuple[int, int]],
    store: BlockStore,
    room: Callable[[], int],
) -> Iterator[tuple[int, int]]:
    """Keep so many blocks under way as there is room for, so that memory does not grow with the number of runs."""
    waiting = ((first, count) for first, count in blocks if not store.has(first))
    under_way: dict[Future[Any], int] = {}

    def fill() -> None:
        free = room() - len(under_way)
        with interrupts_held():  # a pool starts its processes when it gets work
            for first, count in itertools.islice(waiting, max(0, free)):
                under_way[pool.submit(work, first, count)] = first

    for first, count in blocks:
        fill()
        while not store.has(first):
            listed = list(under_way)
            if listed and not isinstance(listed[0], Future):  # of a cluster's client
                from distributed import wait as cluster_wait

                done = cluster_wait(listed, return_when=FIRST).done
            else:
                done = wait(listed, return_when=FIRST).done
            for future in done:
                begin, columns = under_way.pop(future), future.result()
                if columns is not None:
                    store.write(begin, columns)
            fill()
        yield first, count


def paired_difference(quantity: str, baseline: Array, other: Array) -> Json | None:
    """Mean of the differences (other − baseline) of paired runs with a Student interval, and whether it is `real`.

    `baseline`, `other` (shape (n,)): run by run with the same draws; runs that failed in either (NaN) are left out.
    Gives None with fewer than two pairs; the difference is real where the 95 % interval leaves out zero.
    """
    change = np.asarray(other, dtype=float) - np.asarray(baseline, dtype=float)
    change = change[np.isfinite(change)]
    if len(change) < 2:
        return None
    from scipy.special import stdtrit

    half = float(stdtrit(len(change) - 1, 0.5 + 0.5 * LEVEL)) * float(change.std(ddof=1)) / math.sqrt(len(change))
    mean = float(change.mean())
    real = abs(mean) > half
    return {"quantity": quantity, "mean": mean, "low": mean - half, "high": mean + half, "real": real}


def compare_alternatives(
    tasks: Sequence[Task], runs: int, advance: Callable[[int], object] = lambda count: None
) -> list[Json]:
    """Run all alternatives with the same draws.

    `tasks`: the baseline first; all with the same seed. `advance`: told the number of runs of each block that is done.
    Gives, for each alternative: engine, share of feasible runs with its interval, mean energies and margins above the
    reserve, and for all but the first the differences.
    """
    found: list[dict[str, Any]] = []
    baseline: dict[str, Array] = {}
    for task in tasks:
        prepared = prepare(task)
        batteries = prepared.mission.robot.batteries
        quantities = ["feasible", "duration_s"]
        quantities += [f"{what}_{name}_wh" for name in batteries for what in ("energy", "margin")]
        parts: dict[str, list[Array]] = {name: [] for name in quantities}
        for first, count in blocks_of(prepared, runs).items():
            block = compute_block(task, first, count)
            for name in quantities:
                parts[name].append(np.asarray(block[name], dtype=float))
            advance(count)
        columns = {name: np.concatenate(values) for name, values in parts.items()}
        row: dict[str, Any] = {
            "engine": prepared.engine,
            "p_feasible": float(columns["feasible"].mean()),
            "p_feasible_interval": list(proportion_interval(int(columns["feasible"].sum()), runs)),
            "mean": {name: float(np.nanmean(values)) for name, values in columns.items() if name != "feasible"},
            "differences": [],
        }
        if baseline:
            made = (paired_difference(name, baseline[name], v) for name, v in columns.items() if name in baseline)
            row["differences"] = [difference for difference in made if difference is not None]
        else:
            baseline = columns
        found.append(row)
    return found
