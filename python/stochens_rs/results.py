"""What the functions return: frozen records, each field with its shape and meaning.

A ``status`` says how a computation ended; wrong input raises instead. "completed": a method with
nothing to optimise ran through. "optimal": the recomputed gap is within the tolerance. The others
come with feasible weights, the best found, and a larger gap, which is reported:
"optimal_inaccurate": no solver got further; "user_limit": the time or the passes granted ran out;
"interrupted": Ctrl-C.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _gate, _html
from .exceptions import InputTypeError, NonFiniteError, ShapeError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from ._certificates import Basis
    from .ensembles import Ensemble
    from .rng import RngLike
    from .system import System

# How a computation ended, the most reassuring first.
STATUSES = ("completed", "optimal", "optimal_inaccurate", "user_limit", "interrupted")
_EPS = float(np.finfo(np.float64).eps)


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
    target : ndarray, shape of a realization, or None
        What was fitted to, or what the error of a uniform average is measured against.
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
    target: NDArray[np.float64] | None = None
    ensemble: Ensemble | None = None

    def __post_init__(self) -> None:
        from .ensembles import Ensemble

        _gate.kept("estimate", self.estimate)
        _gate.kept("weights", self.weights)
        if self.target is not None:
            _gate.kept("target", self.target, shape=self.estimate.shape)
        for name in ("error", "gap", "lower_bound"):
            value = getattr(self, name)
            if value is not None:
                finite(name, value)
        _gate.choice("status", self.status, STATUSES)
        _gate.text("method", self.method)
        _gate.flag("exact", self.exact)
        if self.ensemble is None:
            return
        N, shape = _gate.instance("ensemble", self.ensemble, Ensemble).size, self.ensemble.shape
        if shape != self.shape:
            raise ShapeError(f"`ensemble` must have shape {self.shape}, got {shape}")
        if len(self.weights) != N:
            raise ShapeError(f"`weights` must have {N} rows, got {len(self.weights)}")

    def __reduce__(self) -> tuple[Any, ...]:
        return Fit, tuple(getattr(self, one.name) for one in fields(self))

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the estimate."""
        return self.estimate.shape

    def _repr_html_(self) -> str:
        return _html.fit(self)

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

    def _repr_html_(self) -> str:
        return _html.path(self)

    def __post_init__(self) -> None:
        for name in ("errors", "gaps"):
            values = getattr(self, name)
            if values is not None:
                finite(name[:-1], float(values[int(np.argmin(np.isfinite(values)))]))

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
        Rank of B: singular values up to ``eta sigma_max``, ``eta = max(n, m) eps``, count as 0.
    condition : float
        Largest over smallest singular value of B above the rank cut-off.
    reachable : bool
        Whether `relative` is at most 1.5e-8, the square root of the rounding unit ``eps``, or
        `residual` at most `rounding`.
    rounding : float
        How large `residual` may come out for a target within reach,
        ``(n + 1) eps || |A| |x0| + |xf| || + theta ||B|| ||u||`` with the control u for it and
        ``theta = (2 max(n, m) + 4) eps``; below it,
        `residual` and `relative` say nothing. (Over several steps, with what rounding leaves in
        ``A^K x0`` and ``C_K``. For fusion="diagonal" the averages count as exact.)
    """

    residual: float
    relative: float
    rank: int
    condition: float
    reachable: bool
    rounding: float

    def _repr_html_(self) -> str:
        return _html.record(self)


def finite(name: str, value: object) -> None:
    """Refuse a figure of a fit that is no number, or too large for one."""
    if not _gate.is_real(value):
        raise InputTypeError(f"`{name}` must be a real number, got {_gate.show(value)}")
    if not isfinite(value):
        raise NonFiniteError(f"the {name} of the fit overflows ({value}): scale the problem down")


def reach_text(reach: Reachability) -> str:
    """In a few words, for the one line that shows a plan."""
    if not reach.reachable:
        return f"out of reach {100 * reach.relative:.3g} %"
    certain = reach.relative * reach.relative <= _EPS
    return "reachable" if certain else "reachable up to rounding"


@dataclass(frozen=True)
class PlanError:
    """How wrong a control is for a system that is known exactly.

    With ``v = B^+ (xf - A x0)``, the best control, and ``x_actual = A x0 + B v``, where it leads:

    Attributes
    ----------
    control : float
        ``||u - v||``.
    control_relative : float
        `control` over the norm of what `control_relative_to` names.
    state : float
        ``||B (u - v)||``, the distance between the state reached and `x_actual`.
    state_relative : float
        `state` over the norm of what `state_relative_to` names.
    residual : float
        ``||(I - B B^+)(xf - A x0)||``: by Pythagoras the distance to `xf` is
        ``sqrt(state^2 + residual^2)``.
    control_rounding : float
        The exact ``||u - v||`` lies within `control` plus or minus this; inf if rounding leaves no
        figure of v.
    state_rounding : float
        The same for `state`, and for `residual`.
    control_relative_to : str
        "v"; or "B^+ A x0", the control that takes x0 to the origin, if v is 0 but for rounding; or
        "nothing", if that is 0, too: `control_relative` is then 0 for 0, inf otherwise.
    state_relative_to : str
        "x_actual"; or "x0", if `x_actual` is 0 but for rounding; or "nothing", as above.

    Notes
    -----
    Rounding: the factors of B are exact for a matrix ``B + E``, ``||E|| <= theta ||B||``,
    ``theta = (2 max(n, m) + 4) eps`` (LAPACK Users' Guide, 4.9, and measured); ``xf - A x0``
    is off by ``rho = (n + 1) eps || |A| |x0| + |xf| ||`` at most. To first order in
    ``theta condition(B)`` (Wedin, BIT 13 (1973) 217-232), with r the residual,
    ``g = sigma_min(B) - theta ||B||``, ``t = theta ||B|| ||r|| / g``, ``eta = max(n, m) eps``, and
    B of the rank that the rule of `Reachability` finds:

    - `control_rounding` = ``(rho + 2 theta ||B|| ||v|| + t) / g + eps (||u - v|| + ||v||)``;
    - `state_rounding` = ``rho + theta ||B|| ||v|| + t + eta ||B||_F (||v|| + ||u - v||)``.

    Over several steps ``C_K`` and ``A^K x0`` take the places of B and ``A x0``; what rounding
    leaves in them is added to ``theta ||B||`` and ``rho``.
    """

    control: float
    control_relative: float
    state: float
    state_relative: float
    residual: float
    control_rounding: float
    state_rounding: float
    control_relative_to: str
    state_relative_to: str

    def _repr_html_(self) -> str:
        return _html.plan_error(self)


@dataclass(frozen=True, repr=False)
class PlanBound:
    """How wrong a control may be, for the exact values the plan's estimates stand for.

    With the best control ``v`` and where it leads, ``x = A^K x0 + C_K v`` (one step: ``K = 1``,
    ``C_1 = B``):

    Attributes
    ----------
    state : float
        The state that the control leads to is at most this far from ``x``, ``||C_K (u - v)||_2``.
    control : float
        ``||u - v||_2`` is at most this.
    target : float
        The state that the control leads to is at most this far from ``xf``: ``state`` and what no
        control reaches, ``sqrt(state^2 + ||xf - x||^2)``. Fails only where `state` does.
    delta : float
        `state` and `control` each fail with at most this probability.
    state_bound, control_bound : str
        What gave them. "simulated": the order statistic of errors drawn from the laws
        (`theory.bounds.Simulated`). "exact error": nothing is random, and this is the error, with
        what rounding may add. "sum of errors": the triangle inequality, with the error of every
        estimate (`theory.bounds.from_errors`). Others: a formula of `theory.bounds`.
    relative_to : str
        What the exact values are. "laws": those the realizations were drawn from. "targets":
        for the entities that were fitted, the target of the fit, whatever the truth is.
    certain : bool
        Whether the radii hold surely, with no probability of failure.
    """

    state: float
    control: float
    target: float
    delta: float
    state_bound: str
    control_bound: str
    relative_to: str
    certain: bool

    @property
    def covers(self) -> str:
        """Over what the radii hold, in words."""
        how = (
            "surely, as nothing was drawn"
            if self.certain
            else f"each of the two with {self._share} at least, over the draws of the realizations"
        )
        what = (
            "the exact values are those that the realizations were drawn from"
            if self.relative_to == "laws"
            else "in place of exact values that were fitted stand the targets of the fits"
        )
        return f"{how}; {what}"

    @property
    def _share(self) -> str:
        return f"probability {100 * (1 - self.delta):.6g} %"

    def __repr__(self) -> str:
        return (
            f"<PlanBound: state within {self.state:.3g}, {self.target:.3g} from xf, control within "
            f"{self.control:.3g}, {'surely' if self.certain else f'with {self._share}'}>"
        )

    def _repr_html_(self) -> str:
        return _html.plan_bound(self)


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
    _basis: Basis | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        _gate.kept("u", self.u, ndim=(1,))
        _gate.kept("predicted_state", self.predicted_state, ndim=(1,))
        _gate.instance("reachability", self.reachability, Reachability)
        _gate.choice("fusion", self.fusion, ("product", "diagonal"))
        _gate.choice("status", self.status, STATUSES)

    def __reduce__(self) -> tuple[Any, ...]:
        from ._pickles import reduced

        return reduced(self)

    def bound(
        self,
        delta: float = 0.05,
        *,
        system: System | None = None,
        x0: ArrayLike | None = None,
        xf: ArrayLike | None = None,
        rng: RngLike = 0,
    ) -> PlanBound:
        """Bound the error of the control, from what the plan knows of its entities.

        Parameters
        ----------
        delta : float, default 0.05
            Probability of failure of each radius, in (0, 1).
        system : System, optional
            Needed only if the law of A is unknown: the system whose A its realizations are
            independent singletons of, as `sample` draws them.
        x0, xf : array_like, shape (n,), optional
            The same for x0 and xf.
        rng : None, int, SeedSequence, Generator, BitGenerator or Key, default 0
            Source of randomness of the simulation; with the default the same bound in every call.

        Returns
        -------
        PlanBound
            Radii for the state and for the control, and what gave them.

        Raises
        ------
        InputError, InputTypeError
            If `delta` does not lie in (0, 1); the law of an entity is unknown (realizations
            brought by the user, a part of a systematic sample) and not declared, or a declared
            one contradicts the plan; two entities were drawn with the same key; systematic
            realizations of rows are paired.

        Notes
        -----
        The realizations are drawn again, thousands of times, and an order statistic of the errors
        is the bound (`theory.bounds.Simulated`): it holds over the draws of the realizations, and
        comes within a few percent of the error that is exceeded with probability `delta`. Fits
        ("alse", "slse") are taken as they are: their distance from their targets is known. With
        fits and exact values only, nothing is random and the bound is the error itself, relative
        to the targets. Where a simulation would take too long (`delta` below about 1e-4, n of
        several hundreds), the formulas of `theory.bounds`.

        For realizations brought by the user, neither the law nor the exact values are known, and
        no bound follows from a plan. With a bound on how far two realizations can be apart,
        `DataStream.confidence` has one. To compare with a nominal system, see `Plan.error`.

        Examples
        --------
        >>> import stochens_rs as se
        >>> system = se.System([[0.9, 0.2], [-0.1, 0.8]], [[1.0, 0.0], [0.5, 1.0]])
        >>> plan = se.steer(system, [1.0, 2.0], [0.0, 0.0], 10_000, rng=1)
        >>> bound = plan.bound(0.01)
        >>> plan.error(system, [1.0, 2.0], [0.0, 0.0]).state <= bound.state < 0.06
        True
        """
        from ._certificates import completed, plan_bound

        delta = _gate.probability("delta", delta)
        basis = completed(self._basis, system, x0, xf, "bound")
        return plan_bound(basis, self.u, delta, rng, fusion=self.fusion)  # type: ignore[arg-type]

    def _repr_html_(self) -> str:
        return _html.plan(self)

    def covariance(
        self,
        *,
        system: System | None = None,
        x0: ArrayLike | None = None,
        xf: ArrayLike | None = None,
    ) -> NDArray[np.float64]:
        """Compute the exact covariance of the control, over draws of the realizations.

        Parameters
        ----------
        system, x0, xf
            As in `bound`: needed only for entities whose law is unknown.

        Returns
        -------
        ndarray, shape (m, m)
            `theory.moments.control_covariance` for the sizes, the fusion, the scheme and the axis
            of this plan. That of the state is ``B @ covariance @ B.T``.

        Raises
        ------
        InputError, InputTypeError
            As `bound`; and if an entity was fitted with other than uniform weights, or if iid and
            systematic samples are mixed or the latter paired: no formula is known.

        Notes
        -----
        For realizations of another law, brought by the user and independent of each other,
        ``np.cov(se.realization_controls(B, x0, xf, A), rowvar=False) / N`` estimates the
        covariance for fusion="diagonal"; a plan does not keep the realizations.

        Examples
        --------
        >>> import stochens_rs as se
        >>> A, B = [[1.0, 0.0], [2.0, 5.0]], [[1.0], [0.0]]
        >>> se.control(B, [1.0, 1.0], se.sample([2.0, 2.0], 10, rng=1), A).covariance()
        array([[0.4]])
        """
        from ._certificates import completed, plan_covariance

        basis = completed(self._basis, system, x0, xf, "covariance")
        return plan_covariance(basis, self.fusion)  # type: ignore[arg-type]

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
        from . import _exact
        from .system import System

        checked = System.from_any(system)
        if checked.m != len(self.u):
            raise ShapeError(
                f"`system` must have m={len(self.u)} inputs as this plan, got m={checked.m}"
            )
        start = _gate.vector("x0", x0, length=checked.n)
        goal = _gate.vector("xf", xf, length=checked.n)
        return _exact.one_step(checked.A, checked.B, start, goal).error(self.u, start)

    def __repr__(self) -> str:
        from ._expectations import expectation

        return f"<Plan {self.fusion}: m={len(self.u)}, {self.status}, {expectation(self)}>"
