"""The result of a comparison: numbers per battery and run, where the error arises, and the contract's JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from missionsim.compare.axes import PlaceCell
from missionsim.compare.behaviour import STATISTICS, MissionGap
from missionsim.compare.where import Dependence, Series, Where, in_words, ranked
from missionsim.effects.model import TermKey
from missionsim.files import Json, fields_of, sha256
from missionsim.numerals import in_wh, watts
from missionsim.physics import Array
from missionsim.runs.error import Errors, ErrorStatistics, RunError

SCHEMA = "missionsim.comparison/1"
WHERE_IN_JSON = 200
"""Values listed in the JSON, those that explain most first."""


@dataclass(frozen=True, kw_only=True)
class RunComparison(RunError):
    """One battery over one run."""

    battery: str
    error_statistics: ErrorStatistics
    """Of the energy error over the run's progress (share of its time)."""
    progress: Array = field(repr=False)
    error_curve_pct: Array = field(repr=False)
    """Both: the signed error over progress, relative to measured. Shape (m,)."""
    series: Series = field(repr=False)
    """Power over time."""
    by_term_wh: Mapping[TermKey, float] = field(repr=False)
    """Modelled energy."""

    def to_json(self) -> Json:
        """The contract's fields and ours beside them."""
        names = "run energy_error_pct power_rmse_w power_bias_w seconds energy_measured_wh energy_model_wh"
        return fields_of(self, f"{names} error_statistics")


def thousandfold(measured: float, model: float) -> str:
    """Whether two positive numbers are some three powers of ten apart, as milliwatts and kilowatts are from watts."""
    if measured <= 0.0 or model <= 0.0:
        return ""
    ratio = measured / model
    return "1,000 times" if 300 < ratio < 3000 else "1/1,000" if 300 < 1 / ratio < 3000 else ""


