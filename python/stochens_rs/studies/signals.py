"""Ctrl-C and SIGTERM during the run of a study."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from .worker import Interruption

_open: list[Interruption] = []  # of the runs in the main thread, the outermost first


@contextmanager
def interruptions() -> Iterator[Interruption]:
    """Count the signals; the first one breaks off the task that runs in this process.

    A signal counts for all runs, should a task run a study itself. Signals that are ignored stay
    so, and threads other than the main one get none.
    """
    found = Interruption()
    if threading.current_thread() is not threading.main_thread():
        yield found
        return
    owner = os.getpid()

    def receive(number: int, _: FrameType | None) -> None:
        if os.getpid() != owner:  # a worker that was forked during the run
            if number == signal.SIGINT:
                raise KeyboardInterrupt
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
            return
        for one in _open:
            one.count += 1
            one.number = one.number or number
        if found.breakable:
            raise KeyboardInterrupt

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    caught = {n: old for n, old in before.items() if old not in (signal.SIG_IGN, None)}
    _open.append(found)
    for number in caught:
        signal.signal(number, receive)
    try:
        yield found
    finally:
        _open.remove(found)
        for number, handler in caught.items():
            signal.signal(number, handler)
