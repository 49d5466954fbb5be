"""Instruments simulated by a pilot model, and the certificate of a plan near a reference, in NumPy.

From the statements alone: full matrices, LAPACK's QR and SVD, quantiles of SciPy, no rounding.
Rows are pairs: Z (N, d), Y (N, n).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from .laws import normal_quantile as wq

Array = NDArray[np.float64]


def simulated(H0: Array, starts: Array, lengths: Array, v: Array, gain: Array | None) -> Array:
    """The z = (x, u, 1) of every pair under H0, with ``u = gain x + v``."""
    n, d = H0.shape
    rows, at = [], 0
    for x0, length in zip(starts, lengths, strict=True):
        x = x0
        for k in range(at, at + length):
            u = v[k] + (0.0 if gain is None else gain @ x)
            z = np.concatenate([x, u, np.ones(d - n - len(u))])
            rows.append(z)
            x = H0 @ z
        at += length
    return np.array(rows)


@dataclass(frozen=True)
class Estimate:
    """``H - Theta = Sigma^(1/2) Gamma T`` with Gamma standard normal."""

    H: Array
    T: Array
    R: Array
    E: Array
    tau: float


def estimate(zeta: Array, Z: Array, Y: Array) -> Estimate:
    """Theorem 1."""
    Q, R = np.linalg.qr(zeta)
    signs = np.where(np.diag(R) < 0.0, -1.0, 1.0)
    Q, R = Q * signs, R * signs[:, None]
    T = np.linalg.inv(Z.T @ Q)
    H = Y.T @ Q @ T
    left = Z - Q @ (Q.T @ Z)
    return Estimate(H, T, R, Y - Z @ H.T, float(np.linalg.norm(T @ left.T, 2)))


def scalar_bound(found: Estimate, frobenius: float, delta: float) -> float:
    """sigma is at most this."""
    (N, n), d = found.E.shape, len(found.T)
    room = np.sqrt(stats.chi2.ppf(delta, n * (N - d))) - frobenius * found.tau
    return float(np.linalg.norm(found.E) / room) if room > 0.0 else np.inf


def full_bound(found: Estimate, spectral: float, smallest: float) -> Array:
    """Sigma is at most this; `smallest`: the quantile of the smallest root of W_n(I, N - d)."""
    room = np.sqrt(smallest) - spectral * found.tau
    S = found.E.T @ found.E
    return S / room**2 if room > 0.0 else np.full_like(S, np.inf)


def powers(A: Array, K: int) -> list[Array]:
    """A^0, .., A^(K-1)."""
    found = [np.eye(len(A))]
    for _ in range(K - 1):
        found.append(A @ found[-1])
    return found


def wcs(matrices: list[Array], sizes: list[float]) -> float:
    """The weighted inequality of Cauchy and Schwarz for ``||sum M_j y_j||``, ``||y_j|| <= b_j``."""
    terms = [(np.linalg.norm(M, 2), M, b) for M, b in zip(matrices, sizes, strict=True)]
    terms = [term for term in terms if term[0] * term[2] > 0.0]
    if not terms:
        return 0.0
    G = sum(b / size * M @ M.T for size, M, b in terms)
    return float(np.sqrt(np.linalg.eigvalsh(G)[-1] * sum(size * b for size, _, b in terms)))


def frobenius_norm(first: list[tuple[Array, Array]]) -> float:
    """``||sum_j c_j' (x) M_j||`` of pairs (M_j, c_j)."""
    return float(np.linalg.norm(sum(np.kron(c[None, :], M) for M, c in first), 2))


