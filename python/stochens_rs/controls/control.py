"""`control`, `steer` and `realization_controls`: from estimates to controls."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from .. import _core
from .._base import running, validation
from .._base.names import Labels, default_labels
from .._base.records import trusted
from .._base.running import get_num_threads
from .._base.types import FUSIONS, ArrayLike, Floats, Fusion, worst
from ..ensembles.ensemble import Counts, Ensemble, core_of, sample
from ..ensembles.systems import SystemEnsemble
from ..exceptions import InputError, InputTypeError, ShapeError, SolverError
from ..fusion.fits import Fit
from ..fusion.fusing import Method, fuse
from ..fusion.provenance import Basis, known
from ..identification.identified import Identified
from ..limits.limits import Cost, LimitsLike, Uncertain, as_cost, as_limits
from ..limits.problem import OPTIMAL, Horizon, checked_task, seconds
from ..rng import RngLike, as_key
from ..system.system import System, mean_of
from ..theory.exact import best, best_control, checked_ends, checked_steps, factors, states
from . import of_model
from .of_model import Record
from .plan import Plan
from .set_point import Target

EntityLike: TypeAlias = Fit | Ensemble | Counts | ArrayLike
SystemLike: TypeAlias = System | tuple[EntityLike, ArrayLike] | Any


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
    target: Target | None = None,
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
    target : array_like, shape (n_outputs,), or mapping of names, optional
        For a model of outputs, in place of xf: where they are to be, and to stay with a constant
        input; default 0. Those with nan, or that are left out, are free. Rows of them are one for
        each time 0, 1, ..., of which the last stays. Weights of `cost` may be of the outputs alone,
        as in `gain`.

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
    and all that is said of it is of a plan that is followed; see `Limited.open_until`.
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
    >>> model = se.identify(data, noise=se.Noise(design="independent"))
    >>> found = se.control(model, [1.0, 2.0], [0.0, 0.0], steps=4).bound(0.05)
    >>> found["target"].method, found.target < 0.1
    ('several steps without noise', True)
    >>> pushed, cost = ([[1.0, 1.0], [0.0, 1.0]], [[0.0], [1.0]]), se.Cost(R=0.0)
    >>> plan = se.control(pushed, [1.0, 0.0], [0.0, 0.0], steps=2, limits=(-0.5, 0.5), cost=cost)
    >>> found = plan.limited
    >>> plan.u.ravel(), found.active.ravel(), round(found.missed, 6), plan.status
    (array([-0.5,  0.5]), array([-1,  1], dtype=int8), 0.25, 'optimal')
    """
    within, weights = as_limits(limits), as_cost(cost)
    wanted = of_model.Wanted(steps, within, weights, time_limit)
    if of_model.of_outputs(system, {"x0": x0, "xf": xf}, {"record": record, "target": target}):
        return of_model.output_control(system, record, target, wanted)
    if within.forecast is not None and not within.forecast.exact:
        raise InputError(
            "`error` of `forecast` must be 0 for a model of states: read them as outputs=, and "
            "identify with Window(lags=1)"
        )
    if isinstance(system, Identified):
        if validation.choice("fusion", fusion, FUSIONS) != "product":
            raise InputError("`fusion` must be 'product' for a model from data, got 'diagonal'")
        goal = of_model.ending(weights.reference, xf, system.state_names)
        basis = of_model.basis_in_states(system, x0, goal)
        return of_model.model_control(basis, wanted)
    if isinstance(x0, Uncertain):
        raise InputError("`x0` may be Uncertain for models from data only; else pass a Fit")

    # 1. the arguments: what is known of each entity, its estimate, and the task within limits
    B, entities, labels, dt = problem(system, x0, xf, weights.reference)
    first, last, matrix = entities
    n, m = B.shape
    K, how = fusion_over(steps, fusion, n, m)
    start, goal = first.estimate(), last.estimate()
    task = checked_task(n, m, K, goal, within, weights, labels)
    time = seconds(time_limit, task)

    # 2. without limits: u = C_K^+ (xf_hat - A_hat^K x0_hat), or the average of the controls
    A = None if how == "diagonal" else matrix.estimate()
    if A is None:
        average = _core.mean_difference(n, *realizations(entities))  # of xf^s - A^s x0^s
        found = best(B, goal - average, average)  # the averages count as exact
    else:
        found = best_control(A, B, start, goal, K, "A" if matrix.size is None else "A_hat")
    u, limited = found.u.reshape(K, m), None

    # 3. within limits: the least J(u)
    if task is not None:
        horizon = Horizon(task, np.eye(n) if A is None else A, B)
        limited = horizon.solve(found.free if A is None else start, time_limit=time)
        u = limited.u

    # 4. where the model goes, what no control reaches, and what `bound` needs later
    if A is None:
        predicted = np.stack([start, found.reached if limited is None else found.free + B @ u[0]])
    elif limited is not None and limited.states is not None:
        predicted = np.vstack([start, limited.states])
    else:
        predicted = states(A, B, start, u)
    sure = matrix.size is None or task is not None
    info: dict[str, Any] = {entity.name: entity.description for entity in entities}
    info["warnings"] = mean_warnings(system) + of_model.step_warnings(found, sure=sure)
    entries = zip(entities, (start, goal, A), strict=True)
    x0_known, xf_known, A_known = (known(one.name, one.value, used) for one, used in entries)
    rounding = found.state_rounding, found.control_rounding
    kept = trusted(Basis, B, x0_known, xf_known, A_known, rounding)
    ended = [one.value.status for one in entities if isinstance(one.value, Fit)]
    status = worst(["completed", *ended, *([limited.status] if limited else [])])
    info["singular_values"] = found.factors.singular_values
    about = how, status, info, kept, limited, labels, dt
    return trusted(Plan, u, predicted, found.reachability(), *about)


