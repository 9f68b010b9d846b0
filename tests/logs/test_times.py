"""Time stamps as loggers write them, against datetime and zoneinfo of the standard library."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from missionsim.importer.mapping import import_source
from missionsim.inputs.loading import load_map
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
    "zone's name": lambda t: _milli(t.strftime("%Y-%m-%d %H:%M:%S.%f")) + " CEST",
    "german with a zone": lambda t: _milli(t.strftime("%d.%m.%Y %H:%M:%S,%f")) + " UTC",
    "dots": lambda t: _milli(t.strftime("%d-%m-%Y %H.%M.%S.%f")),
    "ctime": lambda t: f"{t:%a %b %d %H:%M:%S}.{t.microsecond // 1000:03d} CET {t:%Y}",
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


@pytest.mark.parametrize("text", ["2021-06-25T23:59:{:02d}.5{}", "25.06.2021 23:59:{:02d}{}"])
@pytest.mark.parametrize(
    ("most", "other", "said"), [("+01:00", "", "has no UTC offset"), ("", "Z", "has a UTC offset")]
)
def test_stamps_with_and_without_an_offset(text: str, most: str, other: str, said: str) -> None:
    odd = {0, 17}
    texts = [text.format(second, other if second in odd else most) for second in range(59)] + ["time"]
    found = read_stamps([Labels.of(texts)], "t")
    assert set(np.flatnonzero(np.isnan(found.seconds))) == odd | {59}
    assert np.ptp(found.seconds[1:17]) == 15.0
    assert [r.message for r in found.remarks if "offset" in r.message] == [f"'{texts[0]}' {said}, unlike other stamps"]
    with pytest.raises(TimeError, match=f"{said}, unlike other stamps") as raised:
        read_stamps([Labels.of(texts[15:25])], "t")
    assert raised.value.row == 2


def test_a_first_stamp_that_is_none(tmp_path: Path) -> None:
    """The times of all rows were counted from it, so that no row had one."""
    texts = ["", *(FORMS["iso"](t) for t in STEPS[1:])]
    (tmp_path / "run.csv").write_text("at,watt\n" + "".join(f"{text},10\n" for text in texts))
    (tmp_path / "map.yaml").write_text("kind: map\ncolumns: {time_s: {stamp: at}, power_robot_w: watt}\n")
    (log,) = import_source(tmp_path / "run.csv", load_map(tmp_path / "map.yaml"))
    assert log.rows == len(texts) - 1


def test_zones_by_name_change_with_the_clocks() -> None:
    texts = Labels.of(["2024-10-27 02:59:59 CEST", "2024-10-27 02:00:00 CET", "27.10.2024 02:00:01 MEZ"][:2])
    np.testing.assert_array_equal(np.diff(read_stamps([texts], "t").seconds), [1.0])


def test_a_name_of_several_zones_is_asked_for() -> None:
    texts = Labels.of(["2024-11-23 13:10:00 CST", "2024-11-23 13:10:01 CST"])
    with pytest.raises(TimeError, match=r"several zones of the name CST; say which in a map \(zone: America/Chicago\)"):
        read_stamps([texts], "t")
    found = read_stamps([texts], "t", "America/Chicago").seconds
    assert found[0] == datetime(2024, 11, 23, 13, 10, tzinfo=ZoneInfo("America/Chicago")).timestamp()


@pytest.mark.parametrize(
    ("texts", "steps"),
    [
        (["09:59.5", "10:00.0", "10:00.5"], [0.5, 0.5]),
        (["59:59,9", "00:00,1", "00:00,3"], [0.2, 0.2]),  # as spreadsheets show times, without the hour
        (["59:59.9", "60:00.1", "61:00.1"], [0.2, 60.0]),
        (["59:58", "59:59", "60:00"], [1.0, 1.0]),
    ],
)
def test_minutes_and_seconds(texts: list[str], steps: list[float]) -> None:
    found = read_stamps([Labels.of(texts)], "t")
    np.testing.assert_allclose(np.diff(found.seconds), steps, atol=1e-9)
    assert "minutes and seconds" in found.remarks[0].message


def test_two_numbers_with_a_colon_are_hours_and_minutes_only_beside_a_date() -> None:
    with pytest.raises(TimeError, match="'00:01' may be hours and minutes, or minutes and seconds"):
        read_stamps([Labels.of(["00:01", "00:02", "00:03"])], "t")
    late = read_stamps([Labels.of(["13:10", "13:11"])], "t")
    assert [remark.severity for remark in late.remarks] == ["note", "warning"]
    dated = read_stamps([Labels.of(["2024-11-23", "2024-11-23 "]), Labels.of(["00:01", "00:02"])], "t")
    assert np.diff(dated.seconds)[0] == 60.0
    assert not [remark for remark in dated.remarks if remark.severity == "warning"]


@pytest.mark.parametrize(("zero", "who"), [(25569.0, "spreadsheets count"), (719529.0, "MATLAB counts")])
def test_days(tmp_path: Path, zero: float, who: str) -> None:
    """A log of such times was 86,400 times too short, with nothing said."""
    days = zero + (START.replace(tzinfo=UTC).timestamp() + TRUE) / 86400.0
    found = read_stamps([days], "t")
    assert found.remarks[0].message == f"recognised as days, as {who} them"
    assert found.seconds[0] == pytest.approx(START.replace(tzinfo=UTC).timestamp(), abs=1e-3)
    np.testing.assert_allclose(found.seconds - found.seconds[0], TRUE, atol=1e-4)
    rows = [f"{day:.10f},{10 + i % 3}" for i, day in enumerate(days)]
    (tmp_path / "run.csv").write_text("time_s,power_robot_w\n" + "\n".join(rows) + "\n")
    assert read_log(tmp_path / "run.csv").duration_s == pytest.approx(20.0, abs=0.3)


def test_parts_of_a_day() -> None:
    """Times of a spreadsheet fell into one row, as seconds."""
    clock = (0.9999 + TRUE / 86400.0) % 1.0  # past midnight
    found = read_stamps([clock], "t")
    assert found.kind == "day"
    np.testing.assert_allclose(found.seconds - found.seconds[0], TRUE, atol=1e-4)
    with pytest.raises(TimeError, match="may be parts of a day, as spreadsheets write a time, or seconds"):
        read_stamps([0.5 + np.arange(50) / 8640.0], "t")
    assert read_stamps([0.001 * np.arange(50)], "t").kind == "own"


def test_days_or_seconds_are_asked_for() -> None:
    """Rows of ten seconds as days, or of 8.6 kHz."""
    with pytest.raises(TimeError, match=r"may be days, as spreadsheets count them, or seconds; .* unit: d"):
        read_stamps([45619.5 + np.arange(50) / 8640.0], "t")
    seconds = 45619.5 + 0.001 * np.arange(50)  # of a clock, at 1 kHz
    assert read_stamps([seconds], "t").kind == "own"


def test_seconds_and_nanoseconds() -> None:
    seconds, nano = np.array([1748959510.0, 1748959510.0, 1748959511.0, np.nan]), np.array([0.0, 999999999.0, 5e8, 1.0])
    assert read_stamps([seconds, nano], "t").seconds[:3] - 1748959510 == pytest.approx([0.0, 1.0, 1.5], abs=1e-6)
    assert np.isnan(read_stamps([seconds, nano], "t").seconds[3])
    for other in (nano - 1, nano + 0.5, 2 * nano):
        with pytest.raises(TimeError, match="a date and a time of day"):
            read_stamps([seconds, other], "t")
