"""A headless Chromium, driven over a pipe in its DevTools protocol: no package is needed."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
LIMIT = 120.0  # seconds that an answer may take

# Chromium reads commands from file 3 and writes answers to file 4.
_AS_3_AND_4 = """
import fcntl, os, sys
ends = [fcntl.fcntl(int(one), fcntl.F_DUPFD, 10) for one in sys.argv[1:3]]
for one, number in zip(ends, (3, 4)):
    os.dup2(one, number)
    os.close(one)
os.execv(sys.argv[3], sys.argv[3:])
"""


class Browser:
    """One page of one browser."""

    def __init__(self, process, reading, writing):
        self.process, self.reading, self.writing = process, reading, writing
        self.count, self.session, self.rest = 0, None, b""
        self.events = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)[
            "sessionId"
        ]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method, **params):
        """What the browser answers; what it reports meanwhile is kept in `events`."""
        self.count += 1
        asked = {"id": self.count, "method": method, "params": params}
        if self.session:
            asked["sessionId"] = self.session
        os.write(self.writing, json.dumps(asked).encode() + b"\0")
        while (said := self._message()).get("id") != self.count:
            self.events.append(said)
        assert "error" not in said, said["error"]
        return said["result"]

    def _message(self):
        while b"\0" not in self.rest:
            if not select.select([self.reading], [], [], LIMIT)[0]:
                raise TimeoutError(f"no answer of the browser in {LIMIT:g} s")
            got = os.read(self.reading, 1 << 20)
            if not got:
                raise EOFError(f"the browser ended with {self.process.wait()}")
            self.rest += got
        line, _, self.rest = self.rest.partition(b"\0")
        return json.loads(line)

    def open(self, url, *, width=1280, height=900, dark=False):
        """Show a page in a window of `width` pixels, and wait until it is drawn."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", media="screen", features=[scheme])
        self.events.clear()
        self.call("Page.navigate", url=url)
        ready = "document.readyState === 'complete' && location.href !== 'about:blank'"
        end = time.monotonic() + LIMIT
        while not self.run(ready):
            assert time.monotonic() < end, f"{url} is not loaded"
            time.sleep(0.05)

    def run(self, script):
        """The value of an expression, promises awaited."""
        said = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in said, said["exceptionDetails"]
        return said["result"].get("value")

    def reported(self, *methods):
        """Events of these kinds since the page was opened."""
        return [one["params"] for one in self.events if one.get("method") in methods]

    def pdf(self, path):
        """The page as printed on A4."""
        self.call("Emulation.setEmulatedMedia", media="", features=[])
        data = self.call(
            "Page.printToPDF", paperWidth=8.27, paperHeight=11.69, preferCSSPageSize=True
        )["data"]
        path.write_bytes(base64.b64decode(data))


@contextmanager
def browser(profile):
    """Start a browser with an empty profile in the directory `profile`, and end it."""
    (its_reading, writing), (reading, its_writing) = os.pipe(), os.pipe()
    command = [
        *(sys.executable, "-c", _AS_3_AND_4, str(its_reading), str(its_writing), CHROMIUM),
        *("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--no-first-run"),
        *("--disable-dev-shm-usage", f"--user-data-dir={profile}", "--remote-debugging-pipe"),
    ]
    with subprocess.Popen(
        command,
        pass_fds=(its_reading, its_writing),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as process:
        os.close(its_reading)
        os.close(its_writing)
        try:
            yield Browser(process, reading, writing)
        finally:
            os.close(writing)
            os.close(reading)
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
