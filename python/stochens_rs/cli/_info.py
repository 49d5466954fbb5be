"""``stochens info``: what is installed."""

from __future__ import annotations

import json
from importlib import metadata
from typing import Any

import click

from .._base.files import versions
from .._base.threads import get_num_threads
from ._output import show


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def info(as_json: bool) -> None:
    """Versions, threads a call may use, and which extras are installed."""
    facts: dict[str, Any] = {**versions(), "threads": get_num_threads()}
    for package in ("click", "tqdm", "matplotlib"):
        try:
            facts[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            facts[package] = None
    if as_json:
        show(json.dumps(facts, indent=2))
        return
    missing = "not installed (pip install 'stochens_rs[plot]')"
    show("\n".join(f"{k:<12} {missing if v is None else v}" for k, v in facts.items()))
