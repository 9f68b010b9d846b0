"""`missionsim validate`: check YAML files and logs, all faults at once."""

from __future__ import annotations

from pathlib import Path

from missionsim.cli.options import JsonOption, QuietOption
from missionsim.cli.validate_files import validate_files


def validate(*files: Path, json: JsonOption = None, quiet: QuietOption = False) -> int:
    """Check robots, environments, missions, studies, maps and logs; print all faults of all files at once.

    Parameters
    ----------
    files
        YAML files, logs (.csv, .parquet), or folders that hold them.
    json
        Write the faults as JSON to this file, or - for standard output.
    quiet
        Print nothing where everything is right.

    Returns
    -------
    int
        0 when there are no errors (warnings are allowed), 2 otherwise.
    """
    return validate_files(files, json, quiet)
