"""What a learned bias says of a loop at rest: a constant that acts, or a sensor that is wrong."""

from __future__ import annotations

from itertools import combinations
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


def bounded(model: Model) -> Region | None:
    """The region of a model, also of one in doubt; None where no bound of its noise is known."""
    if model.noise != "gaussian":
        return None
    try:
        own = model.assumptions.known is None and model.assumptions.tail == 0.0
        wish = Wish(min(DELTA, model.level), method="mixture" if own else "auto")
        region = asked_region(model, wish)
    except StochensError:
        return None
    known = region.noise is not None and len(region.noise) == model.n_outputs
    return region if known else None


def explained(model: Model, bias: Floats, L: Floats, y: Floats, u: Floats) -> str | None:
    """What explains a bias e at rest at (y, u), learned with L, beside noise and the region.

    ``e = (Theta - H) z + b d + M s + n`` for constants d at the inputs and s of the sensors, ``b =
    H N_u``, ``M = I - H N_y``, z at rest ``N_y y + N_u u + N_1``, and n of covariance ``P = (I - L)
    P (I - L)' + L Sigma L'``. An explanation is refuted where what it leaves of e is further off
    than ``q + ||T D|| ||W z||``, T whitening P.
    """
    p, region = model.n_outputs, bounded(model)
    core, H = model.regressors.core, np.ascontiguousarray(model.coefficients)
    if region is None or region.noise is None or not np.isfinite(region.noise).all():
        return None
    A = np.eye(p) - L
    step = np.eye(p * p) - np.kron(A, A)
    P = np.linalg.solve(step, (L @ region.noise @ L.T).ravel()).reshape(p, p)
    gate = _core.Gate.of(region.core, np.ascontiguousarray((P + P.T) / 2.0), FALSE_ALARM)
    if gate is None:
        return None
    units = np.eye(p + model.m)
    zero = core.rest(H, np.zeros(p), np.zeros(model.m))[1]
    N = np.array([core.rest(H, *np.split(unit, [p]))[1] - zero for unit in units]).T
    N[:, :p] *= -1.0  # the true readings are those less what the sensors add
    effects = np.eye(p, p + model.m) + H @ N
    z, T = core.rest(H, y, u)[1], np.linalg.inv(np.linalg.cholesky(P))
    inputs, all_seen = list(range(p, p + model.m)), [True] * p

    def constants(which: list[int]) -> Floats | None:
        """The constants of these that explain the bias, if they do."""
        chosen = effects[:, which]
        found: Floats = np.linalg.lstsq(T @ chosen, T @ bias, rcond=1e-9)[0]
        left, true = bias - chosen @ found, z + N[:, which] @ found
        inside = min(gate.excess(left, at, all_seen) for at in (z, true)) <= 1.0
        return found if inside else None

    if constants([]) is not None:
        return None
    acting = constants(inputs)
    if acting is not None:
        pairs = zip(acting, model.input_names, strict=True)
        causes = [f"a constant acts, as {show.listed([f'{v:.3g} at {name}' for v, name in pairs])}"]
        beside: list[int] = []
    else:
        causes, beside = [], inputs
    for i in range(p):
        found = constants([i, *beside])
        if found is not None:
            much = f"{abs(found[0]):.3g} {'more' if found[0] > 0.0 else 'less'}"
            others = "the others say" if p > 1 else "the model says"
            causes.append(f"{model.outputs[i]} reads {much} than {others}")
    if not causes:
        several = any(constants([*two, *inputs]) is not None for two in combinations(range(p), 2))
        tail = "two of them are wrong" if several else "the plant is not the model"
        return (
            f"the readings contradict each other at rest, and no single sensor explains it: {tail}"
        )
    text = ", or ".join(causes)
    return text if len(causes) == 1 else f"{text}: undecided which"
