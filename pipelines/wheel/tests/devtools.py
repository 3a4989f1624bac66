"""Drives Chromium through its DevTools protocol."""

from __future__ import annotations

import asyncio
import base64
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import aiohttp

BROWSER = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
)
OPTIONS = [
    "--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars",
    "--disable-dev-shm-usage", "--remote-debugging-port=0", "--no-first-run", "--disable-background-networking",
]  # fmt: skip


class Browser:
    """One page in a browser; use it as a context manager."""

    def __init__(self, folder: Path, width: int = 1440, height: int = 900) -> None:
        assert BROWSER is not None
        self.loop = asyncio.new_event_loop()
        self.console: list[str] = []
        self._number = 0
        self._size = (width, height)
        words = [BROWSER, *OPTIONS, f"--window-size={width},{height}", f"--user-data-dir={folder}", "about:blank"]
        self._process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
        assert self._process.stderr is not None
        for line in self._process.stderr:
            if "DevTools listening on " in line:
                port = line.split("ws://")[1].split("/")[0].split(":")[1].strip()
                break
        self.loop.run_until_complete(self._connect(int(port)))

    async def _connect(self, port: int) -> None:
        self._session = aiohttp.ClientSession()
        async with self._session.get(f"http://127.0.0.1:{port}/json/list") as answer:
            target = next(one for one in await answer.json() if one["type"] == "page")
        self._socket = await self._session.ws_connect(target["webSocketDebuggerUrl"], max_msg_size=0)
        for domain in ("Page", "Runtime", "Log"):
            await self._call(f"{domain}.enable")
        width, height = self._size
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        await self._call("Emulation.setDeviceMetricsOverride", **metrics)

    async def _call(self, method: str, **parameters: Any) -> Any:
        self._number += 1
        number = self._number
        await self._socket.send_json({"id": number, "method": method, "params": parameters})
        while True:
            answer = await self._socket.receive_json(timeout=60)
            self._listen(answer)
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]

    def _listen(self, answer: dict[str, Any]) -> None:
        """Record the messages on the console."""
        method, about = answer.get("method"), answer.get("params", {})
        if method == "Runtime.consoleAPICalled":
            text = " ".join(str(one.get("value", one.get("description"))) for one in about["args"])
            self.console.append(f"{about['type']}: {text}")
        elif method == "Runtime.exceptionThrown":
            details = about["exceptionDetails"]
            self.console.append(f"exception: {details.get('exception', {}).get('description', details['text'])}")
        elif method == "Log.entryAdded":
            entry = about["entry"]
            # the software renderer of the tests is slow to read pixels back
            if "GPU stall due to ReadPixels" not in entry["text"]:
                self.console.append(f"{entry['level']}: {entry['text']}")

    def call(self, method: str, **parameters: Any) -> Any:
        """Call a method of the protocol."""
        return self.loop.run_until_complete(self._call(method, **parameters))

    def open(self, address: str) -> None:
        """Open a page."""
        self.call("Page.navigate", url=address)

    def evaluate(self, script: str) -> Any:
        """Evaluate an expression, and return its value."""
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def wait(self, script: str, seconds: float = 30.0) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if self.evaluate(f"!!({script})"):
                return
            time.sleep(0.05)
        raise TimeoutError(f"{script}; console: {self.console}")

    def click(self, selector: str, x: float = 0.5, y: float = 0.5) -> None:
        """Click on an element, at a share of its width and height."""
        at = self.evaluate(
            f"(r => [r.left + {x} * r.width, r.top + {y} * r.height])"
            f"((e => (e.scrollIntoView({{block: 'nearest'}}), e.getBoundingClientRect()))({selector}))"
        )
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            button = {"button": "left", "clickCount": 1} if kind != "mouseMoved" else {}
            self.call("Input.dispatchMouseEvent", type=kind, x=at[0], y=at[1], **button)

    def set(self, selector: str, value: float) -> None:
        """Set the value of an input, as a slider does."""
        self.evaluate(f"(e => {{ e.value = {value}; e.dispatchEvent(new Event('input')) }})({selector})")

    def press(self, key: str) -> None:
        """Press a key in the focused element."""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key)

    def screenshot(self, path: Path) -> None:
        """Write a picture of the page."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))

    def close(self) -> None:
        """End the browser."""
        self.loop.run_until_complete(self._socket.close())
        self.loop.run_until_complete(self._session.close())
        self.loop.close()
        self._process.terminate()
        self._process.wait(20)

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def button(text: str) -> str:
    """Return the expression of the button with a text."""
    return f"[...document.querySelectorAll('button')].find(b => b.textContent.trim().startsWith({text!r}))"
