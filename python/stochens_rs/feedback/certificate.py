"""`LoopCertificate`: what is proved of a linear feedback for all systems of a region."""

from __future__ import annotations

import hashlib
import json
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import replace
from math import ceil
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np

from .. import _core
from .._base import files, show, validation
from .._base.names import Labels, weight
from .._base.reading import read
from .._base.records import Index, SavedRecord, cached_property, require_shapes, trusted
from .._base.running import get_num_threads
from .._base.types import ArrayLike, Floats
from ..exceptions import InputError, NonFiniteError, StochensError
from ..identification.assumptions import block_of, directions_of, signals_of, sizes_of
from ..identification.changes import Predictor
from ..identification.identified import Identified
from ..identification.model import Model, after, in_states
from ..identification.region import Region
from .bounds import Margins, Rest, Rounding, Tube
from .watch import LAWS, LawOfWatch, Watch

LoopStatus: TypeAlias = Literal["certified", "refuted", "not provable", "undetermined", "undecided"]

WINDOW = "a window that is not that of its model"
BIAS = "a learned constant, which it keeps within limits: take the loop of gain(model)"
DOUBLED = 10  # times that the number of logs is doubled in a forecast


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
        `reason`. "undecided": rounding decides, see `reason`. Only the first is a promise.
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
    source : Predictor or None
        What `watch` needs of the model.
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
    source: Predictor | None = None

    def _check(self) -> None:
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
        return _judge(self.region, self.K, self.labels, self.status == "undetermined")

    def save(self, path: Any) -> int:
        """Save to a file, or with the ending .json the proof for `check_proof.py`.

        Parameters
        ----------
        path : path
            The file. ``proof.json`` has names, delta, and a Q that proves stability for a region
            as much larger as can be: the checker's own region is a cruder one.

        Returns
        -------
        int
            The generation, as of all saved records; of a proof 1.

        Raises
        ------
        StateError, StateLockedError, StateIOError
            As for all saved records.
        InputError, InputTypeError
            If `path` is not a path, or a proof is asked for where nothing is certified.

        Examples
        --------
        >>> import numpy as np, pathlib, tempfile, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w)
        >>> proof = se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate(0.05)
        >>> proof.save(pathlib.Path(tempfile.mkdtemp()) / "proof.json")
        1
        """
        if not files.checked_path("path", path).endswith(".json"):
            return super().save(path)
        if self.proof is None:
            raise InputError("`path` must not end in .json: nothing is certified of this gain")
        if self.region.misfit is not None:
            raise InputError("`path` must not end in .json: check_proof.py knows no misfit")
        none, more = np.zeros_like(self.proof), min(self.margin, 1e3) - 1.0
        larger = (1.0 + part * more for part in (0.98, 0.9, 0.7, 0.4))
        found = (self._core.invariant(none, 1.0, 1.0, by * by - 1.0) for by in larger)
        root = next((one for one in found if one is not None), self.proof)
        Q = root @ root.T
        tree = {
            "states": list(self.labels.states),
            "inputs": list(self.labels.inputs),
            "offset": self.region.centre.shape[1] - self.region.n - self.region.m,
            "delta": self.region.delta,
            "Q": ((Q + Q.T) / 2.0).tolist(),
        }
        text = json.dumps(tree, sort_keys=True)
        seal = hashlib.sha256(text.encode()).hexdigest()
        files.write_text(path, json.dumps({"proof": tree, "sha256": seal}, indent=1) + "\n")
        return 1

    @property
    def assumption(self) -> str:
        """What the region holds for."""
        return self.region.assumption

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
        if self.proof is None or len(self.multipliers) != len(unknown) + (
            self.region.misfit is not None
        ):
            return False
        root = np.ascontiguousarray(self.proof)
        return self._core.verified(root, np.zeros_like(root), 1.0, 1.0, self.multipliers)

    def tube(
        self,
        x0: ArrayLike,
        steps: int,
        *,
        inputs: ArrayLike | None = None,
        start: float = 0.0,
        noise: float | None = None,
        rest: Rest | None = None,
        readings: ArrayLike = 0.0,
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
        readings : float or array_like, shape (p,), default 0
            Each reading that the feedback gets may be off by this, in any way, at every step:
            drift, offset, steps of a converter. A loop of readings has them at all lags, in its
            filters and in the constant that it learns.

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
        over rows and steps. Errors of readings: the record of the feedback is off by at most ``d =
        (I - |N|)^-1 |G| e``, its inputs by ``|K| d``, and an ellipsoid is invariant for all systems
        and all such inputs; they add to `Tube.start`.

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
        misread = self._misread(readings)
        nominal, *bounds = self._core.tube(first, K, plan, radius, noisy, point)
        if not np.isfinite(nominal).all():
            raise NonFiniteError("`x0`, `inputs` and `steps` lead beyond the largest number")
        parts: list[Any] = bounds
        holds, misfit = self.status == "certified", self.region.misfit
        if holds and misfit is not None:  # which is bounded where states and inputs are so small
            reach = np.asarray(bounds[-1])[None]
            holds = bool(sizes_of(misfit, reach, self.labels)[0] <= misfit.within)
        if misread is not None:
            (moved, off), (_, begun, radii, _, _, later, reach) = misread, parts
            with np.errstate(over="ignore"):
                begun[1:] += moved
                begun[:, n:] += off
                for one in (radii[1:], later):
                    one += np.linalg.norm(moved[:n])
                reach += moved + np.append(np.zeros(n), off)
        parts = parts if holds else [one + np.inf for one in parts]
        about = self.region.delta, noise, self.labels, self.dt
        fields = [nominal[:, :n], nominal[:-1, n:], *parts, *about]
        for one in fields:
            if isinstance(one, np.ndarray):
                one.flags.writeable = False
        return Tube(*fields)

    def _misread(self, sizes: ArrayLike) -> tuple[Floats, Floats] | None:
        """How far errors of the readings move states and ``K x``, (n + m,), and inputs, (m,)."""
        recorder = None if self.source is None else self.source.recorder()
        p = self.region.n if recorder is None else recorder[1].shape[1]
        given = read("readings", sizes)
        each = validation.vector("readings", given if given.ndim else np.full(p, given), length=p)
        if not each.any():
            return None
        require_linear(self.region, "readings")
        self._refuse("readings", WINDOW)
        return self._core.misread(recorder, each)

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
        require_linear(self.region, "rest")
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
        self._at_zero("holds")
        limits = np.concatenate(
            [_smaller("states", states, self.region.n), _smaller("inputs", inputs, self.region.m)]
        )
        if not np.isfinite(limits).any():
            raise InputError("`inputs` or `states` must have a finite limit")
        misfit = self.region.misfit
        if misfit is not None and misfit.within < np.inf:  # ||z|| <= within if each is small
            z = signals_of("of", misfit.of, self.labels)
            each = np.where(z.any(axis=0), misfit.within / np.sqrt(len(z)), np.inf)
            limits = np.minimum(limits, each)
        first, names = None, self.labels.states
        if x0 is not None:
            first = validation.vector("x0", x0, length=self.region.n, labels=names)
        level, scale = self._core.holds(limits, first)
        return level if scale is None else scale

    def watch(
        self,
        *,
        every: float | None = None,
        level: float | None = None,
        law: LawOfWatch = "variance",
        moving: bool = False,
    ) -> Watch:
        """Make an alarm that rings when the plant is none of the systems of `region` any more.

        Parameters
        ----------
        every : float, optional
            The mean number of steps between false alarms, at least; default 1e5.
        level : float, optional
            In its place the probability of a false alarm ever.
        law : {"variance", "gaussian", "symmetric", "bounded"}, default "variance"
            What is assumed of the noise given the past. "variance": mean 0 and a covariance within
            its bound, nothing else. "gaussian": also sub-Gaussian. "symmetric": of any size.
            "bounded": mean 0 and ``w' S^-1 w <= 1``.
        moving : bool, default False
            Whether the plant may move inside the region at will; else it is constant in each block
            of 64 steps, for which small changes are seen sooner.

        Returns
        -------
        Watch
            ``state = watch(y, u)`` in each step.

        Raises
        ------
        InputError, InputTypeError
            If both are given, the region is unbounded, or no bound of the noise is known.

        Notes
        -----
        In the event of the region and of the bound of the noise, of probability ``1 - delta -
        source.spent``: the mean number of alarms in T steps is at most ``(T + 14) / every``. The
        sum over starts of products of bets with expectation at most 1 (Shin, Ramdas and Rinaldo
        2023): docs, "Has my plant changed?".

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> rng = np.random.default_rng(1)
        >>> x, u, w = rng.standard_normal((3, 100, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w)
        >>> proof = se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate(0.05)
        >>> watch, x = proof.watch(every=1e5), np.zeros(1)
        >>> for k in range(300):
        ...     u = proof.K @ x + 0.3 * rng.standard_normal(1)
        ...     state = watch(x, u)
        ...     x = 1.2 * x + (1.0 if k < 150 else 0.6) * u + 0.1 * rng.standard_normal(1)
        >>> state.status, watch.changes().explanations
        ('alarm', ('u[0]', 'x[0](k+1)'))
        """
        if every is not None and level is not None:
            raise InputError("`every` and `level` must not be given both")
        name, value, low, high = "every", 1e5 if every is None else every, 2.0, 1e15
        if level is not None:
            name, value, low, high = "level", level, 1e-15, 0.5
        promise = validation.positive(name, value)
        if not low <= promise <= high:
            raise InputError(f"`{name}` must be from {low:g} to {high:g}, got {promise:g}")
        law = validation.choice("law", law, LAWS)
        require_linear(self.region, "watch")
        return Watch(self, promise, law, validation.flag("moving", moving))

    def of(self, region: Region | None, reason: str | None = None) -> LoopCertificate:
        """Return the verdict about the same gain for another region.

        Parameters
        ----------
        region : Region or None
            Of the same states and inputs; None where there is none.
        reason : str, optional
            Why there is none.

        Returns
        -------
        LoopCertificate
            Without a region "undetermined".

        Raises
        ------
        InputError, InputTypeError
            If `region` is not a region of these states and inputs, or `reason` not a text.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w)
        >>> model = se.identify(data, noise=0.1)
        >>> proof = se.gain(model, 1.0, 1.0).certificate(0.05)
        >>> proof.of(model.region(0.01)).status
        'certified'
        >>> proof.of(None, "the log was lost").status
        'undetermined'
        """
        if reason is not None:
            validation.text("reason", reason)
        if region is None:
            fields = {"status": "undetermined", "norm": np.inf, "proof": None, "reason": reason}
            return replace(self, **fields, multipliers=self.multipliers[:0], member=None)  # type: ignore[arg-type]
        known = validation.instance("region", region, Region)
        found = judged(known, self.K, self.labels, None, (None, 0), self.target, self.source)
        return replace(found, dt=self.dt)

    def margins(self) -> Margins:
        """Find how much the loop withstands: proved for every system of the region.

        Returns
        -------
        Margins
            Gain, phase and disk margins of each input, the disk of all inputs at once, delay, error
            of readings, rounding of the gain and saturation, each beside that of the centre.
            Nothing is certified unless `status` is "certified" and the data determine all
            directions.

        Raises
        ------
        InputError
            If the window of the loop is not known.

        Notes
        -----
        Gain and phase: a chain of discs of factors, each with one Lyapunov function for all
        systems. Disk ``S - T`` (Seiler, Packard and Gahinet 2020), readings, varying delay and
        share: a block beside that of the region in one small-gain proof, with multipliers; the
        uncertain B is counted. A constant delay, and a gain of fewer bits, are loops of their own.
        A delay that varies, of up to one step: any mix of the input and that of the step before;
        above 1: inputs of up to so many steps before, in any pattern. Readings: each is off by at
        most this part of itself. Share: each input may be cut to this part of it at any step.
        A loop of a window has a record of its own, of inputs that it asked for and of what it read,
        at all lags, beside that of the plant; only of the share it has what acted.
        It takes under a second with one input, but 9 s with 3 inputs and 10 states, and 23 s with 5
        and 20; `allows` takes milliseconds.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w)
        >>> proof = se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate(0.05)
        >>> proof.margins()
        <Margins: 95 %, gain 0.331 to 2.52, phase 49.3 deg, disk 0.864>
        """
        self._refuse("margins", WINDOW)
        recorder = None if self.source is None else self.source.recorder()
        found = np.ascontiguousarray(self._core.margins(recorder).T)
        m = len(self.labels.inputs)
        found[:, 2 : 4 * m : 4] = np.rad2deg(found[:, 2 : 4 * m : 4])
        reason = None
        if self.status != "certified":
            reason = f"the loop is {self.status}"
        elif self.region.missing:
            reason = f"the data leave {', '.join(self.region.missing[:3])} open: vary the inputs"
        elif (found[0, : 4 * m].reshape(m, 4)[:, :2] == 1.0).all():
            reason = (
                "no proof was found, as where readings say nearly the same (pass their sum and "
                "difference) or the certificate has no room (more data)"
            )
        certified, nominal = (validation.frozen(one) for one in found)
        return Margins(certified, nominal, self.region.delta, self.labels, self.dt, reason)

    def allows(self, *, on: ArrayLike | str | Sequence[str], of: str | Sequence[str]) -> float:
        """Find how large a term of any kind may be that the model leaves out.

        Parameters
        ----------
        on : str, sequence of str, or array_like of shape (n,)
            The states that the term is added to; or the direction of one number in all states.
        of : str or sequence of str
            The states and inputs that it is a function of.

        Returns
        -------
        float
            gamma: for every system of the region and every f with ``||f(z, k)|| <= gamma ||z||``,
            nonlinear, time-varying or random, the loop stays stable. 0 where nothing is proved.

        Raises
        ------
        InputError, InputTypeError
            If a name is unknown or a direction is 0.

        Notes
        -----
        The proof needs the region to hold for the data: a plant with such a term while they were
        recorded needs a `Misfit` in `identify`.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w)
        >>> proof = se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate(0.05)
        >>> round(proof.allows(on="x[0]", of="x[0]"), 2)
        0.5
        """
        return self._core.allows(
            directions_of("on", on, self.labels), signals_of("of", of, self.labels)
        )[0]

    def attracts(self, inputs: tuple[ArrayLike, ArrayLike], x0: ArrayLike) -> float:
        """Find from where every system comes to rest although its inputs saturate, without noise.

        Parameters
        ----------
        inputs : (low, high)
            Limits at which the inputs stop: numbers or arrays of shape (m,), ``low < 0 < high``.
        x0 : array_like, shape (n,)
            A direction of starts.

        Returns
        -------
        float
            From ``scale x0`` with any ``|scale|`` up to this every system comes to rest; 0 where
            nothing is proved.

        Raises
        ------
        InputError, InputTypeError
            If a limit cannot be used, 0 is no point of rest, or the loop learns a constant.

        Notes
        -----
        Near 0 by a sector, ``sat(v) = kappa v``, ``1 - beta <= kappa <= 1``: a block beside
        that of the region. From further away by the motion of the centre with an ellipsoid around
        it, until that is in such a set; its rounding is allowed for, not proved. A window has the
        inputs as they were cut.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w)
        >>> proof = se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate(0.05)
        >>> round(proof.attracts((-1.0, 1.0), [1.0]), 1), round(proof.holds((-1.0, 1.0), [1.0]), 1)
        (3.7, 1.3)
        """
        self._at_zero("attracts")
        self._refuse("attracts", WINDOW, BIAS)
        require_linear(self.region, "attracts")
        first = validation.vector("x0", x0, length=self.region.n, labels=self.labels.states)
        return self._core.attracted(_smaller("inputs", inputs, self.region.m), first)

    def rounding(
        self, x0: ArrayLike, *, bits: int | None = None, steps: int = 1, noise: float | None = None
    ) -> Rounding:
        """Bound how far the loop in the numbers of a small computer is from the exact one.

        The exact one has the gain `K` of this certificate, not the rounded one: the bound may be
        added to ``tube(x0, steps)`` or ``tube(x0, steps, noise=noise)``, without other arguments,
        and holds in the same event.

        Parameters
        ----------
        x0 : array_like, shape (n,)
            The first state.
        bits : int, optional
            Fixed point with so many bits behind the point, with an exact sum. Default: floating
            point of 32 bits, in any order, with or without fused products, subnormal numbers kept
            or not.
        steps : int, default 1
            How many steps the bound is for, with `noise`; without it is for all time.
        noise : float, optional
            The probability that is given away for noise, as in `tube`. Default: no noise.

        Returns
        -------
        Rounding
            Infinite where nothing is proved of `K` or of the stored gain. States, gain and inputs
            are rounded to nearest; no number overflows: see `Tube.reach` for their size.

        Raises
        ------
        InputError, InputTypeError
            If an argument cannot be used, 0 is no point of rest, or the loop learns a constant.

        Notes
        -----
        The stored gain S is certified as it is. Its inputs are wrong by ``|eta_i| <= g sum_j |S_ij
        x_j| + mu``, ``g = (n + 2) u / (1 - (n + 2) u)``, ``u = 2^-24``, and by ``|S - K| |x|`` with
        the states x of the exact loop, `Tube.reach` and noise; errors of the inputs move the states
        by at most ``s``, an invariant ellipsoid for all systems, and ``s g |S|`` of the states
        again. Of few bits S - K is the largest part: a loop whose own K has no more bits, as
        ``replace(loop, K=found.K, S=None)``, has none of it. Filters ``a c + (1 - a) before`` and
        their poles are rounded as well: in float32 each step is off by ``(5 + a / (1 - a)) u (|c| +
        |before|)``, and the filter by ``1 / (1 - a)`` of that, beside the one before it.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w)
        >>> proof = se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate(0.05)
        >>> proof.rounding([1.0], bits=12)
        <Rounding: 12 fraction bits, 95 %, off by at most x[0] 0.00063 without noise>
        """
        self._at_zero("rounding")
        self._refuse("rounding", WINDOW, BIAS)
        require_linear(self.region, "rounding")
        n, K = self.region.n, np.asarray(self.K)
        window = None if self.source is None else self.source.window
        filters = None if window is None else (window.pole, len(window.outputs), window.count)
        if bits is None:
            with np.errstate(over="ignore", under="ignore"):
                kept = K.astype(np.float32).astype(np.float64)
            kept[np.abs(kept) < 2.0**-126] = 0.0  # subnormal
        else:
            step = 2.0 ** -validation.size("bits", bits, minimum=0, maximum=62)
            kept = np.round(K / step) * step
        # the gain that is stored, about the motion of this one
        core = _judge(self.region, kept, self.labels, self.status == "undetermined")
        exact = self.tube(x0, steps, noise=noise)
        reach = exact.reach + exact.noise
        with np.errstate(invalid="ignore"):  # 0 inf
            apart = np.abs(kept - K) @ reach[:n]
        moved = core.rounded(reach, apart, bits, filters)
        states, inputs = (validation.frozen(one.copy()) for one in np.split(moved, [n]))
        margin = 1.0 / core.sizes[0] if core.status == "certified" else 0.0
        about = margin, self.region.delta, self.labels, noise
        return Rounding(validation.frozen(kept), bits, states, inputs, *about)

    def _refuse(self, what: str, *but: str) -> None:
        """Refuse loops that remember what nothing is proved for."""
        rows = {row for part in self.region.parts for row in part.rows.tolist()}
        odd = WINDOW if len(rows) < self.region.n else None
        if self.source is not None:
            odd = BIAS if self.source.bias is not None else None
        if odd in but:
            raise InputError(f"`{what}` is not known of a loop with {odd}")

    def _at_zero(self, what: str) -> None:
        """Refuse a loop that does not rest at 0."""
        if self.target is not None or self.region.centre.shape[1] > self.region.n + self.region.m:
            raise InputError(
                f"`{what}` needs a loop that rests at 0, without intercept and target: "
                "tube(x0, steps, rest=rest(xs)).reach bounds states and inputs for all time"
            )

    def __repr__(self) -> str:
        share, misfit, why = show.percent(self.region.delta), self.region.misfit, self.reason
        if self.status == "certified":
            what = f"certified for every system of the region ({share}): stable, margin at least "
            what += show.margin(self.margin) + (f", with {misfit.text}" if misfit else "")
        elif self.status == "refuted":
            end = f": {why}" if why else f"; {self._cure}"
            if why is None and self.spectral_radius >= 1.0:
                end = ", and the model itself: take another gain"
            what = f"refuted: this gain leaves a system of the region ({share}) unstable, see "
            what += f"`member`{end}"
        elif why is not None:
            what = f"{self.status}: {why}"
        else:
            size = f"{self.least:.3g} times as large as can be proved"
            what = f"{self.status}: the region is {size}; {self._cure}"
        return f"<LoopCertificate: {what}{show.careful(self.warnings)}>"

    @property
    def _cure(self) -> str:
        """What makes a proof possible: more data make the region smaller, but no misfit."""
        if self.region.misfit:
            return "a gain with a better margin: gain(model)"

        model: Any = vars(self).get("_model")
        source = self.source

        def holds(region: Region) -> bool:
            own = in_states(model, region) if source is None else source.entered(region)
            return _judge(own, self.K, self.labels, False).sizes[1] < 1.0

        more = more_logs(model, self.region.delta, holds)
        return f"{more}, or a gain with a better margin: gain(model)"


def require_linear(region: Region, what: str) -> None:
    """Refuse what holds of linear systems only."""
    if region.misfit is not None:
        raise InputError(
            f"`{what}` must be left out for a model with a misfit: no bound is known there"
        )


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


def _judge(region: Region, K: Floats, labels: Labels, doubted: bool) -> _core.Feedback:
    """What the core finds of a gain, with the misfit of the region as a block beside it."""
    block = None if region.misfit is None else block_of(region.misfit, labels)
    return _core.Feedback(region.linear, np.ascontiguousarray(K), doubted, block)


def sentence(K: Floats | None, proof: LoopCertificate | None) -> dict[str, str]:
    """What the head of a controller says of the proof of its gain."""
    if proof is None:
        return {"proof": "none: nothing is certified of this loop"}
    if K is None or not np.array_equal(K, validation.instance("proof", proof, LoopCertificate).K):
        raise InputError("`proof` must be of this gain: loop.certificate(delta)")
    more = "; a plant that is linear and read as in the data, inputs applied, none at a limit"
    return {
        "proof": repr(proof)[18:-1],
        "margin": f"{proof.margin:.6g}: the region could be so many times larger",
        "delta": f"{proof.region.delta!r}, the probability that the true system is elsewhere",
        "assumes": proof.region.assumption + more,
    }


def judged(
    region: Region,
    K: Floats,
    labels: Labels,
    model: Identified | None,
    squares: tuple[Floats | None, int] = (None, 0),
    target: Floats | None = None,
    source: Predictor | None = None,
) -> LoopCertificate:
    """The verdict about a gain; doubts about the data of the model leave nothing to certify.

    `squares` bounds the covariance of the noise: the `residual` and its `degrees`.
    """
    doubt = None
    if model is not None:
        doubt = model.doubts[0] if model.doubts else _no_effect(region, K, model)
    found = _judge(region, K, labels, doubt is not None)
    reason = doubt
    if doubt is None and found.status == "undetermined":
        reason = "the region is unbounded: too few data"
        if np.isfinite(region.radius):
            along = ", ".join(region.missing[:3]) or "what is outside the span it was made for"
            reason = f"the data do not determine the system along {along}"
    if doubt is None and found.status == "undecided":
        reason = (
            "no system of the region was found unstable, but the proof fails by rounding, with a "
            f"region {found.sizes[1]:.6g} times as large as the largest that can be proved: fewer "
            "lags or filters, or more weight of the inputs, help"
        )
    if model is not None and found.status in ("refuted", "not provable") and found.sizes[2] < 1.0:
        reason = unmoved(model, region.delta)
    warnings = tuple(one for one in (model.warnings if model else ()) if one != doubt)
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
        dt=model.dt if model else None,
        source=source,
        reason=reason,
        residual=squares[0],
        degrees=squares[1],
        warnings=warnings,
        target=None if target is None else validation.frozen(target),
    )
    vars(made)["_core"] = found  # so that it is not computed again
    vars(made)["_model"] = model  # for a forecast
    return made


