"""From exact values to a control in one call: sample, fuse, control."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from .._base import gate
from .._base.types import Fusion
from ..ensembles.sampling import sample
from ..exceptions import InputError
from ..fusion.fusing import METHODS, fuse
from ..rng import RngLike, as_key
from ..system import System
from .entities import fusion_over
from .fused import control

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..fusion.fusing import Method
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
        Number of steps K to reach the target in.
    method : {"uniform", "alse", "slse", "slse-safeguarded"}, default "uniform"
        How to fuse; the least-squares methods fit to the exact entity, as in the paper's analysis.
    fusion : {"product", "diagonal"}, default "product"
        As in `control`; "diagonal" goes with one step and method "uniform" only.
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
    _, how = fusion_over(steps, fusion, checked.n, checked.m)
    if how == "diagonal" and method != "uniform":
        raise InputError(
            f"`fusion` must be 'product' for method '{method}', got 'diagonal': paired "
            "realizations share one weight vector, so weights of their own cannot be paired"
        )
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
    pair = fits["A"], checked.B
    plan = control(pair, fits["x0"], fits["xf"], steps=steps, fusion=how)
    return replace(plan, info={**plan.info, "key": key})
