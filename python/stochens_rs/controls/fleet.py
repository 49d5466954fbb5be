"""`control_fleet`: one command for many units."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .._base import validation
from .._base.signal_names import default_labels
from .._base.weights import weight
from ..exceptions import InputError
from .constraints import sides
from .cost import Cost, as_cost
from .fleet_design import Box, Worst, least_mean, worst_of_few
from .fleet_plan import RISKS, FleetPlan, Risk
from .fleet_units import Systems, read_units
from .limits import as_limits

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .limits import LimitsLike


def control_fleet(
    systems: Systems,
    x0: ArrayLike,
    xf: ArrayLike,
    steps: int,
    *,
    limits: LimitsLike = None,
    cost: Cost | None = None,
    risk: Risk = "mean",
    discard: int = 0,
    time_limit: float | None = None,
) -> FleetPlan:
    """Compute one command that steers all units of a population to a target.

    Parameters
    ----------
    systems : SystemEnsemble or sequence of System or Identified
        The units ``x_s(k+1) = A_s x_s(k) + B_s u(k) (+ c_s)``: different plants, such as machines
        of one series. Not realizations or bootstrap models of *one* plant: for these `control` is
        right, and models with ``centre="estimate"`` are refused. The names of the first unit in
        another order are brought into its order.
    x0 : array_like, shape (n,) or (N, n)
        Where the units begin: all at one state, or each at its own.
    xf : array_like, shape (n,)
        The target.
    steps : int
        Number of steps K.
    limits : Limits, or tuple (low, high), optional
        Of the inputs, each a number, (m,), (K, m) or None.
    cost : Cost, optional
        The weights Qf and R. The miss of a unit is ``||x_s(K) - xf||_Qf``; the default of Qf is 1.
        ``||u||_R^2 = sum_k u(k)'R u(k)``; the default of R is 0 for the mean. For the largest miss
        it is ``1e-8 max_s tr(G_s'Qf G_s) / (K m)`` times I, with G_s the map from the inputs to
        ``x_s(K)``: of commands that miss about as much, the smallest. With ``R=0`` the miss alone
        counts, however large the inputs.
    risk : {"mean", "worst"}, default "mean"
        Minimise ``mean_s miss_s^2 + ||u||_R^2``, or the largest ``miss_s^2 + ||u||_R^2``.
    discard : int, default 0
        With "worst": how many units may miss more. They are chosen one by one, each time the unit
        without which the value falls most. For a certificate fix the number before the units are
        seen.
    time_limit : float, optional
        Seconds after which the search ends, with status "user_limit". With "worst" the command is
        then solved for the units found so far, which takes at most as long again.

    Returns
    -------
    FleetPlan
        With the misses of all units, a bound of the optimality gap that is recomputed from all
        units, and `certify` and `validate` for fresh units. After Ctrl-C the best command so far,
        with status "interrupted".

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used, the models scatter about an estimate, or something overflows.
    ResourceError
        If there is not enough memory.

    Notes
    -----
    The mean needs ``H = mean_s G_s'Qf G_s + R``: the spread of the units is in it, so that it needs
    no R to be regular.

    The largest miss is found by active units: a second-order cone problem for a few of them, then
    the misses of all, then those that miss most are taken in. The lower bound is a value of the
    dual, recomputed. In the end the command is solved once more for `FleetPlan.support` alone.

    Examples
    --------
    >>> import stochens_rs as se
    >>> units = [([[0.0]], [[1.0]]), ([[0.0]], [[2.0]])]
    >>> se.control_fleet(units, [0.0], [1.0], 1).u.round(6)
    array([[0.6]])
    >>> se.control_fleet(units, [0.0], [1.0], 1, risk="worst").u.round(6)
    array([[0.666667]])
    """
    weights = as_cost(cost).only("Qf", "R")
    units = read_units(systems, x0, xf, steps, weights.Qf)
    m = units.systems.m
    labels = units.systems.labels or default_labels(units.systems.n, m)
    low, high = sides("limits", as_limits(limits).only("u").u, units.steps, labels)
    R = None if weights.R is None else weight("R", weights.R, m)
    box = Box(low.ravel(), high.ravel(), R)
    validation.choice("risk", risk, RISKS)
    count = validation.size("discard", discard, minimum=0, maximum=max(0, units.size - 1))
    limit = None if time_limit is None else validation.positive("time_limit", time_limit)
    if risk == "mean":
        if count:
            raise InputError("`discard` needs risk='worst', got risk='mean'")
        found = Worst(least_mean(units, box, limit), box, (), None)
    else:
        found = worst_of_few(units, box, R is None, count, limit)
    design, u = found.design, found.design.u.reshape(low.shape)
    return FleetPlan(
        u,
        risk,
        units.misses(u),
        design.value,
        design.lower_bound,
        design.status,
        design.support,
        found.removed,
        units,
        low,
        high,
        found.box.R,
        found.widest,
        count,
    )
