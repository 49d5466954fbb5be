"""The base of all bounds: a setting, and the bound that a formula makes of it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

from ..._base import html, validation
from ..._base.numbers import ROUNDING, smallest_size
from ..._base.types import Floats
from ...exceptions import InputError, SizeError
from ..formulas import Sizes, checked_finite, inverse_size, one_each

Rates: TypeAlias = "tuple[float, ...]"  # 1 / size of every entity; 0 for one known exactly
Formula: TypeAlias = "Callable[[Any, Rates, float], float]"  # of setting, rates and level

_ROUNDS = 200  # at most: a bisection between float64 of like size ends after 53 halvings
_LARGEST_LEVEL = 744.0  # log(1 / delta) for the smallest positive float64, 4.9e-324
_ABOVE_ROUNDING = 1.0 + ROUNDING  # the largest error can occur, and is rounded, too


class Setting:
    """The quantity that the error is of, with its data.

    All numbers are in units of `unit`, in which nothing overflows.
    """

    unit: float = 1.0
    entities: tuple[str, ...] = ()  # those that have a size each; empty: one size
    equal: str = ""  # the reason why all sizes must be equal; empty: they may differ

    def __init__(self, quantity: str, norm: str = "2") -> None:
        self.quantity, self.norm = quantity, norm

    def rates(self, size: Sizes) -> Rates:
        """Turn checked sizes into rates ``1 / size``."""
        if not self.entities:
            return (inverse_size("size", size),)
        return tuple(inverse_size(f"size[{k}]", N) for k, N in enumerate(one_each(size)))

    def farthest(self, rates: Rates) -> float:
        """The largest error that is possible, or a larger number."""
        return math.inf

    def cap(self, rates: Rates) -> float:
        """The largest possible error, with what rounding may add to it."""
        return float(self.farthest(rates)) * _ABOVE_ROUNDING


class Moments(Setting, ABC):
    """A setting with the numbers that the generic inequalities need, as functions of the rates."""

    @abstractmethod
    def rms(self, rates: Rates) -> float:
        """Root mean square of the error."""

    @abstractmethod
    def variance(self, rates: Rates) -> float:
        """Largest variance of a projection of the error."""


class Bound:
    """A tail bound ``P(error > radius(size, delta)) <= delta`` for every size and every delta.

    Made by :func:`bound`, :func:`candidates` and :func:`best`.

    Parameters
    ----------
    name, source : str
        As the attributes.
    setting : Setting
        The quantity with its data.
    formula : callable
        ``formula(setting, rates, level)``: the radius for ``delta = exp(-level)``.
    equal : str, default ""
        The reason why the inequality needs equal sizes.

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
    setting
        For this package: the quantity with its data.

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
        self, name: str, source: str, setting: Any, formula: Formula | None = None, equal: str = ""
    ) -> None:
        self.name, self.source, self.setting = name, source, setting
        self.equal = equal or setting.equal
        self.quantity, self.norm = setting.quantity, setting.norm
        self._formula = formula

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
        eps, unit = validation.positive("eps", eps), self.setting.unit
        if eps >= self.setting.cap(rates) * unit:
            return 0.0
        level = self._level_at(rates, eps / unit)
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
        entities, given = self.setting.entities, validation.items("exact", exact)
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
        """Radius for ``delta = exp(-level)``, in units of the setting."""
        assert self._formula is not None  # or the class has this method
        return self._formula(self.setting, rates, level)

    def _level_at(self, rates: Rates, eps: float) -> float:
        """A level with ``P(error > eps) <= exp(-level)``, the largest that follows."""
        if self._radius_at(rates, 0.0) > eps:
            return 0.0
        if self._radius_at(rates, _LARGEST_LEVEL) <= eps:
            return math.inf
        return halved(0.0, _LARGEST_LEVEL, lambda level: self._radius_at(rates, level) <= eps)[0]

    def _capped(self, rates: Rates, level: float) -> float:
        """The radius, at most the largest possible error."""
        return min(self._radius_at(rates, level), float(self.setting.cap(rates)))

    def _rates(self, size: Sizes) -> Rates:
        rates: Rates = self.setting.rates(size)
        if self.equal and differ(rates):
            sizes = ", ".join(f"{1.0 / rate:g}" if rate else "None" for rate in rates)
            raise InputError(
                f"`size` must be one number here ({self.equal}), got N0, Nf, NA = {sizes}"
            )
        return rates

    def _in_units(self, radius: float) -> float:
        return checked_finite(float(radius * self.setting.unit), "radius")

    def _repr_html_(self) -> str:
        return html.card(self, [("inequality", self.name), ("from", self.source)])

    def __repr__(self) -> str:
        return f"<Bound {self.name}: error of the {self.quantity}, {self.norm} norm>"


def differ(rates: Rates) -> bool:
    """Whether the entities that are not exact have different sizes."""
    return len({rate for rate in rates if rate > 0.0}) > 1


def halved(
    low: float, high: float, holds: Callable[[float], bool], rounds: int = _ROUNDS
) -> tuple[float, float]:
    """Bisect between `low`, at which `holds` is true, and `high`, at which it is not."""
    for _ in range(rounds):
        middle = low + (high - low) / 2.0
        if not low < middle < high:
            break
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low, high


def level_of(delta: object) -> float:
    """``log(1 / delta)`` of a checked probability of failure."""
    return -math.log(validation.probability("delta", delta))


def unit_of(*arrays: Floats) -> float:
    """Largest absolute entry, 1 if all are 0: in this unit squares do not overflow or vanish."""
    largest = max(float(np.abs(array).max(initial=0.0)) for array in arrays)
    return largest if largest > 0.0 else 1.0
