"""`Gate`: which readings a loop takes for true."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base.types import DELTA
from ..exceptions import StochensError
from ..identification.certifying import Wish

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
