"""How large a region must be: the factor of ``(Theta - C) V (Theta - C)' <= factor S``.

``D = H - Theta`` of least squares. Independent design: ``D V^1/2 = Sigma^1/2 G`` and
``S = Sigma^1/2 E Sigma^1/2`` with G standard normal and E an independent Wishart matrix of nu
degrees (Anderson 2003, ch. 8), so that all laws are free of Theta and Sigma. Any design: mixtures
of supermartingales over lines, with Ville's inequality, valid for all N at once.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .. import _core
from .._base.threads import get_num_threads
from .assumptions import Assumptions
from .least_squares import Fitted, r_factor

if TYPE_CHECKING:
    from .._base.types import Floats


class Shaped(NamedTuple):
    """The factor and S; the covariance of the noise is at most `noise` in the same event."""

    factor: float
    S: Floats
    noise: Floats | None = None


# lam of the mixtures in units of the squared scale of z, and the prior of the universal region;
# fixed before the data.
GRID: Floats = np.array([2.0**j for j in range(-4, 12)])
PRIOR_NOISE = 0.01


# Quantiles depend on sizes alone, and take milliseconds: those asked for before are kept.


@lru_cache(4096)
def roy_quantile(n: int, d: int, nu: int, delta: float) -> float:
    """Of the largest root of ``E^-1 G G'``; infinite for nu < n."""
    return _core.roy_quantile(n, d, nu, delta, get_num_threads())


@lru_cache(4096)
def joint_radii(n: int, d: int, nu: int, delta: float) -> tuple[float, float]:
    """Radii of the spectral and the Frobenius norm of ``E^-1/2 G`` in one event."""
    return _core.joint_radii(n, d, nu, delta, get_num_threads())


@lru_cache(4096)
def wishart_quantile(n: int, d: int, delta: float) -> float:
    """Of the largest root of ``G G'``."""
    return _core.wishart_quantile(n, d, delta, get_num_threads())


@lru_cache(4096)
def scalar_quantile(n: int, d: int, nu: int, delta: float) -> float:
    """Of the largest root of ``G G'`` against chi^2 of n nu degrees."""
    return _core.scalar_quantile(n, d, nu, delta, get_num_threads())


@lru_cache(4096)
def diagonal_quantile(n: int, d: int, nu: int, delta: float) -> float:
    """Of the largest root of ``C^-1/2 G G' C^-1/2``, C diagonal of n chi^2 of nu degrees."""
    return _core.diagonal_quantile(n, d, nu, delta, get_num_threads())


@lru_cache(4096)
def smallest_quantile(n: int, N: int, delta: float) -> float:
    """The lower one of the smallest root of W_n(I, N)."""
    return _core.smallest_quantile(n, N, delta, get_num_threads())


def independent(
    f: Fitted, noise: Assumptions, known: Floats | None, columns: int, delta: float
) -> Shaped:
    """The exact factor for z independent of Gaussian noise; `columns`: rank, with noise to come.

    full: Roy's root of ``E^-1 G G'``, for one row the law of F; diagonal and scalar: the root of
    G G' against the diagonal and the trace of S; known: the root of G G' alone.
    """
    n = len(f.S)
    if columns == 0:
        return Shaped(0.0, f.S, known)
    if known is not None:
        return Shaped(wishart_quantile(n, columns, delta), known, known)
    if f.nu < 1:
        return Shaped(np.inf, np.eye(n))
    if noise.covariance == "scalar" and n > 1:
        return Shaped(scalar_quantile(n, columns, f.nu, delta), np.trace(f.S) * np.eye(n))
    if noise.covariance == "diagonal" and n > 1:
        return Shaped(diagonal_quantile(n, columns, f.nu, delta), np.diag(np.diag(f.S)))
    return Shaped(roy_quantile(n, columns, f.nu, delta), f.S)


