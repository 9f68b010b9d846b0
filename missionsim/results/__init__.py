"""Results of a run as tidy tables, JSON and files, and alternatives side by side."""

from missionsim.results.tables import Table, tables
from missionsim.results.write import write_results

__all__ = ["Table", "tables", "write_results"]
