"""From exact values to a control in one call: sample, fuse, control."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from .._base import validation
from .._base.types import Fusion
from ..ensembles.sampling import sample
from ..exceptions import InputError
from ..fusion.fusing import METHODS, fuse
from ..rng import RngLike, as_key
from ..system import System
from ..theory.dynamics import checked_ends
from .arguments import fusion_over
from .control import control

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..fusion.fusing import Method
    from .cost import Cost
    from .limits import LimitsLike
    from .plan import Plan


def steer(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    size: int,
    *,
    steps: int = 1,
    method: Method = "uniform",
    fusion: Fusion = "product",
    limits: LimitsLike = None,
    cost: Cost | None = None,
    rng: RngLike = None,
) -> Plan:
    """Sample x0, xf and A, fuse them, and compute the control: all in one call.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes.
    x0, xf : array_like, shape (n,)
        Initial state and target.
    size : int
        Number of realizations of each entity.
    steps : int, default 1
        Number of steps K.
    method : str, default "uniform"
        As in `fuse`; the least-squares methods fit to the exact entity, as in the paper's analysis.
    fusion : {"product", "diagonal"}, default "product"
        As in `control`; "diagonal" goes with one step and method "uniform" only.
    limits, cost
        As in `control`.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
        Source of randomness; the entities draw from its children "x0", "xf" and "A".

    Returns
    -------
    Plan
        The fused control; ``info["key"]`` repeats it.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it. Among them fusion="diagonal" over
        several steps.

    Notes
    -----
    The average of one control per realization, ``fusion="diagonal"``, is inconsistent for
    ``steps >= 2``: the control is not linear in A. In a Gaussian system with n=6, m=2, K=4 the
    mean control from averages of 1, 5, 20 and 100 realizations is off by about 1.5, 0.9, 0.7 and
    0.3 times the exact control, however many of them are averaged.

    For more realizations than fit into memory, pass the results of `sample_counts` to `control`:
    the cost of counts does not depend on the number of realizations.

    Examples
    --------
    >>> import stochens_rs as se
    >>> system = se.System([[0.9, 0.2], [-0.1, 0.8]], [[1.0, 0.0], [0.5, 1.0]])
    >>> plan = se.steer(system, [1.0, 2.0], [0.0, 0.0], 10_000, rng=1)
    >>> plan.error(system, [1.0, 2.0], [0.0, 0.0]).control_relative < 0.1
    True
    """
    checked, start, goal = checked_ends(system, x0, xf)
    validation.choice("method", method, METHODS)
    _, how = fusion_over(steps, fusion, checked.n, checked.m)
    if how == "diagonal" and method != "uniform":
        raise InputError(
            f"`fusion` must be 'product' for method '{method}', got 'diagonal': paired "
            "realizations share one weight vector, so weights of their own cannot be paired"
        )
    key = as_key(rng)
    x0_fit, xf_fit, A_fit = (
        fuse(sample(target, size, rng=key.child(name)), method, target=target)
        for name, target in (("x0", start), ("xf", goal), ("A", checked.A))
    )
    plan = control(
        (A_fit, checked), x0_fit, xf_fit, steps=steps, limits=limits, cost=cost, fusion=how
    )
    return replace(plan, info={**plan.info, "key": key})
