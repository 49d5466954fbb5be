"""Moments, atoms and diameters of a control problem under a linear map, for all its bounds.

The error of a fused control is ``u - v* = M (y_hat - y)`` with ``y = xf - A x0``; that of the
state it leads to has the same form. In an orthonormal basis of the rows of ``B^+``:

- state: ``M = U^T``, as ``||B (u - v*)|| = ||U U^T (y_hat - y)||``;
- control: ``M = diag(1/s) U^T``, for ``B = U diag(s) V^T``.
"""

from __future__ import annotations

import math

import numpy as np

from ..._base import memory
from ..._base.types import Axis, Floats
from ...exceptions import NonFiniteError
from ...system import System
from ..formulas import (
    compact_svd,
    matrix_excess,
    pushed_covariance,
    realization_covariance,
    vector_excess,
)
from .base import unit_of


class Geometry:
    """Numbers of ``M (y_hat - y)`` for the bounds, in units in which nothing overflows."""

    def __init__(self, system: System, x0: Floats, xf: Floats, axis: Axis, quantity: str) -> None:
        # some 50 arrays of the size of A live at once in the methods below
        memory.need("the moments of the control", 50 * system.A.nbytes)
        self.by_rows, self.quantity, self.norm = axis == "rows", quantity, "2"
        self._scale(system.B, x0, xf, system.A)
        self._set_ranges()
        self._set_moments()

    def _scale(self, B: Floats, x0: Floats, xf: Floats, A: Floats) -> None:
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
        U, s, _ = compact_svd(B / unit_B)
        self.M = np.ascontiguousarray(U.T if self.quantity == "state" else (U / s).T)
        self.M_norm = (
            0.0 if s.size == 0 else 1.0 if self.quantity == "state" else 1.0 / float(s[-1])
        )

    def _set_moments(self) -> None:
        """Covariances of ``M`` times ``A x0^s``, ``xf^s``, ``A^s x0``, ``(A^s - A)(x0^s - x0)``."""
        axis = "rows" if self.by_rows else "columns"
        M, A, x0 = self.M, self.A, self.x0
        Cv = realization_covariance(x0)
        of_x0, of_xf = pushed_covariance(self.MA, x0), pushed_covariance(M, self.xf)
        of_A, of_both = vector_excess(A, x0, axis), matrix_excess(A, Cv, axis)
        self.covariances = (of_x0, of_xf, M @ of_A @ M.T, M @ of_both @ M.T)
        if self.by_rows:  # diagonal matrices
            from_A = self.m**2 @ of_A.diagonal(), self.m**2 @ of_both.diagonal()
        else:
            from_A = self.tau @ (x0 * x0), self.tau @ Cv.diagonal()
        traces = np.trace(of_x0), np.trace(of_xf), *from_A
        self.traces = tuple(max(0.0, float(trace)) for trace in traces)

    def _set_ranges(self) -> None:
        M, A, x0 = self.M, self.A, self.x0
        self.MA = M @ A
        self.m = np.linalg.norm(M, axis=0)  # ||M e_i||
        self.g0, self.gf = float(abs(x0).sum()), float(abs(self.xf).sum())
        self.hit = np.flatnonzero(x0)
        # atoms of M xf^s and of M A x0^s, one per column
        self.atoms_f = self.gf * np.sign(self.xf[self.xf != 0.0]) * M[:, self.xf != 0.0]
        self.atoms_0 = self.g0 * np.sign(x0[self.hit]) * self.MA[:, self.hit]
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
        # sum_k |a_kj| ||M (s_i e_i - s_k e_k)||^2 for the atom i of column j, s the signs of a_j
        up, down = np.maximum(A, 0.0), np.maximum(-A, 0.0)
        alike, unlike = pair_distances(M, 1.0), pair_distances(M, -1.0)
        apart = np.where(A > 0.0, alike @ up + unlike @ down, unlike @ up + alike @ down)
        # tau_j = tr(M Cv(a_j) M^T)
        self.tau = (absolute * apart).sum(axis=0) / 2.0
        # diameter of the atoms: two of them are at most sqrt(2) g ||M|| and g (m_1 + m_2) apart
        norms = np.where(present, self.m[:, None], 0.0)
        two = np.partition(norms, -2, axis=0)[-2:].sum(axis=0) if len(A) > 1 else 0.0 * g
        random = np.count_nonzero(A, axis=0) >= 2
        self.D = np.where(random, g * np.minimum(math.sqrt(2.0) * self.M_norm, two), 0.0)
        self.cap_A = self.g0 * float(self.D[self.hit].max(initial=0.0))
        self.slope_A = float(self.D[self.hit].max(initial=0.0))
        # ||M (atom - a_j)||^2 = g_j apart_ij - tau_j; the largest is at least tau_j
        farthest = np.sqrt(np.where(present, g * apart - self.tau, 0.0).max(axis=0, initial=0.0))
        self.reach_A = float(np.abs(x0) @ np.where(random, farthest, 0.0))
        # atoms of A^s x0^s: at each i the ends, and 0 where x0 meets a zero column
        moved = np.sign(A) * np.sign(x0) * self.g0 * g
        met = present & (x0 != 0.0)
        i = np.flatnonzero(met.any(axis=1))
        low = np.where(met, moved, math.inf).min(axis=1)[i]
        high = np.where(met, moved, -math.inf).max(axis=1)[i]
        zero = np.zeros((len(M), int(((g == 0.0) & (x0 != 0.0)).any())))
        atoms = np.hstack([M[:, i] * low, M[:, i] * high, zero])
        self.reach_z = largest_norm(atoms - (self.MA @ x0)[:, None])

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
        # entry i of A^s x0^s, where x0^s hits j: at most this far from (A x0)_i
        hits = np.abs(self.g0 * rho[:, None] * np.sign(A) * np.sign(x0) - (A @ x0)[:, None])
        misses = np.where(random, np.abs(A @ x0), 0.0)
        away = np.maximum(hits, misses[:, None])[:, self.hit]
        far = np.minimum(self.m @ away, self.M_norm * np.linalg.norm(away, axis=0))
        self.reach_z = float(far.max(initial=0.0))

    # -- by size ------------------------------------------------------------------------------

    def mean_square(self, r0: float, rf: float, rA: float) -> float:
        """``E||M (y_hat - y)||^2`` of product fusion."""
        t0, tf, tA, tA0 = self.traces
        return r0 * t0 + rf * tf + rA * tA + r0 * rA * tA0

    def paired_mean_square(self, r0: float, rf: float, rA: float) -> float:
        """The same for diagonal fusion; the rates are equal or 0."""
        # r (C0 + CA + CA0) where both are sampled: the last term does not get r^2
        return self.mean_square(r0, rf, rA) + self.traces[3] * (min(r0, rA) - r0 * rA)

    def covariance(self, r0: float, rf: float, rA: float, *, both: bool) -> Floats:
        """``M C M^T`` of one pair; both=False: without the product of the errors of x0 and A."""
        C0, Cf, CA, CA0 = self.covariances
        total = (r0 > 0.0) * C0 + (rf > 0.0) * Cf + (rA > 0.0) * CA
        if both and r0 > 0.0 and rA > 0.0:
            total = total + CA0
        return np.asarray(total, dtype=np.float64)

    def D_0(self, rA: float) -> float:
        """The largest ``sqrt(||M A d||^2 + E||M (A_hat - A) d||^2)``, d of two atoms of x0."""
        pairs, extra = self._pairs_0
        return math.sqrt(float((pairs + rA * extra).max(initial=0.0)))

    def range_A(self, x: Floats) -> float:
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


def pair_distances(M: Floats, sign: float) -> Floats:
    """``||M (e_i - sign e_k)||^2``, (n, n)."""
    squares = (M**2).sum(axis=0)
    total = np.add.outer(squares, squares)
    distances = total - 2.0 * sign * (M.T @ M)
    for i, column in enumerate(M.T):  # once more where most of it cancels
        k = np.flatnonzero(distances[i] < 0.1 * total[i])
        distances[i, k] = ((column[:, None] - sign * M[:, k]) ** 2).sum(axis=0)
    return np.asarray(distances, dtype=np.float64)


def squared_distances(points: Floats) -> Floats:
    """Squared distances between the columns, (k, k)."""
    if points.shape[1] == 0:
        return np.zeros((0, 0))
    centred = points - points.mean(axis=1, keepdims=True)
    squares = (centred**2).sum(axis=0)
    distances = np.add.outer(squares, squares) - 2.0 * (centred.T @ centred)
    np.fill_diagonal(distances, 0.0)
    return np.asarray(np.maximum(distances, 0.0), dtype=np.float64)


def largest_norm(columns: Floats) -> float:
    """Largest 2-norm of a column, 0 without columns."""
    return math.sqrt(float((columns**2).sum(axis=0).max(initial=0.0)))
