"""ROS 1, ROS 2 and MCAP bags through rosbags: any numeric or text field of any topic."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.importer.sources import Field, missing_field
from missionsim.importer.timeline import Signal, merge_signals
from missionsim.inputs.log_map import MapSpec
from missionsim.labels import Labels
from missionsim.logs.raw import RawTable
from missionsim.logs.remarks import Remark

_STEP = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)((?:\[\d+\])*)\Z")
_MOST_ELEMENTS = 16
"""Elements of an array that a listing shows."""
_CLOCKS_APART_S = 5.0
"""Header and bag differ by transport and buffering, tenths of a second; beyond this they are different clocks."""


def _need_rosbags(file: str) -> None:
    try:
        import rosbags.highlevel  # noqa: F401
    except ImportError:
        raise InputError.single(
            "reading bags needs the package rosbags", file=file, allowed="pip install 'missionsim[logs]'"
        ) from None


@contextlib.contextmanager
def open_bag(path: Path) -> Iterator[Any]:
    """A rosbags reader of a ROS 1 bag, a ROS 2 bag (its folder, or a file in it), or a lone MCAP file.

    Raises
    ------
    missionsim.errors.InputError
        rosbags is not installed, or it cannot read the bag.
    """
    file = str(path)
    _need_rosbags(file)
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    if path.is_file() and path.suffix in (".db3", ".mcap") and (path.parent / "metadata.yaml").exists():
        path = path.parent
    try:
        # bags of older ROS 2 carry no message definitions; the common types have not changed since
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except InputError:
        raise
    except Exception as error:  # a broken bag raises whatever its parsers and databases meet
        reason = (str(error) or type(error).__name__).splitlines()[0][:200]
        raise InputError.single(
            "the bag cannot be read", file=file, got=reason, allowed="a whole ROS 1, ROS 2 or MCAP bag"
        ) from None


@dataclass(frozen=True)
class _Path:
    """A parsed ``/topic.field.sub[0]``."""

    topic: str
    get: Callable[[Any], Any]


def _parse(field: str) -> _Path | None:
    topic, _, rest = field.strip().partition(".")
    if not rest:
        return None
    steps: list[Callable[[Any], Any]] = []
    for part in rest.split("."):
        match = _STEP.match(part)
        if match is None or part.startswith("__"):
            return None
        steps.append(attrgetter(match.group(1)))
        for index in re.findall(r"\[(\d+)\]", match.group(2)):
            steps.append(itemgetter(int(index)))

    def get(message: Any) -> Any:
        for step in steps:
            message = step(message)
        return message

    return _Path(topic if topic.startswith("/") else f"/{topic}", get)


def read_bag(path: Path, spec: MapSpec) -> RawTable:
    """Signals of a map from a bag, on the times of its timeline.

    Parameters
    ----------
    path : Path
    spec : MapSpec
        Its `signals` name the fields.

    Raises
    ------
    missionsim.errors.InputError
        An unreadable bag, a topic or field that is not there, a field that is neither number nor text.
    """
    file = str(path)
    if not spec.signals:
        raise InputError.single(
            "a map for a bag needs signals", file=str(spec.path), allowed="signals: {volts: /battery_state.voltage}"
        )
    faults: list[Fault] = []
    with open_bag(path) as reader:
        wanted = _wanted(reader, spec, file, faults)
        if faults:
            raise InputError(faults)
        stamps: dict[str, list[tuple[int, int]]] = {topic: [] for topic in wanted}
        values: dict[str, list[Any]] = {alias: [] for paths in wanted.values() for alias in paths}
        connections = [c for c in reader.connections if c.topic in wanted]
        for connection, received, data in reader.messages(connections=connections):
            message = reader.deserialize(data, connection.msgtype)
            try:
                got = [(alias, at.get(message)) for alias, at in wanted[connection.topic].items()]
            except (AttributeError, IndexError, TypeError):
                faults += _field_faults(message, wanted[connection.topic], spec, file)
                break
            stamps[connection.topic].append((_header_ns(message, received), received))
            for alias, value in got:
                values[alias].append(value)
    if faults:
        raise InputError(faults)
    signals: dict[str, Signal] = {}
    remarks: list[Remark] = []
    times = _times(stamps, spec.stamp, remarks)
    for topic, paths in wanted.items():
        for alias in paths:
            if not values[alias]:
                faults.append(Fault(file, 0, 0, f"topic {topic} has no message", f"signals.{alias}"))
                continue
            column = _as_column(values[alias])
            if column is None:
                faults.append(
                    Fault(
                        file,
                        0,
                        0,
                        "this field is neither a number nor text",
                        f"signals.{alias}",
                        spec.signals[alias].field,
                        "a field further in, such as .x or [0]",
                    )
                )
                continue
            signals[alias] = Signal(times[topic], column, spec.signals[alias].fill, topic)
    if spec.timeline is not None and spec.timeline not in spec.signals:
        faults.append(
            Fault(
                str(spec.path),
                0,
                0,
                f"timeline '{spec.timeline}' is not a signal",
                "timeline",
                spec.timeline,
                ", ".join(spec.signals),
                did_you_mean(spec.timeline, spec.signals),
            )
        )
    if faults:
        raise InputError(faults)
    raw = merge_signals(signals, spec.timeline, file)
    raw.remarks[:0] = remarks
    return raw


def _wanted(reader: Any, spec: MapSpec, file: str, faults: list[Fault]) -> dict[str, dict[str, _Path]]:
    topics = list(reader.topics)
    wanted: dict[str, dict[str, _Path]] = {}
    for alias, signal in spec.signals.items():
        at = _parse(signal.field)
        if at is None or at.topic not in topics:
            known = topics if at is not None else ["/topic.field.sub[0]"]
            faults.append(missing_field(spec, alias, at.topic if at is not None else signal.field, known, file))
        else:
            wanted.setdefault(at.topic, {})[alias] = at
    return wanted


def _field_faults(message: Any, paths: dict[str, _Path], spec: MapSpec, file: str) -> list[Fault]:
    known = [name for name, _ in _leaves(message)]
    faults = []
    for alias, at in paths.items():
        try:
            at.get(message)
        except (AttributeError, IndexError, TypeError):
            faults.append(
                missing_field(spec, alias, spec.signals[alias].field, [f"{at.topic}.{name}" for name in known], file)
            )
    return faults


def _header_ns(message: Any, received_ns: int) -> int:
    """Time of a message's header [ns]; when the bag received it, where it has none or none was set."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None or not (stamp.sec or stamp.nanosec):
        return received_ns
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _times(
    stamps: dict[str, list[tuple[int, int]]], clock: str, remarks: list[Remark]
) -> dict[str, NDArray[np.float64]]:
    """Times of each topic's messages from the start of the bag [s], all by the same clock.

    Messages without a header have the bag's time only. Where the headers' clock is another one (simulated time, a
    robot whose clock is off), both cannot be mixed, and the bag's is taken for all.
    """
    filled = {topic: pairs for topic, pairs in stamps.items() if pairs}
    which = 0 if clock == "header" else 1
    bare = [topic for topic, pairs in filled.items() if all(header == received for header, received in pairs)]
    apart = [
        abs(float(np.median([h - r for h, r in pairs]))) * 1e-9 for topic, pairs in filled.items() if topic not in bare
    ]
    if which == 0 and bare and apart and max(apart) > _CLOCKS_APART_S:
        which = 1
        remarks.append(
            Remark(
                "clock",
                "",
                f"the headers' clock is {max(apart):.4g} s off the bag's, and {', '.join(bare)} has no header",
                "the times at which the bag received the messages were taken",
            )
        )
    start = min((pair[which] for pairs in filled.values() for pair in pairs), default=0)
    return {
        topic: np.array([pair[which] - start for pair in pairs], dtype=np.float64) * 1e-9
        for topic, pairs in filled.items()
    }


