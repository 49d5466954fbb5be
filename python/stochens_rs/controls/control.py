"""`control`: the best control for estimates, exact values or a model.

It checks the options; `model_control` has the rest for models from data, `_estimates_control` for
estimates and exact values. Both make a `Plan`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _core
from .._base.records import trusted
from .._base.types import Floats, Fusion, worst
from ..exceptions import InputError
from ..identification.identified import Identified
from ..identification.model import Model
from ..theory.dynamics import states
from ..theory.exact import best, best_control
from .arguments import fusion_over, mean_warnings, problem, step_warnings
from .constraints import checked_task, seconds
from .cost import Cost, as_cost
from .limited import Horizon
from .limits import Limits, as_limits
from .model_control import model_control
from .output_control import output_control
from .plan import Plan
from .provenance import Basis, known
from .uncertain import Uncertain

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..theory.exact import Best
    from .arguments import Entity, EntityLike, SystemLike
    from .limited import Limited
    from .limits import LimitsLike
    from .output_control import Record


def control(
    system: SystemLike | Identified,
    x0: EntityLike | Uncertain | None = None,
    xf: EntityLike | None = None,
    *,
    steps: int = 1,
    limits: LimitsLike = None,
    cost: Cost | None = None,
    fusion: Fusion = "product",
    time_limit: float | None = None,
    record: Record | None = None,
    target: ArrayLike | None = None,
) -> Plan:
    """Compute the best control from x0 to xf in K steps, from estimates, also within limits.

    Without limits and weights it is the smallest one that comes nearest to xf.

    Parameters
    ----------
    system : System or pair (A, B), or Model
        A System, anything `System.from_any` takes, or a pair of A, shape (n, n), and an array B,
        shape (n, m). In the pair A may be a Fit, an Ensemble or Counts. Or a model from measured
        data, as `identify` makes it; x0 and xf are then arrays.
    x0, xf : Fit, Ensemble, Counts or array_like, shape (n,)
        Initial state and target; xf is left out if `cost` has a reference. A Fit or Counts stands
        for its estimate, an Ensemble for its uniform average. An array counts as exact; for an
        estimate of your own pass a Fit; for a model from data x0 may be `Uncertain`.
    steps : int, default 1
        Number of steps K.
    limits : Limits, tuple (low, high) or mapping, optional
        Limits of inputs, of their changes and of states; a pair is for the inputs: each a number,
        (m,) or (K, m), infinite or None where there is none; or ``{"force": (-8, 8)}``.
    cost : Cost, optional
        Weights of states and inputs, and a reference in place of `xf`.
    fusion : {"product", "diagonal"}, default "product"
        "product": the control of the estimates. "diagonal", for one step: the average of the
        controls of the paired realizations, as in the paper; it needs ensembles of equal size (or
        arrays).
    time_limit : float, optional
        The time for the control within limits [s]; the best one so far has status "user_limit".
    record : (outputs, inputs), optional
        For a model of outputs, in place of x0: rows (T, n_outputs) that were read up to now, and
        the inputs (T - 1, m) between them, enough to fill the window of the model; for example
        `Trajectories.last_record`. "rest" declares that outputs and inputs were 0 for so long, and
        ("rest", y, u) that they were these: refused where the data say that they do not stay there.
    target : array_like, shape (n_outputs,), optional
        For a model of outputs, in place of xf: where they are to be, and to stay with a constant
        input; default 0. Weights of `cost` may be of the outputs alone, as in `gain`.

    Returns
    -------
    Plan
        The control, the states it should lead to, and what is out of reach; within limits also
        which are active, what they cost and how far from the best the control can be.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used, fusion="diagonal" is asked for over several steps, or
        something overflows; the message says what.
    ResourceError
        If ``C_K`` or the powers of A do not fit into the memory this process may use.
    SolverError
        If the singular value decomposition of ``C_K`` does not converge.

    Notes
    -----
    ``u = C_K^+ (xf_hat - A_hat^K x0_hat)``; for one step ``C_1 = B``. What no control can reach
    is in ``reachability``: with m < n most targets cannot be reached in one step.

    One step: both fusions have the mean ``B^+ (xf - A x0)``. Product fusion is never worse, in the
    Loewner order of the covariances and for every convex loss; it is the sum over all triples of
    realizations with product weights, evaluated in O(N) (paper, Lemma 3.2, where one index is
    used for three weight vectors).

    Several steps: the control is not linear in A. The estimate is consistent if the exact ``C_K``
    has rank n; the average of controls of realizations would not be. With ``m K = n`` exactly, the
    inverse of the square, estimated ``C_K`` has heavy tails: rare draws give huge controls. Take
    more steps, or regularise; ``info["warnings"]`` says so.

    Limits or weights: ``J(u) = sum_k ||x(k) - r(k)||^2_Q + ||u(k-1)||^2_R`` over k = 1, ..., K,
    with Qf at K, is minimised within the limits. `u` keeps its own limits exactly, rates and hard
    limits of states to rounding; ``rate_active`` and ``state_active`` say where. The gap
    ``J(u) - min J`` is computed from the result, whatever the solver says; "optimal" means that it
    is at most ``1e-9 J(u)``, or rounding. Over many steps of an unstable system the rounding of the
    inputs grows until they no longer lead to the states of the plan: the plan then has a feedback,
    and all that is said of it is of a plan that is followed; see `Plan.open_loop_until`.
    fusion="diagonal" is then the control of the average of ``xf^s - A^s x0^s``: the average of the
    controls within limits would be biased. With R = 0 more than one control may be the best, and
    the one returned need not be the smallest.

    A model from data takes the place of the exact system, its offset c included: ``xf`` less what
    c adds over K steps.

    Examples
    --------
    >>> import numpy as np, stochens_rs as se
    >>> A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[1.0], [0.5]])
    >>> fit = se.fuse(se.sample(A, 500, rng=1), "alse", target=A)
    >>> plan = se.control((fit, B), se.sample([1.0, 2.0], 500, rng=2), [0.0, 0.0], steps=4)
    >>> plan.u.shape, plan.predicted_states.shape, plan.reachability.reachable
    ((4, 1), (5, 2), True)
    >>> z = np.random.default_rng(3).standard_normal((100, 5))
    >>> x, u, w = z[:, :2], z[:, 2:3], 0.01 * z[:, 3:]
    >>> data = se.Trajectories.from_pairs(x, u, x @ A.T + u @ B.T + w)
    >>> model = se.identify(data, design="independent")
    >>> found = se.control(model, [1.0, 2.0], [0.0, 0.0], steps=4).bound(0.05)
    >>> found["target"].method, found.target < 0.1
    ('several steps without noise', True)
    >>> pushed, cost = ([[1.0, 1.0], [0.0, 1.0]], [[0.0], [1.0]]), se.Cost(R=0.0)
    >>> plan = se.control(pushed, [1.0, 0.0], [0.0, 0.0], steps=2, limits=(-0.5, 0.5), cost=cost)
    >>> plan.u.ravel(), plan.active.ravel(), round(plan.missed, 6), plan.status
    (array([-0.5,  0.5]), array([-1,  1], dtype=int8), 0.25, 'optimal')
    """
    within, weights = as_limits(limits), as_cost(cost)
    if isinstance(system, Model) and system.window is not None:
        given: dict[str, Any] = {"x0": x0, "xf": xf}
        for name, value in given.items():
            if value is not None:
                raise InputError(
                    f"`{name}` must be left out for a model of outputs: it starts from `record`, "
                    "and goes to `target`"
                )
        return output_control(system, record, target, steps, within, weights, time_limit)
    given = {"record": record, "target": target}
    for name, value in given.items():
        if value is not None:
            raise InputError(f"`{name}` must be left out: it is for models of outputs")
    if x0 is None:
        raise InputError("`x0` must be the initial state, got None")
    if isinstance(system, Identified):
        return model_control(system, x0, xf, steps, fusion, within, weights, time_limit)
    if isinstance(x0, Uncertain):
        raise InputError("`x0` may be Uncertain for models from data only; else pass a Fit")
    return _estimates_control(system, x0, xf, steps, fusion, within, weights, time_limit)


def _estimates_control(
    system: SystemLike,
    x0: EntityLike,
    xf: EntityLike | None,
    steps: int,
    fusion: Fusion,
    limits: Limits,
    cost: Cost,
    time_limit: float | None,
) -> Plan:
    """The control for exact values and estimates of A, x0 and xf."""
    # 1. the arguments: what is known of each entity, its estimate, and the task within limits
    B, entities, labels, dt = problem(system, x0, xf, cost.reference)
    first, last, matrix = entities
    n, m = B.shape
    K, how = fusion_over(steps, fusion, n, m)
    start, goal = first.estimate(), last.estimate()
    task = checked_task(n, m, K, goal, limits, cost, labels)
    time = seconds(time_limit, task)

    # 2. without limits: u = C_K^+ (xf_hat - A_hat^K x0_hat), or the average of the controls
    A: Floats | None = None
    if how == "diagonal":
        found = _paired(B, entities, goal)
        predicted = np.stack([start, found.reached])
    else:
        A = matrix.estimate()
        found = best_control(A, B, start, goal, K, "A" if matrix.size is None else "A_hat")
    u = found.u.reshape(K, m)

    # 3. within limits: the least J(u)
    limited: Limited | None = None
    if task is not None:
        # "diagonal": x(1) is the average of A^s x0^s, plus B u
        horizon = Horizon(task, np.eye(n) if A is None else A, B)
        limited = horizon.solve(found.free if A is None else start, time_limit=time)
        u = limited.u
        if A is None:
            predicted[1] = found.free + B @ u[0]

    # 4. where the model goes, what no control reaches, and what `bound` needs later
    if A is not None:
        predicted = states(A, B, start, u)
        if limited is not None and limited.closed and limited.states is not None:
            predicted = np.vstack([start, limited.states])
    reachability = found.reachability()
    info: dict[str, Any] = {entity.name: entity.description for entity in entities}
    info["singular_values"] = found.factors.singular_values
    sure = matrix.size is None or task is not None
    info["warnings"] = mean_warnings(system) + step_warnings(found, exact=sure)
    x0_known, xf_known, A_known = (
        known(entity.name, entity.value, estimate)
        for entity, estimate in zip(entities, (start, goal, A), strict=True)
    )
    return trusted(
        Plan,
        u=u,
        predicted_states=predicted,
        reachability=reachability,
        fusion=how,
        status=worst(
            [entity.status for entity in entities] + ([limited.status] if limited else [])
        ),
        info=info,
        basis=trusted(
            Basis, B, x0_known, xf_known, A_known, (found.state_rounding, found.control_rounding)
        ),
        limited=limited,
        labels=labels,
        dt=dt,
    )


def _paired(B: Floats, given: tuple[Entity, Entity, Entity], goal: Floats) -> Best:
    """The average of ``B^+ (xf^s - A^s x0^s)``; `goal` is that of xf."""
    first, last, matrices = (entity.realizations() for entity in given)
    difference = _core.mean_difference(len(B), first, last, matrices, given[2].by_rows)
    free = goal - difference  # the average of A^s x0^s
    return best(B, free, difference)  # the averages count as exact
