"""What a learned bias says of a loop at rest: a constant that acts, or a sensor that is wrong."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base import show
from .._base.types import DELTA
from ..exceptions import StochensError
from ..identification.model import Model, asked_region
from ..identification.region import Wish

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..identification.region import Region

FALSE_ALARM = 1e-4
DOUBLINGS = 40  # of the steps after which what was learned is as good as settled
FAR = 2.0  # ranges of the logs, outside of which a reading is far
INTEGRATES = 1e-3  # of a deviation leaves in a step: no slower mode is told from an integrator
SPLITS = np.logspace(-3.0, 3.0, 25)  # of a sum of two ellipsoids


def bounded(model: Model) -> tuple[Region, Floats] | None:
    """The region of a model, also of one in doubt, and its noise; None where that has no bound."""
    if model.noise != "gaussian":
        return None
    try:
        own = model.assumptions.known is None and model.assumptions.tail == 0.0
        wish = Wish(min(DELTA, model.level), method="mixture" if own else "auto")
        region = asked_region(model, wish)
    except StochensError:
        return None
    if region.noise is None or len(region.noise) != model.n_outputs:
        return None
    return region, np.ascontiguousarray(region.noise)


def at_rest_of(model: Model) -> tuple[Floats, Floats]:
    """``[N_y N_u]``: outputs and inputs in the window at rest; ``[I - H N_y, H N_u]``."""
    H, own, p, m = model.coefficients, model.regressors, model.n_outputs, model.m
    found = np.zeros((own.length, p + m))
    found[: own.count * p, :p] = np.tile(np.eye(p), (own.count, 1))
    found[own.count * p : own.count * (p + m), p:] = np.tile(np.eye(m), (own.count, 1))
    return found, np.hstack([np.eye(p) - H @ found[:, :p], H @ found[:, p:]])


class Range:
    """The outputs of the logs of a model, and whether readings are far outside of them."""

    def __init__(self, model: Model) -> None:
        y, p = model.data.pairs()[0], model.n_outputs
        self.low, self.high, self.names = y.min(axis=0), y.max(axis=0), model.outputs
        self.width = np.maximum(self.high - self.low, np.finfo(float).tiny)
        # modes that integrate move all outputs along these, in ranges: they may go anywhere
        leaves = at_rest_of(model)[1][:, :p] * self.width / self.width[:, None]
        _, sizes, rows = np.linalg.svd(leaves)
        self.free = rows[sizes <= INTEGRATES]

    def outside(self, y: Floats) -> str | None:
        """The reading that is furthest outside; nan where it was not read."""
        off = np.nan_to_num((y - 0.5 * (self.low + self.high)) / self.width)
        off -= self.free.T @ (self.free @ off)
        i = int(np.abs(off).argmax())
        if abs(off[i]) <= FAR + 0.5:
            return None
        return (
            f"{self.names[i]} = {y[i]:.4g} is far outside of the logs, which had "
            f"{self.low[i]:.4g} to {self.high[i]:.4g}"
        )


def explained(
    model: Model, bias: Floats, L: Floats, y: Floats, u: Floats, calls: int = 1
) -> str | None:
    """What explains a bias at rest at (y, u), the mean of so many calls, learned with L.

    It is ``e = (Theta - H) z + b d + M s + n`` for constants d at the inputs and s of the sensors,
    ``b = H N_u``, ``M = I - H N_y``, z at rest ``N_y y + N_u u + N_1``. An explanation is refuted
    where what it leaves is outside of the sum of the ellipsoids of n and of ``(Theta - H) z``.
    """
    if (found := bounded(model)) is None:
        return None
    (region, noise), (at_rest, effects) = found, at_rest_of(model)
    p, m = model.n_outputs, model.m
    z = at_rest @ np.hstack([y, u])
    z[model.regressors.count * (p + m) :] = 1.0
    moves = at_rest * np.where(np.arange(p + m) < p, -1.0, 1.0)  # of the true z
    settled = _settled(L, noise, calls)
    gate = _core.Gate.of(region.core, settled, FALSE_ALARM)
    if gate is None:
        return None
    white = np.linalg.inv(np.linalg.cholesky(settled))
    seen = [True] * p
    near = settled * (np.linalg.norm(white @ bias) / gate.excess(bias, 0.0 * z, seen)) ** 2

    def misfit(z: Floats) -> Floats:
        far = np.zeros((p, p))
        for part in region.parts:
            at = np.ix_(part.rows, part.rows)
            far[at] += len(region.parts) * part.factor * part.S * part.length(z) ** 2
        return far

    def fitted(which: list[int]) -> Floats | None:
        """The sizes of these causes; None if they are refuted."""
        solved = np.linalg.lstsq(white @ effects[:, which], white @ bias, rcond=1e-9)
        size: Floats = np.asarray(solved[0], dtype=np.float64)
        for far in map(misfit, (z, z + moves[:, which] @ size)):
            if not np.isfinite(far).all():
                return size
            least = 0.0
            for t in SPLITS:  # any ellipsoid around the sum refutes
                T = np.linalg.inv(np.linalg.cholesky((1.0 + 1.0 / t) * near + (1.0 + t) * far))
                best = np.linalg.lstsq(T @ effects[:, which], T @ bias, rcond=1e-9)[0]
                least = max(least, float(np.linalg.norm(T @ (bias - effects[:, which] @ best))))
            if least <= 1.0:
                return size
        return None

    if not bias.any() or fitted([]) is not None:
        return None
    inputs, causes = list(range(p, p + m)), []
    acting = fitted(inputs)
    if acting is not None:
        pairs = zip(acting, model.input_names, strict=True)
        causes = [f"a constant acts, as {show.listed([f'{v:.3g} at {name}' for v, name in pairs])}"]
    elif m + 1 >= p:  # any bias is explained by a sensor and constants at the inputs
        causes = [f"a load acts elsewhere than at {show.listed(list(model.input_names))}"]
    beside = [] if acting is not None else inputs
    for i in range(p):
        size = fitted([i, *beside])
        if size is not None:
            much = f"{abs(size[0]):.3g} {'more' if size[0] > 0.0 else 'less'}"
            others = "the others say" if p > 1 else "the model says"
            causes.append(f"{model.outputs[i]} reads {much} than {others}")
    if not causes:
        pairs_of = itertools.combinations(range(p), 2)
        two = any(fitted([*pair, *beside]) is not None for pair in pairs_of)
        return (
            "no constant at the inputs and no single sensor explains what was learned at rest: a "
            f"load acts elsewhere, or {'two sensors are wrong, or ' * two}the plant is not the "
            "model: undecided which"
        )
    text = ", or ".join(causes)
    return text if len(causes) == 1 else f"{text}: undecided which"


def _settled(L: Floats, noise: Floats, calls: int) -> Floats:
    """The covariance of the mean over so many calls of ``e+ = e + L (w - e)``, long after."""
    keeps = np.eye(len(L)) - L
    one, power = L @ noise @ L.T, keeps
    for _ in range(DOUBLINGS):
        one, power = one + power @ one @ power.T, power @ power
    mean, power = one / calls, np.eye(len(L))
    for k in range(1, calls):
        power = keeps @ power
        later = power @ one
        mean = mean + (calls - k) / calls**2 * (later + later.T)
    return np.ascontiguousarray(0.5 * (mean + mean.T))