def _as_column(values: list[Any]) -> Any:
    first = values[0]
    if isinstance(first, str):
        return Labels.of(values)
    if isinstance(first, (bool, int, float, np.number, np.bool_)):
        return np.array(values, dtype=np.float64)
    return None


def _leaves(message: Any, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Paths of the numeric and text fields inside a message, with their kind."""
    for name in getattr(message, "__dataclass_fields__", ()):
        if name.startswith("__"):
            continue
        value = getattr(message, name)
        yield from _leaf(value, f"{prefix}{name}")


def _leaf(value: Any, path: str) -> Iterator[tuple[str, str]]:
    if isinstance(value, str):
        yield path, "text"
    elif isinstance(value, (bool, int, float, np.number, np.bool_)):
        yield path, "number"
    elif isinstance(value, (list, np.ndarray)):
        for index, item in enumerate(value[:_MOST_ELEMENTS]):
            yield from _leaf(item, f"{path}[{index}]")
    elif hasattr(value, "__dataclass_fields__"):
        yield from _leaves(value, f"{path}.")


def bag_fields(path: Path) -> list[Field]:
    """Every numeric and text field of the topics of a bag, seen in the first message of each."""
    fields = []
    with open_bag(path) as reader:
        for topic, info in sorted(reader.topics.items()):
            for connection, _, data in reader.messages(connections=info.connections):
                message = reader.deserialize(data, connection.msgtype)
                fields += [Field(f"{topic}.{name}", kind, info.msgcount) for name, kind in _leaves(message)]
                break
    return fields
