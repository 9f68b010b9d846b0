"""`missionsim effects`: the library of effects, as a list or one in full."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cyclopts import App

from missionsim.cli.options import TERMINAL, Output
from missionsim.report.terminal import console, simple_table, titled

app = App(name="effects", help="The library of effects: equation, parameters, units, source.", help_format="plaintext")


def log_columns(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """What a log must have for covariates of an effect, and which of them follow from that (clocks, acceleration)."""
    columns: list[str] = []
    derived: list[str] = []
    for name in names:
        if name.startswith("on_time_"):
            source = f"on_{name.removeprefix('on_time_').removesuffix('_s')}"
        else:
            source = "speed_m_s" if name in ("moving_time_s", "starts", "starts_per_s", "accel_m_s2") else name
        columns.append(source)
        if source != name:
            derived.append(name)
    return list(dict.fromkeys(columns)), derived


def _describe(id: str) -> dict[str, Any]:
    from missionsim.effects.library import get_effect

    family, _, name = id.partition(":")
    effect = get_effect(f"{family}:{name.strip('<>')}" if name else id, surfaces=("<surface>",))
    needs, derived = log_columns(effect.needs)
    if name.startswith("<"):
        needs, derived = ([text.replace(name.strip("<>"), name) for text in texts] for texts in (needs, derived))
    return {
        "id": id,
        "equation": effect.equation,
        "meaning": effect.meaning,
        "parameters": [
            {"name": p.name, "unit": p.unit, "low": p.low, "high": p.high, "default": p.default, "meaning": p.meaning}
            for p in effect.parameters
        ],
        "needs": needs,
        "derived": derived,
        "kind": "execution" if effect.execution else "power",
        "source": effect.source,
    }


def _needed(described: dict[str, Any]) -> str:
    return ", ".join([*(["a mission"] if described["kind"] == "execution" else []), *described["needs"]])


@app.default
def list_effects(*, to: Output = TERMINAL) -> int:
    """List every effect of the library.

    Parameters
    ----------
    """
    from missionsim.effects.library import effect_ids

    described = [_describe(id) for id in effect_ids()]
    to.emit({"schema": "missionsim.effects/1", "effects": described})
    if to.text:
        rows = [(d["id"], d["equation"], _needed(d) or "–") for d in described]
        console().print(simple_table("Library of effects", ["effect", "power it adds", "needs in the log"], rows))
        console().print(
            "Acceleration, starts and clocks (moving time, time switched on) follow from those columns.\n"
            "missionsim effects show ID tells parameters, units and source of one."
        )
    return 0


@app.command
def show(id: str, *, to: Output = TERMINAL) -> int:
    """Show one effect in full.

    Parameters
    ----------
    id
        Name of the effect, such as grade or component_power:kinect.
    """
    described = _describe(id)
    to.emit({"schema": "missionsim.effect/1", **described})
    if to.text:
        terminal = console()
        terminal.print(titled(id, f"  {described['meaning']}"))
        terminal.print(f"power   {described['equation']}")
        from_them = f"; derived from them: {', '.join(described['derived'])}" if described["derived"] else ""
        terminal.print(f"needs   {_needed(described) or 'nothing beside the power'}{from_them}")
        terminal.print(f"source  {described['source']}")
        rows = [(p["name"], p["unit"], f"{p['low']:g} … {p['high']:g}", p["meaning"]) for p in described["parameters"]]
        terminal.print(simple_table("parameters", ["name", "unit", "range", "meaning"], rows))
    return 0
