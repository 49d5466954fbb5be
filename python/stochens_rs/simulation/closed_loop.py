"""Tracking a reference with a fresh estimate of A in every step, or with a controller."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from copy import deepcopy
from dataclasses import KW_ONLY, dataclass, field
from typing import Annotated, Any, TypeAlias

import numpy as np

from .. import _core
from .._base import running, show, validation
from .._base.names import order_of
from .._base.records import SavedRecord
from .._base.tables import Tabled
from .._base.types import ArrayLike, Axes, Floats, Status, worst
from ..exceptions import InputError, InputTypeError, NonFiniteError, ShapeError
from ..feedback import Loop
from ..fusion.fusing import METHODS, Method
from ..loops import Regulator
from ..plots.lines import draw_tracking
from ..rng import Key, RngLike, as_key
from ..system.system import System
from ..theory.exact import REACHABLE, factors
from .trajectory import columns

# states (R, K + 1, n), inputs (R, K, m), how the computations ended, and what made them
Driven: TypeAlias = tuple[Floats, Floats, Status, dict[str, Any]]


@dataclass(frozen=True)
class StepEstimate:
    """A `controller` of `track` that estimates A anew in every step, from B and realizations of A.

    Parameters
    ----------
    size : int
        Number of realizations N in every step.
    method : str, default "uniform"
        As in `fuse`; the least-squares methods fit to the exact entity, as in the paper's analysis.
        "uniform" draws counts instead of realizations: O(n^2) a step for every `size`.
    feedback : bool, default True
        Whether the control uses the measured state ``x(k)``, or ``r(k)`` in its place, as in
        section 5.2 of the paper: errors then accumulate.
    sample_states : bool, default False
        Whether ``x(k)`` (without feedback ``r(k)``) and ``r(k+1)`` are sampled too, with N
        realizations each and product fusion.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used.

    Examples
    --------
    >>> import stochens_rs as se
    >>> se.StepEstimate(100, feedback=False)
    StepEstimate(size=100, method='uniform', feedback=False, sample_states=False)
    """

    size: int
    method: Method = "uniform"
    _: KW_ONLY
    feedback: bool = True
    sample_states: bool = False

    def __post_init__(self) -> None:
        validation.size("size", self.size)
        validation.choice("method", self.method, METHODS)
        for name in ("feedback", "sample_states"):
            validation.flag(name, getattr(self, name))


class Tracking(SavedRecord, Tabled):
    """A reference, and the trajectories of a system that tracks it.

    With `runs` given, `states`, `inputs` and `errors` have the runs as their first axis.

    Attributes
    ----------
    states : ndarray, shape (K + 1, n) or (R, K + 1, n)
        ``x(k)``, of the exact system under the computed controls.
    inputs : ndarray, shape (K, m) or (R, K, m)
        ``u(k)``, acting in the step from k to k + 1.
    errors : ndarray, shape (K + 1,) or (R, K + 1)
        ``||x(k) - r(k)||_2``.
    reference : ndarray, shape (K + 1, n)
        ``r(k)``.
    residuals : ndarray, shape (K,)
        ``||(I - B B^+)(r(k+1) - A r(k))||_2``: the part of each step that no control reaches.
    feasible : bool
        Whether each residual is at most 1.5e-8 of ``||r(k+1)|| + ||A r(k)||``.
    key : Key
        The key of the draws.
    status : str
        The worst status among the fits, or the calls of a `Regulator`; "completed" if nothing was
        optimised.
    info : dict
        "method", "size", "feedback", "sample_states" and "runs" (None or R). With a controller in
        their place "controller" (the name of its type), "noise" (n,), and for a `Regulator`
        "limits" (low, high), each (m,), and "statuses" with the number of calls of each.
    """

    states: Annotated[Floats, "run step+1 state"]
    inputs: Annotated[Floats, "run step input"]
    errors: Annotated[Floats, "run step+1", "own unit"]
    reference: Annotated[Floats, "step+1 state"]
    residuals: Annotated[Floats, "step", "own unit"]
    feasible: bool
    key: Key
    status: Status
    info: dict[str, Any] = field(default_factory=dict)

    def _check(self) -> None:
        if not self.inputs.size:
            raise ShapeError(f"`inputs` must have a step and an input, got {self.inputs.shape}")

    @property
    def mean_square(self) -> Floats:
        """``||x(k) - r(k)||^2`` averaged over the runs, shape (K + 1,)."""
        with np.errstate(over="ignore"):
            squares = self.errors.reshape(-1, self.errors.shape[-1]) ** 2
        return np.asarray(squares.mean(axis=0), dtype=np.float64)

    def __repr__(self) -> str:
        K, m = self.inputs.shape[-2:]
        times = "" if self.states.ndim == 2 else f"{len(self.states)} runs of "
        last = float(np.sqrt(self.mean_square[-1]))
        feasible = "" if self.feasible else ", reference not feasible"
        return (
            f"<Tracking: {times}{show.number_of(K)}, m={m}, {self.status}, last error "
            f"{last:.3g}{feasible}>"
        )

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Draw the distance from the reference over the steps, root mean square over the runs.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw, as for `Trajectory.plot`.

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        ImportError
            matplotlib is not installed.

        Examples
        --------
        >>> import stochens_rs as se
        >>> run = se.track(([[0.5]], [[1.0]]), [[0.0], [1.0], [2.0]], 100, rng=1)
        >>> run.plot().get_xlabel()
        'step k'
        """
        distance, several = np.sqrt(self.mean_square), self.states.ndim == 3
        return draw_tracking(distance, self.residuals, averaged=several, ax=ax)

    def _repr_html_(self) -> str:
        distance, rms = np.sqrt(self.mean_square), " (rms)" * (self.states.ndim == 3)
        rows = [
            *((name.replace("_", " "), value) for name, value in self.info.items()),
            (f"off by{rms}", f"{distance[-1]:.4g} at the end, {distance.max():.4g} at most"),
            ("out of reach in one step", f"{self.residuals.max():.4g} at most"),
        ]
        about = f"distance from the reference{rms} over the steps"
        return show.card(self, rows, show.lines(np.arange(len(distance)), [distance], about))


