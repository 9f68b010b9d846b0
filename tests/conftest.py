"""Fixtures for all tests."""

from __future__ import annotations

import gc
import os
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SHARED = Path(os.environ.get("MISSIONSIM_SHARED", ROOT.parent / "shared"))

# one thread a process: the suite shares its cores, and sums repeat to the last bit
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
# the next run need not rewrite all assertions; processes that tests start keep bytecode too, as a user's do
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


@pytest.fixture(scope="session")
def root() -> Path:
    """The repository."""
    return ROOT


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of papers, practice logs and measured logs beside the repository; skips where it is absent."""
    if not (SHARED / "contract.md").is_file():
        pytest.skip(f"the folder of shared papers and logs is not here ({SHARED})")
    return SHARED


@pytest.fixture
def effects_alone(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """No search for laws, which takes half of a diagnosis and begins when effects have been named; studies keep it."""
    if request.node.get_closest_marker("study") is None:
        monkeypatch.setattr("missionsim.diagnose.examine.propose", lambda *_: None)


def pytest_configure() -> None:
    """Examples repeat, and no test is judged by a busy clock; HYPOTHESIS_PROFILE=default searches anew."""
    from hypothesis import settings

    settings.register_profile("repeatable", derandomize=True, deadline=None)
    settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


def pytest_collection_finish() -> None:
    """What was imported by now stays: the garbage collector need not look through it again and again."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
