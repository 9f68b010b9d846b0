"""Model against measurements: replay of logs, statistics, where the model fails, and behaviour against the plan."""

from missionsim import command_package
from missionsim.compare.comparison import BatteryComparison, Comparison, RunComparison
from missionsim.compare.core import compare, compare_files
from missionsim.compare.where import Dependence, Where

__all__ = ["BatteryComparison", "Comparison", "Dependence", "RunComparison", "Where", "compare", "compare_files"]

command_package(__name__)
