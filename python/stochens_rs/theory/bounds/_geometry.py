"""Moments, atoms and diameters of a control problem under a linear map, once for all bounds.

The error of a fused control is ``u - v* = M (y_hat - y)`` with ``y = xf - A x0``; that of the
state it leads to has the same form. In an orthonormal basis of the rows of ``B^+``:

- state: ``M = U^T``, as ``||B (u - v*)|| = ||U U^T (y_hat - y)||``;
- control: ``M = diag(1/s) U^T``, for ``B = U diag(s) V^T``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ... import _gate
from ...exceptions import NonFiniteError
from ..moments._formulas import (
    _AXES,
    Array,
    _compact_svd,
    _excess,
    _vector_covariance,
)
from ._base import unit_of


class Geometry:
    """What the bounds need to know of ``M (y_hat - y)``, in units in which nothing overflows."""

    def __init__(
        self, B: ArrayLike, x0: ArrayLike, xf: ArrayLike, A: ArrayLike, axis: str, quantity: str
    ) -> None:
        B = _gate.matrix("B", B)
        n = B.shape[0]
        x0 = _gate.vector("x0", x0, length=n)
        xf = _gate.vector("xf", xf, length=n)
        A = _gate.matrix("A", A, rows=n, cols=n)
        _gate.memory("the moments of the control", 50 * A.nbytes)
        self.by_rows = _gate.choice("axis", axis, _AXES) == "rows"
        self.quantity = _gate.choice("quantity", quantity, ("state", "control"))
        self._scale(B, x0, xf, A)
        self._set_moments()
        self._set_ranges()

    def _scale(self, B: Array, x0: Array, xf: Array, A: Array) -> None:
        unit_B, unit_A = unit_of(B), unit_of(A)
        unit_y = max(unit_A * unit_of(x0) if A.any() and x0.any() else 0.0, float(abs(xf).max()))
        unit_y = unit_y if unit_y > 0.0 else 1.0
        self.unit_x0 = unit_y / unit_A
        self.unit = unit_y if self.quantity == "state" else unit_y / unit_B
        if not all(0.0 < unit < math.inf for unit in (unit_y, self.unit_x0, self.unit)):
            raise NonFiniteError("`A x0`, or the control, over- or underflows: scale the problem")
        # without A, x0 has no effect whatever its size
        self.x0 = x0 / self.unit_x0 if A.any() else np.zeros_like(x0)
        self.xf, self.A = xf / unit_y, A / unit_A
        U, s, _ = _compact_svd(B / unit_B)
        self.M = np.ascontiguousarray(U.T if self.quantity == "state" else (U / s).T)
        self.M_norm = (
            0.0 if s.size == 0 else 1.0 if self.quantity == "state" else 1.0 / float(s[-1])
        )

    def _set_moments(self) -> None:
        """Covariances of ``M`` times ``A x0^s``, ``xf^s``, ``A^s x0``, ``(A^s - A)(x0^s - x0)``."""
        axis = "rows" if self.by_rows else "columns"
        M, A, x0 = self.M, self.A, self.x0
        Cv = _vector_covariance(x0)
        parts = (
            A @ Cv @ A.T,
            _vector_covariance(self.xf),
            _excess(A, np.outer(x0, x0), axis),
            _excess(A, Cv, axis),
        )
        self.covariances = tuple(M @ C @ M.T for C in parts)
        self._traces = tuple(max(0.0, float(np.trace(C))) for C in self.covariances)

    def _set_ranges(self) -> None:
        M, A, x0 = self.M, self.A, self.x0
        self.m = np.linalg.norm(M, axis=0)  # ||M e_i||
        self.g0, self.gf = float(abs(x0).sum()), float(abs(self.xf).sum())
        self.hit = np.flatnonzero(x0)
        # atoms of M xf^s and of M A x0^s, one per column
        self.atoms_f = self.gf * np.sign(self.xf[self.xf != 0.0]) * M[:, self.xf != 0.0]
        self.atoms_0 = self.g0 * np.sign(x0[self.hit]) * (M @ A[:, self.hit])
        self.D_f = math.sqrt(float(squared_distances(self.atoms_f).max(initial=0.0)))
        if self.by_rows:
            self._rows_of_A()
        else:
            self._columns_of_A()
        # E||M A^s d||^2 - ||M A d||^2 for the difference d of two atoms of x0, at most
        pairs = squared_distances(self.atoms_0)
        extra = self.g0**2 * np.add.outer(self.tau[self.hit], self.tau[self.hit])
        apart = ~np.eye(self.hit.size, dtype=bool)
        self._pairs_0 = pairs[apart], extra[apart]

    def _columns_of_A(self) -> None:
        """Column j of A^s is one of the atoms ``g_j sign(a_ij) e_i``."""
        M, A, x0 = self.M, self.A, self.x0
        absolute, present = np.abs(A), A != 0.0
        g = absolute.sum(axis=0)
        MA = M @ A
        squares = (MA**2).sum(axis=0)
        # tau_j = tr(M Cv(a_j) M^T) = g_j sum_i |a_ij| ||M e_i||^2 - ||M a_j||^2
        self.tau = np.maximum(0.0, g * (self.m**2 @ absolute) - squares)
        # diameter of the atoms: two of them are at most sqrt(2) g ||M|| and g (m_1 + m_2) apart
        norms = np.where(present, self.m[:, None], 0.0)
        two = np.partition(norms, -2, axis=0)[-2:].sum(axis=0) if len(A) > 1 else 0.0 * g
        random = np.count_nonzero(A, axis=0) >= 2
        self.D = np.where(random, g * np.minimum(math.sqrt(2.0) * self.M_norm, two), 0.0)
        self.cap_A = self.g0 * float(self.D[self.hit].max(initial=0.0))
        self.slope_A = float(self.D[self.hit].max(initial=0.0))
        # ||M (atom - a_j)||^2 = g^2 m_i^2 - 2 g sign (M^T M a_j)_i + ||M a_j||^2
        deviation = g**2 * (self.m**2)[:, None] - 2.0 * g * np.sign(A) * (M.T @ MA) + squares
        farthest = np.sqrt(np.where(present, deviation, 0.0).max(axis=0, initial=0.0))
        self.reach_A = float(np.abs(x0) @ np.where(random, farthest, 0.0))
        # atoms of z = A^s x0^s: at each i the largest of each sign
        moved = np.where(present & (x0 != 0.0), np.sign(A) * np.sign(x0) * self.g0 * g, 0.0)
        up, down = moved.max(axis=1), moved.min(axis=1)
        atoms = np.hstack([M[:, up > 0.0] * up[up > 0.0], M[:, down < 0.0] * down[down < 0.0]])
        self.D_z = math.sqrt(float(squared_distances(atoms).max(initial=0.0)))
        self.reach_z = largest_norm(atoms - (M @ (A @ x0))[:, None])

    def _rows_of_A(self) -> None:
        """Entry (i, j) of A^s is ``rho_i sign(a_ij)`` for one j in each row i."""
        A, x0 = self.A, self.x0
        absolute = np.abs(A)
        rho = absolute.sum(axis=1)
        self.tau = (self.m**2 * rho) @ absolute  # at least tr(M E[.] M^T) for e_j
        self._row_scale = rho * self.m
        random = np.count_nonzero(A, axis=1) >= 2
        self.slope_A = math.sqrt(2.0 * float((self._row_scale[random] ** 2).sum()))
        self.cap_A = self.g0 * self.slope_A / math.sqrt(2.0)
        # |rho_i sign(a_ij) x0_j - (A x0)_i| at most, in every row
        values = rho[:, None] * np.sign(A) * x0
        deviation = np.where(A != 0.0, np.abs(values - (A @ x0)[:, None]), 0.0).max(axis=1)
        self.reach_A = min(
            float(self.m @ deviation), self.M_norm * float(np.linalg.norm(deviation))
        )
        # ||A^s x0^s|| <= g0 max_j (sum of rho_i^2 over the rows with a_ij != 0)^(1/2)
        hit = (A != 0.0)[:, self.hit]
        ball = self.M_norm * self.g0 * math.sqrt(float((rho**2 @ hit).max(initial=0.0)))
        self.D_z = 2.0 * ball
        self.reach_z = ball + float(np.linalg.norm(self.M @ (A @ x0)))

    # -- by size ------------------------------------------------------------------------------

    def mean_square(self, r0: float, rf: float, rA: float) -> float:
        """``E||M (y_hat - y)||^2`` of product fusion."""
        t0, tf, tA, tA0 = self._traces
        return r0 * t0 + rf * tf + rA * tA + r0 * rA * tA0

    def paired_mean_square(self, r0: float, rf: float, rA: float) -> float:
        """The same for diagonal fusion; the rates are equal or 0."""
        # r (C0 + CA + CA0) where both are sampled: the last term does not get r^2
        return self.mean_square(r0, rf, rA) + self._traces[3] * (min(r0, rA) - r0 * rA)

    def covariance(self, r0: float, rf: float, rA: float, *, both: bool) -> Array:
        """``M C M^T`` of one pair or, without what both x0 and A contribute, of its linear part."""
        C0, Cf, CA, CA0 = self.covariances
        total = (r0 > 0.0) * C0 + (rf > 0.0) * Cf + (rA > 0.0) * CA
        if both and r0 > 0.0 and rA > 0.0:
            total = total + CA0
        return np.asarray(total, dtype=np.float64)

    def D_0(self, rA: float) -> float:
        """How far apart two realizations of x0 put the mean, beside an average of ``1/rA`` A^s."""
        pairs, extra = self._pairs_0
        return math.sqrt(float((pairs + rA * extra).max(initial=0.0)))

    def range_A(self, x: Array) -> float:
        """Root of the summed squared ranges of one A^s x: columns ``sum_j x_j^2 D_j^2``."""
        if not self.by_rows:
            return float(np.linalg.norm(x * self.D))
        values = np.where(self.A != 0.0, np.sign(self.A) * x, np.nan)
        random = np.count_nonzero(self.A, axis=1) >= 2
        values = values[random]
        if values.size == 0:
            return 0.0
        spread = np.nanmax(values, axis=1) - np.nanmin(values, axis=1)
        return float(np.linalg.norm(self._row_scale[random] * spread))


def squared_distances(points: Array) -> Array:
    """Squared distances between the columns, (k, k)."""
    if points.shape[1] == 0:
        return np.zeros((0, 0))
    centred = points - points.mean(axis=1, keepdims=True)
    squares = (centred**2).sum(axis=0)
    distances = np.add.outer(squares, squares) - 2.0 * (centred.T @ centred)
    np.fill_diagonal(distances, 0.0)
    return np.asarray(np.maximum(distances, 0.0), dtype=np.float64)


def largest_norm(columns: Array) -> float:
    """Largest 2-norm of a column, 0 without columns."""
    return math.sqrt(float((columns**2).sum(axis=0).max(initial=0.0)))
