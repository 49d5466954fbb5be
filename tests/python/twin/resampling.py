"""Ensembles of models from one data set, and pooling of several.

Every ensemble here but `region_draws` of the truth scatters about the estimate H, not about Theta:
no statement about the distance to Theta follows from its mean. Rows of `Z` (N, d) and `Y` (N, n)
are pairs; a model is (n, d).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .triangle import Fitted, Triangle, fit, leverages, merge, residuals, triangle

Array = NDArray[np.float64]

SINGULAR = 1e-10  # of the pivots, after whitening: below, a replicate has no estimate


def bootstrap_counts(N: int, size: int, gen: np.random.Generator) -> NDArray[np.int64]:
    """How often each of N pairs (or runs) is taken in each replicate, (size, N)."""
    return gen.multinomial(N, np.full(N, 1.0 / N), size)


def weighted_models(Z: ArrayLike, Y: ArrayLike, counts: ArrayLike) -> Array:
    """Least squares with pair t taken counts[b, t] times, (size, n, d); NaN where it has none.

    H_b' = (sum k_t z z')^-1 sum k_t z y'. The z are whitened first, so that the sums are near I and
    normal equations cost no digits. For whole runs give all pairs of a run its count.
    """
    Z, Y = np.asarray(Z, dtype=np.float64), np.asarray(Y, dtype=np.float64)
    m = fit(triangle(Z, Y))
    z = Z @ m.white.T
    models = []
    for k in np.asarray(counts, dtype=np.float64):
        V = z.T @ (k[:, None] * z)
        if np.sum(k > 0) < m.rank or np.linalg.eigvalsh(V)[0] < SINGULAR:
            models.append(np.full((Y.shape[1], Z.shape[1]), np.nan))
            continue
        models.append(np.linalg.solve(V, z.T @ (k[:, None] * Y)).T @ m.white)
    return np.array(models)


def residual_models(
    Z: ArrayLike,
    Y: ArrayLike,
    size: int,
    gen: np.random.Generator,
    *,
    centred: bool = True,
    signs: bool = False,
) -> Array:
    """Models of H z_t + e*_t, (size, n, d): H + sum e*_t z_t' V^+.

    e* are residuals taken at random, centred and times sqrt(N / nu); without `centred` their mean
    shifts all models by `residual_shift`. `signs`: each e_t / sqrt(1 - h_t) with a random sign
    (wild; MacKinnon and White 1985).
    """
    Z, Y = np.asarray(Z, dtype=np.float64), np.asarray(Y, dtype=np.float64)
    m, E, N = fit(triangle(Z, Y)), residuals(Z, Y), len(Z)
    z = Z @ m.white.T
    if signs:
        scaled = E / np.sqrt(1.0 - leverages(Z))[:, None]
        drawn = scaled * (gen.integers(0, 2, (size, N)) * 2.0 - 1.0)[:, :, None]
    else:
        E = (E - E.mean(axis=0)) * np.sqrt(N / m.nu) if centred else E
        drawn = E[gen.integers(0, N, (size, N))]
    return np.asarray(m.H + np.einsum("bti,tj->bij", drawn, z) @ m.white)


def residual_shift(Z: ArrayLike, Y: ArrayLike) -> Array:
    """Mean of the models from residuals that are not centred, minus H: e-bar (sum z_t)' V^+."""
    Z = np.asarray(Z, dtype=np.float64)
    m = fit(triangle(Z, Y))
    return np.outer(residuals(Z, Y).mean(axis=0), (m.white @ Z.sum(axis=0)) @ m.white)


def wild_covariance(Z: ArrayLike, Y: ArrayLike) -> Array:
    """sum_t (V^+ z_t z_t' V^+) x (e_t e_t') / (1 - h_t), (n d, n d), of vec H by columns (HC2)."""
    Z = np.asarray(Z, dtype=np.float64)
    m = fit(triangle(Z, Y))
    E = residuals(Z, Y) / np.sqrt(1.0 - leverages(Z))[:, None]
    effect = Z @ m.white.T @ m.white
    terms = np.einsum("tj,ti->tji", effect, E).reshape(len(Z), -1)
    return np.asarray(terms.T @ terms)


def region_draws(fitted: Fitted, size: int, gen: np.random.Generator) -> Array:
    """H + S^(1/2) E^(-1/2) G V^(-1/2), E ~ W_n(I, nu), (size, n, d); for nonlinear functions.

    Mean H; covariance V^-1 x S / (nu - n - 1). E^(-1/2) from Bartlett's triangle.
    """
    n, nu = len(fitted.H), fitted.nu
    L = np.linalg.cholesky(fitted.S)
    i = np.arange(n)
    T = np.tril(gen.standard_normal((size, n, n)), -1)
    T[:, i, i] = np.sqrt(gen.chisquare(nu - i, (size, n)))
    G = gen.standard_normal((size, n, fitted.rank))
    root = np.linalg.solve(T.transpose(0, 2, 1), G)  # E = T T': E^-1 = T'^-1 T^-1
    return np.asarray(fitted.H + L @ root @ fitted.white)


def pooled(data: Sequence[Triangle]) -> Fitted:
    """Least squares of all data together (Gauss and Markov): (sum H_i V_i)(sum V_i)^-1."""
    return fit(merge(*data))


def precision_weights(data: Sequence[Triangle]) -> Array:
    """The best weights where only the estimates H_i may be combined: w_i ~ 1 / tr V_i^-1.

    E||sum w_i H_i - Theta||_F^2 = tr Sigma sum w_i^2 tr V_i^-1. Pooling is better.
    """
    w = np.array([1.0 / np.sum(fit(part).white ** 2) for part in data])
    return np.asarray(w / w.sum())


def autoregression_bias(a: float, T: int) -> float:
    """-2 a / T: bias of least squares on one stationary scalar trajectory, to O(1/T^2).

    Nicholls and Pope (1988); for display, not to be subtracted.
    """
    return -2.0 * a / T
