"""`missionsim montecarlo`: many draws of the uncertain values."""

from __future__ import annotations

import logging
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from cyclopts import Parameter

from missionsim.cli.options import AS_FILED, TERMINAL, Changes, OutFolder, Output
from missionsim.cli.run import show
from missionsim.errors import Fault, InputError
from missionsim.files import install_hint, to_json, write_text
from missionsim.numerals import counted
from missionsim.report.figures_run import write_batch_figures
from missionsim.report.terminal import console, show_table
from missionsim.results.write import write_results
from missionsim.uncertainty.answers import refuse_correlated
from missionsim.uncertainty.batch import MOST_RUNS, MOST_WORKERS, Prepared, Task, answer_batch, prepare
from missionsim.uncertainty.draws import FAILED, simulate_run, unread_values
from missionsim.uncertainty.store import BlockStore

RESUMABLE = 130
SCHEDULER_WAIT_S = 10


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Batch:
    """Options of a batch.

    Parameters
    ----------
    runs
        How many runs; 1000 without it.
    seed
        Of all random numbers; run i of a seed is the same however many runs or workers there are.
    workers
        Processes on this machine.
    scheduler
        Address of a running Dask scheduler, in place of processes here (needs missionsim[dask]).
    only
        Run this one run of the batch alone, with SimPy, and print its draws and its result; its full trace goes to the
        folder run_<number> in --out. The first is 0; with --runs N the last is N − 1.
    until
        Stop as soon as the 95 % interval of the probability of success is at most this wide.
    sobol
        Estimate Sobol indices from so many base samples (a power of two) times the number of values plus two; what the
        mission leaves to chance counts as one value. Without it they are estimated where arrays make it cheap;
        with 0, never.
    out
        Folder for the runs (Parquet, block by block), the summary and the figures.
    resume
        Go on with the batch in --out.
    plot
        Draw histogram and charge over time into --out.
    """

    runs: int | None = None
    seed: int = 0
    workers: int = 1
    scheduler: str | None = None
    only: int | None = None
    until: float | None = None
    sobol: int | None = None
    out: OutFolder | None = None
    resume: bool = False
    plot: bool = False

    @property
    def count(self) -> int:
        """How many runs."""
        return 1000 if self.runs is None else self.runs

    def check(self) -> None:
        """Refuse what cannot be, all of it at once."""
        runs, until, only, base = self.count, self.until, self.only, self.sobol or 0
        # without --runs, a run alone may have any number
        last = only if self.runs is None and only is not None else runs - 1
        numbers = "a run's number, 0 or more" if self.runs is None else f"a run's number, 0 to {last} (--runs {runs})"
        faults: list[Fault] = []
        for name, bad, got, allowed in (
            ("--runs", not 1 <= runs <= MOST_RUNS, runs, f"1 to {MOST_RUNS}"),
            ("--workers", not 1 <= self.workers <= MOST_WORKERS, self.workers, f"1 to {MOST_WORKERS}"),
            ("--until", until is not None and not 0.0 < until < 1.0, until, "a width between 0 and 1, such as 0.02"),
            ("--only", only is not None and not 0 <= only <= last, only, numbers),
            ("--sobol", bool(base and (base < 64 or base & (base - 1))), base, "a power of two, 64 or more, or 0"),
            ("--resume", self.resume and self.out is None, "no --out", "--out with the folder of the batch"),
            ("--plot", self.plot and self.out is None, "no --out", "--out with a folder for the figures"),
        ):
            if bad:
                faults += InputError.single(f"{name} cannot be used so", got=got, allowed=allowed).faults
        if faults:
            raise InputError(faults)


ALONE = Batch()


