"""Formulas for the covariances of realizations and of their averages, on checked arrays.

The notation is that of :mod:`stochens_rs.theory.moments`.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._base import validation
from .._base.types import AXES, FUSIONS, SCHEMES, Floats
from ..exceptions import InputError, NonFiniteError, ShapeError
from ..system.system import System
from .exact import checked_ends, factors

Size: TypeAlias = "int | float | None"
Sizes: TypeAlias = "Size | tuple[Size, Size, Size]"
Finite = TypeVar("Finite", float, Floats)


def sum_of_others(lines: Floats) -> Floats:
    """``sum_{k != i} |W_kj|``, which is ``g_j - |W_ij|`` without the subtraction."""
    absolute = np.abs(lines)
    before = np.zeros_like(absolute)
    after = np.zeros_like(absolute)
    np.cumsum(absolute[:-1], axis=0, out=before[1:])
    after[:-1] = np.cumsum(absolute[:0:-1], axis=0)[::-1]
    return before + after


def realization_covariance(w: Floats) -> Floats:
    """``Cv(w)`` for one realization."""
    return column_excess(w[:, None], np.ones(1))


def column_excess(A: Floats, d: Floats) -> Floats:
    """``T_A(d)``: off the diagonal ``-A diag(d) A^T``, on it ``Phi d``."""
    T: Floats = 0.0 - (A * d) @ A.T  # "0.0 -" rather than "-": zeros stay +0.0
    np.fill_diagonal(T, (np.abs(A) * sum_of_others(A)) @ d)
    return T


def _centred(values: Floats, weights: Floats) -> Floats:
    """Subtract from every row of values its weighted mean.

    The value with the largest weight is subtracted first, and is then exactly 0, so that the
    squares ``g sum_j w_j (v_j - mean)^2 = sum_{j<k} w_j w_k (v_j - v_k)^2`` keep their relative
    accuracy.
    """
    heaviest = weights.argmax(axis=1, keepdims=True)
    y = values - np.take_along_axis(values, heaviest, axis=1)
    total = weights.sum(axis=1, keepdims=True)
    mean = (weights * y).sum(axis=1, keepdims=True) / np.where(total > 0.0, total, 1.0)
    return np.asarray(y - mean, dtype=np.float64)


def pushed_covariance(F: Floats, w: Floats) -> Floats:
    """``F Cv(w) F^T = g sum_i |w_i| y_i y_i^T``, ``y_i = sign(w_i) F e_i`` minus its mean."""
    absolute = np.abs(w)
    Y = _centred(F * np.sign(w), np.broadcast_to(absolute, F.shape))
    return np.asarray(absolute.sum() * ((Y * absolute) @ Y.T), dtype=np.float64)


def matrix_excess(A: Floats, M: Floats, axis: str) -> Floats:
    """``E[A^s M A^sT] - A M A^T``."""
    diagonal = np.diagonal(M)
    if axis == "columns":
        return column_excess(A, diagonal)
    # Rows are independent of each other: only the diagonal entries differ. They are
    # sum_j |a_ij| (rho_i - |a_ij|) M_jj - sum_{j != k} a_ij a_ik M_jk.
    apart = M - np.diag(diagonal)
    return np.diag((np.abs(A) * sum_of_others(A.T).T) @ diagonal - ((A @ apart) * A).sum(axis=1))


def vector_excess(A: Floats, x: Floats, axis: str) -> Floats:
    """``Cov(A^s x)``, which is `matrix_excess` for ``M = x x^T``."""
    if axis == "columns":
        return column_excess(A, x * x)
    # sum_{j<k} |a_ij| |a_ik| (s_ij x_j - s_ik x_k)^2
    weights = np.abs(A)
    squares = (weights * _centred(np.sign(A) * x, weights) ** 2).sum(axis=1)
    return np.diag(weights.sum(axis=1) * squares)


def whole_numbers(values: Floats) -> NDArray[Any]:
    """Integers W of any size with ``|values| = W 2^e`` exactly, e constant along the last axis."""
    mantissas, exponents = np.frexp(np.abs(values))
    least = exponents.min(axis=-1, keepdims=True, where=values != 0.0, initial=2000)
    shifts = np.where(values == 0.0, 0, exponents - least)
    return np.asarray(np.ldexp(mantissas, 53).astype(np.int64).astype(object) << shifts)


def fractional_parts(N: float, parts: NDArray[Any], whole: NDArray[Any]) -> tuple[Floats, Floats]:
    """``f = frac(N parts / whole)`` and ``1 - f`` of integers, each correct to its last digit."""
    remainders = int(N) * parts % whole
    f, rest = remainders / whole, (whole - remainders) / whole
    return f.astype(np.float64), rest.astype(np.float64)


def systematic_vector_covariance(w: Floats, N: float) -> Floats:
    """Covariance of the average of N systematic samples of a vector; N = 0: known exactly."""
    if N == 0.0 or not w.any():
        return np.zeros((w.size, w.size))
    W = whole_numbers(w)
    # f_i = frac(N |w_i| / g), phi_i = frac(N (p_1 + ... + p_i)), psi = 1 - phi
    f, f_rest = fractional_parts(N, W, W.sum())
    phi, psi = fractional_parts(N, np.cumsum(W), W.sum())
    both = np.minimum.outer(phi, phi) * np.minimum.outer(psi, psi)  # Cov(b_i, b_k)
    counts = np.diff(np.diff(both, axis=0, prepend=0.0), axis=1, prepend=0.0)
    # |Cov(N_i, N_k)| <= sd(N_i) sd(N_k), also where the differences are rounding: 0 where N p_i is
    # an integer
    sd = np.sqrt(f * f_rest)
    most = np.outer(sd, sd)
    counts = np.clip(counts, -most, most)
    np.fill_diagonal(counts, f * f_rest)
    # scaled by a power of two, hence exactly, so that g^2 does not overflow
    exponent = np.frexp(np.abs(w).max())[1]
    scale = float(np.ldexp(np.abs(w), -exponent).sum()) / N
    covariance = scale * scale * counts * np.outer(np.sign(w), np.sign(w))
    return np.asarray(np.ldexp(covariance, 2 * exponent), dtype=np.float64)


def _systematic_excess(A: Floats, C0: Floats, x: Floats, N: float, axis: str) -> Floats:
    """``E[A_hat M A_hat^T] - A M A^T``, ``M = C0 + x x^T``, for N systematic samples."""
    if axis == "columns":  # sum_j M_jj Cov(a_hat_j)
        excess = np.zeros((A.shape[0], A.shape[0]))
        for weight, line in zip(C0.diagonal() + x * x, A.T, strict=True):
            excess += weight * systematic_vector_covariance(line, N)
        return excess
    diagonal = np.empty(len(A))
    signs = np.sign(A)
    moved = signs * _centred(signs * x, np.abs(A))  # the covariance of a line times its signs is 0
    for i, line in enumerate(A):
        covariance = systematic_vector_covariance(line, N)
        diagonal[i] = (covariance * C0).sum() + moved[i] @ covariance @ moved[i]
    return np.diag(diagonal)


def fused_product_covariance(A: Floats, x0: Floats, r0: float, rA: float, axis: str) -> Floats:
    """``Cov(A_hat x0_hat)`` for ``1/r0`` realizations of ``x0`` and ``1/rA`` of ``A``."""
    Cv = realization_covariance(x0)
    from_both = r0 * rA * matrix_excess(A, Cv, axis)
    from_A = rA * vector_excess(A, x0, axis)
    covariance: Floats = r0 * pushed_covariance(A, x0) + from_A + from_both
    return covariance


def _systematic_difference(
    A: Floats, x0: Floats, xf: Floats, sizes: tuple[object, object, object], axis: str
) -> Floats:
    """Covariance of ``xf_hat - A_hat x0_hat`` for independent averages of systematic samples."""
    N0, Nf, NA = (count(f"size[{k}]", N) for k, N in enumerate(sizes))
    C, C0 = systematic_vector_covariance(xf, Nf), systematic_vector_covariance(x0, N0)
    # Given x0_hat, A_hat x0_hat has the covariance of A_hat at x0_hat; E[x0_hat x0_hat^T] = M.
    if NA:
        C = C + _systematic_excess(A, C0, x0, NA, axis)
    return np.asarray(C + A @ C0 @ A.T, dtype=np.float64)


def fused_covariance(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    size: Sizes,
    fusion: str,
    axis: str,
    scheme: str,
) -> tuple[Floats, Floats]:
    """``B`` and the covariance of ``xf_hat - A_hat x0_hat`` (diagonal: of the average pair)."""
    checked, x0, xf = checked_ends(system, x0, xf)
    A, B = checked.A, checked.B
    validation.choice("axis", axis, AXES)
    sizes = one_each(size)
    r0, rf, rA = (inverse_size(f"size[{k}]", N) for k, N in enumerate(sizes))
    product = validation.choice("fusion", fusion, FUSIONS) == "product"
    if validation.choice("scheme", scheme, SCHEMES) == "systematic":
        if not product:
            raise InputError(
                "`fusion` must be 'product' with scheme='systematic', got 'diagonal': there is no "
                "formula for pairs of dependent realizations"
            )
        return B, _systematic_difference(A, x0, xf, sizes, axis)
    if product:
        return B, rf * realization_covariance(xf) + fused_product_covariance(A, x0, r0, rA, axis)
    # N independent pairs: the covariance of one pair over N; exact entities stay exact.
    sampled = {r for r in (r0, rf, rA) if r > 0.0}
    if len(sampled) > 1:
        raise InputError(
            "`size` must be one number with fusion='diagonal', which pairs the realizations, "
            f"got N0, Nf, NA = {', '.join(validation.show(N) for N in sizes)}"
        )
    one0, onef, oneA = (float(r > 0.0) for r in (r0, rf, rA))
    one_pair = onef * realization_covariance(xf) + fused_product_covariance(A, x0, one0, oneA, axis)
    return B, max(sampled, default=0.0) * one_pair


def lines_of(A: Floats, axis: str) -> Floats:
    """``A`` with the sampled lines as columns."""
    return A if validation.choice("axis", axis, AXES) == "columns" else A.T


def count(name: str, size: object) -> float:
    """Check a size; 0 for an entity that is known exactly (None or inf)."""
    if size is None or (isinstance(size, (float, np.floating)) and size == math.inf):
        return 0.0
    return float(validation.size(name, size))


def inverse_size(name: str, size: object) -> float:
    """``1 / size``; 0 for an entity that is known exactly."""
    N = count(name, size)
    return 1.0 / N if N else 0.0


def one_each(size: object) -> tuple[object, object, object]:
    """``(N0, Nf, NA)``."""
    if not isinstance(size, (tuple, list)):
        inverse_size("size", size)  # so that an error names `size`, not `size[0]`
        return size, size, size
    if len(size) != 3:
        raise ShapeError(f"`size` must be one number or (N0, Nf, NA), got {len(size)} numbers")
    N0, Nf, NA = size
    return N0, Nf, NA


def compact_svd(B: Floats) -> tuple[Floats, Floats, Floats]:
    """``B = U diag(s) V^T`` with the numerical rank as inner size, so ``B+ = V diag(1/s) U^T``."""
    found = factors(B)
    return found.U, found.s, found.V


def symmetric_product(F: Floats, C: Floats) -> Floats:
    """``F C F^T``, exactly symmetric."""
    product = F @ C @ F.T
    return checked_finite(np.asarray((product + product.T) / 2.0, dtype=np.float64))


def checked_finite(values: Finite, what: str = "covariance") -> Finite:
    """Refuse values that overflowed."""
    if not np.isfinite(values).all():
        raise NonFiniteError(f"the {what} overflows: scale the problem down")
    return values


def root_trace(C: Floats) -> float:
    """``sqrt(tr C)``; a trace that rounding makes negative counts as 0."""
    with np.errstate(over="ignore"):
        trace = checked_finite(np.trace(C), "mean squared error")
    return math.sqrt(max(0.0, float(trace)))
