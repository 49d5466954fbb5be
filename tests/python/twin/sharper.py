"""Tubes of followed plans and the exact law of fits with feedback, in plain NumPy.

A model ``y+ = Theta z + w`` errs by ``D G E``, ``||G||_2 <= rho``. A plan whose regressors in the
coordinates of the region are ``c_k`` is followed, so the states are off by

    e+ = A e + D G (E e + c_k) + R w_k,   e_0 = 0,

A (n, n), D (n, q), E (r, n), c (K, r), G (q, r), and what is looked at are rows h: ``h' e_k``.
``v_p = D' A'^p h`` and ``H_p = E A^p D``; phi bounds the Frobenius norm of G, if anything does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

Array = NDArray[np.float64]
KAPPAS = (0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 2.5)
ONCE = 1.0 + 1e-9  # of every bound


class Tube(NamedTuple):
    """Per step k = 1, .., K and row: ``|h' e_k|`` is at most the sum, the last times a quantile."""

    first: Array  # (K, rows), of first order in G
    rest: Array  # (K, rows), of all higher orders
    deviation: Array  # (K, rows), of the noise


def tube(
    A: Array,
    D: Array,
    E: Array,
    c: Array,
    rows: Array,
    rho: float,
    phi: float = np.inf,
    RR: Array | None = None,
    *,
    ts: Sequence[float] | None = None,
    kappas: Sequence[float] = KAPPAS,
) -> Tube:
    """What a region says of a followed plan: the three parts for all steps and rows.

    `RR` covers the covariance of the noise of a step. All t of `ts` and all `kappas` are true at
    once: the least is taken, per step and row.
    """
    steps, zero = range(1, len(c) + 1), np.zeros((len(c), len(rows)))
    first = [[first_order(X(A, D, c, h, k), rho, phi) for h in rows] for k in steps]
    weights = around(A) if ts is None else ts
    rest = np.array([weighted(A, D, E, c, rows, rho, phi, t) for t in weights]).min(axis=0)
    if RR is None:
        return Tube(np.array(first), rest, zero)
    found = [lemma2(A, D, E, RR, rho, len(c), kappa)[1:] for kappa in kappas]
    variances = np.einsum("ri,akij,rj->akr", rows, np.array(found), rows).min(axis=0)
    return Tube(np.array(first), rest, np.sqrt(variances))


def around(A: Array) -> list[float]:
    """The weights t that are tried: around the spectral radius of A, and 1."""
    radius = float(np.abs(np.linalg.eigvals(A)).max())
    shares = (0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.15, 1.2, 1.3)
    return [max(share * radius, 0.05) for share in shares] + [1.0]


def quantile_of(events: int, delta: float) -> float:
    """Which multiple of their deviations so many normal variables exceed with chance delta."""
    return float(norm.isf(delta / (2 * events)))


# -- sec. 3: any region ----------------------------------------------------------------------------


def power(A: Array, p: int) -> Array:
    """A^p."""
    return np.linalg.matrix_power(A, p)


def v(A: Array, D: Array, h: Array, p: int) -> Array:
    """``v_p = D' A'^p h``."""
    return D.T @ power(A, p).T @ h


def H(A: Array, D: Array, E: Array, p: int) -> Array:
    """``H_p = E A^p D``."""
    return E @ power(A, p) @ D


def X(A: Array, D: Array, c: Array, h: Array, k: int) -> Array:
    """``h' e1_k = <G, X_k>``: ``X_k = sum_{j<k} v_{k-1-j} c_j'`` (q, r)."""
    return sum(np.outer(v(A, D, h, k - 1 - j), c[j]) for j in range(k))


def first_order(X: Array, rho: float, phi: float = np.inf) -> float:
    """The largest ``<G, X>``: of the spectral ball, and at most that of the Frobenius ball."""
    of_frobenius = phi * np.linalg.norm(X) if np.isfinite(phi) else np.inf
    return ONCE * min(rho * np.linalg.norm(X, "nuc"), of_frobenius)


def toeplitz(A: Array, D: Array, E: Array, t: float, k: int) -> Array:
    """Blocks (j, i), j > i, of ``t^-(p+1) H_p``, p = j - 1 - i, on [0, k)."""
    r, q = len(E), D.shape[1]
    whole = np.zeros((k, r, k, q))
    for p in range(k - 1):
        block = t ** -(p + 1) * H(A, D, E, p)
        for i in range(k - 1 - p):
            whole[i + 1 + p, :, i, :] = block
    return whole.reshape(k * r, k * q)


def gain(A: Array, D: Array, E: Array, t: float, k: int) -> float:
    """``g_t`` on [0, k)."""
    return float(np.linalg.norm(toeplitz(A, D, E, t, k), 2))


