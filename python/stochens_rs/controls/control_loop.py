"""`ControlLoop`: what all loops beside a plant share, turns of threads, the log, the way out."""

from __future__ import annotations

import threading
from collections import deque
from contextlib import contextmanager
from typing import TYPE_CHECKING, Generic, TypeVar

from ..exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .._base.types import Floats

LOGGED = 1000  # calls that the log keeps
BEYOND = 1e6  # times the largest in the data from which a number is that of a broken sensor

Entry = TypeVar("Entry")


class ControlLoop(Generic[Entry]):
    """A loop that is called once in each step; it has no attributes but its own.

    What is measured comes in by `validation.measured`: a wrong type or shape raises and changes
    nothing. What a broken sensor sends (nan, inf, 1e300) does not stop the loop: `_held` gives the
    last input once more, and the reason is in the log. No number that is not finite is kept.
    """

    __slots__ = ("__weakref__", "_busy", "_calls", "_last", "_log")

    def __init__(self, safe: Floats) -> None:
        self._busy = threading.Lock()
        self._log: deque[Entry] = deque(maxlen=LOGGED)
        self._calls = 0
        self._last = safe  # the input that was returned last

    @property
    def calls(self) -> int:
        """The number of calls since the loop was made or reset, held ones included."""
        return self._calls

    @property
    def log(self) -> tuple[Entry, ...]:
        """The last 1000 calls, the latest at the end."""
        return tuple(self._log)

    @contextmanager
    def _turn(self) -> Iterator[None]:
        if not self._busy.acquire(blocking=False):
            raise InputError("this loop is in use by another thread: give each thread its own copy")
        try:
            yield
        finally:
            self._busy.release()

    def _entered(self, entry: Entry, u: Floats) -> Floats:
        """Write a call down; what is returned is the caller's own."""
        self._last = u
        self._calls += 1
        self._log.append(entry)
        return u.copy()

    def _cleared(self, safe: Floats) -> None:
        self._log.clear()
        self._calls, self._last = 0, safe
