"""Where fitted numbers come from: short hashes of the logs, kept in the robot file and recognised again."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Sequence
from typing import Any

MOST_HASHES = 40
LENGTH = 8
CALIBRATION = "calibration"
"""Key of a robot file's ``sources`` that says to which logs its parameters were fitted."""


def log_hash(log: Any) -> str:
    """SHA-256 of a log's file, or of its power where it was made in memory; 64 hexadecimal digits."""
    if log.sha256:
        return str(log.sha256)
    digest = hashlib.sha256()
    for battery in sorted(log.power_w):
        digest.update(log.power_w[battery].tobytes())
    return digest.hexdigest()


def data_tag(logs: Sequence[Any]) -> str:
    """The first digits of the hashes of the logs, one a run; beyond `MOST_HASHES` runs one for all."""
    hashes = sorted(log_hash(log) for log in logs)
    if len(hashes) > MOST_HASHES:
        return hashlib.sha256("".join(hashes).encode()).hexdigest()[:LENGTH]
    return " ".join(digest[:LENGTH] for digest in hashes)


def fitted_to(source: str, logs: Iterable[Any]) -> bool:
    """Whether a parameter's source says that it was fitted to one of these very logs.

    Such a number is no knowledge beside the logs: as a prior it would count the same data twice.
    """
    match = re.search(r"\bdata ((?:[0-9a-f]{8}\s?)+)", source)
    if not match:
        return False
    known = set(match.group(1).split())
    tables = list(logs)
    return any(log_hash(log)[:LENGTH] in known for log in tables) or (
        len(tables) > MOST_HASHES and data_tag(tables) in known
    )
