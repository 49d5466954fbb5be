"""Regions for states measured with error, by instruments (Anderson and Rubin 1949).

``e_t = y_t - Theta z_t`` holds the noise of both readings, and the instruments zeta_t are
independent of all noise. On a run ``e_t = w_t + v_{t+1} - A v_t``, so only every second pair is
used: then the e_t are independent.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .._base.numbers import TINY
from ..exceptions import InputError
from ..theory.exact import EPS
from .least_squares import SLACK
from .levels import roy_quantile
from .part import Part

if TYPE_CHECKING:
    from .._base.types import Floats


class Projected(NamedTuple):
    """``inside' inside = [Z Y]' P [Z Y]``, P the projector on the instruments; `outside`: I - P."""

    inside: Floats
    outside: Floats
    rank: int
    N: int


def projected(R: Floats, count: int, N: int) -> Projected:
    """From the triangle of [zeta Z Y], `count` columns of zeta, of any rank."""
    D = np.linalg.norm(R[:count, :count], axis=0)
    U, s, _ = np.linalg.svd(R[:count, :count] / np.where(D == 0.0, 1.0, D))
    rank = int(np.sum(s > max(N, count) * EPS * np.max(s, initial=0.0)))
    inside = U[:, :rank].T @ R[:count, count:]
    left = R[:count, count:] - U[:, :rank] @ inside
    return Projected(inside, np.vstack([left, R[count:, count:]]), rank, N)


def two_stages(found: Projected, d: int) -> Floats:
    """Two-stage least squares: ``Y P Z' (Z P Z')^+``."""
    scale = np.linalg.norm(found.inside[:, :d], axis=0)
    scale = np.where(scale == 0.0, 1.0, scale)
    solved = np.linalg.lstsq(found.inside[:, :d] / scale, found.inside[:, d:], rcond=None)[0]
    return np.asarray(solved.T / scale)


def instrumented(found: Projected, d: int, delta: float) -> tuple[Floats, Part]:
    """Centre and region ``{E P E' <= q E (I - P) E'}``, q Roy's quantile of (n, r, N - r).

    At the truth both sides are Wishart matrices of r and N - r degrees. With ``Q = P - q (I - P)``,
    ``V = Z' Q Z`` and ``C = Y' Q Z V^-1``, completing the square gives ``S = C V C' - Y' Q Y``.
    """
    n = found.inside.shape[1] - d
    rows, columns = np.arange(n), np.arange(d)
    enough = found.rank >= d
    q = roy_quantile(n, found.rank, found.N - found.rank, delta) if enough else np.inf
    D = np.linalg.norm(found.inside[:, :d], axis=0)
    D = np.where(D == 0.0, 1.0, D)
    scaled = np.concatenate([D, np.ones(n)])
    if np.isfinite(q):
        inside, outside = found.inside / scaled, found.outside / scaled
        form = inside.T @ inside - q * (outside.T @ outside)
        V, YZ, YY = form[:d, :d], form[d:, :d], form[d:, d:]
        if np.linalg.eigvalsh(V)[0] > 1e-12 * d:
            C = np.linalg.solve(V, YZ.T).T
            S = C @ V @ C.T - YY
            # widened by the rounding of these differences, which noise of few sources leaves alone
            terms = np.sum(inside[:, d:] ** 2, axis=0) + q * np.sum(outside[:, d:] ** 2, axis=0)
            terms += np.diag(np.abs(C) @ np.abs(V) @ np.abs(C.T))
            S += n * np.diag(SLACK * (d + n) * EPS * terms)
            sizes = np.sqrt(np.maximum(np.diag(S), TINY))
            if np.linalg.eigvalsh(S / sizes[:, None] / sizes)[0] < -SLACK * n * EPS:
                raise InputError(
                    f"no model explains these data with these `instruments` (delta={delta:g}): an "
                    "instrument depends on the noise, or the noise is not white or not Gaussian"
                )
            root = np.linalg.cholesky(V).T
            white = np.linalg.inv(root).T / D
            nothing = np.zeros((d, 0))
            return C / D, Part(rows, columns, white, root * D, nothing, 1.0, S, 1.0)
    unbounded = Part(rows, columns, np.eye(d), np.eye(d), np.zeros((d, 0)), 1.0, np.eye(n), np.inf)
    return two_stages(found, d), unbounded
