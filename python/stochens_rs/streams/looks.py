"""`Look`: the control by a model of a stream, its certificate, and whether the data are enough."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from math import ceil, floor, inf, isfinite, log2
from typing import TYPE_CHECKING

import numpy as np

from .._base import html, validation
from .._base.records import Record, trusted
from .._base.types import Floats
from ..certificates.certificate import Certificate
from ..certificates.model_basis import ModelBasis
from ..certificates.of_model import Asked, certificate
from ..certificates.region_errors import trajectory
from ..exceptions import DataWarning
from ..theory.exact import best_control

if TYPE_CHECKING:
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
    size : int
        The number of pairs so far.
    """

    u: Floats
    certificate: Certificate
    tol: float
    forecast: float
    size: int

    def __post_init__(self) -> None:
        super().__post_init__()
        validation.kept("u", self.u, ndim=(2,))
        validation.positive("tol", self.tol)
        validation.size("size", self.size, minimum=0)

    @property
    def stop(self) -> bool:
        """Whether the target is within the tolerance: the data are enough."""
        return self.certificate.target <= self.tol

    def _more(self) -> str:
        """The forecast in words."""
        if isfinite(self.forecast):
            return f"about {self.forecast:.4g} more pairs"
        return "never" if isfinite(self.certificate.parts["model error"]) else "unknown"

    def __repr__(self) -> str:
        pairs = html.number_of(self.size, "pair")
        then = "enough" if self.stop else f"forecast: {self._more()}"
        then += html.warned(self.certificate.warnings)
        target = self.certificate.target
        return f"<Look: within {target:.4g} after {pairs}, tol {self.tol:g}, {then}>"

    def _repr_html_(self) -> str:
        rows = [
            ("forecast", None if self.stop else self._more()),
            ("control u", html.vector(self.u.ravel())),
        ]
        return html.card(self, rows, self.certificate._repr_html_())


FAR = 30  # a power of 2; laws of more pairs are slow to compute
SMALL = 1e-300


def look(model: Snapshot, x0: Floats, xf: Floats, u: Floats | None, steps: int, tol: float) -> Look:
    """Control by the model, or the given u; its certificate, and the forecast."""
    for said in model.doubts:
        warnings.warn(DataWarning(f"the certificate is infinite: {said}"), stacklevel=3)
    if u is None:
        # x(K) = A^K x0 + C_K u + sum_{k<K} A^k c
        drift = trajectory(model._Theta, np.zeros(model.n), np.zeros((steps, model.m)))[-1]
        u = best_control(model.A, model.B, x0, xf - drift, steps).u.reshape(steps, model.m)
    basis, predicted = trusted(ModelBasis, model, x0, xf), trajectory(model._Theta, x0, u)
    found = certificate(basis, u, predicted, model.delta, Asked(False, False, False))
    forecast = inf if model.doubts else _forecast(model, x0, u, found.parts, tol)
    return trusted(Look, validation.frozen(u), found, tol, forecast, model.size)


def _forecast(model: Snapshot, x0: Floats, u: Floats, parts: dict[str, float], tol: float) -> float:
    """How many more pairs until ``error(N) <= tol - reach``, with the same u and V, S ~ N."""
    room, error = tol - parts["reach"], parts["model error"]
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
        later = model._size_after(2.0**power)
        region = model._region(model.delta, frobenius=len(u) > 1, size=later)
        size, error = float(later), float(region._core.errors(x0, u, 0.0, None).radii[-1])
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
