"""Where data lie relative to the hull of given models, and what that says about the true model.

Models Theta_i (n, d) that are independent of the data; ``V = R' R`` with R = `root`. With
``S_i = Theta_i R'`` and ``t = H R'``, H least squares,
``||Y - Theta_w Z||^2 = ||sum w_i S_i - t||^2 + tr S``. For z independent of Gaussian noise of
covariance sigma^2 I the noise of t is sigma times a standard normal in p = n rank dimensions, of
which k belong to the affine hull of the S_i.
Known covariances become I by a change of units.
"""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .. import _core

if TYPE_CHECKING:
    from .._base.types import Floats

DOUBT = 0.01  # probability to doubt models of which a mixture is true
MOST = 1.5  # of Stein's constant; below 2 least squares is never better
LOOSE = 1.002  # how far above its largest value a squared radius may be
_SPAN = 1e-10  # singular values of the differences of the models below this share count as 0
_LARGE = 1e4  # noncentral laws are replaced by a normal bound beyond


class Noise(NamedTuple):
    """``sigma^2``, or None and what estimates it: the residual sum of squares and its degrees."""

    variance: float | None
    rss: float
    degrees: int


class Hull(NamedTuple):
    """The mixture ``point = sum w_i S_i`` nearest to the data t; P projects on the affine hull.

    `distance2` is ``||t - point||^2``, `off2` is ``||t - P t||^2``, `along` is ``||P t - point||``;
    k and `face` are the dimensions of the affine hull and of the face that `point` lies in, p is
    that of the space.
    """

    point: Floats
    t: Floats
    distance2: float
    off2: float
    along: float
    k: int
    face: int
    p: int

    @property
    def away(self) -> Floats:
        """``t - point``."""
        return self.t - self.point


def coordinates(models: Floats, fitted: _core.Fitted, units: Floats) -> tuple[Floats, Floats]:
    """The S_i (M, n, rank) and t (n, rank), each row in `units` L: ``L^-1 Theta R'``."""
    S: Floats = np.asarray(np.linalg.solve(units, models @ fitted.root.T))
    return S, np.asarray(np.linalg.solve(units, fitted.H @ fitted.root.T))


def position(S: Floats, t: Floats, weights: Floats) -> Hull:
    """What the data t are relative to the S_i, for the best weights."""
    point = np.tensordot(weights, S, axes=1)
    largest = float(np.max(np.linalg.norm(S.reshape(len(S), -1), axis=1)))
    basis = _span(S, largest)
    to = (t - S[0]).ravel()
    nearest = basis.T @ (basis @ to)
    return Hull(
        point=point,
        t=t,
        distance2=float(np.sum((t - point) ** 2)),
        off2=float(np.sum((to - nearest) ** 2)) if len(basis) < to.size else 0.0,
        along=float(np.linalg.norm(nearest - (point - S[0]).ravel())),
        k=len(basis),
        face=len(_span(S[weights > 0.0], largest)),
        p=t.size,
    )


def _span(S: Floats, largest: float) -> Floats:
    """An orthonormal basis of the differences of the S_i, as rows."""
    _, s, basis = np.linalg.svd((S[1:] - S[0]).reshape(len(S) - 1, S[0].size), full_matrices=False)
    return np.asarray(basis[s > _SPAN * largest])


def least_squares_share(hull: Hull, noise: Noise) -> float:
    """The share of least squares: ``max(0, 1 - c / distance2)``, 0 where noise explains all.

    With q = p - face, ``c = sigma^2 min(1.5 (q - 2), chi^2_{q; DOUBT})``. While `point` stays in
    its face, t is shrunk along the normal cone of that face, of dimension q, and Stein's identity
    has no boundary terms there: the unbiased estimate of the risk minus that of least squares is
    ``sigma^2 (distance2 / sigma^2 - 2 q)`` below c and ``c (c - 2 sigma^2 (q - 2)) / distance2``
    beyond, both <= 0 (James and Stein 1961; Bock 1982). So no Theta has a larger mean-square error
    than with least squares. The quantile lets the data in only where they contradict the models;
    1.5 keeps three quarters of what the best constant, 1, gains far from the hull.
    sigma unknown: ``1.5 (q - 2) / (degrees + 2)`` and the quantile of F, times tr S (Baranchik
    1970); without degrees nothing is known of the noise, and 0.
    """
    q, free = hull.p - hull.face, noise.degrees
    if hull.distance2 == 0.0 or (noise.variance is None and free == 0):
        return 0.0
    if q <= 2:
        return 1.0
    if noise.variance is not None:
        c = noise.variance * min(MOST * (q - 2), _core.chi2_upper(DOUBT, q))
    else:
        c = noise.rss * min(MOST * (q - 2) / (free + 2), q / free * _core.f_upper(DOUBT, q, free))
    return max(0.0, 1.0 - c / hull.distance2)


