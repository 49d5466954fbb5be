"""`Look`: the control by a model of a stream, its certificate, and whether the data are enough.

The certificate is that of the region for the noise-free run: with the model's states xh(k),
``||x(K) - xf|| <= ||xh(K) - xf|| + r_K`` for all inputs at once, in the event of the region.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from math import ceil, floor, inf, isfinite, log2
from typing import TYPE_CHECKING

import numpy as np

from .._base import html, validation
from .._base.numbers import norm
from .._base.records import Record
from ..exceptions import DataWarning
from ..theory.dynamics import matrix_powers
from ..theory.exact import best_control

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..identification.region import Region
    from .snapshot import Snapshot


@dataclass(frozen=True, eq=False, repr=False)
class Look(Record):
    """What the data so far say about reaching xf from x0. Made by `ModelStream.look`.

    Attributes
    ----------
    u : ndarray, shape (K, m)
        The control: the best one of the model, or the given one.
    certificate : float
        The true system without noise ends at most so far from xf: `reach` + `model_error`. True
        with probability 1 - `delta` for all looks at the stream together, however u was chosen and
        whenever the stream is stopped.
    reach : float
        How far the model ends from xf.
    model_error : float
        How far the true system may end from where the model does.
    tol : float
        The tolerance.
    forecast : float
        How many more pairs are expected until the certificate is within the tolerance, if data go
        on like those so far; inf: never, because the model itself ends too far from xf, or unknown,
        because the data so far do not determine what is needed. A forecast, not a bound.
    size : int
        The number of pairs so far.
    delta : float
        The probability that any certificate of the stream is wrong, at most.
    assumption : str
        What the certificate rests on.
    doubts : tuple of str
        Why `certificate` is infinite however many pairs there are: columns that are no states of a
        plant, unless they are declared as `exact`.
    """

    u: Floats
    certificate: float
    reach: float
    model_error: float
    tol: float
    forecast: float
    size: int
    delta: float
    assumption: str
    doubts: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        validation.kept("u", self.u, ndim=(2,))
        validation.positive("tol", self.tol)
        validation.size("size", self.size, minimum=0)
        validation.probability("delta", self.delta)

    @property
    def stop(self) -> bool:
        """Whether the certificate is within the tolerance: the data are enough."""
        return self.certificate <= self.tol

    def _more(self) -> str:
        """The forecast in words."""
        if isfinite(self.forecast):
            return f"about {self.forecast:.4g} more pairs"
        return "never" if isfinite(self.model_error) else "unknown"

    def __repr__(self) -> str:
        pairs = html.number_of(self.size, "pair")
        then = "enough" if self.stop else f"forecast: {self._more()}"
        then += html.warned(self.doubts)
        return f"<Look: within {self.certificate:.4g} after {pairs}, tol {self.tol:g}, {then}>"

    def _repr_html_(self) -> str:
        rows = [
            (
                "certificate",
                f"{self.certificate:.4g}, with {100 * (1 - self.delta):.6g} % at least",
            ),
            ("the model ends", f"{self.reach:.4g} from xf"),
            ("the system", f"{self.model_error:.4g} from there at most, without noise"),
            ("for", self.assumption),
            *(("nothing is certified", text) for text in self.doubts),
            ("forecast", None if self.stop else self._more()),
            ("control u", html.vector(self.u.ravel())),
        ]
        return html.card(self, rows)


FAR = 30  # a power of 2; laws of more pairs are slow to compute
SMALL = 1e-300


def look(model: Snapshot, x0: Floats, xf: Floats, u: Floats | None, steps: int, tol: float) -> Look:
    """Control by the model, or the given u; its certificate, and the forecast."""
    region = model.region()
    for said in model.doubts:
        warnings.warn(DataWarning(f"the certificate is infinite: {said}"), stacklevel=3)
    if u is None:
        A, goal = model.A, xf
        if model.c is not None:  # x(K) = A^K x0 + C_K u + sum_{k<K} A^k c
            goal = xf - matrix_powers(A, steps)[:-1].sum(axis=0) @ model.c
        u = best_control(A, model.B, x0, goal, steps).u.reshape(steps, model.m)
    end, error = _ends(region, x0, u)
    if model.doubts:
        error = inf
    reach = norm(end - xf)
    return Look(
        u=validation.frozen(u),
        certificate=reach + error,
        reach=reach,
        model_error=error,
        tol=tol,
        forecast=inf if model.doubts else _forecast(model, x0, u, reach, error, tol),
        size=model.size,
        delta=model.delta,
        assumption=region.assumption,
        doubts=model.doubts,
    )


def _ends(region: Region, x0: Floats, u: Floats) -> tuple[Floats, float]:
    """Where the model ends, and how far the true system may be from there."""
    found = region._core.errors(x0, u, 0.0, None)
    return found.states[-1], float(found.radii[-1])


def _forecast(
    model: Snapshot, x0: Floats, u: Floats, reach: float, error: float, tol: float
) -> float:
    """How many more pairs until ``error(N) <= tol - reach``, with the same u and V, S ~ N."""
    room = tol - reach
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
        at_later = model._region(model.delta, size=later)
        size, error = float(later), _ends(at_later, x0, u)[1]
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
