"""What the plan of a mission lets one expect: energy interval by interval, and the way home from each moment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.errors import InputError
from missionsim.physics import Array
from missionsim.runs.motion import distances

if TYPE_CHECKING:
    from missionsim.inputs.mission import MissionSpec


@dataclass(frozen=True)
class ExpectedRun:
    """What one battery should see: one row per interval of the plan."""

    duration_s: Array
    distance_m: Array
    energy_j: Array
    """All three: length, way driven and energy of each interval; a distance of 0 is standing or turning. Shape (n,)."""
    return_j: Array
    """Energy home from the start of each interval, and from the end of the last. Shape (n + 1,)."""

    def __post_init__(self) -> None:
        n = len(self.duration_s)
        if not (len(self.distance_m) == len(self.energy_j) == n and len(self.return_j) == n + 1 and n > 0):
            raise ValueError("an expected run needs n ≥ 1 durations, distances and energies, and n + 1 ways home")


def expected_run(mission: MissionSpec, battery: str) -> ExpectedRun:
    """Simulate a mission and give what one battery should see, with the way home from each moment.

    With an environment the way home is the shortest to the dock, as the engine finds it at the end of each segment,
    straight between. Without one it is back over the way driven, slopes reversed.

    Missions that recharge are refused: whether to go on is decided anew at each dock, by the charge that the charger
    really gave, so each stretch from dock to dock is a mission of its own. Raises InputError: for an unknown battery,
    and for missions that recharge on the way.
    """
    from missionsim.engine.simulate import simulate

    if battery not in mission.robot.batteries:
        raise InputError.unknown(f"no battery '{battery}'", battery, mission.robot.batteries)
    capacity = mission.robot.batteries[battery].capacity
    # the whole plan is wanted, also of a mission that the real battery cannot finish
    result = simulate(mission, values={f"robot.{capacity.path}": capacity.value * 1e6})
    if any(segment.kind == "dock" for segment in result.segments):
        raise InputError.single(
            "on-line prediction covers missions without recharging",
            got=result.mission,
            allowed="a mission for each stretch from dock to dock, with its own initial_charge",
        )
    line = result.timeline
    energy = np.asarray(np.sum(list(result.energies[battery].values()), axis=0), dtype=float)
    time = np.asarray(line.duration_s, dtype=float)
    distance = distances(line)
    homes = result.home_energy()
    if all(home.get(battery) is not None for home in homes):
        home_j = _homes_of_segments(mission, result, battery, homes)
    else:
        home_j = _back_over_the_way(mission, result, battery, distance)
    return ExpectedRun(time, distance, energy, home_j)


def _homes_of_segments(mission: Any, result: Any, battery: str, homes: list[dict[str, float | None]]) -> Array:
    """Energy home (J) at each interval's start and the mission's end, straight lines between ends of segments."""
    ends_s = [result.segment_end_s[index] for index in range(len(result.segments))]
    values = [3600.0 * float(home[battery] or 0.0) for home in homes]
    environment = mission.environment
    chargers = [name for name, place in environment.places.items() if place.charger is not None]
    docks = [mission.policy.dock] if mission.policy.dock else chargers or [mission.start]
    first = 0.0 if mission.start in docks else values[0]
    times = np.append(result.timeline.start_s, ends_s[-1])
    return np.asarray(np.interp(times, [0.0, *ends_s], [first, *values]), dtype=float)


def _back_over_the_way(mission: Any, result: Any, battery: str, distance: Array) -> Array:
    """Energy (J) of driving back what has been driven, with the same settings and the slopes reversed."""
    from dataclasses import replace

    from missionsim.effects.timeline import integrate
    from missionsim.inputs.power import build_power_model

    line = result.timeline
    columns = {**line.columns, "slope_rad": -np.asarray(line.columns["slope_rad"])}
    terms = integrate(build_power_model(mission.robot), replace(line, columns=columns))[battery]
    back = np.asarray(np.sum(list(terms.values()), axis=0), dtype=float)
    return np.concatenate([[0.0], np.cumsum(np.where(distance > 0.0, back, 0.0))])
