"""`Margins` and `Rounding`: how much a certified loop withstands beside the error of its model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from .._base import show
from .._base.names import Labels
from .._base.records import Probability, SavedRecord
from .._base.types import Figure, Floats, SubFigure
from ..plots.certificates import draw_margins

_EACH, _WHOLE = 4, 6  # margins of each input, and of the loop


@dataclass(frozen=True, eq=False, repr=False)
class Margins(SavedRecord):
    """What a loop withstands: for every system of a region, and the same of its centre alone.

    Made by `LoopCertificate.margins`. Each margin is for one fault while all else is as it was; for
    several at once use `LoopCertificate.allows` or a model with a `Misfit`.

    Attributes
    ----------
    certified : ndarray, shape (4 m + 6,)
        Proved for all systems of the region, in the order of `names`.
    nominal : ndarray, shape (4 m + 6,)
        The same of the centre: what a textbook says of the model; not proved.
    delta : float
        The true system is outside of the region with at most this probability.
    labels : Labels
        The names of states and inputs.
    dt : float or None
        The time between two steps [s].
    """

    certified: Annotated[Floats, "margin", "infinite"]
    nominal: Annotated[Floats, "margin", "infinite"]
    delta: Probability
    labels: Labels
    dt: float | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """What each of the numbers is."""
        one = ("least gain", "largest gain", "phase [deg]", "disk")
        return (
            *(f"{what} of {name}" for name in self.labels.inputs for what in one),
            "disk of all inputs at once",
            "constant delay [steps]",
            "delay that varies [steps]",
            "relative error of readings",
            "bits of the gain",
            "least share of the inputs",
        )

    @property
    def gain(self) -> Floats:
        """Constant factors of each input between these keep the loop stable, shape (m, 2)."""
        return self.certified[:-_WHOLE].reshape(-1, _EACH)[:, :2]

    @property
    def phase(self) -> Floats:
        """Phase margins [deg] of each input, shape (m,)."""
        return self.certified[:-_WHOLE].reshape(-1, _EACH)[:, 2]

    @property
    def disk(self) -> float:
        """The disk margin alpha of all inputs at once: factors ``(1 + d / 2) / (1 - d / 2)``.

        Any ``|d| <= alpha``, complex, dynamic or time-varying, and another one at each input: gains
        of ``(2 - alpha) / (2 + alpha)`` to its inverse, phases up to ``2 atan(alpha / 2)``.
        """
        return float(self.certified[-6])

    @property
    def delay(self) -> float | None:
        """The input may be late by any constant time of whole steps up to this [s]."""
        return None if self.dt is None else self.dt * float(self.certified[-5])

    def plot(self, *, figure: Figure | SubFigure | None = None) -> Figure:
        """Draw which factors of each input are certified, in the complex plane.

        Parameters
        ----------
        figure : matplotlib Figure or SubFigure, optional
            Where to draw; the default is a new figure.

        Returns
        -------
        matplotlib Figure

        Raises
        ------
        ImportError
            If matplotlib is not installed.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w)
        >>> proof = se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate(0.05)
        >>> len(proof.margins().plot().axes)
        1
        """
        own, model = (one[:-_WHOLE].reshape(-1, _EACH) for one in (self.certified, self.nominal))
        return draw_margins(own, model, self.labels.inputs, show.percent(self.delta), figure)

    def rows(self) -> list[list[str]]:
        """The table: what, certified, of the model."""
        shown = []
        for name, *pair in zip(self.names, self.certified, self.nominal, strict=True):
            text = show.at_most if name.startswith(("least", "bits")) else show.margin
            texts = [text(float(v)) for v in pair]
            shown.append([name, *("none" if t == "inf" else t.rstrip(".") for t in texts)])
        return shown

    def __repr__(self) -> str:
        low, high = self.gain[:, 0].max(), self.gain[:, 1].min()
        size = show.margin(float(self.phase.min()))
        return (
            f"<Margins: {show.percent(self.delta)}, gain {show.at_most(low)} to "
            f"{show.margin(high)}, phase {size} deg, disk {show.margin(self.disk)}>"
        )

    def _repr_html_(self) -> str:
        return show.card(self, [], show.grid(["", "certified", "of the model"], self.rows()))


@dataclass(frozen=True, eq=False, repr=False)
class Rounding(SavedRecord):
    """How far a loop in the numbers of a computer is from that in exact numbers.

    Made by `LoopCertificate.rounding`.

    Attributes
    ----------
    K : ndarray, shape (m, n)
        The gain as it is stored, which is the one that is certified.
    bits : int or None
        The bits behind the point; None for floating point of 32 bits.
    states : ndarray, shape (n,)
        Each state of every system stays within this of that of the exact loop, for all time.
    inputs : ndarray, shape (m,)
        The same for ``K x``.
    margin : float
        That of the stored gain, see `LoopCertificate.margin`.
    delta : float
        The true system is outside of the region with at most this probability.
    labels : Labels
        The names of states and inputs.
    """

    K: Annotated[Floats, "input state"]
    bits: int | None
    states: Annotated[Floats, "state", "infinite"]
    inputs: Annotated[Floats, "input", "infinite"]
    margin: float
    delta: Probability
    labels: Labels

    def __repr__(self) -> str:
        form = "float32" if self.bits is None else show.number_of(self.bits, "fraction bit")
        if not np.isfinite(self.states).all():
            return f"<Rounding: {form}, unbounded>"
        names = zip(self.labels.states, self.states, strict=True)
        each = ", ".join(f"{name} {show.at_most(float(v), 2)}" for name, v in list(names)[:6])
        return f"<Rounding: {form}, {show.percent(self.delta)}, off by at most {each}>"
