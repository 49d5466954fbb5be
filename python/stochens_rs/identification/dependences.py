"""Columns that are no states of a plant: exact dependences.

A finite difference of readings leaves residuals of which a combination is 0 for all pairs. Regions
do not hold for it, and say nothing of it: where this is found and not declared, no certificate is
finite.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .._base import html

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .. import _core
    from .._base.types import Floats
    from .assumptions import Assumptions

# Least eigenvalue of the correlation matrix of residuals that is taken for 0. With a covariance of
# full rank it is below with a probability of order (1e-4 n)^2, as there are more pairs than needed.
SINGULAR = 1e-8
ROUNDING = 10.0  # times what rounding may change, below which a residual is 0


class Range(NamedTuple):
    """What the residuals of some rows span: those that are 0, and a basis of the others.

    `rows` are tested; `zero` of them have no residual. ``Y[:, rows] @ basis`` has residuals that
    are independent, and `tied` (rows, k) combinations of residuals, in units of each, that are 0.
    """

    rows: NDArray[np.int64]
    zero: NDArray[np.int64]
    basis: Floats
    tied: Floats


def tested_rows(assumed: Assumptions, known: Floats | None, n: int) -> NDArray[np.int64]:
    """The states that are not declared as exact, by `exact` or as rows of a known A."""
    rows = np.setdiff1d(np.arange(n), np.array(assumed.exact, dtype=np.int64))
    return rows if known is None else rows[np.isnan(known[rows, :n]).any(axis=1)]


def spanned(f: _core.Fitted, rows: NDArray[np.int64]) -> Range:
    """What the residuals of these rows span."""
    S = f.S[np.ix_(rows, rows)]
    sizes = np.sqrt(np.diag(S))
    live = sizes > ROUNDING * f.rounding[rows]
    scale = sizes[live]
    values, vectors = np.linalg.eigh(S[np.ix_(live, live)] / scale[:, None] / scale)
    apart = values > SINGULAR
    spread = np.zeros((len(rows), len(scale)))
    spread[live] = vectors / scale[:, None]
    tied = np.zeros((len(rows), int((~apart).sum())))
    tied[live] = vectors[:, ~apart]
    return Range(rows, rows[~live], spread[:, apart], tied)


def exact_relations(f: _core.Fitted, found: Range, names: Sequence[str]) -> tuple[str, ...]:
    """What is said of residuals that are 0, or tied to each other, where pairs are left to see it.

    The columns after "declare" leave others that are independent.
    """
    if f.nu <= len(f.S):
        return ()
    said = []
    if len(found.zero):
        some = [names[i] for i in found.zero]
        said.append(
            f"{html.listed(some)} {'have' if len(some) > 1 else 'has'} no residual: computed from "
            "the other columns, or without noise. If that is how the plant is, declare "
            f"exact={_short(some)}"
        )
    if found.tied.shape[1]:
        last, left = _reduced(found.tied)
        involved = [names[found.rows[i]] for i in np.flatnonzero(np.abs(left).max(axis=1) > 1e-6)]
        some = [names[found.rows[i]] for i in sorted(last)]
        said.append(
            f"the residuals of {html.listed(involved)} are tied exactly: a column was computed "
            "from others, as a finite difference or a filter; then leave it out, and pass the "
            "others as outputs=. If all are exact states, and the noise has fewer sources than "
            f"states, declare exact={_short(some)}"
        )
    return tuple(said)


def _short(names: list[str]) -> str:
    return repr(names) if len(names) <= 4 else f"[{', '.join(map(repr, names[:3]))}, ...]"


def _reduced(tied: Floats) -> tuple[list[int], Floats]:
    """Gauss and Jordan with pivots: a row of its own for each column; of equal ones the last."""
    left, pivots = tied.copy(), list[int]()
    for k in range(left.shape[1]):
        size = np.round(np.abs(left[:, k:]), 9)
        size[pivots] = 0.0
        row = int(np.flatnonzero(size.max(axis=1) == size.max())[-1])
        column = k + int(np.argmax(size[row]))
        left[:, [k, column]] = left[:, [column, k]]
        left[:, k] /= left[row, k]
        others = np.arange(left.shape[1]) != k
        left[:, others] -= np.outer(left[:, k], left[row, others])
        pivots.append(row)
    return pivots, left
