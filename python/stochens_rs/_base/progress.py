"""The progress bar of long calls: on a terminal or in a notebook, silent elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeAlias

__all__ = ["Progress", "in_ipython", "progress_bar"]

Progress: TypeAlias = bool | Callable[[int, int | None], object] | None


def in_ipython() -> bool:
    """Whether this is an IPython session, in a notebook or in a terminal."""
    ipython = sys.modules.get("IPython")
    return ipython is not None and ipython.get_ipython() is not None


@contextmanager
def progress_bar(
    progress: Progress, total: int | None, what: str, unit: str = "it"
) -> Iterator[Callable[[int], object]]:
    """Turn `progress` (None, a flag or a callable ``f(done, total)``) into a callable ``f(done)``.

    A pipe or a file on stderr gets no bar: nobody watches it.
    """
    if callable(progress):
        call = progress
        yield lambda done: call(done, total)
    elif progress and sys.stderr is not None and (sys.stderr.isatty() or in_ipython()):
        from tqdm import tqdm

        with tqdm(total=total, desc=what, unit=unit, unit_scale=True, leave=False) as bar:
            yield lambda done: bar.update(done - bar.n)
    else:
        yield lambda _: None
