"""One fitted model: clock, noise and Gram matrices for a set of chosen effects, fitted in turns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from missionsim.identify import settings as const
from missionsim.identify.align import Clock, uphill
from missionsim.identify.data import Constraints
from missionsim.identify.design import Design, Source
from missionsim.identify.gram import Gram, make_gram, random_effects, reduced
from missionsim.identify.noise import Noise, start_factor, start_noise
from missionsim.identify.predictive import LeastSquares
from missionsim.identify.reml import fit_noise, on_rows
from missionsim.physics import Array


@dataclass(frozen=True)
class Model:
    """Everything known once a set of effects is in the model."""

    source: Source
    chosen: tuple[int, ...]
    """Numbers of the regression columns in the model."""
    clock: Clock
    design: Design
    noise: Noise
    """Both, and `gram`: at the clock of this model."""
    squares: LeastSquares | None = None
    """Least squares at this clock, where it predicts left-out runs better than the noise model does."""

    @property
    def constraints(self) -> Constraints:
        """Whose columns these are, and what they must obey."""
        return self.source.constraints

    @cached_property
    def gram(self) -> Gram:
        """Gram matrices of all columns."""
        return make_gram(self.design, self.noise)

    def estimate(self, chosen: Sequence[int]) -> tuple[Array, Array]:
        """Coefficients that a robot file can hold: relative shifts of the base, then shares of columns.

        They give the measured energy of the fitted runs together (see `LeastSquares.unbiased`).

        Parameters
        ----------
        chosen : columns in the model

        Returns
        -------
        value : shape (q + chosen,)
        covariance : from leaving runs out where least squares is used, of the noise model elsewhere
        """
        squares = self.squares or LeastSquares.of(self.design)
        value, covariance = self.gram.joint(chosen, squares.q) if self.squares is None else squares.jackknife(chosen)
        return squares.unbiased(chosen, value, covariance), covariance


def spread(model: Model) -> Model:
    """The model on runs spread evenly over all where they are many."""
    numbers = spread_runs(len(model.design.runs), len(model.design.y), const.FEWEST_FITTED // 2)
    if len(numbers) == len(model.design.runs):
        return model
    design, at = model.design.of_runs(numbers)
    squares = None if model.squares is None else LeastSquares.of(design)
    clock, source = model.clock.of_runs(numbers), model.source.of_runs(numbers)
    return Model(source, model.chosen, clock, design, model.noise.of_rows(at), squares)


def score(source: Source, clock: Clock, noise: Noise, chosen: Sequence[int]) -> float:
    """Log-likelihood of the chosen columns at a clock, noise given; base parameters and run effects integrated out."""
    gram, log_det = reduced(source.design(clock, chosen), noise, range(len(chosen)))
    # the prior of the runs' own delays, which the search moves as well
    spread = sum((d / const.RUN_DELAY_SD_S) ** 2 for d in clock.run_delay_s)
    return gram.evidence(range(len(chosen))) - 0.5 * log_det - 0.5 * spread


def spread_runs(runs: int, rows: int, fewest: int = const.FEWEST_FITTED) -> list[int]:
    """Numbers of runs, spread evenly over all, that together have at most about `MOST_FITTED` rows."""
    few = min(runs, max(fewest, math.ceil(runs * const.MOST_FITTED / max(rows, 1))))
    return sorted({int(j) for j in np.linspace(0, runs - 1, few).round()})


def fitted_noise(design: Design, chosen: Sequence[int], guess: Noise | None = None, thorough: bool = True) -> Noise:
    """`fit_noise`, from some of the runs where they are many."""
    numbers = spread_runs(len(design.runs), len(design.y))
    if len(numbers) == len(design.runs):
        return fit_noise(design, chosen, guess, thorough)
    part, at = design.of_runs(numbers, const.MOST_FITTED // len(numbers))
    known = None if guess is None else guess.of_rows(at)
    return on_rows(design, fit_noise(part, chosen, known, thorough), chosen)


def refine_clock(source: Source, clock: Clock, noise: Noise, chosen: Sequence[int], rounds: int = 2) -> Clock:
    """Common delay and lag by pattern search, delays of single runs from their jitter effect, in turns."""
    reach = max(1.0, source.layout.step_s)
    numbers = spread_runs(len(source.runs), len(noise.weight), const.FEWEST_FITTED // 2)
    some, part = source, noise
    if len(numbers) < len(source.runs):
        some, part = source.of_runs(numbers), noise.of_rows(source.rows_of(numbers))
    steps = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, -1), (-1, 1), (-1, 2), (1, -2)]
    for turn in range(rounds):
        own = clock.of_runs(numbers)

        @cache
        def value(delay: float, lag: float, own: Clock = own) -> float:
            return score(some, replace(own, delay_s=delay, lag_s=lag), part, chosen)

        at = (round(clock.delay_s, 3), round(clock.lag_s, 3))
        if turn == 0:  # a delay is easily taken for a lag: look along the ridge of equal sums
            ridge = [(round(at[0] - d * reach, 3), round(at[1] + d * reach, 3)) for d in (-0.4, -0.2, 0, 0.2, 0.4)]
            at = max((place for place in ridge if place[1] >= 0), key=lambda place: value(*place))
        delay_s, lag_s = uphill(value, at, reach, steps, 6, 3, const.CLOCK_RISE_NATS)
        # the lag has no lower end, and 1.3 rows is as far as the steps go
        at_edge = abs(delay_s) > 1.0 * reach or lag_s > 1.3 * reach
        clock = replace(clock, delay_s=delay_s, lag_s=lag_s, at_edge=at_edge)
        if len(source.runs) > 1:
            design = source.design(clock, chosen)
            delays = np.asarray(clock.run_delay_s) + random_effects(design, noise, range(len(chosen)))[:, 3]
            mean = float(np.mean(delays))
            each = np.clip(delays - mean, -const.LARGEST_RUN_DELAY_S, const.LARGEST_RUN_DELAY_S)
            clock = replace(clock, delay_s=clock.delay_s + mean, run_delay_s=tuple(float(d) for d in each))
    return clock


def fit_model(source: Source, chosen: Sequence[int], start: Model | None = None, thorough: bool = True) -> Model:
    """Fit clock and noise for a set of effects, starting from a neighbouring model."""
    chosen = tuple(chosen)
    clock = start.clock if start else source.clock
    design = start.design if start and start.source is source else source.design(clock)
    guess = start.noise if start else None
    # without a start, or where runs differ by more than meters do
    anew = guess is None or (
        max(guess.gain, guess.motion_gain, guess.offset_w / design.layout.mean_power_w) > const.UNUSUAL_GAIN
    )
    if guess is not None and anew:
        # what a new effect explains had passed for differences between runs, and a fit from there would stay there
        fresh = start_noise(design)
        shape = {name: getattr(fresh, name) for name in ("fast_s", "slow_s", "fast_share", "slow_share")}
        guess = replace(
            guess,
            gain=min(guess.gain, const.USUAL_GAIN),
            motion_gain=min(guess.motion_gain, const.USUAL_GAIN),
            offset_w=min(guess.offset_w, fresh.offset_w),
            **shape,
        )
    noise = fitted_noise(design, chosen, guess, thorough=anew)
    if source.aligned:
        clock = refine_clock(source, clock, noise, chosen, 2 if start is None else 1)
        design = source.design(clock)
        noise = fitted_noise(design, chosen, noise, thorough=thorough or (guess is not None and anew))
    return Model(source, chosen, clock, design, noise)


def log_likelihood(model: Model) -> float:
    """Log evidence of the model with its own noise, for comparing models whose noise was fitted separately."""
    noise, design = model.noise, model.design
    gram, log_det = reduced(design, noise, model.chosen)
    start = 0.5 * len(design.stretches) * start_factor(*noise.shape)[2]
    level = float(np.sum(np.log(noise.sigma_w * noise.scale / np.sqrt(noise.weight)))) + start
    return gram.evidence(range(len(model.chosen))) - 0.5 * log_det - level


def prediction(model: Model, chosen: Sequence[int], design: Design) -> Array:
    """Power that a model with some of its effects predicts at the rows of a design [W], shape (n,).

    Base parameters at their most probable values with these effects in; what a robot file cannot hold is left out:
    offsets and gains of single runs, and the nuisances of clock, curvature and switching.
    """
    value, _ = model.estimate(chosen)
    count = len(design.layout.parameters)
    power = design.base + value[:count] @ design.gradient[:count]
    if len(chosen):
        power = power + value[count:] @ design.phi[list(chosen)]
    return np.asarray(power)
