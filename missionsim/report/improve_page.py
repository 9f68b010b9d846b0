"""The interactive page of an improvement: the waterfall of the error, and the diagnosis before and after."""

from __future__ import annotations

from collections.abc import Sequence

from missionsim.diagnose.improve import Improved
from missionsim.diagnose.waterfall import energy_note, measured_note
from missionsim.identify.findings import Diagnosis
from missionsim.report.diagnosis_page import diagnosis_sections
from missionsim.report.page import COLOURS, Block, Chart, Section, Table, Tiles, Tone, Verdict, format_cell, label, page
from missionsim.report.traces import RESIDUAL, Trace, axis, line


def improve_page(robot: str, done: Sequence[Improved], *, footer: str = "") -> str:
    """The page as HTML.

    `done`: one a battery; `footer`: how it was made.
    """
    sections: list[Section] = []
    for one in done:
        prefix = f"Battery {one.battery}: " if len(done) > 1 else ""
        sections.append(Section(f"{prefix}Result", _result(one)))
        for title, diagnosis in (("Before", one.first), ("After", one.last)):
            inner = diagnosis_sections(Diagnosis(robot, {one.battery: diagnosis}))
            sections += [Section(f"{prefix}{title}: {part.title}", part.blocks) for part in inner]
    return page(f"{robot}: model improved", sections, subtitle="compare, diagnose, add, compare again", footer=footer)


def _result(one: Improved) -> list[Block]:
    which = "held-out runs" if one.heldout else "the fitted runs; none were held out"
    first, last = one.steps[0], one.steps[-2]
    text = f"{one.worse} " if one.worse else ""
    text += (
        f"Battery {one.battery}: {', '.join(one.added) or 'nothing'} added; the power error on {which} went from "
        f"{first.power_rmse_w:.3g} to {last.power_rmse_w:.3g} W, the energy error from "
        f"{first.energy_error_pct:.2f} to {last.energy_error_pct:.2f} %. "
        f"{one.stopped[:1].upper()}{one.stopped[1:]}"
    )
    if note := energy_note(one):
        text += f" {note}"
    names = [label(step.name) for step in one.steps]
    floor = one.steps[-1]
    charts: list[Block] = []
    for title, values, level in (
        ("power error (RMS), W", [s.power_rmse_w for s in one.steps], floor.power_rmse_w),
        ("energy error, mean over runs, %", [s.energy_error_pct for s in one.steps], floor.energy_error_pct),
    ):
        colours = [COLOURS[1], *([COLOURS[4]] * (len(values) > 2)), *([COLOURS[2]] * (len(values) - 3)), "#aab2bd"]
        steps: Trace = {"type": "bar", "x": names, "y": values, "marker": {"color": colours}, "showlegend": False}
        steps |= {"text": [format_cell(v, 3) for v in values], "textposition": "outside"}
        steps["hovertemplate"] = "%{x}: %{y:.3g}<extra></extra>"
        noise = line(names, [level] * len(names), "noise floor", hoverinfo="skip")
        noise["line"] = {"color": RESIDUAL, "dash": "dot"}
        layout = {"yaxis": axis(title, rangemode="tozero"), "hovermode": "closest"}
        floors = "the noise floor is what a true model would still show"
        caption = f"The {title.split(',')[0]} on {which}, step by step; {floors}."
        charts.append(Chart([steps, noise], layout, caption, 360))
    tone: Tone = "bad" if one.worse else "good" if one.added and last.power_rmse_w < first.power_rmse_w else "neutral"
    table = Table(
        ["model", "energy error, %", "power error (RMS), W"],
        [[s.name, f"{s.energy_error_pct:.2f}", f"{s.power_rmse_w:.3g}"] for s in one.steps],
        measured_note(one),
        3,
    )
    tiles = Tiles(
        [
            ("Added", str(len(one.added)), ", ".join(one.added)),
            ("Power error", f"{first.power_rmse_w:.3g} → {last.power_rmse_w:.3g} W", which),
            ("Noise floor", f"{floor.power_rmse_w:.3g} W", "noise, and runs whose meters and drives differ"),
        ]
    )
    return [Verdict(text, tone), tiles, *charts, table]
