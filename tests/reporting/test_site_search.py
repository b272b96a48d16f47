"""The site's search from disk: a browser starts no worker from a file; one in a hidden frame takes its place."""

import shutil
from pathlib import Path

import pytest
from browser import BROWSER, browser

WORKER = Path(__file__).resolve().parents[2] / "docs" / "assets" / "iframe-worker.js"
ANSWERS = "addEventListener('message', (event) => postMessage(2 * event.data));"
ASKS = """new Promise((resolve) => {
  const worker = new Worker("answers.js");
  worker.addEventListener("message", (event) => resolve(event.data));
  worker.postMessage(21);
}).catch(() => "refused")"""


@pytest.mark.skipif(BROWSER is None, reason="no headless browser: install chromium")
@pytest.mark.parametrize(("head", "answer"), [("", "refused"), ("<script src=worker.js></script>", 42)])
def test_a_worker_answers_on_a_page_from_disk(head, answer, tmp_path):
    shutil.copy(WORKER, tmp_path / "worker.js")
    (tmp_path / "answers.js").write_text(ANSWERS)
    (tmp_path / "page.html").write_text(f"<html><head>{head}</head><body></body></html>")
    with browser(tmp_path / "profile") as page:
        page.show(tmp_path / "page.html", width=800)
        assert page.value(ASKS) == answer
