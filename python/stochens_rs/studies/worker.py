"""What a worker does: a block of consecutive tasks of a study, and the numbers it found.

Task t is replicate ``t // size`` of configuration ``t % size``. Its key depends on the labels of
the configuration and on the number of the replicate, so no block depends on another one.
"""

from __future__ import annotations

import os
import platform
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .._base import validation
from .._base.threads import one_thread
from .._base.types import Floats
from .._base.validation import show
from .._core import version
from ..exceptions import InputError, InputTypeError
from ..rng import Key
from .grid import Grid

Function: TypeAlias = Callable[..., Mapping[str, Any]]
# The names of what a task returns, with the shape of each.
Layout: TypeAlias = dict[str, tuple[int, ...]]

WAITING, DONE, FAILED = 0, 1, 2  # the state of a task
_LONGEST = 300  # characters of the text of an error
_LOOK = 0.5  # seconds between two looks for the parent of a worker
_LONGEST_NAME = 50  # of a number that a task returns


@dataclass(frozen=True)
class Work:
    """What a worker needs to know of a study."""

    function: Function
    grid: Grid
    key: Key
    owner: int = field(default_factory=os.getpid)  # the process that has the signal handlers


@dataclass
class Block:
    """The tasks from `start` on, and what became of them."""

    start: int
    states: NDArray[np.uint8]
    layout: Layout = field(default_factory=dict)
    values: dict[str, Floats] = field(default_factory=dict)  # by name, one row for each task
    errors: dict[int, str] = field(default_factory=dict)  # by task
    platform: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def stop(self) -> int:
        """The task after the last one."""
        return self.start + len(self.states)

    def cut(self, count: int) -> None:
        """Keep the first tasks only."""
        self.states = self.states[:count]
        self.values = {name: rows[:count] for name, rows in self.values.items()}

    def take(self, position: int, found: object, grid: Grid) -> None:
        """Keep what the function returned for a task; raise if it does not fit."""
        if not isinstance(found, Mapping):
            raise InputTypeError(f"`function` must return a mapping of numbers, got {show(found)}")
        if not self.layout:
            self.lay_out(_layout_of(found, grid))
        if found.keys() != self.layout.keys():
            raise InputError(
                f"`function` must return the names {_listed(self.layout)}, got {_listed(found)}"
            )
        for name, shape in self.layout.items():
            value = found[name]
            if type(value) is not float:
                value = _number(name, value)
                if np.shape(value) != shape:
                    raise InputError(
                        f"`{name}` must have shape {shape} in all tasks, got {np.shape(value)}"
                    )
            elif shape:
                raise InputError(f"`{name}` must have shape {shape} in all tasks, got a number")
            self.values[name][position] = value

    def lay_out(self, layout: Layout) -> None:
        """Make room for the values."""
        count = len(self.states)
        self.layout = layout
        self.values = {name: np.full((count, *shape), np.nan) for name, shape in layout.items()}


class Interruption:
    """Whether a run is to stop, and whether a task runs that a signal may break off."""

    def __init__(self) -> None:
        self.count = 0
        self.number = 0  # of the first signal
        self.breakable = False


def run_block(
    work: Work, start: int, stop: int, layout: Layout, interruption: Interruption | None = None
) -> Block:
    """Run tasks; without `interruption` in a worker, which ignores Ctrl-C and uses one thread."""
    block = Block(start, np.zeros(stop - start, np.uint8), platform=fingerprint())
    if layout:
        block.lay_out(layout)
    began = time.perf_counter()
    if interruption is None:
        if os.getpid() != work.owner:
            end_with_parent()
        with _unsignalled(work.owner), one_thread():
            _run_tasks(work, block, Interruption())
    else:
        _run_tasks(work, block, interruption)
    block.seconds = time.perf_counter() - began
    return block


