"""The interactive page of a plan: map, legs, charge over time, what else there was, or why there is none."""

from __future__ import annotations

import itertools

from missionsim.numerals import in_wh
from missionsim.planner.answer import Answer
from missionsim.report.page import COLOURS, Block, Bullets, Chart, Section, Table, Tiles, Trace, Verdict, axis, page
from missionsim.report.site_map import map_of_plan, site_chart


def plan_page(answer: Answer, *, footer: str = "") -> str:
    """The page as HTML, which opens from disk. `answer`: with ``why`` in `extra` where it is not feasible; `footer`:
    how it was made."""
    task = answer.site.task
    title = f"{task.name} with {task.robot.name}"
    if not answer.feasible:
        first, *rest = answer.extra["why"]["text"]
        blocks: list[Block] = [Verdict(f"No plan: {first}", "bad"), Bullets(rest), site_chart(map_of_plan(answer))]
        return page(title, [Section("Why there is no plan", blocks)], footer=footer)
    names = list(answer.energy_wh)
    tiles = [("Duration", f"{answer.duration_s / 60.0:.1f} min", "")]
    tiles += [
        (f"Battery {name}", f"{in_wh(answer.energy_wh[name])} Wh", f"{in_wh(answer.charge_left_wh[name])} Wh left")
        for name in names
    ]
    if sure := answer.extra.get("probability"):
        interval = f"{100 * sure['low']:.2f} to {100 * sure['high']:.2f} %"
        tiles.append(("Holds", f"{100 * sure['value']:.2f} %", f"of {sure['runs']} fresh draws ({interval})"))
    rows = []
    for leg in answer.legs:
        piece = leg.piece
        way = ("", "", None) if piece is None else (piece.name, piece.legs[0].settings.scheme, piece.limit_m_s)
        wh = [in_wh(part[name]) for part in (leg.energy_wh, leg.charge_wh) for name in names]
        rows.append([leg.kind, leg.place, *way, leg.duration_s, *wh])
    columns = ["leg", "to", "along", "scheme", "m/s", "s", *(f"{name}, Wh" for name in names)]
    legs = Table([*columns, *(f"{name} left, Wh" for name in names)], rows)
    physics = answer.site.physics
    times = [0.0, *itertools.accumulate(leg.duration_s / 60.0 for leg in answer.legs)]
    traces: list[Trace] = []
    for b, name in enumerate(names):
        values = [float(physics.initial_wh[b]), *(leg.charge_wh[name] for leg in answer.legs)]
        share = [100.0 * value / float(physics.capacity_wh[b]) for value in values]
        colour = COLOURS[b % len(COLOURS)]
        curve = {"type": "scatter", "mode": "lines"}
        traces.append({**curve, "x": times, "y": share, "name": name, "line": {"color": colour}})
        reserve = {"y": [100.0 * float(physics.reserve_wh[b] / physics.capacity_wh[b])] * 2, "x": [0.0, times[-1]]}
        thin = {"color": colour, "dash": "dot", "width": 1}
        traces.append({**curve, **reserve, "name": f"reserve of {name}", "line": thin})
    layout = {"xaxis": axis("time, min"), "yaxis": axis("charge, %", rangemode="tozero")}
    sections = [
        Section("Plan", [Verdict(f"{answer.course()}: {answer.claim}.", "good"), Tiles(tiles)]),
        Section("Map", [site_chart(map_of_plan(answer))]),
        Section("Charge", [Chart(traces, layout, "Charge of each battery at the ends of the legs.", 300)]),
        Section("Legs", [legs]),
    ]
    if others := answer.extra.get("alternatives"):
        rows = [
            [item["kind"], 100 * item["worse"] if item.get("worse") is not None else None, item.get("duration_s")]
            for item in others
        ]
        sections.append(Section("What else there was", [Table(["plan", "worse, %", "s"], rows)]))
    if front := answer.extra.get("pareto"):
        rows = [[point["duration_s"], *(in_wh(wh) for wh in point["energy_wh"].values())] for point in front]
        sections.append(Section("Energy against time", [Table(["s", *(f"{name}, Wh" for name in names)], rows)]))
    return page(title, sections, footer=footer)
