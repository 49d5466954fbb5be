"""What all bounds share: checked input, inversion, the smallest sufficient size."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, ClassVar, TypeAlias

import numpy as np

from ..._base import gate, html
from ...exceptions import InputTypeError, NonFiniteError, SizeError
from ..formulas import Array, Sizes, inverse_size

Rates: TypeAlias = "tuple[float, ...]"  # 1 / size of every entity; 0 for one known exactly

_ROUNDS = 200  # halvings: more than a float64 can tell apart
_LARGEST_LEVEL = 744.0  # log(1 / delta) for the smallest positive float64
_ABOVE_ROUNDING = 1.0 + 1e-12  # an error that is attained must not exceed its bound by rounding


class Bound:
    """A tail bound ``P(error > radius(size, delta)) <= delta`` for every size and every delta.

    Parameters
    ----------
    *args, **kwargs
        Those of the bound. What several bounds have in common (`Bound`, `Average`, `Fused`,
        `Trajectory`, `stochens_rs.paper.bounds.Printed`) is no bound and cannot be made.

    Raises
    ------
    InputTypeError
        The class is no bound; the message names those that are.

    Attributes
    ----------
    name : str
        What the inequality is called.
    quantity : str
        What the error is of: "vector", "matrix", "state", "control" or "trajectory".
    norm : str
        The norm of the error: "2", "Frobenius", "spectral" or "1".
    source : str
        The inequality behind it and what goes into it.

    Notes
    -----
    The three methods are inverse to each other: ``probability(N, radius(N, delta)) = delta`` and
    ``required_size(eps, delta)`` is the smallest N with ``radius(N, delta) <= eps``. No radius is
    larger than the largest error that the data allow, whose probability to be exceeded is 0. A
    bound whose data have no randomness (zero vectors, lines with one nonzero entry) has radius 0.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> bound = bounds.McDiarmid([3.0, -1.0, 0.5])
    >>> isinstance(bound, bounds.Bound), bound.name, bound.norm
    (True, 'McDiarmid', '2')
    """

    name: ClassVar[str]
    source: ClassVar[str]
    quantity: str
    norm: str
    _unit: float = 1.0  # everything below the public methods is computed in this unit

    def __new__(cls, *args: Any, **kwargs: Any) -> Any:
        if not hasattr(cls, "name"):
            usable = ", ".join(sorted(kind.__name__ for kind in _usable(cls)))
            raise InputTypeError(
                f"{cls.__name__} is what several bounds have in common and no bound: use {usable}"
            )
        return super().__new__(cls)

    def radius(self, size: Sizes, delta: float) -> float:
        """Radius that the error exceeds with probability at most `delta`.

        Parameters
        ----------
        size : int, None or (N0, Nf, NA)
            Number of realizations, up to 2^53; None or inf: known exactly. A bound for a control
            or a state takes one number for all entities or one each.
        delta : float
            Probability of failure, in (0, 1).

        Returns
        -------
        float
            In the units of the quantity.

        Raises
        ------
        InputError, InputTypeError
            `size` is not a count, `delta` does not lie in (0, 1), or the radius overflows.
        """
        rates = self._rates(size)
        return self._in_units(self._capped(rates, level_of(delta)))

    def probability(self, size: Sizes, eps: float) -> float:
        """Bound on the probability that the error exceeds `eps`.

        Parameters
        ----------
        size : int, None or (N0, Nf, NA)
            As in :meth:`radius`.
        eps : float
            Error, > 0, in the units of the quantity.

        Returns
        -------
        float
            At most 1, and 0 where no error can be as large as `eps`.

        Raises
        ------
        InputError, InputTypeError
            `size` is not a count, or `eps` is not a positive number.
        """
        rates = self._rates(size)
        eps = gate.positive("eps", eps)
        if eps >= self._cap(rates) * self._unit:
            return 0.0
        level = self._level(rates, eps / self._unit)
        return 1.0 if level <= 0.0 else math.exp(-level)

    def required_size(self, eps: float, delta: float) -> int:
        """Smallest number of realizations that gives a radius of at most `eps`.

        Parameters
        ----------
        eps : float
            Error, > 0, in the units of the quantity.
        delta : float
            Probability of failure, in (0, 1).

        Returns
        -------
        int
            The same number for all entities.

        Raises
        ------
        InputError, InputTypeError
            An argument is out of range, or more than 2^53 realizations are needed.
        """
        return self._required(eps, delta, self._same)

    def _required(self, eps: float, delta: float, same: Callable[[float], Rates]) -> int:
        """Bisect over the integers; the radius falls with the size."""
        eps, level = gate.positive("eps", eps), level_of(delta)

        def enough(size: int) -> bool:
            return self._in_units(self._capped(same(1.0 / size), level)) <= eps

        if enough(1):
            return 1
        too_few, sufficient = 1, gate.EXACT
        if not enough(sufficient):
            raise SizeError(f"`eps` is {eps:.3g}: more than 2^53 realizations would be needed")
        while sufficient - too_few > 1:
            middle = (too_few + sufficient) // 2
            if enough(middle):
                sufficient = middle
            else:
                too_few = middle
        return sufficient

    def _capped(self, rates: Rates, level: float) -> float:
        return min(self._radius(rates, level), self._cap(rates))

    def _cap(self, rates: Rates) -> float:
        return self._largest_error(rates) * _ABOVE_ROUNDING

    # -- what a bound defines: one of the first two, the other follows by inversion ------------

    def _radius(self, rates: Rates, level: float) -> float:
        """Radius for ``delta = exp(-level)``; here by inversion of `_level`."""
        if self._level(rates, math.ulp(0.0)) >= level:
            return 0.0
        outside = 1.0
        while self._level(rates, outside) < level:
            outside *= 2.0
            if outside == math.inf:
                return outside
        inside = outside / 2.0
        while inside > 0.0 and self._level(rates, inside) >= level:
            outside, inside = inside, inside / 2.0
        for _ in range(_ROUNDS):
            middle = inside + (outside - inside) / 2.0
            if not inside < middle < outside:
                break
            if self._level(rates, middle) >= level:
                outside = middle
            else:
                inside = middle
        return outside

    def _level(self, rates: Rates, eps: float) -> float:
        """Largest known level with ``P(error > eps) <= exp(-level)``; by inversion of `_radius`."""
        known, unknown = 0.0, _LARGEST_LEVEL
        if self._radius(rates, known) > eps:
            return 0.0
        if self._radius(rates, unknown) <= eps:
            return math.inf if self._radius(rates, unknown) == 0.0 else unknown
        for _ in range(_ROUNDS):
            middle = (known + unknown) / 2.0
            if not known < middle < unknown:
                break
            if self._radius(rates, middle) <= eps:
                known = middle
            else:
                unknown = middle
        return known

    def _largest_error(self, rates: Rates) -> float:
        """The largest error that can happen at all, or more; for entities that are not exact."""
        return math.inf

    def _rates(self, size: Sizes) -> Rates:
        return (inverse_size("size", size),)

    def _same(self, rate: float) -> Rates:
        return (rate,)

    def _in_units(self, radius: float) -> float:
        scaled = radius * self._unit
        if not math.isfinite(scaled):
            raise NonFiniteError("the radius overflows: scale the problem down")
        return scaled

    def _repr_html_(self) -> str:
        return html.card(self, [("inequality", self.name), ("from", self.source)])

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: error of the {self.quantity}, {self.norm} norm>"


def _usable(kind: type[Bound]) -> set[type[Bound]]:
    """The bounds that are built on a common part."""
    below: set[type[Bound]] = set().union(*(_usable(k) for k in kind.__subclasses__()))
    return below | {kind} if hasattr(kind, "name") else below


def level_of(delta: object) -> float:
    """``log(1 / delta)`` of a checked probability of failure."""
    return -math.log(gate.probability("delta", delta))


# -- units -------------------------------------------------------------------------------------


def unit_of(*arrays: Array) -> float:
    """Largest entry, 1 if all are zero: in this unit squares neither overflow nor vanish."""
    largest = max(float(np.abs(array).max(initial=0.0)) for array in arrays)
    return largest if largest > 0.0 else 1.0
