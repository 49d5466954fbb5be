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
