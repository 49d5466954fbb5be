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


class Followed(NamedTuple):
    """A plan that is followed; a reference is one too, made of what was known before the noise."""

    A: Array
    D: Array
    E: Array
    c: Array


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
    plan = Followed(A, D, E, c)
    steps = range(1, len(c) + 1)
    first = [[first_order(X(plan, h, k), rho, phi) for h in rows] for k in steps]
    weights = around(A) if ts is None else ts
    rest = np.min([weighted(plan, rows, rho, phi, t) for t in weights], axis=0)
    noise = np.zeros_like(rest) if RR is None else deviations(plan, rows, rho, RR, kappas)
    return Tube(np.array(first), rest, noise)


def around(A: Array) -> list[float]:
    """The weights t that are tried: around the spectral radius of A, and 1."""
    radius = float(np.abs(np.linalg.eigvals(A)).max())
    shares = (0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.15, 1.2, 1.3)
    return [max(share * radius, 0.05) for share in shares] + [1.0]


def quantile_of(events: int, delta: float) -> float:
    """Which multiple of their deviations so many normal variables exceed with chance delta."""
    return float(norm.isf(delta / (2 * events)))


def quantile_at(k: int, K: int, rows: int, delta: float) -> float:
    """The same for the rows of step k of K: .8 of delta is for those of the last step."""
    if k == K:
        return quantile_of(rows, delta * (0.8 if K > 1 else 1.0))
    return quantile_of((K - 1) * rows, 0.2 * delta)


# -- sec. 3: any region ----------------------------------------------------------------------------


def v(plan: Followed, h: Array, k: int) -> list[Array]:
    """``v_p = D' A'^p h`` for p = k - 1, .., 0: the weights of steps 0, .., k - 1."""
    found = []
    for _ in range(k):
        found.append(plan.D.T @ h)
        h = plan.A.T @ h
    return found[::-1]


def H(plan: Followed, p: int) -> Array:
    """``H_p = E A^p D``."""
    return plan.E @ np.linalg.matrix_power(plan.A, p) @ plan.D


def X(plan: Followed, h: Array, k: int) -> Array:
    """``h' e1_k = <G, X_k>``: ``X_k = sum_{j<k} v_{k-1-j} c_j'`` (q, r)."""
    return np.array(v(plan, h, k)).T @ plan.c[:k]


def first_order(X: Array, rho: float, phi: float = np.inf) -> float:
    """``<G, X>`` is at most this: over the spectral ball, and over the Frobenius ball."""
    of_frobenius = phi * np.linalg.norm(X) if np.isfinite(phi) else np.inf
    return ONCE * min(rho * np.linalg.norm(X, "nuc"), of_frobenius)


def toeplitz(plan: Followed, t: float, k: int) -> Array:
    """Blocks (j, i), j > i, of ``t^-(p+1) H_p``, p = j - 1 - i, on [0, k)."""
    r, q = len(plan.E), plan.D.shape[1]
    whole = np.zeros((k, r, k, q))
    for p in range(k - 1):
        block = t ** -(p + 1) * H(plan, p)
        for i in range(k - 1 - p):
            whole[i + 1 + p, :, i, :] = block
    return whole.reshape(k * r, k * q)


def gain(plan: Followed, t: float, k: int) -> float:
    """``g_t`` on [0, k)."""
    return float(np.linalg.norm(toeplitz(plan, t, k), 2))


def maps(plan: Followed) -> Array:
    """``T_j``: from the columns of G, one below the other, to ``E e1_j`` (K, r, q r)."""
    K, r, q = len(plan.c), len(plan.E), plan.D.shape[1]
    T = np.zeros((K, r, q * r))
    for j in range(K):
        for i in range(j):
            T[j] += np.kron(plan.c[i][None], H(plan, j - 1 - i))
    return T


def gram(T: Array, t: float, k: int) -> Array:
    """``sum_{j<k} t^(-2j) T_j' T_j``."""
    return sum(t ** (-2 * j) * T[j].T @ T[j] for j in range(k))


def length(values: Array, t: float) -> float:
    """``||f||_t`` of the rows f_0, f_1, .."""
    j = np.arange(len(values))
    return float(np.sqrt(t ** (-2.0 * j) @ (values**2).sum(axis=1)))


def reach(plan: Followed, h: Array, t: float, k: int) -> float:
    """``sqrt(sum_{j<k} t^(2j) |v_{k-1-j}|^2)``."""
    return length(np.array(v(plan, h, k)), 1.0 / t)


