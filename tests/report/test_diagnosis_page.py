"""The pages of diagnose and improve in a real browser: charts drawn, controls at work, nothing asked of the network."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from missionsim.diagnose.improve import Improved, improve
from missionsim.diagnose.split import choose_split
from missionsim.identify.findings import Diagnosis, RunSeries
from missionsim.identify.settings import Settings
from missionsim.inputs.edit import robot_text
from missionsim.report.diagnosis_page import diagnosis_page, improve_page
from tests.diagnose.logs import drive
from tests.report.browser import OUTSIDE, OVERLAPS, run_in_page


@pytest.fixture(scope="module")
def done() -> Improved:
    split = choose_split([drive(seed, seconds=240.0, scrub_w_s_rad=3.0) for seed in range(4)])
    return improve(robot_text("pioneer3dx"), split, "robot", Settings(), lambda finding, diagnosis: True)


SCRIPT = """
  var shown = Array.from(document.querySelectorAll(".chart")).filter(function (c) { return c.offsetParent; });
  window.found.shown = shown.length;
  window.found.drawn = shown.filter(function (c) { return c.querySelector(".main-svg"); }).length;
  window.found.requests = performance.getEntriesByType("resource").filter(function (entry) {
    return !/^(data|blob):/.test(entry.name); }).length;
  function over(t) { return t.name === "measured"; }
  var chart = shown.filter(function (c) { return c.data && c.data.some(over); })[0];
  function toggle(name) { return Array.from(chart.querySelectorAll(".traces")).filter(function (t) {
    return t.textContent === name; })[0].querySelector(".legendtoggle"); }
  function state() { return chart.data.filter(over)[0].visible; }
  click(toggle("measured")); await pause(900);
  window.found.hidden = state();
  click(toggle("measured")); await pause(900);
  window.found.again = state();
  var select = Array.from(document.querySelectorAll("select")).filter(function (s) { return s.options.length > 2; })[0];
  select.selectedIndex = 2; select.dispatchEvent(new Event("change", {bubbles: true})); await pause(600);
  window.found.run = Array.from(document.querySelectorAll(".chart")).filter(function (c) {
    return c.offsetParent && c.data && c.data.some(over); }).length;
"""


@pytest.mark.browser
def test_diagnosis_page(done: Improved, tmp_path: Path) -> None:
    found = run_in_page(diagnosis_page(Diagnosis("pioneer3dx", {"robot": done.first})), SCRIPT, tmp_path)
    assert found["errors"] == []
    assert found["requests"] == 0
    assert found["drawn"] == found["shown"] >= 2
    assert found["hidden"] == "legendonly"
    assert found["again"] is True
    assert found["run"] == 1


@pytest.mark.browser
def test_improvement_fits_a_telephone(done: Improved, tmp_path: Path) -> None:
    found = run_in_page(improve_page("pioneer3dx", [done]), OUTSIDE, tmp_path, width=390)
    assert found == {"errors": [], "wide": 0, "outside": []}


@pytest.mark.browser
def test_no_button_lies_on_a_legend(done: Improved, tmp_path: Path) -> None:
    found = run_in_page(improve_page("pioneer3dx", [done]), OVERLAPS, tmp_path, width=1180)
    assert found == {"errors": [], "overlaps": []}


@pytest.mark.long
def test_many_long_runs_still_make_a_small_page(done: Improved) -> None:
    rng = np.random.default_rng(0)
    time_s = np.arange(0.0, 3600.0, 0.1)
    runs = [RunSeries(f"run_{i}", time_s, *rng.normal(20.0, 1.0, (3, len(time_s)))) for i in range(60)]
    long = [replace(diagnosis, series=tuple(runs)) for diagnosis in (done.first, done.last)]
    html = improve_page("pioneer3dx", [replace(done, first=long[0], last=long[1])])
    assert "The first 30 of 60 runs." in html
    assert len(html) < 1_500_000


@pytest.mark.browser
def test_improve_page_has_the_waterfall(done: Improved, tmp_path: Path) -> None:
    assert done.added == ("turning_scrub",)
    found = run_in_page(
        improve_page("pioneer3dx", [done]),
        """
      var charts = Array.from(document.querySelectorAll(".chart")).filter(function (c) { return c.offsetParent; });
      window.found.drawn = charts.filter(function (c) { return c.querySelector(".main-svg"); }).length;
      window.found.bars = charts[0].querySelectorAll(".bars .point").length;
      window.found.first = document.querySelector("h2").textContent;
    """,
        tmp_path,
    )
    assert found["errors"] == []
    assert found["bars"] == len(done.steps) == 4
    assert found["drawn"] >= 4