def montecarlo(
    mission: Path,
    *,
    batch: Batch = ALONE,
    engine: Literal["auto", "arrays", "simpy"] = "auto",
    changes: Changes = AS_FILED,
    to: Output = TERMINAL,
) -> int:
    """Draw the uncertain values of a mission many times and run it with each draw.

    Exit code 0: done; 1: a run asked with --only is infeasible; 130: interrupted, go on with --resume.

    Parameters
    ----------
    mission
        Mission file.
    engine
        arrays evaluates many runs at once, simpy runs each; auto takes arrays where the mission allows it.
    """
    batch.check()
    chosen = "simpy" if batch.only is not None and engine == "auto" else engine
    task = Task(str(mission), changes.pairs, changes.robot, batch.seed, chosen)
    prepared = prepare(task)
    if not prepared.sampler.values and to.text:
        told = (
            "no number of this mission is uncertain; all runs are the same unless the mission itself is left to chance"
        )
        print(f"warning: {told}", file=sys.stderr)
    if to.text and (unread := unread_values(prepared.mission, prepared.model, prepared.sampler)):
        told = f"the nominal mission does not use {', '.join(unread)}; drawing them changes nothing"
        print(f"warning: {told}", file=sys.stderr)
    if batch.only is not None:
        return _only(prepared, batch, batch.only, to)
    if batch.out is not None:
        return _batch(task, prepared, batch, batch.out, to)
    with tempfile.TemporaryDirectory(prefix="missionsim-", ignore_cleanup_errors=True) as folder:
        return _batch(task, prepared, batch, Path(folder) / "batch", to)


def _only(prepared: Prepared, batch: Batch, run: int, to: Output) -> int:
    seed = batch.seed
    drawn, result, limited = simulate_run(prepared.mission, prepared.model, prepared.sampler, seed, run)
    if batch.out is not None:
        folder = batch.out / f"run_{run:09d}"
        write_results(result, folder)
        write_text(folder / "drawn.json", to_json(drawn))
    to.emit({**result.summary(), "run": run, "seed": seed, "drawn": drawn, "speed_limited": limited})
    if to.text:
        terminal = console()
        units = {value.name: value.unit for value in prepared.sampler.values}
        rows = [(name, f"{value:.6g}", units.get(name, "times")) for name, value in drawn.items()]
        show_table(f"Run {run} of seed {seed}: drawn values", ["value", ">drawn", "unit"], rows)
        if limited:
            terminal.print("A drawn speed is above the greatest of the robot or its control scheme and is cut to that.")

        show(result)
    return 0 if result.feasible else 1


def _batch(task: Task, prepared: Prepared, batch: Batch, out: Path, to: Output) -> int:
    if batch.sobol:
        refuse_correlated(prepared)
    store = BlockStore(out)

    def tell_damaged(damaged: list[int]) -> None:
        if damaged:
            told = f"{counted(len(damaged), 'damaged block')}, the first with run {damaged[0]}"
            print(f"warning: computing again {told}", file=sys.stderr)

    try:
        with to.progress() as bar, _executor(batch.scheduler) as executor:
            row = bar.add_task(f"runs ({prepared.engine})", total=batch.count)
            answer, firsts = answer_batch(
                task,
                batch.count,
                store,
                resume=batch.resume,
                workers=batch.workers,
                executor=executor,
                until=batch.until,
                sobol=batch.sobol,
                advance=lambda count: bar.advance(row, count),
                on_damaged=tell_damaged,
            )
        if all(told.startswith(FAILED) for part in store.tables(["message"], firsts) for told in part["message"]):
            with suppress(ArithmeticError, ValueError, RuntimeError):
                simulate_run(prepared.mission, prepared.model, prepared.sampler, batch.seed, 0)  # raises its fault
        if batch.plot:
            write_batch_figures(store, firsts, tuple(prepared.mission.robot.batteries), out)
    except KeyboardInterrupt:
        kept = "nothing is kept without --out"
        if batch.out is not None:
            kept = f"finished blocks are in {out}; go on with the same command and --resume"
        print(f"interrupted; {kept}", file=sys.stderr)
        return RESUMABLE
    to.emit(answer)
    if to.text:
        _print(answer, prepared)
    return 0


