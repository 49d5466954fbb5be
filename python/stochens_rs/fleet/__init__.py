"""`FleetPlan` and `control_fleet`: one command for many units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal, TypeAlias, get_args

import numpy as np

from .. import _core
from .._base import running, show, validation
from .._base.names import Labels, default_labels, weight
from .._base.records import Probability, Record, SavedRecord, require_shapes
from .._base.running import get_num_threads
from .._base.tables import Timed
from .._base.types import ROUNDING, ArrayLike, Axes, Floats, NDArray, Status, shared
from ..ensembles import SystemEnsemble
from ..ensembles.systems import systems_in_order
from ..exceptions import InputError, ShapeError
from ..fusion.fused_model import ensemble_of
from ..identification.identified import Identified
from ..limits.limits import Cost, LimitsLike, as_cost, as_limits
from ..limits.problem import Task, read_task
from ..plots.lines import draw_misses
from ..system.system import System
from ..theory import scenario
from ..validation.held_out import needed, rank_of

__all__ = ["FleetPlan", "RiskBound", "control_fleet"]

Risk: TypeAlias = Literal["mean", "worst"]
Method: TypeAlias = Literal["compression", "a priori", "discarding", "hold-out"]


class RiskBound(SavedRecord):
    """A fresh unit misses more than `threshold` with probability at most `epsilon` (+ `delta`).

    Attributes
    ----------
    epsilon : float
        The bound of the risk, with confidence ``1 - beta``.
    beta : float
        The bound fails with at most this probability, over the units it was computed from.
    method : str
        "compression", "a priori", "discarding": from the units of the design, see
        `theory.scenario`. "hold-out": from fresh units.
    size : int
        The number of these units.
    count : int
        What `method` counts: the units that alone give the command (compression), the variables
        (a priori, discarding), the units above the threshold (hold-out).
    threshold : float
        The miss that is spoken of; with regions, of the plants behind the models.
    delta : float
        With regions of models, the probability that the region of a fresh unit fails; else 0.
    misses : ndarray, shape (size,), or None
        The misses of the fresh units of a hold-out.
    keeps : bool
        Whether a unit that leaves its limits of states counts as one that misses more.
    """

    epsilon: float
    beta: Probability
    method: Method
    size: int
    count: int
    threshold: float
    delta: float = 0.0
    misses: Floats | None = None
    keeps: bool = False

    @property
    def covers(self) -> str:
        """Which units the number is about, in words."""
        which = "these fresh units" if self.method == "hold-out" else "the units of the design"
        text = (
            f"a fresh unit, drawn independently from the same law as {which}, which were drawn "
            f"independently; with confidence {1.0 - self.beta:.9g} over their draws"
        )
        if self.delta:
            return f"{text}; the miss is that of the plant behind the model of the unit"
        return text

    def __repr__(self) -> str:
        how = f"{100 * self.epsilon:.4g} %"
        if self.delta:
            how += f" + {100 * self.delta:.4g} %"
        leaves = " or leaves its limits" if self.keeps else ""
        return (
            f"<RiskBound {self.method}: a fresh unit misses more than {self.threshold:.4g}{leaves} "
            f"with at most {how}, {self.count} of {self.size}>"
        )


class FleetPlan(SavedRecord, Timed):
    """One command for many units, made by `control_fleet`.

    Attributes
    ----------
    u : ndarray, shape (K, m)
        The command; ``u[k]`` acts in the step from k to k + 1, within its limits exactly.
    risk : {"mean", "worst"}
        What was minimised.
    misses : ndarray, shape (N,)
        ``(sum_k ||x_s(k) - r(k)||_Q^2)^(1/2)`` of every unit, also of those that were left out.
    excess : ndarray, shape (N,)
        By how much a state of the unit is beyond its limit, at most; 0 up to 1e-8 of the largest
        number among the limits and the target.
    value : float
        What was minimised, with the weight of the inputs in it. "mean":
        ``(mean_s miss_s^2 + ||u||_R^2)^(1/2)``. "worst": the largest
        ``(miss_s^2 + ||u||_R^2)^(1/2)`` of the units that were not left out; their largest miss
        alone is `threshold`.
    lower_bound : float
        No command within the limits has a smaller value; recomputed from all units.
    gap : float
        ``value - lower_bound``, relative to the value at 0 (clipped into the limits).
    status : str
        "optimal", or why it is not. "worst": `gap` is at most 1e-6, or ``value^2 - lower_bound^2``
        at most 1e-9 of the sum of the squares of the values at u and at 0. "infeasible": limits of
        states cannot be kept; the command is the best one within limits wider by `missing`.
    active : ndarray of int8, shape (K, m)
        -1 at the lower limit, 1 at the upper one.
    support : tuple of int
        "worst": the units that alone give the command: it was solved for these and no others. All
        that were not left out, where a stop left no such command. "mean": none.
    removed : tuple of int
        The units that were left out, in their order.
    units : Units
        The units, their starts, and the task: what is wanted of all, and the limits.
    R : ndarray, shape (m, m), or None
        The weight of the inputs in one step; of "worst" also where none was given.
    widest : int or None
        The unit that R was taken from, where none was given; it is one of `support`.
    discard : int
        How many units were allowed to miss more, and to leave the limits of states.
    missing : float
        By how much the limits of states cannot be kept, at least by one unit; `lower_bound` is then
        for limits that are wider by this.
    """

    u: Annotated[Floats, "step input"]
    risk: Risk
    misses: Annotated[Floats, "unit"]
    excess: Annotated[Floats, "unit"]
    value: float
    lower_bound: float
    status: Status
    support: tuple[int, ...]
    removed: tuple[int, ...]
    units: Units
    R: Annotated[Floats, "input from_input"] | None = None
    widest: int | None = None
    discard: int = 0
    missing: float = 0.0

    def _check(self) -> None:
        size, shape = self.units.size, self.units.task.low.shape
        require_shapes(self, u=shape, misses=(size,))
        for name in ("support", "removed"):
            for unit in getattr(self, name):
                validation.size(name, unit, minimum=0, maximum=size - 1)
        if self.widest is not None:
            validation.size("widest", self.widest, minimum=0, maximum=size - 1)
        validation.size("discard", self.discard, minimum=len(self.removed), maximum=size - 1)

    @property
    def dt(self) -> float | None:
        """The time between two steps [s]; None if the units state none."""
        return self.units.systems.dt

    @property
    def labels(self) -> Labels | None:
        """Names and units of states and inputs, those of the units."""
        return self.units.systems.labels

    @property
    def gap(self) -> float:
        """How far the value can be from the least one, relative to the value at 0.

        0 is clipped into the limits. A value that can be 0 has no other scale.
        """
        zero = np.clip(0.0, self.units.task.low, self.units.task.high)
        misses = np.delete(self.units.misses(zero)[0], self.removed)
        beside = 0.0 if self.R is None else float(np.sum(zero @ self.R * zero))
        square = np.mean(misses**2) if self.risk == "mean" else misses.max() ** 2
        scale = float(np.sqrt(square + beside))
        return (self.value - self.lower_bound) / scale if scale > 0.0 else 0.0

    @property
    def active(self) -> NDArray[np.int8]:
        """Which inputs are at a limit: -1 at the lower one, 1 at the upper one."""
        near = 1e-6 * float(np.abs(self.u).max())
        low, high = self.units.task.low, self.units.task.high
        at_high = (high - self.u <= near).astype(np.int8)
        return np.where(self.u - low <= near, np.int8(-1), at_high)

    @property
    def threshold(self) -> float:
        """The largest miss of the units that were not left out."""
        return float(np.delete(self.misses, self.removed).max())

    @property
    def _rms(self) -> float:
        return float(np.sqrt(np.mean(self.misses**2)))

    @property
    def scores(self) -> Floats:
        """The misses (N,), infinite for a unit that leaves its limits of states."""
        return np.where(self.excess > 0.0, np.inf, self.misses)

    def certify(
        self,
        beta: float,
        *,
        method: Literal["compression", "a priori", "discarding"] = "compression",
        radius: ArrayLike | None = None,
        delta: float | None = None,
    ) -> RiskBound:
        """Bound how often a fresh unit misses more than the units of the design, or leaves limits.

        Parameters
        ----------
        beta : float
            Probability that the bound fails, in (0, 1).
        method : {"compression", "a priori", "discarding"}, default "compression"
            As in `theory.scenario`. "compression" holds for the command as it is. "a priori" and
            "discarding" hold for the exact optimum and take the command for it. Choose before you
            see the numbers: the smallest of several fails more often.
        radius : array_like, shape (N,), optional
            For units known by models: bounds of the distance between the miss of each model and
            that of its plant under this command, from regions. They are added to the misses.
        delta : float, optional
            With `radius`: the probability that such a bound fails for a fresh unit, in (0, 1).

        Returns
        -------
        RiskBound
            Its number is about fresh units of the law that the units of the design were drawn from,
            independently.

        Raises
        ------
        InputError, InputTypeError
            If the plan is for the mean, or `method` does not hold for it. For these there is
            `validate`.

        Notes
        -----
        By compression: the command is a function of the k units of `support` alone, and the
        threshold is the largest miss of all units that were not left out. For k units that are
        fixed beforehand the others are fresh to their command, and at most `discard` of these miss
        more than the threshold; every choice of k units is counted, see
        `theory.scenario.compression`. So the optimum, its uniqueness and the status do not matter.

        A unit that leaves its limits of states counts as one that misses infinitely: the number is
        about both. The units whose limits the command rests on are in the support.

        Where R was not given it is that of one unit, `widest`, which is in the support. For the
        other methods it counts as one more variable: given that unit, the others are independent
        draws with smaller maps, and a fresh unit with a larger map is one of at most N + 1 that has
        the largest.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> B = 1.0 + 0.2 * np.random.default_rng(1).standard_normal((500, 1, 1))
        >>> plan = se.control_fleet(se.SystemEnsemble(0 * B, B), [0.0], [1.0], 1, risk="worst")
        >>> risk = plan.certify(1e-6)
        >>> risk.count, bool(risk.epsilon < 0.07)
        (2, True)
        """
        beta = validation.probability("beta", beta)
        if self.risk == "mean":
            raise InputError("`certify` needs risk='worst'; for a mean use validate(new_units)")
        validation.choice("method", method, get_args(Method)[:3])
        N, scores = self.units.size, self.scores
        radii, failing = self._radii(radius, delta, N)
        removed, limits = list(self.removed), self.units.task
        threshold = float(np.delete(scores, removed).max())
        if threshold == np.inf:
            raise InputError("units leave their limits of states: use validate(new_units) instead")
        # the inputs that are not fixed, the value, and R
        count = int(np.count_nonzero(limits.low < limits.high)) + 1 + (self.widest is not None)
        if method == "compression":
            threshold = float(np.delete(scores + radii, removed).max())
            count = len(self.support)
            epsilon = scenario.compression(N, count, beta, violations=self.discard)
        elif self.status != "optimal":
            raise InputError(
                f"`method` {method!r} needs an optimal plan, this one is {self.status!r}: use "
                "'compression', or validate(new_units)"
            )
        elif failing:
            raise InputError("`radius` needs method='compression', or validate(new_units)")
        elif method == "discarding":
            if (scores[removed] <= threshold).any():
                raise InputError(
                    "a unit that was left out misses no more than the threshold, so that this "
                    "bound does not hold: use 'compression', or validate(new_units)"
                )
            epsilon = scenario.discarding(N, len(removed), count, beta)
        elif self.discard:
            raise InputError(
                f"`method` {method!r} does not hold after units were left out: use 'compression', "
                "'discarding' or validate(new_units)"
            )
        else:
            epsilon = scenario.a_priori(N, count, beta)
        keeps = limits.state_low is not None
        return RiskBound(epsilon, beta, method, N, count, threshold, failing, keeps=keeps)

    def validate(
        self,
        new_units: Systems,
        beta: float,
        *,
        threshold: float | None = None,
        epsilon: float | None = None,
        x0: ArrayLike | None = None,
        radius: ArrayLike | None = None,
        delta: float | None = None,
    ) -> RiskBound:
        """Bound how often a fresh unit misses more than a threshold, from fresh units.

        Parameters
        ----------
        new_units : SystemEnsemble or sequence of System or Identified
            Units that had no part in the design, drawn independently from the law in question. The
            names of the plan in another order are brought into its order.
        beta : float
            Probability that the bound fails, in (0, 1).
        threshold : float, optional
            Fixed before the fresh units were seen. The default is `threshold` of this plan.
        epsilon : float, optional
            In place of a threshold the risk, in (0, 1): the `RiskBound.threshold` is then the least
            miss that is shown to be exceeded by at most this share of all units.
        x0 : array_like, shape (n,) or (N', n), optional
            Where they begin; the default is that of the plan, if it is the same for all units.
        radius : array_like, shape (N',), optional
            As in `certify`, of the fresh units.
        delta : float, optional
            As in `certify`.

        Returns
        -------
        RiskBound
            Of Clopper and Pearson (1934); it holds for any command, and needs neither an optimal
            nor a convex design.

        Raises
        ------
        InputError, InputTypeError
            If the units do not fit the plan or are those of the design, or if they are too few for
            `epsilon`.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> B = 1.0 + 0.2 * np.random.default_rng(1).standard_normal((1500, 1, 1))
        >>> units, fresh = se.SystemEnsemble(0 * B[:500], B[:500]), B[500:]
        >>> plan = se.control_fleet(units, [0.0], [1.0], 1, risk="worst")
        >>> risk = plan.validate(se.SystemEnsemble(0 * fresh, fresh), 1e-6)
        >>> risk.size, bool(risk.epsilon < 0.05)
        (1000, True)
        >>> plan.validate(se.SystemEnsemble(0 * fresh, fresh), 0.05, epsilon=0.05)
        <RiskBound hold-out: a fresh unit misses more than 0.4191 with at most 4.951 %, 38 of 1000>
        """
        beta = validation.probability("beta", beta)
        share = None if epsilon is None else validation.probability("epsilon", epsilon)
        if share is not None:
            validation.left_out("with `epsilon`, which gives one", threshold=threshold)
        limit = (
            self.threshold if threshold is None else validation.nonnegative("threshold", threshold)
        )
        fresh, mine = read_systems(new_units), self.units.systems
        sizes = (fresh.n, fresh.m), (mine.n, mine.m)
        validation.same_sizes("new_units", *sizes, "those of this plan")
        validation.same_dt("new_units", fresh.dt, mine.dt, "this plan")
        fresh = systems_in_order("new_units", fresh, mine.labels)
        if x0 is None and len(self.units.x0) > 1:
            raise InputError("`x0` must be given: units of the design began at different states")
        starts = self.units.x0 if x0 is None else validation.starts(x0, fresh.size, fresh.n)
        units = Units(fresh, starts, self.units.task)
        if old := units.of_design(self.units):
            raise InputError(f"`new_units` must be fresh, {old} of {units.size} are of the design")
        misses, excess = units.misses(self.u)
        radii, failing = self._radii(radius, delta, fresh.size)
        misses = misses + radii
        scores = np.where(excess > 0.0, np.inf, misses)
        if share is None:
            above = int(np.count_nonzero(scores > limit))
        else:
            rank = rank_of(units.size, share, beta)
            if rank > units.size:
                raise InputError(
                    f"`epsilon` {share:g} with `beta` {beta:g} needs {needed(share, beta)} fresh "
                    f"units at least, got {units.size}"
                )
            above = units.size - rank
            limit = float(np.sort(scores)[rank - 1])
            if limit == np.inf:
                raise InputError(
                    f"`epsilon` {share:g} allows {above} units to leave limits: more do"
                )
        found = scenario.hold_out(fresh.size, above, beta)
        kept = self.units.task.state_low is not None
        return RiskBound(found, beta, "hold-out", fresh.size, above, limit, failing, misses, kept)

    def _radii(self, radius: Any, delta: Any, size: int) -> tuple[Floats, float]:
        """Radii (N,), 0 where none are given, and the probability that one of them fails."""
        if (radius is None) != (delta is None):
            raise InputError("`delta` must be given with `radius` alone: how often a radius fails")
        if radius is None:
            return np.zeros(size), 0.0
        if self.units.task.state_low is not None:
            about = "with limits of states, as it is about misses alone"
            validation.left_out(about, radius=radius)
        radii = validation.vector("radius", radius, length=size)
        if (radii < 0.0).any():
            raise InputError(f"`radius` must be >= 0, got {radii.min():.3g}")
        return radii, validation.probability("delta", delta)

    def plot(self, ax: Axes | None = None, *, validated: RiskBound | None = None) -> Axes:
        """Draw the misses of all units, from the least to the largest.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Where to draw; the default is a new figure.
        validated : RiskBound, optional
            Of `validate`, whose fresh units are drawn as well.

        Returns
        -------
        matplotlib.axes.Axes
            With the threshold as a line; support and units left out are marked.

        Raises
        ------
        ImportError
            If matplotlib is missing.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> B = 1.0 + 0.2 * np.random.default_rng(1).standard_normal((500, 1, 1))
        >>> plan = se.control_fleet(se.SystemEnsemble(0 * B, B), [0.0], [1.0], 1, risk="worst")
        >>> plan.plot().get_ylabel()
        'miss'
        """
        fresh = None
        if validated is not None:
            fresh = validation.instance("validated", validated, RiskBound).misses
        marks = np.zeros((2, self.units.size), dtype=bool)
        marks[0, list(self.support)] = True
        marks[1, list(self.removed)] = True
        worst = self.risk == "worst"
        line = self.threshold if worst else self._rms
        named = "threshold" if worst else "rms of the units"
        return draw_misses(self.misses, line, *marks, named=named, fresh=fresh, ax=ax)

    def __repr__(self) -> str:
        K, m = self.u.shape
        N = show.number_of(self.units.size, "unit")
        what, miss = "largest miss", self.threshold
        if self.risk == "mean":
            what, miss = "rms miss", self._rms
        less = f" without {len(self.removed)}" if self.removed else ""
        return (
            f"<FleetPlan {self.risk}: {N}, {show.number_of(K)}, m={m}, {self.status}, {what} "
            f"{miss:.4g}{less}, gap {self.gap if self.gap > ROUNDING else 0.0:.1g}>"
        )


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
    fleet, within, weights = read_systems(systems), as_limits(limits), as_cost(cost)
    n, m = fleet.n, fleet.m
    if within.x is not None and within.soft is not False:
        raise InputError(f"`soft` must be False for a fleet, got {validation.show(within.soft)}")
    labels = fleet.labels or default_labels(n, m)
    if weights.R is not None:
        weight("R", weights.R, m, labels=labels.inputs)
    names = labels.states
    goal = None
    if weights.reference is None:
        goal = validation.vector("xf", xf, length=n, labels=names)
    K = validation.size("steps", steps, maximum=2**31 // m)
    task = read_task(n, m, K, goal, within, weights, labels)
    units = Units(fleet, validation.starts(x0, fleet.size, n, names), task)
    validation.choice("risk", risk, get_args(Risk))
    out = validation.size("discard", discard, minimum=0, maximum=max(0, units.size - 1))
    limit = None if time_limit is None else validation.positive("time_limit", time_limit)
    running.need("a command for a fleet", 8 * MATRICES * (task.low.size + 1) ** 2)
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
    left = tuple(support), tuple(removed)
    numbers = *units.misses(u), value, lower_bound, status
    return FleetPlan(u, risk, *numbers, *left, units, R, widest, out, missing)


Systems: TypeAlias = "SystemEnsemble | Sequence[System | Identified | Any]"


class Units(Record):
    """Units ``x_s(k+1) = A_s x_s(k) + B_s u(k) + c_s``, and where they shall go.

    Attributes
    ----------
    systems : SystemEnsemble
        The units.
    x0 : ndarray, shape (N, n) or (1, n)
        Where they begin; one row: all at the same place.
    task : Task
        What is wanted of all, and the limits.
    """

    systems: SystemEnsemble
    x0: Floats
    task: Task

    def _check(self) -> None:
        N, n, task = self.systems.size, self.systems.n, self.task
        if validation.kept("x0", self.x0, ndim=(2,)).shape not in ((1, n), (N, n)):
            raise ShapeError(f"`x0` must have shape ({n},) or ({N}, {n}), got {self.x0.shape}")
        require_shapes(task, low=(task.steps, self.systems.m), reference=(task.steps, n))

    @property
    def size(self) -> int:
        """The number of units N."""
        return self.systems.size

    @property
    def arrays(self) -> tuple[Floats, Floats, Floats | None, Floats]:
        """What the core takes."""
        s = self.systems
        return s.A, s.B, s.c, self.x0

    def rows(self) -> Floats:
        """All numbers of each unit, with where it begins, in one row."""
        s, N = self.systems, self.size
        c = np.zeros((N, s.n)) if s.c is None else s.c
        x0 = np.broadcast_to(self.x0, (N, s.n))
        return np.hstack([s.A.reshape(N, -1), s.B.reshape(N, -1), c, x0])

    def of_design(self, design: Units) -> int:
        """How many of these units are among those of the design, but for rounding.

        Of a law that draws equal units, fresh ones may be equal to some of the design; there only
        the design as a whole is refused.
        """
        mine, theirs = self.rows(), design.rows()
        if len(np.unique(theirs, axis=0)) == design.size:
            return shared(theirs, mine)
        return self.size if sorted(mine.tolist()) == sorted(theirs.tolist()) else 0

    def misses(self, u: Floats) -> tuple[Floats, Floats]:
        """The miss of every unit (N,), and by how much it leaves limits of states, else 0."""
        return _core.fleet_misses(self.arrays, self.task, u, get_num_threads())


def read_systems(systems: Systems) -> SystemEnsemble:
    """Units as one record; models that are no units are refused."""
    if not isinstance(systems, SystemEnsemble):
        return ensemble_of("systems", validation.items("systems", systems))
    if systems.centre == "estimate":
        raise InputError(
            "`systems` scatter about an estimate, as drawn models of one plant do: they are no "
            "units of a fleet, and no risk of that plant follows; use control(model, ...), or "
            "SystemEnsemble(A, B) if these are units"
        )
    return systems
