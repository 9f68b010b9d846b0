"""The command line. `main` is what the `missionsim` script calls."""

from __future__ import annotations


def main() -> None:
    """Run the command line and leave with its exit code."""
    import gc
    import sys

    # what start-up makes lives until the end: looking through it for garbage again and again costs a tenth of it
    gc.set_threshold(50_000, 20, 20)
    from missionsim.cli.app import run_command

    sys.exit(run_command(sys.argv[1:]))
