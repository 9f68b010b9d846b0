"""Install a wheel in clean environments, with the lowest and with the newest versions allowed, and use it there.

``python -m tests.quality.installs --python 3.11 3.12 3.13`` builds the wheel, installs it with the extras and runs the
main commands in a folder that ``missionsim examples`` wrote; prints one line for each environment, ends with 1 if a
command failed. Needs uv and a package registry.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
EXTRAS = ("logs", "dask", "gym")
RAMPS = "--robot pioneer3dx docs/examples/ramp_runs"
COMMANDS = f"""\
validate missions environments robots docs/maps
run missions/pioneer3dx/valve_patrol.yaml --out out/run --plot png
run missions/pioneer3dx/valve_patrol.yaml --mcap out/run.mcap --quiet
whatif missions/pioneer3dx/recharging_patrol.yaml --vary defaults.speed=0.3,0.46,0.75 --out out/whatif.csv
montecarlo missions/pioneer3dx/valve_patrol_as_driven.yaml --runs 200 --seed 7 --workers 2 --out out/batch
plan missions/planning/inspection.yaml
reproduce --out out/published
calibrate --new cart --base c1*v+c0 docs/examples/ramp_runs --out out/cart.yaml
compare {RAMPS} --report out/compare.html
diagnose {RAMPS} --report out/diagnose.html
add-effect --robot pioneer3dx --effect grade docs/examples/ramp_runs --out out/graded.yaml
improve {RAMPS} --yes --out out/improved.yaml --report out/improve.html
effects
effects show grade
import docs/examples/patrol_driven.csv --suggest --out out/map.yaml
import docs/examples/ramp_runs/run_00.csv
import out/run.mcap
import-site docs/examples/sites/two_floors.building.yaml --out out/site.yaml
import-robot docs/examples/sites/cart_config.yaml --out out/cart_robot.yaml
export nav2 docs/examples/sites/yard.geojson --robot pioneer3dx --out out/costs.geojson
schema --out out/schemas
robots"""
"""Exit code 1 is an answer; 2 and 3 are failures."""


def build_wheel(folder: Path) -> Path:
    """The wheel of this checkout."""
    _uv("build", "--wheel", "--out-dir", str(folder), str(ROOT))
    return next(folder.glob("*.whl"))


def install(wheel: Path, folder: Path, python: str, resolution: str) -> Path:
    """A clean environment that holds the wheel; its ``bin`` folder."""
    _uv("venv", "--python", python, str(folder))
    here = ["--python", str(folder / "bin" / "python")]
    extras = [word for extra in EXTRAS for word in ("--extra", extra)]
    # uv's "lowest-direct" counts as direct what stands in this file, not what a wheel asks for
    _uv("pip", "install", *here, "--resolution", resolution, "-r", str(ROOT / "pyproject.toml"), *extras)
    _uv("pip", "install", *here, "--no-deps", str(wheel))
    return folder / "bin"


def failures(binaries: Path, folder: Path) -> Iterator[str]:
    """Commands that do not end with 0 or 1, with the end of what they said."""
    environment = {"PATH": f"{binaries}:/usr/bin:/bin", "HOME": str(folder), "COLUMNS": "100", "OMP_NUM_THREADS": "1"}
    for line in [f"examples --out {folder}/use", *COMMANDS.splitlines()]:
        done = subprocess.run(
            [str(binaries / "missionsim"), *line.split()],
            cwd=folder / "use" if (folder / "use").is_dir() else folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=900,
            check=False,
            stdin=subprocess.DEVNULL,
        )
        if done.returncode not in (0, 1) or "Traceback" in done.stderr:
            yield f"{line}: exit {done.returncode}\n{done.stderr[-1500:]}"


def _uv(*words: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "uv", "-q", *words],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "UV_PYTHON_DOWNLOADS": "never"},
    )
    if done.returncode:
        raise RuntimeError(f"uv {' '.join(words)}: {done.stderr[-2000:]}")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--python", nargs="+", default=["3.11"])
    parser.add_argument("--resolution", nargs="+", default=["lowest-direct", "highest"])
    given = parser.parse_args(arguments)
    bad = 0
    with tempfile.TemporaryDirectory() as name:
        wheel = build_wheel(Path(name))
        for python in given.python:
            for resolution in given.resolution:
                folder = Path(name) / f"{Path(python).name}-{resolution}"
                found = list(failures(install(wheel, folder, python, resolution), folder))
                bad += len(found)
                count = len(COMMANDS.splitlines()) + 1
                print(f"Python {python}, {resolution}: {count} commands, {len(found)} failed")
                print("".join(f"  {text}\n" for text in found), end="", flush=True)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
