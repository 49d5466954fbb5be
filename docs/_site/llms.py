"""llms.txt: the pages in one list for programs that read, https://llmstxt.org."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from docutils import nodes

LEAVES = ("api/generated/", "genindex", "changelog", "contributing")


def entry(app: Any, docname: str) -> str:
    """A line with title, address and the first sentence of a page."""
    env = app.env
    texts = (p.astext() for p in env.get_doctree(docname).findall(nodes.paragraph))
    words = next((text for text in texts if not text.startswith("Go to the end")), "")
    first = " ".join(words.split()).partition(". ")[0].rstrip(".:")
    address = app.builder.get_target_uri(docname)
    return f"- [{env.titles[docname].astext()}]({address}): {first}"


def write(app: Any, failed: Exception | None) -> None:
    """Write the list beside the first page."""
    if failed or app.builder.format != "html":
        return
    names = sorted(name for name in app.env.found_docs if not name.startswith(LEAVES))
    about = "> Control of a linear system that is known only in part, with bounds of the error."
    lines = [f"# {app.config.project} {app.config.release}", "", about, "", "## Pages", ""]
    text = "\n".join([*lines, *(entry(app, name) for name in names), ""])
    (Path(app.outdir) / "llms.txt").write_text(text, "utf-8")


def setup(app: Any) -> dict[str, bool]:
    """Connect to the build."""
    app.connect("build-finished", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