@contextmanager
def _executor(address: str | None) -> Iterator[Any]:
    """A Dask client for the address of a scheduler, or nothing."""
    if address is None:
        yield None
        return
    try:
        from distributed import Client
    except ImportError:
        told = "--scheduler needs the extra 'dask'"
        raise InputError.single(told, got="no package 'distributed'", allowed=install_hint("dask")) from None
    for name in [*logging.root.manager.loggerDict, "asyncio"]:
        if name.startswith(("distributed", "tornado", "asyncio")):  # what matters is told here
            logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = Client(address, timeout=SCHEDULER_WAIT_S)
    except (OSError, TimeoutError, ValueError) as error:
        told = f"no Dask scheduler answers at this address: {str(error)[:80]}"
        raise InputError.single(told, got=address, allowed="an address such as tcp://localhost:8786") from error
    try:
        yield client
    finally:
        client.close()


def _print(answer: dict[str, Any], prepared: Prepared) -> None:
    terminal = console()
    p = answer["p_feasible"]
    why = f" (not arrays: {answer['why_not_arrays']})" if answer["why_not_arrays"] else ""
    terminal.print(
        f"{answer['mission']} with {answer['robot']}: {answer['runs']} runs, seed {answer['seed']}, "
        f"engine {answer['engine']}{why}"
    )
    terminal.print(
        f"succeeds with its reserve in {100 * p['value']:.2f} % of the runs "
        f"(95 % interval {100 * p['low']:.2f} to {100 * p['high']:.2f} %)"
    )
    rows = []
    for name, battery in answer["batteries"].items():
        kept = battery["p_reserve"]
        terminal.print(
            f"  battery '{name}' ends with its reserve in {100 * kept['value']:.2f} % "
            f"({100 * kept['low']:.2f} to {100 * kept['high']:.2f} %)"
        )
        energy, capacity = battery["energy_wh"], battery["capacity_needed_wh"]
        if energy["mean"] is None:
            continue
        cells = [energy[key] for key in ("mean", "sd", "q05", "q50", "q95")]
        need = "not known" if capacity["value"] is None else f"{capacity['value']:.4g}"
        low, high = battery["energy_wh"]["intervals"]["q95"]
        lies = " … ".join("?" if bound is None else f"{bound:.5g}" for bound in (low, high))
        rows.append([name, *(f"{cell:.4g}" for cell in cells), need, lies])
    heads = ["battery", ">mean", ">sd", ">5 %", ">50 %", ">95 %", ">99 % need", "95 % quantile lies in"]
    show_table("Energy [Wh]", heads, rows)
    if answer["speed_limited_share"]:
        terminal.print(
            f"  in {100 * answer['speed_limited_share']:.3g} % of the runs a drawn speed is above the greatest of the "
            "robot or its control scheme and is cut to that"
        )
    failures = answer["failures"]
    for item in failures["empty"][:5]:
        terminal.print(
            f"  battery '{item['battery']}' is empty in {item['segment']}: {100 * item['share']:.1f} % of the "
            f"runs, typically after {item['median_time_s']:.0f} s"
        )
    for item in failures["reasons"][:5]:
        terminal.print(f"  {100 * item['share']:.1f} %: {item['reason']}")
    important = []
    for row in answer["importance"][:12]:
        ranks = [_number(row[key], "+.2f") for key in ("rank_correlation", "margin_rank_correlation")]
        indices = [_number(row[key], ".3f", row.get(f"{key}_interval")) for key in ("first", "total")]
        important.append([row["battery"], row["parameter"], *ranks, *indices])
    if important:
        title = "What matters: rank correlation with energy and with the margin above the reserve; indices of energy"
        show_table(title, ["battery", "value", ">energy", ">margin", ">first order", ">total"], important)
    if answer["importance"] and not any("total_interval" in row for row in answer["importance"]):
        if prepared.sampler.groups:
            text = "correlated values have no total indices"
        else:
            text = "total indices: add --sobol 64 (or more, a power of two); each costs a run for every value"
            text += ", what is left to chance counting as one value, 'chance'" if answer["chance"] else ""
        terminal.print(f"  {text}")


def _number(value: float | None, form: str, interval: list[float] | None = None) -> str:
    if value is None:
        return "–"
    text = f"{value:{form}}".replace("-", "−")
    return text if interval is None else f"{text} ±{interval[1] - value:{form}}"
