"""What both experiments do in every replicate: sample an entity, fuse it by every method, form
controls.

Only formulas that run over n stand here; samples are drawn and fused by the library.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._base.types import Fusion
from ..controls.fused import realization_controls
from ..ensembles.ensemble import Ensemble
from ..ensembles.sampling import sample
from ..fusion.fusing import Method, fuse_path
from ..rng import Key
from .curves import Curve, Panel

FloatArray = NDArray[np.float64]
Sizes = NDArray[np.int64]
Exact = tuple[FloatArray, FloatArray]  # relative rms and spread, (k,) each
METHODS: tuple[Method, ...] = ("uniform", "slse", "slse-safeguarded", "alse")
# Every method with product fusion; for uniform weights also the paper's mean of per-realization
# controls.
FUSIONS: tuple[Fusion, ...] = ("product", "diagonal")
FUSED: tuple[tuple[Method, Fusion], ...] = (
    ("uniform", "diagonal"),
    *((method, "product") for method in METHODS),
)
LARGEST = 1e100  # of a scale: squares of what comes of it do not overflow
ROUNDING = 1e-13  # relative errors up to here are zero to rounding


@dataclass
class Solves:
    """How the solves for ALSE weights ended, and the worst gap among them."""

    statuses: Counter[str] = field(default_factory=Counter)
    worst_gap: float = 0.0

    def add(self, statuses: tuple[str, ...], gaps: FloatArray | None, scale: float) -> None:
        """`gaps` are absolute, on ``||sum w E - E*||^2``; they are kept relative to `scale`."""
        self.statuses.update(statuses)
        if gaps is not None and scale > 0:
            self.worst_gap = max(self.worst_gap, float(np.max(gaps)) / scale)

    def to_dict(self, tol: float) -> dict[str, Any]:
        """Number of solves, how they ended, the worst relative gap and the tolerance asked for."""
        return {
            "solves": sum(self.statuses.values()),
            "statuses": dict(sorted(self.statuses.items())),
            "worst_relative_gap": self.worst_gap,
            "tol": tol,
        }


@dataclass(frozen=True)
class Entity:
    """One sampled entity (x0, xf or A) with its estimates after sizes[0], sizes[1], ... samples."""

    ensemble: Ensemble
    estimates: dict[Method, FloatArray]  # by method, (k, *shape)
    errors: dict[Method, FloatArray]  # by method, (k,), absolute

    @classmethod
    def draw(cls, target: FloatArray, sizes: Sizes, rng: Key, tol: float, solves: Solves) -> Entity:
        """Sample ``sizes[-1]`` realizations of `target` and fuse every prefix by every method."""
        ensemble = sample(target, int(sizes[-1]), rng=rng)
        estimates: dict[Method, FloatArray] = {}
        errors: dict[Method, FloatArray] = {}
        for method in METHODS:
            path = fuse_path(ensemble, sizes, method, target=target, tol=tol, estimates=True)
            if "interrupted" in path.statuses:
                raise KeyboardInterrupt  # half a replicate is of no use
            assert path.estimates is not None  # estimates=True
            estimates[method], errors[method] = path.estimates, path.errors
            if method == "alse":
                solves.add(path.statuses, path.gaps, float(np.sum(target**2)))
        return cls(ensemble, estimates, errors)


def controls(
    B: FloatArray, B_plus: FloatArray, x0: Entity, xf: Entity, A: Entity, sizes: Sizes
) -> dict[tuple[Method, Fusion], FloatArray]:
    """The controls after each number of samples, (k, m) for every pair (method, fusion).

    Product fusion: ``u = B+ (xf_hat - A_hat x0_hat)``; diagonal fusion: ``u = mean_s B+ (xf^s -
    A^s x0^s)``. `B_plus` is formed once by the caller; it is the only factorization.
    """
    fused: dict[tuple[Method, Fusion], FloatArray] = {}
    for method in METHODS:
        drift = np.einsum("kij,kj->ki", A.estimates[method], x0.estimates[method])
        fused[method, "product"] = (xf.estimates[method] - drift) @ B_plus.T
    u = realization_controls((A.ensemble, B), x0.ensemble, xf.ensemble)
    fused["uniform", "diagonal"] = np.cumsum(u, axis=0)[sizes - 1] / sizes[:, None]
    return fused


def normal(key: Key, n: int) -> FloatArray:
    """(n,) standard normal variates of `key` (NumPy's Philox)."""
    return key.generator().standard_normal(n)


class Errors:
    """Collects relative errors: one (replicates, k) array for every (panel, method, fusion)."""

    def __init__(self, replicates: int, sizes: Sizes) -> None:
        self.shape = (replicates, sizes.size)
        self.table: dict[tuple[str, str, str | None], FloatArray] = {}

    def put(self, r: int, panel: str, method: str, fusion: str | None, errors: FloatArray) -> None:
        """Enter the (k,) errors of replicate r."""
        key = (panel, method, fusion)
        self.table.setdefault(key, np.full(self.shape, np.nan))[r] = errors

    def curves(self, panel: str, exact: dict[str | None, Exact]) -> tuple[Curve, ...]:
        """The curves of one panel; `exact` says what uniform weights must give, by fusion."""
        curves = []
        for (name, method, fusion), errors in self.table.items():
            if name == panel:
                rms, spread = exact[fusion] if method == "uniform" else (None, None)
                curves.append(Curve(method, fusion, errors, rms, spread))
        return tuple(curves)


def both_orders(covariance: Callable[[int], FloatArray]) -> tuple[FloatArray, FloatArray]:
    """The matrices of ``C(N) = C1 / N + C2 / N^2``, from ``C(1)`` and ``C(2)``.

    Every covariance under uniform weights has this form; ``C2 = 0`` but for product fusion.
    """
    one, two = covariance(1), covariance(2)
    first = 4 * two - one
    return first, one - first


def exact_moments(orders: tuple[FloatArray, FloatArray], sizes: Sizes, norm: float) -> Exact:
    """Relative rms and spread of an error with the covariance ``C(N) = C1 / N + C2 / N^2``.

    ``rms = sqrt(tr C) / norm`` and ``spread = sqrt(2 tr C^2) / norm^2``. Matrices of shape
    (b, n, n) stand for b independent blocks (the columns of a sampled matrix).
    """
    C = [orders[0] / N + orders[1] / N**2 for N in sizes.astype(np.float64)]
    rms = np.sqrt([np.trace(one, axis1=-2, axis2=-1).sum() for one in C]) / norm
    spread = np.sqrt([2 * np.sum(one**2) for one in C]) / norm**2
    return rms, spread


def required_size(orders: tuple[FloatArray, FloatArray], level: float) -> int:
    """The smallest N with ``sqrt(tr C(N)) <= level``, for ``C(N) = C1 / N + C2 / N^2``."""
    a, b = (float(np.trace(C)) for C in orders)
    # level^2 N^2 - a N - b = 0
    return math.ceil((a + math.sqrt(a * a + 4 * level**2 * b)) / (2 * level**2))


def ordering(panel: Panel) -> dict[str, float]:
    """Shares of (replicate, size) pairs in which one method is worse than another.

    "alse_above_slse" = 0.02 says: in 2 % of all pairs ALSE had the larger error. Differences
    within the panel's zero level, or within rounding, do not count.
    """

    def share(worse: str, better: str) -> float:
        a, b = panel.curve(worse).errors, panel.curve(better).errors
        return float(np.mean(a > b * (1 + 1e-9) + panel.zero_level))

    return {
        "alse_above_slse": share("alse", "slse"),
        "alse_above_uniform": share("alse", "uniform"),
        "slse_above_uniform": share("slse", "uniform"),
        "safeguarded_above_uniform": share("slse-safeguarded", "uniform"),
    }


def agreement(panels: tuple[Panel, ...], sizes: Sizes) -> dict[str, Any]:
    """The largest absolute z-score over all uniform curves, and of how many comparisons.

    Sizes below 10 are left out where there are others: there the mean square hangs on errors so
    rare and large that z is far from normal.
    """
    kept = sizes >= min(10, sizes[-1])
    z = np.concatenate([c.z[kept] for p in panels for c in p.curves if c.z is not None])
    return {
        "smallest_size": int(sizes[kept][0]),
        "comparisons": int(z.size),
        "largest_abs_z": float(np.max(np.abs(z))),
    }


def zero_level(tol: float, solves: Solves) -> float:
    """Below which relative error a solve for ALSE weights cannot tell the estimate from the target.

    The gap bounds the squared error in excess of the smallest possible one.
    """
    return math.sqrt(max(tol, solves.worst_gap))


def zero_from(panel: Panel, sizes: Sizes, method: str = "alse") -> int | None:
    """The smallest size from which on all errors are zero (to the panel's level), or None."""
    zero = np.all(panel.curve(method).errors <= panel.zero_level, axis=0)
    steady = np.logical_and.accumulate(zero[::-1])[::-1]
    return int(sizes[np.argmax(steady)]) if steady.any() else None


def slse_over_bound(panel: Panel, sizes: Sizes) -> float:
    """Largest ratio, over the sizes from 2 on, of SLSE's mean square to the exact one of uniform
    weights.

    At most 1 in expectation (Lemma 4.5, corrected: ``E d_n^2 <= V / n``); at n = 1 both are the
    same sample.
    """
    exact = panel.curve("uniform").exact_rms
    assert exact is not None  # uniform weights have one
    later = sizes >= min(2, sizes[-1])
    return float(np.max((panel.curve("slse").rms[later] / exact[later]) ** 2))
