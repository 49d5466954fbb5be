"""Blocks of consecutive tasks of a study, their numbers, and the table of all of them.

Task t is replicate ``t // size`` of configuration ``t % size``. Its key depends on the labels of
the configuration and on the number of the replicate, so no block depends on another one.
"""

from __future__ import annotations

import math
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .._base import running, validation
from .._base.types import Floats
from .._base.validation import show
from .._core import version
from ..exceptions import InputError, InputTypeError, StateError
from .grid import Grid

# The names of what a task returns, with the shape of each.
Layout: TypeAlias = dict[str, tuple[int, ...]]
Span: TypeAlias = tuple[int, int]  # tasks: the first, and the one after the last

WAITING, DONE, FAILED = 0, 1, 2  # the state of a task
_LONGEST_NAME = 50  # of a number that a task returns


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

    def lay_out(self, layout: Layout) -> None:
        """Make room for the values."""
        self.layout, count = layout, len(self.states)
        self.values = {name: np.full((count, *shape), np.nan) for name, shape in layout.items()}

    def take(self, position: int, found: object, grid: Grid) -> None:
        """Keep what the function returned for a task; raise if it does not fit."""
        if not isinstance(found, Mapping):
            raise InputTypeError(f"`function` must return a mapping of numbers, got {show(found)}")
        if not self.layout:
            self.lay_out(_layout_of(found, grid))
        if found.keys() != self.layout.keys():
            ours, theirs = (", ".join(map(repr, names)) for names in (self.layout, found))
            raise InputError(f"`function` must return the names {ours}, got {theirs}")
        for name, shape in self.layout.items():
            value = found[name] if type(found[name]) is float else _number(name, found[name])
            if (has := np.shape(value)) != shape:
                raise InputError(f"`{name}` must have shape {shape} in all tasks, got {has}")
            self.values[name][position] = value
        self.states[position] = DONE

    def cut(self, count: int) -> None:
        """Keep the first tasks only."""
        self.states = self.states[:count]
        self.values = {name: rows[:count] for name, rows in self.values.items()}


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


class Table:
    """States and numbers of the tasks `span`, filled by blocks in any order."""

    def __init__(self, span: Span) -> None:
        self.span = span
        running.need("the states of the replicates", span[1] - span[0])
        self.states: NDArray[np.uint8] = np.zeros(span[1] - span[0], np.uint8)
        self.layout: Layout = {}
        self.values: dict[str, Floats] = {}
        self.errors: dict[int, str] = {}
        self._texts: dict[str, str] = {}  # so that a text that occurs often is kept once
        self.platforms: list[dict[str, str]] = []

    def add(self, block: Block) -> None:
        """Enter a block; numbers that are there must be the same, a failure may be replaced."""
        if not self.span[0] <= block.start <= block.stop <= self.span[1]:
            raise StateError("its `replicates` reach beyond those of this study")
        if block.layout and not self.layout:
            count = len(self.states)
            entries = sum(math.prod(shape) for shape in block.layout.values())
            running.need("the numbers of the replicates", 8 * count * entries)
            room = {k: np.full((count, *shape), np.nan) for k, shape in block.layout.items()}
            self.layout, self.values = dict(block.layout), room
        if block.layout and block.layout != self.layout:
            raise StateError("two blocks differ in the names or shapes of their numbers")
        here = slice(block.start - self.span[0], block.stop - self.span[0])
        old, new = self.states[here], block.states
        twice = (old == DONE) & (new == DONE)
        for name, rows in block.values.items():
            if twice.any() and rows[twice].tobytes() != self.values[name][here][twice].tobytes():
                raise StateError(f"two blocks differ in `{name}` of the same replicates")
        fresh = (new != WAITING) & (old != DONE)
        for name, rows in block.values.items():
            self.values[name][here][fresh] = rows[fresh]
        for task in (np.flatnonzero(fresh & (old == FAILED)) + block.start).tolist():
            self.errors.pop(task, None)
        old[fresh] = new[fresh]
        for task, text in block.errors.items():
            if self.states[task - self.span[0]] == FAILED:
                self.errors[task] = self._texts.setdefault(text, text)
        if block.platform and block.platform not in self.platforms:
            self.platforms.append(block.platform)

    def forget_failures(self) -> None:
        """Let failed tasks run again."""
        self.states[self.states == FAILED] = WAITING
        self.errors.clear()

    def spans(self, chosen: NDArray[np.bool_]) -> list[Span]:
        """The runs of consecutive tasks that are chosen, in order."""
        edges = np.flatnonzero(np.diff(np.r_[False, chosen, False].astype(np.int8)))
        return [(a + self.span[0], b + self.span[0]) for a, b in edges.reshape(-1, 2).tolist()]

    def block(self, span: Span, platform: dict[str, str]) -> Block:
        """The tasks `span` as a block."""
        here = slice(span[0] - self.span[0], span[1] - self.span[0])
        errors = {t: text for t, text in self.errors.items() if span[0] <= t < span[1]}
        values = {name: rows[here] for name, rows in self.values.items()}
        return Block(span[0], self.states[here], dict(self.layout), values, errors, platform)

    def count(self, state: int) -> int:
        """How many tasks are in this state."""
        return int(np.count_nonzero(self.states == state))


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
