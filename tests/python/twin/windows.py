"""Windows of readings and inputs in plain NumPy, from their definition."""

from __future__ import annotations

import numpy as np


def filtered(s, pole, count, t):
    """The filters (xi^1, .., xi^r) at step t of the signal s (T, k), all begun at s[0]."""
    xi = [s[0]] * count
    for k in range(1, t + 1):
        before = [s[k], *xi[:-1]]
        xi = [pole * one + (1 - pole) * v for one, v in zip(xi, before, strict=True)]
    return np.concatenate(xi)


def rows(y, u, t, *, lags=None, filters=None, delay=0, intercept=False):
    """z_t of a piece with readings y (T + 1, n_y) and inputs u (T, m)."""
    if lags is not None:
        past = [y[t - k] for k in range(lags)]
        acting = [u[t - delay - k] for k in range(lags)]
        parts = [*past, *acting]
    else:
        pole, count = filters
        parts = [filtered(y, pole, count, t), filtered(u, pole, count, t - delay)]
    return np.concatenate([*parts, np.ones(int(intercept))])


def d1():
    """A record of one output and one input without random numbers: y (61, 1), u (60, 1)."""
    t = np.arange(60)
    u = ((3 * t**2 + 2 * t) % 7 - 3) / 3
    y = [0.3, -0.2]
    for k in range(1, 60):
        w = ((k + 3) ** 2 % 11 - 5) / 20
        y.append(1.2 * y[k] - 0.5 * y[k - 1] + u[k] + 0.4 * u[k - 1] + w)
    return np.array(y)[:, None], u[:, None]


def rest(H, r, m, *, lags=None, filters=None, delay=0, intercept=False):
    """(z, u, what constant inputs do to the next outputs) where ``H z`` is nearest to ``y = r``."""
    T = (lags or filters[1]) + delay + 1

    def always(u):
        y, v = np.tile(r, (T + 1, 1)), np.tile(u, (T, 1))
        of = {"lags": lags, "filters": filters, "delay": delay, "intercept": intercept}
        return rows(y, v, T - 1, **of)

    start = always(np.zeros(m))
    per = np.column_stack([always(unit) - start for unit in np.eye(m)])
    u = np.linalg.lstsq(H @ per, r - H @ start, rcond=None)[0]
    return start + per @ u, u, H @ per
