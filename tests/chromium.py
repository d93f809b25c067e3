"""A real browser for tests of pages: headless Chromium through its DevTools pipe."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import tempfile


class Chromium:
    """One tab. Its ``faults`` are exceptions, errors on the console and requests for anything but a file or data."""

    def __init__(self):
        found = map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))
        program = next(filter(None, found), None)
        assert program, "Chromium is missing: scripts/test installs it (apt-get install chromium)"
        self.faults, self._last, self._rest, self._loaded = [], 0, b"", set()
        self._home = tempfile.mkdtemp(prefix="fracflow-chromium-")
        theirs, self._to = os.pipe()
        self._from, ours = os.pipe()
        words = (
            "--headless=new --no-sandbox --disable-gpu --hide-scrollbars --no-first-run --disable-background-networking"
        )
        command = [program, *words.split(), f"--user-data-dir={self._home}", "--remote-debugging-pipe", "about:blank"]
        shell = ["bash", "-c", f'exec "$@" 3<&{theirs} 4>&{ours}', "bash", *command]
        self._log = open(os.path.join(self._home, "log"), "wb")
        self._process = subprocess.Popen(shell, pass_fds=(theirs, ours), stdout=self._log, stderr=self._log)
        os.close(theirs)
        os.close(ours)
        target = next(t for t in self.call("Target.getTargets")["targetInfos"] if t["type"] == "page")
        about = {"targetId": target["targetId"], "flatten": True}
        self._session = self.call("Target.attachToTarget", **about)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.call("Page.setLifecycleEventsEnabled", enabled=True)

    _session = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._session = None
        self.call("Browser.close")
        self._process.wait(20)
        os.close(self._to)
        os.close(self._from)
        self._log.close()
        shutil.rmtree(self._home, ignore_errors=True)

    def call(self, method, **params):
        """A command of the DevTools protocol, and its result."""
        self._last += 1
        message = {"id": self._last, "method": method, "params": params}
        message |= {"sessionId": self._session} if self._session else {}
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            found = self._read()
            if found.get("id") == self._last:
                assert "error" not in found, (method, found["error"])
                return found["result"]

    def _read(self):
        while b"\0" not in self._rest:
            part = os.read(self._from, 1 << 20)
            assert part, "Chromium ended: " + open(self._log.name).read()[-2000:]
            self._rest += part
        line, _, self._rest = self._rest.partition(b"\0")
        found = json.loads(line)
        params = found.get("params", {})
        if found.get("method") == "Runtime.exceptionThrown":
            self.faults.append(str(params["exceptionDetails"]))
        if found.get("method") == "Runtime.consoleAPICalled" and params["type"] in ("error", "warning", "assert"):
            self.faults.append(str(params["args"]))
        if found.get("method") == "Log.entryAdded" and params["entry"]["level"] in ("error", "warning"):
            self.faults.append(params["entry"]["text"])
        if found.get("method") == "Page.lifecycleEvent" and params["name"] == "load":
            self._loaded.add(params["loaderId"])
        if found.get("method") == "Network.requestWillBeSent":
            url = params["request"]["url"]
            self.faults += [] if url.startswith(("file:", "data:", "about:")) else [f"asked for {url}"]
        return found

    def open(self, path, width=1280, height=900, scale=1):
        """Show a file, at a width of the window."""
        metrics = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": width < 600}
        self.call("Emulation.setDeviceMetricsOverride", **metrics)
        document = self.call("Page.navigate", url=f"file://{os.path.abspath(path)}")
        assert "errorText" not in document, document
        while (
            "loaderId" in document and document["loaderId"] not in self._loaded
        ):  # its scripts run in a page that stays
            self._read()
        return self

    def follow(self, link):
        """Click a link, by its selector, that leads to another document, and await it."""
        before = len(self._loaded)
        self.value(f"document.querySelector({json.dumps(link)}).click(); 0")
        while len(self._loaded) == before:
            self._read()
        return self

    def value(self, script):
        """Value of a JavaScript expression."""
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def press(self, key, times=1):
        """Press a key, of what has the focus."""
        for _ in range(times):
            for kind in ("keyDown", "keyUp"):
                self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=KEYS[key])

    def picture(self, path, selector="html"):
        """Write a PNG of an element."""
        box = self.value(f"(() => {{ const b = document.querySelector({json.dumps(selector)}).getBoundingClientRect();"
                         " return [b.left + scrollX, b.top + scrollY, b.width, b.height]; })()")  # fmt: skip
        clip = dict(zip(("x", "y", "width", "height"), box, strict=True), scale=1)
        found = self.call("Page.captureScreenshot", clip=clip, captureBeyondViewport=True)
        with open(path, "wb") as file:
            file.write(base64.b64decode(found["data"]))


KEYS = {"ArrowLeft": 37, "ArrowRight": 39, "Home": 36, "End": 35}
