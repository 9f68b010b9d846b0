"""How often the proposed law is right: ``python -m tests.laws.study --seeds 1:4 [--share 0.05] [--out DIR] [LAW ...]``.

Files in, the contract's JSON out, as a user sees it; one row a case, one table of rates.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from tests.hidden_effects.product import robot_argument

from .world import LAWS, MEMORY, Made, make

ROBOT = "pioneer3dx"
LIBRARY_TWIN = frozenset({"cpu_load"})


def case(law: str | None, seed: int, share: float, **more: Any) -> dict[str, Any]:
    """Make a case, diagnose it, judge the answer."""
    made = make(law, seed, share, **more)
    with tempfile.TemporaryDirectory() as folder:
        train, heldout = made.write(Path(folder))
        report, seconds = diagnose(train, heldout)
    return judge(law, seed, share, made, report) | {"seconds": seconds}


def diagnose(train: Path, heldout: Path, robot: str = ROBOT) -> tuple[dict[str, Any], float]:
    """The diagnosis of the battery ``robot`` as JSON, and the CPU time it took."""
    from missionsim.diagnose import diagnose_files

    start = time.process_time()
    found = diagnose_files(robot_argument(robot), [train], holdout=[heldout])
    report = json.loads(json.dumps(found.to_json()))
    return report["batteries"]["robot"], time.process_time() - start


def judge(law: str | None, seed: int, share: float, made: Made, report: dict[str, Any]) -> dict[str, Any]:
    """One row: every field a number, a truth value, a text, or None where the question does not arise."""
    proposed = report["proposed_laws"]
    row: dict[str, Any] = {
        "law": law or "nothing",
        "seed": seed,
        "share": share,
        "verdict": report["verdict"],
        "effects": [e["effect"] for e in report["effects"]],
        "proposed": bool(proposed),
        "formula": proposed[0]["forms"][0]["formula"] if proposed else "",
        "forms": len(proposed[0]["forms"]) if proposed else 0,
        "variables": None,
        "certain": None,
        "open": bool(proposed) and len({frozenset(form["depends_on"]) for form in proposed[0]["forms"]}) > 1,
        "band": None,
        "removed": None,
        "found_share": proposed[0]["energy_share"] if proposed else None,
    }
    if law is None:
        return row
    truth = set(LAWS[law].variables)
    if law not in MEMORY:
        row["variables"] = bool(proposed) and set(proposed[0]["forms"][0]["depends_on"]) == truth
        row["certain"] = bool(proposed) and set(proposed[0]["depends_on"]) <= truth
    if proposed and law not in MEMORY and proposed[0]["curve"]:
        row["band"] = held_by_band(law, made, proposed[0]["curve"])
    row["removed"] = removed(made, report)
    return row


def held_by_band(law: str, made: Made, curve: dict[str, Any]) -> float:
    """Part of the range of the leading quantity in which the band holds the true curve."""
    x = np.array(curve["x"])
    typical = {name: np.full(len(x), _typical(made, name)) for name in STATE}
    fixed = {k: np.full(len(x), float(v)) for k, v in curve["at"].items() if not isinstance(v, str)}
    state = typical | fixed | {curve["variable"]: x}
    if curve["at"].get("surface") is not None:
        state["carpet"] = np.full(len(x), float(curve["at"]["surface"] == "carpet"))
    if curve["variable"] not in state or curve["variable"].startswith(("on_time", "moving_time")):
        return 0.0
    true = made.strength * np.asarray(LAWS[law].form(state), dtype=float)
    return float(np.mean((true >= np.array(curve["low"])) & (true <= np.array(curve["high"]))))


STATE = (
    *("speed_m_s", "yaw_rate_rad_s", "accel_m_s2", "slope_rad", "payload_kg", "temp_ambient_c", "cpu_load", "time_s"),
    *("arm_torque", "on_kinect", "on_laser"),
)


def _typical(made: Made, name: str) -> float:
    return float(np.median(np.abs(np.concatenate([log[name] for log in made.train.values()]).astype(float))))


def removed(made: Made, report: dict[str, Any]) -> float:
    """Part of the removable held-out power error that is removed: 0 as recalibrated, 1 as if the truth were known."""
    held = report["heldout"]["power_rmse_w"]
    before, after = held["recalibrated"], held["with_effects"]
    if report["proposed_laws"] and report["proposed_laws"][0]["heldout_rmse_w"]:
        after = report["proposed_laws"][0]["heldout_rmse_w"]["after"]
    noise = [log["power_robot_w"] - made.power_w[run] for run, log in made.heldout.items()]
    floor = float(np.sqrt(np.mean(np.concatenate(noise) ** 2)))
    return float((before - after) / max(before - floor, 1e-9))


def table(rows: list[dict[str, Any]]) -> str:
    """Rates over all rows, and each case that went wrong."""
    hidden = [r for r in rows if r["law"] != "nothing" and r["law"] not in MEMORY]
    nulls = [r for r in rows if r["law"] == "nothing"]
    lines = ["| | asked | reached |", "|---|---|---|"]

    def rate(name: str, asked: str, values: list[bool]) -> None:
        if values:
            share = 100 * sum(values) / len(values)
            lines.append(f"| {name} | {asked} | {sum(values)} of {len(values)} ({share:.0f} %) |")

    rate("right variables first", "90 %", [bool(r["variables"]) for r in hidden])
    rate("no wrong variable called certain", "–", [bool(r["certain"]) for r in hidden if r["proposed"]])
    rate(
        "band holds the true curve over 90 % of its range",
        "90 %",
        [r["band"] >= 0.9 for r in hidden if r["band"] is not None],
    )
    rate("80 % of the removable held-out error removed", "–", [r["removed"] >= 0.8 for r in hidden])
    if hidden:
        mean = 100 * float(np.mean([min(max(r["removed"], -1.0), 1.0) for r in hidden]))
        lines.append(f"| removable held-out error removed, mean | 80 % | {mean:.0f} % |")
    memory = [r for r in rows if r["law"] in MEMORY]
    rate("laws with a state of their own: something is said", "–", [r["verdict"] != "nothing_missing" for r in memory])
    rate("a formula on nothing hidden", "≤ 2 %", [r["proposed"] for r in nulls])
    lines.append(f"| CPU seconds a case, median | 5 | {np.median([r['seconds'] for r in rows]):.1f} |")
    lines += [
        "",
        "| law | seed | formula shown first | variables | band | removed | effects named |",
        "|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        number = {k: "" if r[k] is None else f"{r[k]:.2f}" for k in ("band", "removed")}
        right = "" if r["variables"] is None else ("right" if r["variables"] else "wrong")
        lines.append(
            f"| {r['law']} | {r['seed']} | `{r['formula']}` | {right} | {number['band']} | {number['removed']} | "
            f"{', '.join(r['effects'])} |"
        )
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("laws", nargs="*", help="names; none = all of them and nothing")
    parser.add_argument("--seeds", default="1:2")
    parser.add_argument("--share", type=float, default=0.05)
    parser.add_argument("--nulls", type=int, default=1, help="cases with nothing hidden a seed")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args(arguments)
    first, last = (int(x) for x in options.seeds.split(":"))
    rows = []
    for seed in range(first, last):
        jobs: list[tuple[str | None, int]] = [(law, seed) for law in options.laws or LAWS if law != "nothing"]
        if not options.laws or "nothing" in options.laws:
            jobs += [(None, 1000 * seed + i) for i in range(options.nulls)]
        for law, number in jobs:
            rows.append(case(law, number, options.share))
            print(json.dumps(rows[-1], ensure_ascii=False), file=sys.stderr, flush=True)
    text = table(rows)
    print(text)
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "laws.md").write_text(text, encoding="utf-8")
        (options.out / "laws.json").write_text(json.dumps(rows, indent=1, ensure_ascii=False), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
