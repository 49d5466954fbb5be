"""The numbers of all tasks of a study: one array for each name, in the order of the replicates."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .._base import memory
from .._base.types import Floats
from ..exceptions import StateError
from .worker import DONE, FAILED, WAITING, Block, Layout

Span = tuple[int, int]  # tasks: the first, and the one after the last


class Table:
    """States and numbers of the tasks `span`, filled by blocks in any order."""

    def __init__(self, span: Span) -> None:
        self.span = span
        memory.need("the states of the replicates", span[1] - span[0])
        self.states: NDArray[np.uint8] = np.zeros(span[1] - span[0], np.uint8)
        self.layout: Layout = {}
        self.values: dict[str, Floats] = {}
        self.errors: dict[int, str] = {}
        self._texts: dict[str, str] = {}  # so that a text that occurs often is kept once
        self.platforms: list[dict[str, str]] = []

    def lay_out(self, layout: Layout) -> None:
        """Make room for the numbers of all tasks; the first layout stays."""
        if self.layout or not layout:
            return
        count = len(self.states)
        entries = sum(math.prod(shape) for shape in layout.values())
        memory.need("the numbers of the replicates", 8 * count * entries)
        self.values = {name: np.full((count, *shape), np.nan) for name, shape in layout.items()}
        self.layout = dict(layout)

    def add(self, block: Block) -> None:
        """Enter a block; numbers that are there must be the same, a failure may be replaced."""
        self.lay_out(block.layout)
        if block.layout and block.layout != self.layout:
            raise StateError("two blocks differ in the names or shapes of their numbers")
        here = slice(block.start - self.span[0], block.stop - self.span[0])
        old, new = self.states[here], block.states
        twice = (old == DONE) & (new == DONE)
        for name, rows in block.values.items():
            if twice.any() and rows[twice].tobytes() != self.values[name][here][twice].tobytes():
                raise StateError(f"two blocks differ in `{name}` of the same replicates")
        kept = (new != WAITING) & (old != DONE)
        for name, rows in block.values.items():
            self.values[name][here][kept] = rows[kept]
        for task in (np.flatnonzero(kept & (old == FAILED)) + block.start).tolist():
            self.errors.pop(task, None)
        old[kept] = new[kept]
        for task, text in block.errors.items():
            if self.states[task - self.span[0]] == FAILED:
                self.errors[task] = self._texts.setdefault(text, text)
        if block.platform and block.platform not in self.platforms:
            self.platforms.append(block.platform)

    def forget_failures(self) -> int:
        """Let failed tasks run again; returns their number."""
        failed = self.states == FAILED
        self.states[failed] = WAITING
        self.errors.clear()
        return int(failed.sum())

    def waiting(self) -> list[Span]:
        """The tasks that have not run."""
        return list(self.spans(self.states == WAITING))

    def spans(self, chosen: NDArray[np.bool_]) -> Iterator[Span]:
        """The runs of consecutive tasks that are chosen, in order."""
        edges = np.flatnonzero(np.diff(np.r_[False, chosen, False].astype(np.int8)))
        for first, end in edges.reshape(-1, 2).tolist():
            yield first + self.span[0], end + self.span[0]

    def block(self, span: Span, platform: dict[str, str]) -> Block:
        """The tasks `span` as a block."""
        here = slice(span[0] - self.span[0], span[1] - self.span[0])
        errors = {t: text for t, text in self.errors.items() if span[0] <= t < span[1]}
        values = {name: rows[here] for name, rows in self.values.items()}
        return Block(span[0], self.states[here], dict(self.layout), values, errors, platform)

    def count(self, state: int) -> int:
        """How many tasks are in this state."""
        return int(np.count_nonzero(self.states == state))
