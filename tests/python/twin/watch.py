"""The evidence of an alarm in plain NumPy: every bet by its formula, summed over all starts."""

import numpy as np

from . import windows

SHIFTS, SMALL, BLOCKS = (0.15, 0.5, 1.5, 5.0), 2, (8, 64)
SHARES = (0.05, 0.2, 0.5, 0.9)
RECENT = 1000  # calls before an alarm
SIZES = (5.0, 50.0, 500.0)  # pairs whose noise is as large as a change
SCALES = np.array([1.0, 1.2, 1.5, 3.0, 8.0, 20.0])  # how many times louder the noise may be
TRUST = 0.5  # the power of the likelihood


def phi(t):
    return np.sign(t) * np.log1p(np.abs(t) + t * t / 2.0)


def evidence(C, V, S_r, S, pairs, rows, gains, moving=False):
    """The evidence after each pair (z, y), for the law "variance", without alarms."""
    (n, d), L = C.shape, np.linalg.cholesky(S)
    back, W = np.linalg.inv(L), np.linalg.inv(np.linalg.cholesky(V))
    B = back @ np.linalg.cholesky(S_r)
    rms = np.sqrt(np.diag(V) / pairs)
    bets = [(back[:, i], j) for i in range(n) for j in range(d + 1)]
    bets += [(back @ C[:, j], j) for j in gains]
    bets = [(one / np.linalg.norm(one), j) for one, j in bets]
    units = np.append(1.0 / rms, 1.0)
    single = np.zeros((len(bets), len(SHIFTS), 2))
    blocks = [np.zeros((len(bets), SMALL, 2)) for _ in BLOCKS]
    energy, learned = np.zeros(len(SHARES)), np.zeros(2)
    estimates = [np.zeros((n, d)), np.zeros((n, d))]
    past, found = [], []
    for t, row in enumerate(rows, 1):
        z, y = row[:d], row[d:]
        e, h = back @ (y - C @ z), np.linalg.norm(W @ z)
        past.append((z, e, h))
        for b, (along, j) in enumerate(bets):
            g = 1.0 if j == d else z[j]
            x, v, p = g * (along @ e), g * g, abs(g) * np.linalg.norm(B.T @ along) * h
            for k, shift in enumerate(SHIFTS):
                a = max(0.0, shift * units[j] - p / v)
                for side, one in enumerate((x, -x)):
                    factor = np.exp(phi(a * (one - p))) / (1.0 + a * a * v / 2.0)
                    single[b, k, side] = factor * (1.0 + single[b, k, side])
        for q, memory in enumerate((20.0, 200.0)):
            zeta = np.sqrt(pairs) * W @ z
            mean = estimates[q] @ zeta
            size = np.linalg.norm(mean)
            a = min(5.0, max(0.0, size - np.linalg.norm(B, 2) * h))
            factor = 1.0
            if a > 0.0:
                along = mean / size
                x, p = along @ e, np.linalg.norm(B.T @ along) * h
                factor = np.exp(phi(a * (x - p))) / (1.0 + a * a / 2.0)
            learned[q] = factor * (1.0 + learned[q])
            estimates[q] += np.outer(e - mean, zeta) / (memory + zeta @ zeta)
        r = max(0.0, np.linalg.norm(e) - np.linalg.norm(B, 2) * h)
        energy = (1.0 - np.array(SHARES) + np.array(SHARES) * r * r / n) * (1.0 + energy)
        total = single.mean() + energy.mean() + learned.sum()
        for which, steps in enumerate(BLOCKS):
            if t % steps:
                continue
            for b, (along, j) in enumerate(bets):
                size = np.linalg.norm(B.T @ along)
                for k in range(SMALL):
                    s = SHIFTS[k] * units[j]
                    for side, sign in enumerate((1.0, -1.0)):
                        log = block(past[-steps:], sign * along, j, s, size, W, d, moving)
                        blocks[which][b, k, side] = np.exp(log) * (1.0 + blocks[which][b, k, side])
            total += steps * blocks[which].mean()
        found.append(total / 6.0)
    return np.array(found)


def block(pairs, along, j, s, size, W, d, moving):
    """The logarithm of the factor of a block."""
    log, drift, squares = 0.0, 0.0, 0.0
    for z, e, h in pairs:
        g = 1.0 if j == d else z[j]
        x, v, p = g * (along @ e), g * g, abs(g) * size * h
        t = s * x
        log += phi(s * (x - p) if moving else t) - np.log1p(s * s * v / 2.0)
        slope = (1.0 + abs(t)) / (1.0 + abs(t) + t * t / 2.0)
        drift, squares = drift + slope * g * (W @ z), squares + p * p
    if moving:
        return log
    return log - s * size * np.linalg.norm(drift) - s * s / 8.0 * squares


def onset(calls, p, about, level, fill, **window):
    """Places in `calls`, (y, inputs that had acted), between which a change began.

    `about`: a region, the covariance of the noise, and the pairs they are from; the window is full
    after `fill` steps. Before a change the coefficients are of the region as a Gaussian one, behind
    it within the noise of 5, 50 or 500 pairs.
    """
    calls, (region, noise, pairs) = calls[-RECENT:], about
    z, y, at = [], [], []
    read, acted = (np.isfinite(one).all(axis=1) for one in np.split(calls, [p], axis=1))
    begin = 0
    for t in range(1, len(calls)):
        if not (read[t - 1] and read[t] and acted[t]):
            begin = t
        elif t - 1 - begin >= fill:
            piece = calls[begin : t + 1]
            z.append(windows.rows(piece[:, :p], piece[1:, p:], t - 1 - begin, **window))
            y.append(calls[t, :p])
            at.append(t)
    if not at:
        return None
    (part,) = region.parts
    off = np.array(y) - np.array(z) @ region.centre.T
    x = np.array(z)[:, part.columns] @ part.white.T
    e = np.linalg.solve(np.linalg.cholesky(noise), off.T).T
    behind = [likelihood(x[::-1], e[::-1], pairs / one, SCALES) for one in SIZES]
    total = likelihood(x, e, 1.0, np.ones(1))[0] + np.logaddexp.reduce(np.vstack(behind))[::-1]
    share = np.cumsum(np.exp(TRUST * (total[:-1] - total[:-1].max())))
    first, last = np.searchsorted(share / share[-1], [level / 2.0, 1.0 - level / 2.0])
    return at[first], at[min(int(last), len(at) - 1)]


def likelihood(x, e, size, scales):
    """Logarithms of the density of the first 0, 1, .. rows of ``e = c (B x + w)``, B of this size.

    A row for each c.
    """
    K, B = size * np.eye(x.shape[1]), np.zeros((x.shape[1], e.shape[1]))
    logs, squares, n = [0.0], [0.0], e.shape[1]
    for row, one in zip(x, e, strict=True):
        g, off = K @ row, one - row @ B
        v = 1.0 + row @ g
        logs.append(logs[-1] + n * np.log(v))
        squares.append(squares[-1] + off @ off / v)
        K, B = K - np.outer(g, g / v), B + np.outer(g, off / v)
    steps, c = n * np.arange(len(logs)), scales[:, None]
    return -0.5 * (np.array(logs) + np.array(squares) / c**2) - steps * np.log(c)
