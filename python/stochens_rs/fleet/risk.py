"""The risk of a fresh unit, by the units of the design."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from .._base.records import Probability, SavedRecord
from .._base.types import Floats
from ..exceptions import InputError
from ..validation.fresh_systems import needed, rank_of

Method: TypeAlias = Literal["compression", "a priori", "discarding", "hold-out"]
METHODS: tuple[Method, ...] = get_args(Method)


@dataclass(frozen=True, eq=False, repr=False)
class RiskBound(SavedRecord):
    """A fresh unit misses more than `threshold` with probability at most `epsilon` (+ `delta`).

    Attributes
    ----------
    epsilon : float
        The bound of the risk, with confidence ``1 - beta``.
    beta : float
        The bound fails with at most this probability, over the units it was computed from.
    method : str
        "compression", "a priori", "discarding": from the units of the design, see
        `theory.scenario`. "hold-out": from fresh units.
    size : int
        The number of these units.
    count : int
        What `method` counts: the units that alone give the command (compression), the variables
        (a priori, discarding), the units above the threshold (hold-out).
    threshold : float
        The miss that is spoken of; with regions, of the plants behind the models.
    delta : float
        With regions of models, the probability that the region of a fresh unit fails; else 0.
    misses : ndarray, shape (size,), or None
        The misses of the fresh units of a hold-out.
    keeps : bool
        Whether a unit that leaves its limits of states counts as one that misses more.
    """

    epsilon: float
    beta: Probability
    method: Method
    size: int
    count: int
    threshold: float
    delta: float = 0.0
    misses: Floats | None = None
    keeps: bool = False

    @property
    def covers(self) -> str:
        """Which units the number is about, in words."""
        which = "these fresh units" if self.method == "hold-out" else "the units of the design"
        text = (
            f"a fresh unit, drawn independently from the same law as {which}, which were drawn "
            f"independently; with confidence {1.0 - self.beta:.9g} over their draws"
        )
        if self.delta:
            return f"{text}; the miss is that of the plant behind the model of the unit"
        return text

    def __repr__(self) -> str:
        how = f"{100 * self.epsilon:.4g} %"
        if self.delta:
            how += f" + {100 * self.delta:.4g} %"
        leaves = " or leaves its limits" if self.keeps else ""
        return (
            f"<RiskBound {self.method}: a fresh unit misses more than {self.threshold:.4g}{leaves} "
            f"with at most {how}, {self.count} of {self.size}>"
        )


def quantile(scores: Floats, epsilon: float, beta: float) -> tuple[float, int]:
    """The miss that at most the share `epsilon` of all units exceeds, and how many of these do."""
    size, rank = len(scores), rank_of(len(scores), epsilon, beta)
    if rank > size:
        raise InputError(
            f"`epsilon` {epsilon:g} with `beta` {beta:g} needs {needed(epsilon, beta)} fresh units "
            f"at least, got {size}"
        )
    limit = float(np.partition(scores, rank - 1)[rank - 1])
    if limit == np.inf:
        raise InputError(
            f"`epsilon` {epsilon:g} allows for {size - rank} of these units: more of them leave "
            "their limits of states"
        )
    return limit, size - rank
