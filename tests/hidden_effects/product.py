"""The product under test, called through its public commands only (the names of the contract)."""

from __future__ import annotations

import contextlib
import io
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .peers import Outcome

NAME = "missionsim"
ROBOT_FILES = Path(__file__).parent / "robots"


def robot_argument(robot: str) -> str:
    """Shipped robots by name, the world's own by path."""
    path = ROBOT_FILES / f"{robot}.yaml"
    return str(path) if path.exists() else robot


def command(arguments: Sequence[str]) -> int:
    """Run one missionsim command in this process, silently; returns its exit code."""
    from missionsim.cli import main

    noise = io.StringIO()
    with contextlib.redirect_stdout(noise), contextlib.redirect_stderr(noise):
        try:
            code = main(list(arguments))
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
    if code not in (0, 1):
        raise RuntimeError(f"missionsim {' '.join(arguments)} ended with {code}:\n{noise.getvalue()[-2000:]}")
    return int(code or 0)


def diagnose(train: Path, heldout: Path, robot: str, mission: Path | None = None) -> tuple[Outcome, dict[str, Any]]:
    """Diagnose a folder of runs; held-out errors come from the folder of held-out runs."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "diagnosis.json"
        arguments = [
            "diagnose",
            "--robot",
            robot_argument(robot),
            "--holdout",
            str(heldout),
            "--json",
            str(out),
            "--quiet",
        ]
        if mission is not None:
            arguments += ["--mission", str(mission)]
        start = time.perf_counter()
        command([*arguments, str(train)])
        seconds = time.perf_counter() - start
        report = json.loads(out.read_text(encoding="utf-8"))
    return outcome(report, seconds), report


def outcome(report: dict[str, Any], seconds: float) -> Outcome:
    """The contract's diagnosis JSON as an outcome (battery ``robot``)."""
    battery = report["batteries"]["robot"]
    names, sets, shares = [], {}, {}
    for found in battery["effects"]:
        name = found["effect"]
        if name in names:  # one effect may stand once per surface
            continue
        names.append(name)
        sets[name] = tuple(found["indistinguishable_from"])
        main = next(iter(found["parameters"].values()))
        value, share = main["value"], found["energy_share"]
        if value:
            ends = sorted((share * main["low"] / value, share * main["high"] / value))
            shares[name] = (share, ends[0], ends[1])
    held = battery.get("heldout") or {}
    energy = (held.get("energy_error_pct") or {}).get("with_effects", float("nan"))
    rmse = (held.get("power_rmse_w") or {}).get("with_effects", float("nan"))
    return Outcome(
        NAME,
        tuple(names),
        sets=sets,
        verdict=battery["verdict"],
        energy_error_pct=energy,
        rmse_w=rmse,
        seconds=seconds,
        shares=shares,
        experiments=len(battery.get("next_experiment", [])),
    )
