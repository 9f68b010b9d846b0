"""Damaged files of other tools: a message and exit code 2, or a file that reads; nothing half-written, no hang."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from missionsim.cli.app import run_command
from missionsim.inputs.loading import check_files

FILES = Path(__file__).parents[2] / "docs" / "examples" / "sites"
SITES = sorted(path.name for path in FILES.iterdir())


def damaged(raw: bytes, rng: random.Random) -> bytes:
    """Cut off, bytes flipped, taken out or doubled, numbers replaced, or in another encoding."""
    kind = rng.randrange(6)
    at = rng.randrange(len(raw))
    if kind == 0:
        return raw[:at]
    if kind == 1:
        return bytes(b ^ (1 << rng.randrange(8)) if rng.random() < 0.002 else b for b in raw)
    if kind == 2:
        return raw[:at] + raw[at + rng.randrange(1, 40) :]
    if kind == 3:
        end = at + rng.randrange(1, 60)
        return raw[:end] + raw[at:end] + raw[end:]
    if kind == 4:
        digits = [i for i, b in enumerate(raw) if chr(b).isdigit()]
        at = rng.choice(digits)
        word = rng.choice([b"1e308", b"-1", b"NaN", b'"x"', b"null", b"[]", b"{}", b"99999999999", b"0", b"1e-320"])
        return raw[:at] + word + raw[at + 1 :]
    return raw.decode().encode(rng.choice(["utf-16", "latin-1", "utf-16-be", "utf-8-sig"]), "replace")


def try_damaged(name: str, count: int, seed: int, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = random.Random(f"{name} {seed}")
    raw = (FILES / name).read_bytes()
    for number in range(count):
        source, out, mission = folder / name, folder / "site_out.yaml", folder / "mission_out.yaml"
        source.write_bytes(damaged(raw, rng))
        command = "import-robot" if name == "cart_config.yaml" else "import-site"
        arguments = [command, str(source), "--out", str(out)]
        if number % 2 and name in ("rover.plan", "order.json", "hill.gpx", "rover.waypoints"):
            arguments += ["--mission", str(mission)]
        code = run_command(arguments)
        told = capsys.readouterr()
        assert code in (0, 2), (number, told.err)
        if code == 2:
            assert "error:" in told.err
            assert {path.name for path in folder.iterdir()} == {name}, told.err
        else:
            assert not [fault for fault in check_files([out]) if fault.severity == "error"]
        for path in (out, mission):
            path.unlink(missing_ok=True)


@pytest.mark.parametrize("name", SITES)
def test_damaged_site(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    try_damaged(name, 10, 1, tmp_path, capsys)


@pytest.mark.study
@pytest.mark.parametrize("name", SITES)
def test_many_damaged_sites(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    try_damaged(name, 220, 2, tmp_path, capsys)
