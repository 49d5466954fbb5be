"""The progress bar of long calls: on a terminal or in a notebook, silent elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TypeAlias

import numpy as np

from ..exceptions import InputTypeError
from .gate import show

__all__ = ["Progress", "in_ipython", "progress_bar"]

# None, a flag, or a function f(done, total).
Progress: TypeAlias = bool | Callable[[int, int | None], object] | None


def in_ipython() -> bool:
    """Whether this is an IPython session, in a notebook or in a terminal."""
    ipython = sys.modules.get("IPython")
    return ipython is not None and ipython.get_ipython() is not None


def progress_bar(
    progress: Progress, total: int | None, what: str, unit: str = "it"
) -> AbstractContextManager[Callable[[int], object]]:
    """Turn `progress` into a context that gives a function ``f(done)``.

    A pipe or a file on stderr gets no bar: nobody watches it.

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
    elif progress and sys.stderr is not None and (sys.stderr.isatty() or in_ipython()):
        from tqdm import tqdm

        with tqdm(total=total, desc=what, unit=unit, unit_scale=True, leave=False) as bar:
            yield lambda done: bar.update(done - bar.n)
    else:
        yield lambda _: None
