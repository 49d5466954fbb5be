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

from .. import _core

if TYPE_CHECKING:
    from .._base.types import Floats


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
    point, numbers = _core.hull_position(S.reshape(len(S), -1), t.ravel(), weights)
    return Hull(point.reshape(t.shape), t, *numbers)
