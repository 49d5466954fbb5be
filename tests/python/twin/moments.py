"""Covariances of averages of realizations by their formulas; an average is (size, scheme).

A size of 0 stands for what is known exactly. The fractional parts of systematic samples are exact.
"""

from fractions import Fraction

import numpy as np


def covariance(w, size, scheme="iid"):
    """Of the average of a vector."""
    absolute, signs = np.abs(w), np.sign(w)
    if size == 0 or not w.any():
        return np.zeros((w.size, w.size))
    if scheme == "iid":
        others = np.array([np.delete(absolute, i).sum() for i in range(w.size)])
        return np.where(np.eye(w.size) > 0.0, absolute * others, -np.outer(w, w)) / size
    parts = [Fraction(float(v)) for v in absolute]
    c = [size * sum(parts[:i], Fraction(0)) / sum(parts) for i in range(w.size + 1)]
    phi = [v % 1 for v in c]
    both = np.array([[min(f, h) - f * h for h in phi] for f in phi])
    counts = both[1:, 1:] - both[:-1, 1:] - both[1:, :-1] + both[:-1, :-1]
    return (absolute.sum() / size) ** 2 * counts.astype(float) * np.outer(signs, signs)


def excess(A, M, size, axis, scheme="iid"):
    """``E[A_hat M A_hat^T] - A M A^T``"""
    if axis == "columns":
        return sum(M[j, j] * covariance(A[:, j], size, scheme) for j in range(A.shape[1]))
    return np.diag([(covariance(row, size, scheme) * M).sum() for row in A])


def fused(A, B, x0, xf, sizes, of_control, axis, scheme="iid", paired=False):
    """Of the control, or of the state that it leads to."""
    total = max(*sizes, 1) if paired else 1
    N0, Nf, NA = (min(N, 1) for N in sizes) if paired else sizes
    C0 = covariance(x0, N0, scheme)
    C = covariance(xf, Nf, scheme) + A @ C0 @ A.T
    C = (C + excess(A, C0 + np.outer(x0, x0), NA, axis, scheme)) / total
    F = np.linalg.pinv(B) if of_control else B @ np.linalg.pinv(B)
    return F @ C @ F.T


def final(A, states, xf, sizes, axis):
    """Of the state after the steps of the best control, to leading order."""
    (N0, Nf, NA), n, K = sizes, len(A), len(states) - 1
    powers = [np.linalg.matrix_power(A, k) for k in range(K + 1)]
    C = covariance(xf, Nf) + powers[K] @ covariance(states[0], N0) @ powers[K].T
    for j in range(n):
        if axis == "columns":
            G = sum(states[k, j] * powers[K - 1 - k] for k in range(K))
        else:
            G = sum(np.outer(powers[K - 1 - k][:, j], states[k]) for k in range(K))
        C = C + G @ covariance(A[:, j] if axis == "columns" else A[j], NA) @ G.T
    return C


def trajectory(A, B, states, u, sizes, axis):
    """Along a trajectory, with new averages of ``(A, B)`` in every step and of the first state."""
    NA, NB, N0 = sizes
    S = [covariance(states[0], N0)]
    for x, v in zip(states, u, strict=False):
        grown = excess(A, S[-1] + np.outer(x, x), NA, axis)
        S.append(A @ S[-1] @ A.T + grown + excess(B, np.outer(v, v), NB, axis))
    return np.array(S)
