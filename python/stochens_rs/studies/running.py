"""Runs the tasks of a study, in this process or by an executor, in blocks of measured cost."""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from types import FrameType
from typing import Any, TypeAlias

import numpy as np

from .._base import validation
from .._base.running import one_thread
from .._base.types import Floats, NDArray, Status
from .._base.validation import show
from ..exceptions import InputError, InputTypeError
from ..rng import Key
from .tasks import DONE, FAILED, OWN, Block, Grid, Layout, fingerprint, room

Function: TypeAlias = Callable[..., Mapping[str, Any]]

_HERE, _THERE = 0.1, 0.5  # seconds that a block is to take, in this process and in a worker
_GROWTH = 4  # a block has at most this many times the tasks of the largest before it
_LOOK = 0.1  # seconds between two looks for signals and the time
_GRACE = 5.0  # seconds that running blocks get to end after Ctrl-C
_LONGEST = 300  # characters of the text of an error


@dataclass(eq=False)
class Interruption:
    """Whether a run is to stop, and whether a task runs that a signal may break off."""

    count: int = 0
    number: int = 0  # of the first signal
    breakable: bool = False


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
    work: Work, tasks: NDArray[np.int64], layout: Layout, interruption: Interruption | None = None
) -> Block:
    """Run tasks; without `interruption` in a worker, which ignores Ctrl-C and uses one thread.

    After an interruption the block has those that were done before.
    """
    if interruption is not None:
        return _run_tasks(work, tasks, layout, interruption)
    with ExitStack() as stack:
        stack.enter_context(one_thread())
        if os.getpid() != work.owner:
            end_with_parent()
            if threading.current_thread() is threading.main_thread():
                before = signal.signal(signal.SIGINT, signal.SIG_IGN)
                stack.callback(signal.signal, signal.SIGINT, before or signal.SIG_DFL)
        return _run_tasks(work, tasks, layout, Interruption())


def _run_tasks(
    work: Work, tasks: NDArray[np.int64], layout: Layout, interruption: Interruption
) -> Block:
    began, states, errors = time.perf_counter(), [], []
    values: dict[str, Floats] = {}
    configurations: dict[int, tuple[Key, dict[str, Any]]] = {}
    for position, task in enumerate(tasks.tolist()):
        replicate, number = divmod(task, work.grid.size)
        if number not in configurations:
            key = work.key.child(work.grid.text(number))
            configurations[number] = key, work.grid.configuration(number)
        key, configuration = configurations[number]
        state, failure = DONE, []
        try:
            interruption.breakable = True
            if interruption.count:
                raise KeyboardInterrupt
            found = work.function(key.child(f"replicate {replicate}"), **configuration)
            interruption.breakable = False
            row, layout = _fitted(found, layout, work.grid)
            values = values or room(layout, len(tasks))
            for name, value in row.items():
                values[name][position] = value
        except KeyboardInterrupt:
            interruption.count = max(1, interruption.count)
        except Exception as error:  # whatever the function raises
            state, failure = FAILED, [_one_line(error)]
        finally:
            interruption.breakable = False
        # Results of this package may be partial after Ctrl-C, with the status "interrupted".
        if interruption.count:
            break
        states.append(state)
        errors += failure
    count, seconds = len(states), time.perf_counter() - began
    done = {name: rows[:count] for name, rows in values.items()} if DONE in states else {}
    states_of = np.array(states, np.int8)
    return Block(tasks[:count], states_of, done, tuple(errors), fingerprint(), seconds)


def _fitted(found: object, layout: Layout, grid: Grid) -> tuple[dict[str, Any], Layout]:
    """What the function returned as numbers, and their names and shapes, if they are to be had."""
    if not isinstance(found, Mapping) or not found:
        raise InputTypeError(f"`function` must return a mapping of numbers, got {show(found)}")
    row = {k: v if type(v) is float else _number(k, v) for k, v in found.items()}
    layout = layout or {name: np.shape(value) for name, value in row.items()}
    if row.keys() != layout.keys():
        ours, theirs = (", ".join(map(repr, names)) for names in (layout, row))
        raise InputError(f"`function` must return the names {ours}, got {theirs}")
    for name, shape in layout.items():
        if (has := np.shape(row[name])) != shape:
            raise InputError(f"`{name}` must have shape {shape} in all tasks, got {has}")
        if not isinstance(name, str) or not name.isidentifier() or name in (*grid.labels, *OWN):
            raise InputError(f"`function` must return names that are no axes, got {show(name)}")
        if grid.nested is not None and shape[:1] != (len(grid.labels[grid.nested]),):
            raise InputError(f"`{name}` must have an entry for each {grid.nested!r}, got {shape}")
    return row, layout


