"""Results of a run as tidy tables, JSON and files, and alternatives side by side."""

from missionsim.results.write import Table, tables, write_results

__all__ = ["Table", "tables", "write_results"]
