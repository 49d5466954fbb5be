"""Controls over several steps from estimates: ``u = C_K(A_hat, B)^+ (xf_hat - A_hat^K x0_hat)``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .._base import gate
from .._base.types import worst
from ..theory.dynamics import checked_steps, states
from ..theory.exact import best_control
from .basis import Basis, known
from .entities import entities
from .trajectory_plan import TrajectoryPlan

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .entities import EntityLike


def control_steps(
    B: ArrayLike, x0: EntityLike, xf: EntityLike, A: EntityLike, steps: int
) -> TrajectoryPlan:
    """Compute the minimum-norm control over K steps from x0 to xf for the estimated system.

    Parameters
    ----------
    B : array_like, shape (n, m)
        Input matrix.
    x0, xf : Fit, Ensemble, Counts or array_like, shape (n,)
        Initial state and target. A Fit or Counts stands for its estimate, an Ensemble for its
        uniform average, an array for itself.
    A : Fit, Ensemble, Counts or array_like, shape (n, n)
        System matrix.
    steps : int
        Number of steps K, at least 1.

    Returns
    -------
    TrajectoryPlan
        The control, the trajectory it should give, what is out of reach, and bounds.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used, or a power of the estimated A overflows; the message names
        it.
    ResourceError
        If ``C_K`` or the powers of A do not fit into the memory this process may use.
    SolverError
        If the singular value decomposition of ``C_K`` does not converge.

    Notes
    -----
    ``C_K = [B, A_hat B, ..., A_hat^{K-1} B]`` meets u(K-1), ..., u(0). The
    entities are fused first (product fusion). The other way round, the average of one control per
    realization of A, is not offered: for K >= 2 the control is not linear in A, so that its
    mean over the realizations is not the control of the mean, and more samples do not help. The
    estimate is consistent if the exact ``C_K`` has rank n. With ``m K = n`` exactly, the inverse
    of the square, estimated ``C_K`` has heavy tails: rare draws give huge controls. Take more
    steps, or regularise; ``info["warnings"]`` says so.

    Examples
    --------
    >>> import stochens_rs as se
    >>> A, B = [[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]]
    >>> fit = se.fuse(se.sample(A, 500, rng=1), "alse", target=A)
    >>> plan = se.control_steps(B, [1.0, 0.0], [0.0, 0.0], fit, 10)
    >>> plan.u.shape, plan.predicted_states.shape, plan.reachability.reachable
    ((10, 1), (11, 2), True)
    """
    inputs = gate.matrix("B", B)
    n, m = inputs.shape
    K = checked_steps(steps, n, m)
    given = entities(x0, xf, A, n=n)
    start, goal, matrix = (entity.estimate() for entity in given)
    name = "A" if given[2].size is None else "A_hat"
    best = best_control(matrix, inputs, start, goal, K, name)
    u, reachability = best.u.reshape(K, m), best.reachability()
    info: dict[str, Any] = {entity.name: entity.description for entity in given}
    info["singular_values"] = best.factors.singular_values
    info["warnings"] = _warnings(n, m, K, reachability.rank, exact=given[2].size is None)
    x0_known, xf_known, A_known = (
        known(entity.name, entity.value, estimate.copy())
        for entity, estimate in zip(given, (start, goal, matrix), strict=True)
    )
    return TrajectoryPlan(
        u=u,
        predicted_states=states(matrix, inputs, start, u),
        reachability=reachability,
        status=worst([entity.status for entity in given]),
        info=info,
        basis=Basis(inputs.copy(), x0_known, xf_known, A_known),
    )


def _warnings(n: int, m: int, K: int, rank: int, *, exact: bool) -> tuple[str, ...]:
    found = []
    if rank < n:
        found.append(
            f"C_K has rank {rank} < n = {n}: only targets in its range can be reached, and the "
            "estimate need not be consistent"
        )
    elif m * K == n and not exact:
        found.append(
            f"m K = n = {n}: the inverse of the estimated C_K has heavy tails; take more than "
            f"{K} steps, or regularise"
        )
    return tuple(found)
