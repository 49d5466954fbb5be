"""Tests of residuals with exact levels, exact dependences, and what to be careful about."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .. import _core
from .._base import show, validation
from .._base.records import Record, trusted
from .._base.running import get_num_threads
from ..exceptions import InputError
from ..rng import Key, as_key

if TYPE_CHECKING:
    from numpy.typing import NDArray

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
            f"{show.listed(some)} {'have' if len(some) > 1 else 'has'} no residual: computed from "
            "the other columns, or without noise. If that is how the plant is, declare "
            f"exact={_short(some)}"
        )
    if found.tied.shape[1]:
        last, left = _reduced(found.tied)
        involved = [names[found.rows[i]] for i in np.flatnonzero(np.abs(left).max(axis=1) > 1e-6)]
        some = [names[found.rows[i]] for i in sorted(last)]
        said.append(
            f"the residuals of {show.listed(involved)} are tied exactly: a column was computed "
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


NAMES = ("correlation in time", "correlation at lag 1", "tails", "heteroscedasticity", "change")
HINTS = (
    "noise that lasts, states measured with error, or a window of readings that is too short",
    "states measured with error, noise that lasts, or a window of readings that is too short",
    "noise that is not Gaussian; alone it does little harm",
    "noise that grows with the states or inputs: regions are too small",
    "a system or a noise that changed between the halves of the data",
)
DRAWS = 499
LEVEL = 0.01  # of a warning, over all tests together
WORK = 1.6e8  # normal variates that `identify` draws at most, about three seconds of one core
KEY = as_key(20_020_101).child("residual tests")  # fixed, so that p-values repeat


@dataclass(frozen=True, eq=False, repr=False)
class Checks(Record):
    """Tests of the residuals of a model, each with its p-value.

    Attributes
    ----------
    p_values : dict of str to float
        "correlation in time" (lags 1 to 5), "correlation at lag 1", "tails" (Mardia's kurtosis),
        "heteroscedasticity" (squared residuals against leverages), "change" (the two halves of
        the data). Small where an assumption fails.
    distances : dict of str to float
        How far each statistic is from the mean of the simulated ones, in their standard deviations:
        what tells p-values at their least apart.
    draws : int
        The number of simulated data sets; no p-value is below ``1 / (draws + 1)``.
    exact : bool
        Whether the p-values are exact under Gaussian noise; False for runs, where they are
        approximate.
    """

    p_values: dict[str, float]
    distances: dict[str, float]
    draws: int
    exact: bool

    def __post_init__(self) -> None:
        super().__post_init__()
        validation.size("draws", self.draws)
        validation.flag("exact", self.exact)
        for name in NAMES:
            validation.positive(name, self.p_values.get(name), maximum=1.0)
            if not np.isfinite(self.distances.get(name, np.nan)):
                raise InputError(f"`distances` must have a number for {name}")

    def failed(self, level: float = LEVEL) -> tuple[str, ...]:
        """Name the tests that reject.

        Parameters
        ----------
        level : float, default 0.01
            Probability of any false alarm: each of the five tests has a fifth of it.

        Returns
        -------
        tuple of str
            Their names; empty if no assumption is seen to fail, which proves none of them.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> z = np.random.default_rng(1).standard_normal((40, 3))
        >>> data = se.Trajectories.from_pairs(z[:, :1], z[:, 1:2], z[:, :1] + z[:, 2:])
        >>> se.identify(data).checks.failed()
        ()
        """
        share = validation.probability("level", level) / len(NAMES)
        return tuple(name for name in NAMES if self.p_values[name] <= share * (1.0 + 1e-9))

    @property
    def warnings(self) -> tuple[str, ...]:
        """One sentence for each test that rejects at the default level."""
        hints = dict(zip(NAMES, HINTS, strict=True))
        return tuple(
            f"{name} in the residuals ({self._said(name)}): {hints[name]}" for name in self.failed()
        )

    def _said(self, name: str) -> str:
        """The p-value; where none is smaller, how far off the statistic is."""
        p = self.p_values[name]
        if p > 1.0 / (self.draws + 1) * (1.0 + 1e-9):
            return f"p = {p:.2g}"
        away = f"{show.two(self.distances[name])} standard deviations off"
        return f"p <= {p:.2g}, beyond all {self.draws} simulated, {away}"

    def __repr__(self) -> str:
        name = min(NAMES, key=lambda one: (self.p_values[one], -self.distances[one]))
        kind = "exact" if self.exact else "approximate"
        return f"<Checks: smallest of 5 {kind} p-values: {name}, {self._said(name)}>"

    def _repr_html_(self) -> str:
        return show.card(self, [(name, self._said(name)) for name in NAMES])


def checked_residuals(
    Z: Floats,
    Y: Floats,
    rows: NDArray[np.int64],
    *,
    exact: bool,
    draws: int = DRAWS,
    key: Key = KEY,
) -> Checks | None:
    """Test the residuals of least squares of `Y` on `Z`; None with too few pairs for a test.

    Of the states `rows`, and where their residuals are tied to each other, of as many combinations
    as are not: the statistics are those of any basis.
    """
    f = _core.fit(np.hstack([Z, Y]), Z.shape[1], len(Z), get_num_threads())
    basis = spanned(f, rows).basis
    count = basis.shape[1]
    if f.rank < 1 or count < 1 or f.nu < len(f.S) or len(Z) < 4:
        return None
    free = np.ascontiguousarray(Y[:, rows] @ basis)
    found = _core.residual_p_values(Z, free, f.white, draws, bytes(key), get_num_threads())
    p_values, distances = (dict(zip(NAMES, one.tolist(), strict=True)) for one in found)
    return trusted(Checks, p_values, distances, draws, exact)


# ratio of singular values, about sqrt(EPS), below which a decision on the rank is delicate: the
# directions that the data do not determine are then known to fewer than half of the digits
TRUSTED = 1e-8


def missing_directions(found: Sequence[_core.Fitted], names: Sequence[str]) -> tuple[str, ...]:
    """The directions that the data do not determine in any block, ``x[1] - 0.5 u[0]``."""
    said: dict[str, None] = {}
    for block in found:
        own = [names[j] for j in block.columns]
        said |= dict.fromkeys(_combination(row, own) for row in block.combinations())
    return tuple(said)


def _combination(row: Floats, names: Sequence[str]) -> str:
    text = ""
    for value, name in zip(row, names, strict=True):
        if value == 0.0:
            continue
        number = "" if abs(abs(value) - 1.0) < 5e-4 else f"{abs(value):.3g} "
        sign = ("-" if value < 0.0 else "") if not text else (" - " if value < 0.0 else " + ")
        text += f"{sign}{number}{name}"
    return text


def cautions(found: Sequence[_core.Fitted], missing: tuple[str, ...]) -> list[str]:
    """What to be careful about in the fits of the rows of a model."""
    said = []
    if missing:
        said.append(f"the data do not determine the model along {'; '.join(missing)}")
    ratio = min((one.ratio for one in found if one.rank), default=1.0)
    if ratio < TRUSTED:
        said.append(
            f"the states and inputs are nearly dependent (ratio {ratio:.1e}): bounds are large"
        )
    return said
