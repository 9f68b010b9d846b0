"""The map of a site: places, docks, edges by surface and slope; a route by energy per metre, the charge at places."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.engine.outcome import RunResult
from missionsim.inputs.environment import EnvironmentSpec
from missionsim.physics import Array
from missionsim.planner.answer import Answer
from missionsim.planner.reach import Reached
from missionsim.report.map_text import Paper
from missionsim.report.page import Chart, new_figure, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Points = Array
SURFACES = ("#7a8793", "#c9a66b", "#8fb58a", "#b59ac9", "#d9928f", "#88b5d0")
DOCK, SURE, ONLY, OUT, VISIT = "#0072b2", "#009e73", "#e69f00", "#c0392b", "#cc3377"
SCALE = "viridis"


@dataclass(frozen=True)
class SiteMap:
    """What a map shows."""

    environment: EnvironmentSpec
    title: str
    driven: Sequence[tuple[int, str, float]] = ()
    """Edges in the order in which they were driven; `begin` tells the direction. Sequence of (edge, begin, Wh/m)."""
    charges: Mapping[str, str] = field(default_factory=dict)
    """Charge when the robot last left or passed a place, as text."""
    colours: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """Of places. Mapping of str to (colour, word)."""
    turns: Sequence[tuple[int, str, float, str]] = ()
    """Points on edges. Sequence of (edge, begin, share, text)."""
    order: Mapping[str, str] = field(default_factory=dict)
    """Which visit is made at a place, counted in their order, with a ``+`` where there are more."""


def map_of_run(result: RunResult, environment: EnvironmentSpec) -> SiteMap:
    """The map of a run."""
    edges = result.edges_driven()
    driven = [(e.edge, e.begin, sum(e.energy_wh.values()) / max(e.length_m, 1e-9)) for e in edges]
    verdict = "feasible" if result.feasible else f"not feasible: {result.reason}"
    ends = {edge.segment: edge for edge in edges}
    place, steps = edges[0].begin if edges else "", []
    for i, segment in enumerate(result.segments):
        last = int(np.searchsorted(result.timeline.segment, i, side="right")) - 1
        if last < 0 or result.timeline.segment[last] != i:
            continue
        place = ends[i].end if i in ends else place
        visited = segment.kind == "inspect" or (segment.kind == "wait" and segment.label != "wait")
        steps.append(
            (
                "visit" if visited else segment.kind,
                place,
                {name: float(charge[last]) for name, charge in result.charge_wh.items()},
            )
        )
    capacity = {name: battery.capacity_wh for name, battery in result.batteries.items()}
    order, charges = _stops(steps, capacity)
    title = f"{result.mission}, {result.robot}: {verdict}; charge of {' / '.join(capacity)}"
    visits = dict.fromkeys(order, (VISIT, "visit, in this order"))
    return SiteMap(environment, title, driven, charges, visits, order=order)


def map_of_plan(answer: Answer) -> SiteMap:
    """The map of a plan."""
    task = answer.site.task
    capacity = answer.site.physics.by_name(answer.site.physics.capacity_wh)
    driven = [
        (leg.piece.way.edge, leg.piece.way.begin, sum(leg.energy_wh.values()) / max(leg.piece.way.length_m, 1e-9))
        for leg in answer.legs
        if leg.piece is not None
    ]
    each = len(answer.order()) // answer.extra.get("rounds", 1)
    order, charges = _stops([(leg.kind, leg.place, leg.charge_wh) for leg in answer.legs], capacity, each)
    environment = task.environment
    shut = {name for name, choice in task.edges.items() if choice.closed}
    if shut:
        edges = tuple(
            edge.model_copy(update={"closed": edge.closed or edge.name in shut}) for edge in environment.edges
        )
        environment = environment.model_copy(update={"edges": edges})
    title = f"{task.name}, {task.robot.name}; charge of {' / '.join(capacity)}"
    visits = {visit.place: (VISIT, "visit, in this order") for visit in task.visits}
    return SiteMap(environment, title, driven, charges, visits, order=order)


def _stops(
    steps: Sequence[tuple[str, str, Mapping[str, float]]], capacity_wh: Mapping[str, float], each: int | None = None
) -> tuple[dict[str, str], dict[str, str]]:
    """Of each place the number of its first visit, and the charge left there, or from and to which it was charged.

    `steps`: kind, place at its end, and charge by battery of each leg; `each`: visits of a round, counted in each anew.
    """
    made: dict[str, set[int]] = {}
    left: dict[str, str] = {}
    charged: dict[str, list[str]] = {}
    count = 0
    before: Mapping[str, float] | None = None
    for kind, place, charge in steps:
        left[place] = _percent(charge, capacity_wh)
        if kind == "visit":
            made.setdefault(place, set()).add((count % each if each else count) + 1)
            count += 1
        elif kind in ("charge", "dock", "recharge") and before is not None:
            text = f"charges {_percent(before, capacity_wh)} → {left[place]}"
            charged.setdefault(place, []).append(text)
        before = charge
    order = {place: f"{min(numbers)}{'+' * (len(numbers) > 1)}" for place, numbers in made.items()}
    texts = {
        place: "\n".join([*charged.get(place, [])[:2], *["…"] * (len(charged.get(place, ())) > 2)] or [text])
        for place, text in left.items()
    }
    return order, texts


def map_of_reach(environment: EnvironmentSpec, start: str, found: Sequence[Reached], probability: float) -> SiteMap:
    """The map of what can be reached."""
    percent = f"{100 * probability:g} %"
    words = {
        (True, True): (SURE, f"there and back, {percent} of draws"),
        (True, False): (ONLY, f"there and back, in fewer than {percent}"),
        (False, False): (OUT, "out of reach"),
    }
    colours = {item.place: words[item.reachable, item.sure] for item in found}
    colours |= {name: (OUT, "out of reach") for name in environment.places if name not in colours and name != start}
    charges, turns = {}, []
    for item in found:
        assert item.plan is not None
        physics = item.plan.site.physics
        left = {name: wh - item.plan.energy_wh[name] for name, wh in physics.by_name(physics.initial_wh).items()}
        if item.reachable:
            charges[item.place] = "home with " + _percent(left, physics.by_name(physics.capacity_wh))
        if item.turn is not None:
            length = environment.length_m(environment.edges[item.turn["edge_index"]]) or 1.0
            share = item.turn["metres"] / length
            text = f"before '{item.turn['edge']}'" if item.turn["one_way"] else f"after {item.turn['metres']:.0f} m"
            turns.append((item.turn["edge_index"], item.turn["from"], share, f"turn back {text}"))
    return SiteMap(environment, f"reach from {start}", (), charges, colours, sorted(set(turns)))


def write_map(site: SiteMap, path: Path) -> Path:
    """Draw a map into a PNG or SVG file, by its suffix."""
    return save_figure(site_figure(site), path)


def site_figure(site: SiteMap) -> Figure:
    """The map as a Matplotlib figure."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    where, curves = layout(site.environment)
    span = np.maximum(np.ptp(np.array(list(where.values())), axis=0), 1e-9)
    figure_width, height = 11.0, float(np.clip(9.0 * span[1] / max(span[0], 1e-9), 4.0, 9.5)) + 1.4
    figure = new_figure(figure_width, height)
    axes = figure.subplots()
    axes.set_aspect("equal")
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlabel("x [m] (wider edge: steeper; slope in the direction of its arrow)")
    axes.set_ylabel("y [m]")
    axes.margins(0.12)
    axes.set_title(site.title, fontsize=10, loc="left")
    size = float(max(span))
    surfaces = _surfaces(site.environment)
    shut = _shut(site.environment)
    for index, edge in enumerate(site.environment.edges):
        line, surface = curves[index], _surface(site.environment, edge)
        if index in shut:
            axes.plot(*line.T, color="#b0b0b0", linestyle=":", linewidth=1.6, label="closed", zorder=1)
            axes.plot(*line[len(line) // 2], marker="x", color="#555555", markersize=8, zorder=2)
            continue
        width = 1.4 + 40.0 * min(abs(math.tan(edge.slope.value)), 0.15)
        axes.plot(*line.T, color=surfaces[surface], linewidth=width, alpha=0.75, zorder=1, label=surface or "edge")
    lines: list[Points] = []
    if site.driven:
        values = np.array([wh for *_, wh in site.driven])
        low, high = float(values.min()), float(values.max())
        norm = Normalize(low, high if high > low else low + 1e-9)
        for number, begin, wh in site.driven:
            line = shifted(curves[number], begin == site.environment.edges[number].from_, 0.009 * size)
            colour = colormaps[SCALE](norm(wh))
            axes.plot(*line.T, color=colour, linewidth=3.2, solid_capstyle="butt", zorder=3)
            middle, ahead = line[int(0.62 * len(line)) - 1], line[int(0.62 * len(line))]
            axes.annotate("", ahead, middle, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2}, zorder=4)
            lines.append(line)
        bar = figure.colorbar(ScalarMappable(norm, SCALE), ax=axes, shrink=0.7, pad=0.01)
        bar.set_label("energy of all batteries on the edge [Wh/m]", fontsize=8)
    marks = []
    for number, begin, share, text in site.turns:
        line = curves[number] if begin == site.environment.edges[number].from_ else curves[number][::-1]
        at = line[min(int(share * (len(line) - 1) + 0.5), len(line) - 1)]
        axes.plot(*at, marker="X", color=OUT, markersize=8, zorder=6, linestyle="none", label="turn back")
        marks.append((at, text))
    _draw_places(axes, site, where)
    handles, labels = axes.get_legend_handles_labels()
    known = dict(zip(labels, handles, strict=True))
    figure.legend(known.values(), known.keys(), fontsize=7.5, loc="outside lower center", ncols=7, frameon=False)
    figure.draw_without_rendering()  # so that it is known where on the paper everything lies
    paper = Paper(axes, [*lines, *curves.values()], list(where.values()))
    for name, at in where.items():
        paper.write(np.array(at), name + (f"\n{site.charges[name]}" if name in site.charges else ""), 7.5, "black")
    for at, text in marks:
        paper.write(at, text, 7.0, OUT)
    for index, edge in enumerate(site.environment.edges):
        line, slope, text = curves[index], math.tan(edge.slope.value), edge.name or ""
        if abs(slope) > 5e-4:
            text += f" {100 * slope:+.1f} %".replace("-", "−") + (" →" if line[-1][0] >= line[0][0] else " ←")
        paper.along(line, text + " one way" * (not edge.both_ways) + " closed" * (index in shut))
    return figure


def _draw_places(axes: Axes, site: SiteMap, where: Mapping[str, tuple[float, float]]) -> None:
    for name, at in where.items():
        spec = site.environment.places[name]
        colour, word = site.colours.get(name, ("#444444", "place"))
        number = site.order.get(name, "")
        axes.plot(*at, marker="o", markersize=10 if number else 7, color=colour, label=word, zorder=5, linestyle="none")
        if number:
            axes.annotate(number, at, fontsize=7 if len(number) < 2 else 6, color="white", weight="bold", ha="center",
                          va="center_baseline", zorder=8, in_layout=False)  # fmt: skip
        if spec.charger is not None:
            axes.plot(*at, marker="s", markersize=15, markerfacecolor="none", markeredgecolor=DOCK, label="dock",
                      markeredgewidth=1.8, zorder=5, linestyle="none")  # fmt: skip
        if spec.closed:
            axes.plot(*at, marker="x", markersize=13, color="#222222", zorder=6, linestyle="none")


def site_chart(site: SiteMap) -> Chart:
    """The map as an interactive chart."""
    where, curves = layout(site.environment)
    size = float(np.ptp(np.array(list(where.values())), axis=0).max())
    surfaces, shut = _surfaces(site.environment), _shut(site.environment)
    traces: list[dict[str, Any]] = []
    for index, edge in enumerate(site.environment.edges):
        line, surface = curves[index], _surface(site.environment, edge)
        style = {"color": "#b0b0b0", "dash": "dot"} if index in shut else {"color": surfaces[surface], "width": 2}
        name = "closed" if index in shut else surface or "edge"
        text = f"{edge.name or ''} {edge.from_}–{edge.to}, {site.environment.length_m(edge) or 0:.4g} m, {surface}, "
        text += f"slope {100 * math.tan(edge.slope.value):.3g} %"
        traces.append(_line(line, style, name, text, any(t["name"] == name for t in traces)))
    if site.driven:
        from matplotlib import colormaps
        from matplotlib.colors import to_hex

        values = np.array([wh for *_, wh in site.driven])
        low, high = float(values.min()), float(values.max())
        shades = colormaps["viridis"]((values - low) / max(high - low, 1e-12))
        for (number, begin, wh), shade in zip(site.driven, shades, strict=True):
            spec = site.environment.edges[number]
            line = shifted(curves[number], begin == spec.from_, 0.009 * size)
            end = spec.to if begin == spec.from_ else spec.from_
            style = {"color": to_hex(shade), "width": 5}
            traces.append(_line(line, style, "route", f"{begin} → {end}: {wh:.4g} Wh/m", True))
        marker = {"color": [low, high], "colorscale": "Viridis", "showscale": True, "opacity": 0,
                  "colorbar": {"title": {"text": "Wh/m"}, "len": 0.7}}  # fmt: skip
        traces.append({"type": "scatter", "mode": "markers", "x": [None, None], "y": [None, None], "marker": marker,
                       "showlegend": False, "name": "scale"})  # fmt: skip
    names = list(where)
    colours = [site.colours.get(name, ("#444444", ""))[0] for name in names]
    docks = [site.environment.places[name].charger is not None for name in names]
    traces.append({
        "type": "scatter", "mode": "markers+text", "name": "places (square: dock)", "cliponaxis": False,
        "text": [f"{site.order[n]} {n}" if n in site.order else n for n in names],
        "textposition": "top right", "x": [where[n][0] for n in names], "y": [where[n][1] for n in names],
        "marker": {"size": [13 if dock else 9 for dock in docks], "color": colours,
                   "symbol": ["square" if dock else "circle" for dock in docks]},
        "customdata": [site.charges.get(name, "").replace("\n", "<br>") for name in names],
        "hovertemplate": "%{text} %{customdata}<extra></extra>",
    })  # fmt: skip
    layout_ = {
        "hovermode": "closest",
        "xaxis": {"title": {"text": "x, m"}, "showgrid": False},
        "yaxis": {"title": {"text": "y, m"}, "scaleanchor": "x", "showgrid": False},
    }
    caption = (
        "The site: edges by surface, the route by energy per metre, visits in their order; the charge stands at each "
        "place under the pointer."
    )
    return Chart(traces, layout_, caption, 560)


def _line(line: Points, style: Mapping[str, Any], name: str, text: str, known: bool) -> dict[str, Any]:
    return {
        "type": "scatter", "mode": "lines", "x": line[:, 0], "y": line[:, 1], "line": dict(style), "name": name,
        "showlegend": not known, "legendgroup": name, "hovertemplate": f"{text}<extra></extra>",
    }  # fmt: skip


def layout(environment: EnvironmentSpec) -> tuple[dict[str, tuple[float, float]], dict[int, Points]]:
    """Where places are drawn [m], and the line of each edge from its begin, shape (points, 2). Places without
    coordinates are laid out by the lengths of their edges (Kamada and Kawai 1989); parallel edges bow."""
    where = {name: spec.position for name, spec in environment.places.items()}
    if any(at is None for at in where.values()):
        import networkx

        graph = networkx.Graph()
        graph.add_nodes_from(where)
        for edge in environment.edges:
            graph.add_edge(edge.from_, edge.to, weight=environment.length_m(edge) or 1.0)
        scale = sum(environment.length_m(edge) or 1.0 for edge in environment.edges) / max(len(environment.edges), 1)
        spread = networkx.kamada_kawai_layout(graph, scale=scale * math.sqrt(max(len(where), 1)))
        where = {name: (float(x), float(y)) for name, (x, y) in spread.items()}
    places = {name: at for name, at in where.items() if at is not None}
    seen: dict[tuple[str, ...], int] = {}
    curves = {}
    for index, edge in enumerate(environment.edges):
        pair = tuple(sorted((edge.from_, edge.to)))
        number = seen[pair] = seen.get(pair, -1) + 1
        begin, end = np.array(places[edge.from_]), np.array(places[edge.to])
        along = np.linspace(0.0, 1.0, 41)[:, None]
        line = begin + along * (end - begin)
        if number:
            aside = np.array([-(end - begin)[1], (end - begin)[0]]) * (1.0 if edge.from_ == pair[0] else -1.0)
            line = line + 0.14 * ((number + 1) // 2) * (1 if number % 2 else -1) * 4 * along * (1 - along) * aside
        curves[index] = line
    return places, curves


def shifted(line: Points, forward: bool, by: float) -> Points:
    """A line in the direction of travel, to the right of where it lies."""
    made = line if forward else line[::-1]
    ahead = made[-1] - made[0]
    length = float(np.hypot(*ahead))
    return made + by * np.array([ahead[1], -ahead[0]]) / length if length else made


def _surface(environment: EnvironmentSpec, edge: Any) -> str:
    return str(edge.surface or environment.ambient.surface or "")


def _surfaces(environment: EnvironmentSpec) -> dict[str, str]:
    names = dict.fromkeys(_surface(environment, edge) for edge in environment.edges)
    return {name: SURFACES[i % len(SURFACES)] for i, name in enumerate(names)}


def _shut(environment: EnvironmentSpec) -> set[int]:
    return set(range(len(environment.edges))) - {index for index, *_ in environment.open_ways()}


def _percent(charge_wh: Mapping[str, float], capacity_wh: Mapping[str, float]) -> str:
    parts: Iterable[str] = (f"{100 * charge / capacity_wh[name]:.0f} %" for name, charge in charge_wh.items())
    return " / ".join(parts)
