"""A control and what is known about it, as a record."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import gate, html
from .._base.labels import Labels, fitting
from .._base.records import SavedRecord, require_shapes
from .._base.types import DELTA, FUSIONS, STATUSES, Floats, Fusion, Quantity, Status
from ..exceptions import InputError, ShapeError
from ..theory.records import Reachability
from .basis import Basis, ModelBasis, completed
from .certificate import Certificate
from .compared import Compared
from .drawn import Drawn
from .limit_bound import limited_bound
from .limit_certificate import limited_certificate
from .limited import Limited
from .model_bound import certificate, declared
from .plan_arrays import PlanArrays
from .plan_bound import PlanBound, plan_bound
from .plan_covariance import plan_covariance
from .shown import expectation, made_from
from .within import Within, cost_rows, cost_text, worst_state

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..rng import RngLike
    from ..system import System


@dataclass(frozen=True, eq=False, repr=False)
class Plan(SavedRecord, Compared, Within, Drawn, PlanArrays):
    """A control over K steps, its predicted states, and the data for its error bound.

    Attributes
    ----------
    u : ndarray, shape (K, m)
        The control; ``u[k]`` acts in the step from k to k + 1.
    predicted_states : ndarray, shape (K + 1, n)
        Trajectory of the model, ``xh(k+1) = A_hat xh(k) + B u(k) (+ c)`` from ``x0_hat``; for
        fusion="diagonal" the average of ``A^s x0^s`` takes the place of ``A_hat x0_hat``.
    reachability : Reachability
        What K steps cannot reach, according to the estimates: residual and relative residual of
        ``xf_hat - A_hat^K x0_hat``, rank and condition of
        ``C_K = [B, A_hat B, ..., A_hat^{K-1} B]`` (one step: ``C_1 = B``). Also for a plan with
        limits: what no input reaches however large.
    fusion : str
        "product" or "diagonal".
    status : str
        The worst status among the entities' fits and the control within limits: "optimal",
        "optimal_inaccurate" (`gap` is above its tolerance), "user_limit" (of time), "interrupted",
        "infeasible" (hard state limits that cannot be kept); "completed" if nothing was optimised.
    info : dict
        "x0", "xf", "A": method, number of realizations, gap; "singular_values" of ``C_K``;
        "warnings", a tuple of sentences.
    basis : Basis, ModelBasis or None
        What is known about B, x0, xf and A, for `bound` and `covariance`, or the model from data;
        None for a plan that was made by hand.
    limited : Limited, optional
        What is known about a control within limits or with weights: active limits, multipliers,
        gap, objective and what the limits cost, as properties of the plan too.
    labels : Labels, optional
        Names and units of the states and inputs, as those of the system.
    dt : float, optional
        The step length [s], as that of the system or the model.
    """

    u: Floats
    predicted_states: Floats
    reachability: Reachability
    fusion: Fusion
    status: Status
    info: dict[str, Any] = field(default_factory=dict)
    basis: Basis | ModelBasis | None = None
    limited: Limited | None = None
    labels: Labels | None = None
    dt: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        gate.kept("u", self.u, ndim=(2,))
        gate.kept("predicted_states", self.predicted_states, ndim=(2,))
        if len(self.predicted_states) != len(self.u) + 1:
            raise ShapeError(
                f"`predicted_states` must have {len(self.u) + 1} rows, one more than `u`, got "
                f"{len(self.predicted_states)}"
            )
        gate.instance("reachability", self.reachability, Reachability)
        gate.choice("fusion", self.fusion, FUSIONS)
        gate.choice("status", self.status, STATUSES)
        if isinstance(self.basis, ModelBasis):
            require_shapes(self.basis.model, B=self._shape)
        elif self.basis is not None:
            require_shapes(gate.instance("basis", self.basis, Basis), B=self._shape)
        if self.limited is not None:
            gate.instance("limited", self.limited, Limited)
            if not np.array_equal(self.limited.u, self.u):
                raise InputError("`limited` must be of the control `u` of this plan")
        fitting(self.labels, *self._shape)
        if self.dt is not None:
            gate.positive("dt", self.dt)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to be careful about, one sentence each; those of a model from data among them."""
        return tuple(self.info.get("warnings", ()))

    @property
    def _shape(self) -> tuple[int, int]:
        return self.predicted_states.shape[1], self.u.shape[1]

    def bound(
        self,
        delta: float = DELTA,
        *,
        system: System | None = None,
        x0: ArrayLike | None = None,
        xf: ArrayLike | None = None,
        rng: RngLike = 0,
        noise: bool = False,
        open_loop: bool = False,
        x0_fixed: bool = False,
    ) -> PlanBound | Certificate:
        """Bound the error of the control, from what the plan keeps about its arguments.

        Parameters
        ----------
        delta : float, default 0.05
            Probability of failure of each radius, in (0, 1).
        system : System, optional
            Needed only if the law of A is unknown: declares that the realizations of A are
            independent singletons of the A of this system, as `sample` draws them.
        x0, xf : array_like, shape (n,), optional
            The same for x0 and xf.
        rng : None, int, SeedSequence, Generator, BitGenerator or Key, default 0
            Source of randomness of the simulation; with the default the same bound in every call.
        noise : bool, default False
            For a model from data, as all that follows: whether the noise of the run to come is
            included. With several steps, an independent design and noise of unknown covariance
            their number must then have been fixed before the data.
        open_loop : bool, default False
            For several steps, your declaration that the inputs of the measured runs were
            independent of all noise, and the runs of each other, with lengths fixed beforehand.
            Regression over all K steps at once (`Trajectories.k_step`) then competes, each of the
            two with delta / 2. With feedback in the runs the bound is wrong.
        x0_fixed : bool, default False
            Your declaration that x0 was fixed before the data, which makes the bound smaller: for
            one step, or with `open_loop`, and Gaussian noise of independent design.

        Returns
        -------
        PlanBound or Certificate
            Radii for the last state and for the control, with the names of the bounds; for a model
            from data a `Certificate`.

        Raises
        ------
        InputError, InputTypeError
            If `delta` does not lie in (0, 1); the law of an entity is unknown (realizations
            brought by the user, a part of a systematic sample) and not declared, or a declared
            one contradicts the plan; two entities were drawn with the same key; systematic
            realizations of rows are paired; the bound overflows; or an argument does not go with
            the model from data, or no bound is known for what was assumed of them.

        Notes
        -----
        The bound is an order statistic of the errors of thousands of simulated draws
        (`theory.bounds.Simulated`). It holds over the draws of the realizations, and is within a
        few percent of the error that is exceeded with probability `delta`. Fits ("alse", "slse")
        are not drawn again: their distance from their targets is known. With fits and exact values
        only, nothing is random and the bound is the error itself, relative to the targets. If the
        ``4 / delta`` draws that are needed would take one thread more than 10 s (`delta` below 2e-6
        for a few states, 3e-5 for n = 20 over four steps, 7e-4 for n = 100), the formulas of
        `theory.bounds` are used, which are often 4 to 40 times larger; over several steps the
        triangle inequality along the predicted states ``xh``, ``||x(K) - xf|| <= ef + ||A^K|| e0
        + eA sum_k ||A^{K-1-k}|| ||xh(k)|| + ||xh(K) - xf_hat||``. `state_bound`, `control_bound`
        and `reason` of the result say so.

        For realizations of an unknown law there is no bound. If the distance of any two
        realizations is bounded, use `DataStream.confidence`. To compare with a nominal system, use
        `Plan.error`.

        For a model from data the bound follows from its region, for any control, also one chosen
        after the data; nothing is random. One step: ``||x(1) - xf|| <= ||H z - xf|| + radius
        ||z||``. Several: ``e(k+1) = A_hat e(k) + D z(k) + D_x e(k)``, ``D = Theta - H``, in first
        order exact over the Frobenius ball or by nuclear norms over the spectral one, and the rest
        by induction. Gaussian noise of known covariance to come by its exact quantile, with .4 of
        `delta`; .1 is for what the error of the model makes of it, the rest for the region.

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
        asked = declared(noise, open_loop, x0_fixed)
        if isinstance(self.basis, ModelBasis):
            exact = {"system": system, "x0": x0, "xf": xf}
            at, how = self.predicted_states, (delta, asked, exact)
            if self.limited is not None:
                return limited_certificate(self.basis, self.limited, at, *how)
            return certificate(self.basis, self.u, at, *how)
        if any(asked):
            raise InputError("`noise`, `open_loop` and `x0_fixed` are for models from data")
        basis = completed(self.basis, system, x0, xf, "bound", self.labels)
        if self.limited is not None:
            at = self.predicted_states
            return limited_bound(basis, self.limited, at, delta, rng, self.fusion)
        return plan_bound(basis, self.u, self.predicted_states, self.fusion, delta, rng)

    def covariance(
        self,
        quantity: Quantity = "state",
        *,
        system: System | None = None,
        x0: ArrayLike | None = None,
        xf: ArrayLike | None = None,
    ) -> Floats:
        """Compute the covariance of the state reached or of the control, over the draws.

        Parameters
        ----------
        quantity : {"state", "control"}, default "state"
            The true system's state after the last step, or the control (one step only).
        system, x0, xf
            As in `bound`: needed only for entities whose law is unknown.

        Returns
        -------
        ndarray, shape (n, n) for the state, (m, m) for the control
            One step: exact, `theory.moments.state_covariance` or `control_covariance` for the
            sizes, the fusion, the scheme and the axis of this plan. Several steps: the leading
            order for many realizations, `theory.moments.final_state_covariance`.

        Raises
        ------
        InputError, InputTypeError
            As `bound`; and where no formula is known: an entity was fitted with other than uniform
            weights, iid and systematic samples are mixed, systematic ones are paired; over several
            steps the control, systematic samples, and ``C_K`` with a rank below n.

        Notes
        -----
        For realizations of another law, brought by the user and independent of each other,
        ``np.cov(se.realization_controls((A, B), x0, xf), rowvar=False) / N`` estimates the
        covariance of the control for fusion="diagonal"; a plan does not keep the realizations.

        Examples
        --------
        >>> import stochens_rs as se
        >>> system = [[1.0, 0.0], [2.0, 5.0]], [[1.0], [0.0]]
        >>> plan = se.control(system, [1.0, 1.0], se.sample([2.0, 2.0], 10, rng=1))
        >>> plan.covariance("control"), plan.covariance()
        (array([[0.4]]), array([[0.4, 0. ],
               [0. , 0. ]]))
        """
        if self.limited is not None:
            raise InputError("no covariance is known within limits or with weights: use error()")
        basis = completed(self.basis, system, x0, xf, "covariance", self.labels)
        return plan_covariance(basis, self.steps, self.fusion, quantity)

    def _repr_html_(self) -> str:
        first = ("control u(0)", html.vector(self.u[0]))
        drawn = html.states(
            np.arange(self.steps + 1), self.predicted_states, "states of the model over the steps"
        )
        cost = () if self.limited is None else cost_rows(self.limited)
        named = () if self.labels is None else self.labels.rows()
        rows = [first, html.largest(self.u), *cost, *made_from(self.info), *named]
        return html.card(self, rows, drawn)

    def __repr__(self) -> str:
        K, m = self.u.shape
        text = expectation(
            self.reachability, self.basis, self.predicted_states[-1], K, self.covariance
        )
        if self.limited is not None:
            worst = worst_state(self.limited, self.predicted_states, self.labels)
            text = f"without limits {text}; {cost_text(self.limited, worst)}"
        text += html.warned(self.warnings)
        return f"<Plan {self.fusion}: {html.counted(K)}, m={m}, {self.status}, {text}>"
