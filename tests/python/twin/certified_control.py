"""From a region for Theta = [A B c] to the error of a control, one step or several.

The statements hold for every control at once, also for one that is chosen after the data, in the
event that the region contains Theta. `white` (rank, d) has white' white = V^-1; any root of S and
of V^-1 serves, as the norms below do not change when a root is multiplied by a rotation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import sharper
from .laws import normal_quantile
from .regions import _times
from .triangle import Fitted, seen

Array = NDArray[np.float64]


def state_and_input(fitted: Fitted, x: ArrayLike, u: ArrayLike) -> Array:
    """z = (x, u), or (x, u, 1) if the model has one column more."""
    z = np.concatenate([np.asarray(x, dtype=np.float64), np.asarray(u, dtype=np.float64)])
    return np.concatenate([z, np.ones(fitted.H.shape[1] - len(z))])


# -- several steps ---------------------------------------------------------------------------------


# rounds and tolerance of `over_spectral_ball` for the last state and for all others
LAST, OTHERS = (10, 1e-3), (3, 1e-2)


class Steps(NamedTuple):
    """||x(k) - states[k]|| <= radii[k]; first-order part `linear[k]`, `sizes[k]` = ||z(k)||."""

    states: Array  # (K + 1, n), of the model
    radii: Array  # (K + 1,)
    linear: Array  # (K + 1,)
    rest: Array  # (K + 1,): b_k >= ||W^(1/2) e(k)||
    sizes: Array  # (K,)


def weighted_cauchy_schwarz(M: list[Array], c: ArrayLike) -> float:
    """Above ||sum_j M_j y_j|| for all ||y_j|| <= c_j, and at most sum_j c_j ||M_j||.

    sqrt(lam_max(sum_j (c_j / ||M_j||) M_j M_j') sum_j c_j ||M_j||); terms that are 0 are left out.
    """
    terms = [(a, m, np.linalg.norm(m, 2)) for m, a in zip(M, np.asarray(c), strict=True)]
    terms = [(a, m, s) for a, m, s in terms if a * s > 0.0]
    if not terms:
        return 0.0
    if not all(np.isfinite(a * s) for a, _, s in terms):
        return np.inf
    gram = sum((a / s) * (m @ m.T) for a, m, s in terms)
    return float(np.sqrt(np.linalg.norm(gram, 2) * sum(a * s for a, _, s in terms)))


def over_spectral_ball(M: list[Array], c: Array, rounds: int = 40, tol: float = 1e-6) -> float:
    """Above ||sum_j M_j Gamma c_j|| for all ||Gamma||_2 <= 1; c_j in the rows of `c`.

    The largest value is that of ||N(l)||_*, N(l) = sum_j M_j' l c_j', over unit vectors l, and by
    ||N||_* <= ||N T^(-1/2)||_F ||T^(1/2)||_F for every T > 0 at most

        nuc(T) = sqrt(tr T lam_max(sum_ij (c_i' T^-1 c_j) M_i M_j')).

    T_0 = sum_j (||M_j|| / ||c_j||) c_j c_j' gives at most the weighted inequality; T = S(X)^(1/2),
    S(X) = sum_ij tr(M_i' X M_j) c_i c_j', X by Frank-Wolfe steps for max tr S(X)^(1/2), the least
    of nuc, which is only used to stop.
    """
    pairs = zip(M, c, strict=True)
    sizes = [(float(np.linalg.norm(m, 2)), float(np.linalg.norm(a))) for m, a in pairs]
    kept = [j for j, (s, a) in enumerate(sizes) if s * a > 0.0]
    if not kept:
        return 0.0
    # coordinates in the span of the c_j, or fewer
    c = np.linalg.qr(c[kept].T)[1].T if len(kept) < c.shape[1] else c[kept]
    M = [M[j] for j in kept]
    squares = (sizes[j][0] / sizes[j][1] * np.outer(a, a) for j, a in zip(kept, c, strict=True))
    T = np.sum(list(squares), axis=0)
    best, S = np.inf, np.zeros(())
    for k in range(rounds):
        values, turned = np.linalg.eigh(T)
        values = np.maximum(values, 0.0)
        values = values + 1e-9 * values.sum() / len(values)
        y = c @ turned / np.sqrt(values)
        Z = np.sum([np.kron(a[None, :], m) for a, m in zip(y, M, strict=True)], axis=0)
        tops, directions = np.linalg.eigh(Z @ Z.T)
        # for rounding: of eigenvalues, and of y where T is nearly singular
        r = len(values)
        rough = sum(sizes[j][0] * float(np.linalg.norm(a)) for j, a in zip(kept, y, strict=True))
        lost = r * np.finfo(np.float64).eps * np.sqrt(r / 1e-9) * rough
        found = np.sqrt(tops[-1]) * (1.0 + 1e-9) + lost
        best = min(best, float(np.sqrt(values.sum()) * found))
        top = directions[:, -1]
        N = np.sum([np.outer(m.T @ top, a) for m, a in zip(M, c, strict=True)], axis=0)
        S = S + 2.0 / (k + 2.0) * (N.T @ N - S)
        values, turned = np.linalg.eigh(S)
        roots = np.sqrt(np.where(values > 1e-13 * values[-1], values, 0.0))
        if best <= (1.0 + tol) * roots.sum():
            break
        T = turned * roots @ turned.T
    return best


def several_steps(
    fitted: Fitted,
    x0: ArrayLike,
    inputs: ArrayLike,
    *,
    spectral: float,
    frobenius: float = np.inf,
    rho0: float = 0.0,
    noise: bool = False,
    S: ArrayLike | None = None,
    to_come: tuple[Array, float, float] | None = None,
) -> Steps:
    """The error of the model's trajectory under ||Gamma||_2 <= spectral, ||Gamma||_F <= frobenius.

    e(k+1) = A e(k) + D z(k) + D_x e(k) (+ w(k)) with the model's A, z(k) and D = S^(1/2) Gamma
    V^(-1/2). With c_k = V^(-1/2) z(k), M_p = A^p S^(1/2), W = (V^-1)_xx, wcs the weighted
    inequality:

        lin_k(M) = min(min(frobenius, spectral sqrt(r)) || sum_{j<k} c_j' (x) M_{k-1-j} ||,
                       spectral wcs(M, ||c_j||), spectral over_spectral_ball(M, c))
        b_k = lin_k(W^(1/2) M) + ||W^(1/2) A^k|| rho0 + spectral wcs(W^(1/2) M_{k-1-j}, b_j)
        r_k = lin_k(M)         + ||A^k|| rho0         + spectral wcs(M_{k-1-j}, b_j).

    First order plus rest: rest(k+1) = A rest(k) + D_x e(k) and ||V^(-1/2)(e_j, 0)|| =
    ||W^(1/2) e_j|| <= b_j by induction. The Frobenius branch is the exact maximum of the first
    order over the Frobenius ball; r is the smallest of n, k and the entries of c_j. All k and all
    inputs in one event. `noise`: the radii must be those of d + K columns; K blocks M join the sum
    and ||c_j|| becomes sqrt(1 + ||c_j||^2).

    `to_come` = (N, end, before): Gaussian noise to come of covariance N, independent of the data.
    With what D_x makes of it its covariance is at most Y_k (`sharper.lemma2`, of several kappa that
    of the least trace); r_k gets the quantile of its norm at the level `before`, r_K at `end`.
    """
    m = fitted
    n = len(m.H)
    A = m.H[:, :n]
    root = _root(m.S if S is None else np.asarray(S, dtype=np.float64))
    known = all(seen(m, e) for e in np.eye(m.H.shape[1])[:n])
    half = m.white[:, :n]  # half' half = W: as good as W^(1/2) in front of a vector
    x = np.asarray(x0, dtype=np.float64)
    states, powers, sizes, c = [x], [np.eye(n)], [], []
    for u in np.asarray(inputs, dtype=np.float64):
        z = state_and_input(m, states[-1], u)
        sizes.append(_times(1.0, m, z))
        c.append(m.white @ z)
        states.append(m.H @ z)
        powers.append(A @ powers[-1])
    weights = np.hypot(1.0, sizes) if noise else np.array(sizes)

    seen_by = np.array(c)  # rows c_j, with an entry of its own each for the noise
    if noise:
        seen_by = np.hstack([seen_by, np.eye(len(c))])

    def linear(M: list[Array], k: int, effort: tuple[int, float]) -> float:
        if not np.all(np.isfinite(weights[:k])):
            return np.inf
        back, rows = [M[k - 1 - j] for j in range(k)], seen_by[:k]
        total = sum(
            (np.kron(a[None, :], m) for a, m in zip(rows, back, strict=True)),
            np.zeros((len(M[0]), n * rows.shape[1])),
        )
        size, rank = float(np.linalg.norm(total, 2)), min(n, *rows.shape)
        crude = weighted_cauchy_schwarz(back, weights[:k])
        found = [
            _product(min(frobenius, spectral * np.sqrt(rank)), size),
            _product(spectral, crude),
        ]
        if rank > 1 and np.isfinite(spectral):
            found.append(_product(spectral, over_spectral_ball(back, rows, *effort)))
        return float(min(found))

    M = [power @ root for power in powers]
    WM = [half @ power @ root for power in powers]
    first, rest, r = [0.0], [], [rho0]
    rest.append(_product(rho0, float(np.linalg.norm(half, 2)) if known else np.inf))
    for k in range(1, len(states)):
        past = np.array(rest)
        back = [M[k - 1 - j] for j in range(k)]
        back_W = [WM[k - 1 - j] for j in range(k)]
        first.append(linear(M, k, OTHERS if k < len(c) else LAST))
        start = float(np.linalg.norm(powers[k], 2)) * rho0
        r.append(first[-1] + start + _product(spectral, weighted_cauchy_schwarz(back, past)))
        start = float(np.linalg.norm(half @ powers[k], 2)) * rho0
        b = (
            linear(WM, k, OTHERS)
            + start
            + _product(spectral, weighted_cauchy_schwarz(back_W, past))
        )
        rest.append(b if known else np.inf)
    if to_come is not None:
        N, end, before = to_come
        for k, Y in enumerate(with_noise(A, root, half, N, spectral, len(c))[1:], 1):
            within = Y if known or k == 1 else np.full((n, n), np.inf)
            r[k] += normal_quantile(within, before if k < len(c) else end)
    return Steps(np.array(states), np.array(r), np.array(first), np.array(rest), np.array(sizes))


def with_noise(A: Array, D: Array, E: Array, N: Array, rho: float, steps: int) -> list[Array]:
    """Of each step the Y_k of the least trace; alpha is chosen where rho D has rows of length 1."""
    sizes = rho * np.linalg.norm(D, axis=1)
    units = np.where(sizes > 0.0, sizes, 1.0)
    given = A / units[:, None] * units, D / units[:, None], E * units, N / np.outer(units, units)
    every = [sharper.lemma2(*given, rho, steps, kappa) for kappa in sharper.KAPPAS]
    own = [[Y * np.outer(units, units) for Y in one] for one in every]
    return [min(of, key=np.trace) for of in zip(*own, strict=True)]


def _product(a: float, b: float) -> float:
    """a b, where 0 times infinity is 0: nothing to bound."""
    return 0.0 if a == 0.0 or b == 0.0 else a * b


def _root(S: Array) -> Array:
    values, vectors = np.linalg.eigh(S)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
