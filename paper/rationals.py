"""Exact arithmetic: NumPy arrays of fractions, and all realizations with their probabilities."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from itertools import accumulate, product
from math import prod
from typing import Any, TypeAlias

import numpy as np

# An ndarray of dtype object with entries of type Fraction: NumPy's types cannot say more.
Array: TypeAlias = Any

ZERO, ONE = Fraction(0), Fraction(1)


def array(entries: Any) -> Array:
    """Integers or fractions, in nested lists, as an array of fractions."""
    return np.array(entries, dtype=object) * ONE


def show(vector: Array) -> str:
    """``(1, 1/2)``."""
    return f"({', '.join(map(str, vector))})"


def floats(x: Array) -> Any:
    """The same array in floating point."""
    return np.array(x, dtype=float)


def square(x: Array) -> Fraction:
    """Squared 2-norm of a vector, squared Frobenius norm of a matrix."""
    return Fraction((x * x).sum())


def atoms(w: Array) -> list[tuple[Fraction, Array]]:
    """Every realization of a vector with its probability: ``g sign(w_i) e_i``, ``|w_i| / g``."""
    g = abs(w).sum()
    if g == 0:
        return [(ONE, w)]
    rows = np.diag(g * np.sign(w))
    return [(abs(x) / g, row * ONE) for x, row in zip(w, rows, strict=True) if x != 0]


def matrix_atoms(A: Array) -> list[tuple[Fraction, Array]]:
    """Every realization of a matrix, column by column, with its probability."""
    choices = map(_together, product(*(atoms(column) for column in A.T)))
    return [(p, np.stack(columns, axis=1)) for p, columns in choices]


def row_atoms(A: Array) -> list[tuple[Fraction, Array]]:
    """Every realization of a matrix, row by row, with its probability."""
    return [(p, one.T) for p, one in matrix_atoms(A.T)]


def sequences(w: Array, size: int) -> Iterator[tuple[Fraction, list[Array]]]:
    """Every sequence of `size` realizations of a vector, with its probability."""
    return map(_together, product(atoms(w), repeat=size))


def _together(choice: Sequence[tuple[Fraction, Array]]) -> tuple[Fraction, list[Array]]:
    """Independent realizations and the probability of all of them."""
    return prod((p for p, _ in choice), start=ONE), [one for _, one in choice]


def expectation(law: Iterable[tuple[Fraction, Array]]) -> Array:
    """Sum of values times their probabilities."""
    return sum(p * x for p, x in law)


def mean(samples: Sequence[Array]) -> Array:
    """The plain average."""
    return sum(samples) / len(samples)


def weight(F: Array, E: Array, target: Array) -> Fraction:
    """``clip(<target - F, E - F> / ||E - F||^2, 0, 1)``; 0 if E = F."""
    length = square(E - F)
    return min(max(((target - F) * (E - F)).sum() / length, ZERO), ONE) if length else ZERO


def towards(F: Array, E: Array, target: Array) -> Array:
    """The point of the segment from F to E that is nearest to the target."""
    return F + weight(F, E, target) * (E - F)


def slse_path(samples: Sequence[Array], target: Array) -> list[Array]:
    """Estimates of SLSE after each realization: one exact line search per realization."""
    return list(accumulate(samples, lambda F, E: towards(F, E, target)))


def slse(samples: Sequence[Array], target: Array) -> list[Fraction]:
    """Squared errors of SLSE after each realization."""
    return [square(F - target) for F in slse_path(samples, target)]


def alse(samples: Sequence[Array], w: Array) -> Array:
    """The average on the simplex that is nearest to w, by the corrected Lemma 4.4.

    ``sign(w_k) (|w_k| + d / #hit)`` on the entries hit, d the sum of ``|w_k|`` over the others.
    """
    hit = np.any([sample != 0 for sample in samples], axis=0)
    missed = (abs(w) * ~hit).sum()
    return hit * (w + np.sign(w) * missed / int(hit.sum()))


def spectral_at_most(M: Array, bound: Fraction) -> bool:
    """Whether ``||M||_2^2 <= bound``, for M of order 2.

    ``||M||_2^2`` is the larger root of ``z^2 - ||M||_F^2 z + det(M)^2``. It is at most `bound` if
    the polynomial is nonnegative there and `bound` is not left of its minimum.
    """
    (a, b), (c, d) = M
    frobenius, det = square(M), a * d - b * c
    return bool(2 * bound >= frobenius and bound**2 - frobenius * bound + det**2 >= 0)
