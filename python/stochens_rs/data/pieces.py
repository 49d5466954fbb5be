"""How pairs follow on each other: in runs, which gaps divide into pieces.

A piece is no run of its own: the noise before a gap is in the states behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..exceptions import InputError

LONGEST = 2**40  # steps of a gap, so that no sum of them overflows
NO_GAPS = np.zeros((0, 2), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Pieces:
    """Runs and their pieces.

    Attributes
    ----------
    lengths : ndarray, shape (R,)
        The number of pairs of each run.
    gaps : ndarray, shape (G, 2)
        Rows (t, s): between the pairs t - 1 and t, both of one run, s steps have no pair.
    lost : ndarray, shape (R,)
        The number of rows that the log of each run has lost.
    """

    lengths: NDArray[np.int64]
    gaps: NDArray[np.int64]
    lost: NDArray[np.int64]

    def __post_init__(self) -> None:
        for one in (self.lengths, self.gaps, self.lost):
            one.flags.writeable = False

    @classmethod
    def whole(cls, lengths: NDArray[np.int64]) -> Pieces:
        """Runs without gaps."""
        return cls(lengths, NO_GAPS, np.zeros(len(lengths), dtype=np.int64))

    @classmethod
    def checked(
        cls, lengths: NDArray[np.int64], gaps: NDArray[np.int64], lost: NDArray[np.int64]
    ) -> Pieces:
        """Check arrays that may come from anywhere; `lengths` are numbers of at least 1."""
        if gaps.dtype.kind not in "iu" or gaps.size % 2:
            raise InputError("`gaps` must be rows of two whole numbers")
        at, steps = gaps.reshape(-1, 2).astype(np.int64).T
        within = (at > 0) & (at < lengths.sum()) & ~np.isin(at, np.cumsum(lengths))
        if not (within & (steps > 0) & (steps <= LONGEST)).all() or (np.diff(at) <= 0).any():
            raise InputError("`gaps` must be rows (pair behind it, steps) inside runs, in order")
        counts = lost.astype(np.int64)
        if lost.dtype.kind not in "iu" or lost.shape != lengths.shape or (counts < 0).any():
            raise InputError(f"`lost` must have a number for each of {len(lengths)} runs")
        return cls(lengths, np.column_stack([at, steps]), counts)

    @classmethod
    def joined(cls, parts: Sequence[Pieces]) -> Pieces:
        """Runs one set after another."""
        before = np.cumsum([0, *(part.size for part in parts[:-1])])
        gaps = [part.gaps + np.array([t, 0]) for part, t in zip(parts, before, strict=True)]
        lengths, lost = ([getattr(one, name) for one in parts] for name in ("lengths", "lost"))
        return cls(np.concatenate(lengths), np.vstack(gaps), np.concatenate(lost))

    @property
    def size(self) -> int:
        """The number of pairs."""
        return int(self.lengths.sum())

    def starts(self) -> NDArray[np.int64]:
        """The first pair of each run."""
        return np.cumsum(self.lengths) - self.lengths

    def runs(self) -> NDArray[np.int64]:
        """The run of each pair."""
        return np.repeat(np.arange(len(self.lengths)), self.lengths)

    def places(self) -> NDArray[np.int64]:
        """The place of each pair in its piece: 0 if it does not follow on the one before."""
        first = np.zeros(self.size, dtype=np.int64)
        starts = np.append(self.starts(), self.gaps[:, 0])
        first[starts] = starts
        return np.arange(self.size) - np.maximum.accumulate(first)

    def skipped(self) -> NDArray[np.int64]:
        """The number of steps without a pair before each pair."""
        found = np.zeros(self.size, dtype=np.int64)
        found[self.gaps[:, 0]] = self.gaps[:, 1]
        return found

    def chosen(self, pairs: NDArray[np.bool_]) -> Pieces:
        """What is left of the pieces with some of the pairs, and of the runs that have one."""
        run = self.runs()[pairs]
        steps = np.diff(np.cumsum(self.skipped() + ~pairs)[pairs], prepend=0)
        behind = np.flatnonzero((np.diff(run, prepend=-1) == 0) & (steps > 0))
        kept, lengths = np.unique(run, return_counts=True)
        return Pieces(lengths, np.column_stack([behind, steps[behind]]), self.lost[kept])

    def same(self, other: Pieces) -> bool:
        """Whether runs, gaps and lost rows are equal."""
        mine, its = ((one.lengths, one.gaps, one.lost) for one in (self, other))
        return all(np.array_equal(a, b) for a, b in zip(mine, its, strict=True))