def _run_tasks(work: Work, block: Block, interruption: Interruption) -> None:
    size = work.grid.size
    configurations: dict[int, tuple[Key, dict[str, Any]]] = {}
    for position in range(len(block.states)):
        replicate, number = divmod(block.start + position, size)
        if number not in configurations:
            configurations[number] = (
                work.key.child(work.grid.text(number)),
                work.grid.configuration(number),
            )
        key, configuration = configurations[number]
        try:
            interruption.breakable = True
            if interruption.count:
                raise KeyboardInterrupt
            found = work.function(key.child(f"replicate {replicate}"), **configuration)
            interruption.breakable = False
            if not interruption.count:
                block.take(position, found, work.grid)
                block.states[position] = DONE
        except KeyboardInterrupt:
            interruption.count = max(1, interruption.count)
        except Exception as error:  # whatever the function raises
            block.states[position] = FAILED
            block.errors[block.start + position] = _told(error)
            for rows in block.values.values():
                rows[position] = np.nan
        finally:
            interruption.breakable = False
        # Results of this package may be partial after Ctrl-C, with the status "interrupted".
        if interruption.count:
            block.cut(position)
            block.errors.pop(block.start + position, None)
            return


def _layout_of(found: Mapping[str, Any], grid: Grid) -> Layout:
    """Names and shapes of what the function returned, if they can be those of a study."""
    layout = {name: np.shape(_number(name, value)) for name, value in found.items()}
    if not layout:
        raise InputError("`function` must return at least one number, got an empty mapping")
    for name, shape in layout.items():
        word = isinstance(name, str) and name.isascii() and name.isidentifier()
        if not word or name[0] == "_":
            raise InputError(f"`function` must return names as of arguments, got {show(name)}")
        if len(name) > _LONGEST_NAME or name in grid.labels or name == "replicate":
            raise InputError(
                f"`function` must return names other than the axes', of at most {_LONGEST_NAME} "
                f"characters, got {show(name)}"
            )
        if grid.nested is not None and shape[:1] != (len(grid.labels[grid.nested]),):
            raise InputError(
                f"`{name}` must have {len(grid.labels[grid.nested])} entries, one for each of "
                f"{grid.nested!r}, got shape {shape}"
            )
    return layout


def _number(name: str, value: object) -> Any:
    """A number or an array of numbers as float64."""
    found = np.asarray(value)
    if found.dtype.kind not in "biuf":
        hint = f": return {name}.real" if found.dtype.kind == "c" else ""
        raise InputTypeError(f"`{name}` must be a number or an array, got {show(value)}{hint}")
    if found.dtype.kind in "iu" and found.size and int(np.abs(found).max()) > validation.EXACT:
        raise InputError(f"`{name}` must be at most 2^53, got {show(value)}")
    return found.astype(np.float64)


def _listed(names: Mapping[str, Any]) -> str:
    return ", ".join(repr(name) for name in names)


def _told(error: Exception) -> str:
    """Type and message of an error on one line."""
    try:
        text = str(error)
    except Exception:  # a broken __str__
        text = ""
    told = " ".join(f"{type(error).__name__}: {text}".split()).strip(": ")
    clean = told.encode(errors="replace").decode()
    return clean if len(clean) <= _LONGEST else clean[: _LONGEST - 3] + "..."


@contextmanager
def _unsignalled(owner: int) -> Iterator[None]:
    """Ignore Ctrl-C in the process of a worker: the one that runs the study answers it."""
    if os.getpid() == owner or threading.current_thread() is not threading.main_thread():
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
            time.sleep(_LOOK)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@cache
def fingerprint() -> dict[str, str]:
    """What the bits of a number may depend on, beside the study: see `stochens_rs.Study`."""
    found = np.show_config(mode="dicts")["SIMD Extensions"]
    return {
        "stochens_rs": version(),
        "python": ".".join(platform.python_version_tuple()[:2]),
        "numpy": np.__version__,
        "platform": f"{platform.system()} {platform.machine()}",
        "processor": " ".join([*found.get("baseline", []), *found.get("found", [])]),
    }
