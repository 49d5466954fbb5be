"""The progress bar of long calls: on a terminal or in a notebook, silent elsewhere."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TypeAlias

import numpy as np

from ..exceptions import InputTypeError
from .validation import show

__all__ = ["Progress", "in_ipython", "progress_bar", "watched"]

# None, a flag, or a function f(done, total).
Progress: TypeAlias = bool | Callable[[int, int | None], object] | None


def in_ipython() -> bool:
    """Whether this is an IPython session, in a notebook or in a terminal."""
    ipython = sys.modules.get("IPython")
    return ipython is not None and ipython.get_ipython() is not None


def watched() -> bool:
    """Whether standard error shows lines that are overwritten: no pipe, file or ``TERM=dumb``."""
    if sys.stderr is None:
        return False
    return in_ipython() or (sys.stderr.isatty() and os.environ.get("TERM") != "dumb")


def progress_bar(
    progress: Progress, total: int | None, what: str, unit: str = "it"
) -> AbstractContextManager[Callable[[int], object]]:
    """Turn `progress` into a context that gives a function ``f(done)``.

    There is no bar where it is not `watched`.

    Raises
    ------
    InputTypeError
        At once, if `progress` is neither None, True, False nor callable.
    """
    if not (progress is None or callable(progress) or isinstance(progress, (bool, np.bool_))):
        raise InputTypeError(
            "`progress` must be None, True, False or a function of (done, total), "
            f"got {show(progress)}"
        )
    return _bar(progress, total, what, unit)


@contextmanager
def _bar(
    progress: Progress, total: int | None, what: str, unit: str
) -> Iterator[Callable[[int], object]]:
    if callable(progress):
        call = progress
        yield lambda done: call(done, total)
    elif progress and watched():
        from tqdm import tqdm

        with tqdm(total=total, desc=what, unit=unit, unit_scale=True, leave=False) as bar:
            yield lambda done: bar.update(done - bar.n)
    else:
        yield lambda _: None
