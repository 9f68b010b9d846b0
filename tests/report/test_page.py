"""The page: escaped, self-contained, and working in a real browser."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missionsim.compare import Comparison, compare
from missionsim.report.compare_page import compare_page
from missionsim.report.page import (
    Bullets,
    Chart,
    Choice,
    Details,
    Paragraph,
    Section,
    Table,
    Tiles,
    Verdict,
    format_cell,
    label,
    min_max_indices,
    page,
    plain,
    shared_indices,
)
from tests.compare.worlds import drive, friction_model, log_of, true_power
from tests.report.browser import OUTSIDE, print_to_pdf, run_in_page

MOST_BYTES = 1_500_000
EVIL = '</script><img src=x onerror="document.title=1"><b>&{{ 7*7 }}'


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    logs = []
    for i in range(3):
        columns = drive(seed=i)
        logs.append(log_of(columns, true_power(columns) + 2.0 * np.abs(columns["yaw_rate_rad_s"]), f"run_{i:02d}"))
    return compare(friction_model(), logs)


def test_the_headline_stands_before_the_links(comparison: Comparison) -> None:
    html = compare_page(comparison)
    assert html.index("<h1>") < html.index('class="verdict') < html.index("<nav") < html.index('class="tiles"')
    assert html.count("<nav") == 1


class Outside(HTMLParser):
    """Everything in the markup that would make a browser ask for something."""

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("src", "href", "action", "data", "srcset") and not (value or "").startswith(("#", "data:")):
                self.asked.append(f"{tag} {name}={value}")


def test_page_asks_for_nothing_and_forbids_it(comparison: Comparison) -> None:
    html = compare_page(comparison)
    parser = Outside()
    parser.feed(html)
    assert parser.asked == []
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', html)
    assert policy
    assert policy[1].startswith("default-src 'none'")
    assert not re.search(r"@import|url\(", html.split("<style>")[1].split("</style>")[0])
    assert len(html) < MOST_BYTES


@pytest.mark.parametrize(("times", "side"), [(1.01, "within"), (0.99, "outside")])
def test_the_tolerance_that_was_asked_for_is_the_verdict(comparison: Comparison, times: float, side: str) -> None:
    (battery,) = comparison.batteries.values()
    tolerance = times * abs(battery.energy_error_pct)
    told = f"The energy error is {side} the tolerance of ± {tolerance:g} %."
    assert told in compare_page(comparison, tolerance_pct=tolerance)
    assert "the tolerance of" not in compare_page(comparison)


def test_a_run_that_was_left_out_stands_beside_the_result(comparison: Comparison) -> None:
    assert "Left out" not in compare_page(comparison)
    html = compare_page(replace(comparison, left_out=("ice_11: 0.319 times the other runs",)))
    assert html.index("in none of these numbers") < html.index("ice_11: 0.319 times") < html.rindex("What was assumed")


@pytest.mark.long
def test_many_long_runs_still_make_a_small_page() -> None:
    logs = []
    for i in range(60):
        columns = drive(rows=3000, seed=i)
        noise = np.random.default_rng(i).normal(0.0, 0.5, 3000)
        logs.append(log_of(columns, true_power(columns) + noise, f"run_{i:02d}"))
    html = compare_page(compare(friction_model(), logs))
    assert len(html) < MOST_BYTES
    assert "The 40 runs with the largest power error of 60." in html


def test_text_of_users_is_never_markup() -> None:
    sections = [
        Section(
            EVIL,
            [
                Verdict(EVIL),
                Paragraph(EVIL),
                Bullets([EVIL]),
                Tiles([(EVIL, EVIL, EVIL)]),
                Table([EVIL], [[EVIL]], EVIL),
                Chart([{"type": "scatter", "x": [1], "y": [1], "name": label(EVIL)}], {}, EVIL),
                Choice(EVIL, [(EVIL, [Paragraph(EVIL)])]),
                Details(EVIL, [Paragraph(EVIL)]),
            ],
        )
    ]
    html = page(EVIL, sections, subtitle=EVIL, footer=EVIL)
    assert "<img" not in html.split("<script>")[0]
    data = html.split('id="charts">')[1].split("</script>")[0]
    assert re.fullmatch(r"[A-Za-z0-9+/=]+", data)
    assert "{{ 7*7 }}" in html


def test_cells() -> None:
    values = (None, True, 3, 1234567, 0.0, 12.34567, -0.5, 1e-9, float("nan"))
    assert [format_cell(v) for v in values] == ["–", "yes", "3", "1,234,567", "0", "12.35", "−0.5000", "1.000e-09", "–"]


@settings(max_examples=40)
@given(
    st.recursive(
        st.none() | st.floats() | st.integers(-9, 9) | st.text("aé<\u2028", max_size=5),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text("aé<", max_size=3), inner, max_size=4),
    )
)
def test_chart_data_is_always_json(data: object) -> None:
    import json

    json.dumps(plain(data), allow_nan=False)


@given(st.integers(5, 3000), st.integers(4, 400), st.integers(0, 2**31))
def test_downsampling_keeps_ends_and_extremes(size: int, points: int, seed: int) -> None:
    values = np.random.default_rng(seed).normal(size=size)
    kept = min_max_indices(values, points)
    assert len(kept) <= max(points, 4)
    assert np.all(np.diff(kept) > 0)
    assert {0, size - 1} <= set(kept.tolist())
    assert values[kept].max() == values.max()
    assert values[kept].min() == values.min()
    both = shared_indices([values, -values], 2 * points)
    assert set(kept.tolist()) <= set(both.tolist())


# ---------------------------------------------------------------- in a browser


@pytest.mark.browser
def test_every_chart_is_drawn_without_errors(comparison: Comparison, tmp_path: Path) -> None:
    found = run_in_page(
        compare_page(comparison),
        """
      var shown = Array.from(document.querySelectorAll(".chart")).filter(function (c) { return c.offsetParent; });
      window.found.shown = shown.length;
      window.found.drawn = shown.filter(function (c) { return c.querySelector(".main-svg"); }).length;
      window.found.paths = document.querySelectorAll(".scatterlayer .js-line").length;
      window.found.ready = document.documentElement.dataset.ready;
      window.found.wide = document.documentElement.scrollWidth - window.innerWidth;
      window.found.requests = performance.getEntriesByType("resource").filter(function (entry) {
        return !/^(data|blob):/.test(entry.name); }).map(function (entry) { return entry.name; });
    """,
        tmp_path,
    )
    assert found["errors"] == []
    assert found["requests"] == []
    assert found["ready"] == "yes"
    assert found["drawn"] == found["shown"] >= 4
    assert found["paths"] >= 7
    assert found["wide"] <= 0


@pytest.mark.browser
def test_a_click_on_the_legend_hides_a_series_and_another_shows_it(comparison: Comparison, tmp_path: Path) -> None:
    found = run_in_page(
        compare_page(comparison),
        """
      function over(trace) { return trace.name === "model minus measured"; }
      function power() { return Array.from(document.querySelectorAll(".chart")).filter(function (c) {
        return c.offsetParent && c.data && c.data.some(over); })[0]; }
      function toggle(name) { return Array.from(power().querySelectorAll(".traces")).filter(function (t) {
        return t.textContent === name; })[0].querySelector(".legendtoggle"); }
      function state() { return power().data.filter(function (t) { return t.name === "model"; })[0].visible; }
      window.found.before = state() === undefined || state() === true;
      window.found.lines = power().querySelectorAll(".js-line").length;
      click(toggle("model")); await pause(900);
      window.found.hidden = state();
      window.found.linesHidden = power().querySelectorAll(".js-line").length;
      click(toggle("model")); await pause(900);
      window.found.again = state();
    """,
        tmp_path,
    )
    assert found["errors"] == []
    assert found["before"] is True
    assert found["hidden"] == "legendonly"
    assert found["linesHidden"] == found["lines"] - 1
    assert found["again"] is True


@pytest.mark.browser
def test_choosing_a_run_zooming_and_unfolding(comparison: Comparison, tmp_path: Path) -> None:
    found = run_in_page(
        compare_page(comparison),
        """
      var select = Array.from(document.querySelectorAll("select")).filter(function (s) {
        return s.options[0].text === "run_00"; })[0];
      select.value = "2"; select.dispatchEvent(new Event("change")); await pause(300);
      var options = document.querySelectorAll('[data-choice="' + select.id + '"]');
      window.found.hidden = Array.from(options).map(function (o) { return o.hidden; });
      var chart = options[2].querySelector(".chart");
      window.found.drawn = chart.querySelectorAll(".js-line").length;
      window.found.range = chart.layout.xaxis.range.slice();
      await Plotly.relayout(chart, {"xaxis.range": [10, 20]});
      window.found.zoomed = chart._fullLayout.xaxis.range;
      click(chart.querySelector('.modebar-btn[data-attr="zoom"][data-val="reset"]')); await pause(600);
      window.found.reset = chart._fullLayout.xaxis.range;
      var fold = document.querySelector("details"); fold.open = true; await pause(100);
      window.found.cells = fold.querySelectorAll("td").length;
    """,
        tmp_path,
    )
    assert found["errors"] == []
    assert found["hidden"] == [True, True, False]
    assert found["drawn"] >= 3
    assert found["zoomed"] == [10, 20]
    assert found["reset"] == pytest.approx(found["range"])
    assert found["cells"] > 0


@pytest.mark.browser
def test_the_page_fits_a_telephone(comparison: Comparison, tmp_path: Path) -> None:
    found = run_in_page(compare_page(comparison), OUTSIDE, tmp_path, width=390)
    assert found == {"errors": [], "wide": 0, "outside": []}


@pytest.mark.browser
def test_users_text_stays_text_in_the_browser(tmp_path: Path) -> None:
    bar = {"type": "bar", "x": [label(EVIL)], "y": [1], "name": label(EVIL)}
    html = page("safe", [Section("s", [Paragraph(EVIL), Chart([bar], {"showlegend": True})])])
    found = run_in_page(
        html,
        """
      await pause(300); window.found.title = document.title;
      window.found.images = document.querySelectorAll("img").length;
      window.found.legend = document.querySelector(".legendtext").textContent;
    """,
        tmp_path,
    )
    assert found["title"] == "safe"
    assert found["images"] == 0
    assert "<img" in found["legend"]


@pytest.mark.browser
def test_the_page_on_paper(comparison: Comparison, tmp_path: Path) -> None:
    paper = print_to_pdf(compare_page(comparison), tmp_path)
    data = paper.read_bytes()
    assert data.startswith(b"%PDF")
    pages = len(re.findall(rb"/Type\s*/Page[^s]", data))
    assert 2 <= pages <= 12
    # charts go to paper as lines, not as pictures of the screen
    assert len(data) > 30_000
