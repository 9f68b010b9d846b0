"""Runs and comparisons as MCAP files of JSON messages, for Foxglove and its like, and for `missionsim import`.

Topics: ``/power/<battery>`` (modelled and measured power, residual, watts by term, charge), ``/state`` (all other
columns: speed, scheme, components on), ``/pose`` (foxglove.PoseInFrame) where coordinates are known. Every message
carries ``time_s``; a number is written with all its digits, so that it reads back to the bit. Beside the file lie a
layout for Foxglove and a map for `missionsim import`.
"""

from __future__ import annotations

import heapq
import json
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.exchange.site import flow
from missionsim.files import atomic_write, needed, write_text
from missionsim.glossary import column_of
from missionsim.inputs.power import build_power_model
from missionsim.labels import Labels
from missionsim.logs import read_logs
from missionsim.physics import Array
from missionsim.plan.build import make_plan
from missionsim.runs.drive import assume, drive_blocks

if TYPE_CHECKING:
    from missionsim.engine.outcome import RunResult
    from missionsim.inputs.mission import MissionSpec
    from missionsim.inputs.robot import RobotSpec

Pose = tuple[Array, Array, Array]
"""x and y [m], heading [rad]."""
Rows = tuple[str, Array, Mapping[str, Mapping[str, Any]], Mapping[str, Any], Pose | None]
"""Prefix of the topics, times, values by battery, other columns, pose."""
_STEP_S = 1e-6
"""The end of an interval is written this long before the next begins, so that plots show steps."""
_POWER = {
    "time_s": "Time since the start of the run [s]",
    "model_w": "Modelled power that the battery delivers [W]",
    "measured_w": "Measured power [W]; a slow meter's reading stands in all rows that it was measured over",
    "residual_w": "Measured minus modelled power [W]",
    "charge_wh": "Charge left [Wh]",
    "terms": "Modelled power by component/term [W]",
}
_POSE_SCHEMA = json.loads(Path(__file__).with_name("pose.schema.json").read_text("utf-8"))


def write_run(result: RunResult, mission: MissionSpec, path: str | Path) -> list[Path]:
    """Write a simulated run; each interval with its begin and its end: power is the mean of each. Gives the MCAP file,
    the layout and the map."""
    line = result.timeline
    every = np.arange(len(line))
    index = np.append(np.repeat(every, 2), every[-1:])
    inner = np.stack([np.zeros(len(line)), np.maximum(line.duration_s - _STEP_S, 0.5 * line.duration_s)], axis=1)
    offset = np.append(inner.ravel(), line.duration_s[-1:])
    columns = {name: _flat(value, len(index)) for name, value in line.at(index, offset[:, None]).items()}
    names = [segment.name for segment in result.segments]
    columns["segment"] = [names[i] if i >= 0 else "" for i in line.segment[index].tolist()]
    power = {}
    for battery, terms in result.energies.items():
        watts = {f"{key.component}/{key.name}": (joules / line.duration_s)[index] for key, joules in terms.items()}
        charge = _ends(result.batteries[battery].initial_wh, result.charge_wh[battery])
        power[battery] = {"model_w": result.power_w(battery)[index], "charge_wh": charge, "terms": watts}
    ends = line.at(every, line.duration_s[:, None] * [[0.0, 1.0]])
    speed = np.hypot(ends.get("speed_m_s", 0.0), ends.get("lateral_speed_m_s", 0.0)) * np.ones((len(line), 2))
    pose = _planned_pose(mission, _ends(0.0, np.cumsum(line.duration_s * speed.mean(axis=1))))
    return _write(path, [("", line.start_s[index] + offset, power, columns, pose)], "model_w")


def _ends(first: float, after: Array) -> Array:
    """What holds at the begin and the end of each interval, and once more at the end of all."""
    before = np.concatenate([[first], after[:-1]])
    return np.append(np.stack([before, after], axis=1).ravel(), after[-1:])


def write_comparison(robot: RobotSpec, logs: Sequence[str | Path], path: str | Path) -> list[Path]:
    """Write measured logs beside the model that they drive, row by row; several runs under topics of their own names.
    Gives the MCAP file, the layout and the map."""
    model = build_power_model(robot)
    runs = read_logs(list(logs), robot=robot)

    def rows() -> Iterator[Rows]:
        for run in runs:
            plan = assume(model, run.columns, run.batteries, source=run.source or run.run)
            (driven,) = drive_blocks(plan, [run])
            power: dict[str, dict[str, Any]] = {}
            count = len(run.time_s)
            for battery, model_w in driven.model_w.items():
                measured = driven.measured_w[battery]
                watts = {f"{key.component}/{key.name}": _flat(w, count) for key, w in driven.terms[battery].items()}
                power[battery] = {"model_w": model_w, "measured_w": measured, "residual_w": measured - model_w}
                power[battery]["terms"] = watts
            columns = {name: _flat(value, count) for name, value in run.columns.items() if name != "time_s"}
            pose = None
            if "x_m" in run.columns and "y_m" in run.columns:
                heading = np.asarray(columns.get("heading_rad", np.full(count, math.nan)))
                pose = (np.asarray(columns["x_m"]), np.asarray(columns["y_m"]), heading)
            word = "".join(c if c.isalnum() or c in "_-" else "_" for c in run.run) or "run"
            yield f"/{word}" if len(runs) > 1 else "", run.time_s, power, columns, pose

    return _write(path, rows(), "measured_w")


