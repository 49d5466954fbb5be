"""`Snapshot`: the model of a `ModelStream` after the pairs so far; `Look`: whether it is enough."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from math import ceil, floor, inf, isfinite, isqrt, log2
from typing import Annotated, Any, TypeAlias

import numpy as np

from .. import _core
from .._base import running, show, validation
from .._base.names import checked_names
from .._base.records import (
    Count,
    Positive,
    Probability,
    Record,
    SavedRecord,
    cached_property,
    trusted,
)
from .._base.types import ArrayLike, Floats
from ..certificates.certificate import Certificate
from ..certificates.of_model import (
    ModelBasis,
    Question,
    certificate,
    output_certificate,
    trajectory,
)
from ..controls.control import control
from ..exceptions import InputError, ShapeError
from ..feedback import Loop, LoopCertificate
from ..feedback.certificate import judged
from ..identification.assumptions import Assumptions, checked_scale
from ..identification.assumptions import refuse as refuse_declared
from ..identification.checks import cautions, exact_relations, noise_doubts, tested_rows
from ..identification.identified import Fitted
from ..identification.model import Model, after, in_states
from ..identification.region import Region, Wish, of_core, region_of, withheld

Size: TypeAlias = Annotated[int, partial(validation.size, minimum=0)]


class Snapshot(SavedRecord, Fitted):
    """The model of a `ModelStream` at one time. Made by `ModelStream.model`.

    Attributes
    ----------
    triangle : ndarray
        R with ``R' R = W' W`` for the rows ``W = (x, u, 1, x_next)`` of all pairs so far.
    size : int
        The number of pairs N.
    n, m : int
        The numbers of states and inputs.
    assumptions : Assumptions
        Design, noise and covariance, as declared.
    scale : ndarray, shape (n + m,) or (n + m + 1,)
        The sizes of states and inputs that were expected before the data.
    intercept : bool
        Whether there is an offset c.
    delta : float
        The probability of error of all regions of the stream together.
    first : int
        The number of pairs of the first planned look, see `ModelStream`.
    dt : float or None
        The time between two steps [s].
    state_names, input_names : tuple of str
        The names.
    runs : int
        The number of runs that the pairs came in: one begins where x is not the x_next before.
    """

    triangle: Annotated[Floats, "row row"]
    size: Size
    n: Count
    m: Count
    assumptions: Assumptions
    scale: Annotated[Floats, "column"]
    intercept: bool
    delta: Probability
    first: Count
    dt: Positive | None = None
    state_names: tuple[str, ...] = ()
    input_names: tuple[str, ...] = ()
    runs: int = 0

    def _check(self) -> None:
        d = len(self.scale)
        if d != self.n + self.m + self.intercept or len(self.triangle) != d + self.n:
            raise ShapeError("`triangle` and `scale` must be of the sizes of n, m and intercept")
        validation.size("runs", self.runs, minimum=0, maximum=self.size)
        checked_names(self.n, self.m, self.state_names, self.input_names)

    def _verify(self) -> None:
        refuse(self.assumptions)
        refuse_declared(self.assumptions, self.n, single=True)
        d = self.n + self.m
        if not np.array_equal(checked_scale(self.scale[:d], d, self.intercept), self.scale):
            raise InputError("`scale` must be positive, and 1 for an offset")
        R, size = self.triangle, self.size
        validation.size("runs", self.runs, minimum=min(size, 1), maximum=size)
        if np.tril(R, -1).any() or (np.diag(R) < 0.0).any():
            raise InputError("`triangle` must be upper triangular with a diagonal >= 0")
        ones = float(np.sum(R[:, len(self.scale) - 1] ** 2)) if self.intercept else float(size)
        if (size == 0 and R.any()) or abs(ones - size) > 1e-6 * size:
            raise InputError(f"`triangle` must be that of {size} pairs")

    @property
    def level(self) -> float:
        """What `region` and plans take without a probability of error."""
        return self.delta

    @cached_property
    def estimate(self) -> _core.Estimate:
        """The estimate of the core."""
        triangle = np.ascontiguousarray(self.triangle)
        return _core.Estimate(triangle, self.size, self.n, self.m, self.intercept)

    @cached_property
    def Theta(self) -> Floats:
        """``[A B c]``, read-only."""
        return validation.frozen(self.estimate.Theta)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to be careful about, one sentence each."""
        return (*self.doubts, *cautions(self.blocks, self.missing))

    @cached_property
    def doubts(self) -> tuple[str, ...]:
        """Why no certificate is finite: exact relations, and noise that is not as declared.

        Of the tests of `Model.doubts` those that need no pairs: a stream keeps their triangle. At
        each look they have a level of 5e-6.
        """
        tested = tested_rows(self.assumptions, None, self.n)
        exact = exact_relations(self.blocks[0], tested, self.state_names)
        return (*exact, *noise_doubts(self, tested))

    def region(
        self, delta: float | None = None, *, future: int = 0, frobenius: bool = False
    ) -> Region:
        """Return a set of models that contains the true one, in one event with all other looks.

        Parameters
        ----------
        delta : float, optional
            The probability that it does not at any look, at most that of the stream, which is the
            default.
        future : int, default 0
            Must be 0: regions of a stream cover no noise to come.
        frobenius : bool, default False
            Bound the Frobenius norm as well, by ``sqrt(min(n, rank))`` times the spectral one.

        Returns
        -------
        Region
            For any design that of ``Model.region(delta, anytime=True)``, which holds for all N at
            once. For an independent one the exact region, with ``delta / ((j + 1) (j + 2))`` at the
            planned look j = 0, 1, ...: all of them together have delta.

        Raises
        ------
        InputError, InputTypeError
            If `delta` is above that of the stream; or, for an independent design, the number of
            pairs is not a planned one; the message has the next one.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 50, 1))
        >>> stream = se.ModelStream(1, 1, noise=0.1)
        >>> stream.update(x, u, 0.5 * x + u + 0.1 * w)
        >>> stream.model.region().contains([[0.5]], [[1.0]])
        True
        """
        level = self.delta if delta is None else validation.probability("delta", delta)
        if level > self.delta:
            raise InputError(f"`delta` must be at most {self.delta:g} of all looks, got {level:g}")
        if validation.size("future", future, minimum=0):
            raise InputError("`future` must be 0: regions of a stream cover no noise to come")
        if self.next_look != self.size:
            raise InputError(
                f"a region needs a planned number of pairs with design='independent': there are "
                f"{self.size}, and the next look is at {self.next_look}"
            )
        text = f"{self.assumptions.text}, any design, valid for all N at once"
        if self._planned:
            text = f"{self.assumptions.text}, independent of all states and inputs, planned looks"
            j = look_after(self.first, self.size)
            level /= (j + 1.0) * (j + 2.0)
        wish = Wish(level, anytime=True)
        made = region_of(self.estimate, self.assumptions, wish, self.scale)
        region = of_core(made, self.assumptions, wish, self.m, text, self.missing)
        if validation.flag("frobenius", frobenius):
            # ||G||_F <= sqrt(min(n, rank)) ||G||: the same event
            wider = np.sqrt(made.parts[0].factor * min(self.n, self.rank))
            region = replace(region, frobenius=float(wider))
        return withheld(region, self.doubts)

    @property
    def _planned(self) -> bool:
        """Whether looks are at planned numbers of pairs only."""
        return self.assumptions.design == "independent"

    @property
    def next_look(self) -> int:
        """The number of pairs of the next possible look: `size` if it is possible now."""
        return self._size_after(self.size)

    def _after(self, size: float) -> Snapshot:
        """The model at a possible look at `size` pairs or more, if data go on like those so far."""
        later = self._size_after(size)
        triangle = validation.frozen(self.triangle * np.sqrt(later / self.size))
        made = replace(self, triangle=triangle, size=later)
        made.__dict__["doubts"] = self.doubts  # too few pairs for a residual are no exact relation
        return made

    def _size_after(self, size: float) -> int:
        """The first possible look at `size` pairs or more."""
        N = ceil(size)
        return planned(self.first, look_after(self.first, N)) if self._planned else N

    def __repr__(self) -> str:
        return self._text(f"n={self.n} m={self.m}")

    def _repr_html_(self) -> str:
        return show.card(self, [("assumed", self.assumptions.text)], self._table())