@dataclass(frozen=True)
class Entity:
    """x0, xf or A: a fit, an ensemble, counts, or a copy of exact values."""

    name: str
    value: Fit | Ensemble | Counts | Floats

    def estimate(self) -> Floats:
        """What product fusion uses; a copy if the value belongs to the user."""
        if isinstance(self.value, Fit | Counts):
            return self.value.estimate.copy("K")  # in the same memory order: the same last bits
        return self.value.mean() if isinstance(self.value, Ensemble) else self.value

    def drawn(self) -> Ensemble | None:
        """The realizations; None for exact values."""
        value: Any = self.value
        if isinstance(value, Fit) and value.method == "uniform":
            value = value.ensemble
        if value is None or isinstance(value, Fit | Counts):
            raise InputError(
                f"`{self.name}` must be an Ensemble or an array here, got "
                f"{validation.article(type(self.value))}: it goes with fusion='product'"
            )
        return value if isinstance(value, Ensemble) else None

    @property
    def size(self) -> int | None:
        """Number of realizations; None for exact values."""
        if isinstance(self.value, Fit):
            return len(self.value.weights)
        return self.value.size if isinstance(self.value, Ensemble | Counts) else None

    @property
    def description(self) -> dict[str, Any]:
        """The entry of the plan's `info`."""
        if isinstance(self.value, Fit):
            fit = self.value
            return {"method": fit.method, "size": self.size, "status": fit.status, "gap": fit.gap}
        return {"method": "exact" if self.size is None else "uniform", "size": self.size}


def problem(
    system: SystemLike, x0: Any, xf: Any, reference: Any = None
) -> tuple[Floats, tuple[Entity, Entity, Entity], Labels, float | None]:
    """Check all arguments of a control problem: B, the entities x0, xf and A, the names, and dt.

    `system` is a system, or (A, B) or (A, B, dt) whose A may be a Fit, an Ensemble, Counts or a
    SystemEnsemble; in place of B, a nominal System gives its B, names and dt. The last row of a
    `reference` takes the place of `xf`.
    """
    pair: tuple[Any, ...] = system if isinstance(system, tuple) else ()
    A, models = (pair[0] if pair else None), None
    if isinstance(A, SystemEnsemble):  # realizations of A, with its names and step
        models, A = A, Ensemble.from_samples(A.A, centre=A.centre)
        if models.c is not None:
            raise InputError("`A` must be models without offsets here: see control_fleet")
    if isinstance(A, Fit | Ensemble | Counts):
        if len(pair) not in (2, 3):
            raise InputTypeError(
                f"`system` must be a pair (A, B) or (A, B, dt) when A is "
                f"{validation.article(type(A))}, got {len(pair)} items"
            )
        n = A.shape[0]
        matrix = _entity("A", A, (n, n))
        nominal = pair[1] if isinstance(pair[1], System) else None
        B = validation.matrix("B", pair[1] if nominal is None else nominal.B, rows=n).copy()
        labels, dt = default_labels(n, B.shape[1]), None
        if nominal is not None:
            labels, dt = nominal.labels, nominal.dt
        if models is not None and B.shape[1] == models.m:
            labels, dt = models.labels or labels, models.dt or dt
        if len(pair) == 3:
            dt = validation.positive("dt", pair[2])
    else:
        exact = System.from_any(system)
        B, matrix, labels, dt = exact.B, Entity("A", exact.A), exact.labels, exact.dt
    names = labels.states
    first, last = (
        _entity(name, value, (len(names),), names)
        for name, value in (("x0", x0), ("xf", of_model.ending(reference, xf, names)))
    )
    return B, (first, last, matrix), labels, dt if isinstance(dt, float) else None


