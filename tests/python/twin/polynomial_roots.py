"""The laws of the largest roots once more, in polynomials that do not cancel: for 10 to 40 rows.

The law of the largest root with weight w is a Pfaffian of double integrals (de Bruijn 1955)

    A_ij = int int_{0 < x, y < theta} x^(i-1) y^(j-1) sign(y - x) w(x) w(y) dx dy,

for odd p bordered by int x^(i-1) w. In powers of x the rows are nearly dependent, which costs
double precision all its digits at p = 15 to 20. For another basis of polynomials the Pfaffian only
changes by its leading coefficients; in those that are orthonormal for w^2 dx/dt, A is as well
conditioned as integrals of signs are. With x = sin(t)^2 (Roy) or t^2 (Wishart) everything
under the integral is analytic, so that Gauss and Legendre's rule is exact to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from .laws import scipy as _scipy

Array = NDArray[np.float64]

Basis = Callable[[Array], Array]  # t -> values of all p functions phi_i w dx/dt, (.., p)


def roy_cdf(theta: float, p: int, d: int, nu: int) -> float:
    """P(lam / (1 + lam) <= theta) as `quantiles.roy_cdf`: Jacobi polynomials for x^m (1 - x)^k."""
    if p > d:
        p, d, nu = d, p, nu + d - p
    special = _scipy().special
    lg, i, r = special.gammaln, np.arange(p), np.arange(1, p + 1)
    m, k = (d - p - 1) / 2.0, (nu - p - 1) / 2.0
    b, a = d - p, nu - p
    # P_i^(a, b)(2 x - 1): squared norm for x^b (1 - x)^a on [0, 1], and leading coefficient
    norm = lg(i + a + 1.0) + lg(i + b + 1.0) - lg(i + a + b + 1.0) - lg(i + 1.0)
    norm -= np.log(2.0 * i + a + b + 1.0)
    lead = lg(2.0 * i + a + b + 1.0) - lg(i + 1.0) - lg(i + a + b + 1.0)

    def basis(t: Array) -> Array:  # w dx = 2 sin^b cos^a dt
        log_w = special.xlogy(b, np.sin(t)) + special.xlogy(a, np.cos(t)) + np.log(2.0)
        P = special.eval_jacobi(i, a, b, -np.cos(2.0 * t)[..., None])
        return np.asarray(P * np.exp(log_w[..., None] - norm / 2.0))

    C = (p / 2.0) * np.log(np.pi) + np.sum(
        lg((r + 2.0 * m + 2.0 * k + p + 2.0) / 2.0)
        - lg(r / 2.0)
        - lg((r + 2.0 * m + 1.0) / 2.0)
        - lg((r + 2.0 * k + 1.0) / 2.0)
    )
    scale = float(C + np.sum(norm / 2.0 - lead))
    nodes = 40 + 2 * p + int(6.0 * np.sqrt(nu + d))
    return _pfaffian(basis, p, np.array([0.0, np.arcsin(np.sqrt(theta))]), nodes, scale)


def wishart_cdf(x: float, p: int, d: int, *, above: float = 0.0) -> float:
    """P(all p roots of G G' in [above, x]), G (p, d), p <= d: Laguerre polynomials.

    The integrals over another interval give the law of the smallest root, 1 - P(all above).
    """
    if p > d:
        p, d = d, p
    special = _scipy().special
    lg, i, r = special.gammaln, np.arange(p), np.arange(1, p + 1)
    a = d - p
    # L_i^(a)(2 y), y = x / 2: squared norm for y^a exp(-2 y), and leading coefficient
    norm = lg(i + a + 1.0) - lg(i + 1.0) - (a + 1.0) * np.log(2.0)
    lead = i * np.log(2.0) - lg(i + 1.0)

    def basis(t: Array) -> Array:  # w dy = 2 t^a exp(-t^2) dt
        log_w = special.xlogy(a, t) - t * t + np.log(2.0)
        P = special.eval_genlaguerre(i, a, 2.0 * (t * t)[..., None])
        return np.asarray(P * np.exp(log_w[..., None] - norm / 2.0))

    # the constant of `quantiles.wishart_cdf` is for rows divided by Gamma((d - p - 1) / 2 + i)
    C = (p / 2.0) * np.log(np.pi) - np.sum(lg((d - r + 1) / 2.0) + lg(r / 2.0))
    scale = float(C + np.sum(norm / 2.0 - lead))
    nodes = 40 + 2 * p + int(6.0 * np.sqrt(d))
    end = min(np.sqrt(x), np.sqrt(p) + np.sqrt(d) + 9.0)  # beyond: less than 1e-17
    return _pfaffian(basis, p, np.sqrt([above / 2.0, end * end / 2.0]), nodes, scale)


def _pfaffian(basis: Basis, p: int, ends: Array, nodes: int, log_scale: float) -> float:
    """exp(log_scale) Pf(A), A_ij = int (f_j int^y f_i - f_i int^y f_j) dy between the ends."""
    x, weight, integral = _rule(nodes)
    half_width = (ends[1] - ends[0]) / 2.0
    f = basis(ends[0] + half_width * (x + 1.0)) * half_width
    half = (integral @ f).T @ (weight[:, None] * f)
    A = np.zeros((p + p % 2, p + p % 2))
    A[:p, :p] = half - half.T
    if p % 2:
        A[:p, p], A[p, :p] = weight @ f, -(weight @ f)
    sign, log = np.linalg.slogdet(A)
    return float(np.exp(log_scale + 0.5 * log)) if sign > 0 else 0.0


@cache
def _rule(nodes: int) -> tuple[Array, Array, Array]:
    """Nodes and weights on [-1, 1], and the matrix that takes values to integrals from -1.

    Those of the interpolating polynomial: from -1 to x, value q counts
    weight_q / 2 (1 + x + sum_{l >= 1} P_l(x_q) (P_{l+1}(x) - P_{l-1}(x))).
    """
    x, weight = np.polynomial.legendre.leggauss(nodes)
    P = np.polynomial.legendre.legvander(x, nodes)
    steps = np.column_stack([1.0 + x, P[:, 2:] - P[:, :-2]])
    return x, weight, np.asarray(steps @ P[:, :-1].T * weight / 2.0)
