"""Variances against rational arithmetic, where differences of large terms would lose all digits.

The oracle takes the float64 data as they are and computes in `Fraction`.
"""

from __future__ import annotations

import itertools
from fractions import Fraction

import numpy as np
import pytest

from coverage_study import sets
from stochens_rs.theory import moments

TOLERANCE = 1e-13
AXES = ("columns", "rows")
TINY = (1, 8, 12, 16, 40, 150)  # A = [[1, 10^-k], [0, 1]]
VECTORS = ([1.0, 1.0], [1.0, -1.0], [1.0, 2.0], [3.0, 3.0 + 2.0**-45], [1.0, 1e-20])


def fractions(array):
    return np.vectorize(Fraction, otypes=[object])(np.asarray(array, dtype=float))


def sign(x):
    return (x > 0) - (x < 0)


def vector_covariance(w):
    """Cv(w) = g diag|w| - w w^T."""
    return np.diag(abs(w)) * abs(w).sum() - np.outer(w, w)


def systematic_covariance(w, N):
    """By the fractional parts of the cumulated counts."""
    g = abs(w).sum()
    if g == 0:
        return np.outer(w, w)
    phi = [c - c.__floor__() for c in N * np.cumsum(abs(w)) / g]
    both = np.array([[min(a, b) - a * b for a in phi] for b in phi])
    both = np.pad(both, ((1, 0), (1, 0)), constant_values=Fraction(0))
    counts = both[1:, 1:] - both[:-1, 1:] - both[1:, :-1] + both[:-1, :-1]
    signs = np.array([sign(x) for x in w])
    return (g / N) ** 2 * counts * np.outer(signs, signs)


def excess(A, M, axis, covariance=vector_covariance):
    """E[A^s M A^sT] - A M A^T."""
    if axis == "columns":
        return sum(M[j, j] * covariance(A[:, j]) for j in range(A.shape[1]))
    return np.diag([(covariance(row) * M).sum() for row in A])


def product_covariance(A, x0, r0, rA, axis):
    Cv, M = r0 * vector_covariance(x0), np.outer(x0, x0)
    return A.dot(Cv).dot(A.T) + rA * excess(A, M + Cv, axis)


def relative_error(found, exact):
    """Largest error of an entry, relative to the standard deviations of its row and column."""
    roots = [float(v) ** 0.5 for v in np.diagonal(exact)]
    error = 0.0
    for (i, k), value in np.ndenumerate(exact):
        if roots[i] * roots[k] > 1e-290:
            difference = abs(Fraction(float(found[i, k])) - value)
            error = max(error, float(difference / Fraction(roots[i]) / Fraction(roots[k])))
        elif value == 0:
            error = max(error, abs(found[i, k]) / 1e-290)
    return error


def graded_systems(count, seed):
    """x0, A with entries of all sizes, entries that are nearly equal, and zeros."""
    gen = np.random.default_rng(seed)
    for _ in range(count):
        n = int(gen.integers(2, 6))
        A = gen.choice([-1.0, 1.0], (n, n)) * 10.0 ** -gen.choice([0, 0, 1, 9, 17, 30], (n, n))
        A *= gen.random((n, n)) < 0.8
        x0 = gen.choice([-1.0, 1.0], n) * (1.0 + gen.choice([0.0, 0.0, 2.0**-40, 0.5], n))
        yield x0 * 10.0 ** -gen.choice([0, 0, 0, 12], n), A


def systems():
    for k, x0 in itertools.product(TINY, VECTORS):
        yield np.array(x0), np.array([[1.0, 10.0**-k], [0.0, 1.0]])
    yield from graded_systems(sets(40, 8), 1)


SIZES = ((1, None, 1), (None, None, 1), (1, None, None), (10**6, None, 3))


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("size", SIZES)
def test_product_fusion(size, axis):
    rates = [Fraction(0) if N is None else Fraction(1, N) for N in size]
    worst = 0.0
    for x0, A in systems():
        n = len(x0)
        exact = product_covariance(fractions(A), fractions(x0), rates[0], rates[2], axis)
        found = moments.state_covariance((A, np.eye(n)), x0, np.zeros(n), size, axis=axis)
        worst = max(worst, relative_error(found, exact))
        if size == (1, None, 1):
            found = moments.product_covariance(A, x0, axis=axis)
            worst = max(worst, relative_error(found, exact))
    assert worst < TOLERANCE


