"""Models from resampled data and from the law of the estimate: how it scatters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

import numpy as np

from .. import _core
from .._base import memory
from .._base.threads import get_num_threads
from ..data import Trajectories
from ..exceptions import InputError
from ..rng import Key
from .assumptions import Assumptions

if TYPE_CHECKING:
    from .._base.types import Floats


Law: TypeAlias = "tuple[Floats, Floats, Floats, str, int]"
Bootstrap: TypeAlias = Literal["pairs", "residual", "wild", "trajectories"]
BOOTSTRAPS: tuple[Bootstrap, ...] = get_args(Bootstrap)


def bootstrap_models(
    blocks: list[_core.Fitted],
    Z: Floats,
    Y: Floats,
    Theta: Floats,
    data: Trajectories,
    size: int,
    method: Bootstrap,
    key: Key,
) -> Floats:
    """Models of `size` resamples, (size, n, d); fewer where a resample determines none.

    In whitened regressors ``q_t``, with ``sum q q' = I``, and residuals ``e_t`` a model is
    ``Theta + (sum k e q') (sum k q q')^-1 white`` with counts k, or ``Theta + (sum e* q') white``
    with drawn or signed residuals e*. A resample depends on the key and its number alone, so it is
    the same for all blocks of rows.
    """
    memory.need("the models", 3 * 8 * size * Theta.size)
    models, solved = np.repeat(Theta[None], size, axis=0), np.ones(size, dtype=bool)
    residuals = Y - Z @ Theta.T
    runs = None
    if method == "trajectories":
        runs = np.repeat(np.arange(len(data), dtype=np.uint32), data.lengths)
    kind = "pairs" if method == "trajectories" else method
    for f in blocks:
        if not len(f.columns):
            continue
        q, e = Z[:, f.columns] @ f.white.T, residuals[:, f.rows]
        if method == "residual":
            if f.nu < 1:
                raise InputError("method='residual' needs more pairs than unknowns: use 'pairs'")
            e = (e - e.mean(axis=0)) * np.sqrt(f.N / f.nu)
        elif method == "wild":
            left = 1.0 - np.sum(q * q, axis=1)  # 0 where a pair is fitted exactly: so is e
            e = e / np.sqrt(np.where(left > 1e-12, left, np.inf))[:, None]
        place = np.ix_(f.rows, f.columns)
        H = np.ascontiguousarray(Theta[place])
        found = _core.bootstrap(
            np.hstack([q, e]), H, f.white, runs, kind, size, bytes(key), None, get_num_threads()
        )
        solved &= ~np.isnan(found[:, 0])
        models[:, place[0], place[1]] = found.reshape(size, *H.shape)
    return models[solved]


def law_of_estimate(f: _core.Fitted, noise: Assumptions, Theta: Floats, white: Floats) -> Law:
    """What the core draws models from: Theta, white of all columns, S, its kind and nu."""
    least = len(Theta) if noise.covariance == "full" else 1
    if noise.known is None and f.nu < least:
        raise InputError(f"draw() needs at least {f.rank + least} pairs, got {f.N}")
    S = f.S if noise.known is None else noise.known
    return Theta, white, S, noise.covariance, f.nu


def whitened(f: _core.Fitted, d: int) -> Floats:
    """``white' white = V^+`` for all d columns, 0 in those that are known."""
    white = np.zeros((f.rank, d))
    white[:, f.columns] = f.white
    return white
