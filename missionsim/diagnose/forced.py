"""The same effects fitted to other runs, without a search."""

from __future__ import annotations

from missionsim.diagnose.features import Features
from missionsim.identify.choose import Choice
from missionsim.identify.data import Settings
from missionsim.identify.design import make_source
from missionsim.identify.model import fit_model
from missionsim.identify.result import Identification


def forced_choice(features: Features, found: Identification, settings: Settings) -> Choice | None:
    """Fit the columns that an identification chose to other runs of the same features.

    Returns None where one of them never acts in these runs, or where the runs are too short.
    """
    layout = found.choice.model.design.layout
    wanted = [layout.columns[k].name for k in found.choice.model.chosen]
    try:
        source = make_source(features.runs, features.candidates, features.prior_sd, settings)
    except ValueError:
        return None
    numbers = {column.name: k for k, column in enumerate(source.layout.columns)}
    if any(name not in numbers for name in wanted):
        return None
    empty = fit_model(source, ())
    model = fit_model(source, tuple(numbers[name] for name in wanted), empty, thorough=False)
    return Choice(model, empty, found.choice.spread, {})
