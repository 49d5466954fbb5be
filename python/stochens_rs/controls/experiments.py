"""How many realizations a given error takes, and which runs to make next."""

from __future__ import annotations

from functools import cache
from html import escape
from math import ceil, inf
from typing import Annotated, Any

import numpy as np

from .. import _core
from .._base import running, show, validation
from .._base.records import Probability, Record, SavedRecord
from .._base.tables import columns
from .._base.types import DELTA, QUANTITIES, ArrayLike, Floats, Fusion, Quantity, smallest_size
from ..certificates.of_model import ModelBasis
from ..exceptions import InputError, SizeError
from ..identification.model import Model, white_of
from ..limits.limits import LimitsLike, as_limits
from ..limits.problem import sides
from ..rng import Key, RngLike, as_key
from ..system.system import System
from ..theory import moments
from ..theory.drawn_bounds import Bounded, not_simulated, runs_for, searched_size
from ..theory.exact import RELATIVE_TO, best_control, checked_ends
from .control import fusion_over
from .plan import Plan


class Requirement(Record, eq=True):
    """The number of realizations that one bound requires, and the errors with that number.

    Attributes
    ----------
    name : str
        Name of the bound.
    size : int or None
        The smallest sufficient number of realizations ("simulated": within 1 to 5 %); None if that
        is above 2^53, or `delta` too small to simulate.
    rms : float or None
        Exact root mean square error at `size`; None over several steps.
    quantile : float or None
        The ``1 - delta`` quantile of the simulated errors at `size`.
    failures : int or None
        Number of simulated errors above `error`.
    """

    name: str
    size: int | None
    rms: float | None
    quantile: float | None
    failures: int | None


class SamplePlan(Record):
    """Numbers of realizations for a given error; what `required_samples` returns.

    Attributes
    ----------
    error : float
        The error that may be exceeded with probability `delta`, absolute.
    delta : float
        The probability of failure.
    reference : float
        The norm that a relative error is divided by.
    relative_to : str
        The vector with that norm, as in `PlanError`: "x_actual", the state that the exact control
        leads to, or if that is zero "x0"; for the control "v", the exact one, or if that is zero
        "B^+ A x0", which takes x0 to the origin; "nothing" if all of these are zero.
    quantity, fusion : str
        As given.
    steps : int
        Number of steps K.
    rows : tuple of Requirement
        One per bound, smallest size first. All hold; use the first.
    expected_size : int or None
        Smallest size whose exact root mean square error is at most `error`: no guarantee. None
        over several steps.
    simulated_size : int
        The size needed in the simulation (no guarantee): there a share `delta` of the simulated
        errors exceeds `error`.
    runs : int
        Simulated fusions per size.
    key : Key
        The key of the simulation.
    """

    error: float
    delta: float
    reference: float
    relative_to: str
    quantity: str
    fusion: str
    steps: int
    rows: tuple[Requirement, ...]
    expected_size: int | None
    simulated_size: int
    runs: int
    key: Key

    @property
    def size(self) -> int:
        """The smallest size that a bound guarantees."""
        smallest = self.rows[0].size
        if smallest is None:
            raise SizeError("no bound is satisfied by up to 2^53 realizations")
        return smallest

    def _repr_html_(self) -> str:
        return show.card(self, [], f"<pre>{escape(str(self))}</pre>")

    def __str__(self) -> str:
        over = "" if self.steps == 1 else f" over {show.number_of(self.steps)}"
        text = f"error of the {self.quantity}{over}: at most {self.error:.3g}"
        if self.relative_to in RELATIVE_TO:
            share = 100 * self.error / self.reference
            of = f"{self.reference:.3g}, the norm of {RELATIVE_TO[self.relative_to]}"
            text += f" ({share:.3g} % of {of})"
        rows = [["bound", "N", "exact rms", "quantile", "failures"]]
        for row in self.rows:
            cells = ["none up to 2^53", "", "", ""]
            if row.size is not None:
                rms = "" if row.rms is None else f"{row.rms:.3g}"
                failed = f"{row.failures} of {self.runs}"
                cells = [_grouped(row.size), rms, f"{row.quantile:.3g}", failed]
            rows.append([row.name, *cells])
        lines = [f"{text},", f"with probability {1.0 - self.delta:g}, {self.fusion} fusion", ""]
        lines += [*columns(rows, 100), "", "no guarantee:"]
        if self.expected_size is not None:
            size = _grouped(self.expected_size)
            lines.append(f"the exact rms comes down to this error at N = {size},")
        return "\n".join([*lines, f"the simulated quantile at N = {_grouped(self.simulated_size)}"])


