"""A study of a feedback within limits: cost, limits reached, states beyond theirs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..._base import validation
from ..._base.signal_names import order_of
from ..._base.types import Floats
from ..._base.weights import weight
from ...controls.constraints import sides
from ...controls.cost import Cost, as_cost
from ...controls.limits import Limits, as_limits
from ...controls.regulating import regulate
from ...controls.regulator import checked_model
from ...exceptions import InputError, ShapeError
from ...identification.identified import Identified
from ...rng import Key
from ...simulation.closed_loop import track
from ...system import System
from ..units import of_states
from .template import Template, template


def closed_loop(
    system: Any,
    x0: ArrayLike,
    xf: ArrayLike | None = None,
    *,
    steps: int = 10,
    limits: Any = None,
    cost: Cost | None = None,
    noise: ArrayLike = 0.0,
    length: int = 50,
    model: Any = None,
) -> Template:
    """Return the function of a study of a feedback, as `regulate` makes it, under noise.

    Parameters
    ----------
    system : System or (A, B)
        What is controlled.
    x0 : array_like, shape (n,)
        Where it begins.
    xf : array_like, shape (n,), optional
        The target; default: the origin.
    steps : int, default 10
        Number of steps K that each call of the feedback plans.
    limits : Limits, float or tuple (low, high), optional
        As in `regulate`, the same in every step; one number L stands for (-L, L).
    cost : Cost, optional
        The weights Q, Qf and R; the default of Q and R is 1.
    noise : float or array_like, shape (n,), default 0.0
        Standard deviations of the Gaussian noise w(k) of `system`.
    length : int, default 50
        Number of steps T that are simulated.
    model : System or Model, optional
        What the feedback plans with; default: `system`.

    Returns
    -------
    Template
        ``function(key, steps, limits, Q, R, noise, model)``, for a grid of any of these: limits of
        inputs, and Q or R in place of those of `cost`. Pairs, arrays and models need labels there.
        It returns "cost", ``sum_k ||x(k) - xf||_Q^2 +
        ||u(k-1)||_R^2`` over k = 1, ..., T with the Q and R here, whatever the feedback has, so
        that costs can be compared; "limited", the share of inputs that are at a limit; "violation",
        by how much a state was beyond its limits at most; "distance", ``||x(T) - xf||``.

    Raises
    ------
    InputError, InputTypeError
        If the arguments do not fit together.

    Examples
    --------
    >>> import stochens_rs as se
    >>> cart = ([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]])
    >>> function = se.studies.closed_loop(cart, [1, 0], cost=se.Cost(R=0.1), noise=0.001)
    >>> study = se.Study(function, {"limits": [0.2, 1.0]}, replicates=5, rng=1)
    >>> study.run().values["limited"].mean(axis=1) > 0.1
    array([ True, False])
    """
    known = System.from_any(system)
    n = known.n
    goal = np.zeros(n)
    if xf is not None:
        goal = validation.vector("xf", xf, length=n, labels=known.state_names)
    acting = known if model is None else _acting(model, known)
    weights = as_cost(cost).only("Q", "Qf", "R")
    Q: Any = 1.0 if weights.Q is None else weights.Q
    R: Any = 1.0 if weights.R is None else weights.R
    weights, within = replace(weights, Q=Q, R=R), as_limits(_pair(limits))
    regulate(acting, steps, goal, limits=within, cost=weights)  # refuses what does not fit
    return template(
        _numbers,
        ("steps", "limits", "Q", "R", "noise", "model"),
        ("limited", "steps"),
        of_states(known.labels, "violation", "distance", "noise"),
        system=known,
        x0=validation.vector("x0", x0, length=n, labels=known.state_names),
        xf=goal,
        judged=(weight("Q", Q, n), weight("R", R, known.m)),
        noise=validation.deviations("noise", noise, n),
        length=validation.size("length", length),
        within=within,
        cost=weights,
        steps=steps,
        limits=within.u,
        Q=Q,
        R=R,
        model=acting,
    )


def _numbers(
    key: Key,
    *,
    system: System,
    x0: Floats,
    xf: Floats,
    steps: int,
    limits: Any,
    Q: Any,
    R: Any,
    noise: Any,
    length: int,
    model: Any,
    within: Limits,
    cost: Cost,
    judged: tuple[Floats, Floats],
) -> dict[str, float]:
    within, cost = replace(within, u=_pair(limits)), replace(cost, Q=Q, R=R)
    loop = regulate(_acting(model, system), steps, xf, limits=within, cost=cost)
    reference = np.tile(xf, (length + 1, 1))
    ride = track(system, reference, controller=loop, x0=x0, noise=noise, rng=key)
    low, high = sides("limits", within.u, 1, system.labels)
    below, above = sides("limits.x", within.x, 1, system.labels)
    x, u, off = ride.states[1:], ride.inputs, ride.states[1:] - xf
    weight_x, weight_u = judged
    return {
        "cost": float(np.sum((off @ weight_x) * off) + np.sum((u @ weight_u) * u)),
        "limited": float(np.mean((u <= low) | (u >= high))),
        "violation": float(max(0.0, (x - above).max(), (below - x).max())),
        "distance": float(ride.errors[-1]),
    }


def _acting(model: Any, system: System) -> System | Identified:
    """The model that plans, in the order of the system whose limits and weights it gets."""
    acting = checked_model(model)
    if acting.B.shape != system.B.shape:
        raise ShapeError(
            f"`model` must have n={system.n} and m={system.m} as `system`, got "
            f"n={acting.B.shape[0]} and m={acting.B.shape[1]}"
        )
    if isinstance(acting, System):
        return acting._in_order("model", system.labels)
    if order_of("model", acting.labels, system.labels) != (None, None):
        raise InputError(
            "`model` must have its states and inputs in the order of `system`: identify it with "
            "the names in this order"
        )
    return acting


def _pair(limits: Any) -> Any:
    """(-L, L) for a number L."""
    return (
        (-validation.nonnegative("limits", limits), limits)
        if validation.is_real(limits)
        else limits
    )
