"""The proof of a feedback in NumPy, in floating point and in rational numbers."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

U = 2.0**-53


def joined(K, d):
    """``[I; K; 0]``."""
    m, n = K.shape
    return np.vstack([np.eye(n), K, np.zeros((d - n - m, n))])


def claimed(C, W, S, K, rho, Q, X=None, alpha=1.0, lam=1.0):
    """``[Q - X - alpha rho^2 S, 0; 0, alpha I] - F Q F' / lambda``, F = [A0; E], and its sizes."""
    n, d = C.shape
    J = joined(K, d)
    X = np.zeros((n, n)) if X is None else X
    F, aF = np.vstack([C @ J, W @ J]), np.vstack([abs(C) @ abs(J), abs(W) @ abs(J)])
    top = Q - X - alpha * rho**2 * S
    sizes = abs(Q) + abs(X) + alpha * rho**2 * abs(S)
    r = len(W)
    whole = np.block([[top, np.zeros((n, r))], [np.zeros((r, n)), alpha * np.eye(r)]])
    around = np.block([[sizes, np.zeros((n, r))], [np.zeros((r, n)), alpha * np.eye(r)]])
    M = whole - F @ Q @ F.T / lam
    return (M + M.T) / 2, around, aF @ abs(Q) @ aF.T / lam


def verified(C, W, S, K, rho, Q, X=None, alpha=1.0, lam=1.0):
    """Whether both shifted Cholesky factorizations run through (Rump 2006)."""
    arrays = [C, W, S, K, Q] + ([] if X is None else [X])
    if not all(np.isfinite(one).all() for one in arrays) or not np.isfinite(rho):
        return False
    if not (alpha > 0 and 0 < lam <= 1 and (Q == Q.T).all() and (S == S.T).all()):
        return False
    n, d = C.shape
    M, around, products = claimed(C, W, S, K, rho, Q, X, alpha, lam)
    N = len(M)

    def gamma(j):
        return j * U / (1 - j * U)

    formed = 1.01 * (gamma(8) * around + gamma(2 * (n + d) + 2 * n + 16) * products).sum(1).max()
    factored = 1.01 * gamma(N + 3) / (1 - gamma(N + 3)) * np.trace(abs(M))
    own = 1.01 * gamma(n + 3) / (1 - gamma(n + 3)) * np.trace(Q)
    try:
        np.linalg.cholesky(M - (formed + factored) * np.eye(N))
        np.linalg.cholesky(Q - own * np.eye(n))
    except np.linalg.LinAlgError:
        return False
    return True


def rational(array):
    """The entries as fractions."""
    return [[Fraction(float(v)) for v in row] for row in np.atleast_2d(array)]


def times(a, b):
    return [
        [sum(x * y for x, y in zip(row, col, strict=True)) for col in zip(*b, strict=True)]
        for row in a
    ]


def positive_definite(M):
    """By elimination without rounding."""
    M = [row[:] for row in M]
    for k in range(len(M)):
        if M[k][k] <= 0:
            return False
        for i in range(k + 1, len(M)):
            by = M[i][k] / M[k][k]
            M[i] = [a - by * b for a, b in zip(M[i], M[k], strict=True)]
    return True


def true(C, W, S, K, rho, Q):
    """Whether the claim is true for these numbers, without any rounding."""
    n, d = C.shape
    J = rational(joined(K, d))
    F = times(rational(C), J) + times(rational(W), J)
    Qr, Sr, size = rational(Q), rational(S), Fraction(float(rho)) ** 2
    FQF = times(times(F, Qr), [list(col) for col in zip(*F, strict=True)])
    N = len(F)

    def entry(i, j):
        if i < n and j < n:
            return Qr[i][j] - size * Sr[i][j]
        return Fraction(int(i == j))

    M = [[entry(i, j) - FQF[i][j] for j in range(N)] for i in range(N)]
    return positive_definite(M) and positive_definite(Qr)


def stacked_norm(A0, D, E, points=4001):
    """``max ||E (zI - A0)^-1 D||`` over a grid of the upper half of the unit circle."""
    z = np.exp(1j * np.linspace(0.0, np.pi, points))[:, None, None]
    response = E @ np.linalg.solve(z * np.eye(len(A0)) - A0, np.broadcast_to(D, (points, *D.shape)))
    return np.linalg.norm(response, 2, axis=(1, 2)).max()


def deviation(C, W, D, G, K, plan, x0, steps):
    """States and inputs of a member minus those of the centre under ``u = ub + K (x - xb)``."""
    n, m = len(C), len(K)
    member = C + D @ G @ W
    x, xb, off = x0.copy(), x0.copy(), []
    for k in range(steps + 1):
        ub = plan[k] if k < len(plan) else K @ xb
        u = ub + K @ (x - xb)
        off.append(np.concatenate([x - xb, u - ub]))
        one = np.ones(C.shape[1] - n - m)
        x, xb = member @ np.concatenate([x, u, one]), C @ np.concatenate([xb, ub, one])
    return np.array(off)
