"""`design`: the inputs of the next runs that bring the certificate of a plan down fastest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from .. import _core
from .._base import running, show, validation
from .._base.records import Probability, SavedRecord
from .._base.types import DELTA, Floats
from ..certificates.of_model import ModelBasis
from ..exceptions import InputError
from ..identification.model import Model
from ..limits.limits import as_limits
from ..limits.problem import sides
from ..rng import as_key
from .plan import Plan

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..limits.limits import LimitsLike
    from ..rng import RngLike


@dataclass(frozen=True, eq=False, repr=False)
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
        Where the runs begin; default: the mean of the starts of the measured runs.
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
    model._require_states("plan.model")
    if model.pilot is not None:
        raise InputError(
            "`plan` must be for a model without a pilot: inputs chosen from its runs are not "
            "independent of their noise; plan by the pilot, and let it be that of the next runs"
        )
    if model.design != "adaptive":
        raise InputError(
            "`plan` must be for a model with design='adaptive': inputs that follow from earlier "
            "runs are not independent of their noise"
        )
    count = validation.size("runs", runs)
    length = plan.steps if steps is None else validation.size("steps", steps)
    running.need(f"`runs` = {count}: their inputs and starts", 16 * count * (length + model.n))
    low, high = sides("limits", as_limits(limits).only("u").u, length, model.labels)
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise InputError("`limits` must be finite: the best inputs are at them")
    first = model.data.pairs()[0][model.data._pieces.starts()].mean(axis=0)
    given = validation.starts(first if x0 is None else x0, count, model.n, model.labels.states)
    begin = np.ascontiguousarray(np.broadcast_to(given, (count, model.n)))
    white, covariance = model._white(), model.covariance
    if covariance is None:
        raise InputError("`plan` must be for a model with more pairs than unknowns")
    now = plan.bound(delta)
    parts = model._Theta, white, covariance, basis.x0, plan.u
    key = bytes(as_key(rng).child("design"))
    inputs, phi = _core.next_runs(*parts, begin, length, low, high, key)
    falls = np.sqrt(phi / phi[0]) if phi[0] else np.ones(count + 1)
    error = now.parts["model error"]
    fixed = sum(part for name, part in now.parts.items() if name != "model error")
    forecast = fixed + error * falls
    return NextRuns(inputs.reshape(count, length, model.m), begin, forecast, now.delta)
