"""Threads: how many a call may use, and one for work that cannot look for signals."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from typing import TypeVar

from . import gate

T = TypeVar("T")

_limit: int | None = None


def set_num_threads(threads: int | None) -> None:
    """Set how many threads one call may use.

    Threads are started and joined inside a call; there is no pool, so forking is safe. The
    results are the same for any number, bit for bit.

    Parameters
    ----------
    threads : int or None
        At least 1 and at most 1024; None goes back to the default: the environment variable
        ``STOCHENS_NUM_THREADS`` if that is a whole number, otherwise the processors this
        process may use.

    Raises
    ------
    SizeError, InputTypeError
        If `threads` is not such a number.

    Examples
    --------
    >>> import stochens_rs as se
    >>> se.set_num_threads(2)
    >>> se.get_num_threads()
    2
    >>> se.set_num_threads(None)
    """
    global _limit
    _limit = None if threads is None else gate.size("threads", threads, maximum=1024)


def get_num_threads() -> int:
    """Return how many threads one call may use (see `set_num_threads`).

    Returns
    -------
    int
        At least 1.
    """
    if _limit is not None:
        return _limit
    asked = os.environ.get("STOCHENS_NUM_THREADS", "")
    if asked.isdecimal() and len(asked) <= 4 and int(asked) > 0:
        return min(int(asked), 1024)
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return os.cpu_count() or 1


def interruptible(work: Callable[[], T]) -> T:
    """Return ``work()``, done on a thread that is left behind when a signal's handler raises.

    For long calls of NumPy, which hear no signal before their end.
    """
    results: list[T] = []
    errors: list[BaseException] = []

    def run() -> None:
        try:
            results.append(work())
        except BaseException as error:  # the caller raises it
            errors.append(error)

    worker = threading.Thread(target=run, daemon=True)
    try:
        worker.start()
    except RuntimeError:  # no thread to be had
        return work()
    while worker.is_alive():
        worker.join(0.05)  # on Windows a signal is heard between two of these
    if errors:
        raise errors[0]
    return results[0]