def beta(plan: Followed, T: Array, rho: float, phi: float, t: float, k: int) -> float:
    """``||E e1||_t`` on [0, k) is at most this."""
    of_all = min(phi, rho * np.sqrt(min(plan.D.shape[1], len(plan.E))))  # phi'
    by_gain = rho * gain(plan, t, k) * length(plan.c[:k], t)
    return min(by_gain, of_all * np.sqrt(max(np.linalg.eigvalsh(gram(T, t, k))[-1], 0.0)))


def weighted(plan: Followed, rows: Array, rho: float, phi: float, t: float) -> Array:
    """(K, rows): ``|h' e_k - h' e1_k|`` is at most this, infinite where rho g_t >= 1."""
    T, found = maps(plan), np.full((len(plan.c), len(rows)), np.inf)
    for k in range(1, len(plan.c) + 1):
        small = rho * gain(plan, t, k)
        if small < 1.0:
            others = beta(plan, T, rho, phi, t, k) / (1.0 - small)
            found[k - 1] = [ONCE * rho * reach(plan, h, t, k) * others for h in rows]
    return found


def deviations(
    plan: Followed, rows: Array, rho: float, RR: Array, kappas: Sequence[float] = KAPPAS
) -> Array:
    """(K, rows): standard deviations of the noise are at most these, for every G."""
    A, D, E, c = plan
    found = [lemma2(A, D, E, RR, rho, len(c), kappa)[1:] for kappa in kappas]
    variances = np.einsum("ri,akij,rj->akr", rows, np.array(found), rows).min(axis=0)
    return ONCE * np.sqrt(variances)


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


def orders(plan: Followed, G: Array) -> tuple[Array, Array, Array]:
    """``e``, ``e1`` (first order in G) and ``e2`` (second), each (K + 1, n), without noise."""
    A, D, E, c = plan
    e, e1, e2 = (np.zeros((len(c) + 1, len(A))) for _ in range(3))
    for k in range(len(c)):
        e[k + 1] = A @ e[k] + D @ G @ (E @ e[k] + c[k])
        e1[k + 1] = A @ e1[k] + D @ G @ c[k]
        e2[k + 1] = A @ e2[k] + D @ G @ E @ e1[k]
    return e, e1, e2


def second_order(plan: Followed, T: Array, h: Array, k: int) -> Array:
    """``h' e2_k = g' Q_k g``, g the columns of G one below the other: symmetric (q r, q r)."""
    ones = np.eye(len(plan.E))
    Q = sum(np.kron(ones, one[:, None]) @ T[j] for j, one in enumerate(v(plan, h, k)))
    return (Q + Q.T) / 2


# -- sec. 2: the exact law in closed loop ----------------------------------------------------------


def root_of(M: Array) -> Array:
    """The symmetric root of a symmetric M >= 0."""
    values, Q = np.linalg.eigh(M)
    return (Q * np.sqrt(np.maximum(values, 0.0))) @ Q.T


def geometric_mean(V: Array, R: Array) -> Array:
    """``V^-1 # R``: the M > 0 with ``M V M = R``."""
    half = root_of(V)
    back = np.linalg.inv(half)
    return back @ root_of(half @ R @ half) @ back


def starts_of_blocks(N: int, blocks: int) -> set[int]:
    """Where M is chosen anew, dense towards the end."""
    share = 1.0 - np.arange(blocks) / blocks
    return set(np.floor(N * (1.0 - share**2)).astype(int).tolist())


def spend(
    x: Array, N1: int, *, eps: float | None = None, M: Array | None = None, blocks: int = 24
) -> Array:
    """q_0, .., q_(N-1) in rows, ``sum q q' = I``; q_t is a function of x_0, .., x_t.

    `x` (N, d) in coordinates in which the second moment of the N1 pairs before is I. A given `M`
    stays as it is; without it M is chosen at the start of each block for the pairs to come.
    """
    N, d = x.shape
    one, fixed = np.eye(d), M
    eps = 0.3 * d / N if eps is None else eps
    R, back, q = (1.0 - eps) * one, one / (1.0 - eps), np.zeros((N, d))
    begins, seen = starts_of_blocks(N, blocks), N1 * one
    for t in range(N - d):
        if fixed is None and t in begins:
            M = geometric_mean((N - t) * seen / (N1 + t), R)
        q[t] = M @ x[t]
        a = q[t] @ back @ q[t]
        if a > 0.5:
            q[t] *= np.sqrt(0.5 / a)
        R = R - np.outer(q[t], q[t])
        f = back @ q[t]
        back = back + np.outer(f, f) / (1.0 - q[t] @ f)
        seen = seen + np.outer(x[t], x[t])
    F = np.linalg.cholesky(one - q.T @ q)
    for t in range(N - d, N):
        q[t], F = completed(F, M @ x[t])
    return q


