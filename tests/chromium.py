"""A real headless Chromium, driven over its DevTools protocol, for tests of pages."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import ClientConnection, connect

_NAMES = ("chromium", "chromium-browser", "google-chrome")
EXECUTABLE = next(filter(None, map(shutil.which, _NAMES)), None)
needs_chromium = pytest.mark.skipif(
    EXECUTABLE is None, reason="no Chromium here (apt install chromium)"
)

_FLAGS = (
    "--headless", "--no-sandbox", "--no-first-run", "--no-default-browser-check",
    "--disable-quic", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--disable-extensions", "--hide-scrollbars", "--disable-dev-shm-usage",
    # WebGL in software, as on a machine without a graphics card.
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--remote-debugging-port=0",
)  # fmt: skip
_PATIENCE = 60.0


@dataclass
class Tab:
    """A page as Chromium shows it, with all that it asked for and complained about.

    Attributes:
        errors: what went wrong: exceptions, and errors on the console.
        requests: addresses the page asked for, itself included.
    """

    socket: ClientConnection
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
    _last: int = 0

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Call a method of the protocol; events that come meanwhile are noted."""
        self._last += 1
        self.socket.send(json.dumps({"id": self._last, "method": method, "params": params}))
        while True:
            message = json.loads(self.socket.recv(timeout=_PATIENCE))
            if message.get("id") == self._last:
                assert "error" not in message, message
                return dict(message["result"])
            self._note(message)

    def run(self, script: str) -> Any:
        """The value of a JavaScript expression, once it is settled."""
        found = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait_for(self, condition: str) -> float:
        """Wait until a JavaScript expression is true; how long that took [s]."""
        begin = time.perf_counter()
        while not self.run(condition):
            assert time.perf_counter() - begin < _PATIENCE, (condition, self.errors)
            time.sleep(0.02)
        return time.perf_counter() - begin

    def screenshot(self, path: Path, *, whole: bool = False) -> bytes:
        """A picture (PNG) of what the window shows, or of the whole page."""
        found = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        picture = base64.b64decode(found["data"])
        path.write_bytes(picture)
        return picture

    def _note(self, event: dict[str, Any]) -> None:
        params = event.get("params", {})
        match event.get("method"):
            case "Network.requestWillBeSent":
                self.requests.append(params["request"]["url"])
            case "Network.webSocketCreated":
                self.requests.append(params["url"])
            case "Runtime.exceptionThrown":
                self.errors.append(str(params["exceptionDetails"]))
            case "Runtime.consoleAPICalled" if params["type"] in ("error", "assert"):
                self.errors.append(str([a.get("value", a) for a in params["args"]]))
            case "Log.entryAdded" if params["entry"]["level"] == "error":
                self.errors.append(str(params["entry"]))


def resize(tab: Tab, width: int, height: int = 900) -> None:
    """Give the window another size [px]; a narrow one is that of a phone."""
    tab.call(
        "Emulation.setDeviceMetricsOverride",
        width=width, height=height, deviceScaleFactor=1, mobile=width < 600,
    )  # fmt: skip


@contextmanager
def opened(address: str, width: int = 1280, height: int = 900) -> Iterator[Tab]:
    """Open a page in a window of its own; the browser ends with the block.

    Args:
        address: of the page, ``file://`` or ``http://``.
        width: of the window [px].
        height: of the window [px].
    """
    assert EXECUTABLE is not None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        browser = subprocess.Popen(  # noqa: S603 - flags of our own
            [EXECUTABLE, *_FLAGS, f"--user-data-dir={profile}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            with connect(_debugger(Path(profile)), max_size=None) as socket:
                tab = Tab(socket)
                for domain in ("Page", "Runtime", "Network", "Log"):
                    tab.call(f"{domain}.enable")
                resize(tab, width, height)
                tab.call("Page.navigate", url=address)
                yield tab
        finally:
            browser.kill()
            browser.wait()


def _debugger(profile: Path) -> str:
    """Address of the debugger of the browser's only tab, once it listens."""
    begin = time.perf_counter()
    port = profile / "DevToolsActivePort"
    while time.perf_counter() - begin < _PATIENCE:
        try:
            number = port.read_text().splitlines()[0]
            with urllib.request.urlopen(f"http://127.0.0.1:{number}/json/list") as answer:
                pages = [t for t in json.load(answer) if t["type"] == "page"]
            return str(pages[0]["webSocketDebuggerUrl"])
        except (OSError, IndexError, ValueError):
            time.sleep(0.02)
    raise TimeoutError("Chromium does not start")
