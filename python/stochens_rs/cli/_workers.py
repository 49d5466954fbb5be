"""What runs studies: this process, several processes, or a cluster."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Any

import click

from .._base.extras import extra
from ..studies.worker import end_with_parent

workers_option = click.option(
    "--workers", metavar="P", type=click.IntRange(1, 1024), default=1, help="Processes."
)


@contextmanager
def executor(workers: int, dask: str | None = None) -> Iterator[Any]:
    """None, what makes a pool of processes, or the executor of a cluster."""
    if dask is not None:
        with extra("a cluster needs distributed", "dask"):
            from distributed import Client
        with Client(dask) as client:
            yield client.get_executor(pure=False)
        return
    yield partial(pool, workers) if workers > 1 else None


def pool(workers: int) -> Executor:
    """Processes that ignore Ctrl-C, which reaches all of a terminal: only this one answers it.

    They end with this process, however it ends.
    """
    context = multiprocessing.get_context("spawn")
    made = ProcessPoolExecutor(workers, context, initializer=end_with_parent)
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # they start so, and keep it
    try:
        for _ in range(workers):
            made.submit(os.getpid)
    finally:
        signal.signal(signal.SIGINT, before)
    return made
