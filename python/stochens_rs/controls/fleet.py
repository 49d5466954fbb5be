"""`control_fleet`: one command for many units."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .. import _core
from .._base import memory, validation
from .._base.threads import get_num_threads
from ..exceptions import InputError
from .fleet_plan import RISKS, FleetPlan, Risk
from .fleet_units import Systems, read_units

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .cost import Cost
    from .limits import LimitsLike

MATRICES = 72  # of (K m + 1)^2 numbers, at most: moments in parts, factors, a program


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
        of one series. Not realizations or drawn models of *one* plant: for these `control` is
        right, and models with ``centre="estimate"`` are refused. The names of the first unit in
        another order are brought into its order.
    x0 : array_like, shape (n,) or (N, n)
        Where the units begin: all at one state, or each at its own.
    xf : array_like, shape (n,)
        The target.
    steps : int
        Number of steps K.
    limits : Limits, or tuple (low, high), optional
        Of the inputs, of their changes, and of the states of every unit. Limits of states are hard
        and need ``soft=False``: with status "infeasible" no command keeps them for all units.
    cost : Cost, optional
        The miss of a unit is ``(sum_k ||x_s(k) - r(k)||_Q^2)^(1/2)`` with Qf at K; without weights
        ``||x_s(K) - xf||``. ``||u||_R^2 = sum_k u(k)'R u(k)``; the default of R is 0 for the mean.
        For the largest miss it is ``1e-8 max_s tr(G_s'Q G_s) / (K m)`` times I, with G_s the map
        from the inputs to the weighed states: of commands that miss about as much, the smallest.
        With ``R=0`` the miss alone counts, however large the inputs.
    risk : {"mean", "worst"}, default "mean"
        Minimise ``mean_s miss_s^2 + ||u||_R^2``, or the largest ``miss_s^2 + ||u||_R^2``.
    discard : int, default 0
        With "worst": how many units may miss more. They are chosen one by one, each time the unit
        without which the value falls most: that takes a new optimum for every unit that carries
        the command, so that a few units out can take a hundred times as long as none. For a
        certificate fix the number before the units are seen.
    time_limit : float, optional
        Seconds after which the search ends, with status "user_limit". With "worst" the command is
        then solved for the units found so far, which takes at most as long again. While units are
        left out it is the last command that was found, without those in `FleetPlan.removed`.

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
    The mean needs ``H = mean_s G_s'Q G_s + R``: the spread of the units is in it, so that it needs
    no R to be regular.

    The largest miss is found by active units: a second-order cone problem for a few of them, then
    the misses and states of all, then those that miss most and the limits that are exceeded most
    are taken in. The lower bound is a value of the dual, recomputed. In the end the command is
    solved once more for `FleetPlan.support` alone.

    Examples
    --------
    >>> import stochens_rs as se
    >>> units = [([[0.0]], [[1.0]]), ([[0.0]], [[2.0]])]
    >>> se.control_fleet(units, [0.0], [1.0], 1).u.round(6)
    array([[0.6]])
    >>> se.control_fleet(units, [0.0], [1.0], 1, risk="worst").u.round(6)
    array([[0.666667]])
    """
    units = read_units(systems, x0, xf, steps, limits, cost)
    task = units.task
    validation.choice("risk", risk, RISKS)
    out = validation.size("discard", discard, minimum=0, maximum=max(0, units.size - 1))
    limit = None if time_limit is None else validation.positive("time_limit", time_limit)
    memory.need("a command for a fleet", 8 * MATRICES * (task.low.size + 1) ** 2)
    threads = get_num_threads()
    support: list[int] = []
    removed: list[int] = []
    R, widest = task.R, None
    if risk == "mean":
        if out:
            raise InputError("`discard` needs risk='worst', got risk='mean'")
        found = _core.fleet_mean(units.arrays, task, limit, threads)
    else:
        found, support, removed, R, widest = _core.fleet_worst(
            units.arrays, task, R is None, out, limit, threads
        )
    u, value, lower_bound, missing, status = found
    return FleetPlan(
        u,
        risk,
        *units.misses(u),
        value,
        lower_bound,
        status,
        tuple(support),
        tuple(removed),
        units,
        R,
        widest,
        out,
        missing,
    )
