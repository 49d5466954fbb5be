"""A control over several steps as a record, and how far its end can be from the target."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from . import _gate
from ._known import Known, grown, spectral_norms
from .exceptions import InputError, NonFiniteError, ShapeError, SizeError
from .fusing import _norm
from .results import PlanError, Reachability
from .system import System
from .theory.multistep import (
    controllability,
    final_state_covariance,
    matrix_powers,
    states,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats: TypeAlias = NDArray[np.float64]

__all__ = ["TrajectoryBound", "TrajectoryPlan"]


@dataclass(frozen=True)
class TrajectoryBound:
    """A bound of the distance between the state after the last step and the target.

    Attributes
    ----------
    state : float
        The bound of ``||x(K) - xf||``: the sum of the four parts.
    target : float
        ``||xf_hat - xf||``, or its radius.
    initial : float
        ``||A^K|| ||x0 - x0_hat||``.
    matrix : float
        ``||A - A_hat|| sum_k ||A^{K-1-k}|| ||xh(k)||`` along the predicted states ``xh``.
    residual : float
        ``||xh(K) - xf_hat||``: what the model itself leaves.
    delta : float
        Probability with which the bound may fail; 0 if it holds surely.
    """

    state: float
    target: float
    initial: float
    matrix: float
    residual: float
    delta: float


@dataclass(frozen=True, eq=False, repr=False)
class TrajectoryPlan:
    """A control over K steps, and what is known about it.

    Attributes
    ----------
    u : ndarray, shape (K, m)
        The control; ``u[k]`` acts in the step from k to k + 1.
    predicted_states : ndarray, shape (K + 1, n)
        Trajectory of the model, ``xh(k+1) = A_hat xh(k) + B u(k)`` from ``x0_hat``.
    reachability : Reachability
        What K steps cannot reach, from the same estimates: residual and relative residual of
        ``xf_hat - A_hat^K x0_hat``, rank and condition of
        ``C_K = [A_hat^{K-1} B, ..., A_hat B, B]``.
    status : str
        The worst status among the entities' fits; "completed" if none was optimised.
    info : dict
        Per entity: method, number of realizations, gap; "singular_values" of C_K; "warnings", a
        tuple of sentences.
    """

    u: Floats
    predicted_states: Floats
    reachability: Reachability
    status: str
    info: dict[str, Any] = field(default_factory=dict)
    _B: Floats = field(init=False)
    _known: tuple[Known, ...] = field(init=False)

    def _with(self, B: Floats, known: tuple[Known, ...]) -> TrajectoryPlan:
        """Enter what the bounds need: the input matrix, and what is known of x0, xf and A."""
        object.__setattr__(self, "_B", B)
        object.__setattr__(self, "_known", known)
        return self

    @property
    def steps(self) -> int:
        """Number of steps K."""
        return len(self.u)

    def bound(self, delta: float) -> TrajectoryBound:
        """Bound ``||x(K) - xf||`` from what is known of the realizations, before any is simulated.

        Parameters
        ----------
        delta : float
            Probability with which the bound may fail, 0 < delta < 1.

        Returns
        -------
        TrajectoryBound
            With probability at least ``1 - delta`` over the draws,
            ``||x(K) - xf|| <= ef + ||A^K|| e0 + eA sum_k ||A^{K-1-k}|| ||xh(k)|| + residual``.

        Raises
        ------
        InputError, InputTypeError
            If `delta` is not a probability, nothing is known of the law of an entity, or the bound
            overflows.

        Notes
        -----
        Uniform averages of what `sample` drew: radii from the law, a bounded-difference bound for
        x0 and xf and the matrix Bernstein inequality for ``||A - A_hat||_2``, the failure
        probability shared equally; ``||A^k||`` from the law. Systematic samples: sure radii. Fits
        to a target: their reported errors, hence *relative to these targets*, with ``||A^k||``
        bounded by powers of ``A_hat``: ``a_k = p_k + eA sum_{i<k} a_i p_{k-1-i}``,
        ``p_k = ||A_hat^k||``. The paper has no such statement for K > 1.

        Examples
        --------
        >>> import stochens_rs as se
        >>> system = se.System([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]])
        >>> plan = se.steer(system, [1.0, 0.0], [0.0, 0.0], 10**6, steps=20, rng=1)
        >>> bound, error = plan.bound(0.01), plan.error(system, [1.0, 0.0], [0.0, 0.0])
        >>> error.state <= bound.state < 0.5
        True
        """
        delta = _gate.positive("delta", delta)
        if delta >= 1.0:
            raise SizeError(f"`delta` must be in (0, 1), got {_gate.show(delta)}")
        random = sum(one.random for one in self._known)
        with np.errstate(over="ignore", invalid="ignore"):
            e0, ef, eA = (one.radius(delta / max(random, 1)) for one in self._known)
        A = self._known[2]
        if A.value is not None and A.law in ("iid", "systematic"):
            norms = spectral_norms(matrix_powers(A.value, self.steps))
        else:
            norms = grown(spectral_norms(matrix_powers(A.estimate, self.steps, "A_hat")), eA)
        return self._sum(e0, ef, eA, norms, delta if random else 0.0)

    def error_bound(self, system: System, x0: ArrayLike, xf: ArrayLike) -> TrajectoryBound:
        """Bound ``||x(K) - xf||`` by the errors of the estimates, for an exactly known system.

        Parameters
        ----------
        system : System
            The true or nominal system, with the same ``B``.
        x0, xf : array_like, shape (n,)
            The true initial state and the target.

        Returns
        -------
        TrajectoryBound
            The bound of `bound` with ``e0 = ||x0 - x0_hat||``, ``ef = ||xf_hat - xf||`` and
            ``eA = ||A - A_hat||_2``; it holds surely, up to rounding.

        Raises
        ------
        InputError, InputTypeError
            If the arguments do not fit this plan, or the bound overflows.

        Notes
        -----
        The triangle inequality for the identity in :mod:`~stochens_rs.theory.multistep`.

        Examples
        --------
        >>> import stochens_rs as se
        >>> system = se.System([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]])
        >>> plan = se.steer(system, [1.0, 0.0], [0.0, 0.0], 1000, steps=20, rng=1)
        >>> error = plan.error(system, [1.0, 0.0], [0.0, 0.0])
        >>> error.state <= plan.error_bound(system, [1.0, 0.0], [0.0, 0.0]).state
        True
        """
        checked, start, goal = self._fitting(system, x0, xf)
        if not np.array_equal(checked.B, self._B):
            raise InputError("`system` must have the B of this plan: the bound holds for exact B")
        with np.errstate(over="ignore"):
            wrong = [
                one.estimate - exact
                for one, exact in zip(self._known, (start, goal, checked.A), strict=True)
            ]
        if not all(np.isfinite(values).all() for values in wrong):
            raise NonFiniteError("the error of an estimate overflows: scale the problem down")
        e0, ef, eA = _norm(wrong[0]), _norm(wrong[1]), float(spectral_norms(wrong[2][None])[0])
        return self._sum(e0, ef, eA, spectral_norms(matrix_powers(checked.A, self.steps)), 0.0)

    def covariance(self) -> Floats:
        """Leading-order covariance of the state after the last step, from the law of the draws.

        Returns
        -------
        ndarray, shape (n, n)
            `theory.multistep.final_state_covariance` of the exact entities and the numbers of
            realizations of this plan; its trace approaches ``E||x(K) - xf||^2`` for large N.

        Raises
        ------
        InputError
            If an entity is neither exact nor the uniform average of independent draws of
            `sample`, two entities share their draws, or ``C_K`` has a rank below n.

        Examples
        --------
        >>> import stochens_rs as se
        >>> system = se.System([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]])
        >>> plan = se.steer(system, [1.0, 0.0], [0.0, 0.0], 1000, steps=20, rng=1)
        >>> plan.covariance().shape
        (2, 2)
        """
        exact = []
        for one in self._known:
            if one.law not in ("iid", "exact"):
                raise InputError(
                    f"`{one.name}` must be exact or the uniform average of independent draws of "
                    f"`sample` for a covariance, got a law that is {one.law}"
                )
            exact.append(one.estimate if one.value is None else one.value)
        keys = [one.key for one in self._known if one.key is not None]
        if len(set(keys)) < len(keys):
            raise InputError(
                "`x0`, `xf` and `A` must be drawn independently for a covariance, but two of them "
                "have the same key: use rng=key.child(name)"
            )
        x0, xf, A = exact
        sizes = (self._known[0].size, self._known[1].size, self._known[2].size)
        return final_state_covariance(
            A, self._B, x0, xf, self.steps, sizes, axis=self._known[2].axis
        )

    def error(self, system: System, x0: ArrayLike, xf: ArrayLike) -> PlanError:
        """Compare the control with the minimum-norm one for an exactly known system.

        Parameters
        ----------
        system : System
            The true system.
        x0, xf : array_like, shape (n,)
            The true initial state and the target.

        Returns
        -------
        PlanError
            With ``v = C_K^+ (xf - A^K x0)`` for all K steps in place of the one-step control and
            ``C_K`` in place of B: the error of the control, the distance between the two last
            states, and what K steps leave of the target. ``||x(K) - xf||`` is
            ``sqrt(state^2 + residual^2)``.

        Raises
        ------
        InputError, InputTypeError
            If the arguments do not fit this plan, or something overflows.

        Examples
        --------
        >>> import stochens_rs as se
        >>> system = se.System([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]])
        >>> plan = se.control_steps(system.B, [1.0, 0.0], [0.0, 0.0], system.A, 5)
        >>> plan.error(system, [1.0, 0.0], [0.0, 0.0]).control
        0.0
        """
        from .controls import _ratio, pseudoinverse

        checked, start, goal = self._fitting(system, x0, xf)
        powers = matrix_powers(checked.A, self.steps)
        C = controllability(powers, checked.B)
        with np.errstate(over="ignore", invalid="ignore"):
            difference = goal - powers[-1] @ start
            best = pseudoinverse(C)[0] @ difference
            wrong = self.u.ravel() - best
            pushed = C @ best
            shift = C @ wrong
            reached = powers[-1] @ start + pushed
        if not all(np.isfinite(v).all() for v in (wrong, shift, reached)):
            raise NonFiniteError("the control or the last state overflows: scale the problem down")
        return PlanError(
            control=_norm(wrong),
            control_relative=_ratio(_norm(wrong), _norm(best)),
            state=_norm(shift),
            state_relative=_ratio(_norm(shift), _norm(reached)),
            residual=_norm(difference - pushed),
        )

    def states(self, system: System, x0: ArrayLike) -> Floats:
        """Trajectory of an exactly known system under this control.

        Parameters
        ----------
        system : System
            The true system.
        x0 : array_like, shape (n,)
            Its initial state.

        Returns
        -------
        ndarray, shape (K + 1, n)
            ``x(k+1) = A x(k) + B u(k)``.

        Raises
        ------
        InputError, InputTypeError
            If the arguments do not fit this plan, or a state overflows.

        Examples
        --------
        >>> import stochens_rs as se
        >>> system = se.System([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]])
        >>> plan = se.control_steps(system.B, [1.0, 0.0], [0.0, 0.0], system.A, 5)
        >>> bool(abs(plan.states(system, [1.0, 0.0])[-1]).max() < 1e-12)
        True
        """
        checked, start, _ = self._fitting(system, x0, None)
        return states(checked.A, checked.B, self.u, start)

    def _fitting(self, system: object, x0: object, xf: object) -> tuple[System, Floats, Floats]:
        checked = System.from_any(system)
        n, m = self.predicted_states.shape[1], self.u.shape[1]
        if (checked.n, checked.m) != (n, m):
            raise ShapeError(
                f"`system` must have n={n} and m={m} as this plan, got n={checked.n} and "
                f"m={checked.m}"
            )
        start = _gate.vector("x0", x0, length=n)
        return checked, start, start if xf is None else _gate.vector("xf", xf, length=n)

    def _sum(self, e0: float, ef: float, eA: float, norms: Floats, delta: float) -> TrajectoryBound:
        """The parts of the bound, ``norms[k] >= ||A^k||``."""
        K = self.steps
        along = np.array([_norm(state) for state in self.predicted_states[:K]])
        with np.errstate(over="ignore", invalid="ignore"):
            matrix = eA * float(norms[K - 1 :: -1] @ along) if eA > 0.0 else 0.0
            initial = float(norms[K]) * e0 if e0 > 0.0 else 0.0
            residual = _norm(self.predicted_states[K] - self._known[1].estimate)
            total = ef + initial + matrix + residual
        if not math.isfinite(total):
            raise NonFiniteError("the bound overflows: take fewer steps, or more realizations")
        return TrajectoryBound(total, ef, initial, matrix, residual, delta)

    def __repr__(self) -> str:
        K, m = self.u.shape
        return (
            f"<TrajectoryPlan: {K} steps, m={m}, {self.status}, "
            f"out of reach {100 * self.reachability.relative:.3g} %>"
        )
