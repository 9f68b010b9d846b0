"""Runs that do not follow the robot as the others do, and the fault in their log that explains it.

Each run is held against what all others say of it: the levels of their power against the model, and a regression of
measured less modelled power on what is logged, within runs. What a known fault of a log undoes is named by that fault.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

from missionsim.effects.covariates import is_moving
from missionsim.effects.model import PowerModel
from missionsim.errors import InputError
from missionsim.glossary import column_of
from missionsim.labels import Labels
from missionsim.physics import Array, Int64s
from missionsim.runs.alike import FEWEST, as_near
from missionsim.runs.covariates import is_switch, may_be_cause
from missionsim.runs.drive import Driven, drive, filled
from missionsim.runs.run import Run, mended

FEWEST_LEVELS = 5
"""Runs whose levels can say what is usual."""
OFFSET, SCATTER = 0.06, 6.0
"""An offset of one run is told from this part of the mean power on, and this many deviations of all runs (assumed)."""
LOADS = ("cpu_load", "cpu_freq_hz", "access_point_distance_m")
"""Columns of the glossary that may say why one run takes more than the others at rest and in motion alike."""
ROUGHER, RESTORED = 1.4, 1.2
"""Scatter of a run about what the others say of it, in times theirs, from which on a fault is looked for, and within
which one explains it (assumed)."""
GAINS = 1.5
"""Gain of a run, in times the largest of the others (floors and loads have one too), from which its meter is odd."""
MENDS = 0.6
"""Scatter of a run after what mends it, in times that before (assumed)."""
RELATED, UNRELATED = 0.6, 0.1
"""Part of its power that follows the others' law in the usual run at least, and in times that of the usual run, below
which a run has nothing to do with them."""
APART = 2.5
"""Distance of two groups of levels, in times the width of the wider, from which the fewer are odd (assumed)."""
BANDS, LEAST_ROWS = 12, 15
"""Bands of a load or temperature in which runs are held against each other, and rows that each must have there."""
ROWS = 4000
"""Rows of each run that a regression looks at."""
LEAST_MAGNITUDES, MOTION = 30, ("speed_m_s", "yaw_rate_rad_s")
"""Steps of the fit by least magnitudes; what robots draw more by, whatever they are."""


class Usual:
    """What runs draw by speed and turn rate, whatever a model says: least magnitudes, which no run of another unit
    leads."""

    def __init__(self, runs: Sequence[Run], battery: str) -> None:
        self.battery = battery
        kept = [(self.columns(run), run.power_w[battery], slice(None, None, 1 + run.rows // ROWS)) for run in runs]
        rows = np.concatenate([columns[keep] for columns, _, keep in kept])
        watts = np.concatenate([power[keep] for _, power, keep in kept])
        weight = np.concatenate([np.full(len(power[keep]), 1.0 / len(power[keep])) for _, power, keep in kept])
        least = 1e-3 * float(np.median(np.abs(watts))) + 1e-12
        ridge, own = 1e-9 * np.diag((rows**2).T @ weight + 1e-12), weight
        for _ in range(LEAST_MAGNITUDES):
            self.watts = np.linalg.solve((rows.T * own) @ rows + ridge, (rows.T * own) @ watts)
            own = weight / np.maximum(np.abs(watts - rows @ self.watts), least)

    def columns(self, run: Run) -> Array:
        """One, moving, speed, its square, turn rate; shape (n, 5)."""
        cov = filled(run, [self.battery])
        speed, turn = (np.abs(np.asarray(cov.get(name, np.zeros(run.rows)))) for name in MOTION)
        return np.column_stack([np.ones(run.rows), is_moving(cov), speed, speed**2, turn])

    def ratio(self, run: Run) -> float:
        """Measured energy of a run in times that of the others at its speeds; not a number where that is none."""
        usual_j = float((self.columns(run) @ self.watts) @ run.dt_s)
        return float(run.power_w[self.battery] @ run.dt_s) / usual_j if usual_j else float("nan")

    @classmethod
    def drawn(cls, runs: Sequence[Run], doubtful: Collection[str], battery: str, factor: float) -> set[str]:
        """Doubtful runs that draw, within a factor, what the others do at such speeds and turns."""
        moved = [run for run in runs if "speed_m_s" in run.columns and run.rows]
        agree = [run for run in moved if run.run not in doubtful]
        if len(agree) < FEWEST:
            return set()
        usual = cls(agree, battery)
        return {run.run for run in moved if run.run in doubtful and 1.0 / factor < usual.ratio(run) < factor}


class Others:
    """What the other runs say of each: a regression of measured less modelled power, within runs; on what is `carried`
    as well if asked."""

    def __init__(self, runs: Sequence[Driven], battery: str, *, carried: bool = False) -> None:
        self.runs, self.battery, self.carried = runs, battery, carried
        shared = set.intersection(*({*one.run.columns} for one in runs))
        self.loads = sorted(
            name
            for name in shared
            if not any(isinstance(one.run.columns[name], Labels) for one in runs)
            and (is_switch(name) or name in LOADS or (column_of(name) is None and may_be_cause(name)))
        )
        self.rows = [self.columns(one) for one in runs]
        self.designs = [self.centred(one, rows) for one, rows in zip(runs, self.rows, strict=True)]
        self.gram = np.array([rows.T @ rows for rows, _ in self.designs])
        self.towards = np.array([rows.T @ gap for rows, gap in self.designs])
        self.left = np.ones(len(runs), dtype=bool)
        self.learn()

    def learn(self) -> None:
        """What all say that are left, and how far each is from what the rest says."""
        self.expected: list[Array] = []
        """Coefficients from all runs but one, shape (p,)."""
        for number in range(len(self.runs)):
            rest = self.left & (np.arange(len(self.runs)) != number)
            gram, towards = self.gram[rest].sum(axis=0), self.towards[rest].sum(axis=0)
            size = np.sqrt(np.maximum(np.diag(gram), 1e-12))
            scaled = gram / np.outer(size, size) + 1e-3 * np.eye(len(size))
            self.expected.append(np.asarray(np.linalg.solve(scaled, towards / size) / size))
        left = [gap - rows @ own for (rows, gap), own in zip(self.designs, self.expected, strict=True)]
        self.scatter = np.array([float(np.std(one)) for one in left])

    def columns(self, driven: Driven) -> Array:
        """What power may depend on, shape (n, p)."""
        cov = driven.covariates
        zero = np.zeros(len(driven.time_s))
        speed = np.abs(np.asarray(cov["speed_m_s"])) if "speed_m_s" in cov else zero
        accel, slope, yaw = (
            np.asarray(cov[name]) + zero if name in cov else zero
            for name in ("accel_m_s2", "slope_rad", "yaw_rate_rad_s")
        )
        yaw = np.abs(yaw)
        loads = [np.nan_to_num(np.asarray(cov[name], dtype=float) + zero) for name in self.loads]
        if self.carried and "payload_kg" in cov:
            loads.append(np.nan_to_num(np.asarray(cov["payload_kg"]) + zero) * speed)
        return np.column_stack(
            [speed, speed**2, yaw, yaw**2, accel * speed, np.maximum(accel, 0.0) * speed, slope * speed, *loads]
        )

    def centred(self, driven: Driven, rows: Array) -> tuple[Array, Array]:
        """Columns and measured less modelled power about their means at rest and in motion; (m, p) and (m,)."""
        gap = driven.measured_w[self.battery] - driven.model_w[self.battery]
        moving = np.asarray(is_moving(driven.covariates)) & np.ones(len(gap), dtype=bool)
        keep = slice(None, None, 1 + len(gap) // ROWS)
        rows, gap, moving = rows[keep].copy(), gap[keep], moving[keep]
        for group in (moving, ~moving):
            if group.any():
                rows[group] -= rows[group].mean(axis=0)
                gap[group] -= gap[group].mean()
        return rows, gap

    def residual(self, number: int, driven: Driven) -> float:
        """Scatter of a run, as logged or mended, about what the others say of it [W]."""
        rows, gap = self.centred(driven, self.columns(driven))
        return float(np.std(gap - rows @ self.expected[number]))

    def beside(self, number: int) -> Array:
        """Measured power less what model and others say [W], shape (n,)."""
        return np.asarray(self.runs[number].measured_w[self.battery] - self.said(number))

    def said(self, number: int) -> Array:
        """What model and others say of a run but for a constant [W], shape (n,)."""
        return np.asarray(self.runs[number].model_w[self.battery] + self.rows[number] @ self.expected[number])

    def late(self, number: int) -> int:
        """Rows by which a run's power comes after what the others say of it."""
        lags, along = correlation(self.runs[number].measured_w[self.battery], self.said(number))
        return int(lags[int(np.argmax(along))])