def track(
    system: System | Any,
    reference: ArrayLike,
    controller: int | StepEstimate | Regulator | Callable[[Floats], ArrayLike],
    *,
    noise: ArrayLike | None = None,
    x0: ArrayLike | None = None,
    rng: RngLike = None,
    runs: int | None = None,
) -> Tracking:
    """Simulate the tracking of a reference, by a new estimate of A in every step or a controller.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes; it is simulated exactly.
    reference : array_like, shape (K + 1, n)
        The states ``r(0), ..., r(K)`` to track; K >= 1.
    controller : int, StepEstimate, Regulator or callable
        A number N: ``StepEstimate(N)``, controls by a new estimate of A in every step. Else ``u(k)
        = controller(x(k))``, for example what `regulate` makes. With `runs` every run begins
        with a copy of the Regulator; without, it goes on itself, and its log has the run. One with
        the names of `system` in another order gets the states in its own order. Another callable is
        called as it is.
    noise : float or array_like, shape (n,), optional
        With a Regulator or callable: standard deviations of Gaussian noise w(k), added to every
        x(k + 1).
    x0 : array_like, shape (n,), optional
        The initial state; ``r(0)`` by default.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
        Source of randomness. Run i draws from the child "replicate-i" (i = 0 without `runs`), its
        step k from the child "step-k" of that, and the entities from the children "A", "state"
        and "target" of that; `noise` from the child "noise" of the run.
    runs : int, optional
        Number R of independent runs; None: one run, and no axis for runs.

    Returns
    -------
    Tracking
        States, inputs and errors, and whether the reference is feasible.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used, or an error overflows, as it may if N does not exceed the
        threshold of stability. What a controller raises is passed on.
    ResourceError
        If the states do not fit into the memory this process may use.

    Notes
    -----
    ``u(k) = B^+ (r(k+1) - A_hat_k x(k))``, ``x(k+1) = A x(k) + B u(k)``, hence
    ``e(k+1) = (I - P)(A x(k) - r(k+1)) - P (A_hat_k - A) x(k)`` for ``e = x - r``,
    ``P = B B^+``. The closed loop is stable in the mean square if and only
    if N exceeds a threshold; for ``P = I`` that is the spectral radius of
    ``|A_ij| (sum_k |A_kj| - |A_ij|)``. For a reference that is not feasible, each step
    leads as near to ``r(k+1)`` as the estimates allow; see ``residuals``.

    A controller is called in Python, step by step. It has a target of its own: errors are those
    from `reference`.

    Examples
    --------
    >>> import numpy as np, stochens_rs as se
    >>> system = se.System([[0.9, 0.2], [-0.1, 0.8]], [[1.0, 0.0], [0.5, 1.0]])
    >>> reference = np.outer(np.cos(0.3 * np.arange(21)), [1.0, 2.0])
    >>> run = se.track(system, reference, 1000, rng=1, runs=50)
    >>> run.states.shape, run.inputs.shape, run.feasible
    ((50, 21, 2), (50, 20, 2), True)

    Brought to rest within limits, with noise:

    >>> loop = se.regulate(system, 5, limits=(-0.5, 0.5), cost=se.Cost(Q=1.0, R=0.1))
    >>> rest = np.zeros((31, 2))
    >>> run = se.track(system, rest, controller=loop, x0=[2.0, 1.0], noise=0.01, rng=1)
    >>> bool(abs(run.inputs).max() <= 0.5), bool(run.errors[-1] < 0.1), run.info["statuses"]
    (True, True, {'optimal': 30})
    """
    checked = System.from_any(system)
    n, m, names = checked.n, checked.m, checked.state_names
    how: Any = {"cols": n, "rows": "K + 1", "empty": False, "labels": names}
    r = validation.inputs("reference", reference, **how).copy()
    if len(r) < 2:
        raise InputError(f"`reference` must have shape (K + 1, {n}) with K >= 1, got {r.shape}")
    start = r[0] if x0 is None else validation.vector("x0", x0, length=n, labels=names)
    R, K = None if runs is None else validation.size("runs", runs), len(r) - 1
    running.need("the trajectories", (R or 1) * ((K + 1) * (n + 1) + K * m) * 8)
    with np.errstate(over="ignore", invalid="ignore"):
        U = factors(checked.B).U
        d = r[:-1] @ checked.A.T - r[1:]
        d = d - (d @ U) @ U.T  # (I - P)(A r(k) - r(k+1))
        needed = np.linalg.norm(r[1:], axis=1) + np.linalg.norm(r[:-1] @ checked.A.T, axis=1)
    if not (np.isfinite(needed).all() and np.isfinite(d).all()):
        raise NonFiniteError("`A` times `reference` overflows: scale the problem down")
    unit = np.maximum(np.abs(d).max(axis=1), np.finfo(np.float64).tiny)
    residuals = unit * np.linalg.norm(d / unit[:, None], axis=1)
    key, cure = as_key(rng), ""
    if validation.is_real(controller):
        controller = StepEstimate(controller)  # type: ignore[arg-type]
    if isinstance(controller, StepEstimate):
        validation.left_out("with a StepEstimate", noise=noise)
        states, inputs, status, info = _estimated(checked, start, r, controller, key, R)
        cure = ": is `size` above the threshold of stability (see track)?"
    else:
        sigma = validation.deviations("noise", 0.0 if noise is None else noise, n)
        states, inputs, status, info = _controlled(checked, start, K, controller, sigma, key, R)
    with np.errstate(over="ignore"):
        # run by run: NumPy 2.4 ends the process where a broadcast finds no memory for its buffer
        errors = np.array([np.linalg.norm(run - r, axis=1) for run in states])
    lost = np.argwhere(~np.isfinite(errors[:, 1:]))  # the first run comes first
    if lost.size:
        raise NonFiniteError(f"the squared error overflows at step {lost[0, 1] + 1}{cure}")
    first = 0 if R is None else slice(None)  # without `runs`, there is no axis for them
    feasible = bool((residuals <= REACHABLE * needed).all())
    found = states[first], inputs[first], errors[first], r, residuals, feasible
    return Tracking(*found, key, status, {**info, "runs": R})


