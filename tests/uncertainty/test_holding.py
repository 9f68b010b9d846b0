"""Batches hold: workers end with their parent, one process a folder, a resumed batch is the same batch."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from missionsim.cli.app import run_command
from missionsim.uncertainty.batch import Task, block_runs, identity, prepare
from missionsim.uncertainty.store import BlockStore

ROOT = Path(__file__).resolve().parents[2]
PATROL = str(ROOT / "missions/pioneer3dx/valve_patrol_as_driven.yaml")
PARENT = """
import time
from missionsim.workers import process_pool
pool = process_pool(2)
print(*{pool.submit(__import__("os").getpid).result() for _ in range(8)}, flush=True)
time.sleep(600)
"""


def alive(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGTERM])
def test_workers_end_with_a_killed_parent(ending: signal.Signals, tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(f"if __name__ == '__main__':\n{''.join(f'    {line}' + chr(10) for line in PARENT.splitlines())}")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True, env=environment) as parent:
        assert parent.stdout is not None
        workers = [int(word) for word in parent.stdout.readline().split()]
        assert workers
        assert all(map(alive, workers))
        parent.send_signal(ending)
        parent.wait()
    until = time.monotonic() + 300.0
    while any(map(alive, workers)) and time.monotonic() < until:
        time.sleep(0.05)
    assert not any(map(alive, workers))


def test_two_batches_do_not_share_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "batch"
    command = ["montecarlo", PATROL, "--runs", "20", "--quiet", "--out", str(out)]
    with BlockStore(out).locked():
        assert run_command(command) == 2
        assert "another process is writing a batch into this folder" in capsys.readouterr().err
    assert not out.exists()
    assert run_command(command) == 0
    assert sorted(path.name for path in out.iterdir()) == ["batch.json", "blocks", "summary.json"]


def test_a_lock_of_a_killed_process_is_free(tmp_path: Path) -> None:
    out = tmp_path / "batch"
    code = (
        "import sys, time, pathlib\nfrom missionsim.uncertainty.store import BlockStore\n"
        "with BlockStore(pathlib.Path(sys.argv[1])).locked():\n    print('held', flush=True)\n    time.sleep(600)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(out)], stdout=subprocess.PIPE, cwd=ROOT) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        holder.kill()
        holder.wait()
    with BlockStore(out).locked():
        pass


@pytest.mark.parametrize("key", ["code", "python"])
def test_a_batch_of_other_code_or_python_is_not_resumed(
    key: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "batch"
    command = ["montecarlo", PATROL, "--runs", "20", "--quiet", "--out", str(out)]
    assert run_command(command) == 0
    assert run_command([*command, "--resume"]) == 0
    known = json.loads((out / "batch.json").read_text())
    assert known[key] == identity(Task(PATROL, (), None, 0, "auto"), 20)[key]
    (out / "batch.json").write_text(json.dumps({**known, key: "another"}))
    assert run_command([*command, "--resume"]) == 2
    assert f"the batch in this folder is another one, by its {key}" in capsys.readouterr().err


def test_blocks_shrink_with_the_length_of_a_mission(tmp_path: Path) -> None:
    """Runs × (intervals and values) of a block are bounded, so that memory is."""
    for times, size in ((1, 50), (3000, 50), (40_000, 4)):
        path = tmp_path / f"{times}.yaml"
        path.write_text(
            "kind: mission\nname: long\nrobot: pioneer3dx\nsegments:\n"
            f"  - repeat: {{times: {times}, segments: [{{wait: {{duration: 1 s}}}}]}}\n",
            encoding="utf-8",
        )
        assert block_runs(prepare(Task(str(path), (), None, 1, "simpy"))) == size
