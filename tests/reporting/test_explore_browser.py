"""The page of `explore` in a browser: modes of a known frame picked and a machine's pole rejected, by mouse and by
keyboard, wide and narrow; the file that is saved is what `identify --choice` makes modes of."""

from __future__ import annotations

import base64
import json
import re

import numpy as np
import pytest
from browser import BROWSER, browser
from known_frame import MACHINE_HZ, modes, write_campaign

import probupdate
from probupdate.cli import main
from probupdate.modal.modes import mac, read_modes

pytestmark = pytest.mark.skipif(BROWSER is None, reason="no headless browser: install chromium")

ORDER = 20
# poles of an order that the page shows: [number, frequency, whether it is picked]
POLES = """[...document.querySelectorAll(".pole")].map((g) => [Number(g.dataset.pole), g.getAttribute("aria-label"),
  g.getAttribute("aria-pressed")]).filter((p) => p[1].includes("order ORDER,"))""".replace("ORDER", str(ORDER))
FOCUSED = 'document.activeElement.getAttribute("aria-label") || ""'


@pytest.fixture(scope="module")
def frame(tmp_path_factory):
    """The campaign, the page of one of its blocks, and the store of its poles."""
    folder = tmp_path_factory.mktemp("frame")
    campaign = write_campaign(folder / "campaign")
    found = probupdate.explore(campaign, folder / "page.html")
    assert found.shown == found.blocks == 1
    return campaign, folder / "page.html"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    with browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


def hertz(label: str) -> float:
    return float(re.match(r"[\d.]+", label)[0])


def nearest(page, frequency_hz: float) -> int:
    return min(page.value(POLES), key=lambda p: abs(hertz(p[1]) - frequency_hz))[0]


def by_mouse(page) -> None:
    for f in modes()[0]:
        page.click(f'[data-pole="{nearest(page, f)}"]')
    page.value('document.querySelector("[aria-label=\\"reason for rejecting\\"]").focus()')
    page.value('document.execCommand("insertText", false, "machine")')
    page.click('[data-click="rejected"]')
    page.click(f'[data-pole="{nearest(page, MACHINE_HZ)}"]')


def by_keys(page) -> None:
    """From the page's beginning by tab to the diagram, over its poles by arrows."""
    for _ in range(40):
        page.press("Tab")
        if "order" in page.value(FOCUSED):
            break
    while f"order {ORDER}," not in (label := page.value(FOCUSED)):
        page.press("ArrowUp" if int(re.search(r"order (\d+)", label)[1]) < ORDER else "ArrowDown")
    for f, key in sorted([*((f, "Enter") for f in modes()[0]), (MACHINE_HZ, "Delete")]):
        wanted = min(page.value(POLES), key=lambda p: abs(hertz(p[1]) - f))[1]
        for _ in range(60):
            here = page.value(FOCUSED)
            if here == wanted:
                break
            page.press("ArrowRight" if hertz(here) < hertz(wanted) else "ArrowLeft")
        assert page.value(FOCUSED) == wanted
        # what has the focus is seen
        ring = 'getComputedStyle(document.activeElement.querySelector(".ring")).stroke'
        assert page.value(ring) == "rgb(0, 114, 178)"
        page.press(key)
        assert ("picked" if key == "Enter" else "rejected") in page.value(FOCUSED)


