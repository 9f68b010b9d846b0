"""The map of a site: places, docks, edges by surface and slope; a route by energy per metre, the charge at places; and
the interactive page of a plan: map, legs, charge over time, what else there was, or why there is none."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from missionsim.engine.outcome import RunResult
from missionsim.inputs.environment import EdgeSpec, EnvironmentSpec
from missionsim.numerals import in_wh
from missionsim.physics import Array
from missionsim.planner.answer import Answer
from missionsim.planner.reach import Reached
from missionsim.report.page import (
    COLOURS,
    Block,
    Bullets,
    Chart,
    Section,
    Table,
    Tiles,
    Trace,
    Verdict,
    axis,
    line,
    page,
)

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
        kind = "visit" if visited else segment.kind
        steps.append((kind, place, {name: float(charge[last]) for name, charge in result.charge_wh.items()}))
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
        edges = tuple(one.model_copy(update={"closed": one.closed or one.name in shut}) for one in environment.edges)
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
        if item.reachable:
            charges[item.place] = "home with " + _percent(item.left_wh, physics.by_name(physics.capacity_wh))
        if item.turn is not None:
            length = environment.length_m(environment.edges[item.turn["edge_index"]]) or 1.0
            share = item.turn["metres"] / length
            text = f"before '{item.turn['edge']}'" if item.turn["one_way"] else f"after {item.turn['metres']:.0f} m"
            turns.append((item.turn["edge_index"], item.turn["from"], share, f"turn back {text}"))
    return SiteMap(environment, f"reach from {start}", (), charges, colours, sorted(set(turns)))


def site_chart(site: SiteMap) -> Chart:
    """The map as an interactive chart."""
    where, curves = layout(site.environment)
    size = float(np.ptp(np.array(list(where.values())), axis=0).max())
    surfaces, shut = surfaces_of(site.environment), shut_ways(site.environment)
    traces: list[dict[str, Any]] = []
    for index, edge in enumerate(site.environment.edges):
        surface = surface_of(site.environment, edge)
        style = {"color": "#b0b0b0", "dash": "dot"} if index in shut else {"color": surfaces[surface], "width": 2}
        name = "closed" if index in shut else surface or "edge"
        text = f"{edge.name or ''} {edge.from_}–{edge.to}, {site.environment.length_m(edge) or 0:.4g} m, {surface}, "
        text += f"slope {100 * math.tan(edge.slope.value):.3g} %"
        traces.append(_edge(curves[index], style, name, text, any(t["name"] == name for t in traces)))
    if site.driven:
        from matplotlib import colormaps
        from matplotlib.colors import to_hex

        values = np.array([wh for *_, wh in site.driven])
        low, high = float(values.min()), float(values.max())
        shades = colormaps["viridis"]((values - low) / max(high - low, 1e-12))
        for (number, begin, wh), shade in zip(site.driven, shades, strict=True):
            spec = site.environment.edges[number]
            way = shifted(curves[number], begin == spec.from_, 0.009 * size)
            end = spec.to if begin == spec.from_ else spec.from_
            style = {"color": to_hex(shade), "width": 5}
            traces.append(_edge(way, style, "route", f"{begin} → {end}: {wh:.4g} Wh/m", True))
        marker = {"color": [low, high], "colorscale": "Viridis", "showscale": True, "opacity": 0}
        marker["colorbar"] = axis("Wh/m", len=0.7)
        traces.append(line([None, None], [None, None], "scale", mode="markers", marker=marker, showlegend=False))
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
    axes = {"xaxis": axis("x, m", showgrid=False), "yaxis": axis("y, m", scaleanchor="x", showgrid=False)}
    caption = (
        "The site: edges by surface, the route by energy per metre, visits in their order; the charge stands at each "
        "place under the pointer."
    )
    return Chart(traces, axes, caption, 560)


def _edge(way: Points, style: Mapping[str, Any], name: str, text: str, known: bool) -> dict[str, Any]:
    tip = f"{text}<extra></extra>"
    return line(way[:, 0], way[:, 1], name, line=dict(style), showlegend=not known, legendgroup=name, hovertemplate=tip)


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
        way = begin + along * (end - begin)
        if number:
            aside = np.array([-(end - begin)[1], (end - begin)[0]]) * (1.0 if edge.from_ == pair[0] else -1.0)
            way = way + 0.14 * ((number + 1) // 2) * (1 if number % 2 else -1) * 4 * along * (1 - along) * aside
        curves[index] = way
    return places, curves


def shifted(way: Points, forward: bool, by: float) -> Points:
    """A line in the direction of travel, to the right of where it lies."""
    made = way if forward else way[::-1]
    ahead = made[-1] - made[0]
    length = float(np.hypot(*ahead))
    return made + by * np.array([ahead[1], -ahead[0]]) / length if length else made


def surface_of(environment: EnvironmentSpec, edge: EdgeSpec) -> str:
    """Surface of an edge, empty where none is named."""
    return str(edge.surface or environment.ambient.surface or "")


def surfaces_of(environment: EnvironmentSpec) -> dict[str, str]:
    """Surfaces of a site with a colour each."""
    names = dict.fromkeys(surface_of(environment, edge) for edge in environment.edges)
    return {name: SURFACES[i % len(SURFACES)] for i, name in enumerate(names)}


def shut_ways(environment: EnvironmentSpec) -> set[int]:
    """Edges that are closed."""
    return set(range(len(environment.edges))) - {index for index, *_ in environment.open_ways()}


def _percent(charge_wh: Mapping[str, float], capacity_wh: Mapping[str, float]) -> str:
    parts: Iterable[str] = (f"{100 * charge / capacity_wh[name]:.0f} %" for name, charge in charge_wh.items())
    return " / ".join(parts)


def legs_table(answer: Answer) -> tuple[list[str], list[list[str]]]:
    """Headings and rows of the legs of a plan."""
    names, rows = list(answer.energy_wh), []
    for leg in answer.legs:
        piece = leg.piece
        chosen = None if leg.visit is None else leg.scheme or answer.site.task.visits[leg.visit]
        scheme = piece.legs[0].settings.scheme if piece is not None else (chosen and chosen.scheme) or ""
        way = ("", scheme, "") if piece is None else (piece.name, scheme, f"{piece.limit_m_s:.2f}")
        wh = [in_wh(part[name]) for part in (leg.energy_wh, leg.charge_wh) for name in names]
        rows.append([leg.kind, leg.place, *way, f"{leg.duration_s:.1f}", *wh])
    columns = ["leg", "to", "along", "scheme", "m/s", "s", *(f"{name} Wh" for name in names)]
    return [*columns, *(f"{name} left" for name in names)], rows


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
    physics = answer.site.physics
    times = [0.0, *itertools.accumulate(leg.duration_s / 60.0 for leg in answer.legs)]
    traces: list[Trace] = []
    for b, name in enumerate(names):
        values = [float(physics.initial_wh[b]), *(leg.charge_wh[name] for leg in answer.legs)]
        share = [100.0 * value / float(physics.capacity_wh[b]) for value in values]
        colour, reserve = COLOURS[b % len(COLOURS)], 100.0 * float(physics.reserve_wh[b] / physics.capacity_wh[b])
        thin = {"color": colour, "dash": "dot", "width": 1}
        traces.append(line(times, share, name, line={"color": colour}))
        traces.append(line([0.0, times[-1]], [reserve] * 2, f"reserve of {name}", line=thin))
    over_time = {"xaxis": axis("time, min"), "yaxis": axis("charge, %", rangemode="tozero"), "hovermode": "x unified"}
    sections = [
        Section("Plan", [Verdict(f"{answer.course()}: {answer.claim}.", "good"), Tiles(tiles)]),
        Section("Map", [site_chart(map_of_plan(answer))]),
        Section("Charge", [Chart(traces, over_time, "Charge of each battery at the ends of the legs.", 300)]),
        Section("Legs", [Table(*legs_table(answer))]),
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
