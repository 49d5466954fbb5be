"""Bounds from simulated errors, within a few percent of the quantile they bound."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ... import _core
from ..._base import validation
from ..._base.types import Floats, Scheme
from ...exceptions import SizeError
from ...rng import Key
from ..formulas import Sizes
from .base import ENTITIES, Bound, Rates
from .drawn_errors import (
    ErrorLaw,
    EstimateErrors,
    PlanErrors,
    least_delta,
    not_simulated,
    radii,
    runs_for,
    searched_size,
)

_TYPICAL = 0.01  # delta for which errors are drawn to bound a probability: R is 20 000 or so


PAIRED = "diagonal fusion pairs the realizations"  # why sizes must be equal


class Simulated(Bound):
    """The order statistic of simulated errors: a bound within a few percent of the quantile.

    Made by ``bound("simulated", ...)`` and :func:`best`.

    Parameters
    ----------
    quantity, norm : str
        As the attributes.
    scheme : {"iid", "systematic"}
        How the lines of a vector or a matrix are drawn.
    of : ndarray or PlanErrors
        Those lines, one per row; or the law of the errors of a state and a control.
    key : Key
        Key of the draws: equal errors in every call.

    Notes
    -----
    R independent errors are drawn from the law, each from counts at a cost of O(n^2). The radius is
    the one that j others exceed, j the largest number with
    ``P(Bin(R, 0.9 delta) <= j) <= 0.01 delta`` (Clopper and Pearson, 1934). The error exceeds it
    with probability at most delta, over the realizations and the simulation together. R takes about
    half a second, but is ``4 / delta`` at least; if it is below about ``12 / delta``, the radius is
    the largest error, exceeded with probability ``1 / (R + 1)``. There is no bound if ``4 / delta``
    errors would take one thread more than 10 seconds (see `least_delta`). `required_size` simulates
    ten sizes at most and ends within 1 % of the smallest sufficient one, or within 5 % if one size
    takes half a second.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> data = ([[1.0, 0.0], [2.0, 5.0]], [[1.0], [0.0]]), [1.0, 1.0], [2.0, 2.0]
    >>> every = [bounds.bound(name, "state", *data) for name in ("simulated", "McDiarmid")]
    >>> [round(bound.radius(1000, 0.01), 1) for bound in every]
    [0.2, 0.4]
    """

    def __init__(
        self, quantity: str, norm: str, scheme: Scheme, of: Floats | PlanErrors, key: Key
    ) -> None:
        super().__init__(
            "simulated",
            "order statistic of errors drawn from the law; its own chance of failure is in delta",
            quantity,
            norm,
            equal=PAIRED if isinstance(of, PlanErrors) and of.paired else "",
            entities=ENTITIES if isinstance(of, PlanErrors) else (),
        )
        self._scheme, self._of, self._key = scheme, of, key
        self._which = int(quantity == "control")  # column of the errors

    def _law(self, rates: Rates) -> ErrorLaw:
        """What errors for these sizes are drawn from."""
        sizes = tuple(round(1.0 / rate) if rate > 0.0 else None for rate in rates)
        if isinstance(self._of, PlanErrors):
            return self._of.sized(sizes)
        if sizes[0] is None:
            raise SizeError("`size` must be a number here: exact values have no errors")
        return EstimateErrors(self._of, self.norm, sizes[0], self._scheme)

    def _radius_at(self, rates: Rates, level: float) -> float:
        """From new draws, equal for equal sizes."""
        if not any(rates):
            return 0.0
        errors, delta = self._law(rates), math.exp(-level)
        found = radii(errors, delta, self._key)
        if found is None:
            raise SizeError(not_simulated(delta, errors.cost))
        return found[self._which]

    def _level_at(self, rates: Rates, eps: float) -> float:
        """The largest level at which few enough of the simulated errors exceed eps."""
        if not any(rates):
            return math.inf
        errors, which = self._law(rates), self._which
        runs = runs_for(_TYPICAL, errors.cost)
        if runs is None:
            return 0.0
        drawn = errors.draw(runs, self._key)
        # what rounding adds to an error in the middle
        off = errors.rounded(tuple(float(np.median(one)) for one in drawn.T))[which]
        drawn = drawn[:, which]
        beyond = int((drawn + (off - float(np.median(drawn))) > eps).sum())
        return _core.drawn_level(runs, beyond)

    def errors(self, size: Sizes) -> ErrorLaw:
        """The law of the errors for a number of realizations.

        Parameters
        ----------
        size : int, None or (N0, Nf, NA)
            As in :meth:`radius`.

        Returns
        -------
        ErrorLaw
            ``errors.draw(runs, key)`` gives independent errors, (runs, 1); for a state or a
            control (runs, 2), of both.

        Raises
        ------
        InputError, InputTypeError
            As :meth:`radius`; or the size of a vector or matrix is None: nothing is random.
        """
        return self._law(self._rates(size))

    def require(self, delta: float) -> None:
        """Refuse a probability of failure that cannot be simulated.

        Parameters
        ----------
        delta : float
            Probability of failure, in (0, 1).

        Raises
        ------
        InputError, InputTypeError
            `delta` is no probability, or below `least_delta`.
        """
        if not self.possible(1, delta):
            raise SizeError(not_simulated(delta, self._cost(self._rates(1))))

    def least_delta(self, size: Sizes) -> float:
        """The smallest probability of failure that can be simulated.

        Parameters
        ----------
        size : int, None or (N0, Nf, NA)
            As in :meth:`radius`.

        Returns
        -------
        float
            2e-6 for a few states, 3e-5 for n = 20 over four steps, 7e-4 for n = 100.

        Raises
        ------
        InputError, InputTypeError
            `size` is not a count.
        """
        rates = self._rates(size)
        return least_delta(self._cost(rates)) if any(rates) else 0.0

    def possible(self, size: Sizes, delta: float) -> bool:
        """Whether there is a bound: `delta` is at least `least_delta`.

        Parameters
        ----------
        size, delta
            As in :meth:`radius`.

        Returns
        -------
        bool
            Whether :meth:`radius` has a result.

        Raises
        ------
        InputError, InputTypeError
            `size` is not a count, or `delta` does not lie in (0, 1).
        """
        return validation.probability("delta", delta) >= self.least_delta(size)

    def _smallest(self, eps: float, delta: float, rates: Callable[[int], Rates]) -> int | None:
        self.require(delta)
        if not any(rates(1)):
            return 1
        return searched_size(lambda N: self._law(rates(N)), self._which, eps, delta, self._key)

    def _cost(self, rates: Rates) -> float:
        return self._law(rates).cost
