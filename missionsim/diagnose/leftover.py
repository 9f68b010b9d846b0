"""A systematic error in one kind of motion, which tests of curves away from ramps and averages over runs pass over; and
watts that are logged beside, of which the fitted runs hold too little."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from missionsim.effects.covariates import Covariates, is_text
from missionsim.effects.model import PowerModel
from missionsim.glossary import column_of
from missionsim.identify.findings import BatteryDiagnosis, Structure
from missionsim.identify.identification import Identification
from missionsim.identify.model import prediction
from missionsim.identify.settings import CLEAR_OF_NOISE, CLEAR_T, MOST_OF_SQUARE, SEVERAL_RUNS, SMALL_TIME
from missionsim.labels import Labels
from missionsim.numerals import rounded, watts
from missionsim.physics import Array, Bools, Ints
from missionsim.runs.covariates import COVARIATES, may_be_cause, repeated
from missionsim.runs.error import errors_of
from missionsim.runs.motion import MOTIONS, kinds_of_motion
from missionsim.runs.run import Run

RAMPS = (MOTIONS.index("speeding up"), MOTIONS.index("slowing down"))
TWIN = 0.985
"""Correlation beside the model from which on two columns cost the same."""
ITS_OWN = 0.05
"""Part of an effect, beside the model and the motion, below which only the motion makes it."""
VARIES: Mapping[str, str] = {
    "driving straight": "speed_m_s",
    "turning on the spot": "yaw_rate_rad_s",
    "driving a curve": "yaw_rate_rad_s",
    "speeding up": "accel_m_s2",
    "slowing down": "accel_m_s2",
}


def leftover(found: Identification, covariates: Sequence[Covariates]) -> Structure | None:
    """What recalibration and the effects found leave over in one kind of motion; None where nothing stands out.

    `covariates`: covariates of each fitted run at its raw rate, as in `missionsim.diagnose.features.Features`.
    """
    model = found.choice.model
    source, design = model.source, model.design
    known = [covariates[i] for i in source.kept]
    if not all({"speed_m_s", "accel_m_s2"} <= cov.keys() for cov in known):
        return None
    kinds = []
    for cov, run in zip(known, source.runs, strict=True):
        kind = kinds_of_motion(cov)
        ahead = kinds_of_motion({name: column for name, column in cov.items() if name != "yaw_rate_rad_s"})
        kind = np.where(np.isin(ahead, RAMPS), ahead, kind)  # ramps count as such in curves as well
        if len(kind) != len(run.time_s):
            return None
        kinds.append((kind[None, :] == np.arange(len(MOTIONS))[:, None]).astype(float))
    names = {effect.effect for effect in found.effects}
    chosen = [k for k in model.chosen if found.library[design.layout.columns[k].candidate].effect in names]
    error_w = prediction(model, chosen, design) - design.y
    rows = source.averaged(kinds, model.clock) > 0.5  # rows that lie in this kind of motion for the most part
    run_index, sd_w = design.run_index(), found.noise["sd_w"]
    return standing_out(error_w, design.duration_s, run_index, rows, noise_w=sd_w, mean_power_w=found.mean_power_w)


def goes_with(
    found: Identification, covariates: Sequence[Covariates], reads: Mapping[str, Collection[str]]
) -> dict[str, str]:
    """By effect found, in words, a column that the glossary does not hold and that goes with the effect's own in these
    runs, so that whichever of them it is, driving would cost the same: rain that fell on the cold days. `reads`: by
    effect, the columns that it reads itself."""
    model = found.choice.model
    source, design = model.source, model.design
    known = [covariates[i] for i in source.kept]
    twins = repeated(known)
    names = [n for n in sorted(set.intersection(*({*cov} for cov in known))) if n not in COVARIATES and n not in twins]
    names = [n for n in names if column_of(n) is None and may_be_cause(n)]
    root = np.sqrt(design.duration_s)
    rows = {name: driven for name in names if (driven := _driven_with(name, known))}
    columns = {name: source.averaged(driven, model.clock) * root for name, driven in rows.items()}
    # what a column that hardly changes is times turning is turning
    plain = source.averaged([np.vstack(one) for one in _driving(known)], model.clock)
    sizes = dict(zip(model.chosen, model.gram.shares(model.chosen), strict=True))
    told: dict[str, str] = {}
    for effect in (one.effect for one in found.effects if columns):
        own = [k for k in model.chosen if model.constraints.of_column(k).effect == effect]
        rest = [k for k in model.chosen if k not in own]
        others = np.vstack([design.gradient, design.phi[rest], plain]) * root
        basis, length, _ = np.linalg.svd(others.T, full_matrices=False)
        basis = basis[:, length > 1e-9 * length.max()]

        def beside(x: Array, basis: Array = basis) -> Array:
            return np.asarray(x - (x @ basis) @ basis.T)

        whole = np.asarray(sum(sizes[k] * design.phi[k] for k in own) * root)
        mine = beside(whole)
        if np.linalg.norm(mine) < ITS_OWN * np.linalg.norm(whole):
            continue
        for name, column in columns.items():
            if name in reads.get(effect, ()):
                continue
            theirs = beside(column)
            lengths = np.linalg.norm(theirs, axis=1) * np.linalg.norm(mine)
            if np.max(np.abs(theirs @ mine) / np.maximum(lengths, 1e-300)) > TWIN:
                told[effect] = f"{name} goes with it in these runs and would cost the same: drive one without the other"
                break
    return told


def _driven_with(name: str, known: Sequence[Covariates]) -> list[Array]:
    """What a column may make standing, driving and turning cost, in each run at its raw rate, arrays (forms, rows);
    none where it does not change."""
    if is_text(known[0][name]):
        labels = [cov[name] for cov in known if isinstance(cov[name], Labels)]
        texts = sorted({label.names[int(i)] for label in labels for i in np.unique(label.codes) if i >= 0})
        of_runs = [np.array([label.equals(text) for text in texts], dtype=float) for label in labels]
    else:
        of_runs = [np.atleast_2d(np.nan_to_num(np.asarray(cov[name], dtype=float))) for cov in known]
    if len(of_runs) < len(known) or not np.ptp(np.hstack(of_runs), axis=1).any():
        return []
    return [np.vstack([x * many for many in own]) for x, own in zip(of_runs, _driving(known), strict=True)]


def _driving(known: Sequence[Covariates]) -> list[list[Array]]:
    """Standing, driving and turning in each run at its raw rate: ones, and the sizes of the speeds that all log."""
    speeds = [n for n in ("speed_m_s", "yaw_rate_rad_s") if all(n in cov for cov in known)]
    return [
        [np.ones(np.shape(cov["time_s"])), *(np.abs(np.asarray(cov[n], dtype=float)) for n in speeds)] for cov in known
    ]


def standing_out(
    error_w: Array, seconds: Array, run: Ints, rows: Bools, *, noise_w: float, mean_power_w: float
) -> Structure | None:
    """The kind of motion with most of the squared error in a small part of the time, if its mean is clear of noise.

    `error_w`, `seconds` (shape (n,)): model minus measured power [W]; time that a row stands for [s]. `run` (shape
    (n,)): number of the run. `rows` (shape (kinds, n)): whether a row lies in each of `MOTIONS`. `noise_w`: standard
    deviation of the noise of a row [W]. The structure depends on what tells this kind of motion from others.
    """
    square = error_w**2 * seconds
    if square.sum() <= 0.0:
        return None
    shares = (rows @ square) / square.sum()
    kind = int(np.argmax(shares))
    here = rows[kind]
    time_share = float(seconds[here].sum() / seconds.sum())
    if shares[kind] < MOST_OF_SQUARE or time_share > SMALL_TIME:
        return None
    each = [here & (run == j) for j in np.unique(run)]
    means = np.array([np.average(error_w[m], weights=seconds[m]) for m in each if m.any()])
    if len(means) < SEVERAL_RUNS or abs(float(np.sum(np.sign(means)))) < len(means):
        return None
    mean = float(means.mean())
    if abs(mean) < CLEAR_OF_NOISE * noise_w or abs(mean) < CLEAR_T * float(means.std(ddof=1)) / math.sqrt(len(means)):
        return None
    bias_w = float(np.average(error_w[here], weights=seconds[here]))
    told = (
        f"a systematic error while {MOTIONS[kind]}, model {watts(abs(bias_w), 2)} too "
        f"{'high' if bias_w > 0.0 else 'low'}: {100 * float(shares[kind]):.0f} % of the squared error in "
        f"{100 * time_share:.0f} % of the time; no effect of the library describes it"
    )
    return Structure(VARIES.get(MOTIONS[kind], ""), 0.0, 0.0, abs(bias_w) * time_share / mean_power_w, told)


MUCH = 0.03
"""Part of the energy from which on watts that may be drawn are worth a sentence (assumed)."""


def fed_note(last: BatteryDiagnosis, battery: str, fitted: Sequence[Run], others: Sequence[Run]) -> str:
    """In words, what is logged in watts beside a battery and would be much of its energy in other runs, where the
    fitted ones hold too little of it to show whether the battery feeds it; else empty."""
    for one in last.candidates:
        kind, _, column = one.effect.partition(":")
        least = one.smallest_detectable_share
        if kind != "logged_power" or one.accepted or least is None:
            continue
        parts = []
        for runs in (fitted, others):
            own = [run for run in runs if column in run.columns]
            fed = sum(float(np.nansum(run.number(column) * run.dt_s)) for run in own)
            fed *= 1e3 if column.endswith("_kw") else 1.0
            parts.append(fed / max(sum(3600.0 * run.energy_wh(battery) for run in own), 1e-9))
        here, there = parts
        if here < least and there > MUCH:
            return (
                f" Whether this battery feeds {column} cannot be seen: it would be {100 * here:.1f} % of the energy of "
                f"the fitted runs, where {100 * least:.1f} % could be seen, and {100 * there:.0f} % in the others. Fit "
                f"runs with more of it; where it is known to be fed, add-effect --effect {one.effect} --force adds it."
            )
    return ""


HARDLY_TURNING = 0.1
"""Turn rates below this part of a fast turn's (the 99th percentile) are what a robot that drives straight shows."""
LOST = 0.05
"""Part of the energy that makes a sentence worth it (assumed)."""


def straight_note(model: PowerModel, runs: Sequence[Run], battery: str) -> str:
    """In words, that a file draws much of its power from turn rates as small as a straight drive's, which are exactly
    nought in a simulated mission; else empty."""
    name = "yaw_rate_rad_s"
    if not all(name in run.columns for run in runs):
        return ""
    least = HARDLY_TURNING * float(np.nanquantile(np.abs(np.concatenate([run.number(name) for run in runs])), 0.99))
    rates = [run.number(name) for run in runs]
    small = [np.where(np.abs(rate) < least, 0.0, rate) for rate in rates]
    straight = [replace(run, columns={**run.columns, name: rate}) for run, rate in zip(runs, small, strict=True)]
    driven, simulated = (errors_of(model, some, battery).total.model_j for some in (runs, straight))
    lost = 1.0 - simulated / driven if driven else 0.0
    if abs(lost) < LOST:
        return ""
    return (
        f" {100 * abs(lost):.0f} % {'less' if lost > 0.0 else 'more'} energy comes out where turn rates below "
        f"{rounded(least, 2)} rad/s are none, as in a simulated mission: what was found reads the noise of straight "
        "drives. Set it to zero in the map, or do not trust `run` on straight ways."
    )
