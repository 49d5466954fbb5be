"""Runs the tasks of a study, in this process or by an executor, in blocks of measured cost."""

from __future__ import annotations

import inspect
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from contextlib import suppress
from typing import TypeAlias

from .._base.types import Status
from .._base.validation import show
from ..exceptions import InputError, InputTypeError
from .store import Span
from .worker import Block, Interruption, Layout, Work, run_block

# An executor, or what makes one: it is called again when the workers of the last one have died.
ExecutorLike: TypeAlias = "Executor | Callable[[], Executor] | None"

_HERE, _THERE = 0.1, 0.5  # seconds that a block is to take, in this process and in a worker
_GROWTH = 4  # a block has at most this many times the tasks of the largest before it
_LOOK = 0.1  # seconds between two looks for signals and the time
_GRACE = 5.0  # seconds that running blocks get to end after Ctrl-C
_LOST = 3  # times that workers may die before any further block is done
_PAUSE = 0.25  # seconds before a pool is made again after one that did nothing; then twice as many


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

    def give_back(self, span: Span) -> None:
        """Let a block that was lost be the next one."""
        if span[0] < span[1]:
            self._spans.appendleft(span)
            self._left += span[1] - span[0]

    def measure(self, block: Block) -> None:
        """Learn from a block what a task costs."""
        count = len(block.states)
        if count:
            cost = max(block.seconds / count, 1e-7)
            self._cost = cost if self._cost is None else (self._cost + cost) / 2
            self._largest = max(self._largest, count)