def _grouped(size: int) -> str:
    """A number with spaces between the thousands."""
    return f"{size:,}".replace(",", " ")


_START = 1000  # size at which a search starts if no bound has one
_RUNS = 1000  # simulated fusions per bound, for its quantile and failures
_STEPS = 3  # q falls nearly like N^-1/2, so that few steps are enough


def required_samples(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    error: float,
    *,
    steps: int = 1,
    delta: float = DELTA,
    relative: bool = True,
    quantity: Quantity = "state",
    fusion: Fusion = "product",
    rng: RngLike = None,
) -> SamplePlan:
    """Find how many realizations of x0, xf and A give a control of a given accuracy.

    Parameters
    ----------
    system : System
        The exact (or nominal) system, or anything `System.from_any` takes.
    x0, xf : array_like, shape (n,)
        Initial state and target.
    error : float
        The error that may be exceeded with probability `delta`.
    steps : int, default 1
        Number of steps K of the control.
    delta : float, default 0.05
        Probability of failure, in (0, 1).
    relative : bool, default True
        Whether `error` is relative to the norm of the state that the exact control leads to; if
        that is zero, to the norm of x0. For "control": to the norm of the exact control; if that is
        zero, to that of the control that takes x0 to the origin. See `SamplePlan.relative_to`.
    quantity : {"state", "control"}, default "state"
        ``||B (u - v)||``, the distance from the state that the exact control ``v`` leads to, or
        ``||u - v||``; over several steps with ``C_K`` in place of ``B``.
    fusion : {"product", "diagonal"}, default "product"
        How the realizations are fused, with uniform weights; "diagonal" for one step only.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
        Source of randomness for the simulation.

    Returns
    -------
    SamplePlan
        For every bound the number of realizations, with the exact and the simulated error there.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.

    Notes
    -----
    The bounds are those of `theory.drawn_bound`, the exact root mean square is that of
    `theory.moments`. "simulated" is within a few percent of what is needed, a tenth where its draws
    are slow and `delta` is small; the formulas hold for every delta. Over several steps "simulated"
    is the only bound. The simulation draws counts, not realizations: its cost does not depend on N.

    Within limits of the inputs, over one step, the sizes for an absolute error of the state hold as
    they are: ``||B (u - v)||`` with the best v within them is at most
    ``||B B^+ (b_hat - b)||``, ``b = xf - A x0``, the error without limits, for every weight R >= 0
    and Q = I: for u, v the best of two targets ``||B (u - v)||^2 + ||u - v||_R^2 <=
    <B (u - v), b_hat - b>``. Over several steps A changes the map from inputs to states, and no
    size is known.

    Examples
    --------
    >>> import stochens_rs as se
    >>> system = se.System([[0.9, 0.2], [-0.1, 0.8]], [[1.0, 0.0], [0.5, 1.0]])
    >>> plan = se.required_samples(system, [1.0, 2.0], [1.0, 1.0], 0.1, rng=1)
    >>> plan.simulated_size < plan.size, plan.rows[0].name
    (True, 'simulated')
    """
    checked, start, goal = checked_ends(system, x0, xf)
    error = validation.positive("error", error)
    delta = validation.probability("delta", delta)
    kind = validation.choice("quantity", quantity, QUANTITIES)
    K, how = fusion_over(steps, fusion, checked.n, checked.m)
    key = as_key(rng)
    best = best_control(checked.A, checked.B, start, goal, K)
    relative_to, reference = best.compared(kind, start)
    if validation.flag("relative", relative):
        if not reference:
            raise InputError(
                f"`error` cannot be relative here: the exact {kind} is zero (use relative=False)"
            )
        error *= reference
    rms_of = moments.control_rms if kind == "control" else moments.state_rms

    def rms(size: int) -> float:
        return rms_of(checked, start, goal, size, fusion=how)

    rms(1)  # refuses what overflows
    if error * error < np.finfo(np.float64).tiny:
        raise SizeError(f"`error` is {error:.3g}, its square underflows: scale the problem up")
    of = Bounded(kind, (checked, start, goal), fusion=how, steps=K)
    which, bound_key = of.which, key.child("bound").child("simulated bound")
    cost = of.law((1, 1, 1)).cost
    possible = runs_for(delta, cost) is not None
    if K > 1 and not possible:  # the only bound
        raise SizeError(not_simulated(delta, cost))

    @cache
    def drawn(size: int) -> tuple[float, int]:
        """The quantile of the simulated errors, and how many exceed the error."""
        errors = of.law((size,) * 3).draw(_RUNS, key.child("runs"))[:, which]
        return float(np.quantile(errors, 1.0 - delta)), int((errors > error).sum())

    rows = []
    # what the rounding of a control like the exact one leaves of the error
    left = error - (best.control_rounding if kind == "control" else best.state_rounding)
    for name in ("simulated", *of.names((1, 1, 1))):
        size = None
        if left > 0.0 and name != "simulated":
            size = of.required_size(name, left, delta)
        elif left > 0.0 and possible:
            size = searched_size(lambda N: of.law((N,) * 3), which, left, delta, bound_key)
        if size is None:
            rows.append(Requirement(name, None, None, None, None))
        else:
            exact = rms(size) if K == 1 else None
            rows.append(Requirement(name, size, exact, *drawn(size)))
    rows.sort(key=lambda row: inf if row.size is None else row.size)
    expected = smallest_size(lambda N: rms(N) <= error) if K == 1 else None
    if K == 1 and expected is None:
        raise SizeError("`error` is so small that more than 2^53 realizations are needed")
    needed = rows[0].size or expected or _START
    for _ in range(_STEPS):  # N <- N share^2, at which the simulated quantile is the error
        share = drawn(needed)[0] / error
        needed = int(min(max(1, ceil(needed * share**2)), validation.EXACT))
    return SamplePlan(
        error=error,
        delta=delta,
        reference=reference,
        relative_to=relative_to,
        quantity=kind,
        fusion=how,
        steps=K,
        rows=tuple(rows),
        expected_size=expected,
        simulated_size=needed,
        runs=_RUNS,
        key=key,
    )


