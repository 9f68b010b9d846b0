"""Measured logs: read, checked, told what is wrong with them, frozen as `LogTable` (a `missionsim.runs.run.Run`)."""

from missionsim.logs.blocks import iter_blocks
from missionsim.logs.raw import Remark
from missionsim.logs.read import check_log, describe, find_logs, read_log, read_logs
from missionsim.runs.run import Run as LogTable
from missionsim.runs.run import row_durations

__all__ = [
    "LogTable", "Remark", "check_log", "describe", "find_logs", "iter_blocks", "read_log", "read_logs", "row_durations",
]  # fmt: skip