def _flat(value: Any, count: int) -> Any:
    """A column of `count` numbers or words; what is shorter holds for several."""
    if isinstance(value, Labels):
        codes = np.asarray(value.codes)
        codes = np.repeat(codes.ravel(), count // max(codes.size, 1)) if codes.size != count else codes.ravel()
        return [value.names[code] if code >= 0 else "" for code in codes.tolist()]
    array = np.asarray(value)
    if array.size == count:
        return array.ravel()
    return np.repeat(array.ravel(), count // array.size) if array.size else np.zeros(count)


def _planned_pose(mission: MissionSpec, driven_m: Array) -> Pose | None:
    """Position and heading on the map after so many metres driven; None without coordinates or off the map's edges."""
    environment = mission.environment
    if environment is None or mission.start is None:
        return None
    distances, ends, headings = [0.0], [environment.places[mission.start].position], []
    for leg in make_plan(mission).legs:
        if leg.kind not in ("roll", "slide"):
            continue
        if leg.edge is None:
            return None
        begin, end = (environment.places[name].position for name in leg.edge[:2])
        length = environment.length_m(environment.edges[leg.edge.edge])
        if begin is None or end is None or not length:
            return None
        share = leg.edge.to_m / length
        ends.append((begin[0] + (end[0] - begin[0]) * share, begin[1] + (end[1] - begin[1]) * share))
        headings.append(math.atan2(end[1] - begin[1], end[0] - begin[0]))
        distances.append(distances[-1] + leg.distance_m)
    if not headings or None in ends:
        return None
    along, points = np.array(distances), np.array(ends, float)
    off = driven_m > along[-1] * (1 + 1e-6) + 1e-6  # on the way home after the mission was cut short
    x, y = (np.where(off, math.nan, np.interp(driven_m, along, points[:, axis])) for axis in (0, 1))
    leg_of = np.clip(np.searchsorted(along, driven_m, side="right") - 1, 0, len(headings) - 1)
    return x, y, np.array(headings)[leg_of]


def _write(path: str | Path, runs: Iterable[Rows], power: str) -> list[Path]:
    """The MCAP file, and beside it a layout for Foxglove and a map for ``missionsim import``."""
    mcap = needed("mcap.writer", "writing MCAP", str(path))
    target = Path(path)
    topics: dict[str, dict[str, None]] = {}
    with atomic_write(target) as temporary, open(temporary, "wb") as stream:
        writer = mcap.Writer(stream, compression=mcap.CompressionType.ZSTD)
        writer.start("", "missionsim")
        streams = []
        for topic, schema, messages in (one for rows in runs for one in _messages(*rows)):
            raw = json.dumps(schema, ensure_ascii=False).encode()
            number = writer.register_schema(str(schema["title"]), "jsonschema", raw)
            channel = writer.register_channel(topic, "json", number)
            streams.append(_keyed(channel, messages, topics.setdefault(topic, {})))
        for nanoseconds, number, raw in heapq.merge(*streams, key=itemgetter(0)):  # readers warn where time goes back
            writer.add_message(number, nanoseconds, raw, nanoseconds)
        writer.finish()
    layout, mapping = target.with_suffix(".foxglove.json"), target.with_suffix(".map.yaml")
    write_text(layout, json.dumps(_layout(topics), indent=1) + "\n")
    write_text(mapping, _map(topics, target.stem, power))
    return [target, layout, mapping]


def _keyed(
    channel: int, messages: Iterable[tuple[int, dict[str, Any]]], fields: dict[str, None]
) -> Iterator[tuple[int, int, bytes]]:
    """Time, channel and bytes of each message; its fields are noted."""
    for nanoseconds, message in messages:
        fields |= dict.fromkeys(message)
        yield nanoseconds, channel, json.dumps(message, ensure_ascii=False, allow_nan=False).encode()


def _messages(
    prefix: str, time: Array, power: Mapping[str, Mapping[str, Any]], columns: Mapping[str, Any], pose: Pose | None
) -> Iterator[tuple[str, dict[str, Any], Iterator[tuple[int, dict[str, Any]]]]]:
    """Topic, JSON schema and messages (nanoseconds, data)."""
    stamps = np.maximum(np.rint(time * 1e9), 0).astype(np.int64).tolist()
    seconds = time.tolist()
    properties: dict[str, Any]
    for battery, values in power.items():
        properties = {key: {"type": "number", "description": _POWER[key]} for key in ("time_s", *values)}
        terms = values.get("terms", {})
        if terms:
            inner = {name: {"type": "number"} for name in terms}
            properties["terms"] = {"type": "object", "description": _POWER["terms"], "properties": inner}
        schema = {"title": f"missionsim.power.{battery}", "type": "object", "properties": properties}
        yield f"{prefix}/power/{battery}", schema, _rows(stamps, {"time_s": seconds, **values})
    properties = {"time_s": {"type": "number", "description": _POWER["time_s"]}}
    properties |= {k: {"type": "number" if isinstance(v, np.ndarray) else "string"} for k, v in columns.items()}
    schema = {"title": "missionsim.state", "type": "object", "properties": properties}
    yield f"{prefix}/state", schema, _rows(stamps, {"time_s": seconds, **columns})
    if pose is not None:
        yield f"{prefix}/pose", _POSE_SCHEMA, _poses(stamps, seconds, pose)


def _rows(stamps: Sequence[int], values: Mapping[str, Any]) -> Iterator[tuple[int, dict[str, Any]]]:
    """One message a row; numbers that are not finite are left out, since JSON has none."""
    plain = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}
    terms = {name: np.asarray(value).tolist() for name, value in plain.pop("terms", {}).items()}
    for row, stamp in enumerate(stamps):
        message = {name: value[row] for name, value in plain.items() if _known(value[row])}
        if terms:
            message["terms"] = {name: value[row] for name, value in terms.items() if _known(value[row])}
        yield stamp, message


def _known(value: Any) -> bool:
    return not isinstance(value, float) or math.isfinite(value)


def _poses(stamps: Sequence[int], seconds: Sequence[float], pose: Pose) -> Iterator[tuple[int, dict[str, Any]]]:
    for stamp, time, x, y, heading in zip(stamps, seconds, *(part.tolist() for part in pose), strict=True):
        if not (math.isfinite(x) and math.isfinite(y)):
            continue
        half = heading / 2 if math.isfinite(heading) else 0.0
        turn = {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)}
        data = {"position": {"x": x, "y": y, "z": 0.0}, "orientation": turn}
        when = {"sec": stamp // 10**9, "nsec": stamp % 10**9}
        yield stamp, {"timestamp": when, "frame_id": "map", "time_s": time, "pose": data}


def _layout(topics: Mapping[str, Collection[str]]) -> dict[str, Any]:
    """A Foxglove layout: power of each battery, charge, and the pose in 3D where there is one."""
    panels: dict[str, Any] = {}
    for topic, fields in topics.items():
        if "/power/" in topic:
            shown = [key for key in ("measured_w", "model_w", "residual_w") if key in fields]
            panels[f"Plot!{len(panels)}"] = _plot(f"{topic} [W]", [f"{topic}.{key}" for key in shown])
            if "charge_wh" in fields:
                panels[f"Plot!{len(panels)}"] = _plot(f"{topic}: charge [Wh]", [f"{topic}.charge_wh"])
        elif topic.endswith("/state") and "speed_m_s" in fields:
            panels[f"Plot!{len(panels)}"] = _plot("speed [m/s]", [f"{topic}.speed_m_s"])
        elif topic.endswith("/pose"):
            panels[f"3D!{len(panels)}"] = {"topics": {topic: {"visible": True}}, "followTf": "map"}
    names = list(panels)
    tree: Any = names[-1] if names else ""
    for number, name in enumerate(reversed(names[:-1]), 1):
        tree = {"direction": "column", "first": name, "second": tree, "splitPercentage": 100 / (number + 1)}
    usual = {"globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}}
    return {"configById": panels, **usual, "layout": tree}


def _plot(title: str, paths: Sequence[str]) -> dict[str, Any]:
    drawn = [{"value": path, "enabled": True, "timestampMethod": "receiveTime"} for path in paths]
    return {"title": title, "paths": drawn, "showLegend": True, "xAxisVal": "timestamp"}


def _map(topics: Mapping[str, Collection[str]], name: str, power: str) -> str:
    """A map with which the first run's topics become a log again."""
    first = next((topic.rpartition("/power/")[0] for topic in topics if "/power/" in topic), "")
    signals, columns = {}, {}
    for topic, fields in topics.items():
        if topic.startswith(f"{first}/power/"):
            battery = topic.rpartition("/")[2]
            logged = topics.get(f"{first}/state", ())
            if any(name in logged for name in (f"power_{battery}_w", f"voltage_{battery}_v", f"energy_{battery}_wh")):
                continue
            signals[f"p_{battery}"] = f"{topic}.{power}"
            columns[f"power_{battery}_w"] = f"p_{battery}"
        elif topic == f"{first}/state":
            signals["t"] = f"{topic}.time_s"
            for field in fields:
                taken = field in columns or field == "time_s" or field.startswith("on_time_")
                if not taken and column_of(field) is not None:
                    signals[f"s_{field}"] = f"{topic}.{field}"
                    columns[field] = f"s_{field}"
    lines = [f"# for missionsim import {name}.mcap", "kind: map", f"name: {flow(name)}", "signals:"]
    lines += [f"  {alias}: {flow(field)}" for alias, field in signals.items()]
    lines += ["timeline: t", "columns:", "  time_s: t", *(f"  {column}: {alias}" for column, alias in columns.items())]
    return "\n".join(lines) + "\n"
