"""Regions from the triangle of data, in NumPy: what `Region::from_data` of the core does.

The quantiles are those of the core, which `quantiles` of this folder judges.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stochens_rs import _core

from .laws import chi2_quantile

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
EPS = float(np.finfo(float).eps)
SLACK = 4.0  # times (d + n) EPS of the lengths: rounding of outcomes, triangle and estimate
WIDER = 10.0  # of the rounding that a part is widened by
GRID: Floats = np.array([2.0**j for j in range(-4, 12)])
PRIOR_NOISE = 0.01


class Wish(NamedTuple):
    """What is asked of a region."""

    delta: float
    components: bool = False
    directions: Floats | None = None
    future: int = 0
    frobenius: bool = False
    method: str = "auto"
    anytime: bool = False


class Part(NamedTuple):
    """``(Theta - C) V (Theta - C)' <= factor S`` for some rows and columns."""

    rows: Indices
    columns: Indices
    white: Floats
    root: Floats
    missing: Floats
    ratio: float
    S: Floats
    factor: float


class Region(NamedTuple):
    """The centre, the parts, and what holds in the same event."""

    centre: Floats
    parts: tuple[Part, ...]
    frobenius: float | None
    noise: Floats | None


def region(model: Any, wish: Wish) -> Region:
    """The region of a `Model` of the package, from its triangle."""
    n, d, N, known, noise = model.n, model._d, model.size, model.known, model.assumptions
    triangle, units = model.triangle, model.scale
    first = 0 if wish.anytime else model._first
    if units is None:
        units = np.ones(d)
    if first:
        rows = model.rows
        triangle, N = np.linalg.qr(rows[first:], mode="r"), N - first
    all_rows = blocks(triangle, d, N, known, False)
    by_rows = wish.components and len(all_rows) == 1
    if first:
        units = blocks(np.linalg.qr(rows[:first], mode="r"), d, first, known, by_rows)
    parts_, frobenius, bound = parts(
        blocks(triangle, d, N, known, True) if by_rows else all_rows, noise, wish, units, n
    )
    return Region(assembled(all_rows, known, n, d), parts_, frobenius, bound)


class Fitted(NamedTuple):
    """Least squares and what its error is measured with.

    `white` (rank, d) has ``white' white = V^+``, `root` (rank, d) has ``root' root = V``. `missing`
    (d, d - rank): ``Theta z`` is determined only if ``missing' z = 0``. `rounding` (n,): what
    rounding may change in each row of ``H V^1/2`` and of the residuals.
    """

    H: Floats
    S: Floats
    N: int
    rank: int
    white: Floats
    root: Floats
    missing: Floats
    ratio: float
    R11: Floats
    rounding: Floats

    @property
    def nu(self) -> int:
        """Degrees of freedom of the residuals."""
        return self.N - self.rank


def r_factor(rows: Floats) -> Floats:
    """The square triangle of few rows, with a diagonal >= 0."""
    R = np.linalg.qr(rows)[1]
    R = np.vstack([R, np.zeros((rows.shape[1] - len(R), rows.shape[1]))])
    signs: Floats = np.where(np.diag(R) < 0.0, -1.0, 1.0)
    return R * signs[:, None]


def fit(R: Floats, d: int, N: int) -> Fitted:
    """Least squares from the triangle, of any rank.

    ``R11 = U diag(s) Q' D`` with the column lengths D: ``H' = D^-1 Q_r s_r^-1 U_r' R12`` and
    ``S = R22' R22 + R12' (I - U_r U_r') R12``, where the second term is what a lower rank leaves.
    """
    R11, R12, R22 = R[:d, :d], R[:d, d:], R[d:, d:]
    D = np.linalg.norm(R11, axis=0)
    D = np.where(D == 0.0, 1.0, D)
    U, s, Qt = np.linalg.svd(R11 / D)
    rank, missing = null_space(Qt, s, max(N, d) * EPS)
    U, s_r, Q_r = U[:, :rank], s[:rank], Qt[:rank]
    white = (Q_r / s_r[:, None]) / D
    left = R12 - U @ (U.T @ R12)
    H = (white.T @ (U.T @ R12)).T
    return Fitted(
        H=H,
        S=R22.T @ R22 + left.T @ left,
        N=N,
        rank=rank,
        white=white,
        root=(s_r[:, None] * Q_r) * D,
        missing=missing / D[:, None],
        ratio=float(s_r[-1] / s_r[0]) if rank else 0.0,
        R11=R11,
        rounding=SLACK * len(R) * EPS * (np.linalg.norm(R[:, d:], axis=0) + np.abs(H) @ D),
    )