def adaptive(
    f: Fitted,
    noise: Assumptions,
    known: Floats | None,
    scale: Floats,
    state_scale: Floats,
    delta: float,
    method: str,
    anytime: bool,
) -> Shaped:
    """The factor for any design; `scale` (d,) and `state_scale` (n,) are fixed before the data.

    Known noise: the sphere mixture. Unknown Gaussian noise: the same with a lower bound of the
    covariance ("mixture"), or the marginal likelihood over the largest ("universal"); "auto" takes
    the smaller of both at delta / 2 each.
    """
    n = len(f.S)
    if f.rank == 0:
        return Shaped(0.0, f.S, known)
    if known is not None:
        return Shaped(mixture_level(f, n, scale, delta), known, known)
    share = delta / 2.0 if method == "auto" else delta
    found: list[Shaped] = []
    if method != "universal":
        found.append(_unknown_noise(f, noise, scale, share, anytime))
    if method != "mixture":
        found.append(Shaped(universal(f, scale, state_scale, share), f.S))
    best = min(found, key=lambda one: one.factor * float(np.linalg.norm(one.S, 2)))
    return best._replace(noise=found[0].noise)


def mixture_level(f: Fitted, n: int, scale: Floats, delta: float) -> float:
    """rho^2 with ``||D V^1/2||^2 <= rho^2 sigma^2``, from ``log det(I + V / lam)`` over a grid."""
    s = np.linalg.svd(f.R11 / scale, compute_uv=False)
    smallest = float(s[f.rank - 1] ** 2)
    ld = np.array([np.sum(np.log1p(s * s / lam)) for lam in GRID])
    wider: Floats = 1.0 + GRID / smallest
    return _core.least_squares_level(n, ld, wider, delta, False)


def _unknown_noise(
    f: Fitted, noise: Assumptions, scale: Floats, delta: float, anytime: bool
) -> Shaped:
    """Gaussian noise of one covariance: rho^2 at delta / 2, and as much for the covariance.

    full: ``S >= (a - rho^2) Sigma``, a the quantile of the smallest root of W_n(I, N); scalar:
    ``tr S >= (chi^2_{nN} - min(n, rank) rho^2) sigma^2``: the covariance is at most S over that.
    `anytime` shares by 1 / (N (N + 1)).
    """
    n = len(f.S)
    share = delta / 2.0 / (f.N * (f.N + 1.0) if anytime else 1.0)
    rho2 = mixture_level(f, n, scale, delta / 2.0)
    if noise.covariance == "scalar":
        left = _core.chi2_quantile(share, n * f.N) - min(n, f.rank) * rho2
        S: Floats = np.trace(f.S) * np.eye(n)
    else:
        left = smallest_quantile(n, f.N, share) - rho2
        S = f.S
    return Shaped(rho2 / left, S, S / left) if left > 0.0 else Shaped(np.inf, S)


def universal(f: Fitted, scale: Floats, state_scale: Floats, delta: float) -> float:
    """``det(I + S^-1 D V D') <= rho``: marginal over largest likelihood; rho - 1 is the factor.

    Prior ``Theta ~ N(0, Sigma x I)`` and ``Sigma ~ IW(psi I, n + 2)`` in units of the scales
    (Wasserman, Ramdas and Balakrishnan 2020). The region is valid for any prior.
    """
    n, N = len(f.S), f.N
    if f.nu < n:
        return np.inf
    nu0, psi = n + 2.0, PRIOR_NOISE
    d = f.R11.shape[1]
    # all in units of the scales: z / scale, y / state_scale
    R11 = f.R11 / scale
    fitted, S = f.R11 @ f.H.T / state_scale, f.S / np.outer(state_scale, state_scale)
    ld = float(np.sum(np.log1p(np.linalg.svd(R11, compute_uv=False) ** 2)))
    # Psi = psi I + S + what ridge leaves of the fitted part
    prior = np.hstack([np.eye(d), np.zeros((d, n))])
    below = r_factor(np.vstack([np.hstack([R11, fitted]), prior]))[d:, d:]
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