def runs_beside(others: Others, model: PowerModel) -> dict[str, str]:
    """Runs that scatter more than the others, and what explains it; `others` learns from the rest alone then."""
    found: dict[str, str] = {}
    # part of the variance of each run's power that what the others say of it explains
    follows = np.zeros(len(others.runs))
    for i, one in enumerate(others.runs):
        measured, said = one.measured_w[others.battery], others.said(i)
        if np.ptp(measured) > 0.0 < np.ptp(said):
            follows[i] = float(np.corrcoef(measured, said)[0, 1]) ** 2
    for i in np.argsort(-others.scatter).tolist():
        # the roughest first, and what it says taken from what is held against the next
        if others.left.sum() < FEWEST_LEVELS or others.scatter[i] <= ROUGHER * np.median(others.scatter[others.left]):
            break
        others.left[i] = False
        others.learn()
        told = _fault(others, i, model)
        if not told and follows[i] < UNRELATED * float(np.median(follows)) and np.median(follows) > RELATED:
            told = (
                f"power_{others.battery}_w does not follow what the robot does as in the other runs: rows in another "
                "order, a column that hangs, another robot?"
            )
        if told:
            found[others.runs[i].run.run] = told
        else:
            others.left[i] = True
            others.learn()
    return _stuck(others, model) | found


