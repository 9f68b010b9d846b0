"""`missionsim whatif`: alternatives of a mission as differences to a baseline."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from missionsim.cli.options import AS_FILED, TERMINAL, Changes, Output, Target
from missionsim.cli.run import clock
from missionsim.errors import Fault, InputError
from missionsim.inputs.overrides import split_assignment, value_of
from missionsim.numerals import counted, in_wh, rounded
from missionsim.report.terminal import console, show_table, signed, simple_table, titled
from missionsim.results.whatif import BASELINE, Alternative, WhatIf, from_study, run_alternatives, varied
from missionsim.results.write import TABLES, write_table
from missionsim.uncertainty.batch import MOST_RUNS, MOST_WORKERS, Task, compare_alternatives

MOST_TERMS = 5


def whatif(
    mission: Path | None = None,
    *,
    vary: list[str] | None = None,
    study: Path | None = None,
    changes: Changes = AS_FILED,
    montecarlo: int = 0,
    seed: int = 0,
    workers: int = 1,
    out: Annotated[Path, Target("file", "a table", TABLES)] | None = None,
    to: Output = TERMINAL,
) -> int:
    """Run the alternatives of a mission and print one table: what each changes by battery, duration and term.

    Each alternative is a full run. Exit code 0 even where alternatives are infeasible (the table says so); 1 when the
    baseline itself is.

    Parameters
    ----------
    mission
        Mission file; a study names its own.
    vary
        path=v1,v2,... such as defaults.speed=0.3,0.46,0.75; several --vary give every combination. A value with commas
        of its own goes into brackets or braces: sensors={laser: 1, kinect: 1}.
    study
        Study file with named alternatives as differences to a baseline.
    montecarlo
        Also draw the uncertain values of each alternative so many times, the same draws for all, and say which
        differences are real.
    seed
        Of those draws.
    workers
        Processes on this machine that run the alternatives.
    out
        Table as CSV (or Parquet, by its suffix): a row an alternative, battery and term.
    """
    if (vary is None) == (study is None):
        told, allowed = "whatif needs either --vary or --study", "--vary defaults.speed=0.3,0.5, or --study STUDY.yaml"
        raise InputError.single(told, got="both" if vary else "neither", allowed=allowed)
    base, robot = changes.pairs, changes.robot
    if study is not None:
        path, alternatives = from_study(study)
        path = mission or path
        alternatives = [
            Alternative(a.name, (*base, *a.set), robot if robot is not None else a.robot, a.title) for a in alternatives
        ]
    else:
        if mission is None:
            raise InputError.single("whatif needs a mission", allowed="whatif MISSION.yaml --vary …")
        path = mission
        alternatives = [Alternative(BASELINE, base, robot), *varied(to_vary(vary or ()), base, robot)]
    if montecarlo and not 2 <= montecarlo <= MOST_RUNS:
        raise InputError.single("--montecarlo cannot be used so", got=montecarlo, allowed=f"2 to {MOST_RUNS}, or 0")
    if not 1 <= workers <= MOST_WORKERS:
        raise InputError.single("--workers cannot be used so", got=workers, allowed=f"1 to {MOST_WORKERS}")
    with to.progress() as bar:
        task = bar.add_task("alternatives", total=len(alternatives))
        try:
            found = run_alternatives(path, alternatives, lambda: bar.advance(task), workers)
        except InputError as error:
            if study is None:
                raise
            raise InputError(f if f.file else replace(f, file=str(study)) for f in error.faults) from None
    to.warn(found.warnings)
    if out is not None:
        write_table(found.table(), out)
    answer = found.to_json()
    if montecarlo:
        possible = [a for a, row in zip(alternatives, answer["alternatives"], strict=True) if row["batteries"]]
        tasks = [Task(str(path), tuple(a.set), a.robot, seed, "auto") for a in possible]
        with to.progress() as bar:
            task = bar.add_task("runs", total=montecarlo * len(tasks))
            rows = compare_alternatives(tasks, montecarlo, lambda count: bar.advance(task, count))
        named = [{"name": a.name, **row} for a, row in zip(possible, rows, strict=True)]
        answer["montecarlo"] = {"runs": montecarlo, "seed": seed, "alternatives": named}
    to.emit(answer)
    if to.text:
        show(found)
        if montecarlo:
            _show_differences(answer["montecarlo"])
    to.written(out)
    return 0 if found.runs[0].feasible else 1


def _show_differences(answer: dict[str, Any]) -> None:
    """Print which differences of the alternatives hold under the uncertainty."""
    rows = []
    for row in answer["alternatives"]:
        means = {d["quantity"]: d["mean"] for d in row["differences"]}
        for d in row["differences"]:
            name = d["quantity"]
            gives = means.get(name.replace("margin_", "energy_"), math.nan) if "margin_" in name else math.nan
            # what a battery keeps often changes by just what it gives; then one of the two tells all
            if not math.isclose(gives, -d["mean"], rel_tol=1e-9):
                interval = " … ".join(rounded(d[end], sign=True) for end in ("low", "high"))
                real = "yes" if d["real"] else "cannot be told"
                rows.append([row["name"], _percent(row), name, rounded(d["mean"], 4, sign=True), interval, real])
    first = answer["alternatives"][0]
    terminal = console()
    succeeds = f"{first['name']}: succeeds in {_percent(first)}"
    terminal.print(f"{answer['runs']} runs each, same draws; {succeeds}")
    show_table(
        "Differences to the baseline", ["alternative", ">succeeds", "quantity", ">mean", "95 % interval", "real?"], rows
    )


def _percent(row: Mapping[str, Any]) -> str:
    low, high = row["p_feasible_interval"]
    return f"{100 * row['p_feasible']:.1f} % ({100 * low:.1f}–{100 * high:.1f})"


def to_vary(given: Sequence[str]) -> list[tuple[str, list[str]]]:
    """Paths and their values. Raises InputError: with every value that is empty or not YAML."""
    pairs = [(path, split_values(text)) for path, text in map(split_assignment, given)]
    faults: list[Fault] = []
    for path, value in ((path, value) for path, values in pairs for value in values):
        try:
            value_of(value, path)
        except InputError as problem:
            faults += problem.faults
        if not value:
            faults.append(Fault("", 0, 0, "an empty value among those to vary", path, "", "path=v1,v2"))
    if faults:
        raise InputError(faults)
    return pairs


def split_values(text: str) -> list[str]:
    """Values between commas that stand in no bracket, brace or quote; a quotation mark inside a word is none."""
    values: list[str] = []
    for piece in text.split(","):
        bare = _QUOTED.sub("", values[-1] if values else "")
        still_open = sum(map(bare.count, "[{(")) > sum(map(bare.count, "]})")) or _QUOTE.search(bare) is not None
        values[-1:] = [f"{values[-1]},{piece}"] if still_open else [*values[-1:], piece]
    return [value.strip() for value in values]


_QUOTE = re.compile(r"(?<![^\s\[{(:,])['\"]")
_QUOTED = re.compile(r"""(?<![^\s\[{(:,])('([^']|'')*'|"([^"\\]|\\.)*")""")


def show(found: WhatIf) -> None:
    """Print the alternatives beside the baseline, at most 100 columns wide."""
    terminal = console()
    rows = found.rows()
    terminal.print(titled(found.mission, f", {counted(len(rows) - 1, 'alternative')}; differences are to the baseline"))
    columns = ["alternative", ">duration", ">± s"]
    for name in found.batteries:
        columns += [f">{name} Wh", ">± Wh", ">± %"]
    columns.append("feasible")
    cells, left = [], []
    for number, row in enumerate(rows):
        label = f"{number} {row['name']}"
        if not row["batteries"]:
            cells.append([label, *["–"] * (2 + 3 * len(found.batteries)), "impossible"])
            continue
        line: list[Any] = [label, clock(row["duration_s"]), signed(row["difference_s"], 1, none=True)]
        kept = [label]
        for name in found.batteries:
            b = row["batteries"][name]
            percent = b["difference_pct"]
            line += [in_wh(b["energy_wh"]), signed(b["difference_wh"], 3, none=True), signed(percent, 1, none=True)]
            if b["charge_left_wh"] is None:
                kept += ["–"] * 3
            else:
                share = f"{100 * b['charge_left_fraction']:.1f} %"
                kept += [in_wh(b["charge_left_wh"]), share, in_wh(b["margin_wh"])]
        cells.append([*line, "yes" if row["feasible"] else "NO"])
        left.append(kept)
    table = simple_table("Alternatives", columns, cells)
    table.collapse_padding = True
    terminal.print(table)
    for number, row in enumerate(rows):
        if not row["feasible"]:
            terminal.print(f"  {number} {row['name']}: {row['reason']}")
    columns = [">left Wh", ">left", ">margin Wh"]
    heads = [f">{name} {column[1:]}" for name in found.batteries for column in columns]
    show_table("Charge left, and what it is above the reserve", ["alternative", *heads], left)
    terms = []
    for number, row in enumerate(rows[1:], start=1):
        changes = [
            (difference, battery, term)
            for battery, b in row["batteries"].items()
            for term, difference in b["difference_by_term_wh"].items()
            if abs(difference) > 5e-7
        ]
        changes.sort(key=lambda change: -abs(change[0]))
        text = ", ".join(f"{battery}/{term} {signed(d, 4, none=True)}" for d, battery, term in changes[:MOST_TERMS])
        if row["batteries"]:
            terms.append((f"{number} {row['name']}", text or "nothing changes"))
    show_table("Terms that change most [Wh]", ["alternative", "battery/term"], terms)
