"""MCAP files of JSON messages, as `missionsim run --mcap` and Foxglove's tools write them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from missionsim.errors import InputError
from missionsim.logs.formats.jsonlines import column, flat
from missionsim.logs.readers import Options, Recording, Topic


def read_json_mcap(path: Path, options: Options) -> Recording | None:
    """Fields of JSON messages as ``/topic.key.inner[0]``, at the times of the log; None where messages are no JSON.

    Raises
    ------
    missionsim.errors.InputError
        A damaged file.
    """
    try:
        from mcap.reader import make_reader
    except ImportError:
        return None
    wanted = None if options.fields is None else {field.strip().partition(".")[0] for field in options.fields}
    held: dict[str, tuple[str, list[int], list[dict[str, Any]]]] = {}
    counts: dict[str, int] = {}
    try:
        with open(path, "rb") as stream:
            for schema, channel, message in make_reader(stream).iter_messages(log_time_order=False):
                if channel.message_encoding != "json":
                    return None
                topic = channel.topic
                counts[topic] = counts.get(topic, 0) + 1
                if wanted is not None and topic not in wanted:
                    continue
                if options.most is not None and counts[topic] > options.most:
                    continue
                _, times, messages = held.setdefault(topic, (schema.name if schema else "", [], []))
                messages.append(dict(flat(json.loads(message.data), "")))
                times.append(message.log_time)
    except Exception as error:  # a damaged file raises whatever its parser meets
        if not counts:
            return None
        reason = (str(error) or type(error).__name__).splitlines()[0][:200]
        told = "the MCAP file cannot be read"
        raise InputError.single(told, file=str(path), got=reason, allowed="a whole file") from None
    if not counts:
        return None
    topics = []
    for topic, (title, times, messages) in held.items():
        names = dict.fromkeys(name for message in messages for name in message)
        chosen = [name for name in names if options.fields is None or f"{topic}.{name}" in options.fields]
        columns = {name: column([message.get(name) for message in messages]) for name in chosen}
        topics.append(Topic(topic, np.asarray(times, dtype=np.int64) / 1e9, columns, title, counts[topic]))
    return Recording(topics)
