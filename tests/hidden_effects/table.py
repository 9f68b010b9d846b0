"""The table of the study, in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

Row = dict[str, Any]


def _rate(rows: Sequence[Row], key: str) -> str:
    """Share of the rows where the question arises, as 'p % (k/n)'."""
    asked = [row[key] for row in rows if row.get(key) is not None]
    if not asked:
        return "–"
    return f"{100.0 * sum(asked) / len(asked):.0f} % ({sum(asked)}/{len(asked)})"


def _mean(rows: Sequence[Row], key: str, digits: int = 2) -> str:
    values = np.array([row[key] for row in rows if isinstance(row.get(key), float)], dtype=float)
    values = values[np.isfinite(values)]
    return f"{np.mean(values):.{digits}f}" if len(values) else "–"


def removed(rows: Sequence[Row], key: str, power: float = 1.0) -> float:
    """Part of the removable held-out error that is removed: Σ(nominal − method) / Σ(nominal − truth known).

    Errors in W are divided by the nominal one first, so that a strong robot weighs no more than a weak one.
    """
    gain, best = 0.0, 0.0
    for row in rows:
        method, base, known = (float(row.get(k) or np.nan) for k in (key, f"nominal_{key}", f"oracle_{key}"))
        if np.isfinite(method + base + known):
            scale = base if key.endswith("_w") else 1.0
            gain += (base / scale) ** power - (method / scale) ** power
            best += (base / scale) ** power - (known / scale) ** power
    return gain / best if best > 0 else float("nan")


def _removed(rows: Sequence[Row], key: str, power: float = 1.0) -> str:
    value = removed(rows, key, power)
    return "–" if not np.isfinite(value) else f"{100.0 * value:.0f} %" if value > -1.0 else "worse than nominal"


def markdown(rows: Sequence[Row], heading: str) -> str:
    """The whole study as Markdown: one table by group and method, one by effect and share for the product."""
    rows = [row | {"found": bool(row["in_set"]) if row["first_right"] is not None else None} for row in rows]
    lines = [f"# Hidden effects: {heading}", ""]
    head = (
        "group", "method", "n", "right name first", "exactly right", "all named", "a wrong name",
        "truth in the set", "confident wrong name", "cannot tell, kept honest",
        "resolved by one / two proposed experiments", "outside: says so",
        "held-out energy error % nominal → method (truth known)", "removed (energy)", "removed (power²)",
        "interval covers", "s",
    )  # fmt: skip
    lines += ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for group in dict.fromkeys(row["group"] for row in rows):
        for method in dict.fromkeys(row["method"] for row in rows):
            part = [row for row in rows if row["group"] == group and row["method"] == method]
            if not part:
                continue
            names = method != "boosted trees"
            intervals = sum(row["intervals"] for row in part)
            covered = sum(row["covered"] for row in part)
            errors = (
                f"{_mean(part, 'nominal_energy_error_pct')} → {_mean(part, 'energy_error_pct')} "
                f"({_mean(part, 'oracle_energy_error_pct')})"
            )
            cells = [group, method, str(len(part))]
            for key in ("first_right", "exact", "all_named", "any_wrong", "in_set", "confident_wrong", "honest"):
                cells.append(_rate(part, key) if names else "–")
            resolved = [_rate(part, key) for key in ("resolved_by_one", "resolved_by_two")]
            cells += [" / ".join(resolved) if resolved[0] != "–" else "–", _rate(part, "outside_said")]
            cells += [errors, _removed(part, "energy_error_pct"), _removed(part, "rmse_w", 2.0)]
            cells.append(f"{100.0 * covered / intervals:.0f} % ({covered}/{intervals})" if intervals else "–")
            cells.append(_mean(part, "seconds"))
            lines.append("| " + " | ".join(cells) + " |")
    lines[2:2] = _goals(rows)
    lines += ["", *_by_effect(rows), "", *_troubles(rows)]
    return "\n".join(lines).rstrip() + "\n"


def _of_oracle(rows: Sequence[Row], group: str, key: str) -> str:
    """How often missionsim is right for each time that the oracle is, as 'p % (k/n)'; '–' without an oracle."""
    ours, best = (
        sum(bool(row[key]) for row in rows if row["group"] == group and row["method"] == method)
        for method in ("missionsim", "oracle")
    )
    return f"{100.0 * ours / best:.0f} % ({ours}/{best})" if best else "–"


def _goals(rows: Sequence[Row]) -> list[str]:
    """The goals of the study beside what missionsim reached."""
    ours = [row for row in rows if row["method"] == "missionsim"]
    if not ours:
        return []

    def of(*groups: str) -> list[Row]:
        return [row for row in ours if row["group"] in groups]

    def seen(part: list[Row]) -> list[Row]:
        # `too_small`: no wrong name, and each effect left out lies below the detection limit that the report prints
        return [row for row in part if not row.get("too_small")]

    effects = of("one effect, 2 %", "one effect, 5 %", "one effect, 10 %", "two effects")
    covered, intervals = (sum(row[key] for row in ours) for key in ("covered", "intervals"))
    lines = [
        ("nothing hidden: nothing named", "≥ 98 %", _rate(of("nothing hidden"), "exact")),
        ("2 % of the energy: right name first", "≥ 95 %", _rate(of("one effect, 2 %"), "first_right")),
        (
            "2 %: right name first, without silence about what the report says it cannot see",
            "–",
            _rate(seen(of("one effect, 2 %")), "first_right"),
        ),
        *(
            (f"{text}, of what the oracle names", "≥ 95 %", _of_oracle(rows, group, key))
            for text, group, key in (
                ("1 %: right name first", "one effect, 1 %", "first_right"),
                ("2 %: right name first", "one effect, 2 %", "first_right"),
                ("pairs: both named", "two effects", "all_named"),
            )
        ),
        ("5 % of the energy: right name first", "100 %", _rate(of("one effect, 5 %"), "first_right")),
        ("5 %: truth named or in the set of what cannot be told apart", "100 %", _rate(of("one effect, 5 %"), "found")),
        ("pairs: both named", "≥ 90 %", _rate(of("two effects"), "all_named")),
        (
            "pairs: both named, without silence about what the report says it cannot see",
            "–",
            _rate(seen(of("two effects")), "all_named"),
        ),
        ("pairs: both named or in the set of what cannot be told apart", "–", _rate(of("two effects"), "all_in_set")),
        (
            "removable held-out energy error removed (2, 5, 10 %, pairs)",
            "≥ 95 %",
            _removed(effects, "energy_error_pct"),
        ),
        ("confounded: a confident wrong name", "0 %", _rate(of("confounded"), "confident_wrong")),
        ("outside the library: a confident wrong name", "0 %", _rate(of("outside"), "confident_wrong")),
        ("outside, beside one of the library: a confident wrong name", "0 %", _rate(of("mixed"), "confident_wrong")),
        ("in all cases: a confident wrong name", "0 %", _rate(ours, "confident_wrong")),
        ("confounded: cannot tell, kept honest", "100 %", _rate(of("confounded"), "honest")),
        (
            "confounded: resolved by at most two proposed experiments",
            "≥ 95 %",
            _rate(of("confounded"), "resolved_by_two"),
        ),
        ("behaviour: right name first", "–", _rate(of("execution"), "first_right")),
        ("intervals cover", "95 %", f"{100 * covered / intervals:.0f} % ({covered}/{intervals})" if intervals else "–"),
    ]
    out = ["| goal | asked | reached |", "|---|---|---|"]
    return out + [f"| {' | '.join(line)} |" for line in lines if line[2] != "–"] + [""]


def _by_effect(rows: Sequence[Row]) -> list[str]:
    """Right name first of missionsim by planted effect and share."""
    groups = [f"one effect, {s} %" for s in (1, 2, 5, 10)]
    ours = [r for r in rows if r["method"] == "missionsim" and r["group"] in groups]
    if not ours:
        return []
    effects = dict.fromkeys(r["case"].rsplit("-", 1)[0] for r in ours)
    lines = ["## Right name first, by effect and share (missionsim)", "", "| effect | 1 % | 2 % | 5 % | 10 % |"]
    lines.append("|---|---|---|---|---|")
    for effect in effects:
        cells = []
        for g in groups:
            part = [r for r in ours if r["group"] == g and r["case"].rsplit("-", 1)[0] == effect]
            note = "recalibrated" if any(r["expected"] == "recalibration" for r in part) else ""
            cells.append(" ".join(x for x in (_rate(part, "first_right"), note) if x and x != "–") or "–")
        lines.append(f"| {effect} | " + " | ".join(cells) + " |")
    return lines


def _troubles(rows: Sequence[Row]) -> list[str]:
    """Every case where missionsim was not right, so that nobody has to dig."""
    lines = ["## Where missionsim was not right", ""]
    for row in rows:
        if row["method"] != "missionsim":
            continue
        bad = row.get("failure") or row["confident_wrong"] or row["exact"] is False or row["honest"] is False
        if bad:
            what = "failed" if row.get("failure") else f"named: {row['named'] or 'nothing'}"
            sets = f" · cannot tell: {row['sets']}" if row["sets"] else ""
            lines.append(f"- {row['case']} seed {row['seed']}: {what} · {row['verdict']}{sets}")
    return lines if len(lines) > 2 else []
