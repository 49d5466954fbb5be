"""What a loop knows of its window of readings, and which readings it takes for true."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .. import _core
from .._base import show
from .._base.types import DELTA
from ..exceptions import StochensError
from ..identification.region import Wish

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .._base.types import Floats
    from ..identification.model import Model
    from ..identification.region import Region


FALSE_ALARM = 1e-5  # of a call: the probability that a true reading is rejected


class Gate:
    """A reading y is rejected if it is too far from what was predicted, p, for every system.

    ``||T (y - p)|| > q + ||T D|| ||W z||`` with ``T = (Sb + P)^-1/2``, q^2 the upper 1e-5 of chi2:
    ``y - C z = D G W z + w`` with ``||G|| <= 1`` for all systems of the region, and ``||T w|| <=
    ||Sigma^-1/2 w||`` as ``Sb >= Sigma``. So a true reading behind a window of true ones is
    rejected with at most 1e-5 in the event of the region, whatever was planned; P is what an
    uncertain window adds. With a disturbance learned before, y must be too far with it and without.
    """

    def __init__(self, region: Region) -> None:
        self.centre: Floats = np.array(region.centre)
        self._noise: Floats = np.array(region.noise)  # Sb (p, p)
        self._parts = [(part, part.columns) for part in region.parts]
        self._shapes = np.zeros((len(region.parts), *self._noise.shape))  # D D' of each part
        for shape, part in zip(self._shapes, region.parts, strict=True):
            shape[np.ix_(part.rows, part.rows)] = part.S * part.factor
        self._usual = _white(self._noise, self._shapes)  # of all readings behind a known window

    def excess(self, off: Floats, z: Floats, seen: NDArray[np.bool_], more: Floats | None) -> float:
        """``(||T off|| - ||T D|| ||W z||) / q`` of the components `seen`; above 1 it rejects."""
        T, sizes, quantile = self._usual
        if more is not None or not seen.all():
            at = np.ix_(seen, seen)
            noise = self._noise if more is None else self._noise + more
            T, sizes, quantile = _white(noise[at], self._shapes[:, seen][:, :, seen])
            off = off[seen]
        far = math.sqrt(np.square(T @ off).sum())
        for (part, columns), size in zip(self._parts, sizes, strict=True):
            far -= size * part.length(z[columns])
        return far / quantile


def _white(noise: Floats, shapes: Floats) -> tuple[Floats, list[float], float]:
    """T, ``||T D||`` of each part, and the quantile."""
    T: Floats = np.linalg.inv(np.linalg.cholesky(noise))
    sizes = [math.sqrt(np.linalg.eigvalsh(T @ shape @ T.T)[-1]) for shape in shapes]
    return T, sizes, _quantile(len(noise), FALSE_ALARM)


@cache
def _quantile(size: int, delta: float) -> float:
    return _core.normal_quantile(np.eye(size), delta)


def gate_of(model: Model) -> Gate | None:
    """The gate of a model, also of one in doubt; None where no bound of its noise is known."""
    if model.noise != "gaussian":
        return None
    try:
        own = model.assumptions.known is None and model.assumptions.tail == 0.0
        region = model._region(Wish(DELTA, method="mixture" if own else "auto"))
    except StochensError:
        return None
    if region.noise is None or not np.isfinite(region.radius):
        return None
    noise = np.asarray(region.noise)
    good = len(noise) == model.n_outputs and np.isfinite(noise).all()
    return Gate(region) if good and np.linalg.eigvalsh(noise)[0] > 0.0 else None


UNSURE = 9.0  # most of the variance of the next readings that an uncertain window may add, to run
PATIENCE = 4  # windows behind which a loop says that as many more at the same pace will not do


class Contents(NamedTuple):
    """The window after a call."""

    x: Floats
    P: Floats | None  # covariance of its error; None: all readings and inputs in it are true
    excess: float  # what P adds to the variance of the next readings, in units of the noise
    since: int  # complete readings in a row
    missed: int  # calls in a row in which no reading came
    calls: int
    read: NDArray[np.int64]  # how many readings of each output came
    mark: float  # the excess a window before
    first: int  # the call from which it may start
    stuck: bool = False

    def tells(self, started: bool) -> bool:
        """Whether the loop may run: full, or long enough and sure enough."""
        return self.P is None or (self.excess <= UNSURE and (started or self.calls >= self.first))


class ReadingWindow:
    """How the window goes on: a Kalman filter, for which a reading that came has no error.

    ``x+ = A_s x + G y + ..`` with ``y = C x + .. + w``: given those y that came the error of (x, y)
    has a smaller covariance, in which they are 0; ``(A_s, G)`` takes it one step on. Begun at the
    first reading, with the range and the deviation of each signal as its error. Where all readings
    came and nothing was missing before, it is the window of the model itself.
    """

    def __init__(self, model: Model) -> None:
        window, p, (J, ABc, G) = model.window, model.n_outputs, model._loop
        assert window is not None
        n = len(ABc)
        self._core, self._fill, self._names = window.core, window.fill, model.outputs
        self._tail = np.ones(int(model.intercept))
        self._C = (model._H @ J)[:, :n]
        self._step = np.hstack([window.loop(0.0 * model._H).ABc[:, :n], G])
        y, u, _ = model.data.pairs()
        self._mean = y.mean(axis=0)
        wide = [one.std(axis=0) + np.ptp(one, axis=0) for one in (y, u)]
        past = window.count * p
        self._apart = np.hstack(
            [np.tile(wide[0], window.count), np.tile(wide[1], (n - past) // model.m)]
        )
        self._newest = p if window.pole is None else 0  # entries that are readings
        noise = model.covariance
        self._noise: Floats = np.diag(1e-6 * wide[0] ** 2) if noise is None else np.array(noise)
        self._noise += 1e-12 * np.diag(wide[0] ** 2 + np.diag(self._noise))
        self._seen_by = np.linalg.inv(np.linalg.cholesky(self._noise)) @ self._C

    def entering(self, now: Contents, acted: Floats) -> Floats:
        """``(x; u; 1)``."""
        return np.concatenate([now.x, acted, self._tail])

    def unknown(self, now: Contents) -> Floats | None:
        """What an uncertain window adds to the covariance of the next readings."""
        return None if now.P is None else self._C @ now.P @ self._C.T

    def full(self, x: Floats) -> Contents:
        """A window that is known."""
        read = np.full(len(self._names), self._fill + 1)
        return Contents(x, None, 0.0, self._fill + 1, 0, self._fill + 1, read, 0.0, 0)

    def begun(self, y: Floats, acted: Floats, seen: NDArray[np.bool_]) -> Contents:
        """The window at a first reading: all before it is taken to be the same."""
        rows = np.tile(np.where(seen, y, self._mean), (self._fill + 1, 1))
        x = self._core.state_of(rows, np.tile(acted, (self._fill, 1)))
        apart = self._apart.copy()
        apart[: self._newest][seen[: self._newest]] = 0.0
        start = Contents(x, None, 0.0, 0, 0, 0, 0 * seen.astype(np.int64), np.inf, self._fill + 1)
        return self._counted(start, x, np.diag(apart**2), seen)

    def advanced(
        self,
        now: Contents,
        y: Floats,
        acted: Floats,
        seen: NDArray[np.bool_],
        predicted: Floats,
    ) -> Contents:
        """The window one step later, with the readings that came and estimates of the others."""
        x, P, n = now.x, now.P, len(now.x)
        if P is None and len(seen) == np.count_nonzero(seen):
            return self._counted(now, self._core.advance(x, y, acted), None, seen)
        P = np.zeros((n, n)) if P is None else P
        CP, step = self._C @ P, self._step
        M = CP @ self._C.T + self._noise
        if seen.all():
            gain = np.linalg.solve(M, CP).T
            joint, step, off = P - gain @ CP, step[:, :n], gain @ (y - predicted)
            filled = y
        else:
            joint, came = np.block([[P, CP.T], [CP, M]]), n + np.flatnonzero(seen)
            off = np.zeros(len(joint))
            if len(came):
                gain = np.linalg.solve(joint[np.ix_(came, came)], joint[came]).T
                off = gain @ (y - predicted)[seen]
                joint -= gain @ joint[came]
                joint[came] = joint[:, came] = 0.0
            filled = np.where(seen, y, predicted + off[n:])
        after = step @ joint @ step.T
        x = self._core.advance(x + off[:n], filled, acted)
        return self._counted(now, x, (after + after.T) / 2.0, seen)

    def _counted(
        self, now: Contents, x: Floats, P: Floats | None, seen: NDArray[np.bool_]
    ) -> Contents:
        came, calls = np.count_nonzero(seen) == len(seen), now.calls + 1
        mark, stuck = now.mark, now.stuck
        since = now.since + 1 if came else 0
        P, excess = (None if since > self._fill else P), 0.0
        if P is not None:
            added = self._seen_by @ P @ self._seen_by.T
            excess = float(np.linalg.eigvalsh(added)[-1]) if np.isfinite(added).all() else np.inf
        if calls % (self._fill + 1) == 0:
            then = excess * (excess / mark) ** PATIENCE if excess < mark else excess
            stuck = calls >= PATIENCE * (self._fill + 1) and not then <= UNSURE
            mark = excess
        missed = 0 if seen.any() else now.missed + 1
        return Contents(x, P, excess, since, missed, calls, now.read + seen, mark, now.first, stuck)

    def lacks(self, now: Contents) -> str:
        """What the loop waits for."""
        known = (
            f"the next readings are known to {np.sqrt(now.excess):.3g} deviations of their noise"
        )
        if now.stuck:
            i = int(np.argmin(now.read))
            return f"of {self._names[i]} {now.read[i]} of {now.calls} were read: {known}, must be 3"
        left = max(1, self._fill + 1 - now.since)
        return f"{known}: 3 will do, or {show.number_of(left, 'complete reading')} in a row"