def noise_bound(proof: LoopCertificate, name: str, eps: float) -> tuple[Floats, float]:
    """A bound of the covariance, and what is left of `eps` for the noise itself."""
    left, region = validation.probability(name, eps), proof.region
    require_linear(region, name)
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


def more_logs(model: Identified | None, delta: float, holds: Callable[[Region], bool]) -> str:
    """How many times as many logs will do: `holds` for the region of so many, if they go on so."""
    if not isinstance(model, Model) or model.pilot is not None:
        return "more logs"
    known = model

    def enough(half: int) -> bool:
        try:
            return holds(after(known, ceil(known.size * 2.0 ** (half / 2))).region(delta))
        except StochensError:
            return False

    found = bisect_left(range(2 * DOUBLED + 1), True, key=enough)
    if found > 2 * DOUBLED:
        return f"more than {2**DOUBLED} times as many logs like these (a forecast)"
    return f"about {2.0 ** (found / 2):.2g} times as many logs like these will do (a forecast)"


def unmoved(model: Identified, delta: float) -> str | None:
    """A mode that does not decay, and of which no input is seen to move it in this region."""
    if not isinstance(model, Model) or model.misfit is not None:
        return None
    rows = model.n if model.window is None else model.n_outputs  # those that were identified
    found = _core.unmoved(in_states(model, model.region(delta)).core, rows)
    if found is None:
        return None
    return (
        f"{model.labels.states[found[0]]} has a part that is {found[1]:.3g} times as large after a "
        "step, and the data do not show that an input moves it: more data, or another input"
    )


