"""Runs the tasks of a study, in this process or by an executor, in blocks of measured cost."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from functools import cache
from types import FrameType
from typing import Any, TypeAlias

import numpy as np

from .._base.running import one_thread
from .._base.types import Status
from .._base.validation import show
from ..exceptions import InputError, InputTypeError
from ..rng import Key
from .grid import Grid
from .tasks import FAILED, Block, Layout, Span, fingerprint

Function: TypeAlias = Callable[..., Mapping[str, Any]]

_HERE, _THERE = 0.1, 0.5  # seconds that a block is to take, in this process and in a worker
_GROWTH = 4  # a block has at most this many times the tasks of the largest before it
_LOOK = 0.1  # seconds between two looks for signals and the time
_GRACE = 5.0  # seconds that running blocks get to end after Ctrl-C
_LONGEST = 300  # characters of the text of an error


class Interruption:
    """Whether a run is to stop, and whether a task runs that a signal may break off."""

    def __init__(self) -> None:
        self.count = 0
        self.number = 0  # of the first signal
        self.breakable = False


_open: list[Interruption] = []  # of the runs in the main thread, the outermost first


@contextmanager
def interruptions() -> Iterator[Interruption]:
    """Count Ctrl-C and SIGTERM; the first one breaks off the task that runs in this process.

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


@dataclass(frozen=True)
class Work:
    """What a worker needs to know of a study."""

    function: Function
    grid: Grid
    key: Key
    owner: int = field(default_factory=os.getpid)  # the process that has the signal handlers


def run_block(
    work: Work, start: int, stop: int, layout: Layout, interruption: Interruption | None = None
) -> Block:
    """Run tasks; without `interruption` in a worker, which ignores Ctrl-C and uses one thread."""
    block = Block(start, np.zeros(stop - start, np.uint8), platform=fingerprint())
    if layout:
        block.lay_out(layout)
    began, foreign = time.perf_counter(), os.getpid() != work.owner
    if interruption is None and foreign:
        end_with_parent()
    quiet = _unsignalled() if foreign else nullcontext()
    with quiet, one_thread() if interruption is None else nullcontext():
        _run_tasks(work, block, interruption or Interruption())
    block.seconds = time.perf_counter() - began
    return block


def _run_tasks(work: Work, block: Block, interruption: Interruption) -> None:
    configurations: dict[int, tuple[Key, dict[str, Any]]] = {}
    for position in range(len(block.states)):
        task = block.start + position
        replicate, number = divmod(task, work.grid.size)
        if number not in configurations:
            key = work.key.child(work.grid.text(number))
            configurations[number] = key, work.grid.configuration(number)
        key, configuration = configurations[number]
        try:
            interruption.breakable = True
            if interruption.count:
                raise KeyboardInterrupt
            found = work.function(key.child(f"replicate {replicate}"), **configuration)
            interruption.breakable = False
            if not interruption.count:
                block.take(position, found, work.grid)
        except KeyboardInterrupt:
            interruption.count = max(1, interruption.count)
        except Exception as error:  # whatever the function raises
            block.states[position], block.errors[task] = FAILED, _one_line(error)
            for rows in block.values.values():
                rows[position] = np.nan
        finally:
            interruption.breakable = False
        # Results of this package may be partial after Ctrl-C, with the status "interrupted".
        if interruption.count:
            block.cut(position)
            block.errors.pop(task, None)
            return


def _one_line(error: Exception) -> str:
    """Type and message of an error."""
    try:
        text = str(error)
    except Exception:  # a broken __str__
        text = ""
    line = " ".join(f"{type(error).__name__}: {text}".split()).strip(": ")
    clean = line.encode(errors="replace").decode()
    return clean if len(clean) <= _LONGEST else clean[: _LONGEST - 3] + "..."


