"""One control per realization."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base import memory, validation
from .._base.threads import get_num_threads
from ..exceptions import SolverError
from ..theory.exact import factors
from .arguments import problem
from .constraints import checked_task
from .cost import Cost, as_cost
from .limited import OPTIMAL, Horizon
from .limits import as_limits

if TYPE_CHECKING:
    from .._base.types import Floats
    from .arguments import EntityLike, SystemLike
    from .limits import LimitsLike


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
    inputs, given, labels, _ = problem(system, x0, xf)
    n, m = inputs.shape
    task = checked_task(
        n, m, 1, np.zeros(n), as_limits(limits).only("u"), as_cost(cost).only("Q", "R"), labels
    )
    start, goal, matrix = (entity.realizations() for entity in given)
    size = max(entity.size or 1 for entity in given)
    shape = (size, m)
    if out is None:
        memory.need("the controls", size * m * 8)
        # not from the core: NumPy asks the system for large pages, which are filled far sooner
        controls = np.empty(shape)
    else:
        A, B = system[:2] if isinstance(system, tuple) else (system.A, system.B)
        controls = validation.output("out", out, shape, {"A": A, "B": B, "x0": x0, "xf": xf})
    data, threads = (start, goal, matrix, given[2].by_rows), get_num_threads()
    if task is None:
        _core.realization_controls(controls, out is None, factors(inputs).inverse, *data, threads)
        return controls
    horizon = Horizon(task, np.eye(n), inputs)
    factor = horizon.roots[1]
    memory.need("the controls within limits", size * (len(factor) + m + 2) * 8)
    needed = np.empty((size, len(factor)))  # Q^1/2 (xf^s - A^s x0^s)
    _core.realization_controls(needed, True, factor, *data, threads)
    controls[:] = _within(horizon, needed, threads)
    return controls


def _within(horizon: Horizon, y: Floats, threads: int) -> Floats:
    """The least ``||Q^1/2 B u - y||^2 + ||u||^2_R`` within limits for every row of y."""
    task, M, cost = horizon.task, horizon.roots[1] @ horizon.B, horizon.cost()
    low, high = task.low[0], task.high[0]
    u, gaps = _core.box_batch(M, y, cost, low, high, True, threads)
    assert gaps is not None
    doubted = np.flatnonzero(~(gaps <= OPTIMAL * np.einsum("si,si->s", y, y)))  # J(0)
    v, r = u[doubted], y[doubted]
    both = (
        np.sum(r**2, axis=1)
        + np.sum((v @ M.T - r) ** 2, axis=1)
        + np.sum((v @ horizon.R) * v, axis=1)
    )
    for s in doubted[~(gaps[doubted] <= OPTIMAL * both)]:  # J(0) + J(u)
        found = _core.box_control(M, y[s], cost, low, high, None, None)
        if found.status != "optimal":
            raise SolverError(
                f"the control of realization {s} is {found.status} within limits: its gap is "
                f"{found.gap:.3g}, J(0) is {found.at_zero:.3g}; give a larger `R`"
            )
        u[s] = found.control
    return u
