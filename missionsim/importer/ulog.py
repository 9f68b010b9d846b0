"""PX4 ULog through pyulog: any field of any topic."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from missionsim.errors import Fault, InputError
from missionsim.importer.sources import Field, missing_field
from missionsim.importer.timeline import Signal, merge_signals
from missionsim.inputs.log_map import MapSpec
from missionsim.logs.raw import RawTable
from missionsim.logs.remarks import Remark

_FIELD = re.compile(r"(?P<topic>[A-Za-z0-9_]+)(?:\[(?P<instance>\d+)\])?\.(?P<field>[A-Za-z0-9_.\[\]]+)\Z")


def _open(path: Path, topics: list[str] | None) -> Any:
    file = str(path)
    try:
        from pyulog import ULog
    except ImportError:
        raise InputError.single(
            "reading ULog needs the package pyulog", file=file, allowed="pip install 'missionsim[logs]'"
        ) from None
    try:
        return ULog(file, topics)
    except Exception as error:  # pyulog lets struct, index and type errors of a broken file through
        reason = (str(error) or type(error).__name__).splitlines()[0][:200]
        raise InputError.single("the ULog cannot be read", file=file, got=reason, allowed="a whole PX4 ULog") from None


def read_ulog(path: Path, spec: MapSpec) -> RawTable:
    """Signals of a map from a ULog, on the times of its timeline (each topic's ``timestamp``, microseconds).

    Raises
    ------
    missionsim.errors.InputError
        pyulog is not installed, an unreadable file, a field that is not there.
    """
    file = str(path)
    if not spec.signals:
        raise InputError.single(
            "a map for a ULog needs signals", file=str(spec.path), allowed="signals: {volts: battery_status.voltage_v}"
        )
    parsed = {alias: _FIELD.match(signal.field.strip()) for alias, signal in spec.signals.items()}
    log = _open(path, sorted({match["topic"] for match in parsed.values() if match}))
    faults: list[Fault] = []
    signals: dict[str, Signal] = {}
    for alias, match in parsed.items():
        data = _dataset(log, match) if match else None
        if match is None or data is None or match["field"] not in data:
            known = [field.name for field in ulog_fields(path)]
            faults.append(missing_field(spec, alias, spec.signals[alias].field, known, file))
            continue
        time = np.asarray(data["timestamp"], dtype=np.float64) * 1e-6
        signals[alias] = Signal(
            time, np.asarray(data[match["field"]], dtype=np.float64), spec.signals[alias].fill, match["topic"]
        )
    if not faults and spec.timeline is not None and spec.timeline not in signals:
        faults.append(
            Fault(
                str(spec.path),
                0,
                0,
                f"timeline '{spec.timeline}' is not a signal",
                "timeline",
                spec.timeline,
                ", ".join(spec.signals),
            )
        )
    if faults:
        raise InputError(faults)
    raw = merge_signals(signals, spec.timeline, file)
    if log.dropouts:
        lost = sum(dropout.duration for dropout in log.dropouts) * 1e-3
        raw.remarks.append(
            Remark(
                "gap",
                "",
                f"the logger dropped out {len(log.dropouts)} times, {lost:.3g} s together",
                "the values before were held",
                "warning",
                0,
                len(log.dropouts),
            )
        )
    if log.file_corruption:
        raw.remarks.append(Remark("format", "", "part of the ULog is corrupt", "what could be read was read"))
    return raw


def _dataset(log: Any, match: re.Match[str]) -> dict[str, Any] | None:
    instance = int(match["instance"] or 0)
    for data in log.data_list:
        if data.name == match["topic"] and data.multi_id == instance and len(data.data.get("timestamp", ())):
            found: dict[str, Any] = data.data
            return found
    return None


def ulog_fields(path: Path) -> list[Field]:
    """Every field of the topics of a ULog."""
    fields = []
    for data in sorted(_open(path, None).data_list, key=lambda item: (item.name, item.multi_id)):
        topic = data.name if data.multi_id == 0 else f"{data.name}[{data.multi_id}]"
        fields += [
            Field(f"{topic}.{name}", "number", len(values)) for name, values in data.data.items() if name != "timestamp"
        ]
    return fields
