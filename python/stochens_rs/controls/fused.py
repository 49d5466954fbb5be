"""Controls from realizations: one per realization, or one fused from all of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _core
from .._base import gate, memory
from .._base.numbers import norm
from .._base.threads import get_num_threads
from .._base.types import DELTA, Floats, Fusion, worst
from ..exceptions import InputError
from ..identification.identified import Identified
from ..theory.dynamics import states
from ..theory.exact import EPS, best, best_control, factors
from .basis import Basis, known
from .entities import fusion_over, problem, step_warnings
from .from_model import model_control
from .plan import Plan

if TYPE_CHECKING:
    from ..theory.exact import Best
    from .entities import Entity, EntityLike, SystemLike


def realization_controls(
    system: SystemLike, x0: EntityLike, xf: EntityLike, *, out: Floats | None = None
) -> Floats:
    """Compute one control per realization, ``u^s = B^+ (xf^s - A^s x0^s)``.

    Parameters
    ----------
    system : System or pair (A, B)
        As in `control`; realizations of A are an Ensemble in the pair.
    x0, xf : Ensemble or array_like, shape (n,)
        Realizations of the initial state and the target; an array is the same for all.
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
        If the singular value decomposition of B does not converge.

    Notes
    -----
    ``B^+`` is the Moore-Penrose inverse; singular values up to ``eps max(n, m) sigma_max`` count
    as zero. For singletons a control costs O(m). Its mean is ``B^+ (xf - A x0)``.

    Here the matrix ``B^+`` is formed, once for all realizations. Rounding errors are about
    ``eps condition(B) ||u||`` in the control, as in `control`; in the state ``B u`` they are about
    ``eps condition(B) ||xf - A x0||``, with `control` about ``eps ||B|| ||u||``.

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
    """
    inputs, given = problem(system, x0, xf)
    start, goal, matrix = (entity.realizations() for entity in given)
    pinv = factors(inputs).inverse
    size = max(entity.size or 1 for entity in given)
    shape = (size, inputs.shape[1])
    if out is None:
        memory.need("the controls", size * inputs.shape[1] * 8)
        # not from the core: NumPy asks the system for large pages, which are filled far sooner
        controls = np.empty(shape)
    else:
        A, B = system[:2] if isinstance(system, tuple) else (system.A, system.B)
        controls = gate.output("out", out, shape, {"A": A, "B": B, "x0": x0, "xf": xf})
    _core.realization_controls(
        controls, out is None, pinv, start, goal, matrix, given[2].by_rows, get_num_threads()
    )
    return controls


def control(
    system: SystemLike | Identified,
    x0: EntityLike,
    xf: EntityLike,
    *,
    steps: int = 1,
    fusion: Fusion = "product",
    x0_error: float = 0.0,
    robust: bool = False,
    delta: float = DELTA,
) -> Plan:
    """Compute the smallest control from x0 to xf in K steps, from estimates.

    Parameters
    ----------
    system : System or pair (A, B), or Model
        A System, anything `System.from_any` takes, or a pair of A, shape (n, n), and an array B,
        shape (n, m). In the pair A may be a Fit, an Ensemble or Counts. Or a model from measured
        data, as `identify` makes it; x0 and xf are then arrays.
    x0, xf : Fit, Ensemble, Counts or array_like, shape (n,)
        Initial state and target. A Fit or Counts stands for its estimate, an Ensemble for its
        uniform average. An array counts as exact; for an estimate of your own pass a Fit.
    steps : int, default 1
        Number of steps K.
    fusion : {"product", "diagonal"}, default "product"
        "product": the control of the estimates. "diagonal", for one step: the average of the
        controls of the paired realizations, as in the paper; it needs ensembles of equal size (or
        arrays).
    x0_error : float, default 0.0
        For a model from data: the true initial state is within this distance of `x0`.
    robust : bool, default False
        For a model from data and one step: take the u with the smallest bound of
        ``||x(1) - xf||`` instead of the smallest one that comes nearest according to the model.
    delta : float, default 0.05
        The level of that bound, see `Plan.bound`.

    Returns
    -------
    Plan
        The control, the states it should lead to, and what is out of reach.

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

    A model from data takes the place of the exact system, its offset c included: ``xf`` less what
    c adds over K steps. ``robust``: ``min ||H z - xf|| + radius ||z||`` in the norm of V^-1 with
    ``z = (x0, u, 1)`` and the region of the model, a second-order cone problem.

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
    >>> found.method, found.target < 0.1
    ('several steps', True)
    """
    level, least = gate.probability("delta", delta), gate.flag("robust", robust)
    off = gate.nonnegative("x0_error", x0_error)
    if isinstance(system, Identified):
        if level != DELTA and not least:
            raise InputError("`delta` goes with robust=True; otherwise it belongs to plan.bound")
        return model_control(system, x0, xf, steps, fusion, x0_error=off, robust=least, delta=level)
    if least or level != DELTA or off:
        raise InputError("`robust`, `delta` and `x0_error` are for models from data")
    inputs, given = problem(system, x0, xf)
    n, m = inputs.shape
    K, how = fusion_over(steps, fusion, n, m)
    start, goal = given[0].estimate(), given[1].estimate()
    matrix: Floats | None = None
    if how == "diagonal":
        found = _paired(inputs, given, goal)
        predicted = np.stack([start, found.reached])
    else:
        matrix = given[2].estimate()
        name = "A" if given[2].size is None else "A_hat"
        found = best_control(matrix, inputs, start, goal, K, name)
        predicted = states(matrix, inputs, start, found.u.reshape(K, m))
    reachability = found.reachability()
    info: dict[str, Any] = {entity.name: entity.description for entity in given}
    info["singular_values"] = found.factors.singular_values
    info["warnings"] = step_warnings(n, m, K, reachability.rank, exact=given[2].size is None)
    x0_known, xf_known, A_known = (
        known(entity.name, entity.value, estimate)
        for entity, estimate in zip(given, (start, goal, matrix), strict=True)
    )
    return Plan(
        u=found.u.reshape(K, m),
        predicted_states=predicted,
        reachability=reachability,
        fusion=how,
        status=worst([entity.status for entity in given]),
        info=info,
        basis=Basis(inputs, x0_known, xf_known, A_known),
    )


def _paired(B: Floats, given: tuple[Entity, Entity, Entity], goal: Floats) -> Best:
    """The average of ``B^+ (xf^s - A^s x0^s)``; `goal` is that of xf."""
    first, last, matrices = (entity.realizations() for entity in given)
    difference = _core.mean_difference(len(B), first, last, matrices, given[2].by_rows)
    free = goal - difference  # the average of A^s x0^s
    unsure = EPS * (norm(free) + norm(goal))  # the averages count as exact
    return best(B, free, difference, unsure)
