"""`LogTable`, the former name of `missionsim.runs.run.Run`."""

from missionsim.runs.run import Run as LogTable
from missionsim.runs.run import row_durations

__all__ = ["LogTable", "row_durations"]
