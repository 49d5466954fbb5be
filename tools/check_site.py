"""Check the built site: python tools/check_site.py [docs/build] [--browser] [--pictures DIR].

Without a browser: every link between pages leads to a page and an anchor that exist, no page shows
the markup of a list or a link as text, and no page, style or script loads anything from another
host. With --browser (Chromium): every page loads
without an error in the console or a request to elsewhere, is not wider than a phone, and cuts no
code on a desk; the search leads from usual words to the right pages. With --pictures it also
writes pictures of pages, wide, narrow and dark.
"""

from __future__ import annotations

import argparse
import base64
import fcntl
import html.parser
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).resolve().parents[1]
WIDTHS = (1280, 390)  # of a desk and of a phone [px]
# Relations of a <link> that load nothing.
FOLLOWED = {"canonical", "author", "next", "prev", "index", "search", "license"}
LOADED = re.compile(
    r"""url\(\s*["']?(?:https?:)?//"""  # styles
    r"""|@import\s+["'](?:https?:)?//"""
    r"""|(?:fetch|import|importScripts)\(\s*["'`](?:https?:)?//"""  # scripts
    r"""|\bfrom\s*["'](?:https?:)?//|\.src\s*=\s*["'`](?:https?:)?//"""
)
# Markup of a source page that was taken for code or text.
MARKUP = re.compile(r"\]\(/[\w./-]+\)|\{\.[a-z]+\}|^:{3,}")
PICTURED = (
    "index",
    "guide",
    "close-the-loop",
    "measured-runs",
    "readings",
    "systems",
    "logs",
    "compare",
    "examples/index",
    "theory/index",
    "api/index",
    "api/generated/stochens_rs.control",
    "benchmarks",
    "fleet",
)


class Page(html.parser.HTMLParser):
    """Anchors, links and loads of a page, and markup that is its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.markup: list[str] = []
        self.style = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take in what an element refers to."""
        given = {name: value or "" for name, value in attrs}
        self.anchors |= {given[name] for name in ("id", "name") if name in given}
        if tag in ("a", "area") and "href" in given:
            self.links.append(given["href"])
        elif "href" in given and (tag != "link" or given.get("rel", "") not in FOLLOWED):
            self.loads.append(given["href"])
        self.loads += [given[name] for name in ("src", "poster", "data") if name in given]
        for part in given.get("srcset", "").split(","):
            self.loads += part.split()[:1]
        self.loads += re.findall(r"url\([^)]*\)", given.get("style", ""))
        self.style = tag in ("style", "script")

    def handle_data(self, data: str) -> None:
        """Look into styles and scripts of the page itself."""
        if self.style:
            self.loads += LOADED.findall(data)
        else:
            self.markup += MARKUP.findall(data)


def is_foreign(address: str) -> bool:
    """Whether an address that is loaded is one of another host."""
    return bool(LOADED.search(address)) or address.startswith(("http:", "https:", "//"))


def pages(site: Path) -> list[Path]:
    """All pages, without the templates that the theme leaves beside its styles."""
    return [path for path in sorted(site.rglob("*.html")) if "_static" not in path.parts]


def faults(site: Path) -> Iterator[str]:
    """What is wrong with links and loads."""
    found = {path: Page(path.read_text("utf-8")) for path in pages(site)}
    for path, page in found.items():
        name = path.relative_to(site).as_posix()
        for address in page.loads:
            if is_foreign(address):
                yield f"{name} loads {address}"
            elif not address.startswith(("data:", "#", "url(")) and not target(path, address)[0]:
                yield f"{name} loads {address}, which does not exist"
        if name.startswith("rust/"):
            continue  # its links are rustdoc's
        for text in page.markup:
            yield f"{name} shows the markup {text} as text"
        for address in page.links:
            if urlsplit(address).scheme:
                continue
            file, anchor = target(path, address)
            if file is None:
                yield f"{name} links to {address}, which does not exist"
            elif anchor and file in found and anchor not in found[file].anchors:
                yield f"{name} links to {address}, which has no such anchor"
    for path in [*site.rglob("*.css"), *site.rglob("*.js")]:
        if match := LOADED.search(path.read_text("utf-8")):
            yield f"{path.relative_to(site)} loads {match[0]}..."


def target(page: Path, address: str) -> tuple[Path | None, str]:
    """The file and the anchor that an address leads to."""
    parts = urlsplit(address)
    file = (page.parent / unquote(parts.path)).resolve() if parts.path else page
    return (file if file.is_file() else None), unquote(parts.fragment)


