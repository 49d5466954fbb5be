"""A control over several steps as a record."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .._base import gate, html
from .._base.records import by_constructor
from .._base.types import STATUSES, Status
from ..exceptions import InputError, ShapeError
from ..system import System
from ..theory.dynamics import states
from ..theory.exact import best_control
from ..theory.moments import final_state_covariance
from ..theory.records import PlanError, Reachability
from .basis import Basis, Known, completed
from .plan_bound import PlanBound, plan_bound
from .shown import expectation, made_from

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from ..rng import RngLike

    Floats: TypeAlias = NDArray[np.float64]


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
        ``C_K = [B, A_hat B, ..., A_hat^{K-1} B]``.
    status : str
        The worst status among the entities' fits; "completed" if none was optimised.
    info : dict
        Per entity: method, number of realizations, gap; "singular_values" of C_K; "warnings", a
        tuple of sentences.
    basis : Basis or None
        As that of a `Plan`.
    """

    u: Floats
    predicted_states: Floats
    reachability: Reachability
    status: Status
    info: dict[str, Any] = field(default_factory=dict)
    basis: Basis | None = None

    def __post_init__(self) -> None:
        gate.kept("u", self.u, ndim=(2,))
        gate.kept("predicted_states", self.predicted_states, ndim=(2,))
        if len(self.predicted_states) != len(self.u) + 1:
            raise ShapeError(
                f"`predicted_states` must have {len(self.u) + 1} rows, one more than `u`, got "
                f"{len(self.predicted_states)}"
            )
        gate.instance("reachability", self.reachability, Reachability)
        gate.choice("status", self.status, STATUSES)
        if self.basis is not None:
            gate.instance("basis", self.basis, Basis)

    def __reduce__(self) -> tuple[Any, ...]:
        return by_constructor(self)

    @property
    def steps(self) -> int:
        """Number of steps K."""
        return len(self.u)

    def bound(
        self,
        delta: float = 0.05,
        *,
        system: System | None = None,
        x0: ArrayLike | None = None,
        xf: ArrayLike | None = None,
        rng: RngLike = 0,
    ) -> PlanBound:
        """Bound the error of the control, as `Plan.bound` does, with ``C_K`` in place of ``B``.

        Parameters
        ----------
        delta, system, x0, xf, rng
            As in `Plan.bound`.

        Returns
        -------
        PlanBound
            Radii for the last state and for the control, and what gave them.

        Raises
        ------
        InputError, InputTypeError
            As `Plan.bound`; or a bound overflows.

        Notes
        -----
        Where a simulation would take too long, the triangle inequality along the predicted states
        ``xh``: ``||x(K) - xf|| <= ef + ||A^K|| e0 + eA sum_k ||A^{K-1-k}|| ||xh(k)||
        + ||xh(K) - xf_hat||``. The paper has no such statement for K > 1.

        Examples
        --------
        >>> import stochens_rs as se
        >>> system = se.System([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]])
        >>> plan = se.steer(system, [1.0, 0.0], [0.0, 0.0], 10**6, steps=20, rng=1)
        >>> bound, error = plan.bound(0.01), plan.error(system, [1.0, 0.0], [0.0, 0.0])
        >>> error.state <= bound.state < 0.02
        True
        """
        delta = gate.probability("delta", delta)
        basis = completed(self.basis, system, x0, xf, "bound")
        return plan_bound(basis, self.u, delta, rng, predicted=self.predicted_states)

    def covariance(self) -> Floats:
        """Leading-order covariance of the state after the last step, from the law of the draws.

        Returns
        -------
        ndarray, shape (n, n)
            `theory.moments.final_state_covariance` of the exact entities and the numbers of
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
        known, exact = self._entities(), []
        for one in known:
            if one.kind not in ("iid", "exact") or one.values is None:
                raise InputError(
                    f"`{one.name}` must be exact or the uniform average of independent draws of "
                    f"`sample` for a covariance, got realizations of kind '{one.kind}'"
                )
            exact.append(one.values)
        keys = [one.key for one in known if one.key is not None]
        if len(set(keys)) < len(keys):
            raise InputError(
                "`x0`, `xf` and `A` must be drawn independently for a covariance, but two of them "
                "have the same key: use rng=key.child(name)"
            )
        x0, xf, A = exact
        N0, Nf, NA = (None if one.kind == "exact" else one.size for one in known)
        return final_state_covariance(
            (A, self._B), x0, xf, self.steps, (N0, Nf, NA), axis=known[2].axis
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
        checked, start, goal = self._fitting(system, x0, xf)
        best = best_control(checked.A, checked.B, start, goal, self.steps)
        return best.error(self.u.ravel(), start)

    def _repr_html_(self) -> str:
        warnings = [("warning", text) for text in self.info.get("warnings", ())]
        drawn = html.states(
            np.arange(self.steps + 1), self.predicted_states, "states of the model over the steps"
        )
        return html.card(self, [*made_from(self.u, self.info), *warnings], drawn)

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
        return states(checked.A, checked.B, start, self.u)

    @property
    def _B(self) -> Floats:
        self._entities()
        assert self.basis is not None
        return self.basis.B

    def _entities(self) -> tuple[Known, Known, Known]:
        """What the plan knows of x0, xf and A."""
        if self.basis is None:
            raise InputError("this TrajectoryPlan was not made by `control_steps`: it has no bound")
        return self.basis.entities

    def _fitting(self, system: object, x0: object, xf: object) -> tuple[System, Floats, Floats]:
        checked = System.from_any(system)
        n, m = self.predicted_states.shape[1], self.u.shape[1]
        if (checked.n, checked.m) != (n, m):
            raise ShapeError(
                f"`system` must have n={n} and m={m} as this plan, got n={checked.n} and "
                f"m={checked.m}"
            )
        start = gate.vector("x0", x0, length=n)
        return checked, start, start if xf is None else gate.vector("xf", xf, length=n)

    def __repr__(self) -> str:
        K, m = self.u.shape
        text = expectation(
            self.reachability, self.basis, self.predicted_states[-1], K, self.covariance
        )
        return f"<TrajectoryPlan: {html.counted(K)}, m={m}, {self.status}, {text}>"
