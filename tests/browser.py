"""A headless Chromium spoken to through two pipes, with the DevTools protocol and nothing else."""

from __future__ import annotations

import atexit
import base64
import functools
import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

FOUND = next(
    (
        path
        for name in ("chromium", "chromium-browser", "google-chrome")
        if (path := shutil.which(name))
    ),
    None,
)
"""The program, where one is installed."""


class _Program:
    """The browser of a test process: it takes half a second to start."""

    def __init__(self) -> None:
        assert FOUND is not None
        to_browser, self._out = os.pipe()
        self._in, from_browser = os.pipe()
        folder = tempfile.mkdtemp(prefix="browser")

        # The browser reads at 3 and writes at 4.
        pipes = f"3</proc/self/fd/{to_browser} 4>/proc/self/fd/{from_browser}"
        command = [
            "sh", "-c", f'exec "$@" {pipes}', "sh",
            FOUND, "--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe",
            "--disable-dev-shm-usage", f"--user-data-dir={folder}", "about:blank",
        ]  # fmt: skip
        process = subprocess.Popen(
            command, pass_fds=(to_browser, from_browser), stderr=subprocess.DEVNULL
        )
        os.close(to_browser)
        os.close(from_browser)
        self._left, self._count = b"", 0
        self.said: dict[str, list[str]] = {}

        @atexit.register
        def stop() -> None:
            process.kill()
            process.wait()
            shutil.rmtree(folder, ignore_errors=True)

    def do(self, session: str, method: str, **parameters: Any) -> dict[str, Any]:
        """Ask a page, or without a session the browser, and return the answer."""
        self._count += 1
        message: dict[str, Any] = {"id": self._count, "method": method, "params": parameters}
        if session:
            message["sessionId"] = session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self.next()
            if answer.get("id") == self._count:
                assert "error" not in answer, answer
                return dict(answer["result"])

    def next(self) -> dict[str, Any]:
        """Return the next message, and note it if it is one of a page's console."""
        while b"\0" not in self._left:
            part = os.read(self._in, 1 << 16)
            assert part, "the browser has ended"
            self._left += part
        text, _, self._left = self._left.partition(b"\0")
        message = dict(json.loads(text))
        if message.get("method") in (
            "Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded",
        ):  # fmt: skip
            self.said[message["sessionId"]].append(json.dumps(message["params"])[:500])
        return message


_program = functools.cache(_Program)


class Browser:
    """One page in a window and a profile of its own.

    Attributes
    ----------
    said : list of str
        What the page wrote to its console, errors too.
    """

    def __init__(self, width: int = 1200, height: int = 1000, dark: bool = False) -> None:
        self._program, self._session = _program(), ""
        self._profile = self.do("Target.createBrowserContext")
        page = self.do("Target.createTarget", url="about:blank", **self._profile)
        self._session = self.do("Target.attachToTarget", **page, flatten=True)["sessionId"]
        self.said = self._program.said[self._session] = []
        for domain in ("Page", "Runtime", "Log"):
            self.do(f"{domain}.enable")
        self.do("Page.setLifecycleEventsEnabled", enabled=True)
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.do("Emulation.setDeviceMetricsOverride", **size)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.do("Emulation.setEmulatedMedia", features=[scheme])

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self._session = ""
        self.do("Target.disposeBrowserContext", **self._profile)

    def do(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Ask for something and return the answer."""
        return self._program.do(self._session, method, **parameters)

    def open(self, path: Path) -> None:
        """Open a file and wait until it is there."""
        page = self.do("Page.navigate", url=path.resolve().as_uri())
        loaded = {"frameId": page["frameId"], "loaderId": page["loaderId"], "name": "load"}
        while True:
            message = self._program.next()
            found = message.get("params", {}).items()
            if message.get("sessionId") == self._session and loaded.items() <= found:
                return

    def value(self, script: str) -> Any:
        """Return the value of an expression in the page; promises are awaited."""
        found = self.do(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def click(self, selector: str) -> None:
        """Click the middle of an element as a mouse does."""
        x, y = self.value(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
            "e.scrollIntoView({block: 'center'}); const b = e.getBoundingClientRect();"
            "return [b.x + b.width / 2, b.y + b.height / 2]; })()"
        )
        self.press(x, y)

    def press(self, x: float, y: float, to: tuple[float, float] | None = None) -> None:
        """Press the mouse at a place, drag it to another, and let go."""
        button = {"button": "left", "clickCount": 1}
        self.do("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, **button)
        x, y = to or (x, y)
        self.do("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, button="left", buttons=1)
        self.do("Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y, **button)

    def screenshot(self, path: Path) -> None:
        """Write a screenshot of the whole page as a PNG."""
        shot = self.do("Page.captureScreenshot", captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(shot["data"]))
