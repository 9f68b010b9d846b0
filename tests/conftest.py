"""Fixtures for all tests."""

from __future__ import annotations

import gc
import hashlib
import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
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


@pytest.fixture
def laws_at_once(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """No search for laws that remember, the other half of what a law costs; `tests/laws/test_lag.py` is about them."""
    from missionsim.laws import proposal

    if request.node.get_closest_marker("study") is None:
        found = proposal._propose
        monkeypatch.setattr(
            proposal, "_propose", lambda g, f, memory, i, **m: None if memory else found(g, f, memory, i, **m)
        )


def _told(value: Any) -> Any:
    """A value as what can be compared as text, whatever object holds it."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
    if is_dataclass(value):
        return type(value).__name__, [(one.name, _told(getattr(value, one.name))) for one in fields(value)]
    if isinstance(value, Mapping):
        return [(name, _told(one)) for name, one in value.items()]
    if isinstance(value, tuple | list):
        return [_told(one) for one in value]
    return repr(value)


_EXAMINED: dict[str, Any] = {}
MOST_EXAMINED = 8


@pytest.fixture(scope="module")
def examined_once() -> Iterator[None]:
    """Commands that examine the same robot on the same logs, as `diagnose`, `add-effect` and `improve` do one after the
    other, get what the first of them saw; where anything differs, a file's text or a row, each sees for itself."""
    import missionsim.diagnose.examine as module

    real, real_propose = module.examine, module.propose

    def once(subject: Any, *more: Any) -> Any:
        key = repr([repr(subject.robot), _told(subject.priors), _told(more), module.propose is real_propose])
        if key not in _EXAMINED:
            while len(_EXAMINED) >= MOST_EXAMINED:
                del _EXAMINED[next(iter(_EXAMINED))]
            _EXAMINED[key] = real(subject, *more)
        return _EXAMINED[key]

    with pytest.MonkeyPatch.context() as patched:
        for user in ("adopt", "diagnosis", "improve"):
            patched.setattr(f"missionsim.diagnose.{user}.examine", once)
        yield


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