def refuse(assumed: Assumptions) -> None:
    """Refuse assumptions whose regions do not hold while data arrive."""
    if assumed.design == "independent" and assumed.noise != "gaussian":
        raise InputError(f"`design` must be 'adaptive' for noise='{assumed.noise}'")


def planned(first: int, j: int) -> int:
    """The number of pairs of look j = 0, 1, ...: ``ceil(first 2^(j/2))``, exactly."""
    return isqrt((first * first << j) - 1) + 1


def look_after(first: int, size: int) -> int:
    """The planned look j at `size` pairs, or else the next one."""
    j = 0
    while planned(first, j) < size:
        j += 1
    return j


class Look(Record):
    """Whether the data so far are enough to reach xf from x0. Made by `ModelStream.look`.

    Attributes
    ----------
    u : ndarray, shape (K, m)
        The control: the best one of the model, or the given one.
    certificate : Certificate
        How far the true system without noise can end from xf, as for `Plan.bound`. True for all
        looks at the stream together, however u was chosen and whenever the stream is stopped.
    tol : float
        The tolerance of `certificate.target`.
    forecast : float
        How many more pairs are expected until the target is within the tolerance, if data go on
        like those so far; inf: never, because the model itself ends too far from xf, or unknown,
        because the data so far do not determine what is needed. A forecast, not a bound.
    runs : float
        The same in runs of the mean length of those so far.
    size : int
        The number of pairs so far.
    missing : float
        By how much hard limits of states may be left, in the region of this look; 0 if they are
        kept. Else the data are not enough.
    """

    u: Annotated[Floats, "step input"]
    certificate: Certificate
    tol: Positive
    forecast: float
    runs: float
    size: Size
    missing: float = 0.0

    @property
    def stop(self) -> bool:
        """Whether the target is within the tolerance, in all limits: the data are enough."""
        return self.certificate.target <= self.tol and self.missing == 0.0

    def _more(self) -> str:
        """The forecast in words."""
        if isfinite(self.forecast):
            return more(self.forecast, self.runs)
        return "never" if isfinite(self.certificate.parts["model error"]) else "unknown"

    def __repr__(self) -> str:
        pairs = show.number_of(self.size, "pair")
        then = "enough" if self.stop else f"forecast: {self._more()}"
        then += show.warned(self.certificate.warnings)
        target = self.certificate.target
        return f"<Look: within {target:.4g} after {pairs}, tol {self.tol:g}, {then}>"


