"""`predict`: where a model from data says that given inputs lead, as a plan with its bounds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import validation
from ..certificates.model_basis import ModelBasis
from ..certificates.region_errors import trajectory
from ..exceptions import InputError, InputTypeError, NonFiniteError
from ..identification.identified import Identified
from ..identification.model import Model
from ..theory.exact import best_control
from .model_control import beyond_data
from .output_control import start_of
from .plan import Plan
from .uncertain import Uncertain

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .output_control import Record


def predict(
    model: Identified,
    x0: ArrayLike | Uncertain | None = None,
    inputs: ArrayLike | None = None,
    *,
    record: Record | None = None,
) -> Plan:
    """Predict the states, or readings, under given inputs, as those of a run that was kept apart.

    Parameters
    ----------
    model : Model or another model from data
        The model, with its regions.
    x0 : array_like, shape (n,), or Uncertain
        The initial state; for a model of states only.
    inputs : array_like, shape (K, m)
        The inputs, one row per step; required. They may be chosen after the data of the model, and
        those of a run that was kept apart may come from a feedback.
    record : (outputs, inputs)
        For a model of outputs, in place of x0: what was read before the first of `inputs`, as for
        `control`. `Window.stretches` cuts runs that were kept apart.

    Returns
    -------
    Plan
        With these inputs as its control, and as its target where the model ends; of outputs the
        predicted ones, at each step. `Plan.bound` has the tube that contains the true states, or
        the readings, `Plan.plot` draws it.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used, or the predicted states overflow.

    Notes
    -----
    The tube holds for all inputs at once, also for those that react to what is read, as the noise
    of each step is independent of what was before it. The run must have no part in the model.

    Examples
    --------
    >>> import numpy as np, stochens_rs as se
    >>> z = np.random.default_rng(1).standard_normal((40, 3))
    >>> x_next = 0.5 * z[:, :1] + z[:, 1:2] + 0.01 * z[:, 2:]
    >>> data = se.Trajectories.from_pairs(z[:, :1], z[:, 1:2], x_next)
    >>> model = se.identify(data, sigma=0.01)
    >>> plan = se.predict(model, [1.0], [[0.0], [1.0]])
    >>> plan.predicted_states.round(1).ravel()
    array([1. , 0.5, 1.3])
    >>> plan.bound().state < 0.03
    True
    """
    if not isinstance(model, Identified):
        raise InputTypeError(f"`model` must be a model from data, got {validation.show(model)}")
    (n, m), known = model.B.shape, _start(model, x0, record)
    start = known["x0"]
    u = validation.inputs("inputs", inputs, cols=m, empty=False, labels=model.input_names).copy()
    path = trajectory(model._Theta, start, u)
    if not np.isfinite(path).all():
        raise NonFiniteError("the predicted states overflow: give fewer or smaller `inputs`")
    drift = trajectory(model._Theta, np.zeros(n), np.zeros_like(u))[-1]
    best = best_control(model.A, model.B, start, path[-1] - drift, len(u))
    exact = {"method": "exact", "size": None}
    info = {
        "x0": exact,
        "xf": exact,
        "A": {"method": "from data", "size": None},
        "warnings": (*beyond_data(model, path, u), *model.warnings),
    }
    basis = ModelBasis(model, xf=path[-1].copy(), given=True, **known)
    reachability = best.reachability()
    names: Any = {"labels": model.labels, "dt": model.dt}
    return Plan(u, path, reachability, "product", "completed", info, basis, **names)


def _start(model: Identified, x0: Any, record: Any) -> dict[str, Any]:
    """What a plan keeps of where it starts."""
    if isinstance(model, Model) and model.window is not None:
        if x0 is not None:
            raise InputError(
                "`x0` must be left out for a model of outputs: it starts from `record`"
            )
        start = start_of(model, record)
        return {"x0": start.x, "read": start.read, "at_rest": start.at_rest}
    if record is not None:
        raise InputError("`record` must be left out: it is for models of outputs")
    if x0 is None:
        raise InputError("`x0` must be the initial state, got None")
    off, given = (x0.radius, x0.values) if isinstance(x0, Uncertain) else (0.0, x0)
    x = validation.vector("x0", given, length=len(model.A), labels=model.state_names).copy()
    return {"x0": x, "x0_error": off}
