"""`missionsim add-effect`: fit an effect and write the robot file that has it."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from missionsim.cli.options import TERMINAL, Output, RobotFile, Search
from missionsim.report.terminal import console

if TYPE_CHECKING:
    from missionsim.diagnose.split import Split
    from missionsim.identify.settings import Settings
    from missionsim.inputs.robot import RobotSpec
    from missionsim.logs import LogTable


def add_effect(
    *logs: Path,
    search: Search,
    out: RobotFile,
    effect: str | None = None,
    formula: str | None = None,
    force: bool = False,
    keep_base: bool = False,
    to: Output = TERMINAL,
) -> int:
    """Fit an effect to logs and write the robot file that has it, with its uncertainty and where it comes from.

    Refuses with exit code 1 what the logs do not support; exit code 1 too where the file predicts the held-out runs
    worse.

    Parameters
    ----------
    logs
        Log files or folders of them.
    out
        Robot file to write.
    effect
        Id in the library (missionsim effects), or the name of one of the robot file's candidates.
    formula
        In place of --effect, a law of your own over columns of the log, such as "k * abs(yaw_rate_rad_s) * payload_kg",
        or the number of a form that diagnose proposes (1 is the first). Its k is fitted; the unit of k follows.
    force
        Write it even if the logs do not support it.
    keep_base
        Leave the base parameters as they are instead of writing the values that were fitted with the effect.
    """
    from missionsim.diagnose.adopt import NotSignificant, adopt
    from missionsim.diagnose.words import heldout_line
    from missionsim.errors import InputError
    from missionsim.files import write_text
    from missionsim.inputs.edit import for_folder, robot_text
    from missionsim.inputs.loading import robot_from_text

    search.check(logs)
    if (effect is None) == (formula is None):
        raise InputError.single(
            "add-effect needs either --effect or --formula",
            got="both" if effect else "neither",
            allowed='--effect turning_scrub, or --formula 1, or --formula "k * abs(yaw_rate_rad_s) * payload_kg"',
        )
    spec, split, tables, left_out = search.read(logs, to)
    chosen = search.battery or motors_battery(spec, tables)
    text = robot_text(search.robot)
    if formula is not None:
        text, effect = _candidate(text, spec, split, chosen, formula, search.settings)
        spec = robot_from_text(text)
    assert effect is not None
    told = {"schema": "missionsim.add_effect/1", "effect": effect, "battery": chosen}
    try:
        made = adopt(text, spec, split, effect, chosen, search.settings, force=force, recalibrate=not keep_base)
    except NotSignificant as error:
        to.emit(told | {"added": False, "reason": str(error)})
        print(f"{error}\n    nothing was written; --force writes it all the same", file=sys.stderr)
        return 1
    write_text(out, for_folder(made.text, out.parent))
    parameters = {name: estimate.to_json() for name, estimate in made.effect.parameters.items()}
    to.emit(
        told
        | {
            "added": True,
            "significant": made.significant,
            "reason": made.reason,
            "parameters": parameters,
            "energy_share": made.effect.energy_share,
            "p_value": made.effect.p_value,
            "indistinguishable_from": list(made.rivals),
            "heldout": made.heldout and made.heldout.to_json(),
            "worse": made.worse or None,
            "left_out": left_out,
            "robot_file": str(out),
            "base": {name: {"value": value, "sd": sd} for name, (value, sd) in made.base.items()},
        }
    )
    if made.worse:
        print(made.worse, file=sys.stderr)
    if made.rivals:
        print(
            f"warning: these logs cannot tell {effect} from {', '.join(made.rivals)}; missionsim diagnose says "
            "what to drive to find out",
            file=sys.stderr,
        )
    if to.text:
        terminal = console()
        found = ", ".join(
            f"{name} = {p.value:.4g}{'' if p.unit in ('', '1') else ' ' + p.unit} (95 % {p.low:.4g} to {p.high:.4g})"
            for name, p in made.effect.parameters.items()
        )
        terminal.print(
            f"{effect} on battery {chosen}: {100 * made.effect.energy_share:.1f} % of the energy; {found}; "
            f"p = {made.effect.p_value:.1g}"
        )
        if not made.significant:
            terminal.print(f"forced: {made.reason}")
        if made.base:
            terminal.print("base: " + ", ".join(f"{n} = {v:.4g}" for n, (v, _) in made.base.items()))
        if made.heldout is not None:
            terminal.print("held out: " + heldout_line(made.heldout))
        terminal.print(f"written: {out}")
    return 1 if made.worse or left_out else 0


def _candidate(
    text: str, spec: RobotSpec, split: Split, battery: str, formula: str, settings: Settings
) -> tuple[str, str]:
    """The text of the robot with the formula as a candidate, and its name; a number means one of the forms proposed."""
    from missionsim.diagnose.diagnosis import examine
    from missionsim.diagnose.proposed import formula_of, proposed_laws, with_candidate
    from missionsim.diagnose.split import Split
    from missionsim.diagnose.subject import Subject

    if formula.strip().isdigit():
        seen = examine(Subject.of(spec), Split(split.train, (), split.how), battery, settings)
        formula = formula_of(proposed_laws(seen.found, seen.features.covariates), formula)
    return with_candidate(text, battery, formula)


def motors_battery(spec: RobotSpec, tables: Sequence[LogTable]) -> str:
    """The battery of the motors if it was measured, else the first that was."""
    measured = list(dict.fromkeys(name for log in tables for name in log.power_w))
    motion = spec.motion
    if motion is not None and motion.battery in measured:
        return motion.battery
    return measured[0]
