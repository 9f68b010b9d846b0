"""What a batch says, with the error of its own answer: energies, failures, which uncertain value matters (ranks; Sobol
indices, alone and with all that it interacts with)."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.errors import InputError
from missionsim.files import Json
from missionsim.physics import Array, Ints
from missionsim.uncertainty.draws import left_to_chance, run_generator
from missionsim.uncertainty.store import BlockStore

if TYPE_CHECKING:
    from missionsim.uncertainty.batch import Prepared

KEPT_TIMES = 100_000
"""Of so many failures at a place, the first ones, the time is known."""
KEPT_REASONS = 1000
_OTHER = "other reasons"


def failures(store: BlockStore, firsts: list[int], total: int) -> Json:
    """Places where batteries run empty, and why runs fail, in bounded memory.

    `firsts`: first runs of the blocks that count; `total`: number of runs. Gives ``empty``: battery, segment, share of
    all runs, median of the time; ``reasons``: message and share. The most frequent first.
    """
    counts: Counter[tuple[str, str]] = Counter()
    times: dict[tuple[str, str], list[Array]] = {}
    reasons: Counter[str] = Counter()
    for part in store.tables(("failed_segment", "failed_battery", "failed_at_s", "message"), firsts):
        failed = np.flatnonzero(part["failed_battery"] != "")
        places = list(zip(part["failed_battery"][failed], part["failed_segment"][failed], strict=True))
        for place, many in Counter(places).items():
            if counts[place] < KEPT_TIMES:
                here = [i for i, at in zip(failed, places, strict=True) if at == place]
                seconds = np.asarray(part["failed_at_s"], dtype=float)[here[: KEPT_TIMES - counts[place]]]
                times.setdefault(place, []).append(seconds)
            counts[place] += many
        for message, many in Counter(part["message"][part["message"] != ""].tolist()).items():
            reasons[message if message in reasons or len(reasons) < KEPT_REASONS else _OTHER] += many
    empty = []
    for place, many in counts.most_common():
        where = {"battery": place[0], "segment": place[1], "share": many / total}
        empty.append(where | {"median_time_s": float(np.median(np.concatenate(times[place])))})
    told = [{"reason": reason, "share": many / total} for reason, many in reasons.most_common(20)]
    return {"empty": empty, "reasons": told}


QUANTILES = {"q01": 0.01, "q05": 0.05, "q25": 0.25, "q50": 0.50, "q75": 0.75, "q95": 0.95, "q99": 0.99}
LEVEL = 0.95
IMPORTANCE_RUNS = 100_000
"""So many runs, the first ones, tell which values matter: enough to know a rank correlation to 0.005."""
IMPORTANCE_NUMBERS = 8_000_000
"""Numbers of drawn values that are held at a time."""
MARGIN_TOLERANCE_WH = 1e-6


def proportion_interval(good: int, total: int) -> tuple[float, float]:
    """Wilson score interval of a proportion (Wilson 1927). Gives low and high end; (0, 1) without any run."""
    if total == 0:
        return 0.0, 1.0
    from scipy.special import ndtri

    z = float(ndtri(0.5 + 0.5 * LEVEL))
    p = good / total
    middle = (p + z * z / (2 * total)) / (1 + z * z / total)
    half = z / (1 + z * z / total) * math.sqrt(p * (1 - p) / total + z * z / (4 * total * total))
    low = 0.0 if good == 0 else middle - half
    high = 1.0 if good == total else middle + half
    return max(0.0, low), min(1.0, high)


def quantile_ranks(count: int, q: float) -> tuple[int, int]:
    """Ranks, from 0, of the order statistics that bound a quantile (David and Nagaraja 2003, section 7.1). Gives −1 and
    `count` where the sample is too small to bound the quantile on that side."""
    # the functions themselves: the distributions around them (scipy.stats) take a second to import
    from scipy.special import bdtr, bdtrik

    def rank(p: float) -> int:
        """Least number of successes of a binomial distribution that is not exceeded with probability p."""
        least = math.ceil(float(bdtrik(p, count, q)))
        return least - 1 if least and bdtr(least - 1, count, q) >= p else least

    tail = 0.5 * (1.0 - LEVEL)
    return rank(tail) - 1, rank(1.0 - tail)


def describe(column: Array) -> Json:
    """Mean, standard deviation and quantiles of a column with their 95 % intervals; failed runs (NaN) left out.

    Quantiles are those of Hyndman and Fan 1996, type 7. `column`: shape (runs,).
    """
    ordered = np.sort(column[np.isfinite(column)])
    count = len(ordered)
    if not count:
        return {"mean": None, "sd": None, **dict.fromkeys(QUANTILES)}
    from scipy.special import stdtrit

    mean = float(ordered.mean())
    sd = float(ordered.std(ddof=1)) if ordered[0] < ordered[-1] else 0.0
    half = float(stdtrit(count - 1, 0.5 + 0.5 * LEVEL)) * sd / math.sqrt(count) if count > 1 else None
    ranks = {name: quantile_ranks(count, q) for name, q in QUANTILES.items()}
    return {
        "mean": mean,
        "sd": sd,
        "mean_interval": [None, None] if half is None else [mean - half, mean + half],
        **dict(zip(QUANTILES, np.quantile(ordered, [*QUANTILES.values()]).tolist(), strict=True)),
        "intervals": {name: [_at(ordered, low), _at(ordered, high)] for name, (low, high) in ranks.items()},
    }


def _at(ordered: Array, rank: int) -> float | None:
    """The number at a rank; None beyond the sample."""
    return float(ordered[rank]) if 0 <= rank < len(ordered) else None


def summarise(store: BlockStore, firsts: list[int], batteries: tuple[str, ...]) -> Json:
    """The answers of a batch; one block, or one column of it, is in memory at a time.

    `firsts`: first runs of the blocks that count. Gives ``runs``, ``p_feasible``, ``speed_limited_share``,
    ``batteries``, ``failures``, ``duration_s``, ``importance`` of the contract's JSON. Importance is found from the
    first `IMPORTANCE_RUNS` runs.
    """

    def numbers(name: str) -> Array:
        return np.asarray(store.column(name, firsts), dtype=float)

    def proportion(good: int) -> Json:
        low, high = proportion_interval(good, total)
        return {"value": good / total if total else None, "low": low, "high": high}

    total = good = limited = 0
    names = store.names()
    components = [name for name in names if name.startswith("component_")]
    margins = {f"margin_{name}_wh": name for name in batteries}
    kept = dict.fromkeys(batteries, 0)
    sums, known = dict.fromkeys(components, 0.0), dict.fromkeys(components, 0)
    for table in store.tables(("feasible", "speed_limited", "failed_battery", *margins, *components), firsts):
        total, good = total + len(table["feasible"]), good + int(np.count_nonzero(table["feasible"]))
        limited += int(np.count_nonzero(table["speed_limited"]))
        for column, battery in margins.items():  # no empty battery ended the run, and this one has its reserve
            enough = np.asarray(table[column], dtype=float) >= -MARGIN_TOLERANCE_WH
            kept[battery] += int(np.count_nonzero(enough & (table["failed_battery"] == "")))
        for name in components:
            finite = table[name][np.isfinite(table[name])]
            sums[name], known[name] = sums[name] + float(finite.sum()), known[name] + len(finite)
    answer: dict[str, Any] = {
        "runs": total,
        "p_feasible": proportion(good),
        "speed_limited_share": limited / total if total else None,
        "duration_s": describe(numbers("duration_s")),
        "batteries": {},
        "failures": failures(store, firsts, total),
    }
    for battery in batteries:
        prefix = f"component_{battery}_"
        answer["batteries"][battery] = {
            "energy_wh": describe(numbers(f"energy_{battery}_wh")),
            "margin_wh": describe(numbers(f"margin_{battery}_wh")),
            "p_reserve": proportion(kept[battery]),
            "capacity_needed_wh": capacity_needed(numbers(f"needed_{battery}_wh")),
            "by_component_wh": {
                name[len(prefix) : -len("_wh")]: sums[name] / known[name] if known[name] else None
                for name in components
                if name.startswith(prefix)
            },
        }
    drawn = [name.removeprefix("drawn:") for name in names if name.startswith("drawn:")]
    count = min(total, IMPORTANCE_RUNS)

    def draws() -> Iterator[tuple[str, Array]]:
        """Names and draws of the first runs, some columns at a time: there may be thousands of values."""
        together = max(1, IMPORTANCE_NUMBERS // max(1, count))
        for low in range(0, len(drawn), together):
            some = drawn[low : low + together]
            first = store.beginning([f"drawn:{name}" for name in some], firsts, count)
            yield from ((name, first[f"drawn:{name}"]) for name in some)

    first = store.beginning([f"{what}_{name}_wh" for what in ("energy", "margin") for name in batteries], firsts, count)
    energies, left = ({name: first[f"{what}_{name}_wh"] for name in batteries} for what in ("energy", "margin"))
    answer["importance"] = rank_importance(draws(), energies, left)
    answer["importance_runs"] = count
    return answer


def capacity_needed(column: Array, share: float = 0.99) -> Json:
    """Energy that suffices for `share` of the runs, without any reserve, with its 95 % interval [Wh].

    The need of a run that fails, or that not even a bottomless battery brings to its end, is not known (NaN) and counts
    as above all others: where the quantile would be one of these, it is not given.
    """
    ordered = np.sort(column[np.isfinite(column)])
    total = len(column)
    at = share * (total - 1)
    low, high = quantile_ranks(total, share) if total else (-1, 0)
    value = None
    if total and math.ceil(at) < len(ordered):
        below, above = float(ordered[math.floor(at)]), float(ordered[math.ceil(at)])
        value = below + (above - below) * (at - math.floor(at))
    return {
        "share": share,
        "value": value,
        "low": None if value is None else _at(ordered, low),
        "high": None if value is None else _at(ordered, high),
        "runs_without": total - len(ordered),
    }


def rank_importance(
    drawn: Iterable[tuple[str, Array]], energies: Mapping[str, Array], margins: Mapping[str, Array] | None = None
) -> list[Json]:
    """Which values matter: first-order index from the sample itself, and Spearman's rank correlation.

    The index is the correlation ratio of the energy over classes of equal counts of the value (Plischke 2012), less
    what classes of pure noise would show. ``total`` needs a design of its own (`sobol`) and is None here. `drawn`: name
    of a value and its draws, shape (n,); `energies`: battery → ndarray of shape (n,), NaN where a run failed;
    `margins`: the same for what each battery keeps above its reserve, on which capacity and ageing act too.
    """
    found: list[dict[str, Any]] = []
    ok = np.all([np.isfinite(energy) for energy in energies.values()], axis=0) if energies else np.zeros(0, dtype=bool)
    count = int(np.count_nonzero(ok))
    outcomes = {name: energy[ok] for name, energy in energies.items() if count >= 20 and _varies(energy[ok])}
    ranks = {name: _ranks(energy)[0] for name, energy in outcomes.items()}
    kept = {name: values[ok] for name, values in (margins or {}).items() if name in outcomes}
    kept_ranks = {name: _ranks(values)[0] for name, values in kept.items() if _varies(values)}
    classes = int(min(50, max(4, round(count ** (1 / 3)))))
    for parameter, values in drawn if outcomes else ():
        column = values[ok]
        if not np.isfinite(column).all() or not _varies(column):
            continue
        own, least, distinct = _ranks(column)
        # equal values belong to one class; a few values are a class each
        member = least * classes // count if distinct > classes else least
        member = np.unique(member, return_inverse=True)[1]
        size = np.bincount(member)
        for battery, energy in outcomes.items():
            means = np.bincount(member, energy - energy.mean()) / size
            ratio = float(size @ means**2) / (count * float(np.var(energy)))
            first = 1.0 - (1.0 - ratio) * (count - 1) / (count - len(size))
            row = {"parameter": parameter, "battery": battery, "first": max(0.0, float(first)), "total": None}
            for key, of in (("rank_correlation", ranks), ("margin_rank_correlation", kept_ranks)):
                row[key] = float(np.corrcoef(own, of[battery])[0, 1]) if battery in of else None
            found.append(row)
    place = {name: i for i, name in enumerate(energies)}
    return sorted(
        found, key=lambda row: (place[row["battery"]], -max(abs(row["rank_correlation"]), abs(_with_margin(row))))
    )


def _varies(values: Array) -> bool:
    """Whether numbers differ by more than rounding."""
    return bool(np.ptp(values) > 1e-12 * np.abs(values).max())


def _ranks(values: Array) -> tuple[Array, Ints, int]:
    """Ranks, those of equal values their mean; the least ranks of equal values; and how many are distinct."""
    _, which, counts = np.unique(values, return_inverse=True, return_counts=True)
    least = np.cumsum(counts) - counts
    return (least + 0.5 * (counts - 1))[which], least[which], len(counts)


DESIGNS = 16
"""Independently scrambled designs; how they differ tells how sure the indices are."""
FEWEST = 4 * DESIGNS
CHANCE = "chance"
"""Name of all that a mission leaves to chance, taken as one value."""
_TRIED, _AFFORDABLE, _AFFORDABLE_SIMPY, _MOST_SAMPLES = 512, 150_000, 400, 1024
_EDGE = 2.0**-40
_MATTERS = 0.05
"""A rank correlation with the margin above this is told even of a value that changes no energy (a capacity)."""
_POINTS = {"arrays": 1 << 14, "simpy": 256}
"""So many points are evaluated at once, at most."""


def sobol_importance(prepared: Prepared, seed: int, samples: int, ranks: list[Json]) -> list[Json]:
    """First-order and total Sobol indices of each battery's energy.

    `samples`: a power of two, `FEWEST` or more; the mission is evaluated ``samples × (values + 2)`` times. `ranks`:
    rank correlations to be carried over. Gives ``parameter``, ``battery``, ``first``, ``total`` with their 95 %
    intervals, largest total first. What is left to chance is one value, `CHANCE`. Raises InputError: where values are
    correlated: the indices are not defined then.

    Saltelli et al. 2010, estimators (b) and (f) of Table 2, on scrambled Sobol' points (`scipy.stats.qmc`). A bootstrap
    would take these points for independent ones and give intervals far too wide; here `DESIGNS` designs are scrambled
    independently, and the interval is that of the jackknife over them with Student's t.
    """
    refuse_correlated(prepared)
    names = [value.name for value in prepared.sampler.values]
    names += [CHANCE] if left_to_chance(prepared.mission) else []
    if not names:
        return ranks
    first, total = _indices(prepared, seed, samples, len(names))
    known = {(row["battery"], row["parameter"]): row for row in ranks}
    rows: list[Json] = []
    for (b, battery), (i, name) in itertools.product(enumerate(prepared.mission.robot.batteries), enumerate(names)):
        rank = known.get((battery, name), {})
        row = {"parameter": name, "battery": battery, "first": first[0, i, b], "total": total[0, i, b]}
        row |= {"first_interval": first[1:, i, b].tolist(), "total_interval": total[1:, i, b].tolist()}
        row |= {key: rank.get(key) for key in ("rank_correlation", "margin_rank_correlation")}
        # else the value does not touch this battery's energy, nor what it keeps
        if row["total"] > 0.0 or abs(_with_margin(row)) > _MATTERS:
            rows.append(row)
    return sorted(rows, key=lambda row: -max(float(row["total"]), _with_margin(row) ** 2))


def _with_margin(row: Mapping[str, Any]) -> float:
    return float(row.get("margin_rank_correlation") or 0.0)


def refuse_correlated(prepared: Prepared) -> None:
    """Say that correlated values have no Sobol indices."""
    if prepared.sampler.groups:
        told, got = "Sobol indices are not defined for correlated values", "correlations in the mission"
        raise InputError.single(told, got=got, allowed="--sobol without correlations, or the rank correlations alone")


def affordable_samples(prepared: Prepared, seed: int) -> int:
    """Base samples for which Sobol indices cost about as much as a batch; 0 where many runs need SimPy."""
    arrays, values = prepared.arrays, prepared.sampler.values
    if arrays is None or not values or prepared.sampler.groups:
        return 0
    _, again = arrays.evaluate(prepared.sampler.draw(seed, 0, _TRIED), _TRIED)
    most = min(_AFFORDABLE, _AFFORDABLE_SIMPY / max(float(again.mean()), 1e-9))
    samples = int(most) // (len(values) + 2)
    if samples < FEWEST:
        return 0
    return int(min(_MOST_SAMPLES, 1 << (samples.bit_length() - 1)))


def _indices(prepared: Prepared, seed: int, samples: int, values: int) -> tuple[Array, Array]:
    """First-order and total indices: estimate, low and high end; shape (3, values, batteries)."""
    from scipy.stats import qmc

    evaluated = []
    for design in range(DESIGNS):
        scrambling = np.random.default_rng(int(run_generator(seed, "sobol", design).integers(1 << 62)))
        generator = qmc.Sobol(2 * values, seed=scrambling)
        points = np.clip(generator.random(samples // DESIGNS), _EDGE, 1.0 - _EDGE).T
        a, b = points[:values], points[values:]
        pages = [np.array(a), np.array(b)]
        for i in range(values):
            pages.append(np.array(a))
            pages[-1][i] = b[i]
        together = max(1, _POINTS[prepared.engine] // a.shape[1])
        parts = [
            _energies(prepared, seed, np.concatenate(pages[i : i + together], axis=1))
            for i in range(0, len(pages), together)
        ]
        found = np.split(np.concatenate(parts, axis=1), len(pages), axis=1)
        evaluated.append((found[0], found[1], np.array(found[2:])))
    middle = np.nanmean([0.5 * (f_a + f_b) for f_a, f_b, _ in evaluated], axis=(0, -1))[:, None]
    variance, first, total = [], [], []
    for f_a, f_b, f_ab in evaluated:
        variance.append(np.nanmean(0.5 * ((f_a - middle) ** 2 + (f_b - middle) ** 2), axis=-1))
        first.append(np.nanmean((f_b - middle) * (f_ab - f_a), axis=-1))
        total.append(np.nanmean(0.5 * (f_a - f_ab) ** 2, axis=-1))
    return _ratio(np.array(first), np.array(variance)), _ratio(np.array(total), np.array(variance))


def _ratio(parts: Array, variances: Array) -> Array:
    """Ratio of sums over designs with its interval by the jackknife. `parts`: shape (designs, values, batteries);
    `variances`: shape (designs, batteries)."""
    from scipy.special import stdtrit

    whole = np.where(variances.sum(axis=0) > 0.0, variances.sum(axis=0), np.inf)
    ratio = parts.sum(axis=0) / whole
    without = (parts.sum(axis=0) - parts) / (whole - variances)[:, None, :]
    spread = np.sqrt((DESIGNS - 1) * np.mean((without - without.mean(axis=0)) ** 2, axis=0))
    half = float(stdtrit(DESIGNS - 1, 0.5 + 0.5 * LEVEL)) * spread
    return np.array([ratio, ratio - half, ratio + half])


def _energies(prepared: Prepared, seed: int, points: Array) -> Array:
    """Energy of each battery at probabilities of the values, shape (batteries, n); NaN where a run fails."""
    values, batteries = prepared.sampler.values, tuple(prepared.mission.robot.batteries)
    draws = {value.name: value.distribution.quantile(points[i]) for i, value in enumerate(values)}
    count = points.shape[1]
    # a point's probability of chance is the seed of all that chance does there
    lots = (points[-1] * 2**53).astype(np.int64) if len(points) > len(values) else np.arange(count)
    block = prepared.block(seed, 0, count, draws, lots)
    return np.array([block[f"energy_{name}_wh"] for name in batteries])
