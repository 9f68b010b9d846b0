"""What the search for a law needs of an identification, in one place: rows, noise, and what is already explained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.identify.data import Array
from missionsim.identify.design import Column, Design
from missionsim.identify.identification import Identification
from missionsim.identify.model import Model, log_likelihood, spread
from missionsim.identify.noise import Noise, bounded_noise, for_rows, start_noise
from missionsim.identify.predictive import LeastSquares
from missionsim.identify.reml import fit_noise

LAGS_S = (0.0, 0.15, 0.3, 0.45, 0.6)
DELAYS_S = (-0.2, -0.1, 0.1, 0.2, 0.3)
CLOCK_NATS = 15.0
"""Rise of the log-likelihood from which on a law moves the clock of meter and motion."""


@dataclass(frozen=True)
class Ground:
    """The model that a law would be added to.

    Attributes
    ----------
    model : Model
        With the effects that were found, and nothing that is in doubt.
    covariates : tuple of mapping
        Of each run of the model, at its raw rate.
    held : tuple of (str, tuple of int)
        Effects found and their columns.
    """

    model: Model
    covariates: tuple[Mapping[str, Any], ...]
    held: tuple[tuple[str, tuple[int, ...]], ...]

    @property
    def design(self) -> Design:
        """Rows of all runs at the analysis rate."""
        return self.model.design

    @property
    def chosen(self) -> tuple[int, ...]:
        """Columns of the effects found."""
        return self.model.chosen

    @property
    def mean_power_w(self) -> float:
        """Mean measured power."""
        return self.design.layout.mean_power_w

    def without(self, effects: Sequence[str]) -> Ground:
        """The ground without some of the effects found."""
        held = tuple((name, own) for name, own in self.held if name not in effects)
        inside = tuple(k for k in self.chosen if any(k in own for _, own in held))
        noise = fit_noise(self.design, inside, self.model.noise, thorough=False)
        return replace(self, model=replace(self.model, chosen=inside, noise=noise), held=held)

    def plain(self, noise: Noise) -> Noise:
        """A noise whose weights were not read off the residual: where an unknown law acts, rows look like outliers."""
        return for_rows(self.design, noise)

    def usual(self) -> Noise:
        """Noise as meters and drives usually have it, whatever this residual looks like."""
        return start_noise(self.design)

    def averaged(self, raw: Sequence[Array]) -> Array:
        """Columns (k, rows) of each run at the raw rate as rows of the design, shape (k, n)."""
        return self.model.source.averaged(raw, self.model.clock)

    def with_law(self, watts: Array, start: Noise | None = None) -> Model:
        """The model with one more column (power for a coefficient of 1, averaged, shape (n,)) and noise of its own.

        The fit begins at usual noise, or at that of a like law: where the null took the law for noise, and its rows for
        outliers, it would stay there.
        """
        design = self.extended(watts)
        chosen = tuple(range(len(design.phi)))
        if self.model.squares is not None:
            squares = LeastSquares.of(design)
            noise = bounded_noise(design, squares, chosen)
            return Model(self.model.source, chosen, self.model.clock, design, noise, squares)
        noise = fit_noise(design, chosen, start, thorough=start is None)
        return Model(self.model.source, chosen, self.model.clock, design, noise)

    def at_noise(self, design: Design, noise: Noise) -> Model:
        """An extended design as a model at a noise that was not fitted with it."""
        return Model(self.model.source, tuple(range(len(design.phi))), self.model.clock, design, noise)

    def on_time(self, raw: Sequence[Array], fitted: Model) -> Ground:
        """The ground at the clock that the law asks for; itself where that is hardly better.

        Without the law its own lag could not be seen. `raw`: power of the law in each run at the raw rate, (1, rows).
        """
        source, was = self.model.source, self.model.clock

        def score(delay_s: float, lag_s: float) -> float:
            clock = replace(was, delay_s=delay_s, lag_s=lag_s)
            there = replace(self, model=replace(self.model, clock=clock, design=source.design(clock, self.chosen)))
            columns = replace(there, model=replace(there.model, chosen=tuple(range(len(self.chosen)))))
            design = columns.extended(source.averaged(raw, clock)[0])
            return log_likelihood(replace(fitted, clock=clock, design=design, squares=None))

        if not source.aligned:
            return self
        best = (score(was.delay_s, was.lag_s), was.delay_s, was.lag_s)
        first = best[0]
        for lag in LAGS_S:
            best = max(best, (score(best[1], lag), best[1], lag))
        for delay in DELAYS_S:
            best = max(best, (score(was.delay_s + delay, best[2]), was.delay_s + delay, best[2]))
        if best[0] < first + CLOCK_NATS:
            return self
        clock = replace(was, delay_s=best[1], lag_s=best[2])
        design = source.design(clock)
        squares = None if self.model.squares is None else LeastSquares.of(design)
        if squares is None:
            noise = fit_noise(design, self.chosen, self.model.noise, thorough=False)
        else:
            noise = bounded_noise(design, squares, self.chosen)
        return replace(self, model=replace(self.model, clock=clock, design=design, noise=noise, squares=squares))

    def extended(self, watts: Array) -> Design:
        """The design with the columns of the effects found and the law, in shares of energy; the law comes last."""
        layout = self.design.layout
        mean = float(np.average(np.abs(watts), weights=self.design.duration_s))
        columns = (*(layout.columns[k] for k in self.chosen), Column(-1, 0, "law", mean))
        phi = np.vstack([self.design.phi[list(self.chosen)], watts * (layout.mean_power_w / max(mean, 1e-300))])
        return replace(self.design, layout=replace(layout, columns=columns), phi=phi)


def ground_of(found: Identification, covariates: Sequence[Mapping[str, Any]]) -> Ground:
    """The ground of an identification: effects that it names stay in, those that it puts in doubt do not.

    Parameters
    ----------
    found : Identification
    covariates : sequence of mapping
        Of every run that was given to it, at the raw rate.
    """
    model = found.choice.model
    columns = model.design.layout.columns
    names = [e.effect for e in found.effects]
    held = tuple(
        (name, tuple(k for k in model.chosen if found.library[columns[k].candidate].effect == name)) for name in names
    )
    inside = tuple(k for k in model.chosen if any(k in own for _, own in held))
    model = spread(model)
    if inside != model.chosen:
        model = replace(model, chosen=inside, noise=fit_noise(model.design, inside, model.noise, thorough=False))
    return Ground(model, tuple(covariates[i] for i in model.source.kept), held)


def evidence(model: Model) -> float:
    """Log evidence with the model's own noise."""
    return log_likelihood(model)


def library_columns(ground: Ground) -> tuple[Array, NDArray[np.intp]]:
    """Columns of the library, shape (p, n), and the number of the candidate of each."""
    return ground.design.phi, np.array([c.candidate for c in ground.design.layout.columns], dtype=np.intp)
