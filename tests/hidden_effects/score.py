"""Score the diagnosis and its peers on the little world or on practice folders, and write the table.

``python -m tests.hidden_effects.score [--practice DIR] [--cases START ...] [--seeds a:b] [--workers N] [--out DIR]``
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import os
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from . import features, known, peers, product, truth
from .judge import judge
from .study import ALL_CASES
from .table import markdown
from .world import World, experiment, make, write, write_csv

Row = dict[str, Any]


@dataclass(frozen=True)
class Task:
    """One case to score: made from a seed, or a folder that lies there already."""

    case: str
    seed: int
    folder: Path | None = None
    with_peers: bool = True
    with_product: bool = True


def score_task(task: Task) -> list[Row]:
    """Rows of one task, one per method; an exception of the product is a row too, never silence."""
    with tempfile.TemporaryDirectory() as scratch:
        if task.folder is None:
            case = ALL_CASES[task.case]
            world: World | None = make(case, task.seed, candidates=known.answers(case))
            folder = write(world, Path(scratch))
            answer: dict[str, Any] = dict(world.answer)
        else:
            world, folder = None, task.folder
            answer = json.loads((folder / "answer.json").read_text(encoding="utf-8"))
        robot = str(answer.get("robot", "pioneer3dx"))
        logs = {k: [features.read_log(p) for p in sorted((folder / k).glob("*.csv"))] for k in ("train", "heldout")}
        train, heldout = ([features.table(log, robot) for log in logs[k]] for k in ("train", "heldout"))
        errors = {"nominal": peers.nominal(heldout)}
        planned = (folder / "mission.yaml").exists()
        if not planned:
            columns = truth.columns(world, [*logs["train"], *logs["heldout"]], answer["hidden"], [*train, *heldout])
            if columns is not None:
                errors["oracle"] = truth.oracle(train, heldout, columns, robot)
        rows = []
        if task.with_product:
            rows.append(_product_row(task, folder, robot, answer, world))
        if world is not None and known.answers(world.case):
            rows.append(judge(task.case, task.seed, answer, known.named(world)))
        if task.with_peers and not planned:  # the peers know no missions
            design = peers.stack(train, robot)
            outcomes = [method(design, heldout, seed=task.seed) for method in peers.NAMING]
            outcomes.append(peers.boosted_trees(train, heldout, seed=task.seed))
            rows += [judge(task.case, task.seed, answer, o) for o in outcomes]
    for row in rows:
        for kind, (energy, rmse) in errors.items():
            row[f"{kind}_energy_error_pct"], row[f"{kind}_rmse_w"] = energy, rmse
    return rows


def _product_row(task: Task, folder: Path, robot: str, answer: dict[str, Any], world: World | None) -> Row:
    mission = folder / "mission.yaml"
    given = mission if mission.exists() else None
    try:
        outcome, report = product.diagnose(folder / "train", folder / "heldout", robot, given)
        row = judge(task.case, task.seed, answer, outcome)
        if answer.get("outside"):  # laws come one after the other, and effects between them
            row["energy_error_pct"], row["rmse_w"] = product.improved(folder / "train", folder / "heldout", robot)
        if world is not None and row["honest"] is not None and len(outcome.names) > 0:
            row |= _experiment(task, world, folder, robot, answer, report)
    except Exception as error:  # the study goes on, and the table shows the failure
        failed = peers.Outcome(product.NAME, (), verdict="failed")
        row = judge(task.case, task.seed, answer, failed)
        return row | {"failure": f"{error}\n{traceback.format_exc(limit=-3)}"}
    return row


def _experiment(
    task: Task, world: World, folder: Path, robot: str, answer: dict[str, Any], report: dict[str, Any]
) -> Row:
    """Drive what the diagnosis proposes (at most two manoeuvres) and diagnose again with these runs added."""
    row: Row = {"resolved_by_one": None, "resolved_by_two": None, "misled": None}
    for number, key in enumerate(("resolved_by_one", "resolved_by_two")):
        proposals = report["batteries"]["robot"].get("next_experiment", [])
        if not proposals or not proposals[0].get("manoeuvre"):
            row[key] = row[key] or False
            return row
        row[f"driven_{number + 1}"] = proposals[0]["do"]
        log = experiment(world, proposals[0]["manoeuvre"], number)
        write_csv(log, folder / "train" / f"experiment_{number}.csv")
        outcome, report = product.diagnose(folder / "train", folder / "heldout", robot)
        after = judge(task.case, task.seed, answer, outcome)
        row[key] = bool(after["first_right"] and not outcome.sets.get(outcome.names[0]))
        row["misled"], row[f"named_{number + 1}"] = after["confident_wrong"], after["named"]
        if row[key] or after["confident_wrong"]:
            row["resolved_by_two"] = row[key]
            return row
    return row


def tasks(arguments: argparse.Namespace) -> Iterator[Task]:
    """The tasks that the command line asks for."""
    kinds = {"with_peers": not arguments.no_peers, "with_product": not arguments.no_product}
    if arguments.practice:
        for folder in sorted(p.parent for p in arguments.practice.glob("*/answer.json")):
            if not arguments.cases or any(folder.name.startswith(c) for c in arguments.cases):
                yield Task(folder.name, 0, folder, **kinds)
        return
    first, _, last = arguments.seeds.partition(":")
    for seed in range(int(first), int(last or int(first) + 1)):
        for name in ALL_CASES:
            if not arguments.cases or any(name.startswith(c) for c in arguments.cases):
                yield Task(name, seed, **kinds)


def run(
    todo: Sequence[Task], workers: int, quiet: bool = False, save: Callable[[list[Row]], None] | None = None
) -> list[Row]:
    """Score all tasks, in parallel; the rows come in the order of the tasks whatever the number of workers.

    ``save`` gets all rows so far after every 25 tasks, so that a long study that is cut off has not been in vain.
    """
    rows: dict[int, list[Row]] = {}

    def ordered() -> list[Row]:
        return [row for i in sorted(rows) for row in rows[i]]

    def done(i: int, result: list[Row]) -> None:
        rows[i] = result
        _progress(len(rows), len(todo), quiet)
        if save is not None and (len(rows) % 25 == 0 or len(rows) == len(todo)):
            save(ordered())

    if workers <= 1:
        with threadpool_limits(1):
            for i, task in enumerate(todo):
                done(i, score_task(task))
    else:
        with ProcessPoolExecutor(workers, initializer=threadpool_limits, initargs=(1,)) as pool:
            futures = {pool.submit(score_task, task): i for i, task in enumerate(todo)}
            for future in as_completed(futures):
                done(futures[future], future.result())
    return ordered()


def _progress(done: int, total: int, quiet: bool) -> None:
    if not quiet and (done % 10 == 0 or done == total):
        print(f"\r{done}/{total} cases", end="" if done < total else "\n", file=sys.stderr, flush=True)


def heading(rows: Sequence[Row], practice: bool) -> str:
    """What the rows are of."""
    cases, seeds = len({row["case"] for row in rows}), sorted({int(row["seed"]) for row in rows})
    return f"{cases} practice cases" if practice else f"{cases} cases of the little world, seeds {seeds[0]}–{seeds[-1]}"


def write_results(rows: Sequence[Row], out: Path, stem: str, title: str) -> None:
    """Write the rows as CSV and the table as Markdown, each whole or not at all."""
    out.mkdir(parents=True, exist_ok=True)
    keys = list(dict.fromkeys(key for row in rows for key in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, keys, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({k: f"{v:.5g}" if isinstance(v, float) else v for k, v in row.items()})
    for path, content in ((out / f"{stem}.csv", text.getvalue()), (out / f"{stem}.md", markdown(rows, title))):
        temporary = path.with_suffix(path.suffix + ".part")
        temporary.write_text(content, encoding="utf-8")
        os.replace(temporary, path)


def earlier(path: Path, rows: Sequence[Row]) -> list[Row]:
    """Rows of an earlier study that the new rows do not replace."""
    if not path.exists():
        return []
    new = {(row["case"], str(row["seed"]), row["method"]) for row in rows}
    with path.open(encoding="utf-8", newline="") as file:
        old = [{key: _read(key, text) for key, text in row.items()} for row in csv.DictReader(file)]
    return [row for row in old if (row["case"], str(row["seed"]), row["method"]) not in new]


def _read(key: str, text: str) -> Any:
    if key in ("group", "case", "method", "expected", "named", "sets", "verdict", "failure"):
        return text
    if text in ("True", "False", ""):
        return {"True": True, "False": False, "": None}[text]
    if key in ("seed", "covered", "intervals"):
        return int(text)
    try:
        return float(text)
    except ValueError:
        return text


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--practice", type=Path, help="folder of cases (train/, heldout/, answer.json) to score instead")
    p.add_argument("--cases", nargs="*", default=[], help="names of cases or their beginnings; none = all")
    p.add_argument("--seeds", default="1000:1003", help="a:b; 0-99 are for tuning, 1000 and above are untouched")
    p.add_argument("--workers", type=int, default=1)
    p.add_argument("--out", type=Path, help="folder for the CSV and the Markdown; none = print only")
    p.add_argument("--add", action="store_true", help="keep the rows of an earlier study that are not replaced")
    p.add_argument("--no-peers", action="store_true")
    p.add_argument("--no-product", action="store_true")
    p.add_argument("--quiet", action="store_true")
    return p


def main(arguments: Sequence[str] | None = None) -> int:
    """Score and print the table."""
    options = parser().parse_args(arguments)
    # the trees' threads of two workers wait for each other in circles: 48 s a case in place of 1
    os.environ["OMP_NUM_THREADS"] = "1"
    todo = list(tasks(options))
    if not todo:
        print("no such cases", file=sys.stderr)
        return 2
    practice = options.practice is not None
    stem = "practice" if practice else "world"

    def save(rows: list[Row]) -> None:
        kept = earlier(options.out / f"{stem}.csv", rows) if options.add else []
        every = [*kept, *rows]
        write_results(every, options.out, stem, heading(every, practice))

    rows = run(todo, options.workers, options.quiet, save if options.out else None)
    print(markdown(rows, heading(rows, practice)))
    failures = [row for row in rows if row.get("failure")]
    for row in failures[:5]:
        print(f"FAILED {row['case']} seed {row['seed']}: {row['failure']}", file=sys.stderr)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
