"""Confidence radii of running means that hold for all numbers of realizations at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base.records import trusted
from .._base.threads import interruptible
from ..certificates.certificate import Certificate
from ..certificates.radius import Radius
from ..exceptions import InputError
from ..theory.exact import EPS
from .state import ENTITIES

if TYPE_CHECKING:
    from collections.abc import Mapping


# Share of delta for the bound on the mean; the bound on the variance has the rest. About the best
# choice for N > 100.
_SHARE = 0.75
_SUM = "the sum of the errors of the means"


def radii_of_means(
    core: _core.DataStream, ranges: Mapping[str, float], sizes: Mapping[str, int], delta: float
) -> Certificate:
    """Return the radii of the running means and of the state (see `DataStream.confidence`)."""
    counts, deviations, spreads, _ = core.statistics()
    apart, rounding = core.evidence()
    uncertain = sum(ranges.get(name, np.inf) > 0.0 for name in ENTITIES)
    radii, methods = [], []
    for k, name in enumerate(ENTITIES):
        given, size = ranges.get(name), sizes.get(name)
        if given is not None and apart[k] > given:
            raise InputError(
                f"`ranges['{name}']` must bound the distance of any two realizations: there "
                f"are two at least {apart[k]:.6g} apart, got {given:.6g}"
            )
        observed = 2.0 * spreads[k] if counts[k] > 1 else np.inf
        diameter = observed if given is None else given
        radius = mean_radius(counts[k], deviations[k], diameter, delta / max(uncertain, 1), size)
        methods.append(_bound(radius, diameter, given, size))
        radii.append(radius + 2.0 * rounding[k])  # rounding of the mean and of the deviation
    x0, _, A = core.estimates()
    r0, rf, rA = radii
    norm = interruptible(lambda: float(np.linalg.norm(A, 2)))
    # r_f + (||FA|| + r_A) r_0 + r_A ||F0||, where inf * 0 counts as 0
    parts = [(norm + rA, r0), (rA, float(np.linalg.norm(x0)))]
    state = rf + sum(a * b if a != 0.0 and b != 0.0 else 0.0 for a, b in parts)
    # the control in doubles, and rounding of norms and sums
    state += core.control()[1] + len(x0) * 4.0 * EPS * state
    if np.isnan(state):
        state = np.inf
    single = [name for name, r in zip(ENTITIES, radii, strict=True) if not np.isfinite(r)]
    reason = "the radius of the state overflows"
    if single:
        reason = f"only one realization of {', '.join(single)}, and `ranges` does not bound it"
    said = [("state", state, "where the control from the exact means leads", _SUM)]
    means = (f"the mean of the law of {name}" for name in ENTITIES)
    said += zip(ENTITIES, radii, means, methods, strict=True)
    return trusted(
        Certificate,
        kind="guaranteed" if len(ranges) == len(ENTITIES) else "estimated",
        delta=delta,
        quantities={
            name: trusted(
                Radius, radius, mean, 1.0 - delta, method, None if radius < np.inf else reason
            )
            for name, radius, mean, method in said
        },
        covers="all together, at all numbers of realizations at once",
        assumption="realizations of each entity independent, of one law, within its range; a bias "
        "of the realizations is not covered",
    )


def mean_radius(
    count: int, deviation: float, diameter: float, delta: float, size: int | None = None
) -> float:
    """Bound ``||mean - mu||`` for all numbers N of realizations at once.

    `deviation` is ``D = sqrt(sum_i ||E_i - mean||^2)``; `diameter` is R with ``||E - E'|| <= R``.
    The bound is tightest at N = `size`, which must not depend on the data. Without `size` it is
    nearly as tight at every N.

    *Mean.* With ``S_n = sum_i (E_i - mu)``, ``||E_i - mu|| <= R`` and ``V = E ||E - mu||^2``,
    ``cosh(lam ||S_n||) exp(-n V psi(lam))`` is a supermartingale in any Hilbert space,
    ``psi(lam) = lam^2 / (2 (1 - lam R / 3))`` (Pinelis 1994, proof of theorem 3.2 with D = 1, and
    ``e^x - 1 - x <= x^2 / (2 (1 - x / 3))``). As cosh(x) >= e^x / 2, Ville's inequality gives
    ``||S_n|| < (l + n V psi(lam)) / lam`` for all n, except with probability ``2 e^-l``. With
    ``1 / lam = R / 3 + sqrt(m V / (2 l))`` that is ``||S_n|| < R l / 3 + w sqrt(2 l V n)``,
    ``w = (sqrt(n / m) + sqrt(m / n)) / 2``: at n = m Bernstein's inequality for one size.

    *Variance.* ``Q_n = sum_i ||E_i - mu||^2`` has terms Y in [0, R^2] with ``E Y^2 <= R^2 V``,
    so ``E exp(-lam Y) <= exp(-lam V + lam^2 R^2 V / 2)``, and by Ville's inequality with
    ``lam = sqrt(2 l / (m V R^2))``: ``V - Q_n / n < 2 beta sqrt(V)`` for all n, except with
    probability ``e^-l``, with ``beta = w R sqrt(l / (2 n))``. And
    ``Q_n / n = D^2 / n + ||S_n / n||^2``.

    *Both.* ``sigma = sqrt(V)`` and ``x = ||S_n / n||`` satisfy ``x <= alpha + gamma sigma`` and
    ``sigma^2 - 2 beta sigma <= D^2 / n + x^2``; the largest such sigma solves a quadratic
    equation. Also, ``2 V = E ||E - E'||^2 <= R^2``.

    *All sizes.* Epoch k = 1, 2, ... is ``4^k <= n < 4^(k+1)``; it has m = 2 4^k, so w < 1.07, and
    ``delta / (k (k + 1))``, in total delta.
    """
    if count < 2 or diameter == 0.0:
        return diameter if count > 0 else float("inf")
    if size is None:
        k = (count.bit_length() - 1) // 2
        if k == 0:
            return diameter
        size, delta = 2 * 4**k, delta / (k * (k + 1))
    n = float(count)
    w = (np.sqrt(n / size) + np.sqrt(size / n)) / 2.0
    log_mean, log_variance = np.log(2.0 / (_SHARE * delta)), -np.log((1.0 - _SHARE) * delta)
    # x <= alpha + gamma sigma
    alpha, gamma = diameter * log_mean / (3.0 * n), w * np.sqrt(2.0 * log_mean / n)
    beta = w * diameter * np.sqrt(log_variance / (2.0 * n))
    sigma = diameter / np.sqrt(2.0)
    if gamma < 1.0:
        # (1 - gamma^2) sigma^2 - 2 (beta + alpha gamma) sigma - (D^2 / n + alpha^2) <= 0
        half, rest = beta + alpha * gamma, 1.0 - gamma**2
        last = np.sqrt(rest) * np.hypot(deviation / np.sqrt(n), alpha)
        sigma = min(sigma, (half + np.hypot(half, last)) / rest)
    return float(min(alpha + gamma * sigma, diameter))


def _bound(radius: float, diameter: float, given: float | None, size: int | None) -> str:
    """Say which bound gives the radius."""
    if diameter == np.inf:
        return "none"
    source = "observed range, an estimate" if given is None else "given range"
    if radius >= diameter:
        return source
    where = "epochs of sizes" if size is None else f"tightest at {size}"
    return f"empirical Bernstein for all sizes, {where}; {source}"