def _number(name: str, value: object) -> Any:
    """A number or an array of numbers as float64."""
    found = np.asarray(value)
    if found.dtype.kind not in "biuf":
        hint = f": return {name}.real" if found.dtype.kind == "c" else ""
        raise InputTypeError(f"`{name}` must be a number or an array, got {show(value)}{hint}")
    if found.dtype.kind in "iu" and found.size and int(np.abs(found).max()) > validation.EXACT:
        raise InputError(f"`{name}` must be at most 2^53, got {show(value)}")
    return found.astype(np.float64)


def _one_line(error: BaseException) -> str:
    """Type and message of an error."""
    try:
        text = str(error)
    except Exception:  # a broken __str__
        text = ""
    line = " ".join(f"{type(error).__name__}: {text}".split()).strip(": ")
    clean = line.encode(errors="replace").decode()
    return clean if len(clean) <= _LONGEST else clean[: _LONGEST - 3] + "..."


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


class Pace:
    """How many tasks make a block: many, but so that all workers end together."""

    def __init__(self, seconds: float, workers: int) -> None:
        self._seconds, self._workers = seconds, workers
        self._cost: float | None = None  # seconds for one task
        self._largest = 1

    def size(self, left: int) -> int:
        """The number of tasks of the next block."""
        if self._cost is None:
            return 1
        fair = -(-left // (2 * self._workers))
        return max(1, min(int(self._seconds / self._cost), _GROWTH * self._largest, fair))

    def measure(self, block: Block) -> None:
        """Learn from a block what a task costs."""
        if count := len(block.tasks):
            cost = max(block.seconds / count, 1e-7)
            self._cost = cost if self._cost is None else (self._cost + cost) / 2
            self._largest = max(self._largest, count)


def run_tasks(
    work: Work,
    waiting: NDArray[np.int64],
    layout: Layout,
    keep: Callable[[Block | None], Layout],
    executor: Executor | None,
    interruption: Interruption,
    end: float,
) -> Status:
    """Run tasks until the time `end`, in this process or by an executor.

    `keep` gets each block, and None now and then. Raises if the executor does not take tasks, or
    its workers die.
    """

    def submitted(tasks: NDArray[np.int64]) -> Future[Block]:
        if executor is not None:
            with _executor_errors("does not take tasks"):
                return executor.submit(run_block, work, tasks, layout)
        future: Future[Block] = Future()
        future.set_result(run_block(work, tasks, layout, interruption))
        return future

    workers = 1 if executor is None else _workers_of(executor)
    pace = Pace(_HERE if executor is None else _THERE, workers)
    most = 1 if executor is None else 2 * workers
    pending: dict[Future[Block], int] = {}  # and how many tasks each has
    over: Status | None = None
    asked, patience = 1, math.inf
    try:
        while pending or (len(waiting) and not over):
            if interruption.count and over != "interrupted":
                over, asked = "interrupted", interruption.count
                patience = time.monotonic() + _GRACE
            elif not over and time.monotonic() >= end:
                over = "time_limit"
            if over:
                pending = {one: count for one, count in pending.items() if not one.cancel()}
            if interruption.count > asked or time.monotonic() >= patience:
                break
            # the first tasks, one after another, say what names and shapes the numbers have
            while len(waiting) and not over and len(pending) < (most if layout else 1):
                tasks = waiting[: pace.size(len(waiting))]
                pending[submitted(tasks)] = len(tasks)
                waiting = waiting[len(tasks) :]
            finished, _ = wait(pending, timeout=_LOOK, return_when=FIRST_COMPLETED)
            for future in finished:
                count = pending.pop(future)
                try:
                    with _executor_errors("could not run `function`, which workers must import"):
                        block = future.result()
                except InputError:
                    if over == "interrupted":  # a worker that died of the same signal
                        continue
                    raise
                layout = keep(block)
                pace.measure(block)
                if len(block.tasks) < count:  # the function raised KeyboardInterrupt
                    interruption.count = max(1, interruption.count)
            keep(None)
        return over or ("interrupted" if interruption.count else "completed")
    finally:
        for future in pending:
            future.cancel()
        _end_broken(executor)


@contextmanager
def _executor_errors(otherwise: str) -> Iterator[None]:
    """Say what is wrong with an executor: workers that died or cannot be started, or else."""
    try:
        yield
    except (Exception, CancelledError) as error:
        died = isinstance(error, (BrokenExecutor, CancelledError, OSError, EOFError))
        if died or type(error).__name__ == "KilledWorker":  # of dask.distributed
            otherwise = "has lost its workers: run the study on with a new one"
        raise InputError(f"`executor` {otherwise} ({_one_line(error)})") from error


def _end_broken(executor: Executor | None) -> None:
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
    raise InputTypeError(f"`executor` must be of concurrent.futures, got {show(executor)}{dask}")


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
