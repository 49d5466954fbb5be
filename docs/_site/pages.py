"""Markdown that is read on a code host as well as here: includes, and links between files.

Links in the files are relative to the file, as a code host wants them. Here they lead to the page
that shows the file: README.md is shown by the first page, an example of the gallery by
its own page.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[1]
# Files outside this folder, and the pages that show them.
SHOWN = {"README.md": "index", "CHANGELOG.md": "changelog", "CONTRIBUTING.md": "contributing"}
INCLUDE = re.compile(r"^```\{include\} (\S+)\n((?::[\w-]+:.*\n)*)```$", re.MULTILINE)
# Where the search leads those who know another word for what a page is about.
WORDS = {
    "index": "csv, installation",
    "close-the-loop": "feedback, lqr, gain, stability, robust control, mpc, "
    "model predictive control, constraints, saturation",
    "how-much-can-go-wrong": "gain margin, phase margin, disk margin, delay margin, nonlinear, "
    "fixed point, float32, anti-windup",
    "measured-runs": "identification, system identification, least squares",
    "logs": "delay, missing data",
    "readings": "arx, outputs, kalman, kalman filter, observer, n4sid, "
    "offset-free, integral action, output feedback",
}
LINK = re.compile(r"(?<=\]\()([^)#\s:]+)(?=[)#])")


def page_of(file: Path) -> str | None:
    """Address of a file from the root of the site's sources, or None if there is none."""
    for name, page in SHOWN.items():
        if file == DOCS.parent / name:
            return f"/{page}.md"
    if file.parent == DOCS / "gallery":
        return f"/examples/{file.stem if file.suffix == '.py' else 'index'}.rst"
    if file == DOCS / "gallery":
        return "/examples/index.rst"
    return f"/{file.relative_to(DOCS).as_posix()}" if file.is_relative_to(DOCS) else None


def with_links(text: str, file: Path) -> str:
    """The text of a file, with links that lead to the pages of the site."""

    def address(match: re.Match[str]) -> str:
        target = (file.parent / match[1]).resolve()
        if not target.exists():
            return match[1]
        return page_of(target) or os.path.relpath(target, DOCS)  # a file to download

    return LINK.sub(address, text)


def included(match: re.Match[str], page: Path) -> str:
    """The part of a file that an include asks for."""
    file = (page.parent / match[1]).resolve()
    options = dict(re.findall(r"^:([\w-]+): \"?(.*?)\"?$", match[2], re.MULTILINE))
    text = file.read_text("utf-8")
    for option, part in (("start-after", 2), ("end-before", 0)):
        if option in options:
            pieces = text.partition(options.pop(option))
            if not pieces[1]:
                raise ValueError(f"{page.name}: {file.name} does not contain the text {option}")
            text = pieces[part]
    if options:
        raise ValueError(f"{page.name}: unknown options of an include: {sorted(options)}")
    return with_links(text, file)


def expanded(text: str, page: Path) -> str:
    """The text of a page as Sphinx gets it."""
    return INCLUDE.sub(lambda match: included(match, page), with_links(text, page))


def read(app: Any, docname: str, source: list[str]) -> None:
    """Change the source of a page before it is parsed."""
    page = Path(app.env.doc2path(docname))
    if page.suffix == ".md":
        for match in INCLUDE.finditer(source[0]):
            app.env.note_dependency(str((page.parent / match[1]).resolve()))
        source[0] = expanded(source[0], page)
        if docname in WORDS:
            words = ", ".join(f"! {word}" for word in WORDS[docname].split(", "))
            title, line, rest = source[0].partition("\n")
            source[0] = f"{title}{line}\n```{{index}} {words}\n```\n{rest}"


def setup(app: Any) -> dict[str, bool]:
    """Connect to the build."""
    app.connect("source-read", read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
