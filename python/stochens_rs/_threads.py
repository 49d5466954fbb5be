"""How many threads a call may use; results never depend on it."""

from __future__ import annotations

import os

from . import _gate

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
    _limit = None if threads is None else _gate.size("threads", threads, maximum=1024)


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
