"""A headless browser driven through its own protocol over a pipe: a page at any width, what it logs, its print."""

from __future__ import annotations

import base64
import json
import os
import selectors
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
SECONDS = 60.0
# the browser reads commands from descriptor 3 and answers on 4, wherever the pipes are
LAUNCH = """import os, sys
ends = [os.dup(int(text)) for text in sys.argv[1:3]]
while min(ends) < 5:
    ends = [os.dup(end) for end in ends]
for number, end in zip((3, 4), ends):
    os.dup2(end, number)
os.execv(sys.argv[3], sys.argv[3:])"""


class Page:
    """One page; `complaints`: errors that it logged or threw, in order."""

    def __init__(self, to_browser: int, from_browser: int):
        self._out, self._in, self._rest, self._number = to_browser, from_browser, b"", 0
        self.complaints: list[str] = []
        self._loaded = False
        target = self._ask("Target.createTarget", session=None, url="about:blank")["targetId"]
        self._session = self._ask("Target.attachToTarget", session=None, targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self._ask(f"{domain}.enable")

    def show(self, path: Path, width: int, height: int = 900) -> None:
        """Load the file on a screen of that size."""
        self._ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        self._loaded = False
        self._ask("Page.navigate", url=path.as_uri())
        while not self._loaded:
            self._message()

    def value(self, script: str) -> object:
        """What a JavaScript expression, or a promise of one, gives."""
        found = self._ask("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def print_style(self, on: bool) -> None:
        """Lay the page out as for paper."""
        self._ask("Emulation.setEmulatedMedia", media="print" if on else "")

    def click(self, selector: str, shift: bool = False) -> None:
        """A click of the mouse in the middle of the first element, scrolled to."""
        where = self.value(f"(() => {{ const e = document.querySelector({json.dumps(selector)}); "
                           "e.scrollIntoView({block: 'center', behavior: 'instant'}); "
                           "const r = e.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; })()")
        assert isinstance(where, list)
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            self._ask("Input.dispatchMouseEvent", type=kind, x=where[0], y=where[1], button="left", clickCount=1,
                      modifiers=8 if shift else 0)

    def press(self, key: str) -> None:
        """A key of the keyboard by its name: Tab, Enter, Delete, ArrowLeft, ..."""
        code = {"Tab": 9, "Enter": 13, "Delete": 46, "ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39,
                "ArrowDown": 40}[key]
        text = {"text": "\r"} if key == "Enter" else {}
        for kind in ("keyDown", "keyUp"):
            self._ask("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code, **text)

    def saved(self, folder: Path, selector: str) -> Path:
        """The file that a click on a link saves into an empty folder."""
        self._ask("Browser.setDownloadBehavior", session=None, behavior="allow", downloadPath=str(folder))
        self.click(selector)
        end = time.monotonic() + SECONDS
        while not (found := [p for p in folder.iterdir() if p.suffix != ".crdownload"]):
            assert time.monotonic() < end, "nothing was saved"
            time.sleep(0.05)
        return found[0]

    def picture(self, path: Path) -> None:
        """A PNG of what the screen shows."""
        path.write_bytes(base64.b64decode(self._ask("Page.captureScreenshot", format="png")["data"]))

    def pdf(self) -> bytes:
        """The page as it prints, on the paper that its style asks for."""
        return base64.b64decode(self._ask("Page.printToPDF", preferCSSPageSize=True, printBackground=True)["data"])

    def _ask(self, method: str, session: str | None = "", **parameters: object) -> dict:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if session is not None:
            message["sessionId"] = self._session
        content = json.dumps(message).encode() + b"\0"
        while content:
            content = content[os.write(self._out, content) :]
        while True:
            answer = self._message()
            if answer.get("id") == self._number:
                assert "error" not in answer, (method, answer)
                return answer["result"]

    def _message(self) -> dict:
        end = time.monotonic() + SECONDS
        with selectors.DefaultSelector() as waiting:
            waiting.register(self._in, selectors.EVENT_READ)
            while b"\0" not in self._rest:
                assert waiting.select(max(end - time.monotonic(), 0)), "the browser does not answer"
                piece = os.read(self._in, 2**20)
                assert piece, "the browser has ended"
                self._rest += piece
        text, self._rest = self._rest.split(b"\0", 1)
        message = json.loads(text)
        method, content = message.get("method"), message.get("params", {})
        if method == "Page.loadEventFired":
            self._loaded = True
        elif method == "Runtime.exceptionThrown":
            self.complaints.append(str(content["exceptionDetails"].get("exception", content)))
        elif method == "Runtime.consoleAPICalled" and content["type"] in ("error", "warning", "assert"):
            self.complaints.append(str(content["args"]))
        elif method == "Log.entryAdded" and content["entry"]["level"] in ("error", "warning"):
            self.complaints.append(content["entry"]["text"])
        return message


@contextmanager
def browser(profile: Path) -> Iterator[Page]:
    """A browser of its own, ended with the block."""
    read_in, write_in = os.pipe()
    read_out, write_out = os.pipe()
    command = [sys.executable, "-c", LAUNCH, str(read_in), str(write_out), BROWSER, "--headless", "--no-sandbox",
               "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={profile}", "--remote-debugging-pipe"]
    child = subprocess.Popen(command, pass_fds=(read_in, write_out), stdout=subprocess.DEVNULL,
                             stderr=subprocess.DEVNULL)
    os.close(read_in)
    os.close(write_out)
    try:
        yield Page(write_in, read_out)
    finally:
        os.close(write_in)
        child.kill()
        child.wait()
        os.close(read_out)
