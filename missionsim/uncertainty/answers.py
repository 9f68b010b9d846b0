"""What a batch says, with the error of its own answer."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.uncertainty.single import drawn_columns
from missionsim.uncertainty.store import BlockStore

QUANTILES = {"q01": 0.01, "q05": 0.05, "q25": 0.25, "q50": 0.50, "q75": 0.75, "q95": 0.95, "q99": 0.99}
LEVEL = 0.95


def proportion_interval(good: int, total: int, level: float = LEVEL) -> tuple[float, float]:
    """Wilson score interval of a proportion (Wilson 1927).

    Parameters
    ----------
    good, total : int
    level : float

    Returns
    -------
    tuple of float
        Low and high end; (0, 1) without any run.
    """
    if total == 0:
        return 0.0, 1.0
    from scipy.special import ndtri

    z = float(ndtri(0.5 + 0.5 * level))
    p = good / total
    middle = (p + z * z / (2 * total)) / (1 + z * z / total)
    half = z / (1 + z * z / total) * math.sqrt(p * (1 - p) / total + z * z / (4 * total * total))
    low = 0.0 if good == 0 else middle - half
    high = 1.0 if good == total else middle + half
    return max(0.0, low), min(1.0, high)


def quantile_interval(ordered: NDArray[np.float64], q: float, level: float = LEVEL) -> tuple[float, float]:
    """Distribution-free interval of a quantile from order statistics (David and Nagaraja 2003, section 7.1).

    Parameters
    ----------
    ordered : ndarray, shape (n,)
        Sorted values.
    q, level : float

    Returns
    -------
    tuple of float
        The extreme values where the sample is too small to bound the quantile on that side.
    """
    from scipy.stats import binom

    n = len(ordered)
    tail = 0.5 * (1.0 - level)
    low = int(binom.ppf(tail, n, q))
    high = int(binom.ppf(1.0 - tail, n, q)) + 1
    return float(ordered[max(low - 1, 0)]), float(ordered[min(high - 1, n - 1)])


def describe(values: NDArray[np.float64]) -> dict[str, Any]:
    """Mean, standard deviation and quantiles of a column with their 95 % intervals.

    Parameters
    ----------
    values : ndarray, shape (n,)
        NaN (failed runs) is left out.
    """
    finite = np.sort(values[np.isfinite(values)])
    if not len(finite):
        return {"mean": None, "sd": None, **dict.fromkeys(QUANTILES)}
    from scipy.special import ndtri

    mean, sd = float(finite.mean()), float(finite.std(ddof=1)) if len(finite) > 1 else 0.0
    half = float(ndtri(0.5 + 0.5 * LEVEL)) * sd / math.sqrt(len(finite))
    result: dict[str, Any] = {"mean": mean, "sd": sd, "mean_interval": [mean - half, mean + half]}
    for name, q in QUANTILES.items():
        result[name] = float(np.quantile(finite, q))
    result["intervals"] = {name: list(quantile_interval(finite, q)) for name, q in QUANTILES.items()}
    return result


def summarise(store: BlockStore, firsts: list[int], batteries: tuple[str, ...]) -> dict[str, Any]:
    """The answers of a batch, read one column at a time.

    Parameters
    ----------
    store : BlockStore
    firsts : list of int
        First runs of the blocks that count.
    batteries : tuple of str

    Returns
    -------
    dict
        ``runs``, ``p_feasible``, ``batteries``, ``failures``, ``duration_s``, ``importance`` of the contract's JSON.
    """
    feasible = store.column("feasible", firsts).astype(bool)
    total, good = len(feasible), int(feasible.sum())
    low, high = proportion_interval(good, total)
    answer: dict[str, Any] = {
        "runs": total,
        "p_feasible": {"value": good / total if total else None, "low": low, "high": high},
        "duration_s": describe(store.column("duration_s", firsts)),
        "batteries": {},
        "failures": _failures(store, firsts, total),
    }
    names = store.names()
    drawn = {name: store.column(f"drawn:{name}", firsts) for name in drawn_columns(dict.fromkeys(names))}
    importance: list[dict[str, Any]] = []
    for battery in batteries:
        energy = store.column(f"energy_{battery}_wh", firsts)
        needed = store.column(f"needed_{battery}_wh", firsts)
        prefix = f"component_{battery}_"
        answer["batteries"][battery] = {
            "energy_wh": describe(energy),
            "margin_wh": describe(store.column(f"margin_{battery}_wh", firsts)),
            "capacity_needed_wh": capacity_needed(needed),
            "by_component_wh": {
                name[len(prefix) : -3]: _mean(store.column(name, firsts))
                for name in names
                if name.startswith(prefix) and name.endswith("_wh")
            },
        }
        importance += rank_importance(drawn, energy, battery)
    answer["importance"] = importance
    return answer


def capacity_needed(needed: NDArray[np.float64], share: float = 0.99) -> dict[str, Any]:
    """Energy that suffices for `share` of the runs, without any reserve, with its 95 % interval [Wh]."""
    finite = np.sort(needed[np.isfinite(needed)])
    if not len(finite):
        return {"share": share, "value": None, "low": None, "high": None}
    low, high = quantile_interval(finite, share)
    return {"share": share, "value": float(np.quantile(finite, share)), "low": low, "high": high}


def rank_importance(
    drawn: dict[str, NDArray[np.float64]], energy: NDArray[np.float64], battery: str
) -> list[dict[str, Any]]:
    """Which values matter: first-order index from the sample itself, and Spearman's rank correlation.

    The index is the correlation ratio of the energy over classes of equal counts of the value (Plischke 2012), less
    what classes of pure noise would show. ``total`` needs a design of its own (`sobol`) and is None here.
    """
    ok = np.isfinite(energy)
    count = int(ok.sum())
    if count < 20 or float(np.std(energy[ok])) == 0.0:
        return []
    from scipy.stats import rankdata

    ranks = rankdata(energy[ok])
    classes = int(min(50, max(4, round(count ** (1 / 3)))))
    rows = []
    for name, values in drawn.items():
        column = values[ok]
        if float(np.std(column)) == 0.0:
            continue
        order = np.argsort(column, kind="stable")
        parts = np.array_split(energy[ok][order], classes)
        between = sum(len(part) * (part.mean() - energy[ok].mean()) ** 2 for part in parts)
        ratio = between / (count * float(np.var(energy[ok])))
        first = 1.0 - (1.0 - ratio) * (count - 1) / (count - classes)
        rho = float(np.corrcoef(rankdata(column), ranks)[0, 1])
        rows.append(
            {
                "parameter": name,
                "battery": battery,
                "first": max(0.0, float(first)),
                "total": None,
                "rank_correlation": rho,
            }
        )
    return sorted(rows, key=lambda row: -abs(row["rank_correlation"]))


def _failures(store: BlockStore, firsts: list[int], total: int) -> dict[str, Any]:
    where: dict[tuple[str, str], list[float]] = {}
    reasons: dict[str, int] = {}
    columns = (store.parts(n, firsts) for n in ("failed_segment", "failed_battery", "failed_at_s", "message"))
    for segments, names, times, messages in zip(*columns, strict=True):
        for segment, battery, time_s in zip(segments, names, times, strict=True):
            if battery:
                where.setdefault((battery, segment), []).append(float(time_s))
        for message in messages:
            if message:
                reasons[message] = reasons.get(message, 0) + 1
    return {
        "empty": [
            {
                "battery": battery,
                "segment": segment,
                "share": len(times) / total,
                "median_time_s": float(np.median(times)),
            }
            for (battery, segment), times in sorted(where.items(), key=lambda item: -len(item[1]))
        ],
        "reasons": [
            {"reason": reason, "share": count / total}
            for reason, count in sorted(reasons.items(), key=lambda item: -item[1])[:20]
        ],
    }


def _mean(values: NDArray[np.float64]) -> float | None:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else None
