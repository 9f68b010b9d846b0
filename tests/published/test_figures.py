"""Verdicts on published figures, and that none of the papers' figures is missing."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from missionsim.published import figures
from missionsim.published.figures import (
    AGREES,
    CALIBRATED,
    CONTRADICTS,
    DIFFERS,
    UNCHECKABLE,
    Figure,
    Ours,
    judge,
    judge_all,
    load_figures,
)


def figure(printed: str, rule: str = "rounded", basis: str = "") -> Figure:
    return Figure(
        paper="p", key="k", item="item", where="Table 1", printed=printed, unit="W", rule=rule, basis=basis, why="why"
    )


@pytest.mark.parametrize(
    ("printed", "rule", "ours", "met"),
    [
        ("12.94", "rounded", 12.9449, True), ("12.94", "rounded", 12.9451, False),
        ("12.90", "rounded", 12.905, True), ("0.76", "truncated", 0.7652, True),
        ("0.76", "truncated", 0.7699, True), ("0.76", "truncated", 0.77, False),
        ("0.76", "truncated", 0.7599, False), ("-2.8", "truncated", -2.86, True),
        ("-2.8", "truncated", -2.75, False), ("95", "at_least", 95.0, True), ("95", "at_least", 94.99, False),
        ("5", "at_most", 4.9, True), ("180", "about:5", 184.9, True), ("180", "about:5", 185.1, False),
        ("5.1e-4", "rounded", 5.14e-4, True), ("5.1e-4", "rounded", 5.16e-4, False),
        ("28.6", "inputs:0.03", 28.63, True),
    ],
)  # fmt: skip
def test_rules_of_rounding(printed: str, rule: str, ours: float, met: bool) -> None:
    assert figure(printed, rule).met(ours) is met


def test_trailing_zeros_count_as_digits() -> None:
    assert figure("0.400").tolerance == pytest.approx(0.0005)
    assert figure("14").tolerance == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("basis", "ours", "status"),
    [
        ("", 1.0, AGREES),
        ("", 1.2, DIFFERS),
        ("input", 1.0, CALIBRATED),
        ("input", 1.2, DIFFERS),
        ("fitted", 1.0, CALIBRATED),
        ("fitted", 1.2, CALIBRATED),
        ("contradiction", 1.2, CONTRADICTS),
        ("contradiction", 1.0, AGREES),
        ("uncheckable", None, UNCHECKABLE),
        ("", None, UNCHECKABLE),
    ],
)
def test_statuses(basis: str, ours: float | None, status: str) -> None:
    assert judge(figure("1.0", basis=basis), Ours(ours)).status == status


def test_inputs_and_fits_are_never_said_to_agree() -> None:
    for paper in figures.PAPERS.values():
        for found in load_figures(paper).values():
            assert found.basis in ("", "input", "fitted", "contradiction", "uncheckable"), found.key
            if found.basis:
                assert found.why, f"{paper} {found.key} has no reason"
            if found.basis in ("input", "fitted"):
                assert judge(found, Ours(found.value)).status == CALIBRATED


def test_ours_must_belong_to_a_printed_figure() -> None:
    with pytest.raises(KeyError, match="no such figures"):
        judge_all("rover2025", {"nonsense": Ours(1.0)})


SEEDS = {
    "jaiem2021": "jaiem2021_pioneer3dx.txt",
    "parasuraman2012": "parasuraman2012_khepera3.txt",
    "hou2019": "hou2019_mecanum.txt",
    "rover2025": "rover_tx2_2025.txt",
}
# numbers with a unit, a percentage or decimals in the running text; what stands here is no figure of the work itself
NUMBER = re.compile(r"(?<![\w.\[/-])(\d+\.\d+|\d+(?=\s*(?:%|W\b|Hz\b|mm/s|mAh|kg\b|batch)))(?![\w.]*\d)")
NOT_OURS = {
    # identifier of the article, sections, USB versions, 5.1·10⁻⁴, numbers of manuscript lines
    "jaiem2021": {"10.1007", "2.1", "2.2", "2.3", "2.4", "3.1", "3.2", "3.3", "3.4", "2.0", "5.1", "399", "531"},
    "parasuraman2012": set(),
    # sections
    "hou2019": {"2.1", "2.2", "2.3", "2.4"},
    "rover2025": set(),
}


@pytest.mark.parametrize("paper", list(SEEDS))
def test_no_printed_number_is_dropped(paper: str, shared: Path) -> None:
    """Every number of the paper's text is a figure of the data file."""
    text = (shared / "seeds" / SEEDS[paper]).read_text(encoding="utf-8")
    text = text.split("REFERENCES")[0]
    printed = {float(f.printed) for f in load_figures(paper).values()}
    printed |= {abs(value) for value in printed}
    # times of samples are the names of their rows
    printed |= {float(time) for key in load_figures(paper) for time in re.findall(r"^table\d\.t(\d\.\d)\.", key)}
    found = {number for number in NUMBER.findall(text) if float(number) not in printed}
    assert sorted(found - NOT_OURS[paper]) == []
    assert len(NUMBER.findall(text)) > 10


