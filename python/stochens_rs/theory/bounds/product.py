"""Bounds for product fusion, ``u = B+ (xf_hat - A_hat x0_hat)``: all entities averaged first.

The product makes the error bilinear: ``y_hat - y = (xf_hat - xf) - A (x0_hat - x0)
- (A_hat - A) x0_hat``. Given ``x0_hat``, the last term is an average of independent terms; how
far ``x0_hat`` can be from ``x0`` costs a share of delta.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ..._base import gate
from ..._base.types import Axis
from ..formulas import Array, Sizes, sum_of_others
from ._base import Rates
from ._geometry import Geometry
from ._inequalities import bousquet, mcdiarmid, square
from .averages import McDiarmid
from .fused import Fused, Quantity, _check_equal, largest_linear, top_eigenvalue
from .norms import Weissman

_SHARE = math.log(10.0)  # a tenth of delta for an event that is not the main one


class _Product(Fused):
    """Product fusion, with a radius for ``||x0_hat - x0||``."""

    def _use(self, geometry: Geometry) -> None:
        super()._use(geometry)
        self._start = McDiarmid(geometry.x0), Weissman(geometry.x0, norm="2")

    def _distance(self, r0: float, level: float) -> float:
        """Radius of ``||x0_hat - x0||_2``."""
        return min(bound._unit * bound._capped((r0,), level) for bound in self._start)


class ProductMcDiarmid(_Product):
    """McDiarmid's inequality for product fusion: ``rms + sqrt(V L)``.

    Parameters
    ----------
    B, x0, xf, A, quantity, axis
        As in :class:`Fused`.

    Raises
    ------
    InputError, InputTypeError
        As :class:`Fused`.

    Notes
    -----
    ``2 V = D_f^2 / Nf + D_0^2 / N0 + sum_j xhat_j^2 D_j^2 / NA``: ``xf`` is revealed first, then
    ``x0``, then ``A``, and the ranges of the martingale differences add up. ``D_f`` and ``D_j``
    are the diameters of the atoms of ``xf`` and of column j, ``D_0^2`` is the largest
    ``||M (A d)||^2 + E||M (A_hat - A) d||^2`` for the difference d of two atoms of ``x0``. The
    last sum is at most ``g0^2 max_j D_j^2``, and with probability ``1 - delta/10`` close to its
    value at ``x0``; the smaller of the two radii is taken. For the state it implies the exponent
    ``N t^2 / (gf^2 + 3 g0^2 gA^2)``. Holds for different sizes of the entities.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> B, x0, xf, A = [[1.0], [0.0]], [1.0, 1.0], [2.0, 2.0], [[1.0, 0.0], [2.0, 5.0]]
    >>> bound = bounds.ProductMcDiarmid(B, x0, xf, A)
    >>> round(bound.radius(1000, 0.01), 4), round(bound.radius((1000, None, 1000), 0.01), 4)
    (0.36, 0.2514)
    """

    name = "McDiarmid"
    source = "bounded martingale differences, xf then x0 then A; mean at most the exact rms"

    def _radius(self, rates: Rates, level: float) -> float:
        r0, _, rA = rates
        at = self._at
        mean, linear = math.sqrt(at.mean_square(*rates)), self._linear_range(rates)
        nominal = at.range_A(at.x0)
        if r0 == 0.0 or rA == 0.0:
            return mcdiarmid(mean, linear + nominal**2 * rA / 2.0, level)
        surely = mcdiarmid(mean, linear + at.cap_A**2 * rA / 2.0, level)
        likely = nominal + at.slope_A * self._distance(r0, level + _SHARE)
        spread = linear + likely**2 * rA / 2.0
        return min(surely, mcdiarmid(mean, spread, level - math.log(0.9)))


class ProductBousquet(_Product):
    """Bousquet's inequality for the linear part of product fusion, McDiarmid's for the rest.

    Parameters
    ----------
    B, x0, xf, A, quantity, axis
        As in :class:`Fused`.

    Raises
    ------
    InputError, InputTypeError
        As :class:`Fused`.

    Notes
    -----
    ``y_hat - y = [(xf_hat - xf) - A (x0_hat - x0) - (A_hat - A) x0] - (A_hat - A)(x0_hat - x0)``.
    The bracket is the average of N independent terms, one for each index (one size for all):
    Bousquet with 0.8 delta. The rest is O(1/N): with ``||x0_hat - x0|| <= r`` (0.1 delta), given
    ``x0_hat``, McDiarmid with 0.1 delta. Best for large N.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> B, x0, xf, A = [[1.0], [0.0]], [1.0, 1.0], [2.0, 2.0], [[1.0, 0.0], [2.0, 5.0]]
    >>> round(bounds.ProductBousquet(B, x0, xf, A).radius(1000, 0.01), 4)
    0.4053
    """

    name = "Bousquet"
    source = "Bousquet for the linear part, McDiarmid for the product of two errors"

    def _rates(self, size: Sizes) -> Rates:
        rates = super()._rates(size)
        _check_equal(rates, "one linear term for each index")
        return rates

    def _radius(self, rates: Rates, level: float) -> float:
        r0, _, rA = rates
        at, rate = self._at, max(rates)
        bilinear = r0 > 0.0 and rA > 0.0
        t0, tf, tA, _ = at._traces
        mean = math.sqrt(t0 * r0 + tf * rates[1] + tA * rA)
        variance = top_eigenvalue(at, rates, both=False) * rate
        largest = largest_linear(at, rates) * rate
        if not bilinear:
            return bousquet(mean, variance, largest, level)
        share = level + _SHARE
        rest = self._distance(r0, share) * mcdiarmid(
            math.sqrt(float(at.tau[at.hit].max(initial=0.0)) * rA), at.slope_A**2 * rA / 2.0, share
        )
        return bousquet(mean, variance, largest, level - math.log(0.8)) + rest


class ProductParts(_Product):
    """One radius for each entity, added: ``rho_f + rho_0 + rho_A``, each with its share of delta.

    Parameters
    ----------
    B, x0, xf, A, quantity, axis
        As in :class:`Fused`.
    x0_hat : (n,) array_like, optional
        The average of the realizations of ``x0``, if it is known already: the radius then holds
        for this ``x0_hat`` (independent of the realizations of A), without allowing for others.

    Raises
    ------
    InputError, InputTypeError
        As :class:`Fused`.

    Notes
    -----
    ``rho_f = rms_f + sqrt(D_f^2 L' / (2 Nf))``; ``rho_0`` the same for ``A x0_hat`` and
    ``rho_A = sqrt(sum_j xhat_j^2 tau_j / NA) + sqrt(sum_j xhat_j^2 D_j^2 L' / (2 NA))`` for
    ``A_hat`` given ``x0_hat``, ``tau_j = tr(M Cv(a_j) M^T)``. ``L' = log(k / delta)`` with k the
    number of entities that are not exact, plus one for the distance of ``x0_hat`` from ``x0``
    where `x0_hat` is not given. McDiarmid for each; never larger than the sum with norms in place
    of ``M``.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> B, x0, xf, A = [[1.0], [0.0]], [1.0, 1.0], [2.0, 2.0], [[1.0, 0.0], [2.0, 5.0]]
    >>> round(bounds.ProductParts(B, x0, xf, A).radius(1000, 0.01), 4)
    0.6664
    """

    name = "sum of parts"
    source = "McDiarmid for each of xf_hat, A x0_hat, A_hat x0_hat given x0_hat; union bound"
    _x0_hat: Array | None = None

    def __init__(
        self,
        B: ArrayLike,
        x0: ArrayLike,
        xf: ArrayLike,
        A: ArrayLike,
        *,
        quantity: Quantity = "state",
        axis: Axis = "columns",
        x0_hat: ArrayLike | None = None,
    ) -> None:
        super().__init__(B, x0, xf, A, quantity=quantity, axis=axis)
        if x0_hat is not None:
            checked = gate.vector("x0_hat", x0_hat, length=self._at.x0.size)
            self._x0_hat = checked / self._at.unit_x0

    def _radius(self, rates: Rates, level: float) -> float:
        r0, rf, rA = rates
        at = self._at
        sure = r0 == 0.0 or rA == 0.0 or self._x0_hat is not None
        parts = sum(rate > 0.0 for rate in rates) + (not sure)
        if parts == 0:
            return 0.0
        share = level + math.log(parts)
        t0, tf, _, _ = at._traces
        rho_f = math.sqrt(rf) * mcdiarmid(math.sqrt(tf), at.D_f**2 / 2.0, share)
        rho_0 = math.sqrt(r0) * mcdiarmid(math.sqrt(t0), at.D_0(0.0) ** 2 / 2.0, share)
        x = at.x0 if self._x0_hat is None or r0 == 0.0 else self._x0_hat
        rms, spread = math.sqrt(float(x**2 @ at.tau)), at.range_A(x)
        if not sure:
            distance = self._distance(r0, share)
            # the norms at x0_hat are at most those at x0 plus this distance
            rms += math.sqrt(float(at.tau[at.hit].max(initial=0.0))) * distance
            spread = min(spread + at.slope_A * distance, at.cap_A)
        rho_A = math.sqrt(rA) * mcdiarmid(rms, spread**2 / 2.0, share)
        return rho_f + rho_0 + rho_A


class ProductHoeffding(Fused):
    """Hoeffding's inequality for every entry of every entity: the paper's own route, repaired.

    Parameters
    ----------
    B : (n, m) array_like
        Input matrix, known exactly; any rank.
    x0, xf : (n,) array_like
        Initial state and target state.
    A : (n, n) array_like
        State matrix.
    axis : {"columns", "rows"}, default "columns"
        Which lines of ``A`` are sampled.

    Raises
    ------
    InputError, InputTypeError
        As :class:`Fused`.

    Notes
    -----
    ``P(||B (u - v*)|| > eps) <= 2 n exp(-2 Nf eps^2 / (9 n gf^2))
    + 2 n exp(-2 N0 eps^2 / (9 n ||A||^2 g0^2)) + 2 n^2 exp(-2 NA eps^2 / (9 n^2 g0^2 gA^2))``:
    Lemma 4.2 with the constants n of the norms in the exponents. The weakest and most elementary.
    For the state only.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> B, x0, xf, A = [[1.0], [0.0]], [1.0, 1.0], [2.0, 2.0], [[1.0, 0.0], [2.0, 5.0]]
    >>> round(bounds.ProductHoeffding(B, x0, xf, A).radius(1000, 0.01), 4)
    3.4698
    """

    name = "Hoeffding"
    source = "Hoeffding for every entry; triangle inequality with eps/3 for each entity"

    def __init__(
        self, B: ArrayLike, x0: ArrayLike, xf: ArrayLike, A: ArrayLike, *, axis: Axis = "columns"
    ) -> None:
        super().__init__(B, x0, xf, A, quantity="state", axis=axis)

    def _use(self, geometry: Geometry) -> None:
        super()._use(geometry)
        at, n = geometry, len(geometry.xf)
        lines = at.A.T if at.by_rows else at.A
        gamma = float(np.abs(lines).sum(axis=0).max()) if sum_of_others(lines).any() else 0.0
        norm = float(np.linalg.norm(at.A, 2))
        # P <= sum of count * exp(-eps^2 / (scale * rate)), in the order x0, xf, A
        self._terms = (
            (2.0 * n, 4.5 * n * (norm * at.g0) ** 2),
            (2.0 * n, 4.5 * n * at.gf**2),
            (2.0 * n * n, 4.5 * (n * at.g0 * gamma) ** 2),
        )

    def _level(self, rates: Rates, eps: float) -> float:
        exponents = [
            math.log(count) - square(eps / math.sqrt(scale * rate))
            for (count, scale), rate in zip(self._terms, rates, strict=True)
            if scale * rate > 0.0
        ]
        if not exponents:
            return math.inf
        top = max(exponents)
        if top == -math.inf:
            return math.inf
        return -top - math.log(sum(math.exp(x - top) for x in exponents))