def null_space(Qt: Floats, s: Floats, share: float) -> tuple[int, Floats]:
    """The rank of ``M = U diag(s) Qt`` and an orthonormal basis of its null space (columns).

    Singular values up to ``share s_1`` are taken for rounding, and so is a row w of the basis with
    ``||w|| <= share s_1 ||q / s||``, q the other entries of its row i: with the a in the range of
    M' with ``a_i = 1`` and the smallest ``||M a|| = 1 / ||q / s||``, row i of ``basis - a w`` is 0,
    and these columns span the null space of a matrix within ``||M a|| ||w|| <= share s_1`` of M.
    """
    rank = int(np.sum(s > share * np.max(s, initial=0.0)))
    basis = Qt[rank:].T
    known = np.linalg.norm(Qt[:rank].T / s[:rank], axis=1) * (share * np.max(s, initial=0.0))
    return rank, np.where((np.linalg.norm(basis, axis=1) <= known)[:, None], 0.0, basis)


def restricted(R: Floats, d: int, rows: Indices, columns: Indices, known: Floats) -> Floats:
    """The triangle for some rows and columns of Theta, where the other entries are `known`.

    ``[Z_columns, (Y - Z known')_rows]`` is ``[Z Y]`` times a matrix, so that of the triangle is
    enough. `known` (n, d) is 0 in these columns.
    """
    count = len(columns)
    M = np.zeros((len(R), count + len(rows)))
    M[columns, np.arange(count)] = 1.0
    M[:d, count:] = -known[rows].T
    M[d + rows, count + np.arange(len(rows))] = 1.0
    return r_factor(R @ M)


class Block(NamedTuple):
    """Least squares for some rows and columns of Theta."""

    rows: Indices
    columns: Indices
    fitted: Fitted


def blocks(R: Floats, d: int, N: int, known: Floats | None, by_rows: bool) -> list[Block]:
    """Least squares for all rows at once, or row by row; `known` (n, d) is nan where free."""
    n = len(R) - d
    free = np.ones((n, d), dtype=bool) if known is None else np.isnan(known)
    Theta0 = np.zeros((n, d)) if known is None else np.where(free, 0.0, known)
    all_rows = np.arange(n)
    sets = (
        [all_rows] if not by_rows and (free == free[0]).all() else [all_rows[[i]] for i in range(n)]
    )
    found = []
    for rows in sets:
        columns = np.flatnonzero(free[rows[0]])
        part = restricted(R, d, rows, columns, Theta0) if known is not None or by_rows else R
        found.append(Block(rows, columns, fit(part, len(columns), N)))
    return found


def assembled(found: list[Block], known: Floats | None, n: int, d: int) -> Floats:
    """Theta from its blocks and the known entries."""
    Theta = np.zeros((n, d)) if known is None else np.nan_to_num(known)
    for block in found:
        Theta[np.ix_(block.rows, block.columns)] = block.fitted.H
    return Theta


def parts(
    found: list[Block], noise: Any, wish: Wish, units: Floats | list[Block], n: int
) -> tuple[tuple[Part, ...], float | None, Floats | None]:
    """The parts of the region, and the Frobenius radius and the bound of the noise if there are."""
    made = []
    frobenius, bound = None, noise.known
    for at, block in enumerate(found):
        rows, columns, f = block
        delta = wish.delta
        if len(rows) < n:  # one row each: together by the union, or independent of each other
            apart = noise.covariance in ("diagonal", "scalar") and noise.design == "independent"
            apart = apart and noise.noise == "gaussian" and wish.components and len(columns) > 0
            # 1 - (1 - delta)^(1/n)
            delta = -float(np.expm1(np.log1p(-delta) / n)) if apart else delta / n
        known = None if noise.known is None else noise.known[np.ix_(rows, rows)]
        if noise.design == "independent" and noise.noise == "gaussian":
            Q = None if wish.directions is None else wish.directions[columns]
            f, rank = _directed(f, Q)
            if wish.frobenius and noise.covariance == "full" and len(rows) == n:
                spectral, frobenius = _core.joint_radii(n, rank + wish.future, f.nu, delta, 1)
                made.append(part_of(f, rows, columns, f.S, spectral**2))
                continue
            factor, S, _ = independent(f, noise, known, rank + wish.future, delta)
        else:
            if isinstance(units, list):
                unit = after(f, units[at].fitted)
            else:
                unit = expected(f, units[columns], units[rows])
            factor, S, own = adaptive(f, noise, known, unit, delta, wish)
            bound = own if len(found) == 1 else bound
        made.append(part_of(f, rows, columns, S, float(factor)))
        if wish.frobenius and len(found) == 1:  # ||G||_F <= sqrt(min(n, d)) ||G||
            frobenius = float(np.sqrt(factor * min(len(rows), f.rank + wish.future)))
    return tuple(made), frobenius, bound if noise.noise == "gaussian" else None


