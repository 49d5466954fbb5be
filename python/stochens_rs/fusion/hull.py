"""Where data lie relative to the hull of given models, and what that says about the true model.

Models Theta_i (n, d) that are independent of the data; ``V = R' R`` with R = `root`. With
``S_i = Theta_i R'`` and ``t = H R'``, H least squares,
``||Y - Theta_w Z||^2 = ||sum w_i S_i - t||^2 + tr S``. For z independent of Gaussian noise of
covariance sigma^2 I the noise of t is sigma times a standard normal in p = n rank dimensions, of
which k belong to the affine hull of the S_i.
Known covariances become I by a change of units; of unknown ones the units are the estimated
deviations of the rows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from .. import _core
    from .._base.types import Floats

_SPAN = 1e-10  # singular values of the differences of the models below this share count as 0


class Noise(NamedTuple):
    """``sigma^2``, or None and what estimates it: the residual sum of squares and its degrees.

    `rows` above 1: so many rows have variances of their own, estimated with `degrees` each.
    """

    variance: float | None
    rss: float
    degrees: int
    rows: int = 1


class Hull(NamedTuple):
    """The mixture ``point = sum w_i S_i`` nearest to the data t; P projects on the affine hull.

    `distance2` is ``||t - point||^2``, `off2` is ``||t - P t||^2``, `along` is ``||P t - point||``;
    k and `face` are the dimensions of the affine hull and of the face that `point` lies in, p is
    that of the space; `largest` is the largest norm of t and the S_i.
    """

    point: Floats
    t: Floats
    distance2: float
    off2: float
    along: float
    k: int
    face: int
    p: int
    largest: float

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
        largest=max(largest, float(np.linalg.norm(t))),
    )


def _span(S: Floats, largest: float) -> Floats:
    """An orthonormal basis of the differences of the S_i, as rows."""
    _, s, basis = np.linalg.svd((S[1:] - S[0]).reshape(len(S) - 1, S[0].size), full_matrices=False)
    return np.asarray(basis[s > _SPAN * largest])


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
