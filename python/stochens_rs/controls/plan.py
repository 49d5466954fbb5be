"""A control for one step as a record."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import gate, html
from .._base.records import by_constructor
from .._base.types import STATUSES, Status
from ..exceptions import ShapeError
from ..system import System
from ..theory.exact import best_control
from ..theory.records import PlanError, Reachability
from .basis import Basis, completed
from .plan_bound import PlanBound, plan_bound, plan_covariance
from .shown import expectation, made_from

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from ..rng import RngLike


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
    basis : Basis or None
        What is known of B, x0, xf and A, for `bound` and `covariance`; None for a plan that was
        made by hand.
    """

    u: NDArray[np.float64]
    predicted_state: NDArray[np.float64]
    reachability: Reachability
    fusion: str
    status: Status
    info: dict[str, Any] = field(default_factory=dict)
    basis: Basis | None = None

    def __post_init__(self) -> None:
        gate.kept("u", self.u, ndim=(1,))
        gate.kept("predicted_state", self.predicted_state, ndim=(1,))
        gate.instance("reachability", self.reachability, Reachability)
        gate.choice("fusion", self.fusion, ("product", "diagonal"))
        gate.choice("status", self.status, STATUSES)
        if self.basis is not None:
            gate.instance("basis", self.basis, Basis)

    def __reduce__(self) -> tuple[Any, ...]:
        return by_constructor(self)

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
        delta = gate.probability("delta", delta)
        basis = completed(self.basis, system, x0, xf, "bound")
        return plan_bound(basis, self.u, delta, rng, fusion=self.fusion)  # type: ignore[arg-type]

    def _repr_html_(self) -> str:
        return html.card(self, [("control u", html.vector(self.u)), *made_from(self.u, self.info)])

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
        basis = completed(self.basis, system, x0, xf, "covariance")
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
        checked = System.from_any(system)
        if checked.m != len(self.u):
            raise ShapeError(
                f"`system` must have m={len(self.u)} inputs as this plan, got m={checked.m}"
            )
        start = gate.vector("x0", x0, length=checked.n)
        goal = gate.vector("xf", xf, length=checked.n)
        return best_control(checked.A, checked.B, start, goal).error(self.u, start)

    def __repr__(self) -> str:
        text = expectation(
            self.reachability, self.basis, self.predicted_state, None, self.covariance
        )
        return f"<Plan {self.fusion}: m={len(self.u)}, {self.status}, {text}>"
