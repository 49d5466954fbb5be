"""`Rest`: where every system of a region comes to rest under a certified feedback."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from .._base import html
from .._base.records import SavedRecord
from .._base.signal_names import Labels

if TYPE_CHECKING:
    from .._base.types import Floats


@dataclass(frozen=True, eq=False, repr=False)
class Rest(SavedRecord):
    """How far the point of rest of any system of a region is from a set point.

    Made by `LoopCertificate.rest`; the feedback is ``u = inputs + K (x - states)``.

    Attributes
    ----------
    states : ndarray, shape (n,)
        The set point.
    inputs : ndarray, shape (m,)
        The inputs that hold it at the centre of the region.
    components : ndarray, shape (n,)
        Each state rests within this of `states`; infinite where nothing is certified.
    input_components : ndarray, shape (m,)
        The same for the inputs.
    radius : float
        The same for the 2-norm of the states.
    delta : float
        The true system is outside of the region with at most this probability.
    labels : Labels
        The names of states and inputs.
    """

    states: Annotated[Floats, "state"]
    inputs: Annotated[Floats, "input"]
    components: Annotated[Floats, "state", "infinite"]
    input_components: Annotated[Floats, "input", "infinite"]
    radius: float
    delta: float
    labels: Labels

    def __repr__(self) -> str:
        size, share = html.at_most(self.radius), html.percent(self.delta)
        return f"<Rest: every system rests within {size} of {html.vector(self.states)}, {share}>"

    def _repr_html_(self) -> str:
        each = zip(
            (*self.labels.states, *self.labels.inputs),
            (*self.states, *self.inputs),
            (*self.components, *self.input_components),
            strict=True,
        )
        return html.card(self, [(name, f"{v:.4g} ± {html.at_most(s)}") for name, v, s in each][:12])
