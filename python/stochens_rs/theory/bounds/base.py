"""The base of all bounds: a quantity, and the formula that bounds its error."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeAlias

from ..._base import html, validation
from ..._base.numbers import smallest_size
from ...exceptions import InputError, SizeError
from ..formulas import Sizes, checked_finite, inverse_size, one_each

Rates: TypeAlias = "tuple[float, ...]"  # 1 / size of every entity; 0 for one known exactly
Formula: TypeAlias = "Callable[[Rates, float], float]"  # of rates and level

_ROUNDS = 200  # at most: a bisection between float64 of like size ends after 53 halvings
_LARGEST_LEVEL = 744.0  # log(1 / delta) for the smallest positive float64, 4.9e-324
ENTITIES = ("x0", "xf", "A")  # of a control or a state


class Bound:
    """A tail bound ``P(error > radius(size, delta)) <= delta`` for every size and every delta.

    Made by :func:`bound`, :func:`candidates` and :func:`best`.

    Parameters
    ----------
    name, source, quantity, norm : str
        As the attributes.
    formula : callable
        ``formula(rates, level)``: the radius for ``delta = exp(-level)`` and sizes ``1 / rates``.
    equal : str, default ""
        The reason why all sizes must be equal.
    entities : tuple of str, default ()
        Those that have a size each; none: one size.
    cap : callable, optional
        ``cap(rates)``: the largest error that is possible, or a larger number.
    unit : float, default 1.0
        The unit of `formula` and `cap`.

    Attributes
    ----------
    name : str
        Name of the inequality.
    source : str
        The inequality and the numbers that it is used with.
    quantity : str
        The quantity: "vector", "matrix", "state" or "control".
    norm : str
        The norm of the error: "2", "Frobenius", "spectral" or "1".

    Notes
    -----
    The three methods are inverse to each other: ``probability(N, radius(N, delta)) = delta`` and
    ``required_size(eps, delta)`` is the smallest N with ``radius(N, delta) <= eps``. A radius is at
    most the largest possible error; for data without randomness (zero vectors, lines with one
    nonzero entry) it is 0.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> bound = bounds.bound("Weissman", "vector", [3.0, -1.0, 0.5])
    >>> round(bound.radius(10_000, 0.01), 4), bound.required_size(0.1, 0.01)
    (0.1138, 12954)
    """

    def __init__(
        self,
        name: str,
        source: str,
        quantity: str,
        norm: str = "2",
        formula: Formula | None = None,
        *,
        equal: str = "",
        entities: tuple[str, ...] = (),
        cap: Callable[[Rates], float] | None = None,
        unit: float = 1.0,
    ) -> None:
        self.name, self.source, self.quantity, self.norm = name, source, quantity, norm
        self.equal, self._entities = equal, entities
        self._formula, self._cap, self._unit = formula, cap, unit

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
            At most 1, and 0 if no error can exceed `eps`.

        Raises
        ------
        InputError, InputTypeError
            `size` is not a count, or `eps` is not a positive number.
        """
        rates = self._rates(size)
        eps = validation.positive("eps", eps)
        if self._cap is not None and eps >= self._cap(rates) * self._unit:
            return 0.0
        level = self._level_at(rates, eps / self._unit)
        return 1.0 if level <= 0.0 else math.exp(-level)

    def required_size(self, eps: float, delta: float, *, exact: Sequence[str] = ()) -> int:
        """Smallest number of realizations that gives a radius of at most `eps`.

        Parameters
        ----------
        eps : float
            Error, > 0, in the units of the quantity.
        delta : float
            Probability of failure, in (0, 1).
        exact : sequence of {"x0", "xf", "A"}, default ()
            For a state or a control: entities that are known exactly.

        Returns
        -------
        int
            The same number for all other entities.

        Raises
        ------
        InputError, InputTypeError
            An argument is out of range, or more than 2^53 realizations are needed.
        """
        entities, given = self._entities, validation.items("exact", exact)
        if given and not entities:
            raise InputError(f"`exact` must be empty for a {self.quantity}: it is one entity")
        known = {validation.choice("exact", name, entities) for name in given}
        flags = tuple(float(name not in known) for name in entities) or (1.0,)
        eps, delta = validation.positive("eps", eps), validation.probability("delta", delta)
        found = self._smallest(eps, delta, lambda N: tuple(1.0 / N * flag for flag in flags))
        if found is None:
            raise SizeError(f"`eps` is {eps:.3g}: more than 2^53 realizations would be needed")
        return found

    def _smallest(self, eps: float, delta: float, rates: Callable[[int], Rates]) -> int | None:
        level = level_of(delta)
        return smallest_size(lambda N: self._in_units(self._capped(rates(N), level)) <= eps)

    def _radius_at(self, rates: Rates, level: float) -> float:
        """Radius for ``delta = exp(-level)``, in units."""
        assert self._formula is not None  # or the class has this method
        return self._formula(rates, level)

    def _level_at(self, rates: Rates, eps: float) -> float:
        """A level with ``P(error > eps) <= exp(-level)``, the largest that follows."""
        if self._radius_at(rates, 0.0) > eps:
            return 0.0
        if self._radius_at(rates, _LARGEST_LEVEL) <= eps:
            return math.inf
        return halved(0.0, _LARGEST_LEVEL, lambda level: self._radius_at(rates, level) <= eps)[0]

    def _capped(self, rates: Rates, level: float) -> float:
        """The radius, at most the largest possible error."""
        found = self._radius_at(rates, level)
        return found if self._cap is None else min(found, self._cap(rates))

    def _rates(self, size: Sizes, *, any_sizes: bool = False) -> Rates:
        """Rates ``1 / size`` of checked sizes."""
        if not self._entities:
            return (inverse_size("size", size),)
        rates = tuple(inverse_size(f"size[{k}]", N) for k, N in enumerate(one_each(size)))
        if self.equal and differ(rates) and not any_sizes:
            sizes = ", ".join(f"{1.0 / rate:g}" if rate else "None" for rate in rates)
            raise InputError(
                f"`size` must be one number here ({self.equal}), got N0, Nf, NA = {sizes}"
            )
        return rates

    def _in_units(self, radius: float) -> float:
        return checked_finite(float(radius * self._unit), "radius")

    def _repr_html_(self) -> str:
        return html.card(self, [("inequality", self.name), ("from", self.source)])

    def __repr__(self) -> str:
        return f"<Bound {self.name}: error of the {self.quantity}, {self.norm} norm>"


def differ(rates: Rates) -> bool:
    """Whether the entities that are not exact have different sizes."""
    return len({rate for rate in rates if rate > 0.0}) > 1


def halved(low: float, high: float, holds: Callable[[float], bool]) -> tuple[float, float]:
    """Bisect between `low`, at which `holds` is true, and `high`, at which it is not."""
    for _ in range(_ROUNDS):
        middle = low + (high - low) / 2.0
        if not low < middle < high:
            break
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low, high


def level_of(delta: object) -> float:
    """``log(1 / delta)`` of a checked probability of failure."""
    return -math.log(validation.probability("delta", delta))
