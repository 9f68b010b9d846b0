"""What the names of files and folders say of the conditions of their runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command as main
from missionsim.labels import Labels
from missionsim.logs import LogTable, read_logs
from tests.logs import loggers

T = np.arange(0.0, 60.0, 0.1).round(1)


def imported(folder: Path, names: list[str]) -> tuple[str, list[LogTable]]:
    """The suggested map of some files, and their logs."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        lines = (f"{t},{p},{v}\n" for t, p, v in zip(T, loggers.power(T), loggers.speed(T), strict=True))
        (folder / name).write_text("t,power,v\n" + "".join(lines))
    made, out = folder / "made.yaml", folder / "out"
    paths = [str(folder / name) for name in names]
    assert main(["import", *paths, "--suggest", "--out", str(made), "--quiet"]) == 0
    assert main(["import", *paths, "--map", str(made), "--out", str(out), "--quiet"]) == 0
    return made.read_text(), sorted(read_logs([out]), key=lambda log: log.run)


LOADED = (("0", "tile"), ("2.5", "carpet"), ("0", "carpet"), ("12.5", "tile"), ("12.5", "carpet"))


@pytest.mark.parametrize("pattern", ["payload{}kg_{}_run{}.csv", "{1}/{0}kg_run{2}.csv"])
def test_floor_and_payload_in_names(tmp_path: Path, pattern: str) -> None:
    names = [pattern.format(*one, i) for i, one in enumerate(LOADED)]
    _, logs = imported(tmp_path, names)
    for log in logs:
        name = next(name for name in names if log.run in name)
        floor = log.columns["surface"]
        assert isinstance(floor, Labels)
        assert floor.names[0] in name
        assert f"{log.number('payload_kg')[0]:g}kg" in name


def test_other_words_are_told_and_numbers_of_runs_are_none(tmp_path: Path) -> None:
    text, _ = imported(tmp_path, [f"{pace}_run{i}.csv" for pace in ("slow", "fast") for i in (1, 2)])
    assert "{file_name: [slow, fast]}" in text.split("columns:")[0]
    text, _ = imported(tmp_path / "b", [f"day{d}_run{i}_20240514.csv" for d in (1, 2) for i in (1, 2)])
    assert "file_name" not in text
