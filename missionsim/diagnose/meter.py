"""A meter that lags otherwise than the robot file says: a repair by itself, which leaves the model as it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from missionsim.diagnose.heldout import Models
from missionsim.diagnose.waterfall import METER, Step, by_chance, clearly_better, clearly_less, noise_floor, step_of
from missionsim.effects.model import PowerModel
from missionsim.fit.final import late_as_seen
from missionsim.fit.prepare import prepare
from missionsim.identify.findings import BatteryDiagnosis
from missionsim.numerals import meter_clock, rounded, watts
from missionsim.physics.lag import Meter
from missionsim.runs.run import Run


class Metered(NamedTuple):
    """A robot's own model, shown by the meter that the logs show."""

    model: PowerModel
    step: Step
    """Its errors."""
    meter: Meter
    was: Meter
    """As the file has it."""

    def told(self, before: Step, which: str) -> str:
        """In words, that the meter lags otherwise than the file says, and what that does; `which`: runs."""
        seen, file = (meter_clock(one.delay_s, one.lag_s) for one in (self.meter, self.was))
        late = "The meter lags" if sum(self.meter) > sum(self.was) else "The meter is not as late as the file says"
        had = f", where the file has {file}" if self.was != Meter() else ", and the file does not say so"
        return (
            f"{late}: {seen}{had}. The model itself may stay as it is: with that meter its power error on {which} "
            f"falls from {rounded(before.power_rmse_w)} to {watts(self.step.power_rmse_w)}."
        )


def metered(models: Models, runs: Sequence[Run], floor_pct: float) -> Metered | None:
    """The file's own model with the meter that the fitted runs show, if its power error on `runs` is clearly less.

    A late meter moves energy over the ends of a run alone: its energy error may be one that a true model shows by
    chance. `floor_pct`: mean of that over many runs [%].
    """
    if not (models.settings.align and runs):
        return None
    model, battery = models.power, models.battery
    late = late_as_seen(model, prepare(model, models.runs, battery), models.clock)
    if late.meter(battery) == model.meter(battery):
        return None
    before, step = (step_of(METER, models.errors(one, runs)) for one in (model, late))
    most_pct = max(before.energy_error_pct, by_chance(floor_pct, len(runs))[1])
    if not clearly_less(step, before) or step.energy_error_pct > most_pct:
        return None
    return Metered(late, step, late.meter(battery), model.meter(battery))


def base_is_off(before: Step, recalibrated: Step, late: Metered | None, most_pct: float) -> bool:
    """Whether a base fitted anew is clearly better than the file as it was, and by more than the meter alone makes it.

    `most_pct`: energy error that a true model shows by chance [%].
    """
    if late is None or not clearly_better(recalibrated, before):
        return clearly_better(recalibrated, before)
    return clearly_less(recalibrated, late.step) or late.step.energy_error_pct > most_pct


def with_meter(found: BatteryDiagnosis, models: Models, held: Sequence[Run]) -> BatteryDiagnosis:
    """The same diagnosis with what the meter alone would mend, where nothing else is missing or off."""
    if found.effects or found.proposed_laws:
        return found
    runs, floor_pct = held or models.runs, noise_floor(found)[0]
    if (late := metered(models, runs, floor_pct)) is None:
        return found
    given, base = (step_of("", models.errors(one, runs)) for one in (models.power, models.fit(()).model))
    # on the runs that it is fitted to, a base fitted anew is always better
    if held and base_is_off(given, base, late, by_chance(floor_pct, len(runs))[1]):
        return found
    return replace(found, meter=late.told(given, "runs not used" if held else "these runs"))