def completed(F: Array, b: Array) -> tuple[Array, Array]:
    """``q = F v``, v along ``F' b``, and ``F [v^perp]``, one column less."""
    v = F.T @ b
    size = np.linalg.norm(v)
    if size <= 1e-12 * np.linalg.norm(F, 2) * np.linalg.norm(b):
        v = np.eye(F.shape[1])[0]
    else:
        v = v / size
    mirror = v + np.copysign(1.0, v[0]) * np.eye(len(v))[0]  # turns v into a multiple of e_1
    others = np.eye(len(v)) - 2.0 * np.outer(mirror, mirror) / (mirror @ mirror)
    return F @ v, F @ others[:, 1:]


class Spent(NamedTuple):
    """``H - Theta = Sigma^(1/2) Gamma T``, Gamma = ``Sigma^(-1/2) sum w q'`` standard normal."""

    H: Array
    T: Array
    T0: Array  # the forecast of T by the first part
    q: Array
    V: Array
    H_LS: Array
    S: Array  # residual sum of squares of least squares, on the same pairs


def estimate(first: Array, z: Array, y: Array, blocks: int = 24) -> Spent:
    """The fit whose law is exact; `first` (N1, d) and z (N, d) are pairs in their order in time."""
    L = whitening(first)
    q = spend(z @ L.T, len(first), blocks=blocks)
    if np.abs(q.T @ q - np.eye(z.shape[1])).max() > 1e-10:
        raise ValueError("sum q q' is not I")
    T = np.linalg.inv(L @ z.T @ q) @ L
    V = z.T @ z
    H_LS = np.linalg.solve(V, z.T @ y).T
    left = y - z @ H_LS.T
    return Spent(y.T @ q @ T, T, L / np.sqrt(len(z)), q, V, H_LS, left.T @ left)


def whitening(first: Array) -> Array:
    """``R1^-T``, ``R1' R1`` the second moment of the first part."""
    return np.linalg.inv(np.linalg.cholesky(first.T @ first / len(first)))


def replayed(first: Array, z0: Array) -> Array:
    """The forecast of T by the main runs replayed on H0: ``(L V0 L')^(-1/2) L``."""
    L = whitening(first)
    return np.linalg.inv(root_of(L @ z0.T @ z0 @ L.T)) @ L


def share_of_S(a: float, b: float, beta: float) -> float:
    """S is at least this times Sigma: the root s of ``s + (sqrt(beta s) + b)^2 = a``, or 0."""
    if a <= b**2:
        return 0.0
    root = np.sqrt(beta * b**2 + (1.0 + beta) * (a - b**2)) - np.sqrt(beta) * b
    return float((root / (1.0 + beta)) ** 2)


def covariance_bound(fit: Spent, rho: float, a: float) -> Array:
    """Sigma is at most this; a: the lower quantile of the least root of W_n(I, N)."""
    off = fit.H_LS - fit.H
    beta = np.linalg.eigvals(np.linalg.solve(fit.S, off @ fit.V @ off.T)).real.max()
    tau = np.linalg.norm(fit.T @ root_of(fit.V), 2)
    s = share_of_S(a, rho * tau, max(float(beta), 0.0))
    return ONCE * fit.S / s if s > 0.0 else np.full_like(fit.S, np.inf)


# -- sec. 4: near a reference ----------------------------------------------------------------------


class Levels(NamedTuple):
    """Radii that hold together, and the levels of the events."""

    spectral: float
    frobenius: float
    first: float  # delta1
    others: float  # delta3


