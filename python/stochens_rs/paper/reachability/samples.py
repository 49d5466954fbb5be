"""Sample reachability (Definition 2.4): every realization of a finite list is checked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..._base import memory, validation
from ..._base.types import Floats
from ...exceptions import NonFiniteError
from ...system import System
from ...theory.bounds.base import unit_of
from ...theory.exact import REACHABLE, factors
from ...theory.formulas import fused_product_covariance, realization_covariance

# of the sums g0 g_j and gf, about 45 eps per unit: those of up to 45 terms, and longer ones in
# practice (Higham, Accuracy and Stability of Numerical Algorithms (2002), 4.2)
_ROUNDING = 1e-14


@dataclass(frozen=True)
class SampleReachability:
    """Which realizations can be steered in one step.

    Attributes
    ----------
    atoms : int
        Number of realizations ``(x0^s, A^s x0^s, xf^s)`` with positive probability, by the
        entries they hit.
    reachable_atoms : int
        How many of them have a control.
    probability : float
        Probability that a realization has a control.
    sample_reachable : bool
        Whether all have one, as Definition 2.4 asks.
    rms_residual : float
        ``sqrt(E||(I - P)(xf^s - A^s x0^s)||^2) = sqrt(tr[(I - P)(C_y + mu mu^T)])``.
    largest_residual : float
        The largest ``||(I - P)(xf^s - A^s x0^s)||``.
    residual : float
        ``||(I - P) mu||``, ``mu = xf - A x0``: that of the exact target.
    """

    atoms: int
    reachable_atoms: int
    probability: float
    sample_reachable: bool
    rms_residual: float
    largest_residual: float
    residual: float


def sample_reachability(system: System | Any, x0: ArrayLike, xf: ArrayLike) -> SampleReachability:
    """Check every realization of ``x0``, ``A`` (by columns) and ``xf`` for a one-step control.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes, such as ``(A, B)``; ``B`` is known exactly.
    x0, xf : (n,) array_like
        Initial state and target.

    Returns
    -------
    SampleReachability
        Counts, probability and residuals.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, or the products overflow.
    ResourceError
        The list of realizations does not fit into memory.

    Notes
    -----
    A realization needs ``(I - P)(gf sign(xf_k) e_k - c e_R) = 0``, ``c = g0 g_I sign(x0_I A_RI)``;
    it counts as reachable if the left side is at most 1.5e-8 of the vector, or rounding. A zero
    vector has the one realization 0. Sample reachable implies reachable, as realizations are
    unbiased; the converse is false, and with m < n it fails generically. Realizations that do not
    enter the step (columns of ``A`` that ``x0^s`` does not hit) are not counted.

    Examples
    --------
    >>> from stochens_rs.paper import reachability
    >>> system = [[1.0, 0.0], [1.0, 1.0]], [[1.0], [1.0]]
    >>> found = reachability.sample_reachability(system, [1.0, 0.0], [2.0, 2.0])
    >>> found.residual < 1e-15, found.atoms, found.reachable_atoms, found.sample_reachable
    (True, 4, 0, False)
    """
    checked = System.from_any(system)
    n = checked.n
    x0 = validation.vector("x0", x0, length=n)
    xf = validation.vector("xf", xf, length=n)
    with np.errstate(over="ignore", invalid="ignore"):
        unit, A, x0, xf = _in_units(checked.A, x0, xf)
        goals, p_goals = _atoms_of_vector(xf)
        moved, p_moved = _atoms_of_product(A, x0)
        mu = xf - A @ x0
        W = _left_over(checked.B)
        C_y = realization_covariance(xf) + fused_product_covariance(A, x0, 1.0, 1.0, "columns")
        mean_square = float(((W.T @ C_y) * W.T).sum()) + float(((W.T @ mu) ** 2).sum())
    if not (np.isfinite(mean_square) and np.isfinite(moved).all() and np.isfinite(goals).all()):
        raise NonFiniteError("the products overflow: scale the problem down")
    memory.need("the list of realizations", 4 * 8 * n * len(moved))
    projected = moved @ W
    count, reached, largest, probability = 0, 0, 0.0, 0.0
    for goal, p in zip(goals, p_goals, strict=True):
        residuals = np.linalg.norm(goal @ W - projected, axis=1)
        # the two may be equal but for the rounding of gf and g0 g_j
        rounding = _ROUNDING * (np.abs(goal).sum() + np.abs(moved).sum(axis=1))
        good = residuals <= REACHABLE * np.linalg.norm(goal - moved, axis=1) + rounding
        count, reached = count + good.size, reached + int(good.sum())
        probability += float(p) * float(p_moved[good].sum())
        largest = max(largest, float(residuals.max()))
    return SampleReachability(
        atoms=count,
        reachable_atoms=reached,
        probability=1.0 if reached == count else min(1.0, probability),
        sample_reachable=reached == count,
        rms_residual=unit * float(np.sqrt(max(0.0, mean_square))),
        largest_residual=unit * largest,
        residual=unit * float(np.linalg.norm(mu @ W)),
    )


def _in_units(A: Floats, x0: Floats, xf: Floats) -> tuple[float, Floats, Floats, Floats]:
    """The unit of ``xf`` and ``A x0``, in which squares neither overflow nor vanish, and all three.

    ``A`` and ``x0`` share it: only their product matters.
    """
    unit_A = unit_of(A)
    moved = unit_A * unit_of(x0) if A.any() and x0.any() else 0.0
    unit = max(moved, float(np.abs(xf).max())) or 1.0
    if not np.isfinite(unit):
        raise NonFiniteError("the products overflow: scale the problem down")
    return unit, A / unit_A, x0 / (unit / unit_A) if moved else 0.0 * x0, xf / unit


def _atoms_of_vector(w: Floats) -> tuple[Floats, Floats]:
    """Realizations (k, n) and their probabilities."""
    hit = np.flatnonzero(w)
    if hit.size == 0:
        return np.zeros((1, w.size)), np.ones(1)
    gamma = np.abs(w).sum()
    return gamma * np.sign(w[hit])[:, None] * np.eye(w.size)[hit], np.abs(w[hit]) / gamma


def _atoms_of_product(A: Floats, x0: Floats) -> tuple[Floats, Floats]:
    """Realizations of ``A^s x0^s`` (k, n) and their probabilities: x0 hits I, column I hits R."""
    g0, g = np.abs(x0).sum(), np.abs(A).sum(axis=0)
    rows, columns = np.nonzero((A != 0.0) & (x0 != 0.0))
    values = g0 * g[columns] * np.sign(A[rows, columns]) * np.sign(x0[columns])
    memory.need("the list of realizations", 8 * rows.size * x0.size)
    atoms = np.zeros((rows.size, x0.size))
    atoms[np.arange(rows.size), rows] = values
    p = np.abs(A[rows, columns]) / g[columns] * np.abs(x0[columns]) / (g0 or 1.0)
    # a column of zeros, or x0 = 0, gives 0
    nothing = 1.0 if g0 == 0.0 else float(np.abs(x0[g == 0.0]).sum() / g0)
    if nothing > 0.0:
        atoms, p = np.vstack([atoms, np.zeros(x0.size)]), np.append(p, nothing)
    return atoms, p


def _left_over(B: Floats) -> Floats:
    """An orthonormal basis (n, n - rank) of what B does not reach."""
    U = np.linalg.svd(B, full_matrices=True)[0]
    return np.asarray(U[:, len(factors(B).s) :], dtype=np.float64)
