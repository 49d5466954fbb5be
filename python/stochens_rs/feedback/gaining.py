"""`gain`: a linear feedback for a system or a model from data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _core
from .._base import validation
from .._base.records import trusted
from .._base.weights import weight
from ..exceptions import InputError
from ..identification.identified import Identified
from ..identification.model import Model
from ..system import System
from .loop import GainMethod, Loop, region_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..identification.region import Region


def gain(
    system: System | Identified | Any,
    Q: ArrayLike | None = None,
    R: ArrayLike | None = None,
    *,
    guarantee: float | Region | None = None,
) -> Loop:
    """Compute a linear feedback ``u = K x``, with the plus sign.

    Parameters
    ----------
    system : System or model
        A System, anything `System.from_any` takes, or a model from data.
    Q : float or array_like, shape (n,) or (n, n), optional
        Weight of the states, >= 0: a number, a diagonal or a matrix. Q and R together, or neither.
        For a model of outputs also of these alone, of shape (n_outputs,) or (n_outputs,
        n_outputs): of the readings now, or of the first filters; a number is that, too.
    R : float or array_like, shape (m,) or (m, m), optional
        Weight of the inputs, > 0.
    guarantee : float or Region, optional
        For a model, with Q and R: the least cost that is guaranteed for all systems of
        ``model.region(guarantee)``, in place of the least cost of the model. Without Q and R, where
        the default is 0.05: the widest margin in that region.

    Returns
    -------
    Loop
        K with its cost and eigenvalues; `Loop.certificate` says what is certain of it.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the model is one over several steps; or the region is that
        of a system without weights.
    SolverError
        If there is none: the inputs do not move a mode of A that does not decay, or Q gives no
        weight to one on the unit circle; it is named with its largest states. Or rounding decides.

    Notes
    -----
    Without `guarantee`: ``K = -(R + B'SB)^-1 B'SA`` with ``S = Q + A'S (I + B R^-1 B'S)^-1 A``, the
    least cost of all gains that stabilise, by a structure-preserving doubling and steps of Newton
    (Hewer 1971) in balanced units. ``control.dlqr`` has the other sign, ``u = -K x``.

    With it: ``x'Sx`` bounds the cost of every system in the region from x; S has the least sum of
    ``S_ii / Q_ii``, over states with a weight, of all that a quadratic Lyapunov function and one
    multiplier prove, and by the matrix S-lemma no such function proves less (Petersen and McFarlane
    1994; van Waarde, Camlibel and Mesbahi 2022). The widest margin is that at 9/10 of the largest
    region for which there is a gain.

    Examples
    --------
    >>> import stochens_rs as se
    >>> loop = se.gain(([[1.2]], [[1.0]]), Q=1.0, R=1.0)
    >>> loop.K.round(4), abs(loop.E[0]).round(4)
    (array([[-0.7935]]), np.float64(0.4065))
    """
    model = system if isinstance(system, Identified) else None
    known = System.from_any(system) if model is None else model
    A, B = (np.ascontiguousarray(matrix) for matrix in (known.A, known.B))
    n, m = B.shape
    if isinstance(model, Model) and model.data.steps > 1:
        raise InputError("`system` must be a model of one step: one over K steps has no feedback")
    if (Q is None) != (R is None):
        raise InputError("`Q` and `R` must be given both or neither")
    if model is None and (guarantee is not None or Q is None):
        raise InputError(
            "`guarantee` and a gain without `Q` and `R` need a model from data, which has a region"
        )
    region = None
    method: GainMethod = "least squares"
    if model is not None and (guarantee is not None or Q is None):
        region = region_of("guarantee", model, 0.05 if guarantee is None else guarantee)
    if Q is None or R is None:
        assert region is not None
        K, S, parameter = _core.widest_gain(region._core)
        method = "widest margin"
    else:
        names = known.labels
        weights = (
            weight("Q", for_outputs(model, Q), n, labels=names.states),
            weight("R", R, m, positive=True, labels=names.inputs),
        )
        if region is None:
            K, S, parameter = _core.feedback_gain(A, B, *weights, names.states)
        else:
            K, S, parameter = _core.guaranteed_gain(region._core, *weights, states=names.states)
            method = "guaranteed cost"
    return trusted(
        Loop,
        A=validation.frozen(A),
        B=validation.frozen(B),
        K=validation.frozen(K),
        S=None if S is None else validation.frozen(S),
        method=method,
        parameter=None if method == "least squares" else parameter,
        labels=known.labels,
        dt=known.dt,
        model=model,
    )


def for_outputs(model: object, value: ArrayLike) -> ArrayLike:
    """Return a weight of the outputs of a model as one of its states, others as they are."""
    if not isinstance(model, Model) or model.window is None:
        return value
    n, p = model.n, model.n_outputs
    given = validation.read("Q", value)
    if given.ndim and given.shape[-1] != p:
        return value
    padded = np.zeros((n, n))
    padded[:p, :p] = weight("Q", value, p)
    return padded
