"""Alternatives of a mission, each a full run, as differences to a baseline."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from missionsim.effects.model import PowerModel
from missionsim.engine.outcome import RunResult
from missionsim.engine.simulate import simulate
from missionsim.errors import Fault, InputError
from missionsim.files import Json, PathLike, fields_of
from missionsim.inputs.loading import load_mission, load_study, remembered
from missionsim.inputs.overrides import route
from missionsim.inputs.power import build_power_model
from missionsim.workers import interrupts_held, process_pool

SCHEMA = "missionsim.whatif/1"
BASELINE = "baseline"
MOST_ALTERNATIVES = 100_000
COLUMNS = (
    *("alternative", "set", "robot", "feasible", "reason", "duration_s", "difference_s", "battery", "term"),
    *("energy_wh", "difference_wh", "charge_left_wh", "margin_wh", "deficit_wh"),
)
"""Of the table."""


@dataclass(frozen=True)
class Alternative:
    """A name, what it sets on the mission, and perhaps another robot."""

    name: str
    set: tuple[tuple[str, Any], ...] = ()
    robot: str | None = None
    title: str = ""


@dataclass(frozen=True)
class WhatIf:
    """A baseline and its alternatives, run."""

    mission: str
    """Name of the mission."""
    alternatives: tuple[Alternative, ...]
    """The baseline first."""
    results: tuple[RunResult | tuple[Fault, ...], ...]
    """Of each, in the same order, with the totals of segments in place of intervals; of one that is impossible, why."""
    warnings: tuple[Fault, ...] = ()
    """What the checks of their files found strange but possible, each once."""

    @cached_property
    def batteries(self) -> tuple[str, ...]:
        """Batteries of any of the runs, in order."""
        return tuple(dict.fromkeys(name for result in self.runs for name in result.batteries))

    @cached_property
    def runs(self) -> list[RunResult]:
        """Results of the alternatives that are possible; the baseline is."""
        return [result for result in self.results if isinstance(result, RunResult)]

    def rows(self) -> list[Json]:
        """One mapping an alternative: values, and differences to the baseline, by battery and by term.

        `difference_…` is the alternative less the baseline; `difference_pct` relative to the baseline; `margin_wh` the
        charge left less the reserve to keep. An alternative that is impossible has no batteries, and `reason` says why.
        """
        base = self.runs[0]
        rows = []
        for alternative, result in zip(self.alternatives, self.results, strict=True):
            batteries: dict[str, Any] = {}
            own: Json = {"name": alternative.name, "title": alternative.title, "set": dict(alternative.set)}
            if not isinstance(result, RunResult):
                why = "; ".join(fault.message + (f" ({fault.got})" if fault.got else "") for fault in result)
                nothing = dict.fromkeys(("robot", "duration_s", "difference_s", "distance_m"))
                told = {"feasible": False, "reason": f"impossible: {why}", **nothing}
                rows.append({**own, **told, "batteries": batteries})
                continue
            for name in self.batteries:
                now, before = result.batteries.get(name), base.batteries.get(name)
                energy, reference = (0.0 if one is None else one.energy_wh for one in (now, before))
                terms, old = (run.by_term_wh(name) if name in run.batteries else {} for run in (result, base))
                names = "charge_left_wh charge_left_fraction reserve_wh empty_at_s deficit_wh"
                given = dict.fromkeys(names.split()) if now is None else fields_of(now, names)
                batteries[name] = {
                    "energy_wh": energy,
                    "difference_wh": energy - reference,
                    "difference_pct": 100.0 * (energy - reference) / reference if reference else None,
                    **{key: given.pop(key) for key in names.split()[:3]},
                    "margin_wh": now.charge_left_wh - now.reserve_required_wh if now else None,
                    **given,
                    "by_term_wh": terms,
                    "difference_by_term_wh": {
                        term: terms.get(term, 0.0) - old.get(term, 0.0) for term in dict.fromkeys([*old, *terms])
                    },
                }
            own |= fields_of(result, "robot feasible") | {"reason": result.reason or None}
            own |= {"duration_s": result.duration_s, "difference_s": result.duration_s - base.duration_s}
            rows.append({**own, "distance_m": result.distance_m, "batteries": batteries})
        return rows

    def to_json(self) -> Json:
        """Schema ``missionsim.whatif/1``; the first of the alternatives is the baseline."""
        return {
            "schema": SCHEMA,
            "mission": self.mission,
            "baseline": self.alternatives[0].name,
            "alternatives": self.rows(),
        }

    def table(self) -> dict[str, list[object]]:
        """One tidy table: a row an alternative, battery and term; `term` is ``total`` for the sum."""
        rows: list[dict[str, Any]] = []
        for row in self.rows():
            setting = "; ".join(f"{path}={value}" for path, value in row["set"].items())
            own = {**row, "alternative": row["name"], "set": setting, "reason": row["reason"] or ""}
            if not row["batteries"]:
                rows.append(own)
            for battery, b in row["batteries"].items():
                terms = {"total": (b["energy_wh"], b["difference_wh"])}
                terms |= {term: (b["by_term_wh"].get(term, 0.0), d) for term, d in b["difference_by_term_wh"].items()}
                rows += [
                    {**own, **b, "battery": battery, "term": term, "energy_wh": energy, "difference_wh": difference}
                    for term, (energy, difference) in terms.items()
                ]
        return {name: [row.get(name) for row in rows] for name in COLUMNS}


def varied(
    vary: Iterable[tuple[str, Sequence[object]]], base: Sequence[tuple[str, object]] = (), robot: str | None = None
) -> list[Alternative]:
    """Every combination of varied values, each on top of what the baseline sets. `base`: what the baseline sets;
    `robot`: the one that all have. Raises InputError: for more combinations than `MOST_ALTERNATIVES`."""
    pairs = list(vary)
    names = [path for path, _ in pairs]
    if twice := [path for path in dict.fromkeys(names) if names.count(path) > 1]:
        raise InputError.single(
            "varied more than once; only the last would hold", got=", ".join(twice), allowed="all values in one --vary"
        )
    count = math.prod(len(values) for _, values in pairs)
    if count > MOST_ALTERNATIVES:
        raise InputError.single(
            f"{count} alternatives", got=", ".join(path for path, _ in pairs), allowed=f"at most {MOST_ALTERNATIVES}"
        )
    made = []
    for combination in itertools.product(*(values for _, values in pairs)):
        chosen = tuple(zip((path for path, _ in pairs), combination, strict=True))
        name = ", ".join(f"{_short(path)}={value}" for path, value in chosen)
        made.append(Alternative(name, (*base, *chosen), robot))
    return made


def from_study(path: PathLike) -> tuple[Path, list[Alternative]]:
    """Mission and alternatives of a study file, the baseline first."""
    study = load_study(path)
    base = tuple(study.baseline.items())
    folder = Path(path).parent

    def own(reference: str | None) -> str | None:
        near = None if reference is None else folder / reference
        return str(near) if near is not None and near.is_file() else reference

    made = [Alternative(BASELINE, base, own(study.robot))]
    for name, spec in study.alternatives.items():
        robot = own(study.robot if spec.robot is None else spec.robot)
        made.append(Alternative(str(name), (*base, *spec.set.items()), robot, spec.title))
    if study.vary:
        made += varied(study.vary.items(), base, own(study.robot))
    return folder / study.mission, made


def run_alternatives(
    mission: PathLike, alternatives: Sequence[Alternative], done: Callable[[], object] = lambda: None, workers: int = 1
) -> WhatIf:
    """Run every alternative in full.

    `mission`: mission file; `alternatives`: the baseline first; `done`: called without arguments after each run (a
    progress bar); `workers`: processes on this machine. Raises InputError: all faults of all alternatives, where the
    baseline or every other one is impossible.
    """
    size = max(1, min(_AT_ONCE, -(-len(alternatives) // workers)))
    parts = [alternatives[i : i + size] for i in range(0, len(alternatives), size)]
    faults: list[Fault] = []
    results: list[RunResult | tuple[Fault, ...]] = []
    warnings: list[Fault] = []

    def take(tried: Iterable[_Tried]) -> None:
        for result, found, told in tried:
            faults.extend(found)
            warnings.extend(told)
            results.append(tuple(found) if result is None else result)
            done()

    if workers > 1 and len(parts) > 1:
        with process_pool(min(workers, len(parts))) as pool, interrupts_held():
            futures = [pool.submit(_run_part, mission, part) for part in parts]
            for future in futures:
                take(future.result())
    else:
        take(_tried(mission, alternatives))
    first, *others = results
    if not isinstance(first, RunResult) or (faults and not any(isinstance(item, RunResult) for item in others)):
        raise InputError(faults)
    return WhatIf(first.mission, tuple(alternatives), tuple(results), tuple(dict.fromkeys(warnings)))


_AT_ONCE = 50
"""Alternatives that a worker process runs before it gives them back."""
_Tried = tuple[RunResult | None, Sequence[Fault], Sequence[Fault]]


def _run_part(mission: PathLike, alternatives: Sequence[Alternative]) -> list[_Tried]:
    return list(_tried(mission, alternatives))


def _tried(mission: PathLike, alternatives: Sequence[Alternative]) -> Iterator[_Tried]:
    """Result (its totals by segment), faults and warnings of each alternative."""
    models: dict[int, PowerModel] = {}  # of robots without change, which are remembered: their identity stays their own
    with remembered():
        for alternative in alternatives:
            try:
                spec = load_mission(mission, list(alternative.set), alternative.robot)
                model = models.get(id(spec.robot)) or build_power_model(spec.robot)
                if not route(alternative.set)["robot"]:
                    models[id(spec.robot)] = model
                result = simulate(spec, model=model)
            except InputError as problem:
                yield None, problem.faults, ()
            else:
                yield result.totals(), (), (*spec.warnings, *result.warnings)


_SAYS_LITTLE = ("drive", "loads", "parameters")
"""Steps of a path that stand in the paths of every segment, component and battery."""


def _short(path: str) -> str:
    """The telling end of a path: its last word and the name that it belongs to, so that two alternatives differ."""
    parts = path.split(".")
    if len(parts) == 1 or parts[0] == "defaults":
        return parts[-1]
    first = len(parts) - 2
    while first > 0 and (parts[first].isdigit() or parts[first] in _SAYS_LITTLE):
        first -= 1
    return ".".join(part for part in parts[first:] if part not in _SAYS_LITTLE)