def _stuck(others: Others, model: PowerModel) -> dict[str, str]:
    """Runs in which a switch has one value, and the power lies beside the others by what the component draws."""
    runs, battery = others.runs, others.battery
    beside = np.array([np.median(others.beside(i)) for i in range(len(runs))])
    beside -= np.median(beside)
    least = SCATTER * 1.4826 * float(np.median(np.abs(beside)))
    found: dict[str, str] = {}
    for name in sorted({name for one in runs for name in one.run.columns if is_switch(name)}):
        states = [one.run.number(name) if name in one.run.columns else np.zeros(0) for one in runs]
        usual = float(np.median([state.mean() for state in states if len(state)]))
        for one, state, level in zip(runs, states, beside, strict=True):
            if not len(state) or np.ptp(state) > 0.0 or abs(state[0] - usual) < 0.5 or abs(level) < least:
                continue
            other = {**one.run.columns, name: np.full(one.run.rows, np.round(usual))}
            watts = drive(model, replace(one.run, columns=other), battery).model_w[battery] - one.model_w[battery]
            if np.median(watts) and 0.7 < level / float(np.median(watts)) < 1.3:
                found[one.run.run] = (
                    f"{name} is {state[0]:g} in every row, and power_{battery}_w lies {level:+.2g} W beside the other "
                    f"runs, as if it were {np.round(usual):g}"
                )
    return found


def _fault(others: Others, number: int, model: PowerModel) -> str:
    """The fault of a log that explains best why a run scatters more than the others; empty where none does."""
    one, battery = others.runs[number], others.battery
    tried: list[tuple[float, str]] = []
    measured, said = one.measured_w[battery], others.said(number)
    scale, offset = np.polyfit(said, measured, 1).tolist() if np.ptp(said) > 0.0 else (1.0, 0.0)
    # a load that is carried scales what is needed in motion, a meter what is needed at rest too; the other runs that
    # are left have a gain of their own
    gains = {}
    for i in np.flatnonzero(others.left).tolist():
        if i != number and np.ptp(own := others.said(i)) > 0.0:
            gain = float(np.polyfit(own, others.runs[i].measured_w[battery], 1)[0])
            gains[others.runs[i].run.run] = float(np.log(max(gain, 1e-3)))
    alone = scale > 0.0 and abs(np.log(scale)) > max(0.1, GAINS * max(map(abs, gains.values()), default=0.0))
    if alone:  # on a hot day all of it may be less, as it is on a warm one
        fair = [other.run for other in others.runs if other.run.run in gains]
        alone = not as_near(one.run, fair, gains | {one.run.run: float(np.log(scale))})
    if alone and abs(offset) < 0.3 * abs(scale - 1.0) * float(np.mean(said)):
        evened = replace(one, measured_w={**one.measured_w, battery: measured / scale})
        tried.append(
            (others.residual(number, evened), f"power_{battery}_w is {scale:.3g} times that of the other runs")
        )
    late = others.late(number)
    # a meter that holds its value is late in every run
    usually = float(np.median([others.late(int(i)) for i in np.flatnonzero(others.left)]))
    if abs(late - usually) > max(1.0, abs(usually)):
        rows = slice(late, None) if late > 0 else slice(None, late)
        moved = np.std((measured - np.roll(said, late))[rows])
        seconds = late * float(np.median(one.dt_s))
        tried.append((float(moved), f"power_{battery}_w lies {seconds:+.3g} s beside what the robot does"))
    for words, run in mended(one.run, [other.run for other in others.runs if other is not one]):
        try:
            tried.append((others.residual(number, drive(model, run, battery)), words))
        except InputError:
            continue
    tried += _unlogged_switching(others, number, model)
    best = min(tried, default=(np.inf, ""))
    rest = others.scatter[others.left]
    usual = max(RESTORED * float(np.median(rest)), float(np.quantile(rest, 0.75)))
    return best[1] if best[0] < min(usual, MENDS * others.scatter[number]) else ""