def more(pairs: float, runs: float) -> str:
    """A forecast in words."""
    also = "" if runs == pairs else f", {runs:.3g} run{'s' * (runs != 1)} like those so far"
    return f"about {pairs:.4g} more pairs{also}"


FAR = 30  # a power of 2; laws of more pairs are slow to compute
SMALL = 1e-300


def look(model: Snapshot | Model, tol: float, u: Floats | None, task: dict[str, Any]) -> Look:
    """Control by the model, or the given u; its certificate, and the forecast.

    `task` has the arguments of `control` after the model.
    """
    for said in model.doubts:
        running.warn(f"the certificate is infinite: {said}")
    missing, again = 0.0, False
    if u is None:
        plan = control(model, **task)
        u, basis, found = plan.u, plan.basis, plan.bound(model.level, noise=False)
        if plan.limited is not None:
            missing, hard = plan.limited.missing, plan.limited.task
            again = hard.state_low is not None and hard.soft is None
    else:
        basis = trusted(ModelBasis, model, task["x0"], task["xf"])
        found = _bound(basis, u)
    assert isinstance(basis, ModelBasis)
    if model.doubts or not model.size:
        forecast = inf
    elif again and isinstance(model, Snapshot):
        # the best control of the model itself, once its regions are small, is the end of the way
        end = control(model._after(2.0**FAR), **task)
        assert end.limited is not None
        parts = end.bound(model.delta).parts

        def error(later: Any) -> float:
            plan = control(later, **task)
            lacks = plan.limited is None or plan.limited.missing > 0.0
            return inf if lacks else plan.bound(model.level).target - parts["reach"]

        room = -inf if end.limited.missing else tol - parts["reach"]
        now = inf if missing else found.target - parts["reach"]
        forecast = _forecast(model, room, now, error)
    else:
        fixed, parts = u, found.parts

        def error(later: Any) -> float:
            return _bound(replace(basis, model=later), fixed).parts["model error"]

        forecast = _forecast(model, tol - parts["reach"], parts["model error"], error)
    runs = _in_runs(model, forecast)
    return trusted(Look, validation.frozen(u), found, tol, forecast, runs, model.size, missing)


def _in_runs(model: Snapshot | Model, pairs: float) -> float:
    """So many pairs in runs of the mean length of those so far; logs of outputs come as a whole."""
    if isinstance(model, Model):
        return float(np.ceil(pairs * len(model.data) / model.size))
    return pairs * model.runs / model.size if model.size else pairs


