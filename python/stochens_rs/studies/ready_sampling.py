"""A study of the bounds of plans from sampled realizations: how often they hold, how tight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from numpy.typing import ArrayLike

from .._base import validation
from .._base.records import Record
from .._base.types import DELTA, QUANTITIES, Floats, Quantity
from ..controls.constraints import sides
from ..controls.steering import steer
from ..fusion.fusing import Method
from ..rng import Key
from ..system import System
from .ready_runs import changed
from .units import PURE

if TYPE_CHECKING:
    from ..controls.constraints import LimitsLike


def sampling_coverage(
    system: Any,
    x0: ArrayLike,
    xf: ArrayLike,
    *,
    size: int = 1000,
    steps: int = 1,
    delta: float = DELTA,
    method: Method = "uniform",
    quantity: Quantity = "state",
    limits: LimitsLike = None,
) -> SamplingCoverage:
    """Return the function of a study of how often bounds from realizations hold, and how tight.

    Parameters
    ----------
    system : System or (A, B)
        The exact system.
    x0, xf : array_like, shape (n,)
        Initial state and target.
    size : int, default 1000
        Number of realizations of x0, xf and A each.
    steps : int, default 1
        Number of steps K.
    delta : float, default 0.05
        Level of the bound.
    method : str, default "uniform"
        How to fuse, as in `steer`.
    quantity : {"state", "control"}, default "state"
        The distance from the state that the exact control leads to, or from that control.
    limits : tuple (low, high), optional
        Limits of the inputs, as in `steer`.

    Returns
    -------
    SamplingCoverage
        ``function(key, size, steps, delta, method)``, for a grid of any of these.

    Raises
    ------
    InputError, InputTypeError
        If the arguments do not fit together.

    Examples
    --------
    >>> import stochens_rs as se
    >>> system = ([[0.9, 0.2], [-0.1, 0.8]], [[0.0], [1.0]])
    >>> function = se.studies.sampling_coverage(system, [1, 1], [0.5, 0])
    >>> study = se.Study(function, {"size": [10, 1000]}, replicates=20, rng=1)
    >>> study.run().values["covered"].mean(axis=1)
    array([0.9, 1. ])
    """
    known = System.from_any(system)
    start = validation.vector("x0", x0, length=known.n).copy()
    goal = validation.vector("xf", xf, length=known.n).copy()
    validation.choice("method", method, get_args(Method))
    sides("limits", limits, validation.size("steps", steps), known.labels)
    return SamplingCoverage(known, start, goal, size, steps, delta, method, quantity, limits)


@dataclass(frozen=True, eq=False)
class SamplingCoverage(Record, listed=False):
    """A plan from realizations that are drawn, and whether its bound holds.

    Calling it with a key, and `size`, `steps`, `delta` or `method` in place of those here, returns
    "covered", whether the bound is at least the true error (0 or 1); both, "bound" and "error", and
    their "ratio".

    Attributes
    ----------
    system : System
    x0, xf : ndarray, shape (n,)
    size, steps, delta, method, quantity, limits
        As in `sampling_coverage`.
    """

    system: System
    x0: Floats
    xf: Floats
    size: int
    steps: int
    delta: float
    method: Method
    quantity: Quantity
    limits: LimitsLike

    def __post_init__(self) -> None:
        validation.size("size", self.size)
        validation.size("steps", self.steps)
        validation.probability("delta", self.delta)
        validation.choice("quantity", self.quantity, QUANTITIES)

    @property
    def units(self) -> dict[str, str]:
        """Of its numbers."""
        return dict.fromkeys(("covered", "ratio", "size", "steps", "delta"), PURE)

    def __call__(
        self,
        key: Key,
        size: int | None = None,
        steps: int | None = None,
        delta: float | None = None,
        method: Method | None = None,
    ) -> dict[str, float]:
        """Return the numbers of one replicate."""
        now = changed(self, size=size, steps=steps, delta=delta, method=method)
        ends = self.system, self.x0, self.xf
        how: dict[str, Any] = {"method": now.method, "limits": now.limits}
        plan = steer(*ends, now.size, steps=now.steps, rng=key.child("plan"), **how)
        bound = getattr(plan.bound(now.delta, rng=key.child("bound")), self.quantity)
        error = getattr(plan.error(*ends), self.quantity)
        return {
            "covered": float(error <= bound),
            "bound": bound,
            "error": error,
            "ratio": bound / error if error else np.inf,
        }
