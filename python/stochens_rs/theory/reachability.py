"""Which states the exact system can reach in K steps.

`stochens_rs.control` computes whether a target is within reach, and the control.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .._base.types import Floats
from ..system.system import System
from .exact import checked_steps, controllability, matrix_powers
from .formulas import checked_finite

__all__ = ["controllability_matrix", "gramian"]


def controllability_matrix(system: System | Any, steps: int) -> Floats:
    """The controllability matrix ``C_K = [B, A B, ..., A^{K-1} B]``.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes, such as ``(A, B)``.
    steps : int
        Number of steps K, at least 1.

    Returns
    -------
    (n, K m) array
        ``x(K) = A^K x(0) + C_K [u(K-1); ...; u(0)]``: columns ``k m`` to ``(k + 1) m`` are
        ``A^k B``, the effect of u(K - 1 - k) on x(K).

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, or a power of A overflows.
    ResourceError
        The matrix, or the powers of A, do not fit into memory.

    Notes
    -----
    (The product printed in the paper has K + 1 factors, one too many.) The range of ``C_K`` grows
    with K up to ``K = n``. As ``xf - A^K x0``, which must lie in it, depends on K, a target within
    reach in K steps may be out of reach in more.

    Examples
    --------
    >>> from stochens_rs.theory import reachability
    >>> reachability.controllability_matrix(([[1.0, 1.0], [0.0, 1.0]], [[0.0], [1.0]]), 3)
    array([[0., 1., 2.],
           [1., 1., 1.]])
    """
    checked = System.from_any(system)
    K = checked_steps(steps, checked.n, checked.m)
    return controllability(matrix_powers(checked.A, K - 1), checked.B)


def gramian(system: System | Any, steps: int) -> Floats:
    """The reachability Gramian of K steps, ``W = sum_{k<K} A^k B B^T (A^k)^T = C_K C_K^T``.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes, such as ``(A, B)``.
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
        The controllability matrix, or the powers of A, do not fit into memory.

    Examples
    --------
    >>> from stochens_rs.theory import reachability
    >>> reachability.gramian(([[1.0, 1.0], [0.0, 1.0]], [[0.0], [1.0]]), 3)
    array([[5., 3.],
           [3., 3.]])
    """
    C = controllability_matrix(system, steps)
    with np.errstate(over="ignore", invalid="ignore"):
        return checked_finite(C @ C.T, "Gramian")
