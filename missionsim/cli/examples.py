"""`missionsim examples`: the missions, logs and maps that the pages use."""

from __future__ import annotations

from missionsim.cli.options import TERMINAL, OutFolder, Output
from missionsim.report.terminal import console


def examples(*, out: OutFolder | None = None, to: Output = TERMINAL) -> int:
    """Write the missions, environments, example logs, maps, sites and pages that come with missionsim.

    The commands of README and of the pages run in that folder.

    Parameters
    ----------
    out
        Folder for the files, made if need be; files with another content are not overwritten. Without it, the files
        are listed.
    """
    from missionsim.inputs.examples import example_files, write_examples

    names = list(example_files()) if out is None else write_examples(out)
    to.emit({"schema": "missionsim.examples/1", "out": out, "files": names})
    if to.text:
        if out is None:
            for name in names:
                console().print(str(name), soft_wrap=True)
        else:
            terminal = console()
            terminal.print(f"{len(names)} files in {out}; try this there:", soft_wrap=True)
            terminal.print("  missionsim run missions/pioneer3dx/valve_patrol.yaml")
    return 0
