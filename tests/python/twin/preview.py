"""What targets to come add to the inputs of a gain, in NumPy."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_discrete_are


def preview(model, weights, K, path, start):
    """The least ``sum |y - y0|_Q^2 + |u - u0|_R^2``, y = C x + D u: what u = K x lacks of it."""
    (A, B, C, D), (Q, R), (x0, u0, w) = model, weights, path
    Ru, N = D.T @ Q @ D + R, C.T @ Q @ D
    S = solve_discrete_are(A, B, C.T @ Q @ C, Ru, s=N)
    own = -np.linalg.solve(Ru + B.T @ S @ B, B.T @ S @ A + N.T)
    lacks = x0 @ A.T + u0 @ B.T + w - np.vstack([x0[1:], x0[-1:]])
    ahead, after = np.zeros_like(u0), np.zeros(len(A))
    for k in range(len(x0) - 1, -1, -1):
        after = (A + B @ own).T @ after + S @ lacks[k]
        ahead[k] = -np.linalg.solve(Ru + B.T @ S @ B, B.T @ after)
    adds, way, x = np.zeros_like(u0), np.zeros_like(x0), start
    for k in range(len(x0)):
        more = own @ (x - x0[k]) + ahead[k]
        adds[k], way[k] = more - K @ (x - x0[k]), x
        x = A @ x + B @ (u0[k] + more) + w[k]
    return adds, way
