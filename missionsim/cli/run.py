"""`missionsim run`: simulate one mission; `missionsim validate`: check YAML files and logs, all faults at once."""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from missionsim.cli.options import AS_FILED, TERMINAL, Changes, OutFolder, Output, OutRecording
from missionsim.errors import Fault, InputError
from missionsim.numerals import counted, in_wh
from missionsim.report.terminal import console, show_table, simple_table, titled

if TYPE_CHECKING:
    from rich.table import Table

    from missionsim.engine.outcome import RunResult


def run(
    mission: Path,
    *,
    changes: Changes = AS_FILED,
    out: OutFolder | None = None,
    format: Literal["csv", "parquet"] = "csv",
    plot: list[Literal["png", "svg"]] | None = None,
    mcap: OutRecording | None = None,
    to: Output = TERMINAL,
) -> int:
    """Simulate one mission with SimPy and tell what each battery gave to what.

    A mission is feasible when every segment is done, no battery is ever empty, and at the end every battery holds its
    reserve and enough to come home to the dock. Exit code 1 when it is not.

    Parameters
    ----------
    mission
        Mission file.
    out
        Folder for the tables (per interval, per segment, segment x component x term, summary), run.json and
        provenance.json.
    format
        Of the tables.
    plot
        Also draw power over time, charge over time and energy by segment, as png (or svg, or both), into the folder
        of --out (else the present one).
    mcap
        Also write power, watts by term, charge, scheme, components and pose over time into this MCAP file, with a
        layout for Foxglove and a map for import beside it.
    """
    from missionsim.engine.simulate import simulate
    from missionsim.inputs.loading import load_mission
    from missionsim.results.write import provenance, write_results

    spec = load_mission(mission, changes.pairs, changes.robot)
    to.warn(spec.warnings)
    result = replace(simulate(spec), provenance=provenance(spec, ["missionsim", *sys.argv[1:]]))
    to.warn(result.warnings)
    written: list[Path] = []
    if out is not None:
        written += write_results(result, out, format)
    if plot is not None:
        from missionsim.report.figures_run import write_figures

        for suffix in plot:
            written += write_figures(result, out or Path(), suffix, spec.environment)
    if mcap is not None:
        from missionsim.exchange.mcap import write_run

        written += write_run(result, spec, mcap)
    to.emit(result.summary())
    if to.text:
        show(result)
    to.written(*written)
    return 0 if result.feasible else 1


def show(result: RunResult) -> None:
    """Print the summary of a run, at most 100 columns wide."""
    from missionsim.results.write import largest_consumers

    terminal = console()
    verdict = "feasible" if result.feasible else f"NOT feasible: {result.reason}"
    terminal.print(titled(result.mission, f" with {result.robot}: {verdict}"))
    driven = counted(sum(segment.kind not in ("return", "recharge") for segment in result.segments), "segment")
    if (cut := result.interrupted) is not None:
        ended, where = "turned back" if result.returned else "stopped", result.segments[cut.segment].name
        driven = f"{result.segments_driven} of {driven}\n"
        driven += f"{ended} after {clock(cut.time_s)} in segment {cut.segment + 1}, '{where}'"
    terminal.print(f"{clock(result.duration_s)}, {result.distance_m:.1f} m, {driven}")
    rows = []
    for name, b in result.batteries.items():
        left = [in_wh(b.charge_left_wh), f"{100 * b.charge_left_fraction:.1f} %", in_wh(b.reserve_required_wh)]
        home = "unknown" if b.home_wh is None else in_wh(b.home_wh)
        used = [in_wh(b.energy_wh), f"{b.mean_power_w:.2f}", f"{b.capacity_wh:.1f}"]
        rows.append([name, *used, *left, home, in_wh(b.reserve_wh)])
    heads = ("Wh used", "mean W", "full Wh", "Wh left", "left", "to keep Wh", "home Wh", "reserve Wh")
    show_table("Batteries", ["battery", *(f">{head}" for head in heads)], rows)
    if result.dock_s:
        charged = ", ".join(f"{name} {in_wh(b.charged_wh)} Wh" for name, b in result.batteries.items() if b.charged_wh)
        terminal.print(f"  charged at docks in {clock(result.dock_s)}: {charged or 'nothing'}")
    for name, b in result.batteries.items():
        if b.empty_at_s is not None:
            empty = f"empty at {clock(b.empty_at_s)} in {b.empty_in_segment}"
            terminal.print(f"  {name}: {empty}, {in_wh(b.deficit_wh)} Wh short")
        elif b.deficit_wh > 0.0:
            terminal.print(f"  {name}: {in_wh(b.deficit_wh)} Wh short of the whole mission")
        elif b.charge_left_wh < b.reserve_required_wh * (1 - 1e-9):
            terminal.print(f"  {name}: below its reserve")
    if unknown := [name for name, battery in result.batteries.items() if battery.home_wh is None]:
        why = "the environment has no way from the mission's end to a dock, or that end is no place of it"
        if "environment" not in result.provenance.get("files", {}):
            why = "the mission has no environment, so that no way to a dock is known"
        terminal.print(f"  home Wh unknown ({', '.join(unknown)}): {why}")
    for fault in result.warnings:
        terminal.print(f"  warning: {fault.message}")
    if result.never_on:
        terminal.print(f"  never on in this mission, so costing nothing: {', '.join(result.never_on)}")
    largest = [(part, of, in_wh(wh), f"{100 * share:.1f} %") for of, part, wh, share in largest_consumers(result)]
    show_table("Three largest consumers", ["component", "battery", ">Wh", ">share"], largest)
    schemes = {name: result.by_scheme_wh(name) for name in result.batteries}
    names = dict.fromkeys(scheme for energies in schemes.values() for scheme in energies)
    if len(names) > 1:
        told = {"none": "no scheme"}
        rows = [[told.get(name, name), *(in_wh(wh.get(name, 0.0)) for wh in schemes.values())] for name in names]
        show_table("Energy by control scheme [Wh]", ["scheme", *(f">{b}" for b in schemes)], rows)
    terminal.print(segment_rows(result))