def _next_look(model: Snapshot | Model, size: float) -> int:
    """The first possible look at `size` pairs or more."""
    return ceil(size) if isinstance(model, Model) else model._size_after(size)


def _bound(basis: ModelBasis, u: Floats) -> Certificate:
    """The certificate of a control of the model."""
    model = basis.model
    if isinstance(model, Model):
        return output_certificate(basis, u, model.level, False)
    predicted = trajectory(model.Theta, basis.x0, u)
    return certificate(Question(basis, u, predicted, model.level))


def _forecast(
    model: Snapshot | Model, room: float, now: float, error_of: Callable[[Any], float]
) -> float:
    """How many more pairs until the error is at most `room`; `now` it is at this."""
    error = now
    if error <= room:
        return 0.0
    if room <= 0.0 or (model.missing and not isfinite(error)):
        return inf
    # the error is above `room` at 2^low and not at 2^high; at powers of 2, all looks share the
    # quantiles for these numbers of pairs, which are kept
    low, high = floor(log2(model.size)), FAR + 1
    above = size, error = float(model.size), error
    while high - low > 1:
        # next to where ``error ~ N^(-1/2)`` would be `room`
        more = 2.0 * (log2(max(error, SMALL)) - log2(room)) if isfinite(error) else 0.0
        power = min(max(ceil(log2(size) + more), low + 1), high - 1)
        pairs = _next_look(model, 2.0**power)
        later: Any = after(model, pairs) if isinstance(model, Model) else model._after(pairs)
        size, error = float(pairs), error_of(later)
        if error > room:
            low, above = power, (size, error)
        else:
            high, below = power, (size, error)
    size, error = above
    if high > FAR:  # far away, the error falls as N^(-1/2)
        size *= (error / room) * (error / room)  # inf where it overflows
    elif isfinite(error) and below[1] > 0.0:  # as a power of N in between
        share = np.log(error / room) / np.log(error / below[1])
        size = float(_next_look(model, size * (below[0] / size) ** share))
    else:
        size = below[0]
    return max(size - model.size, 1.0)


class LoopLook(Record):
    """Whether the data so far certify a feedback. Made by `ModelStream.look`.

    Attributes
    ----------
    proof : LoopCertificate
        What is proved of the gain for the region of this look. True for all looks at the stream
        together, however the gain was chosen and whenever the stream is stopped.
    forecast : float
        How many more pairs are expected until it is certified, if data go on like those so far;
        inf where the data do not determine the loop, or its centre is unstable. No bound.
    runs : float
        The same in runs, as in `Look`.
    size : int
        The number of pairs so far.
    """

    proof: LoopCertificate
    forecast: float
    runs: float
    size: Size

    @property
    def stop(self) -> bool:
        """Whether the loop is certified: the data are enough."""
        return self.proof.status == "certified"

    def __repr__(self) -> str:
        pairs = show.number_of(self.size, "pair")
        if self.stop:
            margin = show.margin(self.proof.margin)
            return f"<LoopLook: certified after {pairs}, margin at least {margin}>"
        then = more(self.forecast, self.runs) if isfinite(self.forecast) else "unknown"
        return f"<LoopLook: {self.proof.status} after {pairs}, forecast: {then}>"


def look_at_loop(model: Snapshot | Model, gain: Loop | ArrayLike) -> LoopLook:
    """Judge a gain for the region of this look; the forecast asks for the regions of more pairs."""
    n, m = model.n, model.m
    K = gain.K if isinstance(gain, Loop) else validation.matrix("gain", gain, rows=m, cols=n)
    if K.shape != (m, n):
        raise InputError(f"`gain` must be of shape ({m}, {n}), got {K.shape}")
    own = validation.frozen(np.array(K))
    proof = judged(in_states(model, model.region(model.level)), own, model.labels, model)
    needed = 0.0
    if proof.status != "certified":

        def error(later: Snapshot | Model) -> float:
            region = in_states(later, later.region(model.level))
            return judged(region, own, model.labels, None).least

        stable = not model.doubts and proof.spectral_radius < 1.0
        needed = _forecast(model, 1.0, proof.least, error) if stable else inf
    forecast = float(max(needed, 0.0))
    return trusted(LoopLook, proof, forecast, _in_runs(model, forecast), model.size)