class Run:
    """One run of a study: what is to be done, who keeps it, and when it ends."""

    def __init__(
        self,
        work: Work,
        layout: Layout,
        keep: Callable[[Block], Layout],
        idle: Callable[[], None],
        interruption: Interruption,
        time_limit: float | None,
    ) -> None:
        self._work, self._layout, self._keep, self._idle = work, layout, keep, idle
        self._interruption = interruption
        self._end = None if time_limit is None else time.monotonic() + time_limit
        self.reason: Exception | None = None  # why the last worker that was not started was not

    def _over(self) -> Status | None:
        """Why the run is to end now, if it is."""
        if self._interruption.count:
            return "interrupted"
        late = self._end is not None and time.monotonic() >= self._end
        return "time_limit" if late else None

    def pause(self, seconds: float) -> None:
        """Wait, unless the run is to end."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and self._over() is None:
            time.sleep(min(_LOOK, seconds))

    def here(self, spans: Iterable[Span]) -> Status:
        """Run all tasks in this process."""
        blocks = Blocks(spans, _HERE, 1)
        while blocks:
            if over := self._over():
                return over
            start, stop = blocks.take()
            block = run_block(self._work, start, stop, self._layout, self._interruption)
            self._done(block, blocks)
            if block.stop < stop:
                return "interrupted"
        return "completed"

    def by(self, executor: Executor, spans: Iterable[Span]) -> Status:
        """Run all tasks by an executor; "workers_lost" if its workers have died."""
        pending: dict[Future[Block], Span] = {}
        workers, self.reason = workers_of(executor), None
        try:
            return self._by(executor, Blocks(spans, _THERE, workers), workers, pending)
        finally:
            for future in pending:
                future.cancel()
            _end_broken(executor)

    def _by(
        self,
        executor: Executor,
        blocks: Blocks,
        workers: int,
        pending: dict[Future[Block], Span],
    ) -> Status:
        lost = 0
        while True:
            over = self._over()
            if over:
                for one in [one for one in pending if one.cancel()]:
                    del pending[one]
                if over == "interrupted":
                    self._wait_for_last(pending)
                    return over
            # the first tasks, one after another, say what names and shapes the numbers have
            room = 2 * workers if self._layout else 1
            while blocks and len(pending) < room and not over:
                span = blocks.take()
                future = self._submitted(executor, span)
                if future is None:
                    self._wait_for_last(pending)
                    return "workers_lost"
                pending[future] = span
            if not pending:
                return over or "completed"
            finished, _ = wait(pending, timeout=_LOOK, return_when=FIRST_COMPLETED)
            for ended in finished:
                span = pending.pop(ended)
                block = _result(ended)
                if block is None:
                    lost += 1
                    if lost >= _LOST:
                        self._wait_for_last(pending)
                        return "workers_lost"
                    blocks.give_back(span)
                    continue
                lost = 0
                self._done(block, blocks)
                if block.stop < span[1]:  # the function raised KeyboardInterrupt
                    self._interruption.count += 1
            self._idle()

    def _submitted(self, executor: Executor, span: Span) -> Future[Block] | None:
        try:
            return executor.submit(run_block, self._work, *span, self._layout)
        except BrokenExecutor:
            return None
        except (OSError, EOFError) as error:  # a worker could not be started
            self.reason = error
            return None
        except Exception as error:
            raise InputError(f"`executor` does not take tasks: {_one_line(error)}") from error

    def _done(self, block: Block, blocks: Blocks) -> None:
        self._layout = self._keep(block)
        blocks.measure(block)

    def _wait_for_last(self, pending: dict[Future[Block], Span]) -> None:
        """Keep the blocks that end within the grace, unless Ctrl-C comes again."""
        end, asked = time.monotonic() + _GRACE, self._interruption.count
        while pending and time.monotonic() < end and self._interruption.count <= max(1, asked):
            finished, _ = wait(pending, timeout=_LOOK, return_when=FIRST_COMPLETED)
            for future in finished:
                del pending[future]
                if (block := _result(future)) is not None:
                    self._layout = self._keep(block)


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


def _result(future: Future[Block]) -> Block | None:
    """The block, or None if its worker died."""
    try:
        block = future.result()
    except (BrokenExecutor, CancelledError):
        return None
    except Exception as error:
        if type(error).__name__ == "KilledWorker":  # by dask.distributed
            return None
        raise InputError(
            f"`executor` could not run `function`, which workers must be able to import: "
            f"{_one_line(error)}"
        ) from error
    if not isinstance(block, Block):
        raise InputTypeError(f"`executor` must return what tasks return, got {show(block)}")
    return block


def run_all(run: Run, executor: ExecutorLike, waiting: Callable[[], list[Span]]) -> Status:
    """Run the tasks that are `waiting`, with new executors in place of broken ones if they can be
    made.
    """
    if executor is None:
        return run.here(waiting())
    if isinstance(executor, Executor):
        return run.by(executor, waiting())
    left, tries = sum(stop - start for start, stop in waiting()), 0
    while True:
        made = executor()
        if not isinstance(made, Executor):
            raise InputTypeError(f"`executor` must make an executor, got {show(made)}")
        status: Status = "interrupted"
        try:
            status = run.by(made, waiting())
        finally:  # blocks that still run are not wanted
            _shut_down(made, wait=status == "completed")
        if status != "workers_lost":
            return status
        before, left = left, sum(stop - start for start, stop in waiting())
        tries = tries + 1 if left == before else 0
        if tries >= _LOST:
            if run.reason is not None:
                text = f"`executor` cannot start workers: {_one_line(run.reason)}"
                raise InputError(text) from run.reason
            return status
        if tries:  # a fork server, or room for processes, may come back
            run.pause(_PAUSE * 2 ** (tries - 1))


def _shut_down(executor: Executor, *, wait: bool) -> None:
    """Give up its workers; not all executors have an option to cancel what waits."""
    takes = inspect.signature(executor.shutdown).parameters
    options = {"cancel_futures": True} if "cancel_futures" in takes else {}
    executor.shutdown(wait=wait, **options)


def checked_executor(executor: object) -> ExecutorLike:
    """Return an executor, what makes one, or None."""
    if executor is None or isinstance(executor, Executor):
        return executor
    if hasattr(executor, "get_executor"):
        raise InputTypeError(
            f"`executor` must be a concurrent.futures.Executor, got {show(executor)}: pass "
            "client.get_executor(pure=False)"
        )
    if not callable(executor):
        raise InputTypeError(
            "`executor` must be a concurrent.futures.Executor or a function that makes one, "
            f"got {show(executor)}"
        )
    return executor


def workers_of(executor: Executor) -> int:
    """How many tasks an executor runs at a time, as far as it says so."""
    for name in ("_max_workers", "num_workers"):
        count = getattr(executor, name, None)
        if isinstance(count, int) and count > 0:
            return count
    client = getattr(executor, "_client", None)  # of dask.distributed
    if client is not None and hasattr(client, "ncores"):
        return max(1, int(sum(client.ncores().values())))
    return os.cpu_count() or 1


def _one_line(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]
