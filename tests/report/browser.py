"""A page in headless Chromium: the DOM after its scripts, and what a script of the test found out inside it."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
PROBE = """<script>
"use strict";
window.found = {errors: []};
window.addEventListener("error", function (event) { window.found.errors.push(String(event.message)); });
document.addEventListener("securitypolicyviolation", function (event) {
  window.found.errors.push("policy: " + event.violatedDirective + " " + event.blockedURI);
});
var said = console.error;
console.error = function () {
  window.found.errors.push(Array.from(arguments).join(" "));
  said.apply(console, arguments);
};
</script>"""

FRAME = """<!DOCTYPE html><body><iframe src="page.html" style="width: WIDTHpx; height: 1400px; border: 0"></iframe>
<script>
window.addEventListener("message", function (event) {
  var out = document.createElement("script");
  out.type = "application/json"; out.id = "found";
  out.textContent = btoa(unescape(encodeURIComponent(event.data)));
  document.body.appendChild(out);
});
</script></body>"""

OUTSIDE = """
  window.found.wide = document.documentElement.scrollWidth - document.documentElement.clientWidth;
  window.found.outside = [];
  document.querySelectorAll(".chart").forEach(function (chart) {
    if (!chart.offsetParent) { return; }
    var card = chart.closest("section").getBoundingClientRect();
    chart.querySelectorAll(".main-svg, text").forEach(function (mark) {
      var box = mark.getBoundingClientRect();
      if (box.width > 0 && (box.left < card.left - 1 || box.right > card.right + 1)) {
        window.found.outside.push(chart.id + ": " + mark.textContent.slice(0, 60));
      }
    });
  });
"""
"""What lies beside the screen, or a chart or writing of a chart beside the card that holds it."""

OVERLAPS = """
  window.found.overlaps = [];
  document.querySelectorAll(".chart").forEach(function (chart) {
    chart.querySelectorAll(".modebar-group").forEach(function (bar) {
      var a = bar.getBoundingClientRect();
      chart.querySelectorAll(".legend .traces").forEach(function (entry) {
        var b = entry.getBoundingClientRect();
        if (a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom) {
          window.found.overlaps.push(chart.id + ": " + entry.textContent);
        }
      });
    });
  });
"""
"""Entries of a legend on which the buttons of their chart lie."""


def browser() -> str:
    """Path of a Chromium; skips the test where there is none."""
    for name in NAMES:
        path = shutil.which(name)
        if path:
            return path
    pytest.skip(f"no browser is installed (looked for {', '.join(NAMES)})")


def run_in_page(html: str, script: str, folder: Path, *, width: int = 1200) -> dict[str, Any]:
    """Open a page from disk, run `script` in it once it is drawn, and give what it left in ``window.found``.

    Parameters
    ----------
    html : str
        The page.
    script : str
        Body of an async function; ``click(element)`` presses the mouse as a user does, ``pause(ms)`` waits.
    folder : Path
        For the page and the browser's profile.
    width : int
        Of the page, CSS pixels. It is shown in a frame, as a window of Chromium is never narrower than 500.
    """
    driver = """<script>
    function pause(ms) { return new Promise(function (done) { setTimeout(done, ms); }); }
    function click(element) {
      var box = element.getBoundingClientRect();
      ["mousedown", "mouseup", "click"].forEach(function (kind) {
        element.dispatchEvent(new MouseEvent(kind, {bubbles: true, cancelable: true, view: window, button: 0,
          clientX: box.x + box.width / 2, clientY: box.y + box.height / 2}));
      });
    }
    (async function () {
      var root = document.documentElement;
      while (document.getElementById("charts") && root.dataset.ready !== "yes") { await pause(50); }
      await pause(500);
      try { SCRIPT } catch (error) { window.found.errors.push(String(error)); }
      parent.postMessage(JSON.stringify(window.found), "*");
    })();
    </script>""".replace("SCRIPT", script)
    page, frame = folder / "page.html", folder / "frame.html"
    page.write_text(html.replace("<style>", PROBE + "<style>", 1).replace("</body>", driver + "</body>"), "utf-8")
    frame.write_text(FRAME.replace("WIDTH", str(width)), "utf-8")
    dom = _call(["--dump-dom", "--virtual-time-budget=12000", f"--window-size={width + 50},1400"], frame, folder)
    match = re.search(r'id="found">([^<]*)<', dom)
    assert match, f"the page's scripts did not come to their end: {dom[:300]}"
    found: dict[str, Any] = json.loads(base64.b64decode(match[1]))
    return found


def print_to_pdf(html: str, folder: Path) -> Path:
    """The page on paper."""
    page, paper = folder / "paper.html", folder / "paper.pdf"
    page.write_text(html, "utf-8")
    _call([f"--print-to-pdf={paper}", "--no-pdf-header-footer", "--virtual-time-budget=8000"], page, folder)
    return paper


def _call(options: list[str], page: Path, folder: Path) -> str:
    command = [
        browser(),
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-background-networking",
        "--disable-dev-shm-usage",
        f"--user-data-dir={folder / 'profile'}",
        *options,
        page.as_uri(),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    return done.stdout
