"""The page as a browser shows it: one animation loop, folds that links open, nothing wider than the screen."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import shutil
import subprocess
from dataclasses import replace

import pytest

from probupdate.reporting import compose

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no headless browser: install chromium")

PROBE = """<script>
const frames = [];
let asked = 0;
window.requestAnimationFrame = (f) => { frames.push(f); asked += 1; return asked; };
window.IntersectionObserver = class {
  constructor(told) { this.told = told; }
  observe() { this.told([{ isIntersecting: true }]); }
};
window.addEventListener("load", () => setTimeout(() => {
  const buttons = [...document.querySelectorAll(".viewer .bar button")];
  for (let k = 0; k < 20; k += 1) buttons[k % 3].click();
  const waiting = frames.length;
  frames.splice(0).forEach((f) => f(1000));
  const after = frames.length;
  const closed = document.querySelectorAll("details:not([open])").length;
  window.location.hash = "#update";
  setTimeout(() => {
    const bar = document.querySelector("nav").getBoundingClientRect();
    const found = { waiting, after, closed, opened: document.querySelector("#update details").open,
      title: document.querySelector("#update h2").getBoundingClientRect().top, bar: bar.bottom, height: bar.height,
      wide: document.documentElement.scrollWidth, screen: window.innerWidth };
    document.title = "found" + JSON.stringify(found);
  }, 900);
}, 100));
</script>"""


@pytest.fixture(scope="module")
def html(full_run):
    with pytest.MonkeyPatch.context() as patch:
        from probupdate.reporting import figures

        patch.setattr(figures, "svg_text", lambda figure, prefix: f'<svg id="{prefix}" viewBox="0 0 700 300"></svg>')
        for name in set(figures.__all__) - {"Mark", "svg_text", "unit_label"}:
            patch.setattr(figures, name, lambda *args, **more: None)
        return compose(replace(full_run, title="a run"))


def probed(html: str, allowed: bool) -> str:
    """With the probe in it, and whether the page's policy knows of it."""
    text = PROBE.removeprefix("<script>").removesuffix("</script>")
    known = f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}' " * allowed
    return html.replace("</title>", "</title>" + PROBE, 1).replace("script-src ", "script-src " + known, 1)


def test_a_script_that_is_not_the_pages_own_does_not_run(html, tmp_path):
    path = tmp_path / "page.html"
    path.write_text(probed(html, allowed=False), encoding="utf-8")
    done = subprocess.run(
        [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}",
         "--virtual-time-budget=4000", "--dump-dom", path.as_uri()],
        capture_output=True, text=True, timeout=120, check=True)  # fmt: skip
    assert "<title>a run" in done.stdout and "<title>found" not in done.stdout


@pytest.mark.parametrize("width", [500, 800, 1400])
def test_the_page_in_a_browser(html, tmp_path, width):
    path = tmp_path / "page.html"
    path.write_text(probed(html, allowed=True), encoding="utf-8")
    done = subprocess.run(
        [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}",
         f"--window-size={width},900", "--virtual-time-budget=4000", "--dump-dom", path.as_uri()],
        capture_output=True, text=True, timeout=120, check=True)  # fmt: skip
    told = re.search(r"<title>found(.*?)</title>", done.stdout)
    assert told, done.stderr[-500:]
    found = json.loads(told[1].replace("&amp;", "&"))
    # one loop however often is clicked while it plays
    assert found["waiting"] == found["after"] == 1
    assert found["closed"] > 5 and found["opened"]
    # the navigation is one line and covers no title that it led to
    assert found["height"] <= 40 and found["title"] >= found["bar"] - 1
    assert found["wide"] <= found["screen"]


def printed(html: str, tmp_path, name: str) -> int:
    """Pages of A4 that a browser prints."""
    path, pdf = tmp_path / f"{name}.html", tmp_path / f"{name}.pdf"
    path.write_text(html, encoding="utf-8")
    subprocess.run(
        [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}",
         "--no-pdf-header-footer", f"--print-to-pdf={pdf}", path.as_uri()],
        capture_output=True, timeout=120, check=True)  # fmt: skip
    return len(re.findall(rb"/Type\s*/Page(?![s\w])", pdf.read_bytes()))


def test_paper_has_the_first_of_each_fold_and_all_of_an_open_one(html, tmp_path):
    closed = printed(html, tmp_path, "closed")
    opened = printed(html.replace('<details class="fold">', '<details class="fold" open>'), tmp_path, "open")
    assert 3 <= closed < opened and closed <= 15


def test_a_long_table_is_named_on_paper(html):
    for box in re.findall(r'<div class="tablebox.*?</div>', html, re.DOTALL):
        rows = box.count("<tr") - 1
        assert ("not printed" in box) == (rows > 40) == (" long" in box[:60])
