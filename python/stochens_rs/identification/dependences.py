"""Columns that are no states of a plant: exact dependences, and one more lag that explains.

A finite difference of readings leaves residuals of which a combination is 0 for all pairs, and
smoothed or noisy readings leave residuals that earlier readings explain. Regions do not hold for
them, and say nothing of it: where this is found and not declared, no certificate is finite.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .. import _core
from .._base import html, memory
from .._base.threads import get_num_threads
from ..theory.exact import EPS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .._base.types import Floats
    from .assumptions import Assumptions

# Least eigenvalue of the correlation matrix of residuals that is taken for 0. With a covariance of
# full rank it is below with a probability of order (1e-4 n)^2, as there are more pairs than needed.
SINGULAR = 1e-8
ROUNDING = 10.0  # times what rounding may change, below which a residual is 0
LEVEL = 1e-4  # of the test of one more lag
REFUSED = 0.1  # explained share of the variance from which that refuses


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


class Lag(NamedTuple):
    """What states and inputs one step earlier explain of the residuals.

    `explained` is ``1 - (det S_1 / det S_0)^(1 / n)``, `each` the same for each row alone.
    """

    rows: NDArray[np.int64]
    explained: float
    each: Floats
    significant: bool

    @property
    def refuses(self) -> bool:
        """Whether no certificate is to be trusted."""
        return self.significant and self.explained >= REFUSED

    def said(self, names: Sequence[str]) -> str:
        """In words, with the columns of which most is explained."""
        some = [names[self.rows[i]] for i in np.flatnonzero(self.each >= 0.5 * self.each.max())]
        then = (
            "they are no states of the plant, or read with error, smoothed or differenced: pass "
            "what was read as outputs=; or the plant is not linear"
            if self.refuses
            else "noise that lasts, a state that is missing, or errors of reading"
        )
        return (
            "one step earlier, states and inputs explain "
            f"{html.two(100 * self.explained)} % more of the variance of {html.listed(some)} "
            f"(p < {LEVEL:g}): {then}"
        )

    @property
    def said_of_constant(self) -> str:
        """The same of a constant in place of a lag."""
        return (
            f"a constant explains {html.two(100 * self.explained)} % more of the variance "
            f"(p < {LEVEL:g}), as of a force that always acts: pass intercept=True"
        )


def rows_with_a_lag(
    rows: Floats, later: NDArray[np.int64], n: int, offset: bool
) -> tuple[Floats, int]:
    """The rows (z, x and u one step earlier, x_next), ``z = (x, u, 1)``, and the length of z.

    `rows` are (x, u, x_next); those with an index in `later` follow on the one before them.
    """
    extra = rows.shape[1] - n
    memory.need("the pairs with those before", 16 * len(later) * (2 * extra + offset + n))
    z, before = rows[later, :extra], rows[later - 1, :extra]
    one = np.ones((len(later), int(offset)))
    return np.hstack([z, one, before, rows[later][:, extra:]]), extra + offset


def one_more_lag(rows: Floats, d: int, n: int, found: Range) -> Lag | None:
    """Test whether residuals of the regressors z are explained by more of them.

    `rows` are (z, more regressors, n outcomes), z being d of them.

    Wilks' Lambda ``det S_1 / det S_0`` by Rao's F, exact for one or two rows or columns and
    regressors independent of Gaussian noise (Rao 1951), else approximate. None where no test is
    possible: runs of one step, too few pairs, no residuals.
    """
    size, every, p = len(rows), rows.shape[1] - n, found.basis.shape[1]
    if not p or size <= every + p:
        return None
    own = np.r_[:every, every + found.rows]
    R = _core.triangle(np.ascontiguousarray(rows[:, own]), get_num_threads())
    wide = _core.fit(R, every, size, 1)
    keep = np.r_[:d, every : len(R)]
    narrow = _core.fit(np.ascontiguousarray(R[:, keep]), d, size, 1)
    q, nu = wide.rank - narrow.rank, wide.nu
    if q < 1 or nu <= p:
        return None
    S1, S0 = (found.basis.T @ f.S @ found.basis for f in (wide, narrow))
    values, vectors = np.linalg.eigh(S0)
    if not values[0] > 0.0:
        return None
    white = vectors / np.sqrt(values)
    # what is explained but for rounding counts as EPS
    log_ratio = float(np.log(np.clip(np.linalg.eigvalsh(white.T @ S1 @ white), EPS, 1.0)).sum())
    # Rao: ((1 - L^(1/t)) / L^(1/t)) b / a ~ F(a, b), a = p q, b = t (nu + q - (p+q+1)/2) - (pq-2)/2
    t = np.sqrt((p * p * q * q - 4.0) / (p * p + q * q - 5.0)) if p * p + q * q > 5 else 1.0
    a, b = float(p * q), t * (nu + q - (p + q + 1) / 2.0) - (p * q - 2) / 2.0
    F = float(np.expm1(-log_ratio / t)) * b / a
    live = np.isin(found.rows, found.zero, invert=True)
    each = np.zeros(len(live))
    np.divide(np.diag(wide.S), np.diag(narrow.S), out=each, where=live)
    explained = -float(np.expm1(log_ratio / p))
    significant = b > 0.0 and _core.f_upper(LEVEL, a, b) < F
    return Lag(found.rows, explained, np.where(live, 1.0 - each, 0.0), significant)