@contextmanager
def _unsignalled() -> Iterator[None]:
    """Ignore Ctrl-C in the process of a worker: the one that runs the study answers it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before or signal.SIG_DFL)


@cache
def end_with_parent() -> None:
    """End this process when the one that started it is gone: a SIGKILL lets it tell nobody.

    Only for one whose parent is known to be the reason for it: started by `multiprocessing`.
    """
    kind = sys.modules.get("multiprocessing.process")
    parent = kind.parent_process() if kind else None
    if parent is None:
        return
    # the sentinel of a forked worker lasts as long as its younger siblings
    child = os.getppid() == parent.pid

    def watch() -> None:
        while parent.is_alive() and not (child and os.getppid() != parent.pid):
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


class Blocks:
    """Cuts the waiting tasks into blocks: long ones, but so that all workers end together."""

    def __init__(self, spans: Iterable[Span], seconds: float, workers: int) -> None:
        self._spans = deque(spans)
        self._seconds, self._workers = seconds, workers
        self._left = sum(stop - start for start, stop in self._spans)
        self._cost: float | None = None  # seconds for one task
        self._largest = 1

    def __bool__(self) -> bool:
        return bool(self._spans)

    def take(self) -> Span:
        """The next block."""
        start, stop = self._spans.popleft()
        size = 1
        if self._cost is not None:
            fair = -(-self._left // (2 * self._workers))
            size = max(1, min(int(self._seconds / self._cost), _GROWTH * self._largest, fair))
        end = min(stop, start + size)
        if end < stop:
            self._spans.appendleft((end, stop))
        self._left -= end - start
        return start, end

    def measure(self, block: Block) -> None:
        """Learn from a block what a task costs."""
        if count := len(block.states):
            cost = max(block.seconds / count, 1e-7)
            self._cost = cost if self._cost is None else (self._cost + cost) / 2
            self._largest = max(self._largest, count)


@dataclass
class Run:
    """One run of a study: what is to be done, who keeps it, and when it ends."""

    work: Work
    layout: Layout
    keep: Callable[[Block], Layout]
    idle: Callable[[], None]
    interruption: Interruption
    end: float  # time.monotonic

    def here(self, spans: Iterable[Span]) -> Status:
        """Run all tasks in this process."""
        blocks = Blocks(spans, _HERE, 1)
        while blocks:
            if over := self._over():
                return over
            start, stop = blocks.take()
            block = run_block(self.work, start, stop, self.layout, self.interruption)
            self._done(block, blocks)
            if block.stop < stop:
                return "interrupted"
        return "completed"

    def by(self, executor: Executor, spans: Iterable[Span]) -> Status:
        """Run all tasks by an executor; raise if it does not take them or its workers die."""
        pending: dict[Future[Block], Span] = {}
        workers = _workers_of(executor)
        blocks = Blocks(spans, _THERE, workers)
        try:
            while blocks or pending:
                if over := self._over():
                    for one in [one for one in pending if one.cancel()]:
                        del pending[one]
                    if over == "interrupted":
                        self._wait_for_last(pending)
                        return over
                    if not pending:
                        return over
                # the first tasks, one after another, say what names and shapes the numbers have
                room = 2 * workers if self.layout else 1
                while blocks and len(pending) < room and not over:
                    span = blocks.take()
                    pending[self._submitted(executor, span)] = span
                finished, _ = wait(pending, timeout=_LOOK, return_when=FIRST_COMPLETED)
                for future in finished:
                    stop, block = pending.pop(future)[1], _result(future)
                    self._done(block, blocks)
                    if block.stop < stop:  # the function raised KeyboardInterrupt
                        self.interruption.count += 1
                self.idle()
            return "completed"
        finally:
            for future in pending:
                future.cancel()
            _end_broken(executor)

    def _over(self) -> Status | None:
        """Why the run is to end now, if it is."""
        if self.interruption.count:
            return "interrupted"
        return "time_limit" if time.monotonic() >= self.end else None

    def _submitted(self, executor: Executor, span: Span) -> Future[Block]:
        try:
            return executor.submit(run_block, self.work, *span, self.layout)
        except Exception as error:
            raise _lost(error, "does not take tasks") from error

    def _done(self, block: Block, blocks: Blocks) -> None:
        self.layout = self.keep(block)
        blocks.measure(block)

    def _wait_for_last(self, pending: dict[Future[Block], Span]) -> None:
        """Keep the blocks that end within the grace, unless Ctrl-C comes again."""
        end, asked = time.monotonic() + _GRACE, self.interruption.count
        while pending and time.monotonic() < end and self.interruption.count <= max(1, asked):
            finished, _ = wait(pending, timeout=_LOOK, return_when=FIRST_COMPLETED)
            for future in finished:
                del pending[future]
                with suppress(InputError):  # a worker that died of the same signal
                    self.layout = self.keep(_result(future))


def _result(future: Future[Block]) -> Block:
    try:
        block = future.result()
    except (Exception, CancelledError) as error:
        text = "could not run `function`, which workers must be able to import"
        raise _lost(error, text) from error
    if not isinstance(block, Block):
        raise InputTypeError(f"`executor` must return what tasks return, got {show(block)}")
    return block


def _lost(error: BaseException, otherwise: str) -> InputError:
    """What is wrong with an executor: its workers have died or cannot be started, or else."""
    died = isinstance(error, (BrokenExecutor, CancelledError, OSError, EOFError))
    if died or type(error).__name__ == "KilledWorker":  # of dask.distributed
        otherwise = "has lost its workers: run the study on with a new one"
    return InputError(f"`executor` {otherwise} ({_one_line(error)})")  # type: ignore[arg-type]


def _end_broken(executor: Executor) -> None:
    """End the workers of a broken pool, which would wait for them for ever.

    Python drops a SIGTERM that reaches a worker while it is being forked, if this process catches
    SIGTERM, as it does during a run.
    """
    pools = sys.modules.get("concurrent.futures.process")  # slow to import
    if pools and isinstance(executor, pools.ProcessPoolExecutor) and executor._broken:
        for worker in dict(executor._processes or {}).values():
            with suppress(OSError, ValueError):  # it has ended
                worker.kill()


def checked_executor(executor: object) -> Executor | None:
    """Return an executor or None."""
    if executor is None or isinstance(executor, Executor):
        return executor
    dask = ": pass client.get_executor(pure=False)" if hasattr(executor, "get_executor") else ""
    raise InputTypeError(
        f"`executor` must be a concurrent.futures.Executor, got {show(executor)}{dask}"
    )


def _workers_of(executor: Executor) -> int:
    """How many tasks an executor runs at a time, as far as it says so."""
    for name in ("_max_workers", "num_workers"):
        count = getattr(executor, name, None)
        if isinstance(count, int) and count > 0:
            return count
    client = getattr(executor, "_client", None)  # of dask.distributed
    if client is not None and hasattr(client, "ncores"):
        return max(1, int(sum(client.ncores().values())))
    return os.cpu_count() or 1
