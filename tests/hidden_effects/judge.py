"""What counts as right: one method's outcome against the answer of a case."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from .peers import Outcome

LIBRARY = frozenset(
    [
        *("grade", "payload", "acceleration", "turning_scrub", "rolling_friction", "viscous_friction"),
        *("aerodynamic_drag", "surface_rolling_resistance", "cold_friction", "temperature_friction", "start_surge"),
        *("conversion_loss", "standby_load", "cpu_load", "cpu_frequency", "radio_range", "path_stretch"),
        *("speed_tracking", "dwell"),
    ]
)
PRACTICE_EQUIVALENT = {  # designs of the practice logs that no method can resolve
    "carpet_payload": ("payload", "surface_rolling_resistance"),
    "cold_is_payload": ("payload", "temperature_friction"),
    "const_speed": ("aerodynamic_drag", "viscous_friction", "rolling_friction"),
}


def in_library(effect: str) -> bool:
    """Whether the contract's library holds the effect."""
    return effect in LIBRARY or effect.startswith(("component_power:", "component_warmup:"))


def behaviour(effect: str) -> bool:
    """Whether the effect is one of the execution of the plan."""
    return effect in {"path_stretch", "speed_tracking", "dwell"}


def expected(answer: Mapping[str, Any]) -> str:
    """'nothing' | 'outside' | 'name' | 'either' (a calibration twin near the 4-sd border) | 'recalibration'."""
    hidden = list(answer["hidden"])
    if not hidden:
        return "nothing"
    if any(not in_library(e) for e in hidden):
        return "outside"
    shifts = [abs(x) for x in answer.get("shift_in_prior_sd", {}).values()]
    if shifts and min(shifts) < 3.0:
        return "recalibration"
    return "either" if shifts and min(shifts) < 5.0 else "name"


def group(case: str) -> str:
    """Row of the table that a case belongs to."""
    if case.startswith("nothing"):
        return "nothing, 1 % model discrepancy" if case.endswith("level3") else "nothing hidden"
    if case.startswith("two-"):
        return "two effects"
    for start in ("outside", "confounded", "execution", "mixed"):
        if case.startswith(start):
            return start
    found = re.search(r"-(\d+)pct(?:-(.*))?$", case)
    if not found:
        return "other"
    variant = {
        "two-runs": "two runs",
        "one-run": "one run",
        "level3": "1 % model discrepancy",
        "10hz": "10 Hz",
        "half-hz": "0.5 Hz",
        "energy": "energy only",
        "bare": "no acceleration logged",
    }
    extra = found.group(2)
    return f"one effect, {found.group(1)} %" + (f", {variant.get(extra, 'other robots')}" if extra else "")


def judge(case: str, seed: int, answer: Mapping[str, Any], outcome: Outcome) -> dict[str, Any]:
    """Row of results: every field is a number, a truth value or None where the question does not arise."""
    hidden, want, named = list(answer["hidden"]), expected(answer), list(outcome.names)
    design = str(answer.get("design", "rich"))
    same = tuple(answer.get("equivalent") or PRACTICE_EQUIVALENT.get(design, ()))
    credible = {name: {name, *outcome.sets.get(name, ())} for name in named}
    wrong = [e for e in named if e not in hidden]
    confident = [e for e in wrong if not credible[e] & set(hidden)]
    if want == "either" and not named:
        want = "recalibration"
    elif want == "either":
        want = "name"
    naming = want == "name"
    row: dict[str, Any] = {
        "group": group(case),
        "case": case,
        "seed": seed,
        "method": outcome.method,
        "expected": want,
        "named": " ".join(named),
        "sets": "; ".join(f"{n}|{','.join(s)}" for n, s in outcome.sets.items() if s),
        "verdict": outcome.verdict,
        "first_right": bool(named and named[0] in hidden) if naming else None,
        "exact": set(named) == set(hidden) if naming else (not named if want != "outside" else None),
        "all_named": set(hidden) <= set(named) if naming else None,
        "all_in_set": set(hidden) <= set().union(*credible.values()) if naming else None,
        "in_set": bool(set().union(*credible.values()) & set(hidden)) if naming and named else None,
        "missed": not named if naming else None,
        "any_wrong": bool(wrong),
        "confident_wrong": bool(confident),
        "honest": None,
        "overconfident": None,
        "outside_said": outcome.verdict == "unexplained_structure" if want == "outside" and outcome.verdict else None,
        "law": outcome.law,
        "energy_error_pct": outcome.energy_error_pct,
        "rmse_w": outcome.rmse_w,
        "seconds": outcome.seconds,
    }
    if naming and len(same) > 1:
        whole = set().union(*credible.values()) if credible else set()
        ambiguous = any(len(s) > 1 for s in credible.values())
        row["honest"] = bool(set(hidden) <= whole and ambiguous)
        row["overconfident"] = bool(named and not ambiguous)
    true = answer.get("share_true") or dict.fromkeys(hidden, answer["share_of_energy"])
    # a plan that is not kept costs another share of the energy than the strength that the case asks for
    inside = [s[1] <= true[e] <= s[2] for e, s in outcome.shares.items() if e in hidden and not behaviour(e)]
    missing = [e for e in hidden if e not in named]
    silent = naming and bool(missing) and not wrong
    row["too_small"] = silent and all(outcome.limits.get(e, 0.0) > true[e] for e in missing)
    row["covered"], row["intervals"] = sum(inside), len(inside)
    return row
