"""From a region for ``Theta = [A B c]`` to the error of a trajectory of its centre.

With ``D = Theta - C`` and ``e(k) = x(k) - xh(k)``, xh the trajectory of the centre C,

    e(k+1) = A e(k) + D z(k) + D_x e(k) (+ w(k)),    z = (xh, u, 1),

A the state matrix of C and D_x the first columns of D. What follows holds for all inputs at once,
also for those chosen after the data, in the event that Theta is in the region.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from .. import _core
from .._base.numbers import ROUNDING
from ..exceptions import NonFiniteError
from ..theory.dynamics import matrix_powers, spectral_norms, states

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..identification.region import Region


class SizedNoise(NamedTuple):
    """Noise to come that is not in the region: ``||[w(0) .. w(K-1)]|| <= radius`` after `root`^-1.

    `root` (n, n) is a root of the known covariance.
    """

    radius: float
    root: Floats


class GaussianNoise(NamedTuple):
    """Gaussian noise to come, independent of the data, of covariance at most ``root root'``.

    Given the data, its part ``sum_i A^(k-1-i) w(i)`` of e(k) is Gaussian, A that of the centre.
    `end` is the level of its quantile for the last state, `before` that of each earlier one, and
    again of what the error of the model makes of it.
    """

    root: Floats
    end: float
    before: float


ToCome: TypeAlias = SizedNoise | GaussianNoise


class Errors(NamedTuple):
    """``||x(k) - states[k]|| <= radii[k]``, ``|x(K) - states[K]|_i <= components[i]``.

    With `GaussianNoise` the components are a statement of their own.
    """

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
    ``min(frobenius ||N||_F, spectral ||N||_*) + ||(A^K)_i|| rho0 + spectral sum ||m_j|| b_j`` with
    ``N = sum m_j' c_j'``, ``c_j = V^-1/2 z(j)`` and ``||V^-1/2 (e(j), 0)|| <= b_j``.
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
    root, spectral = root_of(part.S), float(np.sqrt(part.factor))
    frobenius = np.inf if region.frobenius is None else region.frobenius
    if isinstance(to_come, SizedNoise) and K == 1:
        added = to_come.radius
    elif isinstance(to_come, SizedNoise):  # ||[X, W]||^2 <= ||X||^2 + ||W||^2, in both norms
        root, noise = to_come.root, True
        frobenius = float(np.hypot(frobenius, np.sqrt(min(n, K)) * to_come.radius))
        spectral = float(np.hypot(spectral, to_come.radius))
    try:
        at, radii, _, b, _ = _core.several_steps(
            np.ascontiguousarray(region.centre),
            white,
            root,
            missing,
            part.ratio,
            x0,
            u,
            d > n + region.m,
            (spectral, frobenius, rho0, noise),
            (*to_come,) if isinstance(to_come, GaussianNoise) else None,
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
    c = z @ white.T
    c = np.linalg.qr((np.hstack([c, np.eye(K)]) if noise else c).T)[1]
    values = np.linalg.svd(np.einsum("rj,jik->irk", c, M), compute_uv=False)
    whole = _product(np.linalg.norm(values, axis=1), frobenius)
    first = np.minimum(whole, spectral * values.sum(axis=1) * (1.0 + ROUNDING))
    rest = spectral * np.sum(_product(m, b[:K, None]), axis=0)
    components = first + rest + rho0 * np.linalg.norm(powers[K], axis=1)
    if isinstance(to_come, GaussianNoise):
        components += _noisy_components(powers[:K], to_come)
    elif added and to_come is not None:
        radii[-1] += added * float(np.linalg.norm(to_come.root, 2))
        components += added * np.linalg.norm(to_come.root, axis=1)
    return Errors(at, radii, components)


def _by_rows(region: Region, x0: Floats, u: Floats, rho0: float, to_come: ToCome | None) -> Errors:
    """``|D z|_i <= c_i(z)`` and ``|D_x e|_i <= s_i ||e||`` for regions of several parts.

    Unrolled, ``e(k) = A^k e(0) + sum_{j<k} A^(k-1-j) (D z(j) + D_x e(j) + w(j))``, so that by
    induction ``r_k``, the smaller of the norm of

        E_k = |(A^k)_i| rho0 + sum_{j<k} |A^(k-1-j)| (c(z(j)) + s r_j + omega)

    (componentwise) and the same with norms throughout, is a bound of ``||e(k)||``; omega bounds
    noise of known size, the quantile of Gaussian noise is added to r_k.
    """
    n, K = region.n, len(u)
    at = trajectory(region.centre, x0, u)
    c = np.array([region.component_bounds(x, acting) for x, acting in zip(at, u, strict=False)])
    order = np.concatenate([part.rows for part in region.parts])
    s = np.zeros(n)
    s[order] = _spreads(region, slice(n))
    omega, size = np.zeros(n), 0.0
    if isinstance(to_come, SizedNoise):
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
        components = np.minimum(components, r[k])
        if isinstance(to_come, GaussianNoise):
            moved = powers[:k] @ to_come.root  # e(k) has the quantile of its own part of the noise
            covariance = np.ascontiguousarray(np.einsum("pik,pjk->ij", moved, moved))
            level = to_come.end if k == K else to_come.before
            r[k] += _core.normal_quantile(covariance, level)
    if isinstance(to_come, GaussianNoise):
        components += _noisy_components(powers[:K], to_come)
    return Errors(at, r, components)


def _noisy_components(powers: Floats, noise: GaussianNoise) -> Floats:
    """Of ``sum_p A^p w``, at the level `end` for all of them together."""
    deviations = np.linalg.norm(powers @ noise.root, axis=(0, 2))
    times = float(np.sqrt(_core.chi2_upper(noise.end / len(noise.root), 1)))
    return np.asarray(times * deviations)


def _product(a: Floats, b: Floats | float) -> Floats:
    """``a b`` where 0 times infinity is 0: nothing to bound."""
    with np.errstate(invalid="ignore"):
        return np.where((a == 0.0) | (np.asarray(b) == 0.0), 0.0, a * b)


def root_of(S: Floats) -> Floats:
    """A root of S, `root root' = S`."""
    values, vectors = np.linalg.eigh(S)
    return np.ascontiguousarray(vectors * np.sqrt(np.maximum(values, 0.0)))
