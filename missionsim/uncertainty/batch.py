"""A batch of runs: blocks over processes, resumable, the same bits for any number of workers."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED as FIRST
from concurrent.futures import Executor, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from missionsim import __version__
from missionsim.errors import InputError
from missionsim.files import sha256
from missionsim.spec.loading import load_mission
from missionsim.spec.mission import MissionSpec
from missionsim.spec.power import build_power_model
from missionsim.uncertainty.answers import proportion_interval
from missionsim.uncertainty.arrays import ArrayMission
from missionsim.uncertainty.compile import compile_arrays
from missionsim.uncertainty.draws import Sampler, make_sampler
from missionsim.uncertainty.single import simulate_block
from missionsim.uncertainty.store import BlockStore

if TYPE_CHECKING:
    from numpy.typing import NDArray

BLOCK_RUNS = {"simpy": 200, "arrays": 4096}
"""Runs in a block; fixed, so that tables do not depend on the number of workers."""


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
        Where files have faults, nothing is uncertain in a way that can be drawn, or `arrays` is asked but impossible.
    """
    mission = load_mission(task.mission, overrides=task.overrides, robot=task.robot)
    model = build_power_model(mission.robot)
    sampler = make_sampler(mission)
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
    for first, count in _finished(task, spans, store, workers, executor):
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
    task: Task, spans: list[tuple[int, int]], store: BlockStore, workers: int, executor: Executor | None
) -> Iterator[tuple[int, int]]:
    """Spans in order of runs, each after its block is on disk."""
    if executor is None and workers <= 1:
        for first, count in spans:
            if not store.has(first):
                store.write(first, compute_block(task, first, count))
            yield first, count
        return
    pool: Any = executor
    if pool is None:
        import multiprocessing

        pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))
    try:
        yield from _pooled(pool, task, spans, store, ahead=4 * max(workers, 2))
    finally:
        if executor is None:
            pool.shutdown(wait=False, cancel_futures=True)


def _pooled(
    pool: Any, task: Task, spans: list[tuple[int, int]], store: BlockStore, ahead: int
) -> Iterator[tuple[int, int]]:
    """Keep `ahead` blocks under way, so that memory does not grow with the number of runs."""
    waiting: Iterable[tuple[int, int]] = iter([span for span in spans if not store.has(span[0])])
    under_way: dict[Future[Any], tuple[int, int]] = {}
    iterator = iter(waiting)

    def fill() -> None:
        while len(under_way) < ahead and (span := next(iterator, None)) is not None:
            under_way[pool.submit(compute_block, task, *span)] = span

    for span in spans:
        fill()
        while not store.has(span[0]):
            done, _ = wait_for(under_way)
            for future in done:
                first, _count = under_way.pop(future)
                store.write(first, future.result())
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
