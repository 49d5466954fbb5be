"""Stability of tracking with feedback, in the mean square."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..._base import memory
from ..._base.types import Floats
from ...system import System
from ..formulas import Size, checked_finite, compact_svd, inverse_size
from ..positive_maps import excitation_radius, moment_radius


def stability_threshold(system: System | Any) -> float:
    """Number of realizations per step above which tracking with feedback is stable.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes, such as ``(A, B)``. ``B`` is known exactly
        and may have any rank.

    Returns
    -------
    float
        The closed loop is stable in the mean square if and only if ``N`` exceeds it. With
        ``P = I`` it is ``rho(Phi)``, ``Phi_ij = |A_ij| (g_j - |A_ij|)``; inf if ``(I - P) A`` has
        an eigenvalue on or outside the unit circle, so that no N helps.

    Raises
    ------
    InputError, InputTypeError, ResourceError
        A shape does not fit, an entry is not finite, or ``4 n^3`` numbers do not fit into memory.

    Notes
    -----
    The spectral radius of ``S -> (I-P) A S A^T (I-P) + (1/N) P T_A(diag S) P`` is below 1 if and
    only if ``N > rho(Psi)`` with the nonnegative n x n matrix
    ``Psi_ij = [sum_k F^k P Cv(a_j) P F^kT]_ii``, ``F = (I - P) A``: the second term of the map sees
    the diagonal of S only. Power iteration, O(n^3) a step; O(n^4) where it does not converge.

    Examples
    --------
    >>> stability_threshold(([[0.0, 3.0], [3.0, 1.0]], [[1.0, 0.0], [0.0, 1.0]]))
    3.0
    >>> stability_threshold(([[2.0, 1.0], [0.0, 1.0]], [[0.0], [1.0]]))
    inf
    """
    A, F, P, scale = _loop(system)
    threshold = excitation_radius(A, scale * F, P)
    if threshold in (0.0, math.inf):
        return threshold
    return checked_finite(threshold * scale * scale, "square of `A`")


def stability_radius(system: System | Any, size: Size = 1) -> float:
    """Factor by which the mean square tracking error grows per step in the long run, with feedback.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes, such as ``(A, B)``. ``B`` is known exactly
        and may have any rank.
    size : int or None, default 1
        Number of realizations in every step; None or inf: the exact system.

    Returns
    -------
    float
        Spectral radius of ``S -> (I-P) A S A^T (I-P) + (1/N) P T_A(diag S) P``; the closed loop
        is stable in the mean square if and only if it is below 1.

    Raises
    ------
    InputError, InputTypeError, ResourceError
        As :func:`stability_threshold`.

    Examples
    --------
    >>> stability_radius(([[0.0, 3.0], [3.0, 1.0]], [[1.0, 0.0], [0.0, 1.0]]), 12)
    0.25
    """
    A, F, P, scale = _loop(system)
    radius = moment_radius(A, F, P, inverse_size("size", size)) * scale * scale
    return checked_finite(radius, "square of `A`")


def _loop(system: object) -> tuple[Floats, Floats, Floats, float]:
    """``A`` and ``F = (I - P) A`` over the largest entry of ``A``, ``P`` and that entry."""
    checked = System.from_any(system)
    A, U = checked.A, compact_svd(checked.B)[0]
    memory.need("the stability of the closed loop", 4 * 8 * len(A) ** 3)
    scale = float(np.abs(A).max()) or 1.0
    P = np.eye(len(A)) if U.shape[1] == len(A) else U @ U.T  # P = I exactly: then F = 0 exactly
    A = A / scale
    return A, A - P @ A, P, scale