def explained(hull: Hull, noise: Noise) -> bool | None:
    """Whether an affine mixture is compatible with the data: test of `off2` at level DOUBT.

    None where there is no direction off the hull, or nothing is known of the noise.
    """
    off = hull.p - hull.k
    if off == 0 or (noise.variance is None and noise.degrees == 0):
        return None
    if noise.variance is not None:
        return hull.off2 <= noise.variance * _core.chi2_upper(DOUBT, off)
    level = off / noise.degrees * _core.f_upper(DOUBT, off, noise.degrees)
    return hull.off2 <= noise.rss * level


def hull_radius2(hull: Hull, noise: Noise, delta: float, extra: int = 0) -> float:
    """A bound on ``||(F - Theta) V^1/2||_F^2`` for the mixture F, from the data alone.

    ``off2 / sigma^2`` is noncentral chi^2_{p-k} with the squared distance of Theta to the affine
    hull, independent of the part along it: ``sigma^2 L + (along + sigma chi_k)^2``, L the upper
    limit of the noncentrality (after Baraud 2004). sigma unknown: the largest value over its
    interval from tr S, by cells that are bounded by both their ends and halved where it matters.
    `extra`: independent variates of the same noise that are to be covered too;
    ``(a + x)^2 + y^2 <= (a + sqrt(x^2 + y^2))^2``.
    """
    inside, off = hull.k + extra, hull.p - hull.k
    if noise.variance is not None:
        share = delta / 2.0 if inside and off else delta
        sigma, chi = np.sqrt(noise.variance), np.sqrt(_core.chi2_upper(share, inside))
        rest = noncentrality(hull.off2 / noise.variance, off, share)
        return float(noise.variance * rest + (hull.along + sigma * chi) ** 2)
    if noise.degrees == 0:
        return np.inf
    low = noise.rss / _core.chi2_upper(delta / 6.0, noise.degrees)
    high = noise.rss / _core.chi2_quantile(delta / 6.0, noise.degrees)
    if low <= 0.0:  # no noise at all
        return hull.off2 + hull.along**2
    chi = np.sqrt(_core.chi2_upper(delta / 3.0, inside))

    def upper(v: float) -> float:
        return noncentrality(hull.off2 / v, off, delta / 3.0)

    def squared(v: float, limit: float) -> float:
        return float(v * limit + (hull.along + np.sqrt(v) * chi) ** 2)

    # the limit falls with sigma^2: a cell [v, w] is below the value for w with the limit at v
    limit = upper(low)
    largest, cells = squared(low, limit), [(-squared(high, limit), low, high, limit)]
    while -cells[0][0] > LOOSE * largest:
        _, v, w, limit = heapq.heappop(cells)
        middle = float(np.sqrt(v * w))
        lower = upper(middle)
        largest = max(largest, squared(middle, lower))
        heapq.heappush(cells, (-squared(middle, limit), v, middle, limit))
        heapq.heappush(cells, (-squared(w, lower), middle, w, lower))
    return -cells[0][0]


def noncentrality(x: float, degrees: int, delta: float) -> float:
    """Upper limit of the noncentrality of chi^2 from one value x, with confidence 1 - delta.

    For large x, ``(sqrt(x) + z)^2`` with the normal quantile z, since chi^2 is at least
    ``(sqrt(L) + g)^2`` for a standard normal g: larger by less than the degrees, and quick.
    """
    if x <= _LARGE * (1.0 + degrees / 100.0):
        return _core.noncentrality_limit(x, degrees, delta)
    return float((np.sqrt(x) + np.sqrt(_core.chi2_upper(min(2.0 * delta, 0.999), 1))) ** 2)


def ball(b: float, a: float, away: Floats, share: float) -> float:
    """Spectral radius around ``point + share away``: Theta within b of t (spectral), a of `point`.

    With ``X, Y`` the differences of Theta from `point` and t, that from the point between is
    ``(1 - s) X X' + s Y Y' - s (1 - s) away away'``, squared; or the triangle inequality.
    """
    sizes = np.linalg.svd(away, compute_uv=False)
    distance = float(sizes[0])
    a, b = min(a, b + distance), min(b, a + distance)
    if not np.isfinite(a):
        return np.inf
    least = float(sizes[-1]) if len(away) <= away.shape[1] else 0.0
    between = (1.0 - share) * a * a + share * b * b - share * (1.0 - share) * least**2
    middle = np.sqrt(max(0.0, between))
    return float(min(b + (1.0 - share) * distance, a + share * distance, middle))


def frobenius_ball(b: float, a: float, away: Floats, share: float) -> float:
    """The same for the Frobenius norm, where the identity for the point between is one number."""
    distance = float(np.linalg.norm(away))
    a, b = min(a, b + distance), min(b, a + distance)
    if not np.isfinite(a):
        return np.inf
    between = (1.0 - share) * a * a + share * b * b - share * (1.0 - share) * distance**2
    return float(np.sqrt(max(0.0, between)))