def _unlogged_switching(others: Others, number: int, model: PowerModel) -> Iterator[tuple[float, str]]:
    """Scatter if a switch that stands in this run alone went on and off with the power, and the fault in words."""
    one, battery = others.runs[number], others.battery
    rest = [other.run for i, other in enumerate(others.runs) if i != number]
    if others.scatter[number] < ROUGHER * float(np.max(others.scatter[others.left])):
        return  # a load that nobody logged comes and goes in other runs too
    for name in filter(is_switch, one.run.columns):
        state = one.run.number(name)
        moves = [np.ptp(run.number(name)) > 0.0 for run in rest if name in run.columns]
        if np.ptp(state) > 0.0 or not moves or np.mean(moves) <= 0.5:
            continue
        other = np.full(one.run.rows, 0.0 if state[0] else 1.0)
        watts = drive(model, replace(one.run, columns={**one.run.columns, name: other}), battery).model_w[battery]
        watts = watts - one.model_w[battery]
        beside = others.beside(number)
        beside = beside - np.quantile(beside, 0.05 if np.median(watts) > 0.0 else 0.95)
        seen = np.where(np.abs(beside) > 0.5 * np.abs(watts), other, state)
        switched = drive(model, replace(one.run, columns={**one.run.columns, name: seen}), battery)
        yield (
            others.residual(number, switched),
            f"{name} is {state[0]:g} in every row, while the power goes up and down by its watts",
        )


def correlation(measured: Array, said: Array) -> tuple[Int64s, Array]:
    """Rows by which one follows the other, up to a quarter of the run either way, and the correlation there."""
    a, b = measured - measured.mean(), said - said.mean()
    size = 1 << int(np.ceil(np.log2(2 * len(a))))
    along = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
    most = len(a) // 4
    lags = np.r_[0 : most + 1, -most:0]
    return lags, np.asarray(along[lags] / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-300))


def offsets(others: Others) -> dict[str, str]:
    """Runs whose power lies beside that of all others by one offset, at rest and in motion with the same things on."""
    runs, battery = others.runs, others.battery
    gaps = [others.beside(i) for i in range(len(runs))]
    levels = [_levels(one, gap) for one, gap in zip(runs, gaps, strict=True)]
    beside = np.full((len(runs), 2), np.nan)
    for i, own in enumerate(levels):
        for moving in (0, 1):
            shifts = [
                (level - float(np.median(there)), rows)
                for key, (level, rows) in own.items()
                if key[0] == moving
                and len(there := [other[key][0] for j, other in enumerate(levels) if j != i and key in other])
                >= (3 if moving else 1)
            ]
            if shifts:
                beside[i, moving] = np.average([one[0] for one in shifts], weights=[one[1] for one in shifts])
    if np.isnan(beside[:, 1]).sum() > 0.5 * len(runs):
        return {}
    # what a straight line through measured less expected power over the speed comes to at rest
    speeds = [np.abs(np.asarray(one.covariates["speed_m_s"])) for one in runs]
    pairs = zip(speeds, gaps, strict=True)
    towards = np.array([float(np.polyfit(v, gap, 1)[1]) if np.ptp(v) > 0.0 else np.nan for v, gap in pairs])
    beside = np.column_stack([beside, towards - np.median(towards)])
    known = [np.abs(column[np.isfinite(column)]) for column in beside.T]
    scatter = [1.4826 * float(np.median(one)) if len(one) >= FEWEST_LEVELS - 1 else np.inf for one in known]
    mean = float(np.mean([abs(one.measured_w[battery].mean()) for one in runs]))
    why = "an offset of its meter, or something on that is not logged?"
    found: dict[str, str] = {}
    # the fewer of two groups of levels that lie together, each far from the other
    known_levels = np.sort(beside[np.isfinite(beside[:, 1]), 1])
    widest = int(np.argmax(np.diff(known_levels)))
    low, high = known_levels[: widest + 1], known_levels[widest + 1 :]
    wide = max(float(np.ptp(low)), float(np.ptp(high)))
    two = len(low) != len(high) and high[0] - low[-1] > APART * wide
    few = (low if len(low) < len(high) else high) if two else np.zeros(0)
    for i, (one, apart) in enumerate(zip(runs, beside, strict=True)):
        if (
            abs(apart[1]) > max(OFFSET * mean, _spread(one, gaps[i]))
            and 0.5 < (apart[2] if np.isnan(apart[0]) else apart[0]) / apart[1] < 2.0
            and (bool((np.abs(apart) > SCATTER * np.array(scatter)).any()) or apart[1] in few)
            and not _explained(one, runs, battery, float(apart[1]))
        ):
            found[one.run.run] = (
                f"power_{battery}_w lies {apart[1]:+.2g} W beside the other runs, at rest and in motion: {why}"
            )
    return found


