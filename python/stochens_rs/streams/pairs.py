"""Pairs for a `ModelStream`, single ones, batches and runs, as rows (x, u, 1, x_next)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import gate, memory
from ..exceptions import InputError
from ..identification.trajectories import Trajectories

if TYPE_CHECKING:
    from .._base.types import Floats
    from .snapshot import Snapshot


def pair_rows(about: Snapshot, x: Any, u: Any, x_next: Any) -> Floats:
    """Check pairs or runs of a stream, and return their rows."""
    n, m = about.n, about.m
    if isinstance(x, Trajectories):
        if u is not None or x_next is not None:
            raise InputError("`u` and `x_next` must be left out with Trajectories")
        _refuse_runs(about, x)
        before, inputs, after = x.pairs()
    elif u is None or x_next is None:
        raise InputError("`u` and `x_next` must be given with `x`")
    elif gate.array("x", x, ndim=(1, 2)).ndim == 1:
        before = gate.vector("x", x, length=n)[None]
        inputs = gate.vector("u", u, length=m)[None]
        after = gate.vector("x_next", x_next, length=n)[None]
    else:
        before = gate.matrix("x", x, cols=n)
        inputs = gate.matrix("u", u, rows=len(before), cols=m)
        after = gate.matrix("x_next", x_next, rows=len(before), cols=n)
    memory.need("the pairs", 8 * len(before) * len(about.triangle))
    return np.hstack([before, inputs, np.ones((len(before), int(about.intercept))), after])


def _refuse_runs(about: Snapshot, runs: Trajectories) -> None:
    """Refuse runs of another system."""
    theirs = runs.n, runs.m, runs.dt, runs.steps, runs.state_names, runs.input_names
    if theirs != (about.n, about.m, about.dt, 1, about.state_names, about.input_names):
        dt = "" if about.dt is None else f" dt={about.dt:g}"
        raise InputError(
            f"`x` must be runs with n={about.n} m={about.m}{dt}, one step a pair, and the names "
            f"of the stream, got {runs!r}"
        )
    if about.assumptions.design == "independent" and not runs.single:
        raise InputError(
            "`x` must be single pairs for design='independent', got runs of several steps, "
            "whose states contain earlier noise; use last_pairs()"
        )