@pytest.mark.parametrize(
    ("paper", "prefix", "count"),
    [
        ("jaiem2021", "table4.r", 26 * 14),
        ("jaiem2021", "table5.", 12 * 3 + 3),
        ("jaiem2021", "table3.", 7),
        ("jaiem2021", "table2.", 3),
        ("hou2019", "table3.t", 14 * 3),
        ("hou2019", "table4.t", 14 * 3),
        ("hou2019", "table1.", 12),
        ("parasuraman2012", "table1.", 15),
        ("rover2025", "table1.", 6),
    ],
)
def test_tables_are_whole(paper: str, prefix: str, count: int) -> None:
    assert sum(key.startswith(prefix) for key in load_figures(paper)) == count


def test_table_4_is_transcribed_cell_by_cell(shared: Path) -> None:
    """The rows of the paper's text against the data file; labels of merged cells stand before the numbers."""
    text = (shared / "seeds" / SEEDS["jaiem2021"]).read_text(encoding="utf-8")
    rows = [re.findall(r"(?<=\t)-?\d+(?:\.\d+)?(?=\t|$)", "\t" + line.strip()) for line in text.splitlines()]
    rows = [row for row in rows if len(row) == 21]
    assert len(rows) == 26
    columns = [
        *("P_R", "P_L_kinect", "P_L_laser", "P_L_watt", "P_L_switch1", "P_L_switch2", "P_L_screen", "P_L_proc"),
        *("P_L", "pct_screen"),
    ]
    columns += ["P_total", "pct_P_R", "pct_P_L", "delta_P"]
    data, configurations = load_figures("jaiem2021"), figures.load_table("jaiem2021_table4_rows")
    for number, (row, configuration) in enumerate(zip(rows, configurations, strict=True), start=1):
        assert row[:3] == [configuration[name] for name in ("sonar", "laser", "kinect")]
        assert row[7:] == [data[f"table4.r{number:02d}.{name}"].printed for name in columns]


@pytest.mark.parametrize("table", ["3", "4"])
def test_hous_tables_are_transcribed_cell_by_cell(shared: Path, table: str) -> None:
    text = (shared / "seeds" / SEEDS["hou2019"]).read_text(encoding="utf-8")
    part = text[text.index(f"\nTable {table}. ") :]
    rows = [line.split("\t") for line in part.splitlines() if re.fullmatch(r"[\d.]+(\t[\d.]+){3}", line.strip())][:14]
    data = load_figures("hou2019")
    assert len(rows) == 14
    for time, speed, modelled, measured in rows:
        key = f"table{table}.t{float(time):.1f}"
        assert (speed, modelled, measured) == tuple(
            data[f"{key}.{name}"].printed for name in ("speed", "modelled", "measured")
        )
