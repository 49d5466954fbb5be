"""What the functions return: frozen records, each field with its shape and meaning.

A ``status`` says how a computation ended; wrong input raises instead. "completed": a method with
nothing to optimise ran through. "optimal": the recomputed gap is within the tolerance. The others
come with feasible weights, the best found, and a larger gap, which is reported:
"optimal_inaccurate": no solver got further; "user_limit": the time or the passes granted ran out;
"interrupted": Ctrl-C.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _gate

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from .ensembles import Ensemble
    from .system import System


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """Fused realizations of one vector or matrix.

    Attributes
    ----------
    estimate : ndarray, shape of a realization
        ``sum_s weights[s] E_s``.
    weights : ndarray, shape (N,)
        Nonnegative; their sum is 1 (at most 1 for ``weights="subsimplex"``). Shape (N, m) for
        ``weights="per-column"``: ``weights[:, j]`` belongs to column j; (N, n) for "per-row".
    error : float or None
        ``||estimate - target||`` (2-norm; Frobenius for matrices); None without a target.
    gap : float or None
        For ALSE: ``max_v <f', w - v>`` over the weight set, ``f = ||sum w E - target||^2``,
        recomputed from the realizations; ``f - min f <= gap``. None for other methods.
    status : str
        "completed", "optimal", "optimal_inaccurate", "user_limit" or "interrupted".
    method : str
        The method asked for.
    lower_bound : float or None
        For ALSE: no weights of the set have an error below this one; from the gap, or from the
        entries that no realization hits, whichever says more. None for other methods.
    exact : bool
        For ALSE: the target lies in the hull of the realizations; what is left of the error is
        rounding.
    unseen : int or None
        For ALSE: entries of the target that are not zero while they are in every realization. No
        weights reach them: the error is at least their norm. None for other methods.
    info : dict
        For ALSE "solver", "iterations" and the settings; empty for other methods.
    ensemble : Ensemble
        The realizations.
    """

    estimate: NDArray[np.float64]
    weights: NDArray[np.float64]
    error: float | None
    gap: float | None
    status: str
    method: str
    lower_bound: float | None = None
    exact: bool = False
    unseen: int | None = None
    info: dict[str, Any] = field(default_factory=dict)
    ensemble: Ensemble | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the estimate."""
        return self.estimate.shape

    def __repr__(self) -> str:
        error = "" if self.error is None else f", error {self.error:.3g}"
        gap = "" if self.gap is None else f", gap {self.gap:.1e}"
        return f"<Fit {self.method}: {len(self.weights)} realizations, {self.status}{error}{gap}>"


@dataclass(frozen=True, eq=False, repr=False)
class Path:
    """A fusion after the first k realizations, for a grid of k.

    Attributes
    ----------
    sizes : ndarray of int64, shape (k,)
        The prefix sizes, increasing.
    errors : ndarray, shape (k,)
        ``||estimate - target||`` after the first ``sizes[i]`` realizations.
    method : str
        The method asked for.
    statuses : tuple of str
        One status per size.
    gaps : ndarray, shape (k,), or None
        The gap of each ALSE solution; None for other methods.
    estimates : ndarray, shape (k, ...), or None
        The estimates, if they were asked for.
    """

    sizes: NDArray[np.int64]
    errors: NDArray[np.float64]
    method: str
    statuses: tuple[str, ...]
    gaps: NDArray[np.float64] | None = None
    estimates: NDArray[np.float64] | None = None

    def __repr__(self) -> str:
        return (
            f"<Path {self.method}: {len(self.sizes)} sizes from {self.sizes[0]} to "
            f"{self.sizes[-1]}, last error {self.errors[-1]:.3g}>"
        )


@dataclass(frozen=True)
class Reachability:
    """Whether one step can reach the (estimated) target, as far as the data say.

    Attributes
    ----------
    residual : float
        ``||(I - B B^+)(xf - A x0)||``: what no control can do.
    relative : float
        `residual` over ``||xf - A x0||``; 0 if that is 0.
    rank : int
        Rank of B.
    condition : float
        Largest over smallest singular value of B above the rank cut-off.
    reachable : bool
        Whether `relative` is at most 1e-8, the square root of the rounding unit.
    """

    residual: float
    relative: float
    rank: int
    condition: float
    reachable: bool


@dataclass(frozen=True)
class PlanError:
    """How wrong a control is for a system that is known exactly.

    With ``v = B^+ (xf - A x0)``, the best control, and ``x_actual = A x0 + B v``, where it leads:

    Attributes
    ----------
    control : float
        ``||u - v||``.
    control_relative : float
        ``||u - v|| / ||v||``; 0 for 0/0, inf otherwise if ``v = 0``.
    state : float
        ``||B (u - v)||``, the distance between the state reached and `x_actual`.
    state_relative : float
        ``||B (u - v)|| / ||x_actual||``, with the same convention.
    residual : float
        ``||(I - B B^+)(xf - A x0)||``: by Pythagoras the distance to `xf` is
        ``sqrt(state^2 + residual^2)``.
    """

    control: float
    control_relative: float
    state: float
    state_relative: float
    residual: float


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """A control for one step, and what is known about it.

    Attributes
    ----------
    u : ndarray, shape (m,)
        The control.
    predicted_state : ndarray, shape (n,)
        ``A x0 + B u`` with the fused (product) or averaged (diagonal) realizations.
    reachability : Reachability
        What is out of reach, from the same estimates.
    fusion : str
        "product" or "diagonal".
    status : str
        The worst status among the entities' fits; "completed" if none was optimised.
    info : dict
        Per entity: method, number of realizations, gap; singular values of B.
    """

    u: NDArray[np.float64]
    predicted_state: NDArray[np.float64]
    reachability: Reachability
    fusion: str
    status: str
    info: dict[str, Any] = field(default_factory=dict)

    def error(self, system: System, x0: ArrayLike, xf: ArrayLike) -> PlanError:
        """Compare the control with the best one for an exactly known system.

        Parameters
        ----------
        system : System
            The true system.
        x0, xf : array_like, shape (n,)
            The true initial state and the target.

        Returns
        -------
        PlanError
            Errors of the control and of the state it leads to.

        Raises
        ------
        ShapeError, NonFiniteError, InputTypeError
            If the arguments do not fit this plan.

        Examples
        --------
        >>> import stochens_rs as se
        >>> system = se.System([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]])
        >>> plan = se.control(system.B, [1.0, 1.0], [0.0, 0.0], system.A)
        >>> plan.error(system, [1.0, 1.0], [0.0, 0.0]).control
        0.0
        """
        from .controls import plan_error
        from .system import System

        checked = System.from_any(system)
        if checked.m != len(self.u):
            from .exceptions import ShapeError

            raise ShapeError(
                f"`system` must have m={len(self.u)} inputs as this plan, got m={checked.m}"
            )
        start = _gate.vector("x0", x0, length=checked.n)
        goal = _gate.vector("xf", xf, length=checked.n)
        return plan_error(self.u, checked, start, goal)

    def __repr__(self) -> str:
        return (
            f"<Plan {self.fusion}: m={len(self.u)}, {self.status}, "
            f"out of reach {100 * self.reachability.relative:.3g} %>"
        )
