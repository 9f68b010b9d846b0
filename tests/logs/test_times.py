"""Time stamps as loggers write them, against datetime and zoneinfo of the standard library."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from missionsim.labels import Labels
from missionsim.logs import check_log, iter_blocks, read_log
from missionsim.logs.times import TimeError, read_stamps

START = datetime(2021, 6, 25, 23, 59, 50, 473_000)
STEPS = [START + timedelta(seconds=0.25 * i + 0.001 * (i % 3)) for i in range(80)]
TRUE = np.array([(t - START).total_seconds() for t in STEPS])


def _milli(text: str) -> str:
    """A time with three digits after the mark in place of six."""
    return text[:-3]


FORMS = {
    "iso": lambda t: _milli(t.strftime("%Y-%m-%d %H:%M:%S.%f")),
    "iso T Z": lambda t: _milli(t.strftime("%Y-%m-%dT%H:%M:%S.%f")) + "Z",
    "iso offset": lambda t: _milli(t.strftime("%Y-%m-%dT%H:%M:%S.%f")) + "+02:00",
    "slashes": lambda t: _milli(t.strftime("%Y/%m/%d %H:%M:%S.%f")),
    "german": lambda t: _milli(t.strftime("%d.%m.%Y %H:%M:%S,%f")),
    "american": lambda t: _milli(t.strftime("%m/%d/%Y %I:%M:%S.%f")) + t.strftime(" %p"),
    "british": lambda t: _milli(t.strftime("%d/%m/%Y %H:%M:%S.%f")),
    "time of day": lambda t: _milli(t.strftime("%H:%M:%S.%f")),
    "compact": lambda t: _milli(t.strftime("%Y%m%dT%H%M%S.%f")),
}


@pytest.mark.parametrize("form", FORMS)
def test_forms(tmp_path: Path, form: str) -> None:
    texts = [FORMS[form](t) for t in STEPS]
    found = read_stamps([Labels.of(texts)], "t")
    np.testing.assert_allclose(found.seconds - found.seconds[0], TRUE, atol=2e-6)
    assert found.remarks[0].message.startswith("recognised as")
    rows = [f'"{text}",{10 + i % 3}' for i, text in enumerate(texts)]
    path = tmp_path / "run.csv"
    path.write_text("time_s,power_robot_w\n" + "\n".join(rows) + "\n")
    log = read_log(path)
    np.testing.assert_allclose(log.time_s, TRUE, atol=2e-6)
    assert np.isfinite(log.begin_s) == (form != "time of day")
    assert [fault.message for fault in check_log(path)] == []
    pieces = np.concatenate([block.time_s for block in iter_blocks(path, rows=30)])
    np.testing.assert_allclose(pieces, TRUE, atol=2e-6)


def test_date_and_time_in_two_columns() -> None:
    dates = Labels.of([t.strftime("%Y-%m-%d") for t in STEPS])
    clocks = Labels.of([t.strftime("%H:%M:%S.%f") for t in STEPS])
    for parts in ([dates, clocks], [clocks, dates]):
        found = read_stamps(parts, "t")
        np.testing.assert_allclose(found.seconds - found.seconds[0], TRUE, atol=2e-6)


@pytest.mark.parametrize("zone", ["Europe/Berlin", "America/New_York", "Australia/Sydney"])
@pytest.mark.parametrize("season", ["spring", "autumn"])
def test_a_change_of_clocks_with_a_zone(zone: str, season: str) -> None:
    place = ZoneInfo(zone)
    day = datetime(2025, 1, 1, tzinfo=UTC)
    offsets = [(day + timedelta(hours=h)).astimezone(place).utcoffset() for h in range(24 * 365)]
    turns = [h for h in range(1, len(offsets)) if offsets[h] != offsets[h - 1]]
    forward = {h: offsets[h] > offsets[h - 1] for h in turns}  # type: ignore[operator]
    hour = next(h for h in turns if forward[h] == (season == "spring"))
    times = [day + timedelta(hours=hour, seconds=s) for s in range(-5400, 5400, 30)]
    wall = [t.astimezone(place).strftime("%Y-%m-%d %H:%M:%S") for t in times]
    true = np.array([(t - times[0]).total_seconds() for t in times])
    # a text stands twice in autumn; rows and not names are read
    found = read_stamps([Labels.of(wall)], "t", zone)
    np.testing.assert_allclose(found.seconds - found.seconds[0], true)
    assert found.seconds[0] == pytest.approx(times[0].timestamp())
    bare = read_stamps([Labels.of(wall)], "t")
    np.testing.assert_allclose(bare.seconds - bare.seconds[0], true)
    assert "the clocks were changed" in bare.remarks[-1].message


def test_the_hour_that_is_there_twice_is_refused_where_nothing_tells_which() -> None:
    texts = Labels.of([f"2025-10-26 02:10:{s:02d}" for s in range(30)])
    with pytest.raises(TimeError, match="give the offset in place of the zone"):
        read_stamps([texts], "t", "Europe/Berlin")
    found = read_stamps([texts], "t", "+01:00")
    assert found.seconds[0] == datetime(2025, 10, 26, 1, 10, tzinfo=UTC).timestamp()
    with pytest.raises(TimeError, match="there is no zone 'Mars/Crater'"):
        read_stamps([texts], "t", "Mars/Crater")


@pytest.mark.parametrize("text", ["yesterday", "2021-06-25", "12", "25.13.2021 10:00:00", "10h"])
def test_what_is_no_time(tmp_path: Path, text: str) -> None:
    with pytest.raises(TimeError):
        read_stamps([Labels.of([text, text + " "])], "t")


def test_a_bad_stamp_among_good_ones_is_a_missing_time(tmp_path: Path) -> None:
    texts = [FORMS["iso"](t) for t in STEPS]
    texts[7] = "2021-06-25 23:61:00.000"
    path = tmp_path / "run.csv"
    path.write_text("time_s,power_robot_w\n" + "".join(f"{text},10\n" for text in texts))
    log = read_log(path)
    assert log.rows == len(texts) - 1
    assert any(r.message == "1 row without a time" for r in log.remarks)
