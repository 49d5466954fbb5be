"""`Older`: runs of an older, similar plant, with the declared difference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import _core
from .._base import html, validation
from .._base.records import Record
from .._base.threads import get_num_threads
from .._base.types import Floats
from ..data.trajectories import Trajectories, pooled
from ..exceptions import InputError, InputTypeError, ShapeError


@dataclass(frozen=True, eq=False)
class Older(Record):
    """Runs of an older plant that count beside those of a model, and how far it may be apart.

    Attributes
    ----------
    rows : ndarray, shape (N, 2 n + m)
        The pairs (x, u, x_next), run by run.
    lengths : ndarray, shape (runs,)
        The steps of each run.
    scale : ndarray, shape (d,)
        The diagonal of S; of no meaning where there are directions.
    eta : float
        Declared: ``||S_x^-1 (Theta_old - Theta) S||_2`` is at most this, S_x that of the states; 0
        where there are directions.
    directions : ndarray, shape (k n, d), or None
        Declared: ``Theta_old - Theta = sum_i t_i E_i`` with ``|t_i| <= 1``, the E_i below each
        other.
    weight : float, default 0.0
        What an older pair counts, chosen without the noise of any run; 0: they are left out.
    """

    rows: Floats
    lengths: Floats
    scale: Floats
    eta: float
    directions: Floats | None = None
    weight: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        d = len(validation.kept("scale", self.scale, ndim=(1,)))
        rows = validation.kept("rows", self.rows, ndim=(2,))
        lengths = validation.kept("lengths", self.lengths, ndim=(1,))
        if (lengths < 1.0).any() or (lengths % 1.0).any() or lengths.sum() != len(rows):
            raise InputError(f"`lengths` must be whole numbers of sum {len(rows)}")
        if self.scale.min(initial=np.inf) <= 0.0:
            raise InputError("`scale` must be above 0")
        validation.nonnegative("eta", self.eta)
        if self.directions is not None:
            given = validation.kept("directions", self.directions, ndim=(2,))
            validation.kept("directions", given, shape=(len(given), d))
        if not 0.0 <= self.weight <= 1.0:
            raise InputError(f"`weight` must be in [0, 1], got {self.weight}")

    @property
    def said(self) -> str:
        """What is declared, in words."""
        count = html.number_of(len(self.rows), "pair")
        if self.directions is None:
            apart = f"at most {self.eta:g} apart in the norm of S_x^-1 (Theta_old - Theta) S"
        else:
            apart = "apart by the declared directions at most"
        told = f"counted {self.weight:g} each" if self.weight else "left out, as they promise less"
        return f"{count} of an older plant with the same noise, declared {apart}, {told}"

    def _with(
        self,
        data: Trajectories,
        model: Floats,
        fixed: tuple[Floats, Floats] | None,
        known: Floats,
        weight: float | None,
    ) -> tuple[_core.Pilot, float]:
        """The model of both and the weight; `fixed`: start and inputs of a task."""
        directions = None if self.directions is None else np.ascontiguousarray(self.directions)
        return _core.Pilot.with_older(
            (np.ascontiguousarray(data._rows), data.lengths),
            (np.ascontiguousarray(self.rows), self.lengths.astype(np.int64)),
            np.ascontiguousarray(model),
            (np.ascontiguousarray(self.scale), self.eta, directions),
            np.ascontiguousarray(known),
            fixed,
            weight,
            get_num_threads(),
        )


def older_runs(like: Any, apart: Any, data: Trajectories) -> Trajectories:
    """The runs of an older plant, checked against those of the newer one."""
    if apart is None:
        raise InputError("`apart` must be declared; it cannot be estimated from these runs")
    if not isinstance(like, (Trajectories, list, tuple)):
        raise InputTypeError(
            f"`like` must be Trajectories, got {validation.show(like)}; old runs without inputs: "
            "use them as `pilot` only"
        )
    older = pooled(like, "like")
    if older._about() != data._about():
        raise InputError(
            f"`like` must have the states, inputs, steps and dt of the data: {data!r} and "
            f"{older!r}, with the same names"
        )
    if data._shares(older):
        raise InputError("`like` shares runs with the data: each run must count once")
    return older


def older_of(runs: Trajectories, apart: Any, scale: Floats) -> Older:
    """The record of the runs that count, without their weight."""
    n, d = runs.n, len(scale)
    eta, directions = 0.0, None
    if validation.is_real(apart):
        eta = validation.nonnegative("apart", apart)
    else:
        each = validation.items("apart", apart)
        if not each:
            raise InputError("`apart` must have at least one direction")
        found = [validation.matrix(f"apart[{i}]", one, rows=n) for i, one in enumerate(each)]
        short = d - runs.n - runs.m  # of an offset, which may be left out
        for i, one in enumerate(found):
            if one.shape[1] not in (d, d - short):
                raise ShapeError(
                    f"`apart[{i}]` must have {d - short} columns as [A B], got {one.shape[1]}"
                )
        padded = [np.hstack([one, np.zeros((n, d - one.shape[1]))]) for one in found]
        directions = np.vstack(padded)
    lengths = runs.lengths.astype(np.float64)
    return Older(runs._rows, lengths, scale, float(eta), directions)
