"""A control and what is known about it, as a record."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import field, replace
from typing import Annotated, Any, Literal

import numpy as np

from .. import _core
from .._base import show, validation
from .._base.names import Labels, default_labels, two_states
from .._base.records import Positive, SavedRecord, require_shapes, trusted
from .._base.running import get_num_threads
from .._base.tables import Timed
from .._base.types import (
    DELTA,
    QUANTITIES,
    ArrayLike,
    Axes,
    Figure,
    Floats,
    Fusion,
    Places,
    Quantity,
    Scheme,
    Status,
    SubFigure,
    norm,
)
from ..certificates.certificate import Certificate
from ..certificates.of_model import ModelBasis, Question
from ..exceptions import InputError, ShapeError
from ..feedback import Loop, LoopCertificate
from ..fusion.provenance import Basis, completed
from ..identification.model import Model, estimate_law
from ..limits.problem import Horizon, Limited
from ..plots.lines import draw_phase
from ..plots.panels import Inputs, draw_tube
from ..rng import RngLike, as_key
from ..system.system import System, in_order
from ..theory import moments
from ..theory.exact import (
    EPS,
    PlanError,
    Reachability,
    best_control,
    checked_ends,
    relative,
    states,
)
from ..validation.held_out import Asked, Predicted, Runs, Validation, validated
from .bounds import Typical, limited_bound, model_bound, plan_bound, ranked

_NOT_FOR = {
    True: "for a model from data, whose region needs no exact values: use Plan.error to compare",
    False: "for a plan of estimates: it says something of measured runs, for models from data",
}
_DRAWN = 1e300  # the largest measured value that an axis, with its margins, can show
_ROUNDED = 1e-9  # distances up to here beside the states are said to be rounding


class Plan(SavedRecord, Timed):
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
        "optimal_inaccurate" (`limited.gap` is above its tolerance), "user_limit" (of time),
        "interrupted",
        "undecided" (a hard state limit is broken, and it is not known whether all can be kept),
        "infeasible" (they cannot); "completed" if nothing was optimised.
    info : dict
        "x0", "xf", "A": method, number of realizations, gap; "singular_values" of ``C_K``;
        "warnings", a tuple of sentences.
    basis : Basis, ModelBasis or None
        What is known about B, x0, xf and A, for `bound` and `covariance`, or the model from data;
        None for a plan that was made by hand.
    limited : Limited, optional
        What is known about a control within limits or with weights: `active` limits, `multipliers`,
        `gap`, `objective`, what the limits cost (`missed`), and the `feedback` with which to follow
        a plan whose inputs alone do not lead to its states. None without limits and weights.
    labels : Labels, optional
        Names and units of the states and inputs, as those of the system.
    dt : float, optional
        The step length [s], as that of the system or the model.
    """

    u: Annotated[Floats, "step input"]
    predicted_states: Annotated[Floats, "step+1 state"]
    reachability: Reachability
    fusion: Fusion
    status: Status
    info: dict[str, Any] = field(default_factory=dict)
    basis: Basis | ModelBasis | None = None
    limited: Limited | None = None
    labels: Labels | None = None
    dt: Positive | None = None

    def _check(self) -> None:
        if self.basis is not None:
            known = self.basis.model if isinstance(self.basis, ModelBasis) else self.basis
            require_shapes(known, B=self._shape)
        if self.limited is not None and not np.array_equal(self.limited.u, self.u):
            raise InputError("`limited` must be of the control `u` of this plan")

    @property
    def steps(self) -> int:
        """Number of steps K."""
        return len(self.u)

    @property
    def predicted_outputs(self) -> Floats | None:
        """For a model of outputs, the last reading and where it leads, (K + 1, n_outputs)."""
        if not isinstance(self.basis, ModelBasis):
            return None
        return self.basis.outputs(self.predicted_states, self.u)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to be careful about, one sentence each; those of a model from data among them."""
        found = self.info.get("warnings", ())  # of a file it may be anything
        return tuple(map(str, found)) if isinstance(found, (tuple, list)) else ()

    @property
    def _shape(self) -> tuple[int, int]:
        return self.predicted_states.shape[1], self.u.shape[1]

    @property
    def _labels(self) -> Labels:
        return self.labels or default_labels(*self._shape)

    @property
    def _drawn(self) -> tuple[Floats, Labels]:
        """What is drawn over time, and its names: the states, or of a model of outputs these."""
        outputs = self.predicted_outputs
        if outputs is None or not isinstance(self.basis, ModelBasis):
            return self.predicted_states, self._labels
        return outputs, Labels(self.basis.names, self._labels.inputs)

    def bound(
        self,
        delta: float = DELTA,
        *,
        system: System | None = None,
        x0: ArrayLike | None = None,
        xf: ArrayLike | None = None,
        noise: bool | None = None,
        bands: bool | None = None,
        gain: Loop | LoopCertificate | None = None,
    ) -> Certificate:
        """Bound how wrong the control is, from what the plan keeps about its arguments.

        Parameters
        ----------
        delta : float, default 0.05
            Probability of failure of each radius, in (0, 1).
        system : System, optional
            For realizations brought by you, as `x0` and `xf`: declares that those of A are
            independent singletons of the A of this system, as `sample` draws them: one nonzero
            entry in every column. For others there is `validate`, with fresh ones.
        x0, xf : array_like, shape (n,), optional
            The same for x0 and xf.
        noise : bool, optional
            For a model from data, as all that follows: whether the noise of the run to come is
            included; by default for a model of outputs only, whose bound is then of the readings,
            else of their mean. With several steps, an independent design and noise of unknown
            covariance their number must then have been fixed before the data.
        bands : bool, optional
            Whether to bound each state at each step too, as `plot` draws them: ``|x(k) - xh(k)|_i``
            is at most ``certificate["bands"].radius[k, i]``. The default is yes, but for outputs,
            with `gain` and near a reference; False saves about a quarter of the time.
        gain : Loop or LoopCertificate, optional
            The plan is followed with this feedback of the model, ``u(k) + K (x(k) - xh(k))``: the
            tube is that of `LoopCertificate.tube`, and "inputs" bounds how far those that are
            applied are from the plan. With `noise` one half of `delta` is for the region.

        Returns
        -------
        Certificate
            Radii of "target", the distance ``||x(K) - xf||``; of "state", that of x(K) from where
            the exact best control v leads, ``||C_K (u - v)||``, or for a model from the state that
            it predicts; and of "control", ``||u - v||``. For a model also of "components", ``|x(K)
            - xf|_i``, the "tube" around the predicted states, all together (for one step, and with
            noise, components and bands are a statement of their own: see `Certificate.covers`); for
            one of outputs see `Certificate.outputs`; else "control" and "state" each for itself,
            and "target" with "state". Within limits v is the best control within them, and "excess"
            bounds ``J(u) - J(v)``; with a weight Q that is no multiple of the identity, or of
            several steps, "state" and "target" are ``(sum_k ||x(k) - y(k)||_{Q_k}^2)^(1/2)``, as
            their `distance_from` says, and so is "states" of a model.

        Raises
        ------
        InputError, InputTypeError
            If `delta` does not lie in (0, 1); an argument is for plans of the other kind; the law
            of an entity is unknown (realizations brought by the user, a part of a systematic
            sample) and not declared, or a declared one contradicts the plan; two entities were
            drawn with the same key; systematic realizations of rows are paired; the bound
            overflows; or no bound is known for what was assumed of the data.

        Notes
        -----
        *Estimates.* An order statistic of the errors of thousands of simulated draws
        (`theory.drawn_bound`), the same in every call. It holds over the draws of the
        realizations, and is within a few percent of the error that is exceeded with probability
        `delta`. Fits ("alse", "slse") are not drawn again: their distance from their targets is
        known. With fits and exact values only, nothing is random and the bound is the error itself,
        relative to the targets. If the ``4 / delta`` draws that are needed would take one thread
        more than 10 s (`delta` below 2e-6 for a few states, 3e-5 for n = 20 over four steps, 7e-4
        for n = 100), the formulas of `theory.drawn_bound` are used, which are often 4 to 40 times
        larger; over several steps the triangle inequality along the predicted states ``xh``,
        ``||x(K) - xf|| <= ef + ||A^K|| e0 + eA sum_k ||A^{K-1-k}|| ||xh(k)|| + ||xh(K) -
        xf_hat||``. `method` and `reason` of each radius say so.

        For realizations of an unknown law there is no bound. If the distance of any two
        realizations is bounded, use `DataStream.confidence`. To compare with a nominal system, use
        `Plan.error`.

        *Models from data.* The bound follows from the region of the model, for any control, also
        one chosen after the data. One step: ``||x(1) - xf|| <= ||H z - xf|| + radius ||z||``.
        Several: ``e(k+1) = A_hat e(k) + D z(k) + D_x e(k)``, ``D = Theta - H``, in first order
        exact over the Frobenius ball or by nuclear norms over the spectral one, and the rest by
        induction. Gaussian noise of known covariance to come, with what the error of the model
        makes of it, by its quantile: .4 of `delta` for the last state, .1 for those before.

        *With a pilot and a reference* (`identify`) of as many steps, and an exact x0: the first
        order of the error along the reference, ``F = sum_j A0^(K-1-j) Sigma^(1/2) Gamma g_j``, is
        Gaussian of known covariance, and ``||x(K) - xf|| <= ||xh(K) - xf|| + |s| q + mismatch(s) +
        rest`` with its quantile q: `parts` of the certificate. Target, components and tube are then
        statements of their own. With `gain`, for outputs, and with noise after any feedback each
        row is bounded so, with noise apart.

        Examples
        --------
        >>> import stochens_rs as se
        >>> system = se.System([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]])
        >>> plan = se.steer(system, [1.0, 0.0], [0.0, 0.0], 10**6, steps=20, rng=1)
        >>> bound, error = plan.bound(0.01), plan.error(system, [1.0, 0.0], [0.0, 0.0])
        >>> error.state <= bound.state < 0.02
        True
        """
        delta = validation.probability("delta", delta)
        basis, predicted, limited = self.basis, self.predicted_states, self.limited
        asked = {"noise": noise, "bands": bands, "gain": gain}
        model = isinstance(basis, ModelBasis)
        for name, value in ({"system": system, "x0": x0, "xf": xf} if model else asked).items():
            if value is not None and value is not False:
                raise InputError(f"`{name}` must be left out {_NOT_FOR[model]}")
        if isinstance(basis, ModelBasis):
            question = Question(basis, self.u, predicted, delta)
            found = model_bound(question, limited, noise, bands, gain)
        else:
            known = completed(basis, (system, x0, xf), "bound", self.labels)
            if limited is None:
                found = plan_bound(known, self.u, predicted, self.fusion, delta)
            else:
                found = limited_bound(known, limited, predicted, delta, self.fusion)
        return trusted(Certificate, **{**vars(found), "warnings": self.warnings})

    def typical(
        self,
        delta: float = DELTA,
        *,
        draws: int = 1000,
        rng: RngLike = 0,
        noise: bool | None = None,
        gain: Loop | LoopCertificate | None = None,
    ) -> Typical:
        """Estimate how far models that may be the true one miss the target: approximate, no bound.

        Parameters
        ----------
        delta : float, default 0.05
            The share of the drawn models that miss by more, in (0, 1).
        draws : int, default 1000
            The number of models, at least ``1 / delta - 1``.
        rng : None, int, SeedSequence, Generator, BitGenerator or Key, default 0
            Source of randomness; with the default the same number in every call.
        noise : bool, optional
            Whether the noise of the run to come is included, in the certificate too; default: for
            models of outputs, as in `bound`.
        gain : Loop or LoopCertificate, optional
            A feedback with which the plan is followed, as in `bound`.

        Returns
        -------
        Typical
            The number, ``miss``, beside what ``bound(delta)`` certifies.

        Raises
        ------
        InputError, InputTypeError
            If the plan is not for a `Model` of Gaussian noise that the data determine, without
            single known entries, or its x0 is uncertain; if the model has a warning; if the
            covariance is unknown and fewer than 2 n pairs more than unknowns of a row are there; or
            if an argument cannot be used.

        Notes
        -----
        The models are those of `Model.draw`: ``H + Sigma^1/2 G V^-1/2``, or with an unknown
        covariance ``H + S^1/2 E^-1/2 G V^-1/2``. This control is applied to each, and of the
        ``||x(K) - xf||``, of models of outputs those of the last readings together, the order
        statistic of rank ``ceil((1 - delta) (draws + 1))`` is taken. In 84 cells of 14 systems with
        3 to 40 runs of 10 steps in open loop it was exceeded in 0.2 to 7.6 % of 1000 data sets for
        5 %. No inequality is known: runs whose number was chosen by what they showed make it wrong.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> z = np.random.default_rng(1).standard_normal((40, 3))
        >>> x_next = 0.5 * z[:, :1] + z[:, 1:2] + 0.01 * z[:, 2:]
        >>> data = se.Trajectories.from_pairs(z[:, :1], z[:, 1:2], x_next)
        >>> model = se.identify(data, noise=0.01)
        >>> se.control(model, [1.0], [0.0], steps=2).typical()
        <Typical: certified 0.00677, typical 0.00335, 95 %, without noise>
        """
        share, basis = validation.probability("delta", delta), self.basis
        model = basis.model if isinstance(basis, ModelBasis) else None
        if not isinstance(basis, ModelBasis) or not isinstance(model, Model):
            raise InputError(
                "`typical` needs a plan for a model by `identify`, of which the law is known"
            )
        if model.warnings:
            raise InputError(f"`typical` must not be trusted beside a warning: {model.warnings[0]}")
        window, assumed, rows = model.window, model.assumptions, model.n_outputs
        noisy = window is not None if noise is None else validation.flag("noise", noise)
        certified = self.bound(share, noise=noisy, gain=gain).target
        K = None if gain is None else np.ascontiguousarray(gain.K)
        if basis.x0_error:
            raise InputError("`typical` needs an exact x0, not an Uncertain one")
        if assumed.tail:
            raise InputError("`typical` is not for models with a tail: its law is not known")
        law = estimate_law(model, windows=True)
        if assumed.known is None and law[-1] < 2 * rows:
            raise InputError(
                f"`typical` needs {2 * rows} more pairs than unknowns of a row where the "
                f"covariance is unknown, this model has {law[-1]}"
            )
        key, threads, goal = bytes(as_key(rng).child("typical")), get_num_threads(), basis.target
        if goal is None:
            goal = self._drawn[0][1:][-(1 if window is None else window.count) :].ravel()
        exact = "states without error" if window is None else f"the window of {window.text} exact"
        text = (
            f"{assumed.text}; {exact}; number and lengths of the runs fixed beforehand; "
            f"residuals {'not tested' if model.checks is None else 'without a warning'}"
        )
        of = None if window is None else window.core

        def misses(size: int) -> Floats:
            return _core.drawn_misses(law, basis.x0, self.u, goal, noisy, size, key, threads, of, K)

        return ranked(misses, certified, share, draws, noisy, text)

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
        basis = completed(self.basis, (system, x0, xf), "covariance", self.labels)
        of_control = validation.choice("quantity", quantity, QUANTITIES) == "control"
        fitted = [entity.name for entity in basis.entities if entity.kind == "fitted"]
        schemes = {entity.kind for entity in basis.entities} - {"exact"}
        K, unknown = self.steps, None
        if K > 1 and of_control:
            unknown = f" of a control over {K} steps, which is not linear in A"
        elif fitted:
            unknown = f": the weights of `{fitted[0]}` depend on the realizations"
        elif len(schemes) > 1:
            unknown = " of iid and systematic samples together"
        elif K > 1 and schemes == {"systematic"}:
            unknown = f" over {K} steps of systematic samples"
        if unknown:
            raise InputError(f"no formula is known for the covariance{unknown}")
        (start, goal, A), sizes = basis.values, basis.sizes
        pair, how = (A, basis.B), {"axis": basis.A.axis}
        if K > 1:
            return moments.final_state_covariance(pair, start, goal, K, sizes, **how)
        scheme: Scheme = "systematic" if schemes == {"systematic"} else "iid"
        of = moments.control_covariance if of_control else moments.state_covariance
        return of(pair, start, goal, sizes, fusion=self.fusion, scheme=scheme, **how)

    def error(self, system: System, x0: ArrayLike, xf: ArrayLike | None = None) -> PlanError:
        """Compare the control with the best one for an exactly known system.

        Parameters
        ----------
        system : System
            The true system. The names of the plan in another order are brought into its order.
        x0, xf : array_like, shape (n,)
            The true initial state and the target, in the order of the plan; xf is left out for a
            plan with a reference.

        Returns
        -------
        PlanError
            With ``v = C_K^+ (xf - A^K x0)``, the smallest control that comes nearest to the
            target: the error of the control, the distance between the two last states, and the
            residual that no control reaches. ``||x(K) - xf||`` is ``sqrt(state^2 + residual^2)``.
            For a plan with limits or weights v is the best control of the exact system with the
            same ones (R="auto" with the value used): ``||x(K) - xf|| <= state + residual``.

        Raises
        ------
        InputError, InputTypeError
            If the arguments do not fit this plan, or something overflows.

        Examples
        --------
        >>> import stochens_rs as se
        >>> system = se.System([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]])
        >>> plan = se.control(system, [1.0, 1.0], [0.0, 0.0], steps=5)
        >>> plan.error(system, [1.0, 1.0], [0.0, 0.0]).control
        0.0
        """
        other = self._in_order(system)
        if self.limited is not None:
            how: Any = {"length": other.n, "labels": other.state_names}
            start = validation.vector("x0", x0, **how)
            goal = None if xf is None else validation.vector("xf", xf, **how)
            return _limited_error(self.limited, other, start, goal, self.u)
        checked, start, goal = checked_ends(other, x0, xf)
        best = best_control(checked.A, checked.B, start, goal, self.steps)
        return best.error(self.u.ravel(), start)

    def states(self, system: System, x0: ArrayLike) -> Floats:
        """Compute the trajectory of an exactly known system under this control.

        Parameters
        ----------
        system : System
            The true system, as in `error`.
        x0 : array_like, shape (n,)
            Its initial state, in the order of the plan.

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
        >>> plan = se.control(system, [1.0, 0.0], [0.0, 0.0], steps=5)
        >>> bool(abs(plan.states(system, [1.0, 0.0])[-1]).max() < 1e-12)
        True
        """
        checked = self._in_order(system)
        start = validation.vector("x0", x0, length=checked.n, labels=checked.state_names)
        return states(checked.A, checked.B, start, self.u)

    def validate(
        self,
        runs: Runs,
        delta: float = DELTA,
        *,
        beta: float | None = None,
        x0: ArrayLike | None = None,
        scale: ArrayLike | None = None,
        weights: ArrayLike | None = None,
    ) -> Validation:
        """Bound where the next run ends, from runs of this plan or fresh systems of any law.

        Parameters
        ----------
        runs : Trajectories, array_like of shape (M, K + 1, n), SystemEnsemble or list of System
            Runs of this plan that had no part in it, all of them: a run that diverged or was
            aborted has fewer rows, or nan. For a model of outputs these are readings, the first row
            the last one of the record, each run behind a record like that of the plan. Or systems
            that had no part in it, which are run here, without noise. Trajectories must have the
            inputs of this plan in their first K steps.
        delta : float, default 0.05
            Probability that the next run leaves the tube, and that it ends further from the
            target: each for itself. 0.05 takes 19 runs.
        beta : float, optional
            Probability that the runs mislead; then at most a share `delta` of all further runs
            leaves the tube, with confidence ``1 - beta``. 0.05 takes 59 runs. The runs must then be
            independent of each other.
        x0 : array_like, shape (n,) or (M, n), optional
            Where fresh systems begin; the default is the start of this plan, if it is exact.
        scale : array_like, shape (n,) or (K + 1, n), optional
            Units of the deviations, > 0, fixed before these runs; the row of the start is not used.
            The best are the spreads of other runs. The default is the size of each predicted state,
            and for a `Model` the deviation that its noise gives after k steps.
        weights : array_like, shape (M + 1,), optional
            Where the starts of the runs were drawn from another density f than that of the next
            run, f_new: ``f_new(x0) / f(x0)`` of each run, and last of the next one. Both must be
            declared; ratios that were estimated from the runs guarantee nothing.

        Returns
        -------
        Validation
            ``tube`` and ``target``, infinite where the runs are too few. ``covers`` says what must
            be the same in the next run.

        Raises
        ------
        InputError, InputTypeError
            If the runs do not fit this plan; had other inputs; are models from data, or scatter
            about an estimate; or if `beta` goes with `weights`.

        Notes
        -----
        Of M + 1 exchangeable scores the last is at most the one of rank ``ceil((1 - delta) (M +
        1))`` of the others with probability ``1 - delta`` at least; ties only help. With weights:
        Tibshirani, Barber, Candes and Ramdas 2019. Runs that were left out, or chosen after a look,
        make it void, and so does a plan or a `scale` that was changed after it: validate again,
        with fresh runs. A state is what was recorded or, of fresh systems, computed in doubles.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> A = 0.5 + 0.01 * np.random.default_rng(1).standard_normal((60, 1, 1))
        >>> plan = se.control(([[0.5]], [[1.0]]), [1.0], [0.0], steps=3)
        >>> plan.validate(se.SystemEnsemble(A, np.ones((60, 1, 1))))
        <Validation: 60 fresh systems, x(K) within 0.0145 of xf, tube 0.0204 scales, 95 % each>
        """
        states, labels = self._drawn
        mine = Predicted(self.u, states, self.basis, self.limited, labels, self.dt)
        return validated(mine, runs, x0, Asked.checked(delta, beta, scale, weights))

    def plot(
        self,
        certificate: Certificate | Literal[False] | None = None,
        *,
        states: Places = None,
        inputs: Places = None,
        measured: ArrayLike | None = None,
        figure: Figure | SubFigure | None = None,
    ) -> Figure:
        """Draw the predicted states or outputs, their target and the inputs, each in its panel.

        An input is drawn as steps, its limits as a grey band, thick where it is at one of them,
        and in another colour where it changes by its rate.

        Parameters
        ----------
        certificate : Certificate or False, optional
            From `bound`, of this plan: draws the tube that contains the true states. The default is
            that of ``bound()`` for a model from data, where one is known; False draws none.
        states, inputs : str, int or list of them, optional
            Which ones, by name or number; the default is all, of more than 12 those that change
            most; ``inputs=[]`` draws no input.
        measured : array_like, shape (K + 1, n) or (R, K + 1, n), optional
            The states of one run under this control, or of R runs, of a model of outputs these; of
            more than 20 runs a band from the 5 % to the 95 % quantile and the median.
        figure : matplotlib Figure or SubFigure, optional
            Where to draw; the default is a new figure.

        Returns
        -------
        matplotlib Figure
            With a panel for each state and input.

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        InputError, InputTypeError
            If the arguments do not fit this plan.

        Examples
        --------
        >>> import stochens_rs as se
        >>> len(se.control(([[0.5]], [[1.0]]), [1.0], [0.0], steps=3).plot().axes)
        2
        """
        predicted, labels = self._drawn
        tube, says, runs = self._certified(certificate, measured, each=True)
        at, some = labels.places("states", states), labels.places("inputs", inputs, inputs=True)
        low, high = np.full((2, *self.u.shape), np.inf) * [[[-1.0]], [[1.0]]]
        at_rate = None
        more: dict[str, Any] = {"measured": runs, "target": self._target}
        if self.limited is not None:
            task = self.limited.task
            low, high, at_rate = task.low, task.high, (self.limited.rate_active != 0)[:, some]
            if task.follows:
                more["reference"] = task.reference
            if task.state_low is not None and task.state_high is not None:
                ends = np.stack([task.state_low, task.state_high])
                more["limits"] = ends[..., -predicted.shape[1] :]  # of readings: behind the window
        more = {name: None if one is None else one[..., at] for name, one in more.items()}
        if some:
            names = [labels.input_axes[i] for i in some]
            given = self.u[:, some], names, low[:, some], high[:, some]
            more["inputs"] = Inputs(*given, at_rate=at_rate)
        around = None if tube is None else (tube if tube.ndim == 1 else tube[:, at], says)
        names = [labels.state_axes[i] for i in at]
        return draw_tube(predicted[:, at], around, names, dt=self.dt, figure=figure, **more)

    def plot_phase(
        self,
        across: str | int,
        up: str | int,
        certificate: Certificate | Literal[False] | None = None,
        *,
        measured: ArrayLike | None = None,
        ax: Axes | None = None,
    ) -> Axes:
        """Draw two states against each other: a ring at the start, a dot at the end.

        Parameters
        ----------
        across, up : str or int
            The two states, by name or number.
        certificate : Certificate or False, optional
            As in `plot`: draws discs that contain the true states.
        measured : array_like, shape (K + 1, n) or (R, K + 1, n), optional
            The states of one run under this control, or of R runs.
        ax : matplotlib Axes, optional
            Where to draw, as for `Trajectory.plot`.

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        InputError, InputTypeError
            If there is no such state, or the arguments do not fit this plan.

        Examples
        --------
        >>> import stochens_rs as se
        >>> cart = se.System([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]], states=["p", "v"])
        >>> plan = se.control(cart, [1.0, 0.0], [0.0, 0.0], steps=20)
        >>> plan.plot_phase("p", "v").get_ylabel()
        'v'
        """
        if self.predicted_outputs is not None:
            raise InputError("`plot_phase` draws states: see plot() for a model of outputs")
        at = two_states(self._labels, across, up)
        names = self._labels.state_axes
        tube, says, runs = self._certified(certificate, measured)
        target = self._target
        return draw_phase(
            [(self.predicted_states[:, at], "predicted")],
            (names[at[0]], names[at[1]]),
            radii=tube,
            says=says,
            runs=None if runs is None else runs.reshape(-1, *runs.shape[-2:])[:, :, at],
            target=None if target is None else target[at],
            ax=ax,
        )

    @property
    def _target(self) -> Floats | None:
        """Where the states should end; None where that is what was predicted for given inputs."""
        basis, limited, end = self.basis, self.limited, self.predicted_states[-1]
        if limited is not None and limited.task.follows:
            return None
        if isinstance(basis, ModelBasis):
            return basis.target
        if limited is None:
            return None if basis is None else basis.xf.estimate
        goal: Floats = limited.task.reference[-1]
        away = np.abs(goal - end).max() > 1e-6 * np.abs(self.predicted_states).max()
        return goal if away else None

    def _certified(
        self,
        certificate: Certificate | Literal[False] | None,
        measured: ArrayLike | None,
        each: bool = False,
    ) -> tuple[Floats | None, str, Floats | None]:
        """The tube, of `each` state where there is one, what it says, and the checked runs."""
        (predicted, _), given = self._drawn, certificate
        if certificate is None and isinstance(self.basis, ModelBasis):
            with suppress(InputError):  # no region is known for what was assumed of the data
                certificate = self.bound()
        tube, says, runs = None, "", None
        if certificate is not None and certificate is not False:
            tube = validation.instance("certificate", certificate, Certificate).tube
            if len(tube) != len(predicted):
                raise ShapeError(
                    f"`certificate` must be over {show.number_of(self.steps)}, got one over "
                    f"{show.number_of(len(tube) - 1)}"
                )
            says, known = certificate.share, certificate.quantities
            if "readings" in known:
                tube = np.asarray(known["readings"].radius)
                # in open loop that of an unstable plant soon leaves every panel
                wide = tube > 10.0 * np.maximum(np.ptp(predicted, axis=0), tube[1])
                if given is None and wide.any():
                    tube = np.where(wide, np.nan, tube)
                    says += ", left out where wider than 10 times the range"
            elif each and "bands" in known and known["bands"].method == known["tube"].method:
                tube = np.asarray(known["bands"].radius)
        if measured is not None:
            runs = validation.array("measured", measured, ndim=(2, 3))
            if np.abs(runs).max() > _DRAWN:
                raise InputError(f"`measured` must be at most {_DRAWN:.0e} to be drawn")
            if runs.shape[-2:] != predicted.shape:
                raise ShapeError(
                    f"`measured` must have shape {predicted.shape} each, got {runs.shape}"
                )
        return tube, says, runs

    def _in_order(self, system: object) -> System:
        """The system, its names in the order of this plan."""
        checked = System.from_any(system)
        n, m = self._shape
        if (checked.n, checked.m) != (n, m):
            raise ShapeError(
                f"`system` must have n={n} and m={m}, got n={checked.n} and m={checked.m}"
            )
        validation.same_dt("system", checked.dt, self.dt, "this plan")
        return in_order("system", checked, self.labels)

    def _parts(self) -> tuple[Any, ...]:
        limited = () if self.limited is None else (self.limited.task, self.limited)
        return (self, self.reachability, *limited)

    def _facts(self) -> dict[str, Any]:
        facts = {"key": self.info.get("key")}
        for one in self.basis.entities if isinstance(self.basis, Basis) else ():
            facts |= {f"size_{one.name}": one.size, f"key_{one.name}": one.key}
        return facts

    def _repr_html_(self) -> str:
        rows: list[tuple[str, object]] = [("control u(0)", show.vector(self.u[0]))]
        rows.append(show.largest(self.u))
        for name in ("x0", "xf", "A"):
            one = self.info.get(name)
            if isinstance(one, dict) and "method" in one:
                size = one.get("size")
                drawn = f", {show.grouped(size)} realizations" if isinstance(size, int) else ""
                rows.append((name, f"{one['method']}{drawn}"))
        times = np.arange(self.steps + 1)
        curves = show.states(times, self.predicted_states, "states of the model over the steps")
        return show.card(self, rows, curves)

    def __repr__(self) -> str:
        text = self._expectation()
        if self.limited is not None:
            text = f"without limits {text}; {self._within(self.limited)}"
        text += show.careful(self.warnings)
        fusion = "" if self.fusion == "product" else f" {self.fusion}"
        steps = show.number_of(self.steps)
        return f"<Plan{fusion}: {steps}, m={self.u.shape[1]}, {self.status}, {text}>"

    def _expectation(self) -> str:
        """How far the model ends from its target, and the true system from xf."""
        basis, end, text = self.basis, self.predicted_states[-1], self.reachability.text
        if isinstance(basis, ModelBasis) and basis.given:
            return "inputs given; true system: see bound()"
        if isinstance(basis, ModelBasis):
            there = _place(basis.xf - end, "xf", basis.x0, basis.xf)
            return f"{text}; the model ends {there}; true system: see bound()"
        if basis is None or basis.xf.estimate is None:
            return text
        known = [one.estimate for one in (basis.x0, basis.xf) if one.estimate is not None]
        goal = "xf" if basis.xf.kind == "exact" else "the estimated xf"
        there = _place(basis.xf.estimate - end, goal, *known)
        if all(entity.kind == "exact" for entity in basis.entities):
            return f"{text}; ends {there}"
        return f"{text}; with the estimates: ends {there}; true system: see bound()"

    def _within(self, limited: Limited) -> str:
        """What the limits cost and how many are active, in a few words."""
        text, task = f"J={limited.objective:.3g}", limited.task
        if limited.missed is not None and limited.missed > 0.0:
            text += f", {limited.missed:.2g} of it for the limits"
        text += f"; {_active(limited.active, 'inputs at a limit')}"
        if task.rate is not None:
            text += f", {np.count_nonzero(limited.rate_active) or 'none'} at their rate"
        if limited.state_active is not None:
            own = limited.state_active[:, -self._drawn[0].shape[1] :]
            what = "states" if self.predicted_outputs is None else "readings"
            text += f", {_active(own, f'{what} at a limit')}"
        if limited.missing > 0.0 and task.state_low is not None and task.state_high is not None:
            at = self.predicted_states[1:]
            over = np.maximum(at - task.state_high, task.state_low - at).max(axis=0)
            most = f" ({self._labels.entry(int(np.argmax(over)))} most)" if over.max() > 0.0 else ""
            text += f"; state limits missed by {limited.missing:.3g}{most}"
        if limited.open_until is not None:
            text += (
                f"; follow with `limited.feedback` from step {limited.open_until} on, inputs alone "
                f"J={limited.open_objective:.3g}"
            )
        return text


def _active(sides: Any, what: str) -> str:
    return f"{np.count_nonzero(sides) or 'none'} of {sides.size} {what}"


def _place(off: Floats, goal: str, *states: Floats) -> str:
    """``at xf`` where the distance is rounding beside the states."""
    at = norm(off) <= _ROUNDED * max(map(norm, states))
    return f"at {goal}" if at else f"{norm(off):.2g} from {goal}"


def _limited_error(
    limited: Limited, system: System, x0: Floats, xf: Floats | None, u: Floats
) -> PlanError:
    """Compare `u` with the best control of an exact system within the same limits."""
    A, B, task = system.A, system.B, replace(limited.task, R=limited.R)
    if task.follows != (xf is None):
        which = "None: this plan has a" if task.follows else "given: this plan has no"
        raise InputError(f"`xf` must be {which} reference")
    if xf is not None:
        task = replace(task, reference=np.tile(xf, (task.steps, 1)))
    horizon = Horizon(task, A, B)
    best = horizon.solve(x0)
    wrong = u - best.u
    reached = states(A, B, x0, best.u)[-1]
    control, state = norm(wrong), norm(states(A, B, 0.0 * x0, wrong)[-1])
    size, length = norm(best.u), norm(reached)
    where = "x_actual" if length else "x0"
    length = length or norm(x0)
    off_control, off_state = horizon.core.in_two_norm(best.distance)
    pushed = (u.size + len(x0)) * EPS * norm(horizon.core.pushes())
    return PlanError(
        control=control,
        control_relative=relative(control, size),
        state=state,
        state_relative=relative(state, length),
        residual=norm(task.reference[-1] - reached),
        control_rounding=off_control + EPS * (size + control),
        state_rounding=off_state + pushed * (size + control),
        control_relative_to="v" if size else "nothing",
        state_relative_to=where if length else "nothing",
        objective=horizon.objective(x0, u) - best.objective,
    )