def _no_effect(region: Region, K: Floats, model: Identified) -> str | None:
    """Why a gain is not certified whose inputs have no effect that the data show."""
    source = getattr(model, "least_squares", model)
    known = np.isfinite(region.radius) and getattr(source, "window", None) is None
    if not known or "no effect" in source.assumptions.accept:  # type: ignore[union-attr]
        return None
    n, m = region.n, region.m
    AB, within = np.asarray(region.centre)[:, : n + m], region.entry_bounds[:, : n + m]
    hidden = np.abs(AB) <= within
    of_inputs = (hidden & np.isfinite(within))[:, n:].all(axis=0)
    none = np.flatnonzero(of_inputs & K.any(axis=1)).tolist()
    if not none:
        return None
    if len(none) == m and hidden[:, :n].all():
        return (
            f"{show.number_of(source.size, 'pair')} leave the sign of every effect open, "  # type: ignore[union-attr]
            "of the states too: measure more (or accept='no effect')"
        )
    names, one = ", ".join(model.input_names[j] for j in none), len(none) == 1
    return (
        f"{names} {'has no effect within its bounds' if one else 'have no effect within theirs'}, "
        f"and nothing follows for a feedback: excite {'it' if one else 'them'}, or see whether "
        "rows hold the state after their action (delay=-1) (or accept='no effect')"
    )
