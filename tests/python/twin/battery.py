"""The tests of logs in `rust/identify/battery`, by least squares with more columns."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy import stats

CODES = [s * (10.0**k - 1.0) for k in range(3, 9) for s in (1, -1)] + [32767, -32768, 65535, 1e30]


def left(Y, Z):
    """What least squares on Z leaves of Y."""
    return Y - Z @ np.linalg.lstsq(Z, Y, rcond=None)[0] if Z.shape[1] else Y


def wilks(Y, Z, extra):
    """Probability and share of what `extra` columns explain of Y beside Z (Rao 1951)."""
    of = left(extra, Z)
    of = of[:, np.linalg.norm(of, axis=0) > 1e-5 * np.linalg.norm(extra, axis=0)]
    N, p, q = len(Y), Y.shape[1], np.linalg.matrix_rank(of)
    E0 = left(Y, Z)
    E1 = left(E0, of)
    ratio = np.linalg.det(np.linalg.solve(E0.T @ E0, E1.T @ E1))
    t = np.sqrt((p * p * q * q - 4) / (p * p + q * q - 5)) if p * p + q * q > 5 else 1.0
    a, b = p * q, t * (N - Z.shape[1] - (p + q + 1) / 2) - (p * q - 2) / 2
    return stats.f.sf((ratio ** (-1 / t) - 1) * b / a, a, b), 1 - ratio ** (1 / p)


def shifted(values, places, by):
    """The rows so many pairs before, or behind for a negative number; 0 outside the piece."""
    out = np.zeros_like(values)
    for t in range(len(values)):
        if by >= 0 and places[t] >= by:
            out[t] = values[t - by]
        if by < 0 and t - by < len(values) and places[t - by] == places[t] - by:
            out[t] = values[t - by]
    return out


def tests(x, u, y, places, runs):
    """Name -> p-value of a model of states without intercept."""
    Z, N = np.hstack([x, u]), len(x)
    H = np.linalg.lstsq(Z, y, rcond=None)[0]
    E = y - Z @ H
    S = E.T @ E
    rms = np.sqrt(np.mean(Z**2, axis=0))
    effect = rms * np.sqrt(np.einsum("ij,jk,ik->i", H, np.linalg.inv(S), H))
    order = list(np.argsort(-effect, kind="stable"))
    chosen = order[:3]
    if all(j < x.shape[1] for j in chosen[:2]):  # one of them is an input
        chosen = [*chosen[:2], next((j for j in order if j >= x.shape[1]), chosen[-1])]
    s = (Z / rms)[:, chosen]
    k = s.shape[1]
    squares = np.column_stack([s[:, a] * s[:, b] for a in range(k) for b in range(a, k)])

    def earlier(by, *columns):
        """What columns of the rows so many pairs before explain, of the rows that have them."""
        has = places >= by if by >= 0 else np.append(places[1:], 0) > 0
        if has.sum() <= Z.shape[1] + y.shape[1] + sum(one.shape[1] for one in columns):
            return 1.0
        extra = np.hstack([shifted(one, places, by) for one in columns])
        return wilks(y[has], Z[has], extra[has])[0]

    lags = [earlier(lag, u) for lag in range(1, 9)]
    own = []
    for run in np.unique(runs):
        inside = runs == run
        if inside.sum() > 1:
            own.append(wilks(y, Z, Z * inside[:, None])[0])
    signs = [wilks(y, Z, np.sign(Z[:, [j]]))[0] for j in range(Z.shape[1])]
    curves = [wilks(y, Z, squares)[0], wilks(y, Z, s**3)[0], *signs]
    half = wilks(y, Z, Z * (np.arange(N) >= N // 2)[:, None])[0]
    return {
        "offset": wilks(y, Z, np.ones((N, 1)))[0],
        "memory": earlier(1, x, u),
        "dead time": min(1.0, len(lags) * min(lags)),
        "nonlinear": min(1.0, len(curves) * min(curves)),
        "change": min(1.0, 2 * min(half, len(own) * min(own))),
        "drift": wilks(y, Z, Z * places[:, None])[0],
    }


def far_cells(cells, n, places):
    """Pairs and columns of cells far from all others of their columns, of n readings and inputs.

    How far from the median, over the farthest of the others: 2 for codes, 10 for readings.
    """
    away = np.abs(cells - np.median(cells, axis=0))
    count = max(1, len(cells) // 100)
    found = []
    pulses = False
    for j in reversed(range(cells.shape[1])):  # inputs first: a reading may follow a pulse
        largest = np.sort(away[:, j])[::-1][: count + 1]
        for own, following in pairwise(largest):
            at = np.flatnonzero(away[:, j] >= own)
            code = cells[at[0], j] in CODES and bool((cells[at, j] == cells[at[0], j]).all())
            if own <= (2.0 if code else 10.0) * following:
                continue
            begins = (places[at] == 0).any() or following == 0.0
            if code or (j < n and not begins and not pulses):
                found += [(int(t), j) for t in at]
            pulses |= j >= n
            break
    return [t for t, _ in sorted(found)], [j for _, j in sorted(found)]