def _entity(name: str, value: Any, shape: tuple[int, ...], names: Any = None) -> Entity:
    if not isinstance(value, Fit | Ensemble | Counts):
        return Entity(name, validation.vector(name, value, length=shape[0], labels=names).copy())
    if value.shape != shape:
        raise ShapeError(f"`{name}` must have shape {shape}, got {value.shape}")
    return Entity(name, value)


def realizations(entities: tuple[Entity, Entity, Entity]) -> tuple[Any, Any, Any, bool]:
    """For the core: draws, dense rows or a flat exact value of x0, xf and A; if A has rows."""
    drawn = [entity.drawn() for entity in entities]
    x0, xf, A = (
        entity.estimate().ravel() if one is None else core_of(one)
        for entity, one in zip(entities, drawn, strict=True)
    )
    return x0, xf, A, drawn[2] is not None and drawn[2].axis == "rows"


def fusion_over(steps: object, fusion: object, n: int, m: int) -> tuple[int, Fusion]:
    """Check the number of steps, and that the fusion is possible over so many."""
    how = validation.choice("fusion", fusion, FUSIONS)
    if how == "product":
        return checked_steps(steps, n, m), how
    K = validation.size("steps", steps)
    if K > 1:
        raise InputError(
            f"`fusion` must be 'product' with steps={K}, got 'diagonal': over several steps the "
            "average of the controls is biased"
        )
    return K, how


def mean_warnings(system: SystemLike) -> tuple[str, ...]:
    """A warning where A or B are those of the mean of several models."""
    nominal = system[1] if isinstance(system, tuple) and len(system) > 1 else system
    if not isinstance(nominal, System) or mean_of(nominal) == 1:
        return ()
    return (
        f"the system is the mean of {mean_of(nominal)} models, and all numbers are about this "
        "mean; how far a fresh model misses: plan.validate(fresh)",
    )


def steer(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    size: int,
    *,
    steps: int = 1,
    method: Method = "uniform",
    fusion: Fusion = "product",
    limits: LimitsLike = None,
    cost: Cost | None = None,
    rng: RngLike = None,
) -> Plan:
    """Sample x0, xf and A, fuse them, and compute the control: all in one call.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes.
    x0, xf : array_like, shape (n,)
        Initial state and target.
    size : int
        Number of realizations of each entity.
    steps : int, default 1
        Number of steps K.
    method : str, default "uniform"
        As in `fuse`; the least-squares methods fit to the exact entity, as in the paper's analysis.
    fusion : {"product", "diagonal"}, default "product"
        As in `control`; "diagonal" goes with one step and method "uniform" only.
    limits, cost
        As in `control`.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
        Source of randomness; the entities draw from its children "x0", "xf" and "A".

    Returns
    -------
    Plan
        The fused control; ``info["key"]`` repeats it.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it. Among them fusion="diagonal" over
        several steps.

    Notes
    -----
    The average of one control per realization, ``fusion="diagonal"``, is inconsistent for
    ``steps >= 2``: the control is not linear in A. In a Gaussian system with n=6, m=2, K=4 the
    mean control from averages of 1, 5, 20 and 100 realizations is off by about 1.5, 0.9, 0.7 and
    0.3 times the exact control, however many of them are averaged.

    For more realizations than fit into memory, pass the results of `sample_counts` to `control`:
    the cost of counts does not depend on the number of realizations.

    Examples
    --------
    >>> import stochens_rs as se
    >>> system = se.System([[0.9, 0.2], [-0.1, 0.8]], [[1.0, 0.0], [0.5, 1.0]])
    >>> plan = se.steer(system, [1.0, 2.0], [0.0, 0.0], 10_000, rng=1)
    >>> plan.error(system, [1.0, 2.0], [0.0, 0.0]).control_relative < 0.1
    True
    """
    checked, start, goal = checked_ends(system, x0, xf)
    key = as_key(rng)
    x0_fit, xf_fit, A_fit = (
        fuse(sample(target, size, rng=key.child(name)), method, target=target)
        for name, target in (("x0", start), ("xf", goal), ("A", checked.A))
    )
    how: Any = {"steps": steps, "limits": limits, "cost": cost, "fusion": fusion}
    plan = control((A_fit, checked), x0_fit, xf_fit, **how)
    return replace(plan, info={**plan.info, "key": key})