def near(
    plan: Followed, reference: Followed, rows: Array, at: Levels, ts: Sequence[float],
    *, known: bool, traces: bool | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """Theorem 3: (K, rows) of the first order and of the rest.

    `known`: whether D is made of Sigma itself, or of a bound of it. `traces`: whether norms of
    matrices of q d rows are replaced by traces; by default from 300 rows on.
    """
    K, T, T0 = len(plan.c), maps(plan), maps(reference)
    traces = T.shape[2] > 300 if traces is None else traces
    events = K * len(rows)
    x = np.log(4.0 * events / at.others)
    first, rest = (np.full((K, len(rows)), np.inf) for _ in range(2))
    noise = [chaos_of(reference, T0, t, np.log(2.0 * len(ts) / at.others), traces) for t in ts]
    for k in range(1, K + 1):
        found = [shrunk(plan, T, T0, at, t, k, b, traces) for t, b in zip(ts, noise, strict=True)]
        for i, h in enumerate(rows):
            X_k, X0_k = (X(one, h, k) for one in (plan, reference))
            z = quantile_at(k, K, len(rows), at.first)
            first[k - 1, i] = ONCE * along(X_k, X0_k, z, at)
            second = np.inf if traces else second_bound(plan, reference, T, T0, h, k, x, at, known)
            for t, (small, f) in zip(ts, found, strict=True):
                b = at.spectral * reach(plan, h, t, k) * f
                better = min(b, second + small * b) if np.isfinite(b) else np.inf
                rest[k - 1, i] = min(rest[k - 1, i], ONCE * better)
    return first, rest


def along(X: Array, X0: Array, z: float, at: Levels) -> float:
    """(i): ``|<Gamma, X>| <= |s| z ||X0||_F + min(rho_S ||X - s X0||_*, rho_F ||X - s X0||_F)``."""

    def of(s: float) -> float:
        away = X - s * X0
        worst = min(at.spectral * np.linalg.norm(away, "nuc"), at.frobenius * np.linalg.norm(away))
        return s * z * np.linalg.norm(X0) + worst

    return min(of(s) for s in (0.0, 0.5, 0.8, 0.9, 1.0, 1.1))


def chaos(S: Array, x: float) -> float:
    """``g' S g`` exceeds the square of this with chance ``exp(-x)`` at most."""
    top = np.linalg.eigvalsh(S)[-1]
    return float(np.sqrt(np.trace(S) + 2.0 * np.sqrt(x) * np.linalg.norm(S) + 2.0 * x * top))


def chaos_of(reference: Followed, T0: Array, t: float, x: float, traces: bool) -> float:
    """(ii), its first part: of ``S0_t`` over the longest horizon."""
    K = len(T0)
    if not traces:
        return chaos(gram(T0, t, K), x)
    trace = sum(t ** (-2 * j) * (T0[j] ** 2).sum() for j in range(K))
    top = gain(reference, t, K) * length(reference.c, t)
    return float(np.sqrt(trace) + np.sqrt(2.0 * x) * top)


def shrunk(
    plan: Followed, T: Array, T0: Array, at: Levels, t: float, k: int, noise: float, traces: bool
) -> tuple[float, float]:
    """``rho g_t`` and the bound of ``||E e||_t`` on [0, k): beta_t over ``1 - rho g_t``."""
    small = at.spectral * gain(plan, t, k)
    if small >= 1.0:
        return small, np.inf
    if traces:
        off = sum(t ** (-2 * j) * ((T[j] - T0[j]) ** 2).sum() for j in range(k))
        plain = small * length(plan.c[:k], t)
    else:
        off = max(np.linalg.eigvalsh(gram(T - T0, t, k))[-1], 0.0)
        plain = beta(plan, T, at.spectral, at.frobenius, t, k)
    return small, min(noise + at.frobenius * np.sqrt(off), plain) / (1.0 - small)


def second_bound(
    plan: Followed, reference: Followed, T: Array, T0: Array,
    h: Array, k: int, x: float, at: Levels, known: bool,
) -> float:  # fmt: skip
    """(iii): ``|h' e2_k|`` is at most this."""
    Q, Q0 = second_order(plan, T, h, k), second_order(reference, T0, h, k)
    trace = abs(np.trace(Q0)) if known else largest_trace(Q0, plan.D.shape[1])
    noise = 2.0 * np.sqrt(x) * np.linalg.norm(Q0) + 2.0 * x * np.linalg.norm(Q0, 2)
    worst = at.frobenius**2
    return min(trace + noise + worst * np.linalg.norm(Q - Q0, 2), worst * np.linalg.norm(Q, 2))


def largest_trace(Q0: Array, q: int) -> float:
    """The largest ``|tr Q0|`` over all 0 <= Sigma <= Sbar, where Q0 is made of Sbar."""
    r = len(Q0) // q
    P = np.einsum("iaib->ab", Q0.reshape(r, q, r, q))
    values = np.linalg.eigvalsh(P)
    return float(max(values[values > 0.0].sum(), -values[values < 0.0].sum()))


# -- sec. 5: one quantile --------------------------------------------------------------------------


def one_quantile(f: float, v0: float, delta: float) -> float:
    """q with ``2 Phi(-q / sqrt(f^2 + v0)) + Phi(-q / f) = delta``."""
    low, high = 0.0, quantile_of(1, delta / 4.0) * np.sqrt(f**2 + v0)
    for _ in range(60):
        q = (low + high) / 2.0
        outside = 2.0 * norm.sf(q / np.sqrt(f**2 + v0)) + norm.sf(q / f)
        low, high = (q, high) if outside > delta else (low, q)
    return float(high)
