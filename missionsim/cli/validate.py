"""`missionsim validate`: check YAML files and logs, all faults at once."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

from missionsim.cli.options import TERMINAL, Output
from missionsim.errors import Fault, InputError

_YAML = (".yaml", ".yml")


def validate(*files: Path, to: Output = TERMINAL) -> int:
    """Check robots, environments, missions, studies, maps and logs; print all faults of all files at once.

    Parameters
    ----------
    files
        YAML files, logs (.csv, .parquet), or folders that hold them.

    Returns
    -------
    int
        0 when there are no errors (warnings are allowed), 2 otherwise.
    """
    from missionsim.inputs.loading import check_files

    if not files:
        raise InputError.single("nothing to check", allowed="files or folders: missionsim validate FILE...")
    faults: list[Fault] = []
    yaml_files: list[Path] = []
    logs: list[Path] = []
    for given in files:
        found = [given]
        if given.is_dir():
            inside = sorted(given.rglob("*"))
            found = [p for p in inside if (p.suffix.lower() in _YAML or _is_log(p)) and p.is_file()]
        if not found:
            from missionsim.logs.readers import log_suffixes

            allowed = ", ".join((*_YAML, *log_suffixes()))
            faults.append(Fault(str(given), 0, 0, "no YAML file or log in this folder", allowed=allowed))
        for path in found:
            (logs if _is_log(path) else yaml_files).append(path)
    faults += check_files(yaml_files)
    if logs:
        from missionsim.logs import check_log

        for path in logs:
            faults += check_log(path)
    faults = sorted(set(faults))
    errors = [fault for fault in faults if fault.severity == "error"]
    count = len(yaml_files) + len(logs)
    told = [dataclasses.asdict(fault) for fault in faults]
    to.emit({"schema": "missionsim.validation/1", "files": count, "valid": not errors, "faults": told})
    if to.json != "-":
        for fault in faults:
            print(fault, file=sys.stderr)
    if to.text:
        warnings = len(faults) - len(errors)
        numbers = ((count, "file"), (len(errors), "error"), (warnings, "warning"))
        read, *words = (f"{number} {word}{'s' * (number != 1)}" for number, word in numbers)
        print(f"{read}: " + (", ".join(words if warnings else words[:1]) if faults else "valid"))
    return 2 if errors else 0


def _is_log(path: Path) -> bool:
    if path.suffix.lower() in _YAML:
        return False
    from missionsim.logs.readers import log_suffixes

    return path.suffix.lower() in log_suffixes()