@dataclass(frozen=True, kw_only=True)
class BatteryComparison(RunError):
    """One battery over all runs, which count as one."""

    battery: str
    runs: tuple[RunComparison, ...]
    error_statistics: ErrorStatistics
    error_statistics_predicted: ErrorStatistics
    """Both: of the energy error of all runs together at equal progress, relative to measured and to predicted
    energy."""
    progress: Array = field(repr=False)
    error_curve_pct: Array = field(repr=False)
    """Both: the signed error over progress, relative to measured. Shape (m,)."""
    dependences: tuple[Dependence, ...] = field(repr=False)
    """Along what the error varies, strongest first."""
    places: tuple[PlaceCell, ...] = field(default=(), repr=False)
    """Sums per cell of the map; empty without a pose."""
    mission: MissionGap | None = None
    """The gap between measured and simulated mission, split."""

    @property
    def run_energy_error_pct(self) -> float:
        """Mean over runs of the magnitude of the energy error [%], as `diagnose` and `improve` print it."""
        return Errors(self.runs).run_energy_error_pct

    @property
    def worst_first(self) -> list[RunComparison]:
        """The runs by the magnitude of their energy error, those that measured none last."""
        off = {run.run: abs(run.energy_error_pct) for run in self.runs}
        return sorted(self.runs, key=lambda run: -off[run.run] if math.isfinite(off[run.run]) else math.inf)

    @property
    def by_component_wh(self) -> dict[str, float]:
        """Modelled energy by component, largest first [Wh]."""
        return self._by("{0.component}")

    @property
    def by_term_wh(self) -> dict[str, float]:
        """Modelled energy by term, largest first [Wh]."""
        return self._by("{0.component}.{0.name}")

    def _by(self, form: str) -> dict[str, float]:
        totals: dict[str, float] = {}
        for run in self.runs:
            for key, energy in run.by_term_wh.items():
                name = form.format(key)
                totals[name] = totals.get(name, 0.0) + energy
        return dict(sorted(totals.items(), key=lambda item: -abs(item[1])))

    @property
    def where(self) -> list[Where]:
        """Values of covariates, those that explain most of the error first."""
        return ranked(self.dependences)

    @property
    def gap_wh(self) -> dict[str, float | None]:
        """Measured minus simulated energy (measured minus replayed without a mission), and its two parts [Wh]."""
        power_model = self.energy_measured_wh - self.energy_model_wh
        if self.mission is None:
            return {"total": power_model, "behaviour": None, "power_model": power_model}
        behaviour = self.mission.behaviour_wh
        return {"total": power_model + behaviour, "behaviour": behaviour, "power_model": power_model}

    @property
    def words(self) -> list[str]:
        """The verdict in sentences."""
        error = self.energy_error_pct
        off, bias = watts(self.power_rmse_w), watts(self.shown_bias_w, sign=True)
        power = f"its power is off by {off} (root mean square), {bias} on average."
        if math.isfinite(error) and self.energy_measured_wh > 0.0:
            way = "more" if error > 0.0 else "less"
            count = f"{len(self.runs)} runs" if len(self.runs) > 1 else "one run"
            gives = f"{abs(error):.1f} % {way} energy than was" if abs(error) >= 0.05 else "the energy that was"
            each = f" (single runs are off by {self.run_energy_error_pct:.1f} % on average)" * (len(self.runs) > 1)
            first = f"Over {count} the model gives {gives} measured on battery {self.battery}{each}; {power}"
            if factor := thousandfold(self.energy_measured_wh, self.energy_model_wh):
                first += f" Measured is about {factor} of modelled: is the meter's unit the watt?"
        elif math.isfinite(error):
            first = (
                f"Battery {self.battery} was charged by {in_wh(-self.energy_measured_wh)} Wh in all, if the sign is "
                f"right: what it delivers is positive. Against the model {power}"
            )
        else:
            first = f"No energy was measured on battery {self.battery}."
        middle = [] if self.mission is None else self.mission.words
        return [first.replace("-", "−"), *middle, *in_words(self.dependences)]

    def to_json(self) -> Json:
        """The contract's fields and ours beside them."""
        names = "energy_measured_wh energy_model_wh energy_error_pct run_energy_error_pct power_rmse_w power_bias_w"
        data = fields_of(self, f"{names} gap_wh {STATISTICS} per_run=runs") | {
            "where": [where.to_json() for where in self.where[:WHERE_IN_JSON]],
            "depends_on": [fields_of(one, "by explains=explained") for one in self.dependences if one.explained > 0.0],
            **fields_of(self, "model_by_component_wh=by_component_wh model_by_term_wh=by_term_wh words"),
        }
        if self.mission is not None:
            data["mission"] = self.mission.to_json()
        return data


@dataclass(frozen=True)
class Comparison:
    """Model against measurements."""

    robot: str
    runs: tuple[str, ...]
    batteries: Mapping[str, BatteryComparison]
    notes: tuple[str, ...] = ()
    """What was assumed, left out or skipped, and the remarks of the log checks."""
    logs: tuple[tuple[str, str], ...] = ()
    """Tuple of (run, source file)."""
    rows: int = 0
    """Rows of all logs."""
    mission: str = ""
    """Name of the mission, empty without one."""
    left_out: tuple[str, ...] = ()
    """Runs that are not compared, and why: refused by the checks, copies, or unlike all others by a fault of the
    log."""

    def within(self, tolerance_pct: float) -> bool:
        """Whether the energy error of every battery is within ± `tolerance_pct`."""
        return all(abs(one.energy_error_pct) <= tolerance_pct for one in self.batteries.values())

    def to_json(self) -> Json:
        """The contract's ``missionsim.comparison/1``."""
        return {
            "schema": SCHEMA,
            "robot": self.robot,
            "mission": self.mission or None,
            **fields_of(self, "runs batteries notes left_out rows"),
            "logs": [{"run": run, "file": file, "sha256": sha256(file) if file else None} for run, file in self.logs],
        }