@dataclass(frozen=True)
class Problem:
    """A plan and a reference, with the radii of the event."""

    found: Estimate
    H0: Array
    root: Array
    spectral: float
    frobenius: float
    z: Array
    z0: Array

    @property
    def n(self) -> int:
        """The number of states."""
        return len(self.H0)

    @property
    def c(self) -> Array:
        """``c_j = T z_j``, in rows."""
        return self.z @ self.found.T.T

    @property
    def g(self) -> Array:
        """``g_j = R^-T z0_j``, in rows."""
        return np.linalg.solve(self.found.R.T, self.z0.T).T

    def model(self, k: int) -> list[Array]:
        """``A^(k-1-j) Sigma^(1/2)``, j < k."""
        return [P @ self.root for P in powers(self.found.H[:, : self.n], k)][::-1]

    def pilot(self, k: int) -> list[Array]:
        """``A0^(k-1-j) Sigma^(1/2)``, j < k."""
        return [P @ self.root for P in powers(self.H0[:, : self.n], k)][::-1]

    def C0(self, k: int) -> Array:
        """The covariance of the first-order error along the reference."""
        L = sum(np.kron(g[None, :], M) for M, g in zip(self.pilot(k), self.g[:k], strict=True))
        return np.asarray(L @ L.T)

    def future(self, k: int) -> tuple[Array, Array, Array]:
        """The covariances of the noise of the run: through A0, through A - A0, through A."""
        three = (self.pilot(k), self.model(k))
        apart = [M - L for M, L in zip(*three, strict=True)]
        sums = [sum(M @ M.T for M in each) for each in (three[0], apart, three[1])]
        return sums[0], sums[1], sums[2]

    def first(self, k: int, s: float) -> list[tuple[Array, Array]]:
        """The terms of the first-order error of the plan, less s times that of the reference."""
        plan = zip(self.model(k), self.c[:k], strict=True)
        return [*plan, *((-M, s * g) for M, g in zip(self.pilot(k), self.g[:k], strict=True))]

    def mismatch(self, k: int, s: float) -> float:
        """The largest first-order difference over the Frobenius ball."""
        return self.frobenius * frobenius_norm(self.first(k, s))

    def best(self, k: int, delta: float) -> tuple[float, float]:
        """The s of the smallest ``|s| q + mismatch(s)``, and that value."""
        q = wq(self.C0(k), delta)
        found = optimize.minimize_scalar(
            lambda s: abs(s) * q + self.mismatch(k, s),
            bounds=(-1.0, 2.0),
            options={"xatol": 1e-9},
            method="bounded",
        )
        return float(found.x), float(found.fun)

    def plain_rest(self, K: int, nu: Array | None = None) -> list[float]:
        """b_0, .., b_(K-1) without a reference; first order not over the spectral ball."""
        Tx, b = self.found.T[:, : self.n], [0.0]
        for k in range(1, K):
            inside = [Tx @ M for M in self.model(k)]
            plain = list(zip(inside, self.c[:k], strict=True))
            lengths = [float(np.linalg.norm(c)) for c in self.c[:k]]
            lin = min(self.frobenius * frobenius_norm(plain), self.spectral * wcs(inside, lengths))
            more = 0.0 if nu is None else nu[k - 1]
            b.append(lin + self.spectral * wcs(inside, b) + more)
        return b

    def near(self, j: int, delta: float, s: float = 1.0) -> tuple[float, float]:
        """q_j and mismatch_j: the first order of ``T_x e_j`` along the reference."""
        n = self.n
        X0, Tx = np.linalg.inv(self.found.R).T[:, :n], self.found.T[:, :n]
        q = wq(X0 @ self.C0(j) @ X0.T, delta)
        terms = [(Tx @ M, c) for M, c in zip(self.model(j), self.c[:j], strict=True)]
        terms += [(-X0 @ M, s * g) for M, g in zip(self.pilot(j), self.g[:j], strict=True)]
        return abs(s) * q, self.frobenius * frobenius_norm(terms)

    def rest(self, b: list[float]) -> float:
        """What is not of first order."""
        return self.spectral * wcs(self.model(len(b)), b)

    def better_rest(self, K: int, delta: float, s: float, nu: Array | None = None) -> list[float]:
        """b_0, .., b_(K-1), the smaller of the plain ones and those near the reference."""
        Tx, b = self.found.T[:, : self.n], [0.0]
        for j, plain in enumerate(self.plain_rest(K, nu)[1:], 1):
            more = 0.0 if nu is None else nu[j - 1]
            back = self.spectral * wcs([Tx @ M for M in self.model(j)], b)
            b.append(min(plain, sum(self.near(j, delta, s)) + back + more))
        return b
