"""The run of an experiment: independent replicates, and the record of their errors."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .._base import gate
from .._base.progress import Progress, progress_bar
from .._base.types import Fusion
from ..fusion.fusing import Method
from ..rng import Key, RngLike, as_key
from ..system import System
from .curves import Curve, Panel
from .experiment import Experiment
from .replicate import Floats, Sizes, Solves

LARGEST = 1e100  # allowed scale: squares of results do not overflow
ROUNDING = 1e-13  # relative errors up to here count as zero: 450 times the machine epsilon

# Covariance of an error under uniform weights: C1 and C2 of C(N) = C1 / N + C2 / N^2.
Orders = tuple[Floats, Floats]
# Absolute errors of one replicate, (k,) for every (panel, method, fusion).
Errors = dict[tuple[str, Method, Fusion | None], Floats]


class Quantity(NamedTuple):
    """What one panel shows."""

    panel: str
    figure: str | None
    name: str
    symbol: str
    target: Floats  # errors are divided by its norm
    orders: Mapping[Any, Orders]  # by fusion; None for the estimate of an entity
    solves: Solves | None  # what its ALSE weights depend on; None: on a closed form


class ExperimentRun:
    """Replicates of one experiment: checks the options, runs them, and makes the record."""

    def __init__(
        self, rng: RngLike, replicates: int, samples: int, sizes: ArrayLike | None, tol: float
    ) -> None:
        self.started = time.perf_counter()
        self.key = as_key(rng)
        self.replicates = gate.size("replicates", replicates, maximum=10**6)
        samples = gate.size("samples", samples)
        self.sizes = (
            log_grid(samples) if sizes is None else gate.sizes("sizes", sizes, maximum=samples)
        )
        self.tol = gate.positive("tol", tol)
        self.errors: Errors = {}

    @property
    def keys(self) -> list[Key]:
        """One key for each replicate."""
        return [self.key.child(f"replicate-{r}") for r in range(self.replicates)]

    def run(self, what: str, replicate: Callable[[Key], Errors], progress: Progress) -> None:
        """Run all replicates; their errors are kept as (replicates, k) arrays."""
        found: list[Errors] = []
        with progress_bar(progress, self.replicates, what) as done:
            for key in self.keys:
                found.append(replicate(key))
                done(len(found))
        self.errors = {name: np.array([one[name] for one in found]) for name in found[0]}

    def panel(self, shown: Quantity) -> Panel:
        """The relative errors of one quantity, with the exact ones of uniform weights."""
        norm = float(np.linalg.norm(shown.target))
        curves = []
        for (panel, method, fusion), errors in self.errors.items():
            if panel == shown.panel:
                exact = (
                    exact_moments(shown.orders[fusion], self.sizes, norm)
                    if method == "uniform"
                    else (None, None)
                )
                curves.append(Curve(method, fusion, errors / norm, *exact))
        level, label = ROUNDING, "zero to rounding"
        if shown.solves is not None:
            # The gap bounds the squared error in excess of the smallest possible one.
            level = math.sqrt(max(self.tol, shown.solves.worst_gap))
            label = "zero to solver tolerance"
        return Panel(
            name=shown.panel,
            figure=shown.figure,
            quantity=shown.name,
            symbol=shown.symbol,
            norm=norm,
            zero_level=level,
            zero_label=label,
            curves=tuple(curves),
        )

    def experiment(
        self,
        name: str,
        title: str,
        system: System,
        panels: tuple[Panel, ...],
        solves: Mapping[str, Solves],
        facts: Mapping[str, Any],
        settings: Mapping[str, Any],
    ) -> Experiment:
        """The finished record; `facts` and `settings` are those of this experiment only."""
        return Experiment(
            name=name,
            title=title,
            key=self.key.hex,
            settings={
                "system": system.name,
                "n": system.n,
                "m": system.m,
                "replicates": self.replicates,
                "samples": int(self.sizes[-1]),
                "sizes": self.sizes.tolist(),
                **settings,
                "tol": self.tol,
                "system_sha256": hashlib.sha256(
                    system.A.tobytes() + system.B.tobytes()
                ).hexdigest(),
            },
            sizes=self.sizes,
            panels=panels,
            facts={
                "alse": {entity: one.to_dict(self.tol) for entity, one in solves.items()},
                "ordering": {panel.name: ordering(panel) for panel in panels},
                "theory": agreement(panels, self.sizes),
                **facts,
            },
            seconds=time.perf_counter() - self.started,
        )


def log_grid(samples: int, points: int = 16) -> Sizes:
    """At most `points` sample counts, evenly spaced on a log axis, from 1 to `samples`."""
    return np.unique(np.rint(np.geomspace(1, samples, points)).astype(np.int64))


def both_orders(covariance: Callable[[int], Floats]) -> Orders:
    """``C1`` and ``C2`` of a covariance under uniform weights, from ``C(1)`` and ``C(2)``.

    ``C2 = 0`` except for product fusion.
    """
    one, two = covariance(1), covariance(2)
    first = 4 * two - one
    return first, one - first


def exact_moments(orders: Orders, sizes: Sizes, norm: float) -> tuple[Floats, Floats]:
    """Relative rms and spread of an error with the covariance ``C(N) = C1 / N + C2 / N^2``.

    ``rms = sqrt(tr C) / norm`` and ``spread = sqrt(2 tr C^2) / norm^2``, (k,) each. Matrices of
    shape (b, n, n) stand for b independent blocks (the columns of a sampled matrix).
    """
    C = [orders[0] / N + orders[1] / N**2 for N in sizes.astype(np.float64)]
    rms = np.sqrt([np.trace(one, axis1=-2, axis2=-1).sum() for one in C]) / norm
    spread = np.sqrt([2 * np.sum(one**2) for one in C]) / norm**2
    return rms, spread


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
    """The largest absolute z-score over all uniform curves, and the number of comparisons.

    Sizes below 10 are left out if there are others: for few samples the mean square depends on
    rare large errors, and z is far from normal.
    """
    kept = sizes >= min(10, sizes[-1])
    z = np.concatenate([c.z[kept] for p in panels for c in p.curves if c.z is not None])
    return {
        "smallest_size": int(sizes[kept][0]),
        "comparisons": int(z.size),
        "largest_abs_z": float(np.max(np.abs(z))),
    }
