"""Chromium without a window, driven over its own protocol: what a page's script did, and how it looks at a size."""

import base64
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import ClientConnection, connect

CHROMIUM = next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None)
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--use-gl=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-first-run",
)
PATIENCE = 30.0  # s
SPILT = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
TOP = "document.querySelector('{}').getBoundingClientRect().top"
GROUND = "getComputedStyle(document.body).backgroundColor"
CONTRAST = 4.5  # WCAG 2.2, AA: of words against their ground
FAINT = """(least => {
  const rgb = text => text.match(/[\\d.]+/g).map(Number);
  const light = colour => colour.slice(0, 3).map(v => v / 255).map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
  const ground = e => { for (; e; e = e.parentElement) {
    const c = rgb(getComputedStyle(e).backgroundColor); if (c.length < 4 || c[3] > 0.8) return c; } return [255, 255, 255]; };
  const words = [...document.querySelectorAll("body *")].filter(e => e.getClientRects().length
    && !e.closest(".skip, [hidden], option") && [...e.childNodes].some(n => n.nodeType === 3 && n.data.trim()));
  return words.filter(e => { const style = getComputedStyle(e), ink = e.closest("svg") ? style.fill : style.color;
    if (!ink.startsWith("rgb")) return false;
    const [a, b] = [light(rgb(ink)), light(ground(e))].sort((x, y) => y - x);
    return (a + 0.05) / (b + 0.05) < least; }).map(e => e.outerHTML.slice(0, 90)).slice(0, 3);
})"""


@dataclass
class Page:
    """One tab: `faults` are errors of its scripts and of its console."""

    socket: ClientConnection
    sent: int = 0
    faults: list[str] = field(default_factory=list)

    def call(self, method: str, **parameters: Any) -> Any:
        self.sent += 1
        number = self.sent
        self.socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            told = json.loads(self.socket.recv(timeout=PATIENCE))
            if told.get("method") == "Runtime.exceptionThrown":
                self.faults.append(told["params"]["exceptionDetails"]["exception"].get("description", "error"))
            if told.get("method") == "Log.entryAdded" and told["params"]["entry"]["level"] == "error":
                self.faults.append(told["params"]["entry"]["text"])
            if told.get("id") == number:
                assert "error" not in told, told["error"]
                return told["result"]

    def run(self, script: str) -> Any:
        """Value of an expression on the page; promises are waited for."""
        told = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in told, told
        return told["result"].get("value")

    def open(self, file: Path, width: int, height: int = 900, dark: bool = False) -> None:
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.call("Emulation.setEmulatedMedia", features=scheme)
        self.call("Page.navigate", url=file.resolve().as_uri())
        until = time.monotonic() + PATIENCE
        while self.run("document.readyState") != "complete" and time.monotonic() < until:
            time.sleep(0.05)
        self.drawn()

    def drawn(self) -> None:
        """Wait until two frames have been drawn."""
        self.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def printed(self) -> bytes:
        """The page on paper, as PDF."""
        return base64.b64decode(self.call("Page.printToPDF", printBackground=True)["data"])

    def seen(self) -> bytes:
        """The window's picture, as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot")["data"])


@contextmanager
def browser() -> Iterator[Page]:
    """A tab of a browser that ends with the block."""
    assert CHROMIUM is not None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        call = [CHROMIUM, *FLAGS, f"--user-data-dir={profile}", "--remote-debugging-port=0", "about:blank"]
        process = subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        try:
            assert process.stderr is not None
            address = next(line.split()[-1] for line in process.stderr if line.startswith("DevTools listening on"))
            with connect(address, max_size=None) as whole:
                root = Page(whole)
                target = root.call("Target.createTarget", url="about:blank")["targetId"]
            tab = f"{address.split('/devtools/')[0]}/devtools/page/{target}"
            with connect(tab, max_size=None) as socket:
                page = Page(socket)
                for domain in ("Page", "Runtime", "Log"):
                    page.call(f"{domain}.enable")
                yield page
        finally:
            process.kill()
            process.communicate()


NEEDED = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here (Debian: apt install chromium)")


def looked_at(file: Path, figure: int | None = 1000) -> None:
    """A written page as a reader meets it: no error of a script or of the console, nothing wider than the window on a phone's, a
    laptop's and a desk's screen, dark in a dark system, its words legible in both, the verdict first and the first figure within
    `figure` px (None: it has none), links that lead to a section each, pages on paper."""
    with browser() as page:
        for width, dark in ((400, False), (1280, True), (1920, False)):
            page.open(file, width, dark=dark)
            assert page.run(SPILT) <= 0, f"{width} px"
            assert page.run(GROUND) == ("rgb(20, 25, 31)" if dark else "rgb(255, 255, 255)")
            assert page.run(f"{FAINT}({CONTRAST})") == []
        assert 0 < page.run(TOP.format(".verdict")) < 400
        assert figure is None or page.run(TOP.format("canvas, figure")) < figure
        assert page.run("[...document.querySelectorAll('nav a')].every(a => document.querySelector(a.getAttribute('href')))")
        assert page.printed().startswith(b"%PDF")
        assert page.faults == []
