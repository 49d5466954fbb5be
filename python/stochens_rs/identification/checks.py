"""Tests of residuals with exact levels: warnings, never a licence for a region.

For z independent of Gaussian noise the law of ``chol(S)^-1 E`` is free of Theta and Sigma: the rank
of any statistic among simulated ones has an exact p-value at any N (Dufour and Khalaf 2002).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base import html, validation
from .._base.records import Record, trusted
from .._base.threads import get_num_threads
from ..exceptions import InputError
from ..rng import Key, as_key
from .dependences import spanned

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .._base.types import Floats


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
        away = f"{html.two(self.distances[name])} standard deviations off"
        return f"p <= {p:.2g}, beyond all {self.draws} simulated, {away}"

    def __repr__(self) -> str:
        name = min(NAMES, key=lambda one: (self.p_values[one], -self.distances[one]))
        kind = "exact" if self.exact else "approximate"
        return f"<Checks: smallest of 5 {kind} p-values: {name}, {self._said(name)}>"

    def _repr_html_(self) -> str:
        return html.card(self, [(name, self._said(name)) for name in NAMES])


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