@pytest.mark.parametrize("sample_x0", [True, False])
def test_trajectories_by_rows(sample_x0):
    B, u, worst = np.array([[1.0, 1e-14]]), np.array([[1.0, -1.0]]), 0.0
    for x0, A in systems():
        rows = np.repeat(B, len(x0), axis=0)
        found = moments.trajectory_covariance(
            (A, rows), x0, u, sampled="A B x0" if sample_x0 else "A B", axis="rows"
        )
        F, G, w, v = (fractions(array) for array in (A, rows, x0, u[0]))
        S = vector_covariance(w) * int(sample_x0)
        grown = excess(F, S + np.outer(w, w), "rows") + excess(G, np.outer(v, v), "rows")
        worst = max(worst, relative_error(found[1], F.dot(S).dot(F.T) + grown))
    assert worst < TOLERANCE


@pytest.mark.parametrize("axis", AXES)
def test_systematic_samples(axis):
    worst = 0.0
    for (x0, A), N in itertools.product(list(systems())[: len(TINY) * len(VECTORS)], (1, 2, 3)):
        F, w = fractions(A), fractions(x0)
        C0 = systematic_covariance(w, N)
        exact = excess(
            F, C0 + np.outer(w, w), axis, lambda line, N=N: systematic_covariance(line, N)
        )
        exact = exact + F.dot(C0).dot(F.T)
        found = moments.state_covariance(
            (A, np.eye(2)), x0, np.zeros(2), N, axis=axis, scheme="systematic"
        )
        worst = max(worst, relative_error(found, exact))
        for line in A:
            mse, trace = (
                moments.mse(line, N, scheme="systematic"),
                systematic_covariance(fractions(line), N),
            )
            worst = max(worst, relative_error(np.diag([mse, 1.0]), np.diag([trace.trace(), 1])))
    assert worst < TOLERANCE


def nearly_whole_counts(seed):
    """(w, N): ``N |w_i| / g`` whole numbers; of decimal fractions, but for rounding."""
    gen = np.random.default_rng(seed)
    for _ in range(300):
        parts = gen.integers(0, 50, int(gen.integers(1, 7)))
        N = int(parts.sum())
        if N:
            signs = gen.choice([-1.0, 1.0], len(parts))
            yield signs * parts, N * int(10.0 ** gen.uniform(0.0, 13.0)), True
            yield signs * parts / 10.0, N * int(10.0 ** gen.uniform(0.0, 10.0)), False


def test_systematic_samples_where_counts_are_nearly_whole():
    for w, N, whole in nearly_whole_counts(3):
        exact = systematic_covariance(fractions(w), N)
        assert not whole or not exact.any()
        mse, found = (
            moments.mse(w, N, scheme="systematic"),
            moments.covariance(w, N, scheme="systematic"),
        )
        if whole:
            assert mse == 0.0
            assert not found.any()
        trace = float(exact.trace())
        assert mse == pytest.approx(trace, rel=TOLERANCE, abs=0.0)
        variances = np.array([float(v) for v in np.diagonal(exact)])
        np.testing.assert_allclose(np.diagonal(found), variances, rtol=TOLERANCE, atol=0.0)
        # a covariance is the difference of numbers of size 1 that are rounded
        sd = np.sqrt(variances)
        slack = np.minimum(2.0 * np.outer(sd, sd), 1e-15 * (np.abs(w).sum() / N) ** 2)
        error = np.array(
            [
                [float(abs(a - Fraction(float(b)))) for a, b in zip(*rows, strict=True)]
                for rows in zip(exact, found, strict=True)
            ]
        )
        assert (error <= slack + TOLERANCE * np.outer(sd, sd)).all()
