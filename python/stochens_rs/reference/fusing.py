"""Weights for an ensemble: uniform, ALSE (all samples at once) and SLSE (one sample at a time).

With samples E_1..E_N and a target E*, the objective is f(y) = ||sum_s y_s E_s - E*||^2 in the
Frobenius norm, over the simplex {y >= 0, sum y = 1} or the subsimplex {y >= 0, sum y <= 1}.
Samples are dense here, (N, n) or (N, n, m); `alse_singleton` alone takes indices.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class Fused(NamedTuple):
    """estimate = sum_s weights_s E_s, its distance to the target, and the Frank-Wolfe gap."""

    estimate: Array
    weights: Array
    error: float
    gap: float


class Greedy(NamedTuple):
    """The last estimate, its weights, and the error after the samples 1..n for n = 1..N."""

    estimate: Array
    weights: Array
    errors: Array

    @property
    def error(self) -> float:
        """The last error."""
        return float(self.errors[-1])


def _norm(x: Array) -> float:
    return float(np.sqrt(np.sum(x * x)))


def frank_wolfe_gap(
    samples: ArrayLike, y: ArrayLike, target: ArrayLike, weight_set: str = "simplex"
) -> float:
    """<g, y> - min g with g_s = 2 <E_s, F - E*>: an upper bound of f(y) - min f.

    On the subsimplex the minimum also runs over y = 0, where <g, .> is 0.
    """
    E, t, w = np.asarray(samples, float), np.asarray(target, float), np.asarray(y, float)
    S = E.reshape(len(E), -1)
    g = 2.0 * S @ (w @ S - t.ravel())
    floor = g.min() if weight_set == "simplex" else min(0.0, g.min())
    return float(g @ w - floor)


def _fused(E: Array, y: Array, target: Array, weight_set: str = "simplex") -> Fused:
    estimate = np.tensordot(y, E, axes=1)
    return Fused(estimate, y, _norm(estimate - target), frank_wolfe_gap(E, y, target, weight_set))


def uniform(samples: ArrayLike, target: ArrayLike) -> Fused:
    """The mean of the samples."""
    E = np.asarray(samples, dtype=np.float64)
    return _fused(E, np.full(len(E), 1.0 / len(E)), np.asarray(target, dtype=np.float64))


# --- ALSE, closed form (Lemma 4.4, corrected) -----------------------------------------------------


def project_simplex(tau: ArrayLike) -> Array:
    """The nearest point of {Y >= 0, sum Y = 1}: max(tau - shift, 0), shift by the sum."""
    t = np.asarray(tau, dtype=np.float64)
    descending = np.sort(t)[::-1]
    shifts = (np.cumsum(descending) - 1.0) / np.arange(1, len(t) + 1)
    last = np.flatnonzero(descending > shifts)[-1]  # the largest number of positive entries
    return np.asarray(np.maximum(t - shifts[last], 0.0))


def project_subsimplex(tau: ArrayLike) -> Array:
    """The nearest point of {Y >= 0, sum Y <= 1}: clip; project only if the sum is above 1."""
    clipped = np.maximum(np.asarray(tau, dtype=np.float64), 0.0)
    return clipped if clipped.sum() <= 1.0 else project_simplex(tau)


def alse_singleton(
    indices: ArrayLike, atoms: ArrayLike, target: ArrayLike, weight_set: str = "simplex"
) -> Fused:
    """ALSE for samples of one vector: sample s is atoms[R_s] in entry R_s and 0 elsewhere.

    f = gamma^2 sum_{k seen} (Y_k - tau_k)^2 + sum_{k not seen} t_k^2 with tau_k = t_k / atoms_k,
    Y_k the sum of y_s over {s: R_s = k}. So Y is tau on the seen entries, projected; equal
    samples share Y_k equally. For t = w the projection is a shift: Y_k = |w_k| / gamma + const.
    """
    R = np.asarray(indices, dtype=np.int64).reshape(-1)
    a, t = np.asarray(atoms, dtype=np.float64), np.asarray(target, dtype=np.float64)
    N = len(R)
    if not np.any(a):  # every sample is 0: all weights are optimal
        return Fused(np.zeros_like(a), np.full(N, 1.0 / N), _norm(t), 0.0)
    seen, n_k = np.unique(R, return_counts=True)
    tau = t[seen] / a[seen]
    Y = project_simplex(tau) if weight_set == "simplex" else project_subsimplex(tau)
    share = np.zeros(len(a))
    share[seen] = Y / n_k
    estimate = np.zeros(len(a))
    estimate[seen] = a[seen] * Y
    # g_s = 2 <E_s, F - t> depends on R_s only
    g = 2.0 * a[seen] * (estimate - t)[seen]
    floor = g.min() if weight_set == "simplex" else min(0.0, g.min())
    return Fused(estimate, share[R], _norm(estimate - t), float(g @ Y - floor))


# --- ALSE for everything else: the point of a polytope nearest to the origin ----------------------


def _affine_minimizer(P: Array) -> Array:
    """Coefficients (sum 1, any sign) of the point of the affine hull of the rows nearest to 0."""
    directions = (P[1:] - P[0]).T
    z = np.linalg.lstsq(directions, -P[0], rcond=None)[0]
    return np.concatenate([[1.0 - z.sum()], z])


def _nearest_in_hull(P: Array) -> Array:
    """Weights y on the simplex that minimise ||y P||: Wolfe's active-set method (1976).

    The row with the smallest <row, x>, x = y P, joins the support. Then x moves to the minimizer
    over the affine hull of the support; a row whose weight reaches 0 leaves it.
    """
    eps, radius = np.finfo(float).eps, float(np.max(np.linalg.norm(P, axis=1)))
    first = int(np.argmin(np.sum(P * P, axis=1)))
    support, y = [first], np.array([1.0])
    best, best_norm = (support, y), np.inf
    while True:
        x = y @ P[support]
        if not _norm(x) < best_norm:  # no more progress than rounding
            break
        best, best_norm = (support, y), _norm(x)
        scores = P @ x
        new = int(np.argmin(scores))
        if x @ x - scores[new] <= 4 * eps * radius * best_norm or new in support:
            break
        support, y = [*support, new], np.append(y, 0.0)
        while True:
            z = _affine_minimizer(P[support]) if len(support) > 1 else np.array([1.0])
            if z.min() > 0.0:
                y = z
                break
            down = z <= 0.0
            step = np.min(y[down] / np.maximum(y[down] - z[down], np.finfo(float).tiny))
            y = y + min(step, 1.0) * (z - y)
            keep = y > eps
            keep[np.argmin(np.where(down, y, np.inf))] = False  # the one that reached 0
            support = [k for k, stays in zip(support, keep, strict=True) if stays]
            y = y[keep] / y[keep].sum()
    full = np.zeros(len(P))
    full[best[0]] = best[1]
    return full


def alse_dense(samples: ArrayLike, target: ArrayLike, weight_set: str = "simplex") -> Fused:
    """ALSE for any samples, exact up to rounding; the weights need not be unique.

    f(y) = ||sum_s y_s (E_s - E*)||^2 on the simplex; for the subsimplex, one sample 0 is added.
    """
    E, t = np.asarray(samples, dtype=np.float64), np.asarray(target, dtype=np.float64)
    P = E.reshape(len(E), -1) - t.ravel()
    if weight_set == "subsimplex":
        P = np.vstack([P, -t.ravel()])
    return _fused(E, _nearest_in_hull(P)[: len(E)], t, weight_set)


# --- SLSE (Lemma 4.5, corrected) ------------------------------------------------------------------


def line_search(F: Array, E: Array, target: Array) -> float:
    """t in [0, 1] with (1 - t) F + t E nearest to the target; 0 if E = F."""
    d = E - F
    dd = float(np.sum(d * d))
    if dd == 0.0:
        return 0.0
    return min(max(float(np.sum((target - F) * d)) / dd, 0.0), 1.0)


def _greedy(samples: ArrayLike, target: ArrayLike, safeguard: bool) -> Greedy:
    E, t = np.asarray(samples, dtype=np.float64), np.asarray(target, dtype=np.float64)
    N = len(E)
    F, y, total = E[0], np.zeros(N), E[0]
    y[0] = 1.0
    errors = np.empty(N)
    errors[0] = _norm(F - t)
    for n in range(2, N + 1):  # F(n) = (1 - t) F(n-1) + t E_n
        step = line_search(F, E[n - 1], t)
        F = (1.0 - step) * F + step * E[n - 1]
        y[: n - 1] *= 1.0 - step
        y[n - 1] = step
        if safeguard:  # one more search, towards the mean U_n of the samples so far
            total = total + E[n - 1]
            U = total / n
            step = line_search(F, U, t)
            F = (1.0 - step) * F + step * U
            y[:n] = (1.0 - step) * y[:n] + step / n
        errors[n - 1] = _norm(F - t)
    return Greedy(F, y, errors)


def slse(samples: ArrayLike, target: ArrayLike) -> Greedy:
    """SLSE: one line search per sample, from the estimate F towards the sample.

    t = clip(<E* - F, E - F> / ||E - F||^2, 0, 1), F <- (1 - t) F + t E, F(1) = E_1.
    """
    return _greedy(samples, target, safeguard=False)


def slse_safeguarded(samples: ArrayLike, target: ArrayLike) -> Greedy:
    """SLSE with one more line search on [F, U_n] after each step, U_n the mean of n samples.

    The error is then at most that of the uniform mean, for every n and every sequence of samples.
    """
    return _greedy(samples, target, safeguard=True)


#: All methods by their names in the package, each a function of samples and target.
METHODS: dict[str, Callable[..., Fused | Greedy]] = {
    "uniform": uniform,
    "alse": alse_dense,
    "slse": slse,
    "slse-safeguarded": slse_safeguarded,
}


def fuse_path(
    samples: ArrayLike,
    sizes: ArrayLike,
    method: str = "uniform",
    *,
    target: ArrayLike,
    weight_set: str = "simplex",
) -> Array:
    """The error after the first k samples, for each k in `sizes`."""
    E, more = np.asarray(samples), {"weight_set": weight_set} if method == "alse" else {}
    return np.array([METHODS[method](E[:k], target, **more).error for k in np.asarray(sizes)])
