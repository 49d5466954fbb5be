"""The record of an experiment: its options, checked, and its panels from the numbers of a study."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from stochens_rs import Study, System
from stochens_rs.exceptions import InputError
from stochens_rs.rng import as_key

from .. import common as check
from ..common import STATUSES, Floats, Fusion, Method, PathLike, Progress, RngLike, progress_bar
from ..curves import Curve, Panel
from ..experiment import Experiment
from ..methods import METHODS, STYLES
from ..repeating import complete
from .replicate import Sizes

LARGEST = 1e100  # allowed scale: squares of results do not overflow
ROUNDING = 1e-13  # relative errors up to here count as zero: 450 times the machine epsilon

# Covariance of an error under uniform weights: C1 and C2 of C(N) = C1 / N + C2 / N^2.
Orders = tuple[Floats, Floats]


class Quantity(NamedTuple):
    """What one panel shows."""

    panel: str
    values: str  # "1a" for the numbers "panel_1a"
    figure: str | None
    name: str
    symbol: str
    target: Floats  # errors are divided by its norm
    orders: Mapping[Any, Orders]  # by fusion; None for the estimate of an entity
    solves: str | None  # what its ALSE weights depend on; None: on a closed form


class Recording:
    """One experiment: checks the options, runs its study, and makes the record."""

    def __init__(
        self, rng: RngLike, replicates: int, samples: int, sizes: ArrayLike | None, tol: float
    ) -> None:
        self.started = time.perf_counter()
        self.key = as_key(rng)
        self.replicates = check.size("replicates", replicates, maximum=10**6)
        samples = check.size("samples", samples)
        self.sizes = log_grid(samples) if sizes is None else _checked_sizes(sizes, samples)
        self.tol = check.positive("tol", tol)
        self.values: dict[str, Floats] = {}  # (k, replicates, ...) by name

    def run(
        self,
        what: str,
        function: Callable[..., Mapping[str, Floats]],
        progress: Progress,
        executor: Any,
        path: PathLike | None,
    ) -> None:
        """Run all replicates.

        ``function(key, size)`` returns the absolute errors of each panel as "panel_1a", ...,
        (k, curves), the columns in the order of `METHODS` or `STYLES`, and what `solves` made.
        """
        grid = {"size": self.sizes.tolist()}
        study = Study(function, grid, replicates=self.replicates, rng=self.key, nested="size")
        with progress_bar(progress, self.replicates, what) as tell:
            self.values = complete(study, executor, path, lambda done, _: tell(done))

    def solves(self, name: str) -> dict[str, Any]:
        """Number of solves for ALSE weights, how they ended, the worst relative gap, and `tol`."""
        codes, counts = np.unique(self.values[f"status_{name}"], return_counts=True)
        ended = {str(STATUSES[int(k)]): n for k, n in zip(codes, counts.tolist(), strict=True)}
        return {
            "solves": sum(ended.values()),
            "statuses": dict(sorted(ended.items())),
            "worst_relative_gap": float(self.values[f"gap_{name}"].max()),
            "tol": self.tol,
        }

    def panel(self, shown: Quantity) -> Panel:
        """The relative errors of one quantity, with the exact ones of uniform weights."""
        norm = float(np.linalg.norm(shown.target))
        if norm == 0.0:
            raise InputError(f"`given` must not lead to a {shown.name} of 0: no error is relative")
        columns = (self.values[f"panel_{shown.values}"] / norm).transpose(2, 1, 0)
        looks: Iterable[tuple[Method, Fusion | None]] = (
            STYLES if len(columns) == len(STYLES) else ((method, None) for method in METHODS)
        )
        curves = []
        for (method, fusion), errors in zip(looks, columns, strict=True):
            exact = (
                exact_moments(shown.orders[fusion], self.sizes, norm)
                if method == "uniform"
                else (None, None)
            )
            curves.append(Curve(method, fusion, errors, *exact))
        level, label = ROUNDING, "zero to rounding"
        if shown.solves is not None:
            # The gap bounds the squared error in excess of the smallest possible one.
            level = math.sqrt(max(self.tol, self.solves(shown.solves)["worst_relative_gap"]))
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
        solves: Mapping[str, str],
        facts: Mapping[str, Any],
        settings: Mapping[str, Any],
    ) -> Experiment:
        """The finished record; `facts` and `settings` are those of this experiment only.

        `solves` names what is told of ALSE, and where it is in the study.
        """
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
                "alse": {entity: self.solves(one) for entity, one in solves.items()},
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


def _checked_sizes(sizes: ArrayLike, largest: int) -> Sizes:
    """Increasing sample counts, the last of them at most the largest."""
    found = np.asarray(sizes)
    whole = found.ndim == 1 and found.size and found.dtype.kind in "iu"
    if not whole or found[0] < 1 or found[-1] > largest or (np.diff(found) <= 0).any():
        raise InputError(f"`sizes` must be increasing counts in 1 .. {largest}, got {sizes!r}")
    return found.astype(np.int64)


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
