"""Figures of a Monte Carlo batch: histogram of the energy, charge over the mission as a fan of quantiles."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from missionsim.files import atomic_write
from missionsim.uncertainty.store import BlockStore

FAN_RUNS, HISTOGRAM_RUNS = 20_000, 1_000_000
"""So many runs, the first ones, make the fan and the histogram."""
_BANDS = ((0.01, 0.99, 0.15), (0.05, 0.95, 0.25), (0.25, 0.75, 0.40))


def write_figures(store: BlockStore, firsts: list[int], batteries: tuple[str, ...], folder: Path) -> list[Path]:
    """Draw ``energy_histogram.png`` and ``charge_fan.png``.

    Parameters
    ----------
    store : BlockStore
    firsts : list of int
        Blocks that count.
    batteries : tuple of str
    folder : Path

    Returns
    -------
    list of Path
        The files written.
    """
    from matplotlib.figure import Figure

    histogram = Figure(figsize=(4.6 * len(batteries), 3.4), layout="constrained")
    axes = np.atleast_1d(histogram.subplots(1, len(batteries)))
    for axis, name in zip(axes, batteries, strict=True):
        energy = store.beginning([f"energy_{name}_wh"], firsts, HISTOGRAM_RUNS)[f"energy_{name}_wh"]
        energy = energy[np.isfinite(energy)]
        if not len(energy) or np.ptp(energy) <= 1e-12 * np.abs(energy).max():
            text = f"{energy[0]:.4g} Wh in all runs" if len(energy) else "all runs failed"
            axis.text(0.5, 0.5, text, transform=axis.transAxes, ha="center", va="center")
            axis.set(xlabel=f"energy of battery {name} [Wh]", xticks=[], yticks=[])
            axis.spines[["top", "right"]].set_visible(False)
            continue
        axis.hist(energy, bins="auto" if len(energy) < 50_000 else 120, color="#4477aa")
        for q, style in ((0.05, ":"), (0.5, "-"), (0.95, ":")):
            at = float(np.quantile(energy, q))
            axis.axvline(at, color="#222222", linestyle=style, linewidth=1)
            axis.annotate(
                f"{100 * q:g} %", (at, 1.0), xycoords=("data", "axes fraction"), fontsize=7, ha="center", va="bottom"
            )
        axis.set(xlabel=f"energy of battery {name} [Wh]", ylabel="runs")
        axis.spines[["top", "right"]].set_visible(False)
    fan = Figure(figsize=(4.6 * len(batteries), 3.4), layout="constrained")
    axes = np.atleast_1d(fan.subplots(1, len(batteries)))
    for axis, name in zip(axes, batteries, strict=True):
        charge = store.beginning([f"charge_{name}_wh"], firsts, FAN_RUNS)[f"charge_{name}_wh"]
        charge = charge[np.isfinite(charge).all(axis=1)]
        if not len(charge):
            continue
        progress = np.linspace(0.0, 100.0, charge.shape[1])
        for low, high, alpha in _BANDS:
            edges = np.quantile(charge, [low, high], axis=0)
            axis.fill_between(
                progress,
                edges[0],
                edges[1],
                color="#4477aa",
                alpha=alpha,
                linewidth=0,
                label=f"{100 * low:g}–{100 * high:g} %",
            )
        axis.plot(progress, np.median(charge, axis=0), color="#222222", linewidth=1, label="median")
        axis.set(xlabel="progress of the mission [% of its time]", ylabel=f"charge of battery {name} [Wh]")
        axis.spines[["top", "right"]].set_visible(False)
        axis.legend(fontsize=7, frameon=False)
    written = []
    for figure, file in ((histogram, "energy_histogram.png"), (fan, "charge_fan.png")):
        with atomic_write(folder / file) as temporary:
            figure.savefig(temporary, dpi=130)
        written.append(folder / file)
    return written