def realization_controls(
    system: SystemLike,
    x0: EntityLike,
    xf: EntityLike,
    *,
    limits: LimitsLike = None,
    cost: Cost | None = None,
    out: Floats | None = None,
) -> Floats:
    """Compute one control per realization, ``u^s = B^+ (xf^s - A^s x0^s)``, also within limits.

    Parameters
    ----------
    system : System or pair (A, B)
        As in `control`; realizations of A are an Ensemble in the pair.
    x0, xf : Ensemble or array_like, shape (n,)
        Realizations of the initial state and the target; an array is the same for all.
    limits : tuple (low, high), optional
        Limits of the inputs, each a number or (m,), infinite or None where there is none.
    cost : Cost, optional
        Weights of the state (default I) and of the input (default with limits or Q: "auto"), as in
        `control`.
    out : ndarray of float64, shape (N, m), optional
        Where to write the controls: C-contiguous, writeable, sharing no memory with the other
        arguments. To reuse an array saves more time than the controls take. After an exception its
        entries are undefined.

    Returns
    -------
    ndarray, shape (N, m)
        ``u[s]`` belongs to realization s of every ensemble (N = 1 if all are arrays); `out` itself
        if it was given.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used, the ensembles differ in size, or a control overflows.
    SolverError
        If the singular value decomposition of B does not converge; or if a control within limits
        has a gap above the tolerance of `control`, which only happens without R > 0.

    Notes
    -----
    ``B^+`` is the Moore-Penrose inverse; singular values up to ``eps max(n, m) sigma_max`` count
    as zero. For singletons a control costs O(m). Its mean is ``B^+ (xf - A x0)``.

    Here the matrix ``B^+`` is formed, once for all realizations. Rounding errors are about
    ``eps condition(B) ||u||`` in the control, as in `control`; in the state ``B u`` they are about
    ``eps condition(B) ||xf - A x0||``, with `control` about ``eps ||B|| ||u||``.

    Within limits ``u^s`` minimises ``||B u - (xf^s - A^s x0^s)||^2_Q + ||u||^2_R``. The average of
    such controls is not the control of the averages, which `control` computes: where limits are
    active it is biased, and more realizations do not help.

    Examples
    --------
    >>> import numpy as np, stochens_rs as se
    >>> A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[1.0], [0.5]])
    >>> drawn = se.sample(A, 5, rng=1), B
    >>> u = se.realization_controls(drawn, [1.0, 2.0], [0.0, 0.0])
    >>> u.shape
    (5, 1)
    >>> again = np.empty((5, 1))
    >>> v = se.realization_controls(drawn, [1.0, 2.0], [0.0, 0.0], out=again)
    >>> v is again, bool((v == u).all())
    (True, True)
    >>> w = se.realization_controls(drawn, [1.0, 2.0], [0.0, 0.0], limits=(-1.0, 1.0))
    >>> float(w.min())
    -1.0
    """
    B, entities, labels, _ = problem(system, x0, xf)
    n, m = B.shape
    within, weights = as_limits(limits).only("u"), as_cost(cost).only("Q", "R")
    task = checked_task(n, m, 1, np.zeros(n), within, weights, labels)
    size, threads = max(entity.size or 1 for entity in entities), get_num_threads()
    if out is None:
        running.need("the controls", size * m * 8)
        # not from the core: NumPy asks the system for large pages, which are filled far sooner
        controls = np.empty((size, m))
    else:
        pair = system[:2] if isinstance(system, tuple) else (system.A, system.B)
        others = {"A": pair[0], "B": pair[1], "x0": x0, "xf": xf}
        controls = validation.output("out", out, (size, m), others)
    data = *realizations(entities), threads
    if task is None:
        _core.realization_controls(controls, out is None, factors(B).inverse, *data)
        return controls
    core = Horizon(task, np.eye(n), B).core
    root, R, low, high = core.roots()[1], core.r, task.low[0], task.high[0]
    running.need("the controls within limits", size * (len(root) + m + 2) * 8)
    y = np.empty((size, len(root)))  # Q^1/2 (xf^s - A^s x0^s)
    _core.realization_controls(y, True, root, *data)
    # the least ||Q^1/2 B u - y||^2 + ||u||^2_R for every row of y
    M, diagonal = root @ B, np.diag(R).copy()
    penalty = diagonal if np.array_equal(R, np.diag(diagonal)) else R
    u, gaps = _core.box_batch(M, y, penalty, low, high, True, threads)
    assert gaps is not None
    at_zero = np.einsum("si,si->s", y, y)  # J(0)
    for s in np.flatnonzero(~(gaps <= OPTIMAL * at_zero)):
        off = M @ u[s] - y[s]
        if gaps[s] <= OPTIMAL * (at_zero[s] + off @ off + u[s] @ R @ u[s]):  # J(0) + J(u)
            continue
        found = _core.box_control(M, y[s], penalty, low, high, None, None)
        if found.status != "optimal":
            raise SolverError(
                f"the control of realization {s} is {found.status} within limits: its gap is "
                f"{found.gap:.3g}, J(0) is {found.at_zero:.3g}; give a larger `R`"
            )
        u[s] = found.control
    controls[:] = u
    return controls
