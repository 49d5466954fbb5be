"""The pages of the guide as notebooks, for download: their text, code and pictures."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

BLOCK = re.compile(r"^```python\n(.*?)\n```$", re.MULTILINE | re.DOTALL)
PICTURE = re.compile(r"!\[([^]]*)\]\(([^)\s]+\.png)\)")
ABOUT = {"name": "python3", "display_name": "Python 3", "language": "python"}


def notebook(page: Path) -> dict[str, Any]:
    """Notebook (nbformat 4.5) of a Markdown page: each block of Python is a cell."""
    cells: list[dict[str, Any]] = []
    for k, text in enumerate(BLOCK.split(page.read_text("utf-8"))):
        if text.strip():
            kind = "code" if k % 2 else "markdown"
            cell = {"cell_type": kind, "id": f"cell-{k}", "metadata": {}, "source": text.strip()}
            extra = {"outputs": [], "execution_count": None} if k % 2 else with_pictures(cell, page)
            cells.append(cell | extra)
    kernel = {"kernelspec": ABOUT, "language_info": {"name": "python"}}
    return {"cells": cells, "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}


def with_pictures(cell: dict[str, Any], page: Path) -> dict[str, Any]:
    """The cell's text with its pictures attached; links to other pages become their words."""
    attached = {}
    for _, path in PICTURE.findall(cell["source"]):
        data = base64.b64encode((page.parent / path).read_bytes()).decode()
        attached[Path(path).name] = {"image/png": data}
    text = PICTURE.sub(lambda m: f"![{m[1]}](attachment:{Path(m[2]).name})", cell["source"])
    text = re.sub(r"(?<!!)\[([^]]+)\]\((?!https?:|attachment:)[^)\s]+\)", r"\1", text)
    return {"source": text} | ({"attachments": attached} if attached else {})


def offered(docname: str, source: Path) -> bool:
    """Whether a page has programs that can be run: Markdown of this folder with Python in it."""
    page = source / f"{docname}.md"
    return "/" not in docname and page.exists() and bool(BLOCK.search(page.read_text("utf-8")))


def link(app: Any, docname: str, _template: str, context: dict[str, Any], _tree: Any) -> None:
    """Tell the template of the page where its notebook is."""
    if offered(docname, Path(app.srcdir)):
        context["notebook"] = f"notebooks/{docname}.ipynb"


def write(app: Any, failed: Exception | None) -> None:
    """Write the notebooks beside the pages."""
    if failed or app.builder.format != "html":
        return
    folder = Path(app.outdir) / "notebooks"
    folder.mkdir(exist_ok=True)
    for docname in app.env.found_docs:
        if offered(docname, Path(app.srcdir)):
            text = json.dumps(notebook(Path(app.srcdir) / f"{docname}.md"), indent=1)
            (folder / f"{docname}.ipynb").write_text(text + "\n", "utf-8")


def setup(app: Any) -> dict[str, bool]:
    """Connect to the build."""
    app.connect("html-page-context", link)
    app.connect("build-finished", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
