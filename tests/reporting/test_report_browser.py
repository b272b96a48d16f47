"""The page as a browser shows it: one animation loop, folds that links open, nothing wider than the screen."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import subprocess
from dataclasses import replace

import pytest
from browser import BROWSER, browser

from probupdate.reporting import compose
from probupdate.reporting.elements import Column, Items, Section, Table
from probupdate.reporting.page import render

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
        capture_output=True, text=True, timeout=120, check=True)
    assert "<title>a run" in done.stdout and "<title>found" not in done.stdout


@pytest.mark.parametrize("width", [500, 800, 1400])
def test_the_page_in_a_browser(html, tmp_path, width):
    path = tmp_path / "page.html"
    path.write_text(probed(html, allowed=True), encoding="utf-8")
    done = subprocess.run(
        [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}",
         f"--window-size={width},900", "--virtual-time-budget=4000", "--dump-dom", path.as_uri()],
        capture_output=True, text=True, timeout=120, check=True)
    match = re.search(r"<title>found(.*?)</title>", done.stdout)
    assert match, done.stderr[-500:]
    found = json.loads(match[1].replace("&amp;", "&"))
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
        capture_output=True, timeout=120, check=True)
    return len(re.findall(rb"/Type\s*/Page(?![s\w])", pdf.read_bytes()))


def test_paper_has_more_of_an_open_fold_than_of_a_closed_one(html, tmp_path):
    closed = printed(html, tmp_path, "closed")
    opened = printed(html.replace('<details class="fold">', '<details class="fold" open>'), tmp_path, "open")
    assert 3 <= closed < opened


def test_a_long_table_is_named_on_paper(html):
    for box in re.findall(r'<div class="tablebox.*?</div>', html, re.DOTALL):
        rows = box.count("<tr") - 1
        assert ("not printed" in box) == (rows > 40) == (" long" in box[:60])


# With its figures ---------------------------------------------------------------------------------------------------

# A4 less the style's margins, in CSS pixels of 1/96 inch
PAPER_PX = (184 / 25.4 * 96, 269 / 25.4 * 96)
# what sticks out of the screen or of its own frame, which may move sideways
OUTSIDE = ("""(() => {
  const framed = (e) => e.closest(".tablebox, figure, .links, .viewer");
  const within = (e) => { const f = e.closest("figure, .tablebox"); """
           """return f && getComputedStyle(f).overflowX === "auto"; };
  const wide = (e) => e.getBoundingClientRect().right > window.innerWidth + 1;
  const own = [...document.querySelectorAll("main *")].filter((e) => wide(e) && !framed(e) && !e.closest("svg"));
  const boxes = [...document.querySelectorAll("figure, .tablebox, figure > svg")].filter((e) => wide(e) && !within(e));
  return [...own, ...boxes].map((e) => e.outerHTML.slice(0, 80));
})()""")


@pytest.fixture(scope="module")
def drawn(full_run, tmp_path_factory):
    """The page as a run with every part gives it."""
    path = tmp_path_factory.mktemp("drawn") / "page.html"
    path.write_text(compose(replace(full_run, title="a run")), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    with browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.mark.parametrize("screen", [1000, 1200, 1600])
@pytest.mark.parametrize("width", ["half", "full"])
def test_no_table_of_the_verdict_covers_what_stands_beside_it(page, tmp_path, width, screen):
    wide = Table(caption="In each state", columns=tuple(Column(name=f"from 2026-03-0{k}T09:00Z on") for k in range(6)),
                 rows=(("165 000 (160 000 to 170 000)",) * 6,), width=width)
    beside = Items(title="What not to rely on", statements=("a long sentence " * 40,), level="warning", width="half")
    verdict = Section(anchor="verdict", title="Verdict", headline="found", items=(wide, beside, beside, wide), shown=3)
    path = tmp_path / "page.html"
    path.write_text(render([verdict], title="a run"), encoding="utf-8")
    page.show(path, screen)
    box, table, scrolls, *others = page.value("""(() => {
      const at = (e) => { const r = e.getBoundingClientRect(); return [r.left, r.right, r.top, r.bottom]; };
      const box = document.querySelector("#verdict > .flow > .tablebox"), table = box.querySelector("table");
      return [at(box), at(table), getComputedStyle(box).overflowX === "auto",
              ...[...document.querySelectorAll("#verdict > .flow > .items")].map(at)]; })()""")
    right = box[1] if scrolls else max(box[1], table[1])
    assert not any(a < right and b > box[0] and top < box[3] and bottom > box[2] for a, b, top, bottom in others)


@pytest.mark.parametrize("width", [400, 800, 1400])
def test_nothing_is_wider_than_the_screen_and_nothing_is_complained_of(page, drawn, width):
    page.complaints.clear()
    page.show(drawn, width)
    for fold in ("closed", "open"):
        if fold == "open":
            page.value("document.querySelector('#every-fold').click()")
            assert page.value("document.querySelectorAll('details:not([open])').length") == 0
        assert page.value("document.documentElement.scrollWidth") == page.value("window.innerWidth") == width, fold
        assert page.value(OUTSIDE) == [], fold
    assert page.complaints == []


def test_an_error_on_a_page_is_seen(page, tmp_path):
    """What the test above would find."""
    path = tmp_path / "bad.html"
    path.write_text("<main><p style='width: 900px'>wide</p></main>"
                    "<script>missing()</script><img src='http://0.0.0.0/a'>")
    page.complaints.clear()
    page.show(path, 400)
    assert page.value("document.documentElement.scrollWidth") > 400 and len(page.value(OUTSIDE)) == 1
    assert any("missing" in text for text in page.complaints)


def test_the_first_screen_is_for_who_decides(page, drawn):
    page.show(drawn, 1400, 1000)
    ends = page.value("""Object.fromEntries([["verdict", "#verdict .headline"], ["picture", "#verdict figure svg"],
      ["items", "#verdict .items li"]].map("""
                      "([k, s]) => [k, document.querySelector(s).getBoundingClientRect().bottom]))")
    assert all(0 < bottom <= 1000 for bottom in ends.values()), ends
    titles = page.value("""[...document.querySelectorAll("#verdict > .flow .items h3")].map((e) =>
      [e.innerText, e.getBoundingClientRect().bottom])""")
    assert [name for name, _ in titles] == ["What was found", "What to do", "What not to rely on"]
    assert all(bottom <= 1000 for _, bottom in titles)


def test_it_prints_every_figure_and_cuts_none(page, drawn):
    page.show(drawn, round(PAPER_PX[0]))
    pages = len(re.findall(rb"/Type\s*/Page(?![s\w])", page.pdf()))
    assert 10 <= pages <= 20
    page.print_style(True)
    try:
        sizes = page.value("""[...document.querySelectorAll("figure, .viewer, .tablebox")].map((e) => {
          const r = e.getBoundingClientRect(), s = getComputedStyle(e);
          return [e.className, r.right, r.height, s.breakInside, e.scrollWidth - e.clientWidth]; })""")
    finally:
        page.print_style(False)
    shown = [row for row in sizes if row[2] > 0]
    figures_printed = [row for row in shown if "tablebox" not in row[0] and "viewer" not in row[0]]
    assert len(figures_printed) == drawn.read_text(encoding="utf-8").count("<figure") > 10
    # two fit on a page, so that none leaves half of one empty
    assert all(height <= 0.5 * PAPER_PX[1] for _, _, height, _, _ in figures_printed)
    for name, right, height, inside, beyond in shown:
        assert right <= PAPER_PX[0] + 1 and beyond <= 1, name
        # a figure goes to one page and fits on it; tables may run over two
        assert "tablebox" in name or "half" in name or (inside == "avoid" and height <= PAPER_PX[1]), name


def test_every_figure_has_a_sentence_that_says_what_to_see(drawn):
    captions = re.findall(r"<figure.*?<figcaption>(.*?)</figcaption></figure>", drawn.read_text(encoding="utf-8"),
                          re.DOTALL)
    assert len(captions) > 10
    for caption in captions:
        assert len(caption) > 40 and caption.rstrip().endswith("."), caption
