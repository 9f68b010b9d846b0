"""`missionsim examples`: the missions, logs and maps that the pages use."""

from __future__ import annotations

from pathlib import Path

from missionsim.cli.common import console, emit_json, shows_text
from missionsim.cli.options import JsonOption, QuietOption


def examples(*, out: Path | None = None, json: JsonOption = None, quiet: QuietOption = False) -> int:
    """Write the missions, environments, example logs, maps, sites and pages that come with missionsim.

    The commands of README and of the pages run in that folder.

    Parameters
    ----------
    out
        Folder for the files, made if need be; files with another content are not overwritten. Without it, the files
        are listed.
    json
        Write the list of files as JSON to this file, or - for standard output.
    quiet
        Print nothing.
    """
    from missionsim.inputs.examples import example_files, write_examples

    names = list(example_files()) if out is None else write_examples(out)
    emit_json({"schema": "missionsim.examples/1", "out": out, "files": names}, json)
    if shows_text(json, quiet):
        if out is None:
            for name in names:
                console().print(str(name), soft_wrap=True, markup=False)
        else:
            terminal = console()
            terminal.print(f"{len(names)} files in {out}; try this there:", markup=False, soft_wrap=True)
            terminal.print("  missionsim run missions/pioneer3dx/valve_patrol.yaml", markup=False)
    return 0
