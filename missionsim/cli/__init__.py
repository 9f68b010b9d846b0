"""The command line. `main` is what the `missionsim` script calls."""

from __future__ import annotations


def main() -> None:
    """Run the command line and leave with its exit code."""
    import sys

    from missionsim.cli.app import run_command

    sys.exit(run_command(sys.argv[1:]))
