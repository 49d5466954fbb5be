"""The number of threads of a call, and long NumPy calls that Ctrl-C can interrupt."""

from __future__ import annotations

import _thread
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

from . import validation

T = TypeVar("T")

# Seconds between two looks for signals: on Windows, waiting for a thread does not notice them.
_PAUSE, _SOON = 0.05, 0.001
_BEGIN = 1.0  # seconds that a thread gets to begin

VARIABLE = "STOCHENS_NUM_THREADS"
_MOST = 1024  # threads of one call
_limit: int | None = None
_single = 0  # how many `one_thread` blocks are open, in all threads together
_single_lock = threading.Lock()


def set_num_threads(threads: int | None) -> None:
    """Set how many threads one call may use.

    The results are the same bits with any number of threads. Each call starts and joins its own
    threads, so the process can be forked between calls.

    Parameters
    ----------
    threads : int or None
        1 to 1024. None for the default: the environment variable ``STOCHENS_NUM_THREADS`` if it
        is a whole number, otherwise the number of processors this process may use.

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
    _limit = None if threads is None else validation.size("threads", threads, maximum=_MOST)


def get_num_threads() -> int:
    """Return how many threads one call may use (see `set_num_threads`).

    Returns
    -------
    int
        At least 1.
    """
    return threads_by()[0]


def threads_by() -> tuple[int, str]:
    """How many threads one call may use, and what says so."""
    if _single:
        return 1, "a worker"
    if _limit is not None:
        return _limit, "set_num_threads"
    asked = os.environ.get(VARIABLE, "")
    if asked.isdecimal() and len(asked) <= 4 and int(asked) > 0:
        return min(int(asked), _MOST), VARIABLE
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0))), "processors"
    return os.cpu_count() or 1, "processors"


@contextmanager
def one_thread() -> Iterator[None]:
    """Let each call use one thread: for workers, which are as many as the processors."""
    global _single
    with _single_lock:
        _single += 1
    try:
        yield
    finally:
        with _single_lock:
            _single -= 1


def interruptible(work: Callable[[], T]) -> T:
    """Return ``work()``, computed on a second thread so that Ctrl-C is noticed meanwhile.

    For long NumPy calls, which handle no signal before their end. If a signal handler raises, the
    thread goes on in the background until its work is done.
    """
    waiting = [work]
    found: list[Any] = [None, None, False]  # the result, the exception, whether there is one

    def run() -> None:
        try:
            found[0] = waiting.pop()()
        except BaseException as error:  # the caller raises it
            found[1] = error
        finally:
            found[2] = True

    # not by `Thread.start`, which waits for ever for a thread that has no memory to begin
    end = time.monotonic() + _BEGIN
    with suppress(RuntimeError, MemoryError):  # no thread can be started
        _thread.start_new_thread(run, ())
        while not found[2] and (not waiting or time.monotonic() < end):
            time.sleep(_PAUSE if time.monotonic() >= end else _SOON)
    if waiting:  # it did not begin
        waiting.clear()
        return work()
    if found[1] is not None:
        raise found[1]
    return found[0]  # type: ignore[no-any-return]