def _directed(f: Fitted, Q: Floats | None) -> tuple[Fitted, int]:
    """The same for z in the span of `Q` alone: there only as many columns of G count."""
    if Q is None:
        return f, f.rank
    # in units in which the columns of the data have length 1, as for their own rank
    D = np.linalg.norm(f.R11, axis=0)
    D = np.where(D == 0.0, 1.0, D)
    scaled = Q / D[:, None]
    sizes = np.linalg.norm(scaled, axis=0)
    U, s, _ = np.linalg.svd(scaled / np.where(sizes == 0.0, 1.0, sizes))
    rank, off = null_space(U.T, s, max(Q.shape) * EPS)
    rows = f.white * D
    rows /= np.linalg.norm(rows, axis=1)[:, None]  # orthonormal: cosines decide, not sizes
    seen = int(np.linalg.matrix_rank(rows @ U[:, :rank])) if rank and len(rows) else 0
    return f._replace(missing=np.hstack([off / D[:, None], f.missing])), seen


def part_of(f: Fitted, rows: Indices, columns: Indices, S: Floats, factor: float) -> Part:
    """The part around least squares, widened by its rounding."""
    if 0.0 < factor < np.inf:
        r = WIDER * (1.0 + factor**-0.5) * f.rounding
        S = S + len(S) * np.diag(r**2)
    return Part(rows, columns, f.white, f.root, f.missing, f.ratio, S, factor)


class Shaped(NamedTuple):
    """The factor and S; the covariance of the noise is at most `noise` in the same event."""

    factor: float
    S: Floats
    noise: Floats | None = None


def independent(f: Fitted, noise: Any, known: Floats | None, columns: int, delta: float) -> Shaped:
    """The exact factor for z independent of Gaussian noise; `columns`: rank, with noise to come.

    full: Roy's root of ``E^-1 G G'``, for one row the law of F; diagonal and scalar: the root of
    G G' against the diagonal and the trace of S; known: the root of G G' alone.
    """
    n = len(f.S)
    if columns == 0:
        return Shaped(0.0, f.S, known)
    if known is not None:
        return Shaped(_core.wishart_quantile(n, columns, delta, 1), known, known)
    if f.nu < 1:
        return Shaped(np.inf, np.eye(n))
    if noise.covariance == "scalar" and n > 1:
        return Shaped(_core.scalar_quantile(n, columns, f.nu, delta, 1), np.trace(f.S) * np.eye(n))
    if noise.covariance == "diagonal" and n > 1:
        return Shaped(_core.diagonal_quantile(n, columns, f.nu, delta, 1), np.diag(np.diag(f.S)))
    return Shaped(_core.roy_quantile(n, columns, f.nu, delta, 1), f.S)


class Units(NamedTuple):
    """What z, the mixtures and the noise are measured in, fixed before the pairs of the fit."""

    regressors: Floats  # R11 in these units
    lams: Floats
    sizes: Floats  # of the noise
    psi: float  # of the prior of its covariance in them
    centre: Floats  # of the prior of Theta


def expected(f: Fitted, scale: Floats, sizes: Floats) -> Units:
    """The units that were expected before the data."""
    return Units(f.R11 / scale, GRID, sizes, PRIOR_NOISE, np.zeros_like(f.H))


def after(f: Fitted, first: Fitted) -> Units:
    """Those of N1 pairs before: ``kappa P``, kappa = N2 (1/6, 1/3, 2/3), P = Z1 Z1' / N1."""
    lams = np.array([1.0, 2.0, 4.0]) / 6.0 * (f.N / first.N)
    sizes = np.sqrt(np.diag(first.S) / first.nu)
    sizes = np.where(sizes == 0.0, 1.0, sizes)
    return Units(f.R11 @ first.white.T, lams, sizes, len(first.S) + 2.0, first.H)


