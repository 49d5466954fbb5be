"""The least-variance predictor from a window that is unbiased for every state, in plain NumPy."""

from __future__ import annotations

import numpy as np


def unbiased(A, B, C, Q, R, p):
    """Theta_p (n_y, p (n_y + m)) in the order of lags, and the covariance of its error.

    x+ = A x + B u + w, y = C x + v, w ~ N(0, Q), v ~ N(0, R). With x0 the state p - 1 steps back,
    ``Y = O x0 + T U + e`` and ``y+ = c x0 + t U + f``; generalized least squares with
    ``S = cov e``, ``k = cov(f, e)``: ``W = k S^-1 + (c - k S^-1 O) (O' S^-1 O)^-1 O' S^-1``.
    """
    n, m, ny = len(A), B.shape[1], len(C)
    powers = [np.linalg.matrix_power(A, k) for k in range(p + 1)]
    seen = np.vstack([C @ powers[k] for k in range(p + 1)])
    inputs, noise = np.zeros(((p + 1) * ny, p * m)), np.zeros(((p + 1) * ny, p * n))
    for k in range(1, p + 1):
        for j in range(k):
            inputs[k * ny : (k + 1) * ny, j * m : (j + 1) * m] = C @ powers[k - 1 - j] @ B
            noise[k * ny : (k + 1) * ny, j * n : (j + 1) * n] = C @ powers[k - 1 - j]
    cov = noise @ np.kron(np.eye(p), Q) @ noise.T + np.kron(np.eye(p + 1), R)
    past = slice(0, p * ny)
    S, k, c = cov[past, past], cov[p * ny :, past], seen[p * ny :]
    inverse = np.linalg.inv(S)
    G = seen[past].T @ inverse
    W = k @ inverse + (c - k @ inverse @ seen[past]) @ np.linalg.solve(G @ seen[past], G)
    both = np.hstack([-W, np.eye(ny)])
    of_inputs = inputs[p * ny :] - W @ inputs[past]
    newest = np.arange(p)[::-1]
    readings = W.reshape(ny, p, ny)[:, newest].reshape(ny, -1)
    return np.hstack([readings, of_inputs.reshape(ny, p, m)[:, newest].reshape(ny, -1)]), (
        both @ cov @ both.T
    )


def kalman(A, C, Q, R):
    """The gain L of the steady predictor x+ = A x + B u + L (y - C x), and the innovations."""
    P = np.eye(len(A))
    for _ in range(3000):
        S = C @ P @ C.T + R
        L = A @ P @ C.T @ np.linalg.inv(S)
        P = A @ P @ A.T + Q - L @ S @ L.T
        P = (P + P.T) / 2.0
    return L, C @ P @ C.T + R
