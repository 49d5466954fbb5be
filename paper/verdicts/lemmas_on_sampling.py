"""Section 4 of the paper: the sampling scheme, Lemma 4.1, and the remarks after it."""

from __future__ import annotations

from collections import Counter
from fractions import Fraction
from itertools import product
from math import exp
from typing import Any

import numpy as np

from .. import rationals as exact
from .records import Claim, claim, outcome


def lemma_41() -> Claim:
    """The scheme is unbiased; the printed mean lacks a factor."""
    w, N = exact.array([3, -1, 0, 2]), 3
    g = abs(w).sum()
    total = exact.expectation((p, sum(samples)) for p, samples in exact.sequences(w, N))
    law = [(p, exact.mean(samples)) for p, samples in exact.sequences(w, N)]
    inside = all((mean[w == 0] == 0).all() and (mean * w >= 0).all() for _, mean in law)
    best = min(_second_moment(w, q) for q in _masses(w, 12))
    own = _second_moment(w, abs(w) / g)
    unbiased = np.array_equal(exact.expectation(law), w) and np.array_equal(total, N * w)
    return claim(
        "Lemma 4.1",
        outcome(unbiased and inside, N=N, total=total),
        outcome(best == own == g**2, best=best, square=g**2),
    )


def _second_moment(w: exact.Array, q: exact.Array) -> Fraction:
    """``sum_i w_i^2 / q_i``."""
    return sum((x * x / p for x, p in zip(w, q, strict=True) if x != 0), exact.ZERO)


def _masses(w: exact.Array, parts: int) -> list[exact.Array]:
    """All probability vectors in multiples of ``1 / parts`` that are positive where w is not 0."""
    counts = [range(int(x != 0), parts + 1) for x in w]
    return [exact.array(k) / parts for k in product(*counts) if sum(k) == parts]


def rows_or_columns() -> Claim:
    """Rows serve as well, with constants of their own."""
    A = exact.array([[1, 1, 1], [1, 0, 0], [0, 1, 0]])
    gamma = abs(A).sum(axis=0).max()  # as printed: the largest column sum
    laws = {"columns": exact.matrix_atoms(A), "rows": exact.row_atoms(A)}
    means = [exact.expectation(law) for law in laws.values()]
    squares = {
        k: exact.expectation((p, exact.square(one - A)) for p, one in law)
        for k, law in laws.items()
    }
    largest = {k: max(abs(one).max() for _, one in law) for k, law in laws.items()}
    # sum of g_j^2 - ||a_j||^2 over the lines
    formulas = [(abs(A).sum(axis=k) ** 2 - (A * A).sum(axis=k)).sum() for k in (0, 1)]
    N, eps = 10, 2
    # a_11 is estimated by 3 in every realization, off by 2
    every = sum(p for p, one in laws["rows"] if one[0, 0] - A[0, 0] >= eps) ** N
    hoeffding = 2.0 * exp(-2.0 * N * eps**2 / float(gamma) ** 2)
    as_formulas = all(np.array_equal(m, A) for m in means) and [*squares.values()] == formulas
    exceeded = largest["columns"] <= gamma < largest["rows"]
    return claim(
        "Remark after Lemma 4.1, rows",
        outcome(as_formulas and squares["rows"] != squares["columns"], squares=squares),
        outcome(
            exceeded and float(every) > hoeffding,
            gamma=gamma,
            largest=largest,
            N=N,
            eps=eps,
            every=float(every),
            hoeffding=hoeffding,
        ),
    )


def sparsity() -> Claim:
    """No entry is added, but entries are missing."""
    A = exact.array([[1, 1, 0], [1, 1, 1], [0, 1, 1]])
    atoms = exact.matrix_atoms(A)
    law: Counter[frozenset[Any]] = Counter({frozenset(): exact.ONE})
    complete = []
    for _ in range(4):  # pattern of the average of 1, 2, 3, 4 realizations
        longer: Counter[frozenset[Any]] = Counter()
        for (seen, p), (q, one) in product(law.items(), atoms):
            longer[seen | _pattern(one)] += p * q
        law = longer
        complete.append(law[_pattern(A)])
    inside = all(pattern <= _pattern(A) for pattern in law)
    signs = all((one * A >= 0).all() for _, one in atoms)
    confirms = inside and signs and complete[1] == 0 and 0 < complete[3] < 1
    return claim(
        "Remark after Lemma 4.1, sparsity", outcome(confirms, count=len(atoms), complete=complete)
    )


def _pattern(A: exact.Array) -> frozenset[Any]:
    """Places of the nonzero entries."""
    return frozenset(zip(*np.nonzero(A), strict=True))


def bernoulli() -> Claim:
    """A component has two values, and depends on the others."""
    w = exact.array([3, -1, 0, 2])
    g = abs(w).sum()
    atoms = exact.atoms(w)
    values = [sorted({atom[i] for _, atom in atoms}) for i in range(len(w))]
    two = values == [sorted({0, x}) for x in g * np.sign(w)]
    covariance = exact.expectation((p, np.outer(a - w, a - w)) for p, a in atoms)
    as_formula = np.array_equal(covariance, np.diag(g * abs(w)) - np.outer(w, w))
    nearest = min(exact.square(atom - w) for _, atom in atoms)
    confirms = two and g != 1 and as_formula and covariance[0, 3] < 0 < nearest
    return claim(
        "Remark after Lemma 4.1, Bernoulli",
        outcome(
            confirms,
            values=[f"{{{', '.join(map(str, v))}}}" for v in values],
            covariance=covariance[0, 3],
            nearest=nearest,
        ),
    )
