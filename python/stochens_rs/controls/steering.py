"""From exact values to a control in one call: sample, fuse, control."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, overload

from .._base import gate
from .._base.types import Fusion
from ..ensembles.sampling import sample
from ..exceptions import InputError
from ..fusion.fusing import METHODS, fuse
from ..rng import RngLike, as_key
from ..system import System
from .one_step import FUSIONS, control
from .several_steps import control_steps

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..fusion.fusing import Method
    from .plan import Plan
    from .trajectory_plan import TrajectoryPlan


@overload
def steer(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    size: int,
    *,
    method: Method = "uniform",
    fusion: Fusion = "product",
    rng: RngLike = None,
    steps: None = None,
) -> Plan: ...


@overload
def steer(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    size: int,
    *,
    method: Method = "uniform",
    fusion: Fusion = "product",
    rng: RngLike = None,
    steps: int,
) -> TrajectoryPlan: ...


def steer(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    size: int,
    *,
    method: Method = "uniform",
    fusion: Fusion = "product",
    rng: RngLike = None,
    steps: int | None = None,
) -> Plan | TrajectoryPlan:
    """Sample x0, xf and A, fuse them, and compute the control: all in one call.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes.
    x0, xf : array_like, shape (n,)
        Initial state and target.
    size : int
        Number of realizations of each entity.
    method : {"uniform", "alse", "slse", "slse-safeguarded"}, default "uniform"
        How to fuse; the least-squares methods fit to the exact entity, as in the paper's analysis.
    fusion : {"product", "diagonal"}, default "product"
        As in `control`; "diagonal" goes with method "uniform" only.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
        Source of randomness; the entities draw from its children "x0", "xf" and "A".
    steps : int, optional
        Number of steps K to reach the target in, as in `control_steps`; None: one step, as in
        `control`.

    Returns
    -------
    Plan or TrajectoryPlan
        The fused control, a TrajectoryPlan if `steps` is given; ``info["key"]`` repeats it.

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

    The realizations are drawn. For more of them than fit into memory draw counts instead, at a
    cost that does not depend on their number: `control` takes the results of `sample_counts`.

    Examples
    --------
    >>> import stochens_rs as se
    >>> system = se.System([[0.9, 0.2], [-0.1, 0.8]], [[1.0, 0.0], [0.5, 1.0]])
    >>> plan = se.steer(system, [1.0, 2.0], [0.0, 0.0], 10_000, rng=1)
    >>> plan.error(system, [1.0, 2.0], [0.0, 0.0]).control_relative < 0.1
    True
    """
    checked = System.from_any(system)
    gate.choice("method", method, METHODS)
    if gate.choice("fusion", fusion, FUSIONS) == "diagonal" and method != "uniform":
        raise InputError(
            f"`fusion` must be 'product' for method '{method}', got 'diagonal': paired "
            "realizations share one weight vector, so weights of their own cannot be paired"
        )
    if steps is not None:
        _refuse_diagonal(fusion, gate.size("steps", steps))
    key = as_key(rng)
    targets = {
        "x0": gate.vector("x0", x0, length=checked.n),
        "xf": gate.vector("xf", xf, length=checked.n),
        "A": checked.A,
    }
    fits = {
        name: fuse(sample(target, size, rng=key.child(name)), method, target=target)
        for name, target in targets.items()
    }
    plan: Plan | TrajectoryPlan
    if steps is None:
        plan = control(checked.B, fits["x0"], fits["xf"], fits["A"], fusion=fusion)
    else:
        plan = control_steps(checked.B, fits["x0"], fits["xf"], fits["A"], steps)
    return replace(plan, info={**plan.info, "key": key})


def _refuse_diagonal(fusion: str, steps: int) -> None:
    if fusion == "diagonal":
        reason = (
            "leave out `steps` for one step"
            if steps == 1
            else "the control over K >= 2 steps is not linear in A, so the average of the controls "
            "of the realizations is biased, and more of them do not help"
        )
        raise InputError(f"`fusion` must be 'product' with steps={steps}, got 'diagonal': {reason}")
