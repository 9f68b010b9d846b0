"""`missionsim effects`: the library of effects, as a list or one in full."""

from __future__ import annotations

from cyclopts import App

from missionsim.cli.common import console, emit_json, shows_text, simple_table
from missionsim.cli.options import JsonOption, QuietOption

app = App(name="effects", help="The library of effects: equation, parameters, units, source.", help_format="plaintext")


def _describe(id: str) -> dict[str, object]:
    from missionsim.effects.library import get_effect

    family, _, name = id.partition(":")
    effect = get_effect(f"{family}:{name.strip('<>')}" if name else id, surfaces=("<surface>",))
    return {
        "id": id,
        "equation": effect.equation,
        "meaning": effect.meaning,
        "parameters": [
            {"name": p.name, "unit": p.unit, "low": p.low, "high": p.high, "default": p.default, "meaning": p.meaning}
            for p in effect.parameters
        ],
        "needs": list(effect.needs),
        "kind": "execution" if effect.execution else "power",
        "source": effect.source,
    }


@app.default
def list_effects(*, json: JsonOption = None, quiet: QuietOption = False) -> int:
    """List every effect of the library.

    Parameters
    ----------
    json
        Write the list as JSON to this file, or - for standard output.
    quiet
        Print no table.
    """
    from missionsim.effects.library import effect_ids

    described = [_describe(id) for id in effect_ids()]
    emit_json({"schema": "missionsim.effects/1", "effects": described}, json)
    if shows_text(json, quiet):
        rows = [(d["id"], d["equation"], ", ".join(d["needs"]) or "–") for d in described]  # type: ignore[arg-type]
        console().print(simple_table("Library of effects", ["effect", "power it adds", "needs"], rows))
        console().print("missionsim effects show ID tells parameters, units and source of one.")
    return 0


@app.command
def show(id: str, *, json: JsonOption = None, quiet: QuietOption = False) -> int:
    """Show one effect in full.

    Parameters
    ----------
    id
        Name of the effect, such as grade or component_power:kinect.
    json
        Write it as JSON to this file, or - for standard output.
    quiet
        Print no table.
    """
    described = _describe(id)
    emit_json({"schema": "missionsim.effect/1", **described}, json)
    if shows_text(json, quiet):
        terminal = console()
        terminal.print(f"[bold]{id}[/bold]  {described['meaning']}")
        terminal.print(f"power   {described['equation']}", markup=False)
        terminal.print(f"needs   {', '.join(described['needs']) or 'nothing beside the power'}")  # type: ignore[arg-type]
        terminal.print(f"source  {described['source']}", markup=False)
        rows = [(p["name"], p["unit"], f"{p['low']:g} … {p['high']:g}", p["meaning"]) for p in described["parameters"]]  # type: ignore[attr-defined]
        terminal.print(simple_table("parameters", ["name", "unit", "range", "meaning"], rows))
    return 0
