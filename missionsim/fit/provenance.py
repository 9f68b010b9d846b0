"""Where fitted numbers come from: short hashes of the logs, kept in the robot file and recognised again."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from missionsim.files import Json
from missionsim.labels import Labels
from missionsim.runs.covariates import COVARIATES

if TYPE_CHECKING:
    from missionsim.effects.model import ModelParameter
    from missionsim.runs.run import Run

MOST_HASHES = 2_000
"""Runs that a robot file names; a text in a file has at most 20,000 characters."""
LENGTH = 8
CALIBRATION = "calibration"
"""Key of a robot file's ``sources`` that says to which logs its parameters were fitted."""


OTHER_DAY_SD = 0.03
"""Relative change of a fitted parameter from the logs that it was fitted to, to others: meter, tyres, warmth, load of
the computer. The same as for a parameter that comes without a standard deviation (assumed)."""
_TAG = re.compile(r"\bdata ((?:[0-9a-f]{8}\s?)+)")


def log_hash(log: Run) -> str:
    """SHA-256 of a log's file, or of its power where it was made in memory; 64 hexadecimal digits."""
    if log.sha256:
        return str(log.sha256)
    digest = hashlib.sha256()
    for battery in sorted(log.power_w):
        digest.update(log.power_w[battery].tobytes())
    return digest.hexdigest()


def data_tag(logs: Sequence[Run]) -> str:
    """The first digits of the hashes of the logs, one a run; beyond `MOST_HASHES` runs the lowest of them, of which any
    larger part of the runs holds one."""
    return " ".join(digest[:LENGTH] for digest in sorted(map(log_hash, logs))[:MOST_HASHES])


def fitted_source(logs: Sequence[Run]) -> str:
    """What a robot file says of numbers that were fitted to some logs."""
    return f"fitted to {len(logs)} run{'s' * (len(logs) != 1)}, data {data_tag(logs)}"


def as_fitted(parameter: ModelParameter, value: float, sd: float) -> Json:
    """A fitted value as its file has it: of one unit, where the model has all units of a component."""
    return {
        "value": value / parameter.times,
        "sd": sd / parameter.times,
        "status": "fitted",
        "source": CALIBRATION,
        # what stands beside it in the file may be in another unit
        "note": f"{parameter.value / parameter.times:.6g} {parameter.unit} before".replace(" 1 ", " "),
    }


def fitted_to(source: str, logs: Iterable[Run]) -> bool:
    """Whether a parameter's source says that it was fitted to one of these very logs.

    Such a number is no knowledge beside the logs: as a prior it would count the same data twice.
    """
    match = _TAG.search(source)
    if not match:
        return False
    known = set(match.group(1).split())
    hashes = sorted(map(log_hash, logs))
    # files of before have one hash for all runs where these were more than 40
    of_all = hashlib.sha256("".join(hashes).encode()).hexdigest()
    return not known.isdisjoint(digest[:LENGTH] for digest in (*hashes, of_all))


def sd_on_other_logs(sd: float, source: str) -> float:
    """Relative standard deviation of a parameter for logs that it was not fitted to.

    What `calibrate` writes is how well the average over its own logs is known. On another day the robot is not quite
    the same, so that `OTHER_DAY_SD` adds to it; else drift would pass for a missing effect. `sd`: as the robot file has
    it. `source`: what the file says of where the number comes from; others than fits keep their sd.
    """
    return math.hypot(sd, OTHER_DAY_SD) if _TAG.search(source) else sd


def ranges_of(runs: Sequence[Run], origin: Json | None = None) -> Json:
    """Least and greatest value of each covariate over runs, in units of the glossary; the names of floors. `origin`: of
    a robot file, whose ranges they join."""
    found: Json = dict((origin or {}).get("range", {}))
    for name in (name for name in COVARIATES if name != "heading_rad"):  # an angle has no range
        columns = [run.columns[name] for run in runs if name in run.columns]
        before = found.get(name, [])
        if name == "surface" and columns:
            floors = {text for one in columns if isinstance(one, Labels) for text in one.names}
            found[name] = sorted(floors.union(before))
        numbers = [one[np.isfinite(one)] for one in columns if not isinstance(one, Labels)]
        values = np.concatenate(numbers) if numbers else np.zeros(0)
        if len(values):
            values = np.append(values, np.asarray(before, dtype=float))
            found[name] = [float(f"{limit:.4g}") for limit in (np.min(values), np.max(values))]
    return found


def short_of(text: str, battery: str, logs: Sequence[Run]) -> Iterator[str]:
    """In words, what the robot of a file can do less than the one that was logged."""
    from missionsim.inputs.loading import robot_from_text

    spec = robot_from_text(text)
    top, held_wh = spec.body.max_speed.value, spec.batteries[battery].capacity_wh
    speeds = [np.abs(log.number("speed_m_s")) for log in logs if "speed_m_s" in log.columns]
    fastest = max((float(np.nanmax(speed)) for speed in speeds), default=0.0)
    most_wh = max(log.energy_wh(battery) for log in logs if battery in log.power_w)
    if top < 0.9 * fastest:
        yield f"the top speed, {top:.3g} m/s, is below the {fastest:.3g} m/s of the logs"
    if held_wh < most_wh:
        yield f"the capacity, {held_wh:.3g} Wh, is less than the {most_wh:.3g} Wh that one of the runs took"
