"""Every bound of one quantity as an object: its formulas, and the errors drawn from its law."""

from __future__ import annotations

import math

from stochens_rs.exceptions import SizeError
from stochens_rs.rng import as_key
from stochens_rs.theory import drawn_bound
from stochens_rs.theory.drawn_bounds import (
    Bounded,
    least_delta,
    not_simulated,
    radii,
    searched_size,
)

_LARGEST_LEVEL = 744.0  # log(1 / delta) for the smallest positive float64


class Bound:
    """One formula, or the order statistic "simulated", for every size and delta."""

    def __init__(self, name, of, rng=0):
        self.name, self.of, self.rng = name, of, rng

    @property
    def norm(self):
        return self.of.norm

    def errors(self, size):
        """The law of the errors."""
        return self.of.law(self.of.sizes(size))

    def radius(self, size, delta):
        sizes = self.of.sizes(size)
        if self.name != "simulated":
            return self.of.radius(self.name, sizes, delta)
        law = self.of.law(sizes)
        found = radii(law, delta, as_key(self.rng).child("simulated bound"))
        if found is None:
            raise SizeError(not_simulated(delta, law.cost))
        return found[self.of.which]

    def least_delta(self, size):
        return least_delta(self.errors(size).cost)

    def probability(self, size, eps):
        """The smallest delta, to rounding, with ``radius(size, delta) <= eps``; of a formula."""
        low, high = 0.0, _LARGEST_LEVEL
        if self.radius(size, math.exp(-high)) <= eps:
            return 0.0
        for _ in range(200):
            middle = (low + high) / 2.0
            if not low < middle < high:
                break
            within = self.radius(size, math.exp(-middle)) <= eps
            low, high = (middle, high) if within else (low, middle)
        return math.exp(-low)

    def required_size(self, eps, delta):
        if self.name != "simulated":
            return self.of.required_size(self.name, eps, delta)
        sizes, key = 3 if self.of.plan else 1, as_key(self.rng).child("simulated bound")
        return searched_size(
            lambda N: self.of.law((N, N, N)[:sizes]), self.of.which, eps, delta, key
        )

    def __repr__(self):
        return f"<{self.name}: {self.of.quantity}, {self.norm}>"


def bound(name, quantity, *data, rng=0, **choices):
    """One bound by its name."""
    return Bound(name, Bounded(quantity, data, **choices), rng)


def candidates(quantity, *data, **choices):
    """All formulas for independent realizations of equal number."""
    of = Bounded(quantity, data, **choices)
    return [Bound(name, of) for name in of.names((1, 1, 1))]


def best(quantity, *data, size, delta, **choices):
    """The radius of `drawn_bound`."""
    return drawn_bound(quantity, *data, size=size, delta=delta, **choices)[0]
