"""Reachability under the exact system, in one step and in several."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..._base import gate, memory
from ...exceptions import NonFiniteError
from ..dynamics import checked_steps, matrix_powers
from ..exact import best_over_steps
from ..exact import one_step as best_in_one_step
from ..formulas import Array
from ..records import Reachability


@dataclass(frozen=True, eq=False)
class StepsReachability:
    """Whether K steps take ``x0`` to ``xf``, and with which controls.

    Attributes
    ----------
    residual : float
        ``||(I - C C+)(xf - A^K x0)||``, C the controllability matrix: what no control can do.
    relative : float
        `residual` over ``||xf - A^K x0||``; 0 if that is 0.
    rank : int
        Rank of C.
    condition : float
        Largest over smallest singular value of C above the rank cut-off; inf if C is 0.
    reachable : bool
        Whether `relative` is at most 1.5e-8, the square root of the rounding unit, or `residual`
        at most `rounding`.
    rounding : float
        How large `residual` may come out for a target within reach, as in `Reachability`.
    matrix : ndarray, shape (n, K m)
        ``C = [B, A B, ..., A^(K-1) B]``.
    controls : ndarray, shape (K, m)
        Those of smallest 2-norm that come nearest to ``xf``; row k is u(k).
    """

    residual: float
    relative: float
    rank: int
    condition: float
    reachable: bool
    rounding: float
    matrix: Array
    controls: Array


def one_step(B: ArrayLike, x0: ArrayLike, xf: ArrayLike, A: ArrayLike) -> Reachability:
    """Check whether one step takes ``x0`` to ``xf``.

    Parameters
    ----------
    B : (n, m) array_like
        Input matrix.
    x0, xf : (n,) array_like
        Initial state and target.
    A : (n, n) array_like
        State matrix.

    Returns
    -------
    Reachability
        As that of a `Plan`, for the exact data: ``xf`` is reachable iff
        ``(I - B B+)(xf - A x0) = 0``.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, or ``xf - A x0`` overflows.

    Examples
    --------
    >>> from stochens_rs.theory import reachability
    >>> found = reachability.one_step([[1.0], [0.0]], [1.0, 1.0], [5.0, 0.0], [[1, 2], [0, 1]])
    >>> found.reachable, found.residual, found.rank
    (False, 1.0, 1)
    """
    B = gate.matrix("B", B)
    x0 = gate.vector("x0", x0, length=len(B))
    xf = gate.vector("xf", xf, length=len(B))
    A = gate.matrix("A", A, rows=len(B), cols=len(B))
    return best_in_one_step(A, B, x0, xf).reachability()


def several_steps(
    B: ArrayLike, x0: ArrayLike, xf: ArrayLike, A: ArrayLike, steps: int
) -> StepsReachability:
    """Check whether K steps take ``x0`` to ``xf``, and compute the smallest controls that do.

    Parameters
    ----------
    B : (n, m) array_like
        Input matrix.
    x0, xf : (n,) array_like
        Initial state and target.
    A : (n, n) array_like
        State matrix.
    steps : int
        Number of steps K, at least 1.

    Returns
    -------
    StepsReachability
        Residual, rank and condition of the controllability matrix, and the controls.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, or a power of A overflows.
    ResourceError
        The controllability matrix does not fit into memory.

    Notes
    -----
    ``x(K) = A^K x0 + C [u(K-1); ...; u(0)]``. (The printed product of the paper, with K + 1
    factors, has one too many.) The range of C grows with K up to ``K = n``; what has to lie in it,
    ``xf - A^K x0``, changes with K, too, so that a target within reach of fewer steps need not be
    within reach of more.

    Examples
    --------
    >>> from stochens_rs.theory import reachability
    >>> A, B = [[1.0, 1.0], [0.0, 1.0]], [[0.0], [1.0]]
    >>> found = reachability.several_steps(B, [0.0, 0.0], [1.0, 0.0], A, 2)
    >>> found.reachable, found.controls.round(12).tolist()
    (True, [[1.0], [-1.0]])
    """
    C = controllability_matrix(A, B, steps)
    B = gate.matrix("B", B)
    n, m = B.shape
    K = checked_steps(steps, n, m)
    x0 = gate.vector("x0", x0, length=n)
    xf = gate.vector("xf", xf, length=n)
    A = gate.matrix("A", A)
    best = best_over_steps(matrix_powers(A, K), B, x0, xf)
    return StepsReachability(**vars(best.reachability()), matrix=C, controls=best.u.reshape(K, m))


def controllability_matrix(A: ArrayLike, B: ArrayLike, steps: int) -> Array:
    """The controllability matrix ``C = [B, A B, ..., A^(K-1) B]``.

    Parameters
    ----------
    A : (n, n) array_like
        State matrix.
    B : (n, m) array_like
        Input matrix.
    steps : int
        Number of steps K, at least 1.

    Returns
    -------
    (n, K m) array
        Columns ``k m`` to ``(k + 1) m`` are ``A^k B``, the effect of u(K - 1 - k) on x(K).

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, or a power of A overflows.
    ResourceError
        The matrix does not fit into memory.

    Examples
    --------
    >>> from stochens_rs.theory import reachability
    >>> reachability.controllability_matrix([[1.0, 1.0], [0.0, 1.0]], [[0.0], [1.0]], 3)
    array([[0., 1., 2.],
           [1., 1., 1.]])
    """
    A = gate.matrix("A", A, square=True)
    B = gate.matrix("B", B, rows=len(A))
    steps = gate.size("steps", steps)
    memory.need("the controllability matrix", 4 * steps * B.nbytes)
    blocks = [B]
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(steps - 1):
            blocks.append(A @ blocks[-1])
    C = np.hstack(blocks)
    _finite(C)
    return C


def gramian(A: ArrayLike, B: ArrayLike, steps: int) -> Array:
    """The reachability Gramian of K steps, ``W = sum_{k<K} A^k B B^T (A^k)^T = C C^T``.

    Parameters
    ----------
    A : (n, n) array_like
        State matrix.
    B : (n, m) array_like
        Input matrix.
    steps : int
        Number of steps K, at least 1.

    Returns
    -------
    (n, n) array
        Symmetric and positive semidefinite; ``d^T W+ d`` is the least energy ``sum_k ||u(k)||^2``
        that moves the state by d.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, or the Gramian overflows.
    ResourceError
        The controllability matrix does not fit into memory.

    Examples
    --------
    >>> from stochens_rs.theory import reachability
    >>> reachability.gramian([[1.0, 1.0], [0.0, 1.0]], [[0.0], [1.0]], 3)
    array([[5., 3.],
           [3., 3.]])
    """
    C = controllability_matrix(A, B, steps)
    with np.errstate(over="ignore", invalid="ignore"):
        W: Array = C @ C.T
    _finite(W)
    return W


def _finite(values: Array) -> None:
    if not np.isfinite(values).all():
        raise NonFiniteError("powers of `A`, or `xf - A x0`, overflow: scale the problem down")