MOST_SEGMENTS = 14


def segment_rows(result: RunResult) -> Table:
    """Energy by segment; repetitions of a segment are added up, and of many segments the largest are shown."""
    energies = {name: result.by_segment_wh(name) for name in result.batteries}
    passed = result.places_passed()
    rows = []
    for label, members in result.repeats().items():
        parts = [float(energies[name][members].sum()) for name in result.batteries]
        driven = sum(result.was_done(i) for i in members)
        if driven:
            ways = {tuple(passed.get(i, ())[1:-1]) for i in members}
            if len(ways) == 1 and (between := ways.pop()):
                shown_by = ", ".join(between)
                label += f" (by {shown_by if len(shown_by) < 40 else f'{len(between)} places'})"
            rows.append((sum(parts), label, result.segments[members[0]].kind, driven, parts))
    shown = rows
    title = "Energy by segment [Wh]"
    if len(rows) > MOST_SEGMENTS:
        keep = {row[1] for row in sorted(rows, reverse=True)[:MOST_SEGMENTS]}
        shown = [row for row in rows if row[1] in keep]
        title += f", the {MOST_SEGMENTS} largest of {len(rows)}"
    columns = ["segment", "kind", ">times", *(f">{name}" for name in result.batteries)]
    cells = [(label, kind, times, *(in_wh(part) for part in parts)) for _, label, kind, times, parts in shown]
    return simple_table(title, columns, cells)


def clock(seconds: float) -> str:
    """Seconds as h:mm:ss or m:ss."""
    whole = round(seconds)
    hours, minutes = whole // 3600, whole % 3600 // 60
    return f"{hours}:{minutes:02d}:{whole % 60:02d} h" if hours else f"{minutes}:{whole % 60:02d} min"


_YAML = (".yaml", ".yml")


def validate(*files: Path, to: Output = TERMINAL) -> int:
    """Check robots, environments, missions, studies, maps and logs; print all faults of all files at once.

    Parameters
    ----------
    files
        YAML files, logs (.csv, .parquet), or folders that hold them.

    Returns
    -------
    int
        0 when there are no errors (warnings are allowed), 2 otherwise.
    """
    from missionsim.inputs.loading import check_files

    if not files:
        raise InputError.single("nothing to check", allowed="files or folders: missionsim validate FILE...")
    faults: list[Fault] = []
    yaml_files: list[Path] = []
    logs: list[Path] = []
    for given in files:
        if given.suffix.lower() in _YAML and not given.is_dir():
            yaml_files.append(given)
            continue
        from missionsim.logs.readers import is_recording, log_suffixes  # what checks YAML alone starts faster without

        if is_recording(given):
            logs.append(given)  # the check of logs says how it becomes one
            continue
        known = (*_YAML, *log_suffixes())
        found = [given]
        if given.is_dir():
            found = [p for p in sorted(given.rglob("*")) if p.suffix.lower() in known and p.is_file()]
        if not found:
            allowed = ", ".join(known)
            faults.append(Fault(str(given), 0, 0, "no YAML file or log in this folder", allowed=allowed))
        for path in found:
            (logs if path.suffix.lower() in log_suffixes() else yaml_files).append(path)
    faults += check_files(yaml_files)
    if logs:
        from missionsim.logs import check_log

        for path in logs:
            faults += check_log(path)
    faults = sorted(set(faults))
    errors = [fault for fault in faults if fault.severity == "error"]
    count = len(yaml_files) + len(logs)
    told = [dataclasses.asdict(fault) for fault in faults]
    to.emit({"schema": "missionsim.validation/1", "files": count, "valid": not errors, "faults": told})
    if to.json != "-":
        for fault in faults:
            print(fault, file=sys.stderr)
    if to.text:
        warnings = len(faults) - len(errors)
        numbers = ((count, "file"), (len(errors), "error"), (warnings, "warning"))
        read, *words = (counted(number, word) for number, word in numbers)
        print(f"{read}: " + (", ".join(words if warnings else words[:1]) if faults else "valid"))
    return 2 if errors else 0