# -- in a browser ------------------------------------------------------------------------------


class Browser:
    """Chromium without a window, driven over a pipe by the DevTools protocol."""

    def __init__(self, program: str) -> None:
        self.folder = tempfile.mkdtemp()
        reads, self.into = os.pipe()
        self.out, writes = os.pipe()
        # The browser reads descriptor 3 and writes 4; copies above them are in nobody's way.
        ends = [fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 10) for end in (reads, writes)]
        options = "--headless --no-sandbox --disable-gpu --hide-scrollbars --remote-debugging-pipe"
        self.process = subprocess.Popen(
            [program, *options.split(), f"--user-data-dir={self.folder}", "about:blank"],
            stderr=subprocess.DEVNULL,
            close_fds=False,  # those of Python are not inherited anyway
            preexec_fn=lambda: [os.dup2(end, k) for k, end in enumerate(ends, start=3)],
        )
        for end in (reads, writes, *ends):
            os.close(end)
        self.numbers, self.rest, self.session = itertools.count(1), b"", {}
        self.events: list[dict[str, Any]] = []
        made = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=made, flatten=True)
        self.session = {"sessionId": attached["sessionId"]}
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def message(self) -> dict[str, Any]:
        """Wait for the next message."""
        while b"\0" not in self.rest:
            more = os.read(self.out, 1 << 20)
            if not more:
                raise RuntimeError("the browser has ended")
            self.rest += more
        first, _, self.rest = self.rest.partition(b"\0")
        return json.loads(first)

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Call a method of the protocol, and keep the events that come before its answer."""
        number = next(self.numbers)
        text = json.dumps({"id": number, "method": method, "params": params, **self.session})
        os.write(self.into, text.encode() + b"\0")
        while (message := self.message()).get("id") != number:
            self.events.append(message)
        if "error" in message:
            raise RuntimeError(f"{method}: {message['error']['message']}")
        return message["result"]

    def show(self, address: str) -> list[str]:
        """Load a page; the errors that it causes."""
        self.events.clear()
        self.call("Page.navigate", url=address)
        while all(event.get("method") != "Page.loadEventFired" for event in self.events):
            self.events.append(self.message())
        self.value("new Promise(done => setTimeout(done, 30))")
        return [text for event in self.events if (text := complaint(event))]

    def open(self, address: str, *, width: int = WIDTHS[0], dark: bool = False) -> list[str]:
        """Load a page in a window of this width; the errors that it causes."""
        feature = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", media="screen", features=[feature])
        self.widen(width)
        return self.show(address)

    def value(self, expression: str) -> Any:
        """Value of an expression on the page."""
        options = {"expression": expression, "returnByValue": True, "awaitPromise": True}
        found = self.call("Runtime.evaluate", **options)
        if "exceptionDetails" in found:
            raise RuntimeError(f"{expression[:80]}: {found['exceptionDetails']['text']}")
        return found["result"].get("value")

    def reported(self, *methods: str) -> list[dict[str, Any]]:
        """Events of these kinds since the page was loaded."""
        return [event["params"] for event in self.events if event.get("method") in methods]

    def widen(self, width: int, height: int = 900) -> None:
        """Set the size of the page."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
        self.call("Emulation.setDeviceMetricsOverride", **size)

    def picture(self, path: Path, width: int, height: int) -> None:
        """Write a picture of the page."""
        clip = {"x": 0, "y": 0, "width": width, "height": height, "scale": 1}
        whole = self.call("Page.captureScreenshot", clip=clip, captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(whole["data"]))

    def pdf(self, path: Path) -> None:
        """Write the page as printed on A4."""
        self.call("Emulation.setEmulatedMedia", media="", features=[])
        size = {"paperWidth": 8.27, "paperHeight": 11.69, "preferCSSPageSize": True}
        path.write_bytes(base64.b64decode(self.call("Page.printToPDF", **size)["data"]))

    def close(self) -> None:
        """End the browser."""
        os.close(self.into)
        self.process.wait(20)
        os.close(self.out)
        shutil.rmtree(self.folder, ignore_errors=True)