def _controlled(
    system: System,
    start: Floats,
    K: int,
    controller: Any,
    sigma: Floats,
    key: Key,
    runs: int | None,
) -> Driven:
    """Simulate ``x(k+1) = A x(k) + B u(k) + w(k)`` with ``u(k) = controller(x(k))``."""
    if not callable(controller) or isinstance(controller, type):
        raise InputTypeError(
            "`controller` must be a number of realizations, a StepEstimate or a function, "
            f"u = f(x), got {validation.show(controller)}"
        )
    n, m = system.n, system.m
    labels = controller.labels if isinstance(controller, Loop | Regulator) else None
    sizes = (n, m) if labels is None else (len(labels.states), len(labels.inputs))
    validation.same_sizes("controller", sizes, (n, m), "`system`")
    # what the controller calls by the same names stands where it has it
    order = order_of("system", system.labels, labels)
    back, logged = order.back(), isinstance(controller, Regulator)
    states, inputs = np.empty((runs or 1, K + 1, n)), np.empty((runs or 1, K, m))
    seen: Counter[Status] = Counter()
    for i, (x, u) in enumerate(zip(states, inputs, strict=True)):
        # every run begins with the controller as it was given
        act = deepcopy(controller) if logged and runs is not None else controller
        w = key.child(f"replicate-{i}").child("noise").generator().standard_normal((K, n)) * sigma
        x[0] = start
        for k in range(K):
            found = validation.vector("controller(x)", act(order.of_states(x[k]).copy()), length=m)
            u[k] = back.of_inputs(found)
            if logged:
                seen[act.log[-1].status] += 1
            with np.errstate(over="ignore", invalid="ignore"):
                x[k + 1] = system.A @ x[k] + system.B @ u[k] + w[k]
            if not np.isfinite(x[k + 1]).all():
                raise NonFiniteError(f"the state overflows at step {k + 1} under `controller`")
    info = {
        "controller": type(controller).__name__,
        "limits": tuple(map(back.of_inputs, controller.limits)) if logged else None,
        "statuses": dict(seen),
        "noise": sigma,
    }
    return states, inputs, worst(seen) if seen else "completed", info


def _estimated(
    system: System, start: Floats, r: Floats, how: StepEstimate, key: Key, runs: int | None
) -> Driven:
    """Control by a new estimate of A in every step, in the core."""
    n, m, K, threads = system.n, system.m, len(r) - 1, running.get_num_threads()
    if how.method != "uniform":  # per step: the indices, which have up to 4 bytes, and the weights
        running.need("the realizations of a step", threads * how.size * (4 * n + 24))
    of_B = factors(system.B)
    info = {name: getattr(how, name) for name in ("size", "method", "feedback", "sample_states")}
    states, inputs, optimal = _core.track(
        *columns(system),
        start,
        r,
        (of_B.U.T, of_B.V.T, of_B.s),
        how.size,
        how.method,
        how.feedback,
        how.sample_states,
        runs or 1,
        bytes(key),
        threads,
    )
    best: Status = "optimal" if how.method == "alse" else "completed"
    status = best if optimal else "optimal_inaccurate"
    return states.reshape(-1, K + 1, n), inputs.reshape(-1, K, m), status, info
