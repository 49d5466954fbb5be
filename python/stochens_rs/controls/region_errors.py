"""From a region for ``Theta = [A B c]`` to the error of a trajectory of its centre.

With ``D = Theta - C`` and ``e(k) = x(k) - xh(k)``, xh the trajectory of the centre C,

    e(k+1) = A e(k) + D z(k) + D_x e(k) (+ w(k)),    z = (xh, u, 1),

A the state matrix of C and D_x the first columns of D. What follows holds for all inputs at once,
also for those chosen after the data, in the event that Theta is in the region.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .. import _core
from ..exceptions import NonFiniteError
from ..theory.dynamics import matrix_powers, spectral_norms, states

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..identification.region import Region


class ToCome(NamedTuple):
    """Noise to come that is not in the region: ``||[w(0) .. w(K-1)]|| <= radius`` after `root`^-1.

    `root` (n, n) is a root of the known covariance.
    """

    radius: float
    root: Floats


class Errors(NamedTuple):
    """``||x(k) - states[k]|| <= radii[k]``, ``|x(K) - states[K]|_i <= components[i]``."""

    states: Floats
    radii: Floats
    components: Floats


@np.errstate(over="ignore")
def region_errors(
    region: Region, x0: Floats, u: Floats, *, rho0: float, to_come: ToCome | None = None
) -> Errors:
    """The errors under the inputs `u` (K, m) from an x0 known up to `rho0`.

    They include the noise that the region covers (``region.future``), or that of `to_come`. Where a
    square overflows they are infinite.
    """
    if len(region.parts) == 1:
        return _one_part(region, x0, u, rho0, to_come)
    return _by_rows(region, x0, u, rho0, to_come)


def trajectory(Theta: Floats, x0: Floats, u: Floats) -> Floats:
    """The states (K + 1, n) of ``x(k+1) = Theta (x(k), u(k), 1)``."""
    n = len(Theta)
    ones = np.ones((len(u), Theta.shape[1] - n - u.shape[1]))
    return states(Theta[:, :n], Theta[:, n:], x0, np.hstack([u, ones]))


def spread(region: Region, columns: slice) -> float:
    """``||D v||`` is at most this for all ``||v|| = 1`` in these columns: ``rho ||white||``."""
    return float(np.linalg.norm(_spreads(region, columns, rows=False)))


def _spreads(region: Region, columns: slice, *, rows: bool = True) -> Floats:
    """The same for each row of D, or for each part."""
    d = region.centre.shape[1]
    chosen = np.arange(d)[columns]
    found = []
    for part in region.parts:
        inside = np.isin(part.columns, chosen)
        seen = all(np.isfinite(part.length(e)) for e in np.eye(d)[part.columns[inside]])
        size = float(np.linalg.norm(part.white[:, inside], 2)) if inside.any() else 0.0
        scales = part.deviations if rows else np.array([part.radius])
        found.append(_product(scales, size if seen else np.inf))
    return np.concatenate(found)


def _one_part(region: Region, x0: Floats, u: Floats, rho0: float, to_come: ToCome | None) -> Errors:
    """``D = S^1/2 Gamma V^-1/2`` with bounds of both norms of Gamma: see the core.

    Components, by the same expansion with a row m_j of ``A^(K-1-j) S^1/2`` in place of the matrix:
    ``min(frobenius ||sum m_j c_j'||_F, spectral sum ||m_j|| ||c_j||) + ||(A^K)_i|| rho0 + spectral
    sum ||m_j|| b_j`` with ``c_j = V^-1/2 z(j)`` and ``||V^-1/2 (e(j), 0)|| <= b_j``.
    """
    part = region.parts[0]
    (n, d), K = region.centre.shape, len(u)
    rank, off = len(part.white), part.missing.shape[1]
    white, missing = np.zeros((rank, d)), np.zeros((d, d - rank))
    white[:, part.columns] = part.white
    if off <= d - rank:
        missing[part.columns, :off] = part.missing
    elif not np.isfinite(part.length(np.concatenate([x0, u[0], np.ones(d - n - region.m)]))):
        # a region for one step from a fixed x0 knows nothing off that span
        at = trajectory(region.centre, x0, u)
        return Errors(at, np.array([rho0, np.inf]), np.full(n, np.inf))
    noise, added = region.future > 0, 0.0
    S, spectral = part.S, float(np.sqrt(part.factor))
    columns = rank + (K if noise else 0)
    frobenius = region.frobenius
    if frobenius is None:
        frobenius = np.inf if K == 1 else spectral * float(np.sqrt(min(n, columns)))
    if to_come is None:
        root = root_of(S)
    elif K == 1:
        root, added = root_of(S), to_come.radius
    else:  # ||[X, W]||^2 <= ||X||^2 + ||W||^2, in both norms
        root, noise = to_come.root, True
        frobenius = float(np.hypot(frobenius, np.sqrt(min(n, K)) * to_come.radius))
        spectral = float(np.hypot(spectral, to_come.radius))
    try:
        at, radii, _, b, sizes = _core.several_steps(
            np.ascontiguousarray(region.centre),
            white,
            root,
            missing,
            part.ratio,
            x0,
            u,
            d > n + region.m,
            (spectral, frobenius, rho0, noise),
        )
    except NonFiniteError:  # a square overflows
        at = trajectory(region.centre, x0, u)
        return Errors(at, np.array([rho0, *np.full(K, np.inf)]), np.full(n, np.inf))
    if not np.isfinite(radii[-1]):
        return Errors(at, radii, np.full(n, np.inf))
    powers = matrix_powers(region.centre[:, :n], K)
    M = powers[:K][::-1] @ root
    m = np.linalg.norm(M, axis=2)
    z = np.hstack([at[:-1], u, np.ones((K, d - n - region.m))])
    squares = np.einsum("jr,jik->irk", z @ white.T, M).reshape(n, -1)
    whole = np.sum(squares**2, axis=1) + (np.sum(m**2, axis=0) if noise else 0.0)
    crude = spectral * ((np.hypot(1.0, sizes) if noise else sizes) @ m)
    first = crude if np.isinf(frobenius) else np.minimum(_product(np.sqrt(whole), frobenius), crude)
    rest = spectral * np.sum(_product(m, b[:K, None]), axis=0)
    components = first + rest + rho0 * np.linalg.norm(powers[K], axis=1)
    if added and to_come is not None:
        radii[-1] += added * float(np.linalg.norm(to_come.root, 2))
        components += added * np.linalg.norm(to_come.root, axis=1)
    return Errors(at, radii, components)


def _by_rows(region: Region, x0: Floats, u: Floats, rho0: float, to_come: ToCome | None) -> Errors:
    """``|D z|_i <= c_i(z)`` and ``|D_x e|_i <= s_i ||e||`` for regions of several parts.

    Unrolled, ``e(k) = A^k e(0) + sum_{j<k} A^(k-1-j) (D z(j) + D_x e(j) + w(j))``, so that by
    induction ``r_k``, the smaller of the norm of

        E_k = |(A^k)_i| rho0 + sum_{j<k} |A^(k-1-j)| (c(z(j)) + s r_j + omega)

    (componentwise) and the same with norms throughout, is a bound of ``||e(k)||``.
    """
    n, K = region.n, len(u)
    at = trajectory(region.centre, x0, u)
    c = np.array([region.component_bounds(x, acting) for x, acting in zip(at, u, strict=False)])
    order = np.concatenate([part.rows for part in region.parts])
    s = np.zeros(n)
    s[order] = _spreads(region, slice(n))
    omega, size = np.zeros(n), 0.0
    if to_come is not None:
        omega = to_come.radius * np.linalg.norm(to_come.root, axis=1)
        size = to_come.radius * float(np.linalg.norm(to_come.root, 2))
    powers = matrix_powers(region.centre[:, :n], K)
    norms = spectral_norms(powers)
    r, components = np.full(K + 1, rho0), np.zeros(n)
    for k in range(1, K + 1):
        back = slice(k - 1, None, -1)
        pushed = c[:k] + _product(r[:k, None], s) + omega
        terms = _product(np.abs(powers[back]), pushed[:, None, :])
        components = terms.sum(axis=(0, 2)) + rho0 * np.linalg.norm(powers[k], axis=1)
        pushes = np.linalg.norm(c[:k], axis=1) + _product(r[:k], float(np.linalg.norm(s))) + size
        whole = norms[k] * rho0 + float(np.sum(_product(norms[back], pushes)))
        r[k] = min(float(np.linalg.norm(components)), whole)
    return Errors(at, r, np.minimum(components, r[-1]))


def _product(a: Floats, b: Floats | float) -> Floats:
    """``a b`` where 0 times infinity is 0: nothing to bound."""
    with np.errstate(invalid="ignore"):
        return np.where((a == 0.0) | (np.asarray(b) == 0.0), 0.0, a * b)


def root_of(S: Floats) -> Floats:
    """A root of S, `root root' = S`."""
    values, vectors = np.linalg.eigh(S)
    return np.ascontiguousarray(vectors * np.sqrt(np.maximum(values, 0.0)))
