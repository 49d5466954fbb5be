"""`LoopLook`: whether the data of a stream are enough for a feedback to be certified."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite
from typing import TYPE_CHECKING

import numpy as np

from .._base import html, validation
from .._base.records import Record, trusted
from ..exceptions import InputError
from ..feedback import Loop, LoopCertificate
from .looks import more

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .snapshot import Snapshot


@dataclass(frozen=True, eq=False, repr=False)
class LoopLook(Record):
    """Whether the data so far certify a feedback. Made by `ModelStream.look`.

    Attributes
    ----------
    proof : LoopCertificate
        What is proved of the gain for the region of this look. True for all looks at the stream
        together, however the gain was chosen and whenever the stream is stopped.
    forecast : float
        How many more pairs are expected until it is certified, if data go on like those so far;
        inf where the data do not determine the loop, or its centre is unstable. No bound.
    runs : float
        The same in runs, as in `Look`.
    size : int
        The number of pairs so far.
    """

    proof: LoopCertificate
    forecast: float
    runs: float
    size: int

    def __post_init__(self) -> None:
        super().__post_init__()
        validation.size("size", self.size, minimum=0)

    @property
    def stop(self) -> bool:
        """Whether the loop is certified: the data are enough."""
        return self.proof.status == "certified"

    def __repr__(self) -> str:
        pairs = html.number_of(self.size, "pair")
        if self.stop:
            margin = html.margin(self.proof.margin)
            return f"<LoopLook: certified after {pairs}, margin at least {margin}>"
        then = more(self.forecast, self.runs) if isfinite(self.forecast) else "unknown"
        return f"<LoopLook: {self.proof.status} after {pairs}, forecast: {then}>"

    def _repr_html_(self) -> str:
        return html.card(self, [], self.proof._repr_html_())


def look_at_loop(model: Snapshot, gain: Loop | ArrayLike) -> LoopLook:
    """Judge a gain for the region of this look; ``rho g`` falls as N^(-1/2)."""
    n, m = model.n, model.m
    K = gain.K if isinstance(gain, Loop) else validation.matrix("gain", gain, rows=m, cols=n)
    if K.shape != (m, n):
        raise InputError(f"`gain` must be of shape ({m}, {n}), got {K.shape}")
    own = validation.frozen(np.array(K))
    proof = LoopCertificate._judged(model.region(), own, model.labels, model)
    needed = 0.0
    if proof.status != "certified":
        stable = not model.doubts and isfinite(proof.least)
        needed = model._size_after(model.size * proof.least**2) - model.size if stable else inf
    forecast = float(max(needed, 0.0))
    return trusted(LoopLook, proof, forecast, model._in_runs(forecast), model.size)
