"""Realizations in rational arithmetic, all of them with their probabilities: no rounding."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import product
from typing import TypeAlias

Vector: TypeAlias = tuple[Fraction, ...]
Matrix: TypeAlias = tuple[Vector, ...]  # rows

ZERO, ONE = Fraction(0), Fraction(1)


def vector(*entries: int | Fraction) -> Vector:
    """Entries as fractions."""
    return tuple(Fraction(entry) for entry in entries)


def dot(a: Vector, b: Vector) -> Fraction:
    """``<a, b>``."""
    return sum((x * y for x, y in zip(a, b, strict=True)), ZERO)


def combine(s: Fraction, a: Vector, t: Fraction, b: Vector) -> Vector:
    """``s a + t b``."""
    return tuple(s * x + t * y for x, y in zip(a, b, strict=True))


def distance(a: Vector, b: Vector) -> Fraction:
    """``||a - b||_2^2``."""
    d = combine(ONE, a, -ONE, b)
    return dot(d, d)


def matmul(A: Matrix, B: Matrix) -> Matrix:
    """``A B``."""
    columns = tuple(zip(*B, strict=True))
    return tuple(tuple(dot(row, column) for column in columns) for row in A)


def atoms(w: Vector) -> list[tuple[Fraction, Vector]]:
    """Every realization of a vector with its probability: ``g sign(w_i) e_i``, ``|w_i| / g``."""
    g = sum((abs(x) for x in w), ZERO)
    if g == 0:
        return [(ONE, w)]
    return [
        (abs(x) / g, tuple(g * (1 if x > 0 else -1) if k == i else ZERO for k in range(len(w))))
        for i, x in enumerate(w)
        if x != 0
    ]


def matrix_atoms(A: Matrix) -> list[tuple[Fraction, Matrix]]:
    """Every realization of a matrix, column by column, with its probability."""
    columns = [atoms(column) for column in zip(*A, strict=True)]
    realizations = []
    for choice in product(*columns):
        p = ONE
        for q, _ in choice:
            p *= q
        realizations.append((p, tuple(zip(*(column for _, column in choice), strict=True))))
    return realizations


def row_atoms(A: Matrix) -> list[tuple[Fraction, Matrix]]:
    """Every realization of a matrix, row by row, with its probability."""
    transposed = tuple(zip(*A, strict=True))
    return [(p, tuple(zip(*one, strict=True))) for p, one in matrix_atoms(transposed)]


def apply(A: Matrix, x: Vector) -> Vector:
    """``A x``."""
    return tuple(dot(row, x) for row in A)


def spectral_at_most(M: Matrix, square: Fraction) -> bool:
    """Whether ``||M||_2^2 <= square``, for M of order 2.

    The larger root of ``z^2 - ||M||_F^2 z + det(M)^2``, the square of the norm, is at most
    `square` if the polynomial is not negative there and no longer falls.
    """
    (a, b), (c, d) = M
    trace, det = a * a + b * b + c * c + d * d, a * d - b * c
    return 2 * square >= trace and square**2 - trace * square + det**2 >= 0


def sequences(w: Vector, size: int) -> Iterator[tuple[Fraction, list[Vector]]]:
    """Every sequence of `size` realizations of a vector, with its probability."""
    for choice in product(atoms(w), repeat=size):
        p = ONE
        for q, _ in choice:
            p *= q
        yield p, [sample for _, sample in choice]


def mean(samples: Sequence[Vector]) -> Vector:
    """The plain average."""
    return tuple(sum(column, ZERO) / len(samples) for column in zip(*samples, strict=True))


def slse_path(samples: Sequence[Vector], target: Vector) -> list[Vector]:
    """Estimates of SLSE after each realization: one exact line search per realization."""
    F = samples[0]
    estimates = [F]
    for E in samples[1:]:
        F = towards(F, E, target)
        estimates.append(F)
    return estimates


def slse(samples: Sequence[Vector], target: Vector) -> list[Fraction]:
    """Squared errors of SLSE after each realization."""
    return [distance(F, target) for F in slse_path(samples, target)]


def towards(F: Vector, E: Vector, target: Vector) -> Vector:
    """The point of the segment from F to E that is nearest to the target."""
    t = weight(F, E, target)
    return combine(ONE - t, F, t, E)


def weight(F: Vector, E: Vector, target: Vector) -> Fraction:
    """``clip(<target - F, E - F> / ||E - F||^2, 0, 1)``; 0 if E = F."""
    step = combine(ONE, E, -ONE, F)
    length = dot(step, step)
    t = dot(combine(ONE, target, -ONE, F), step) / length if length else ZERO
    return min(max(t, ZERO), ONE)


def alse(samples: Sequence[Vector], w: Vector) -> Vector:
    """The nearest average on the simplex to w of realizations of w, by the corrected Lemma 4.4.

    ``sign(w_k) (|w_k| + d / #hit)`` on the entries hit, d the sum of ``|w_k|`` over the others.
    """
    hit = [k for k in range(len(w)) if any(sample[k] != 0 for sample in samples)]
    missed = sum((abs(x) for k, x in enumerate(w) if k not in hit), ZERO)
    return tuple(
        x + (1 if x > 0 else -1) * missed / len(hit) if k in hit else ZERO for k, x in enumerate(w)
    )
