"""Windows, regions of their coefficients and the tube of outputs, in plain NumPy."""

from __future__ import annotations

import numpy as np


def lag_rows(y, u, lags):
    """(z, y one step later) with ``z = (y_t .. y_{t-p+1}, u_t .. u_{t-p+1})``."""
    past = range(lags - 1, len(y) - 1)
    z = [
        np.concatenate(
            [y[t - lags + 1 : t + 1][::-1].ravel(), u[t - lags + 1 : t + 1][::-1].ravel()]
        )
        for t in past
    ]
    return np.array(z), y[lags:]


def lag_system(Theta, lags, m):
    """``([A B], J, G)`` of ``x = (y_t .. y_{t-p+1}, u_{t-1} .. u_{t-p+1})``."""
    p = len(Theta)
    past, acted = p * lags, m * (lags - 1)
    n = past + acted
    J = np.zeros((past + m * lags, n + m))
    J[:past, :past] = np.eye(past)
    J[past : past + m, n:] = np.eye(m)
    J[past + m :, past:n] = np.eye(acted)
    matrix = np.zeros((n, n + m))
    matrix[:p] = Theta @ J
    matrix[p:past, : past - p] = np.eye(past - p)
    if acted:
        matrix[past : past + m, n:] = np.eye(m)
        matrix[past + m :, past : n - m] = np.eye(acted - m)
    return matrix, J, np.eye(n)[:, :p]


def filter_step(xi, s, pole):
    """``xi^1 = a xi^1 + (1 - a) s``, ``xi^j = a xi^j + (1 - a) xi^{j-1}`` of the step before."""
    return pole * xi + (1.0 - pole) * np.vstack([s[None], xi[:-1]])


def filter_rows(y, u, pole, count, burn):
    """(z, y one step later) after `burn` rows."""
    xi, eta = np.repeat(y[:1], count, 0), np.repeat(u[:1], count, 0)
    z = []
    for t in range(len(y) - 1):
        if t:
            xi, eta = filter_step(xi, y[t], pole), filter_step(eta, u[t], pole)
        z.append(np.concatenate([xi.ravel(), eta.ravel()]))
    return np.array(z)[burn:], y[burn + 1 :]


def filter_system(Theta, pole, count, m):
    """``([A B], J, G)`` of ``x = (xi_y at t, xi_u at t - 1)``."""
    p = len(Theta)
    past, acted = p * count, m * count
    n = past + acted

    def moved(width):
        F = pole * np.eye(width * count) + (1.0 - pole) * np.eye(width * count, k=-width)
        g = np.zeros((width * count, width))
        g[:width] = (1.0 - pole) * np.eye(width)
        return F, g

    (F, G), (E, h) = moved(p), moved(m)
    J = np.zeros((n, n + m))
    J[:past, :past] = np.eye(past)
    J[past:, past:n], J[past:, n:] = E, h
    matrix = np.zeros((n, n + m))
    matrix[:past, :past] = F
    matrix[:past] += G @ Theta @ J
    matrix[past:, past:n], matrix[past:, n:] = E, h
    return matrix, J, np.vstack([G, np.zeros((acted, p))])


def fitted(z, after):
    """H, V and the residual sum of squares of least squares."""
    V = z.T @ z
    H = np.linalg.solve(V, z.T @ after).T
    left = after - z @ H.T
    return H, V, left.T @ left


def _wcs(matrices, sizes):
    """Weighted Cauchy and Schwarz: ``>= ||sum M_j y_j||`` for all ``||y_j|| <= sizes_j``."""
    norms = [np.linalg.norm(M, 2) for M in matrices]
    total = sum(s * one for s, one in zip(sizes, norms, strict=True))
    if total == 0.0:
        return 0.0
    square = sum(
        s / one * M @ M.T for M, s, one in zip(matrices, sizes, norms, strict=True) if s * one
    )
    return float(np.sqrt(np.linalg.eigvalsh(square)[-1] * total))


def output_tube(H, V, S, system, x0, inputs, gain=None):
    """Outputs (K, p) of the centre and radii (K,), for ``(H - Theta) V (H - Theta)' <= S``."""
    matrix, J, G = system
    n, p = G.shape
    m = J.shape[1] - n
    A, B = matrix[:, :n], matrix[:, n:]
    join = np.vstack([np.eye(n), np.zeros((m, n)) if gain is None else gain])
    root = np.linalg.cholesky(S)
    white = np.linalg.inv(np.linalg.cholesky(V))  # white' white = V^-1
    closed, E, ahead = matrix @ join, white @ J @ join, H @ J @ join
    x, c, predicted = x0, [], []
    for u in inputs:
        z = J @ np.concatenate([x, u])
        c.append(white @ z)
        predicted.append(H @ z)
        x = A @ x + B @ u
    moved = [G @ root]
    for _ in inputs[1:]:
        moved.append(closed @ moved[-1])
    seen = [root] + [ahead @ M for M in moved[:-1]]  # of the outputs
    inside = [E @ M for M in moved]

    def linear(M, k):
        whole = sum(np.kron(c[j][None], M[k - 1 - j]) for j in range(k))
        crude = _wcs(M[:k][::-1], [np.linalg.norm(one) for one in c[:k]])
        return min(crude, np.sqrt(p) * np.linalg.norm(whole, 2))

    b, r = [0.0], []
    for k in range(1, len(inputs) + 1):
        r.append(linear(seen, k) + _wcs(seen[:k][::-1], b))
        b.append(linear(inside, k) + _wcs(inside[:k][::-1], b))
    return np.array(predicted), np.array(r)