class NextRuns(SavedRecord):
    """Inputs of runs to come, and what the certificate may be after them: a forecast, not a bound.

    Made by `design`.

    Attributes
    ----------
    inputs : ndarray, shape (runs, L, m)
        ``inputs[r, k]`` acts in run r in the step from k to k + 1.
    starts : ndarray, shape (runs, n)
        The states from which the runs were assumed to begin.
    forecast : ndarray, shape (runs + 1,)
        What ``plan.bound(delta).target`` may be with the first r of these runs added to the data;
        ``forecast[0]`` is what it is now.
    delta : float
        That of the certificate.
    """

    inputs: Annotated[Floats, "run step input"]
    starts: Annotated[Floats, "run state"]
    forecast: Annotated[Floats, "run+1", "infinite"]
    delta: Probability

    def __repr__(self) -> str:
        runs, L, _ = self.inputs.shape
        now, after = self.forecast[[0, -1]]
        return (
            f"<NextRuns: {show.number_of(runs, 'run')} of {show.number_of(L)}, certificate "
            f"{now:.3g} now, {after:.3g} after them (forecast, not a bound)>"
        )


def design(
    plan: Plan,
    runs: int,
    *,
    limits: LimitsLike,
    steps: int | None = None,
    x0: ArrayLike | None = None,
    delta: float = DELTA,
    rng: RngLike = 0,
) -> NextRuns:
    """Choose the inputs of the next runs that make the certificate of this plan smallest.

    Parameters
    ----------
    plan : Plan
        What the runs are for: a plan for a model by `identify`, of the default design.
    runs : int
        Their number.
    limits : tuple (low, high)
        Limits of the inputs, each a number, (m,) or (steps, m), all finite. The inputs are at them.
    steps : int, optional
        The steps L of a run; default: those of the plan.
    x0 : array_like, shape (n,) or (runs, n), optional
        Where the runs begin; default: the mean of the starts of the measured runs. For a model of
        outputs left out: the runs begin at rest, at the mean of the readings and inputs.
    delta : float, default 0.05
        Of the certificate that is forecast.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, default 0
        Source of the inputs from which the search begins.

    Returns
    -------
    NextRuns
        ``inputs``, and the ``forecast`` after each run.

    Raises
    ------
    InputError, InputTypeError
        If the model was not made by `identify` with ``design="adaptive"`` from single steps of
        exact states, does not determine where the plan leads, or has no covariance of the noise;
        or if an argument cannot be used.

    Notes
    -----
    In first order the error of the plan is ``||sum_j A^{K-1-j} Sigma^1/2 G V^-1/2 z_j||``, G
    standard normal, of mean square ``phi = tr Psi V^-1`` with ``Psi = sum_jk tr(A^{K-1-j} Sigma
    A^{K-1-k}') z_j z_k'``. Run after run, ``sum_k z_k' V^-1 Psi V^-1 z_k`` is maximised over its
    inputs, V with all runs before it: Frank and Wolfe's method for phi, which is convex. The model
    stands for the system. The forecast multiplies the part of the certificate that is the error of
    the model by ``sqrt(phi / phi(0))``. With few runs, where higher orders prevail, the certificate
    falls faster.

    The inputs depend on the noise of the earlier runs: identify all runs together with
    ``design="adaptive"``, the default, whose regions allow that.

    Examples
    --------
    >>> import numpy as np, stochens_rs as se
    >>> rng = np.random.default_rng(1)
    >>> x, u = np.zeros((5, 9, 1)), rng.uniform(-1.0, 1.0, (5, 8, 1))
    >>> for k in range(8):
    ...     x[:, k + 1] = 0.9 * x[:, k] + u[:, k] + 0.1 * rng.standard_normal((5, 1))
    >>> model = se.identify(se.Trajectories(x, u), noise=0.1)
    >>> plan = se.control(model, [1.0], [0.0], steps=3)
    >>> more = se.design(plan, 10, limits=(-1.0, 1.0))
    >>> more.inputs.shape
    (10, 3, 1)
    >>> more
    <NextRuns: 10 runs of 3 steps, certificate 0.16 now, 0.0936 after them (forecast, not a bound)>
    """
    basis = validation.instance("plan", plan, Plan).basis
    if not (isinstance(basis, ModelBasis) and isinstance(basis.model, Model)):
        raise InputError("`plan` must be for a model by `identify`")
    model = basis.model
    if model.pilot is not None:
        raise InputError(
            "`plan` must be for a model without a pilot: inputs would follow its noise"
        )
    if model.design != "adaptive":
        raise InputError(
            "`plan` must be for a model with design='adaptive': inputs would follow its noise"
        )
    count = validation.size("runs", runs)
    length = plan.steps if steps is None else validation.size("steps", steps)
    running.need(f"`runs` = {count}: their inputs and starts", 16 * count * (length + model.n))
    low, high = sides("limits", as_limits(limits).only("u").u, length, model.labels)
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise InputError("`limits` must be finite: the best inputs are at them")
    white, covariance, window = white_of(model, windows=True), model.covariance, model.window
    if covariance is None:
        raise InputError("`plan` must be for a model with more pairs than unknowns")
    if window is None:
        first = model.data.pairs()[0][model.data.layout.starts()].mean(axis=0)
    else:
        if x0 is not None:
            raise InputError("`x0` must be left out for a model of outputs: runs begin at rest")
        read, acted = (one.mean(axis=0) for one in model.data.pairs()[:2])
        first = window.core.rest(model.coefficients, read, acted)[0]
        J, _, G = model.loop  # z = J (x, u, 1), and the noise moves the window by G w
        white = np.ascontiguousarray(white @ J)
        covariance = np.ascontiguousarray(G @ covariance @ G.T)
    given = validation.starts(first if x0 is None else x0, count, model.n, model.labels.states)
    begin = np.ascontiguousarray(np.broadcast_to(given, (count, model.n)))
    now = plan.bound(delta)
    parts = model.Theta, white, covariance, basis.x0, plan.u
    key = bytes(as_key(rng).child("design"))
    inputs, phi = _core.next_runs(*parts, begin, length, low, high, key)
    falls = np.sqrt(phi / phi[0]) if phi[0] else np.ones(count + 1)
    error = now.parts["model error"]
    fixed = sum(part for name, part in now.parts.items() if name != "model error")
    forecast = fixed + error * falls
    return NextRuns(inputs.reshape(count, length, model.m), begin, forecast, now.delta)
