"""``stochens info``: what is installed."""

from __future__ import annotations

from importlib import metadata
from typing import Any

import click

from .._base.files import versions
from .._base.threads import get_num_threads
from ._options import json_option
from ._output import show_result


@click.command(short_help="Installed versions, threads and extras.")
@json_option
def info(as_json: bool) -> None:
    """Installed versions, the number of threads a call may use, and the installed extras."""
    facts: dict[str, Any] = {**versions(), "threads": get_num_threads()}
    for package in ("click", "tqdm", "matplotlib"):
        try:
            facts[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            facts[package] = None
    missing = "not installed (pip install 'stochens_rs[plot]')"
    text = "\n".join(f"{k:<12} {missing if v is None else v}" for k, v in facts.items())
    show_result(facts, text, as_json)