@pytest.mark.parametrize("width", [1400, 400])
@pytest.mark.parametrize("act", [by_mouse, by_keys])
def test_picked_poles_are_the_modes_that_identify_writes(page, frame, tmp_path, act, width, capsys):
    campaign, path = frame
    page.complaints.clear()
    page.show(path, width)
    act(page)
    (tmp_path / "saved").mkdir()
    choice = page.saved(tmp_path / "saved", '[data-explore="save"]')
    assert page.complaints == []
    assert page.value("document.documentElement.scrollWidth <= window.innerWidth")
    content = json.loads(choice.read_text())
    assert main(["identify", str(campaign), "--choice", str(choice), "--out", str(tmp_path / "modes.json")]) == 0
    said = capsys.readouterr().out
    assert "4 poles in 1 block, 1 rejected" in said and ("order 20, machine" in said) == (act is by_mouse)
    found = read_modes(tmp_path / "modes.json")
    frequency, shape = modes()
    (one,) = found.sets
    # exactly these
    np.testing.assert_allclose(one.frequency_hz, [p["frequency_hz"] for p in content["picked"]], rtol=1e-10)
    assert np.all(np.abs(one.frequency_hz - frequency) < 4 * one.frequency_std_hz)
    assert np.all(np.diag(mac(one.shape, shape)) > 0.99)
    assert len(found.choice.picked) == 4
    assert found.choice.rejected[0].frequency_hz == pytest.approx(MACHINE_HZ, rel=0.01)


def test_a_pole_of_another_order_takes_the_place_of_its_mode_s(page, frame):
    page.show(frame[1], 1400)
    first = nearest(page, modes()[0][0])
    page.click(f'[data-pole="{first}"]')
    page.press("ArrowUp")
    page.press("Enter")
    assert page.value('document.querySelectorAll(".pole[aria-pressed=true]").length') == 1
    assert "in place of order 20" in page.value('document.querySelector("[data-explore=message]").textContent')
    # again takes it back, and there is nothing to save then
    page.press("Enter")
    assert page.value('document.querySelector("[data-explore=save]").getAttribute("href")') is None


def test_what_was_chosen_before_is_there_to_be_revised(page, frame, tmp_path):
    campaign, path = frame
    page.show(path, 1400)
    by_mouse(page)
    (tmp_path / "saved").mkdir()
    choice = page.saved(tmp_path / "saved", '[data-explore="save"]')
    run = tmp_path / "run"
    probupdate.identify(campaign, choice=choice, store=run / "modes.json.blocks").write(run / "modes.json")
    again = probupdate.explore(run, tmp_path / "again.html").path
    page.show(again, 1400)
    (tmp_path / "again").mkdir()
    assert json.loads(page.saved(tmp_path / "again", '[data-explore="save"]').read_text()) == json.loads(
        choice.read_text())


def test_mac_and_argand_of_the_picked_modes_are_drawn(page, frame):
    page.show(frame[1], 1400)
    page.click("#pick-proposed")
    n = page.value('document.querySelectorAll(".pole[aria-pressed=true]").length')
    cells = page.value('[...document.querySelectorAll("table.mac td")].map((c) => Number(c.textContent))')
    picked = page.value('[...document.querySelectorAll(".pole[aria-pressed=true]")].map((g) => Number(g.dataset.pole))')
    data = json.loads(page.value('document.getElementById("explore-data").textContent'))["blocks"][0]
    parts = np.frombuffer(base64.b64decode(data["shape"]), "<i2").reshape(-1, 4, 2).astype(float)
    shape = (parts[..., 0] + 1j * parts[..., 1])[sorted(picked, key=lambda k: data["hz"][k])].T
    assert n >= 4 and np.allclose(np.reshape(cells, (n, n)), mac(shape, shape), atol=0.006)
    assert page.value('document.querySelectorAll("[data-explore=argand] svg").length') == n
    assert "Hz" in page.value('document.querySelector(".viewer .foot").textContent')


def test_values_of_a_pole_stand_beside_the_mouse(page, frame):
    page.show(frame[1], 400)
    page.click('[data-click="look"]')
    page.click(f'[data-pole="{nearest(page, modes()[0][1])}"]')
    said = page.value('document.querySelector(".tip").innerText')
    assert re.match(r"4\.7\d+ ± 0\.00\d+ Hz\ndamping 1\.\d+ ± 0\.\d+ %\norder 20, MPC 1\.000\n", said)
    assert page.value('document.querySelectorAll(".pole[aria-pressed=true]").length') == 0
    box = page.value('(({left, right}) => [left, right])(document.querySelector(".tip").getBoundingClientRect())')
    assert 0 <= box[0] < box[1] <= 400
