"""`Look`: the control by a model of a stream, its certificate, and whether the data are enough."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from math import ceil, floor, inf, isfinite, log2
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import show, validation
from .._base.records import Record, trusted
from .._base.types import Floats
from ..certificates.certificate import Certificate
from ..certificates.of_model import Asked, ModelBasis, certificate, trajectory
from ..controls.control import control
from ..exceptions import DataWarning, InputError
from ..feedback import Loop, LoopCertificate
from .snapshot import Snapshot

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

    from .snapshot import Snapshot


@dataclass(frozen=True, eq=False, repr=False)
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

    u: Floats
    certificate: Certificate
    tol: float
    forecast: float
    runs: float
    size: int
    missing: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        validation.kept("u", self.u, ndim=(2,))
        validation.positive("tol", self.tol)
        validation.size("size", self.size, minimum=0)

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

    def _repr_html_(self) -> str:
        rows = [
            ("forecast", None if self.stop else self._more()),
            ("control u", show.vector(self.u.ravel())),
        ]
        return show.card(self, rows, self.certificate._repr_html_())


def more(pairs: float, runs: float) -> str:
    """A forecast in words."""
    also = "" if runs == pairs else f", {runs:.3g} runs like those so far"
    return f"about {pairs:.4g} more pairs{also}"


FAR = 30  # a power of 2; laws of more pairs are slow to compute
SMALL = 1e-300


def look(model: Snapshot, tol: float, u: Floats | None, task: dict[str, Any]) -> Look:
    """Control by the model, or the given u; its certificate, and the forecast.

    `task` has the arguments of `control` after the model.
    """
    for said in model.doubts:
        warnings.warn(DataWarning(f"the certificate is infinite: {said}"), stacklevel=3)
    missing, again = 0.0, False
    if u is None:
        plan = control(model, **task)
        u, basis, found = plan.u, plan.basis, plan.bound(model.delta)
        if plan.limited is not None:
            missing, hard = plan.limited.missing, plan.limited.task
            again = hard.state_low is not None and hard.soft is None
    else:
        basis = trusted(ModelBasis, model, task["x0"], task["xf"])
        found = _bound(basis, u)
    assert isinstance(basis, ModelBasis)
    if model.doubts or not model.size:
        forecast = inf
    elif again:
        # the best control of the model itself, once its regions are small, is the end of the way
        end = control(model._after(2.0**FAR), **task)
        assert end.limited is not None
        parts = end.bound(model.delta).parts

        def error(later: Snapshot) -> float:
            plan = control(later, **task)
            lacks = plan.limited is None or plan.limited.missing > 0.0
            return inf if lacks else plan.bound(model.delta).target - parts["reach"]

        room = -inf if end.limited.missing else tol - parts["reach"]
        now = inf if missing else found.target - parts["reach"]
        forecast = _forecast(model, room, now, error)
    else:
        fixed, parts = u, found.parts

        def error(later: Snapshot) -> float:
            return _bound(replace(basis, model=later), fixed).parts["model error"]

        forecast = _forecast(model, tol - parts["reach"], parts["model error"], error)
    runs = model._in_runs(forecast)
    return trusted(Look, validation.frozen(u), found, tol, forecast, runs, model.size, missing)


def _bound(basis: ModelBasis, u: Floats) -> Certificate:
    """The certificate of a control of the model."""
    model = basis.model
    assert isinstance(model, Snapshot)
    predicted = trajectory(model._Theta, basis.x0, u)
    return certificate(basis, u, predicted, model.delta, Asked(noise=False))


def _forecast(
    model: Snapshot, room: float, now: float, error_of: Callable[[Snapshot], float]
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
        later = model._after(2.0**power)
        size, error = float(later.size), error_of(later)
        if error > room:
            low, above = power, (size, error)
        else:
            high, below = power, (size, error)
    size, error = above
    if high > FAR:  # far away, the error falls as N^(-1/2)
        size *= (error / room) * (error / room)  # inf where it overflows
    elif isfinite(error) and below[1] > 0.0:  # as a power of N in between
        share = np.log(error / room) / np.log(error / below[1])
        size = float(model._size_after(size * (below[0] / size) ** share))
    else:
        size = below[0]
    return max(size - model.size, 1.0)


@dataclass(frozen=True, eq=False, repr=False)
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
    size: int

    def __post_init__(self) -> None:
        super().__post_init__()
        validation.size("size", self.size, minimum=0)

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

    def _repr_html_(self) -> str:
        return show.card(self, [], self.proof._repr_html_())


def look_at_loop(model: Snapshot, gain: Loop | ArrayLike) -> LoopLook:
    """Judge a gain for the region of this look; ``rho g`` falls as N^(-1/2)."""
    n, m = model.n, model.m
    K = gain.K if isinstance(gain, Loop) else validation.matrix("gain", gain, rows=m, cols=n)
    if K.shape != (m, n):
        raise InputError(f"`gain` must be of shape ({m}, {n}), got {K.shape}")
    own = validation.frozen(np.array(K))
    proof = LoopCertificate._judged(model.region(), own, model.labels, model)
    needed = 0.0
    if proof.status != "certified":
        stable = not model.doubts and isfinite(proof.least)
        needed = model._size_after(model.size * proof.least**2) - model.size if stable else inf
    forecast = float(max(needed, 0.0))
    return trusted(LoopLook, proof, forecast, model._in_runs(forecast), model.size)
