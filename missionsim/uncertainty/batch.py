"""A batch of runs: blocks over processes, resumable, the same bits for any number of workers."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED as FIRST
from concurrent.futures import Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from numpy import __version__ as numpy_version

from missionsim import __version__
from missionsim.errors import InputError, MissionsimError
from missionsim.files import sha256
from missionsim.plan.build import make_plan
from missionsim.spec.loading import load_mission
from missionsim.spec.mission import MissionSpec
from missionsim.spec.power import build_power_model
from missionsim.uncertainty.answers import proportion_interval
from missionsim.uncertainty.arrays import ArrayMission
from missionsim.uncertainty.compile import compile_arrays
from missionsim.uncertainty.draws import Sampler, make_sampler
from missionsim.uncertainty.single import simulate_block
from missionsim.uncertainty.store import BlockStore
from missionsim.uncertainty.streams import run_generator

if TYPE_CHECKING:
    from numpy.typing import NDArray

BLOCK_RUNS = {"simpy": 50, "arrays": 4096}
"""Runs in a block; fixed, so that tables do not depend on the number of workers."""
MOST_LOST = 3
"""So often a lost worker process is replaced."""


@dataclass(frozen=True)
class Task:
    """What a worker needs to know; everything else it loads itself, once."""

    mission: str
    overrides: tuple[tuple[str, str], ...]
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


@functools.lru_cache(maxsize=4)
def prepare(task: Task) -> Prepared:
    """Load what a task needs; a worker keeps it for all its blocks.

    Raises
    ------
    missionsim.errors.InputError
        Where files have faults, the nominal mission cannot be planned, or `arrays` is asked but impossible.
    """
    mission = load_mission(task.mission, overrides=task.overrides, robot=task.robot)
    model = build_power_model(mission.robot)
    sampler = make_sampler(mission)
    make_plan(mission, rng=run_generator(0, "chance", 0))  # what no run could do is told once, where it stands
    compiled = compile_arrays(mission, model, sampler) if task.engine != "simpy" else "SimPy was asked for"
    if isinstance(compiled, str):
        if task.engine == "arrays":
            raise InputError.single(
                "this mission cannot be evaluated as arrays",
                file=task.mission,
                got=compiled,
                allowed="--engine simpy, or auto",
            )
        return Prepared(mission, model, sampler, None, compiled)
    return Prepared(mission, model, sampler, compiled, "")


def compute_block(task: Task, first: int, count: int) -> dict[str, NDArray[Any]]:
    """Columns of the runs ``first … first + count − 1``; pure, so that any process may compute it."""
    prepared = prepare(task)
    if prepared.arrays is not None:
        return prepared.arrays.block(task.seed, first, count)
    return simulate_block(prepared.mission, prepared.model, prepared.sampler, task.seed, first, count)


def identity(task: Task, runs: int, engine: str) -> dict[str, Any]:
    """What makes a batch this batch: a resumed one must agree in all of it."""
    prepared = prepare(task)
    files = {"mission": sha256(task.mission)}
    for name, part in (("robot", prepared.mission.robot), ("environment", prepared.mission.environment)):
        path = getattr(part, "path", None)
        if path:
            files[name] = sha256(path)
    return {
        "missionsim": __version__,
        # another version may draw other numbers
        "numpy": numpy_version,
        "engine": engine,
        "seed": task.seed,
        "runs": runs,
        "block_runs": BLOCK_RUNS[engine],
        "overrides": [list(pair) for pair in task.overrides],
        "files": files,
    }


def run_batch(
    task: Task,
    runs: int,
    store: BlockStore,
    *,
    engine: str,
    workers: int = 1,
    executor: Executor | None = None,
    until: float | None = None,
    advance: Callable[[int], None] = lambda runs: None,
) -> list[int]:
    """Compute all blocks that are not there yet.

    Parameters
    ----------
    task : Task
    runs : int
    store : BlockStore
    engine : str
        ``simpy`` or ``arrays``, as decided.
    workers : int
        Processes on this machine.
    executor : concurrent.futures.Executor, optional
        Where to compute instead (a cluster's client).
    until : float, optional
        Stop when the 95 % interval of the probability of success is at most this wide. Judged block by block in the
        order of runs, so that the answer does not depend on who computed what first.
    advance : callable
        Told the number of runs of each block that is done.

    Returns
    -------
    list of int
        First runs of the blocks that count, in order.
    """
    size = BLOCK_RUNS[engine]
    spans = [(first, min(size, runs - first)) for first in range(0, runs, size)]
    counted: list[int] = []
    good = total = 0
    for first, count in _finished(task, engine, spans, store, workers, executor):
        advance(count)
        counted.append(first)
        if until is not None:
            feasible = next(iter(store.parts("feasible", [first])))
            good, total = good + int(feasible.sum()), total + count
            low, high = proportion_interval(good, total)
            if high - low <= until:
                break
    return counted


def _finished(
    task: Task,
    engine: str,
    spans: list[tuple[int, int]],
    store: BlockStore,
    workers: int,
    executor: Executor | None,
) -> Iterator[tuple[int, int]]:
    """Spans in order of runs, each after its block is on disk."""
    if executor is None and workers <= 1:
        for first, count in spans:
            if not store.has(first):
                store.write(first, compute_block(task, first, count))
            yield first, count
        return
    missing = [span for span in spans if not store.has(span[0])]
    decided = replace(task, engine=engine)  # so that no worker tries again what cannot be arrays
    if executor is not None:  # a cluster's workers may see other disks
        yield from _pooled(executor, functools.partial(compute_block, decided), spans, missing, store, 8)
        return
    import multiprocessing

    taken = lost = 0
    while taken < len(spans):
        pool = ProcessPoolExecutor(
            max(1, min(workers, len(missing))),
            mp_context=multiprocessing.get_context("spawn"),
            initializer=_leave_interrupts_to_the_parent,
        )
        work = functools.partial(_write_block, decided, store)
        try:
            for span in _pooled(pool, work, spans[taken:], missing, store, 2 * workers):
                taken += 1
                yield span
        except BrokenProcessPool:
            lost += 1
            if lost > MOST_LOST:
                raise MissionsimError(
                    f"{lost} times a worker process ended unexpectedly (out of memory?); the finished blocks are kept"
                ) from None
            missing = [span for span in spans[taken:] if not store.has(span[0])]
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _leave_interrupts_to_the_parent() -> None:
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _write_block(task: Task, store: BlockStore, first: int, count: int) -> None:
    """Compute a block and write it here, so that its numbers need not travel between processes."""
    store.write(first, compute_block(task, first, count))


def _pooled(
    pool: Any,
    work: Callable[[int, int], dict[str, NDArray[Any]] | None],
    spans: list[tuple[int, int]],
    missing: list[tuple[int, int]],
    store: BlockStore,
    ahead: int,
) -> Iterator[tuple[int, int]]:
    """Keep `ahead` blocks under way, so that memory does not grow with the number of runs."""
    waiting = iter(missing)
    under_way: dict[Future[Any], int] = {}

    def fill() -> None:
        while len(under_way) < ahead and (span := next(waiting, None)) is not None:
            under_way[pool.submit(work, *span)] = span[0]

    for span in spans:
        fill()
        while not store.has(span[0]):
            done, _ = wait_for(under_way)
            for future in done:
                first, columns = under_way.pop(future), future.result()
                if columns is not None:
                    store.write(first, columns)
            fill()
        yield span


def wait_for(futures: Iterable[Any]) -> tuple[set[Any], set[Any]]:
    """The futures that are done, once at least one is; works for those of a cluster's client as well."""
    listed = list(futures)
    if listed and not isinstance(listed[0], Future):
        from distributed import wait as cluster_wait

        found = cluster_wait(listed, return_when="FIRST_COMPLETED")  # type: ignore[no-untyped-call]
        return set(found.done), set(found.not_done)
    found_local = wait(listed, return_when=FIRST)
    return set(found_local.done), set(found_local.not_done)