def adaptive(
    f: Fitted, noise: Any, known: Floats | None, units: Units, delta: float, wish: Wish
) -> Shaped:
    """The factor for any design.

    Known noise: the sphere mixture. Unknown Gaussian noise: the same with a lower bound of the
    covariance ("mixture"), or the marginal likelihood over the largest ("universal"); "auto" takes
    the smaller of both at delta / 2 each.
    """
    if f.rank == 0:
        return Shaped(0.0, f.S, known)
    if known is not None:
        return Shaped(mixture_level(f, units, delta), known, known)
    share = delta / 2.0 if wish.method == "auto" else delta
    found: list[Shaped] = []
    if wish.method != "universal":
        found.append(_unknown_noise(f, noise, units, share, wish))
    if wish.method != "mixture":
        found.append(Shaped(universal(f, units, share), f.S))
    best = min(found, key=lambda one: one.factor * float(np.linalg.norm(one.S, 2)))
    return best._replace(noise=found[0].noise)


def mixture_level(f: Fitted, units: Units, delta: float) -> float:
    """rho^2 with ``||D V^1/2||^2 <= rho^2 sigma^2``, from ``log det(I + V / lam)`` over the lam."""
    s = np.linalg.svd(units.regressors, compute_uv=False)
    ld = np.array([np.sum(np.log1p(s * s / lam)) for lam in units.lams])
    wider: Floats = 1.0 + units.lams / float(s[f.rank - 1] ** 2)
    return _core.least_squares_level(len(f.S), ld, wider, delta, False)


def _unknown_noise(f: Fitted, noise: Any, units: Units, delta: float, wish: Wish) -> Shaped:
    """Gaussian noise of one covariance: rho^2 at delta / 2, and as much for the covariance.

    full: ``S >= (a - rho^2) Sigma``, a the quantile of the smallest root of W_n(I, N); scalar:
    ``tr S >= (chi^2_{nN} - min(n, rank) rho^2) sigma^2``: the covariance is at most S over that.
    Anytime shares by 1 / (N (N + 1)).
    """
    n = len(f.S)
    share = delta / 2.0 / (f.N * (f.N + 1.0) if wish.anytime else 1.0)
    rho2 = mixture_level(f, units, delta / 2.0)
    if noise.covariance == "scalar":
        left = chi2_quantile(share, n * f.N) - min(n, f.rank) * rho2
        S: Floats = np.trace(f.S) * np.eye(n)
    else:
        left = _core.smallest_quantile(n, f.N, share, 1) - rho2
        S = f.S
    return Shaped(rho2 / left, S, S / left) if left > 0.0 else Shaped(np.inf, S)


def universal(f: Fitted, units: Units, delta: float) -> float:
    """``det(I + S^-1 D V D') <= rho``: marginal over largest likelihood; rho - 1 is the factor.

    Prior ``Theta ~ N(C, Sigma x I)`` and ``Sigma ~ IW(psi I, n + 2)`` in the units
    (Wasserman, Ramdas and Balakrishnan 2020). The region is valid for any prior.
    """
    n, N = len(f.S), f.N
    if f.nu < n:
        return np.inf
    nu0, psi = n + 2.0, units.psi
    R11, r = units.regressors, units.regressors.shape[1]
    fitted = f.R11 @ (f.H - units.centre).T / units.sizes
    S = f.S / np.outer(units.sizes, units.sizes)
    ld = float(np.sum(np.log1p(np.linalg.svd(R11, compute_uv=False) ** 2)))
    # Psi = psi I + S + what ridge leaves of the fitted part
    prior = np.hstack([np.eye(r), np.zeros((r, n))])
    below = r_factor(np.vstack([np.hstack([R11, fitted]), prior]))[r:, r:]
    Psi = psi * np.eye(n) + S + below.T @ below
    sign, log_S = np.linalg.slogdet(S)
    if sign <= 0:
        return np.inf
    log_m = (
        -n * N / 2.0 * math.log(math.pi)
        - n / 2.0 * ld
        + nu0 * n / 2.0 * math.log(psi)
        - (nu0 + N) / 2.0 * float(np.linalg.slogdet(Psi)[1])
        + _core.log_multigamma((nu0 + N) / 2.0, n)
        - _core.log_multigamma(nu0 / 2.0, n)
    )
    log_rho = -2.0 / N * (log_m + math.log(delta) + n * N / 2.0 * (1.0 + math.log(2.0 * math.pi)))
    return float(np.expm1(log_rho + n * math.log(N) - log_S))
