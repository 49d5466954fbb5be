"""`LoopCertificate`: what is proved of a linear feedback for all systems of a region."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import numpy as np

from .. import _core
from .._base import show, validation
from .._base.names import Labels, weight
from .._base.reading import read
from .._base.records import Index, SavedRecord, cached_property, require_shapes, trusted
from .._base.running import get_num_threads
from ..exceptions import InputError, NonFiniteError
from ..identification.identified import Identified
from ..identification.model import Model, in_states
from ..identification.region import Region
from .tube import Rest, Tube

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .._base.types import Floats

LoopStatus: TypeAlias = Literal["certified", "refuted", "not provable", "undetermined", "undecided"]


@dataclass(frozen=True, eq=False, repr=False)
class LoopCertificate(SavedRecord):
    """Whether ``u = K x`` makes every system of a region stable.

    Made by `Loop.certificate`. The region holds the true system with probability ``1 - delta``.

    Attributes
    ----------
    region : Region
        The region that all statements are about.
    K : ndarray, shape (m, n)
        The gain: ``u = K x``.
    status : str
        "certified": all systems of the region are stable, which is proved. "refuted": `member` is
        in the region and unstable. "not provable": no proof by a quadratic Lyapunov function, and
        no unstable system was found. "undetermined": the data do not determine the loop; see
        `reason`. "undecided": rounding decides. Only the first is a promise.
    norm : float
        A proved upper bound of ``rho g``; infinite where there is none.
    least : float
        A lower bound of ``rho g``, which is not proved.
    spectral_radius : float
        That of the loop around the centre of the region.
    proof : ndarray, shape (n, n), or None
        R with ``A_G Q A_G' < Q``, ``Q = R R'``, for all systems of the region.
    multipliers : ndarray, shape (parts,)
        That of each part of the region with unknown columns, in the proof; empty without one.
    member : ndarray, shape (n, n + m) or (n, n + m + 1), or None
        ``[A B c]`` of an unstable system in the region.
    labels : Labels
        The names of states and inputs.
    dt : float or None
        The time between two steps [s].
    reason : str or None
        Why nothing is certified, where it is not the size of the region.
    residual : ndarray, shape (n, n), or None
        The sum of squares of the residuals, which bounds the covariance of the noise where the
        region does not.
    degrees : int
        Its degrees of freedom.
    warnings : tuple of str
        What to be careful about, one sentence each: those of the model, and before them that a
        shorter window has a smaller region, where the window was chosen by the data and nothing is
        certified.
    target : ndarray, shape (n + m,), or None
        The states and inputs of the set point of the loop, ``u = us + K (x - xs)``; None: 0.
    """

    region: Region
    K: Annotated[Floats, "input state"]
    status: LoopStatus
    norm: float
    least: float
    spectral_radius: float
    proof: Annotated[Floats, "state state"] | None
    multipliers: Annotated[Floats, "multiplier", "infinite"]
    member: Floats | None
    labels: Labels
    dt: float | None = None
    reason: str | None = None
    residual: Annotated[Floats, "state state"] | None = None
    degrees: Index = 0
    warnings: tuple[str, ...] = ()
    target: Annotated[Floats, "state+input"] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        n, m = self.region.n, self.region.m
        require_shapes(self, K=(m, n), member=self.region.centre.shape)
        if self.residual is not None:
            weight("residual", self.residual, n, matrix=True)
        if not (self.multipliers > 0.0).all():
            raise InputError("`multipliers` must be > 0")
        if (self.status == "certified") != (self.proof is not None):
            raise InputError("`proof` must be given where `status` is 'certified', and only there")

    def _verify(self) -> None:
        norm, *others = self._core.sizes
        if not np.allclose(others, (self.least, self.spectral_radius), rtol=1e-3, equal_nan=True):
            raise InputError("`least` and `spectral_radius` must be those of this region and gain")
        if self.status == "certified" and not (self.check() and self.norm >= norm * (1.0 - 1e-3)):
            raise InputError("`proof` and `norm` do not prove that all systems are stable")
        if self.status == "refuted" and not self._refuted():
            raise InputError("`member` must be an unstable system of the region")

    def _refuted(self) -> bool:
        n, m = self.region.n, self.region.m
        if self.member is None:
            return False
        A, B, c = np.split(np.asarray(self.member), [n, n + m], axis=1)
        matrices = (np.ascontiguousarray(one) for one in (A, B, self.K))
        unstable = np.abs(_core.loop_eigenvalues(*matrices)).max() > 1.0
        return bool(unstable and self.region.contains(A, B, *c.T))

    @cached_property
    def _core(self) -> _core.Feedback:
        doubted = self.status == "undetermined"
        return _core.Feedback(self.region.core, np.ascontiguousarray(self.K), doubted)

    @property
    def margin(self) -> float:
        """The region could be at least this many times larger: ``1 / norm``."""
        return 1.0 / self.norm if self.norm else np.inf

    def check(self) -> bool:
        """Whether `proof` proves that every system of `region` is stable, computed anew.

        Returns
        -------
        bool
            By two Cholesky factorizations in coordinates in which Q is near I, with all rounding.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w)
        >>> se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate(0.05).check()
        True
        """
        unknown = [part for part in self.region.parts if len(part.columns)]
        if self.proof is None or len(self.multipliers) != len(unknown):
            return False
        none = np.zeros_like(self.proof)
        given = np.ascontiguousarray(self.proof), none, 1.0, 1.0, self.multipliers
        return self._core.verified(*given)

    def tube(
        self,
        x0: ArrayLike,
        steps: int,
        *,
        inputs: ArrayLike | None = None,
        start: float = 0.0,
        noise: float | None = None,
        rest: Rest | None = None,
    ) -> Tube:
        """Bound where every system of the region goes from x0.

        Parameters
        ----------
        x0 : array_like, shape (n,)
            The first state; of a model of outputs a window, ``model.window.state_of(y, u)``, which
            is known exactly: the tube is then that of the mean of the readings to come, and errors
            of reading are noise.
        steps : int
            The number of steps K of the tables; what holds for all time is in the tube too.
        inputs : array_like, shape (P, m), optional
            The inputs ub of a plan. Then ``u = ub + K (x - xb)`` with xb the states of the centre
            under ub, and ``u = K x`` after the plan. Default: ``u = K x``.
        start : float, default 0
            x(0) is within this distance of x0.
        noise : float, optional
            The probability that is given away for Gaussian noise of the run, which must be
            independent of the data; half of it for its covariance where that is bounded by the
            residuals. Default: the states without noise.
        rest : Rest, optional
            The feedback is ``u = us + K (x - xs)`` about this set point of `rest`: the tube then
            holds for all time also with an intercept, around the centre under it, and `Tube.later`
            and `Tube.settles` are about the distance from the true point of rest. Default: that of
            `target`, if the loop has one.

        Returns
        -------
        Tube
            Infinite unless `status` is "certified".

        Raises
        ------
        InputError, InputTypeError
            If an argument cannot be used, or no bound of the covariance of the noise is known.

        Notes
        -----
        ``c(k) = W z(k)`` along the centre, ``theta`` the proved norm: ``|h'e(k)| <= sqrt(h'L h)
        ||c|| / (1 - theta)`` (small gain), and sharper by the nuclear norm of the exact first order
        with theta times that for the rest; both also for ``e(k) t^-k``, for several rates t < 1.
        About a set point ``c(k)`` stays at ``W z_s``: the smaller of this bound over the K steps,
        and of ``e(k) = r + A_G^k (x0 - xs - r)`` with r of `rest`. A system of the region need not
        rest at xs: its way from 0 to xs is not that from -xs to 0, whatever the centre does.
        Noise: ``Cov e(k) <= Y`` with ``A_G Y A_G' + Sigma <= Y`` for all systems, and the union
        over rows and steps.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w)
        >>> loop = se.gain(se.identify(data, noise=0.1), 1.0, 1.0)
        >>> tube = loop.certificate(0.05).tube([1.0], 10)
        >>> tube.radii[:2].round(2), tube.settles(0.01)
        (array([0.  , 0.12]), 8)
        """
        n, m = self.region.n, self.region.m
        if isinstance(x0, tuple) and [np.ndim(one) for one in x0] == [2, 2]:
            raise InputError(
                "`x0` must be one state, got a record: pass the window, model.window.state_of(y, u)"
            )
        first = validation.vector("x0", x0, length=n, labels=self.labels.states)
        K = validation.size("steps", steps, maximum=100_000)
        plan = np.zeros((0, m))
        if inputs is not None:
            plan = validation.inputs("inputs", inputs, cols=m, labels=self.labels.inputs)
        radius = validation.nonnegative("start", start)
        if rest is None and self.target is not None and inputs is None:
            rest = self.rest()
        point = None
        if rest is not None:
            if inputs is not None:
                raise InputError(
                    "`inputs` must be left out with `rest`: a plan has an end of its own"
                )
            xs = validation.instance("rest", rest, Rest).states
            point = np.ascontiguousarray(xs), np.ascontiguousarray(rest.inputs)
            if self._resting(*point).to_dict() != rest.to_dict():
                raise InputError("`rest` must be of this certificate: proof.rest(xs)")
        noisy = None if noise is None else noise_bound(self, "noise", noise)
        nominal, *bounds = self._core.tube(first, K, plan, radius, noisy, point)
        if not np.isfinite(nominal).all():
            raise NonFiniteError("`x0`, `inputs` and `steps` lead beyond the largest number")
        about: list[Any] = [self.region.delta, noise, self.labels, self.dt]
        parts: list[Any] = bounds
        if self.status != "certified":
            parts = [one + np.inf for one in parts]
        fields = [nominal[:, :n], nominal[:-1, n:], *parts, *about]
        for one in fields:
            if isinstance(one, np.ndarray):
                one.flags.writeable = False
        return Tube(*fields)

    def rest(self, xs: ArrayLike | None = None) -> Rest:
        """Bound how far from a set point every system of the region comes to rest.

        Parameters
        ----------
        xs : array_like, shape (n,), optional
            The set point; default: `target`, without one the origin. The inputs us are those of
            `target`, or those that hold xs at the centre of the region or come nearest to that.

        Returns
        -------
        Rest
            Infinite unless `status` is "certified".

        Raises
        ------
        InputError, InputTypeError
            If `xs` cannot be used.

        Notes
        -----
        With ``r = C z_s - xs``, ``z_s = (xs, us, 1)`` and ``M = (I - A0)^-1``: ``|h'e| <= |h'M r| +
        rho ||h'M D|| (||W z_s|| + ||E M r||) / (1 - rho ||E M D||)`` by the small gain at z = 1.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w)
        >>> proof = se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate(0.05)
        >>> rest = proof.rest([1.0])
        >>> rest, proof.tube([0.0], 10, rest=rest).settles(0.1)
        (<Rest: every system rests within 0.137 of (1), 95 %>, 5)
        """
        n, m = self.region.n, self.region.m
        if xs is None and self.target is not None:
            return self._resting(*np.split(self.target, [n]))
        names = self.labels.states
        point = np.zeros(n) if xs is None else validation.vector("xs", xs, length=n, labels=names)
        A, B, c = np.split(self.region.centre, [n, n + m], axis=1)
        with np.errstate(over="ignore", invalid="ignore"):
            away = point - A @ point - c.sum(axis=1)
        if not np.isfinite(away).all():
            raise NonFiniteError("`xs` is so large that A xs overflows")
        return self._resting(point, np.linalg.lstsq(B, away, rcond=None)[0])

    def _resting(self, xs: Floats, us: Floats) -> Rest:
        """The `Rest` about the states and inputs of a set point."""
        rows, radius = self._core.rest(xs, us)
        parts: list[Any] = [validation.frozen(one) for one in (xs, us, *np.split(rows, [len(xs)]))]
        parts += [radius, self.region.delta, self.labels]
        return Rest(*parts)

    def holds(
        self,
        inputs: tuple[ArrayLike, ArrayLike] | None = None,
        x0: ArrayLike | None = None,
        *,
        states: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> float:
        """Find the starts from which every system keeps limits for all time, without noise.

        Parameters
        ----------
        inputs : (low, high), optional
            Limits of the inputs: numbers or arrays of shape (m,), ``low < 0 < high``.
        x0 : array_like, shape (n,), optional
            A direction of starts.
        states : (low, high), optional
            Limits of the states, as of the inputs with n.

        Returns
        -------
        float
            From ``scale x0`` with any ``|scale|`` up to this the limits are kept for all time.
            Without `x0` the level s: from all x with ``x'Q^-1 x <= s``, ``Q = R R'`` of the
            `proof` R. 0 where nothing is certified.

        Raises
        ------
        InputError, InputTypeError
            If a limit cannot be used, or there is an intercept, so that 0 is no point of rest.

        Notes
        -----
        ``s = min_i limit_i^2 / h_i'Qh_i`` over the rows h of K and I; for one x0 the best of that,
        of ``Y >= A_G Y A_G' + x0 x0'`` in place of Q, and of the tube.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w)
        >>> proof = se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate(0.05)
        >>> round(proof.holds((-1.0, 1.0), [1.0]), 2)
        1.26
        """
        if self.target is not None or self.region.centre.shape[1] > self.region.n + self.region.m:
            raise InputError(
                "`holds` needs a loop that rests at 0, without intercept and target: "
                "tube(x0, steps, rest=rest(xs)).reach bounds states and inputs for all time"
            )
        limits = np.concatenate(
            [_smaller("states", states, self.region.n), _smaller("inputs", inputs, self.region.m)]
        )
        if not np.isfinite(limits).any():
            raise InputError("`inputs` or `states` must have a finite limit")
        first, names = None, self.labels.states
        if x0 is not None:
            first = validation.vector("x0", x0, length=self.region.n, labels=names)
        level, scale = self._core.holds(limits, first)
        return level if scale is None else scale

    def __repr__(self) -> str:
        share = show.percent(self.region.delta)
        if self.status == "certified":
            what = f"certified for every system of the region ({share}): stable, "
            what += f"margin at least {show.margin(self.margin)}"
        elif self.status == "refuted":
            what = (
                f"refuted: this gain leaves a system of the region ({share}) unstable, see `member`"
            )
            if self.reason is not None:
                what += f": {self.reason}"
            elif self.spectral_radius >= 1.0:
                what += ", and the model itself: take another gain"
            else:
                what += f"; {more_logs(self.least)}, or a gain with a better margin: gain(model)"
        elif self.reason is not None:
            what = f"{self.status}: {self.reason}"
        elif self.status == "undecided":
            what = (
                "undecided: no system of the region was found unstable, but the proof fails by "
                f"rounding, with a region {self.least:.6g} times as large as the largest that can "
                "be proved: fewer lags or filters, or more weight of the inputs, help"
            )
        else:
            what = (
                f"{self.status}: the region is {self.least:.3g} times as large as can be proved; "
                f"{more_logs(self.least)}, or a gain with a better margin: gain(model)"
            )
        return f"<LoopCertificate: {what}{show.careful(self.warnings)}>"

    def _repr_html_(self) -> str:
        rows = [
            ("holds with", f"{show.percent(self.region.delta)} at least"),
            ("for", self.region.assumption),
            ("spectral radius of the centre", self.spectral_radius),
            ("size of the region, of what is proved", f"{self.least:.6g} to {self.norm:.6g}"),
        ]
        return show.card(self, rows)


def _smaller(name: str, limits: tuple[ArrayLike, ArrayLike] | None, size: int) -> Floats:
    """The smaller of both distances from 0, (size,); infinite without limits."""
    if limits is None:
        return np.full(size, np.inf)
    sides = [read(name, one) for one in limits] if isinstance(limits, (tuple, list)) else []
    shapes = {(), (size,)}
    if len(sides) != 2 or any(s.dtype.kind not in "iuf" or s.shape not in shapes for s in sides):
        raise InputError(f"`{name}` must be (low, high), each a number or of shape ({size},)")
    low, high = (np.broadcast_to(side.astype(np.float64), (size,)) for side in sides)
    if not ((low < 0).all() and (high > 0).all()):
        raise InputError(f"`{name}` must have low < 0 < high, got {low} and {high}")
    return np.minimum(-low, high)


def judged(
    region: Region,
    K: Floats,
    labels: Labels,
    model: Identified,
    squares: tuple[Floats | None, int] = (None, 0),
    target: Floats | None = None,
) -> LoopCertificate:
    """The verdict about a gain; doubts about the data of the model leave nothing to certify.

    `squares` bounds the covariance of the noise: the `residual` and its `degrees`.
    """
    doubt = model.doubts[0] if model.doubts else _no_effect(region, K, model)
    found = _core.Feedback(region.core, np.ascontiguousarray(K), doubt is not None)
    reason = doubt
    if doubt is None and found.status == "undetermined":
        reason = "the region is unbounded: too few data"
        if np.isfinite(region.radius):
            along = ", ".join(region.missing[:3]) or "what is outside the span it was made for"
            reason = f"the data do not determine the system along {along}"
    if found.status in ("refuted", "not provable") and found.sizes[2] < 1.0:
        reason = unmoved(model, region.delta)
    warnings = tuple(one for one in model.warnings if one != doubt)
    window = model.window if isinstance(model, Model) else None
    if window is not None and found.status in ("refuted", "not provable", "undecided"):
        warnings = (*window.long, *warnings)
    norm, least, radius = found.sizes
    proof, member = found.proof, found.member
    made = trusted(
        LoopCertificate,
        region=region,
        K=K,
        status=found.status,
        norm=norm,
        least=least,
        spectral_radius=radius,
        proof=None if proof is None else validation.frozen(proof),
        multipliers=validation.frozen(found.multipliers),
        member=None if member is None else validation.frozen(member),
        labels=labels,
        dt=model.dt,
        reason=reason,
        residual=squares[0],
        degrees=squares[1],
        warnings=warnings,
        target=None if target is None else validation.frozen(target),
    )
    vars(made)["_core"] = found  # so that it is not computed again
    return made


def noise_bound(proof: LoopCertificate, name: str, eps: float) -> tuple[Floats, float]:
    """A bound of the covariance, and what is left of `eps` for the noise itself."""
    left, region = validation.probability(name, eps), proof.region
    if left + region.delta >= 1.0:
        raise InputError(f"`{name}` must be below 1 - delta = {1.0 - region.delta:g}, got {eps:g}")
    if region.noise is not None:
        return np.ascontiguousarray(region.noise), left
    if proof.residual is None or proof.degrees < len(proof.residual):
        raise InputError(
            f"`{name}` needs a bound of the covariance of Gaussian noise, which this region does "
            "not have: declare `sigma` or `covariance`, or give more pairs"
        )
    # S >= a Sigma but with eps / 2, a the quantile of the smallest root of W_n(nu, I)
    a = _core.smallest_quantile(region.n, proof.degrees, left / 2.0, get_num_threads())
    return np.ascontiguousarray(proof.residual) / a, left / 2.0


def more_logs(least: float) -> str:
    """How many logs would do, as ``rho g`` falls as the number of pairs to -1/2."""
    return f"about {least**2:.2g} times as many logs like these will do (a forecast)"


def unmoved(model: Identified, delta: float) -> str | None:
    """A mode that does not decay, and of which no input is seen to move it in this region.

    ``w'(A - L I) = 0``, w_p the part of the p rows that were identified, and x_j how the rest of
    the window follows an input ``e_j L^t``: the mode is moved by ``w_p'(A_p x_j + B_p e_j)``, which
    the region knows up to ``||w_p|| ||(Theta - C)(x_j, e_j)||``.
    """
    if not isinstance(model, Model):
        return None
    (n, m), p = model.B.shape, model.n_outputs if model.window is not None else model.n
    region, rows = in_states(model, model.region(delta)), np.arange(n) < p
    values, left = np.linalg.eig(model.A.T)
    shift, own = (np.where(rows[:, None], 0.0, M) for M in (model.A, model.B))
    for k in np.flatnonzero(np.abs(values) >= 1.0):
        w = left[:p, k]
        x = np.linalg.solve(values[k] * np.eye(n) - shift, own)
        moved = np.abs(w @ (model.A[:p] @ x + model.B[:p]))
        parts = [(x.real, np.eye(m)), (x.imag, np.zeros((m, m)))]
        off = sum(np.array([region.bound(a[:, j], u[:, j]) for j in range(m)]) for a, u in parts)
        if (moved <= np.linalg.norm(w) * off).all():
            name = model.labels.states[int(np.argmax(np.abs(w)))]
            return (
                f"{name} has a part that is {np.abs(values[k]):.3g} times as large after a step, "
                "and the data do not show that an input moves it: more data, or another input"
            )
    return None


def _no_effect(region: Region, K: Floats, model: Identified) -> str | None:
    """Why a gain is not certified whose inputs have no effect that the data show."""
    source = getattr(model, "least_squares", model)
    if getattr(source, "window", None) is not None or not np.isfinite(region.radius):
        return None
    if "no effect" in source.assumptions.accept:  # type: ignore[union-attr]
        return None
    n, m = region.n, region.m
    B, within = np.asarray(region.centre)[:, n : n + m], region.entry_bounds[:, n : n + m]
    hidden = ((np.abs(B) <= within) & np.isfinite(within)).all(axis=0)
    none = np.flatnonzero(hidden & K.any(axis=1)).tolist()
    if not none:
        return None
    names = ", ".join(model.input_names[j] for j in none)
    return (
        f"{names} has no effect within its bounds, and nothing follows for a feedback: excite it, "
        "or see whether rows hold the state after their action (delay=-1) (or accept='no effect')"
    )
