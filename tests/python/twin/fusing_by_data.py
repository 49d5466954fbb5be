"""Weights of given models by data: no exact Theta is needed.

Models Theta_1, .., Theta_M (n, d) that are independent of the data. With V = R' R (R = `root`),
||Y - Theta Z||^2 = ||Theta R' - t||^2 + tr S for t = H R': the nearest point of the hull of the
S_i = Theta_i R' to t is a problem on the simplex of size n rank. The noise of t is
sigma times a standard normal in p = n rank dimensions, of which k belong to the affine hull.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stochens_rs.reference.fusing import alse_dense

from .laws import chi2_quantile, chi2_upper, f_upper, noncentrality_limit
from .regions import Region
from .triangle import Fitted

Array = NDArray[np.float64]


class FusedModel(NamedTuple):
    """F = sum w_i Theta_i nearest to the data, and what the data say about the hull.

    `distance2` = ||F R' - t||^2, `off2` = ||t - P t||^2 =: T and `along` = ||P t - F R'||, P the
    projector on the affine hull (dimension k); F R' is in a face of dimension `face`.
    """

    F: Array
    weights: Array
    distance2: float
    off2: float
    along: float
    k: int
    face: int
    p: int
    fitted: Fitted


def fuse(models: ArrayLike, fitted: Fitted) -> FusedModel:
    """The mixture of `models` (M, n, d) nearest to the data, in the norm ||. R'||_F."""
    models = np.asarray(models, dtype=np.float64)
    S = models @ fitted.root.T
    t = fitted.H @ fitted.root.T
    found = alse_dense(S, t)
    F = np.tensordot(found.weights, models, axes=1)
    basis, active = _span(S, S), _span(S[found.weights > 0.0], S)
    to = (t - S[0]).ravel()
    nearest = basis.T @ (basis @ to)
    along = nearest - (F @ fitted.root.T - S[0]).ravel()
    return FusedModel(
        F,
        found.weights,
        found.error**2,
        float(np.sum((to - nearest) ** 2)) if len(basis) < to.size else 0.0,
        float(np.linalg.norm(along)),
        len(basis),
        len(active),
        to.size,
        fitted,
    )


def _span(some: Array, S: Array) -> Array:
    """A basis of the affine hull of some of the S_i, as rows."""
    differences = (some[1:] - some[0]).reshape(len(some) - 1, S[0].size)
    _, s, basis = np.linalg.svd(differences, full_matrices=False)
    return np.asarray(basis[s > 1e-10 * np.max(np.linalg.norm(S.reshape(len(S), -1), axis=1))])


def explained(fused: FusedModel, sigma: float, delta: float) -> bool:
    """Whether some affine mixture is compatible with the data: T / sigma^2 <= chi2_{p-k; delta}."""
    return fused.off2 <= sigma**2 * chi2_upper(delta, fused.p - fused.k)


def certificate(fused: FusedModel, sigma: float, delta: float) -> Region:
    """||(F - Theta) V^(1/2)||_F, from the data alone, sigma known; z independent of the noise.

    T / sigma^2 is noncentral chi2_{p-k} with the squared distance of Theta to the affine hull, and
    independent of the part along it: sigma^2 L + (along + sigma chi_k)^2 with L the upper limit of
    the noncentrality, delta / 2 each (after Baraud 2004), or delta where the other part is empty.
    Any F in the affine hull will do.
    """
    share = delta / 2.0 if 0 < fused.k < fused.p else delta  # one part alone gets all of it
    rest = noncentrality_limit(fused.off2 / sigma**2, fused.p - fused.k, share)
    chi = np.sqrt(chi2_upper(share, fused.k))
    return _region(fused, sigma**2 * rest + (fused.along + sigma * chi) ** 2, delta)


def certificate_unknown(fused: FusedModel, delta: float, cells: int = 400) -> Region:
    """The same with sigma^2 in its chi2 interval from tr S: delta / 3 each.

    The largest value over cells [s, s'] of the interval of s' L(T / s) + (along + sqrt(s') chi)^2;
    the maximum may be inside, and a cell is bounded from above by both its ends.
    """
    f, n = fused.fitted, len(fused.F)
    free, rss = n * f.nu, float(np.trace(f.S))
    if free == 0:
        return _region(fused, np.inf, delta)
    low, high = rss / chi2_upper(delta / 6.0, free), rss / chi2_quantile(delta / 6.0, free)
    s = np.geomspace(low, high, cells + 1)
    chi = np.sqrt(chi2_upper(delta / 3.0, fused.k))
    off = [noncentrality_limit(fused.off2 / v, fused.p - fused.k, delta / 3.0) for v in s[:-1]]
    return _region(
        fused, float(np.max(s[1:] * off + (fused.along + np.sqrt(s[1:]) * chi) ** 2)), delta
    )


def _region(fused: FusedModel, squared: float, delta: float) -> Region:
    assumption = "noise sigma^2 I independent of all z; models independent of the data"
    fitted = fused.fitted._replace(H=fused.F)
    return Region(fitted, squared, np.eye(len(fused.F)), delta, assumption)


def between(hull: float, least_squares: float, distance: float, share: float) -> float:
    """Radius^2 at F + share (H - F), from those at F and H in ||. V^(1/2)||_F.

    ||X_s||^2 = (1 - s) ||X_0||^2 + s ||X_1||^2 - s (1 - s) ||F - H||^2, where neither radius need
    be larger than the other plus the distance.
    """
    a = min(hull, (np.sqrt(least_squares) + distance) ** 2)
    b = min(least_squares, (np.sqrt(hull) + distance) ** 2)
    return float((1.0 - share) * a + share * b - share * (1.0 - share) * distance**2)


class Shrunken(NamedTuple):
    """F + share (H - F): share of least squares; its certificate is `between`."""

    model: Array
    share: float


def shrunken(fused: FusedModel, sigma: float | None = None, *, rule: str = "stein") -> Shrunken:
    """Between the hull and least squares: share = max(0, 1 - c / distance2).

    "mallows": c = sigma^2 n d, what least squares gets as one more model (Hansen 2007). "stein":
    c = sigma^2 (p - face - 2), better than least squares for every Theta if p - face >= 3 (Bock
    1982 for a subspace; Stein's identity along the normal cone of the face, on which t is shrunk);
    sigma unknown: c = (p - face - 2) tr S / (n nu + 2), and 0 where nothing is known of sigma.
    "tested": with q = p - face, c = sigma^2 min(1.5 (q - 2), chi2_{q; 0.01}): what noise explains,
    but no more than Stein's inequality, which holds below 2 (q - 2), allows with a gain; sigma
    unknown: the F law (Baranchik 1970). Almost the mixture where it is right.
    Along directions that the data do not determine the model stays F.
    """
    f, n = fused.fitted, len(fused.F)
    s2 = sigma**2 if sigma is not None else float(np.trace(f.S)) / (n * f.nu + 2)
    q = fused.p - fused.face
    degrees = float(fused.p) if rule == "mallows" else max(0.0, q - 2.0)
    if rule == "tested" and q > 2 and sigma is not None:
        degrees = min(1.5 * degrees, chi2_upper(0.01, q))
    elif rule == "tested" and q > 2 and f.nu > 0:
        free = n * f.nu
        degrees = min(1.5 * degrees, q * (free + 2) / free * f_upper(0.01, q, free))
    share = max(0.0, 1.0 - degrees * s2 / fused.distance2) if fused.distance2 > 0.0 else 0.0
    if sigma is None and f.nu == 0:
        share = 0.0
    seen = (f.H - fused.F) @ f.root.T @ f.white
    return Shrunken(fused.F + share * seen, float(share))
