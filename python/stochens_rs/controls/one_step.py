"""Controls from realizations: ``u = B^+ (xf - A x0)``, one per realization or fused."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .. import _core
from .._base import gate, memory
from .._base.numbers import norm
from .._base.threads import get_num_threads
from .._base.types import Fusion, worst
from ..theory.exact import EPS, best, factors, summed
from .basis import Basis, known
from .entities import entities
from .plan import Plan

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from .entities import EntityLike

    Floats: TypeAlias = NDArray[np.float64]


FUSIONS = ("product", "diagonal")


def realization_controls(
    B: ArrayLike,
    x0: EntityLike,
    xf: EntityLike,
    A: EntityLike,
    *,
    out: Floats | None = None,
) -> Floats:
    """Compute one control per realization, ``u^s = B^+ (xf^s - A^s x0^s)``.

    Parameters
    ----------
    B : array_like, shape (n, m)
        Input matrix.
    x0, xf : Ensemble or array_like, shape (n,)
        Realizations of the initial state and the target; an array is the same for all.
    A : Ensemble or array_like, shape (n, n)
        Realizations of the system matrix; an array is the same for all.
    out : ndarray of float64, shape (N, m), optional
        Where to write the controls: C-contiguous, writeable, sharing no memory with the other
        arguments. Memory that was used before saves more time than the controls take. After an
        exception its entries mean nothing.

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

    Here ``B^+`` is a matrix, formed once for all realizations. Rounding leaves the control off by
    about ``eps condition(B) ||u||`` as it does everywhere, but the state ``B u`` by about
    ``eps condition(B) ||xf - A x0||``, where that of `control` is off by ``eps ||B|| ||u||`` only.

    Examples
    --------
    >>> import numpy as np, stochens_rs as se
    >>> A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[1.0], [0.5]])
    >>> u = se.realization_controls(B, [1.0, 2.0], [0.0, 0.0], se.sample(A, 5, rng=1))
    >>> u.shape
    (5, 1)
    >>> again = np.empty((5, 1))
    >>> v = se.realization_controls(B, [1.0, 2.0], [0.0, 0.0], se.sample(A, 5, rng=1), out=again)
    >>> v is again, bool((v == u).all())
    (True, True)
    """
    inputs = gate.matrix("B", B)
    given = entities(x0, xf, A, n=inputs.shape[0])
    start, goal, matrix = (entity.realizations() for entity in given)
    pinv = factors(inputs).inverse
    size = max(entity.size or 1 for entity in given)
    shape = (size, inputs.shape[1])
    if out is None:
        memory.need("the controls", size * inputs.shape[1] * 8)
        # not from the core: NumPy asks the system for large pages, which are filled far sooner
        controls = np.empty(shape)
    else:
        controls = gate.output("out", out, shape, {"B": B, "x0": x0, "xf": xf, "A": A})
    _core.realization_controls(
        controls, out is None, pinv, start, goal, matrix, given[2].by_rows, get_num_threads()
    )
    return controls


def control(
    B: ArrayLike,
    x0: EntityLike,
    xf: EntityLike,
    A: EntityLike,
    *,
    fusion: Fusion = "product",
) -> Plan:
    """Compute the fused control for one step from x0 to xf.

    Parameters
    ----------
    B : array_like, shape (n, m)
        Input matrix.
    x0, xf : Fit, Ensemble, Counts or array_like, shape (n,)
        Initial state and target. A Fit or Counts stands for its estimate, an Ensemble for its
        uniform average, an array for itself.
    A : Fit, Ensemble, Counts or array_like, shape (n, n)
        System matrix.
    fusion : {"product", "diagonal"}, default "product"
        "product": ``B^+ (xf_hat - A_hat x0_hat)``. "diagonal": the average of the controls of the
        paired realizations, as in the paper; it needs ensembles of equal size (or arrays).

    Returns
    -------
    Plan
        The control, the state it should lead to, and what is out of reach.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    SolverError
        If the singular value decomposition of B does not converge.

    Notes
    -----
    Both have the mean ``B^+ (xf - A x0)``; product fusion is never worse, in the Loewner order of
    the covariances and for every convex loss. Product fusion is the sum over all triples of
    realizations with product weights, evaluated in O(N) (paper, Lemma 3.2, where one index is
    used for three weight vectors). With m < n a target is in general not reachable in one step;
    the control is then the least-squares one and ``reachability`` says what is left.

    Examples
    --------
    >>> import numpy as np, stochens_rs as se
    >>> A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[1.0, 0.0], [0.5, 1.0]])
    >>> x0 = [1.0, 2.0]
    >>> fit = se.fuse(se.sample(A, 500, rng=1), "alse", target=A)
    >>> plan = se.control(B, se.sample(x0, 500, rng=2), [0.0, 0.0], fit)
    >>> plan.status, plan.reachability.reachable
    ('optimal', True)
    """
    inputs = gate.matrix("B", B)
    fusion = "diagonal" if gate.choice("fusion", fusion, FUSIONS) == "diagonal" else "product"
    given = entities(x0, xf, A, n=inputs.shape[0])
    estimates: tuple[Floats | None, ...] = (None, None, None)
    if fusion == "diagonal":
        first, last, matrices = (entity.realizations() for entity in given)
        by_rows = given[2].by_rows
        difference = _core.mean_difference(inputs.shape[0], first, last, matrices, by_rows)
        goal = given[1].estimate()
        free = goal - difference  # the average of A^s x0^s
        estimates = None, goal, None
        unsure = EPS * (norm(free) + norm(goal))  # the averages count as exact
    else:
        start, goal, matrix = (entity.estimate() for entity in given)
        estimates = start, goal, matrix
        with np.errstate(over="ignore", invalid="ignore"):
            free = matrix @ start
            difference = goal - free
            unsure = summed(matrix, start, goal)
    found = best(inputs, free, difference, unsure)
    info: dict[str, Any] = {entity.name: entity.description for entity in given}
    info["singular_values"] = found.factors.singular_values
    x0_known, xf_known, A_known = (
        known(entity.name, entity.value, estimate)
        for entity, estimate in zip(given, estimates, strict=True)
    )
    return Plan(
        u=found.u,
        predicted_state=found.reached,
        reachability=found.reachability(),
        fusion=fusion,
        status=worst([entity.status for entity in given]),
        info=info,
        basis=Basis(inputs.copy(), x0_known, xf_known, A_known),
    )