def complaint(event: dict[str, Any]) -> str | None:
    """What an event of the browser complains of."""
    method, about = event.get("method"), event.get("params", {})
    if method == "Network.requestWillBeSent":
        url = about["request"]["url"]
        return None if url.startswith(("file:", "data:", "blob:", "about:")) else f"requests {url}"
    if method == "Network.loadingFailed" and not about.get("canceled"):
        return f"could not load a {about['type']}: {about['errorText']}"
    if method == "Runtime.exceptionThrown":
        details = about["exceptionDetails"]
        return f"raises {details.get('exception', {}).get('description', details['text'])}"
    if method == "Runtime.consoleAPICalled" and about["type"] in ("error", "assert", "warning"):
        return "says " + " ".join(str(a.get("value", a.get("type"))) for a in about["args"])
    if method == "Log.entryAdded" and about["entry"]["level"] in ("error", "warning"):
        return f"logs {about['entry']['text']}"
    return None


# What stands out of the page to the right, outside of boxes that scroll or are cut.
WIDE = """(() => {
  const edge = document.documentElement.clientWidth + 1;
  if (document.documentElement.scrollWidth <= edge) return [];
  const boxed = e => e && e !== document.body &&
    (getComputedStyle(e).overflowX !== "visible" || boxed(e.parentElement));
  return [...document.body.querySelectorAll("*")].filter(e =>
    e.getBoundingClientRect().right > edge && !boxed(e.parentElement)
  ).slice(0, 3).map(e => e.tagName.toLowerCase() + "." + e.className);
})()"""
CUT = """[...document.querySelectorAll("pre, div.formula")]
  .filter(e => e.scrollWidth > e.clientWidth + 1).map(e => e.textContent.trim().slice(0, 40))"""
RESULTS = """[...document.querySelectorAll("#search-results li a")]
  .map(a => a.getAttribute("href").split(".html")[0])"""
FIRST = {
    "csv": "index",
    "mpc": "close-the-loop",
    "lqr": "close-the-loop",
    "kalman": "readings",
    "arx": "readings",
    "identification": "measured-runs",
    "feedback": "close-the-loop",
    "identify": "api/generated/stochens_rs.identify",
}


def seen(browser: Browser, site: Path) -> Iterator[str]:
    """What is wrong with the pages in a browser."""
    for path in pages(site):
        name = path.relative_to(site).as_posix()
        if name.startswith("rust/"):
            continue
        browser.widen(WIDTHS[0])
        yield from (f"{name} {text}" for text in browser.show(path.as_uri()))
        for width in WIDTHS:
            browser.widen(width)
            if wide := browser.value(WIDE):
                yield f"{name} is wider than {width} px: {', '.join(wide)}"
            if width == WIDTHS[0] and (cut := browser.value(CUT)):
                yield f"{name} cuts at {width} px: {', '.join(cut)}"
    for word, page in FIRST.items():
        browser.show((site / "search.html").as_uri() + f"?q={word}")
        end = time.monotonic() + 20.0
        while not (results := browser.value(RESULTS)) and time.monotonic() < end:
            time.sleep(0.1)
        if (
            not results
            or results[0] != page
            or not {"changelog", "contributing"}.isdisjoint(results)
        ):
            yield f"the search for {word} finds {(results or [])[:5]}"


def take_pictures(browser: Browser, site: Path, folder: Path, names: list[str]) -> None:
    """Pictures of pages at both widths, light and dark."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, width, scheme in itertools.product(names, WIDTHS, ("light", "dark")):
        browser.open((site / f"{name}.html").as_uri(), width=width, dark=scheme == "dark")
        height = min(browser.value("document.documentElement.scrollHeight"), 6000)
        file = f"{name.replace('/', '-')}-{width}-{scheme}.png"
        browser.picture(folder / file, width, height)


def main() -> int:
    """Print what is wrong; the exit code is 1 if anything is."""
    parser = argparse.ArgumentParser(description=__doc__.partition(":")[0])
    parser.add_argument("site", type=Path, nargs="?", default=ROOT / "docs" / "build")
    parser.add_argument("--browser", action="store_true", help="load the pages in Chromium")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="write pictures of pages")
    parser.add_argument("--pages", nargs="*", default=list(PICTURED), help="pages for --pictures")
    options = parser.parse_args()
    site = options.site.resolve()
    wrong = list(faults(site))
    if options.browser or options.pictures:
        program = shutil.which("chromium") or shutil.which("google-chrome")
        if program is None:
            parser.error("no Chromium was found")
        browser = Browser(program)
        try:
            wrong += seen(browser, site) if options.browser else []
            if options.pictures:
                take_pictures(browser, site, options.pictures, options.pages)
        finally:
            browser.close()
    print("\n".join(wrong) or f"{site}: nothing is wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