def maps(A: Array, D: Array, E: Array, c: Array) -> Array:
    """``T_j``: from the columns of G, one below the other, to ``E e1_j`` (K, r, q r)."""
    K, r, q = len(c), len(E), D.shape[1]
    T = np.zeros((K, r, q * r))
    for j in range(K):
        for i in range(j):
            T[j] += np.kron(c[i][None], H(A, D, E, j - 1 - i))
    return T


def frobenius_radius(D: Array, E: Array, rho: float, phi: float) -> float:
    """``phi'``: the Frobenius norm of G is at most this."""
    return min(phi, rho * np.sqrt(min(D.shape[1], len(E))))


def gram(T: Array, t: float, k: int) -> Array:
    """``sum_{j<k} t^(-2j) T_j' T_j``."""
    return sum(t ** (-2 * j) * T[j].T @ T[j] for j in range(k))


def length(values: Array, t: float) -> float:
    """``||f||_t`` of the rows f_0, f_1, .."""
    j = np.arange(len(values))
    return float(np.sqrt((t ** (-2.0 * j) * (values**2).sum(axis=1)).sum()))


def reach(A: Array, D: Array, h: Array, t: float, k: int) -> float:
    """``sqrt(sum_{j<k} t^(2j) |v_{k-1-j}|^2)``."""
    return float(np.sqrt(sum(t ** (2 * j) * (v(A, D, h, k - 1 - j) ** 2).sum() for j in range(k))))


def beta(A: Array, D: Array, E: Array, c: Array, rho: float, phi: float, t: float, k: int) -> float:
    """``||E e1||_t`` on [0, k) is at most this."""
    by_gain = rho * gain(A, D, E, t, k) * length(c[:k], t)
    of_maps = np.linalg.eigvalsh(gram(maps(A, D, E, c[:k]), t, k))[-1]
    return min(by_gain, frobenius_radius(D, E, rho, phi) * np.sqrt(max(of_maps, 0.0)))


def weighted(
    A: Array, D: Array, E: Array, c: Array, rows: Array, rho: float, phi: float, t: float
) -> Array:
    """(K, rows): ``|h' e_k - h' e1_k|`` is at most this, infinite where rho g_t >= 1."""
    found = np.full((len(c), len(rows)), np.inf)
    for k in range(1, len(c) + 1):
        small = rho * gain(A, D, E, t, k)
        if small < 1.0:
            others = beta(A, D, E, c, rho, phi, t, k) / (1.0 - small)
            found[k - 1] = [ONCE * rho * reach(A, D, h, t, k) * others for h in rows]
    return found


def lemma2(
    A: Array, D: Array, E: Array, RR: Array, rho: float, horizon: int, kappa: float
) -> list[Array]:
    """``Y_0, .., Y_K``: the covariance of the noise after k steps is at most Y_k, for every G."""
    D = rho * D
    Y = [np.zeros_like(A)]
    for _ in range(horizon):
        Y.append(lemma2_step(A, D, E, RR, Y[-1], kappa))
    return Y


def lemma2_step(A: Array, D: Array, E: Array, RR: Array, Y: Array, kappa: float) -> Array:
    """``RR' + alpha D D' + A (Y + Y E' (alpha I - E Y E')^-1 E Y) A'``, rho inside D."""
    EYE = E @ Y @ E.T
    top = np.linalg.eigvalsh(EYE)[-1]
    if top <= 0.0:
        return RR + A @ Y @ A.T
    alpha = ONCE * top + kappa * np.sqrt(np.trace(E @ Y @ A.T @ A @ Y @ E.T) / np.trace(D @ D.T))
    middle = Y @ E.T @ np.linalg.solve(alpha * np.eye(len(E)) - EYE, E @ Y)
    step = RR + alpha * D @ D.T + A @ (Y + middle) @ A.T
    return (step + step.T) / 2


# -- the truth that the tubes are about ------------------------------------------------------------


def orders(A: Array, D: Array, E: Array, c: Array, G: Array) -> tuple[Array, Array, Array]:
    """``e``, ``e1`` (first order in G) and ``e2`` (second), each (K + 1, n), without noise."""
    e, e1, e2 = (np.zeros((len(c) + 1, len(A))) for _ in range(3))
    for k in range(len(c)):
        e[k + 1] = A @ e[k] + D @ G @ (E @ e[k] + c[k])
        e1[k + 1] = A @ e1[k] + D @ G @ c[k]
        e2[k + 1] = A @ e2[k] + D @ G @ E @ e1[k]
    return e, e1, e2


def second_order(A: Array, D: Array, E: Array, c: Array, h: Array, k: int) -> Array:
    """``h' e2_k = g' Q_k g``, g the columns of G one below the other: symmetric (q r, q r)."""
    T, r = maps(A, D, E, c[:k]), len(E)
    Q = sum(np.kron(np.eye(r), v(A, D, h, k - 1 - j)[:, None]) @ T[j] for j in range(k))
    return (Q + Q.T) / 2
