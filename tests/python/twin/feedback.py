"""The proof of a feedback in rational numbers, and the norms that it bounds in NumPy."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

U = 2.0**-53


def joined(K, d):
    """``[I; K; 0]``."""
    m, n = K.shape
    return np.vstack([np.eye(n), K, np.zeros((d - n - m, n))])


def rational(array):
    """The entries as fractions."""
    return [[Fraction(float(v)) for v in row] for row in np.atleast_2d(array)]


def times(a, b):
    return [
        [sum(x * y for x, y in zip(row, col, strict=True)) for col in zip(*b, strict=True)]
        for row in a
    ]


def positive_definite(M):
    """By elimination in whole numbers (Bareiss 1968): the entries are multiples of a power of 2."""
    unit = max(value.denominator for row in M for value in row)
    M, before = [[int(value * unit) for value in row] for row in M], 1
    for k in range(len(M)):
        if M[k][k] <= 0:
            return False
        for i in range(k + 1, len(M)):
            pairs = zip(M[i], M[k], strict=True)
            M[i] = [(a * M[k][k] - M[i][k] * b) // before for a, b in pairs]
        before = M[k][k]
    return True


def true(C, W, S, K, rho, R):
    """Whether the claim is true for these numbers and Q = R R', without any rounding."""
    n, d = C.shape
    J = rational(joined(K, d))
    F = times(rational(C), J) + times(rational(W), J)
    root = rational(R)
    Qr, Sr, size = (
        times(root, [list(col) for col in zip(*root, strict=True)]),
        rational(S),
        Fraction(float(rho)) ** 2,
    )
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


def unmoved(region, p):
    """(State, growth) of the modes with ``|L| >= 1`` that no input is seen to move.

    ``w'(A - L I) = 0``, w_p the part of the first p rows, and x_j how the other rows follow an
    input ``e_j L^t``: the mode is moved by ``w_p'(A_p x_j + B_p e_j)``, which the region knows up
    to ``||w_p|| ||(Theta - C)(x_j, e_j)||``.
    """
    n, m = region.n, region.m
    A, B = region.centre[:, :n], region.centre[:, n : n + m]
    values, left = np.linalg.eig(A.T)
    shift, own = (np.where(np.arange(n)[:, None] < p, 0.0, M) for M in (A, B))
    found = []
    for k in np.flatnonzero(np.abs(values) >= 1.0):
        w = left[:p, k]
        x = np.linalg.solve(values[k] * np.eye(n) - shift, own)
        moved = np.abs(w @ (A[:p] @ x + B[:p]))
        parts = [(x.real, np.eye(m)), (x.imag, np.zeros((m, m)))]
        off = sum(np.array([region.bound(a[:, j], u[:, j]) for j in range(m)]) for a, u in parts)
        if (moved <= np.linalg.norm(w) * off).all():
            found.append((int(np.argmax(np.abs(w))), float(np.abs(values[k]))))
    return found
