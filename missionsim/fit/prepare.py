"""Logs and a power model as rows for a fit: base power and its gradient at the raw rate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.model import ModelParameter, PowerModel
from missionsim.errors import InputError
from missionsim.fit.covariates import Run, run_covariates, shared_names, texts, watched
from missionsim.fit.gradient import gradient
from missionsim.identify.data import RunData

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prepared:
    """Runs of one battery, with the base model evaluated.

    Attributes
    ----------
    battery : str
    runs : tuple of Run
    names : frozenset of str
        Covariates that every run has.
    texts : mapping
        Distinct texts of each text column over all runs.
    base_w : tuple of ndarray
        Power of the base model of each run [W].
    gradients : tuple of mapping
        ``∂P/∂ln θ`` by parameter, of each run [W].
    parameters : mapping of str to ModelParameter
        Base parameters by their name within the battery.
    remarks : list of str
        What was assumed or left out, in words.
    """

    battery: str
    runs: tuple[Run, ...]
    names: frozenset[str]
    texts: Mapping[str, tuple[str, ...]]
    base_w: tuple[Array, ...]
    gradients: tuple[Mapping[str, Array], ...]
    parameters: Mapping[str, ModelParameter]
    remarks: list[str]

    def data(self, columns: Sequence[Mapping[str, Array]] | None = None) -> tuple[RunData, ...]:
        """The runs as the identification reads them, with candidate columns where given."""
        own: Sequence[Mapping[str, Array]] = columns if columns is not None else [{} for _ in self.runs]
        return tuple(self._one(i, own[i]) for i in range(len(self.runs)))

    def _one(self, number: int, columns: Mapping[str, Array]) -> RunData:
        run, base_w, slopes = self.runs[number], self.base_w[number], self.gradients[number]
        broken = ~np.isfinite(base_w)
        for values in slopes.values():
            broken |= ~np.isfinite(values)
        measured = run.measured_w
        if broken.any():
            self.remarks.append(
                f"{run.name}: the base model has no value in {int(broken.sum())} rows; they are left out"
            )
            measured = np.where(broken, np.nan, measured)
            base_w = np.where(broken, 0.0, base_w)
            slopes = {name: np.where(broken, 0.0, values) for name, values in slopes.items()}
        return RunData(
            run.name,
            run.time_s,
            run.dt_s,
            measured,
            base_w,
            slopes,
            columns,
            watched(run, set(self.names), self.texts),
            run.fresh,
        )


def prepare(model: PowerModel, logs: Sequence[Any], battery: str) -> Prepared:
    """Covariates, base power and gradient of every run that measures a battery.

    Parameters
    ----------
    model : PowerModel
    logs : sequence of LogTable
    battery : str

    Raises
    ------
    missionsim.errors.InputError
        Where the base model needs a column that the logs lack, or no log measures the battery.
    """
    tables = [log for log in logs if battery in log.power_w]
    if not tables:
        raise InputError.single(f"no log measures the battery '{battery}'", allowed=f"power_{battery}_w")
    remarks: list[str] = []
    runs = [run_covariates(model, log, battery, remarks) for log in tables]
    names = shared_names(runs, remarks)
    lacking = model.missing(dict.fromkeys(names, 0.0), battery)
    if lacking:
        needed = sorted({name for columns in lacking.values() for name in columns})
        raise InputError.single(
            f"the model of battery '{battery}' needs columns that the logs lack",
            got=", ".join(sorted(set.intersection(*(set(log.columns) for log in tables)))),
            allowed=", ".join(needed),
        )
    parameters = {
        term.name_of(name): parameter for term in model.of(battery) for name, parameter in term.parameters.items()
    }
    return Prepared(
        battery,
        tuple(runs),
        frozenset(names),
        texts(runs, names),
        tuple(_base(model, run, battery) for run in runs),
        tuple(gradient(model, run.cov, battery) for run in runs),
        parameters,
        remarks,
    )


def _base(model: PowerModel, run: Run, battery: str) -> Array:
    total = np.asarray(model.total(run.cov, battery), dtype=float)
    return np.ascontiguousarray(np.broadcast_to(total, run.time_s.shape))
