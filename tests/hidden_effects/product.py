"""The product under test, called as a user calls it: files in, the contract's JSON out."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from .peers import Outcome

NAME = "missionsim"
ROBOT_FILES = Path(__file__).parent / "robots"


def robot_argument(robot: str) -> str:
    """Shipped robots by name, the world's own by path."""
    path = ROBOT_FILES / f"{robot}.yaml"
    return str(path) if path.exists() else robot


def diagnose(train: Path, heldout: Path, robot: str, mission: Path | None = None) -> tuple[Outcome, dict[str, Any]]:
    """Diagnose a folder of runs; the held-out errors come from the folder of held-out runs."""
    from missionsim.diagnose import diagnose_files

    start = time.perf_counter()
    diagnosis = diagnose_files(robot_argument(robot), [train], holdout=[heldout], mission=mission)
    report = json.loads(json.dumps(diagnosis.to_json()))
    return outcome(report, time.perf_counter() - start), report


def improved(train: Path, heldout: Path, robot: str) -> tuple[float, float]:
    """Mean energy error of the held-out runs [%] and their power error [W] after everything that `improve` adds."""
    from missionsim.diagnose.improve import improve
    from missionsim.diagnose.split import choose_split
    from missionsim.identify.settings import Settings
    from missionsim.inputs.edit import robot_text
    from missionsim.logs import read_logs

    split = choose_split(read_logs([train]), [heldout])
    done = improve(robot_text(robot_argument(robot)), split, "robot", Settings(), lambda finding, diagnosis: True)
    last = done.steps[-2]
    return last.energy_error_pct, last.power_rmse_w


def outcome(report: dict[str, Any], seconds: float) -> Outcome:
    """The contract's diagnosis JSON as an outcome (battery ``robot``)."""
    battery = report["batteries"]["robot"]
    names, sets, shares = [], {}, {}
    for found in battery["effects"]:
        name = found["effect"]
        if name in names:  # one effect may stand once per surface
            continue
        names.append(name)
        sets[name] = (*found["indistinguishable_from"], *found["other_forms"])
        shares[name] = (found["energy_share"], *found["energy_share_interval"])
    held = battery.get("heldout") or {}
    energy = (held.get("energy_error_pct") or {}).get("with_effects", float("nan"))
    rmse = (held.get("power_rmse_w") or {}).get("with_effects", float("nan"))
    law = (battery["proposed_laws"] or [{}])[0]
    return Outcome(
        NAME,
        tuple(names),
        sets=sets,
        verdict=battery["verdict"],
        energy_error_pct=energy,
        rmse_w=rmse,
        seconds=seconds,
        shares=shares,
        law=law["forms"][0]["formula"] if law else "",
        limits={
            c["effect"]: c["smallest_detectable_share"]
            for c in battery["candidates"]
            if c["smallest_detectable_share"] is not None
        },
        experiments=len(battery.get("next_experiment", [])),
    )