def _levels(driven: Driven, gap: Array) -> dict[tuple[object, ...], tuple[float, int]]:
    """Median of measured less expected power, and the rows, by rest or motion, by what is on and by the floor."""
    cov = driven.covariates
    names = sorted(name for name in driven.run.columns if is_switch(name))
    states = np.column_stack([is_moving(cov) * np.ones(len(gap)), *(np.asarray(cov[name], float) for name in names)])
    kinds, which = np.unique(states, axis=0, return_inverse=True)
    words = [one for name in sorted(driven.run.columns) if isinstance(one := driven.run.columns[name], Labels)]
    # a floor that the whole run lies on is no meter's offset
    texts = tuple((*one.names, "")[int(one.codes[0])] if np.ptp(one.codes) == 0 else "" for one in words)
    groups = (((*kind, *texts), gap[which.ravel() == i]) for i, kind in enumerate(kinds))
    return {kind: (float(np.median(rows)), len(rows)) for kind, rows in groups if len(rows) >= (15 if kind[0] else 5)}


def _spread(driven: Driven, gap: Array) -> float:
    """How far measured less expected power scatters in motion; what a model far from right leaves is no offset."""
    own = gap[np.asarray(is_moving(driven.covariates), dtype=bool) & np.ones(len(gap), dtype=bool)]
    return 1.4826 * float(np.median(np.abs(own - np.median(own)))) if len(own) else 0.0


def _explained(driven: Driven, runs: Sequence[Driven], battery: str, offset: float) -> bool:
    """Whether a load or a temperature that is logged makes up half an offset: other runs have half of it too where they
    have the same of that, or none of them has it."""
    gap = driven.measured_w[battery] - driven.model_w[battery]
    for name, data in driven.run.columns.items():
        load = name in LOADS or (column_of(name) is None and may_be_cause(name))
        if isinstance(data, Labels) or not (load or name.startswith("temp_")):
            continue
        others = [one for one in runs if one is not driven and name in one.run.columns]
        there = np.concatenate([data[:0], *(one.run.number(name) for one in others)])
        if len(others) < FEWEST or not np.isfinite(data).any() or not np.isfinite(there).any():
            continue
        gaps = np.concatenate([one.measured_w[battery] - one.model_w[battery] for one in others])
        low, high = np.nanmin(np.r_[data, there]), np.nanmax(np.r_[data, there])
        edges = np.linspace(low, high, BANDS + 1)[1:-1]
        # what is not finite lies in a band of its own, which none is held against
        own, theirs = (np.where(np.isfinite(x), np.digitize(x, edges), BANDS) for x in (data, there))
        counts = [np.bincount(x, minlength=BANDS + 1)[:BANDS] for x in (own, theirs)]
        shared = np.flatnonzero(np.minimum(*counts) >= LEAST_ROWS)
        rows = counts[0][shared]
        if rows.sum() < 0.5 * len(data):
            moves = min(float(np.ptp(one.run.number(name))) for one in others) > np.ptp(edges) / BANDS
            if load or moves:  # the weather of other days lies elsewhere, whatever the run draws
                return True
            continue
        beside = [np.median(gap[own == b]) - np.median(gaps[theirs == b]) for b in shared]
        if np.average(beside, weights=rows) / offset < 0.5:
            return True
    return False
