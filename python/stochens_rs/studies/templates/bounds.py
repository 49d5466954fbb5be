"""A study of the bounds of plans from sampled realizations: how often they hold, how tight."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_args

from numpy.typing import ArrayLike

from ..._base import validation
from ..._base.types import DELTA, QUANTITIES, Floats, Quantity
from ...controls.constraints import sides
from ...controls.limits import as_limits
from ...controls.steering import steer
from ...fusion.fusing import Method
from ...rng import Key
from ...system import System
from ...theory.dynamics import checked_ends
from .template import Template, compared, template

if TYPE_CHECKING:
    from ...controls.limits import LimitsLike


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
) -> Template:
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
    Template
        ``function(key, size, steps, delta, method)``, for a grid of any of these. It returns
        "covered", whether the bound is at least the true error (0 or 1); both, "bound" and "error",
        and their "ratio".

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
    known, start, goal = checked_ends(system, x0, xf)
    sides("limits", as_limits(limits).only("u").u, validation.size("steps", steps), known.labels)
    return template(
        _numbers,
        ("size", "steps", "delta", "method"),
        ("covered", "ratio", "size", "steps", "delta"),
        {},
        system=known,
        x0=start,
        xf=goal,
        size=validation.size("size", size),
        steps=steps,
        delta=validation.probability("delta", delta),
        method=validation.choice("method", method, get_args(Method)),
        quantity=validation.choice("quantity", quantity, QUANTITIES),
        limits=limits,
    )


def _numbers(
    key: Key,
    *,
    system: System,
    x0: Floats,
    xf: Floats,
    size: int,
    steps: int,
    delta: float,
    quantity: Quantity,
    **how: Any,
) -> dict[str, float]:
    plan = steer(system, x0, xf, size, steps=steps, rng=key.child("plan"), **how)
    bound = plan.bound(delta)
    return compared(getattr(bound, quantity), getattr(plan.error(system, x0, xf), quantity))
