"""What a `LoopCertificate` bounds: margins, rounding of a gain, points of rest, and tubes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from .._base import show, validation
from .._base.names import Labels
from .._base.records import Probability, SavedRecord
from .._base.types import Figure, Floats, SubFigure
from ..plots.certificates import draw_margins
from ..plots.panels import Inputs, draw_tube

_EACH, _WHOLE = 4, 6  # margins of each input, and of the loop


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
    reason : str or None
        Why nothing is proved; None where something is.
    """

    certified: Annotated[Floats, "margin", "infinite"]
    nominal: Annotated[Floats, "margin", "infinite"]
    delta: Probability
    labels: Labels
    dt: float | None = None
    reason: str | None = None

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
        """Return the table: what, certified, of the model.

        Returns
        -------
        list of [name, certified, of the model]
            Texts, one row for each of `names`; "none" is infinite.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w)
        >>> proof = se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate(0.05)
        >>> proof.margins().rows()[1]
        ['largest gain of u[0]', '2.52', '2.75']
        """
        shown = []
        for name, *pair in zip(self.names, self.certified, self.nominal, strict=True):
            text = show.at_most if name.startswith(("least", "bits")) else show.margin
            texts = [text(float(v)) for v in pair]
            shown.append([name, *("none" if t == "inf" else t.rstrip(".") for t in texts)])
        return shown

    def __repr__(self) -> str:
        low, high = self.gain[:, 0].max(), self.gain[:, 1].min()
        size = show.margin(float(self.phase.min()))
        if self.reason is not None:
            return f"<Margins: no gain, phase or disk is proved: {self.reason}>"
        return (
            f"<Margins: {show.percent(self.delta)}, gain {show.at_most(low)} to "
            f"{show.margin(high)}, phase {size} deg, disk {show.margin(self.disk)}>"
        )

    def _repr_html_(self) -> str:
        return show.card(self, [], show.grid(["", "certified", "of the model"], self.rows()))


class Rounding(SavedRecord):
    """How far a loop in the numbers of a computer is from that of the certificate.

    Made by `LoopCertificate.rounding`. The loop of the certificate has its own gain, in exact
    numbers: what is here may be added to its `tube`, with the same noise in both.

    Attributes
    ----------
    K : ndarray, shape (m, n)
        The gain as it is stored.
    bits : int or None
        The bits behind the point; None for floating point of 32 bits.
    states : ndarray, shape (n,)
        Each state of every system stays within this of that of the certificate's loop, for all
        time; with noise for its steps.
    inputs : ndarray, shape (m,)
        The same for the inputs.
    margin : float
        That of the stored gain, see `LoopCertificate.margin`.
    delta : float
        The true system is outside of the region with at most this probability.
    labels : Labels
        The names of states and inputs.
    eps : float or None
        The probability that the noise is larger; None without noise.
    """

    K: Annotated[Floats, "input state"]
    bits: int | None
    states: Annotated[Floats, "state", "infinite"]
    inputs: Annotated[Floats, "input", "infinite"]
    margin: float
    delta: Probability
    labels: Labels
    eps: float | None = None

    def __repr__(self) -> str:
        form = "float32" if self.bits is None else show.number_of(self.bits, "fraction bit")
        if not np.isfinite(self.states).all():
            return f"<Rounding: {form}, unbounded>"
        names = zip(self.labels.states, self.states, strict=True)
        each = ", ".join(f"{name} {show.at_most(float(v), 2)}" for name, v in list(names)[:6])
        share, noise = show.percent(self.delta, self.eps or 0.0), "with" if self.eps else "without"
        return f"<Rounding: {form}, {share}, off by at most {each} {noise} noise>"


class Rest(SavedRecord):
    """How far the point of rest of any system of a region is from a set point.

    Made by `LoopCertificate.rest`; the feedback is ``u = inputs + K (x - states)``. That of
    `ReadingLoop.rest` has the outputs as its states.

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
    exact : tuple of str
        Those that a loop with a learned bias holds exactly once it is at rest, whatever constants
        act.
    """

    states: Annotated[Floats, "state"]
    inputs: Annotated[Floats, "input"]
    components: Annotated[Floats, "state", "infinite"]
    input_components: Annotated[Floats, "input", "infinite"]
    radius: float
    delta: float
    labels: Labels
    exact: tuple[str, ...] = ()

    def __repr__(self) -> str:
        size, share = show.at_most(self.radius), show.percent(self.delta)
        few = self.labels.given and len(self.states) <= 6
        at = show.vector(self.states, self.labels.state_axes if few else ())
        return f"<Rest: every system rests within {size} of {at}, {share}>"


class Tube(SavedRecord):
    """Bounds of the states and inputs of every system of a region, around those of its centre.

    Made by `LoopCertificate.tube`. All hold in one event of probability ``1 - delta``, with noise
    ``1 - delta - eps``; they are infinite where the loop is not certified.

    Attributes
    ----------
    states : ndarray, shape (K + 1, n)
        Those of the centre.
    inputs : ndarray, shape (K, m)
        Its inputs.
    model : ndarray, shape (K + 1, n + m)
        What the error of the model adds to each state and input, as absolute values.
    start : ndarray, shape (K + 1, n + m)
        The same of an uncertain start, and of errors of the readings.
    state_radii : ndarray, shape (K + 1,)
        The 2-norm of the states that both add.
    noise : ndarray, shape (n + m,)
        What noise adds at most in any of the K steps; 0 without noise.
    noise_radius : float
        The same for the 2-norm of the states.
    later : ndarray, shape (L,)
        ``||x(j)||`` is at most ``later[k]`` for all j >= k without noise, L > K; infinite where
        there is no bound for all time.
    reach : ndarray, shape (n + m,)
        The states and inputs are at most this for all time, without noise.
    delta : float
        The true system is outside of the region with at most this probability.
    eps : float or None
        The probability that the noise is larger.
    labels : Labels
        The names of states and inputs.
    dt : float or None
        The time between two steps [s].
    """

    states: Annotated[Floats, "step+1 state"]
    inputs: Annotated[Floats, "step input"]
    model: Annotated[Floats, "step+1 state+input", "infinite"]
    start: Annotated[Floats, "step+1 state+input", "infinite"]
    state_radii: Annotated[Floats, "step+1", "infinite"]
    noise: Annotated[Floats, "state+input", "infinite"]
    noise_radius: float
    later: Annotated[Floats, "later", "infinite"]
    reach: Annotated[Floats, "state+input", "infinite"]
    delta: Probability
    eps: float | None
    labels: Labels
    dt: float | None = None

    @property
    def _rows(self) -> Floats:
        """All parts together, (K + 1, n + m): there is no noise in the first state."""
        later = np.arange(len(self.model))[:, None] > 0
        return self.model + self.start + np.where(later, self.noise, 0.0)

    @property
    def components(self) -> Floats:
        """``|x - states|`` is at most this, shape (K + 1, n), noise included if there is any."""
        return self._rows[:, : self.states.shape[1]]

    @property
    def input_components(self) -> Floats:
        """``|u - inputs|`` is at most this, shape (K, m), noise included if there is any."""
        return self._rows[:-1, self.states.shape[1] :]

    @property
    def radii(self) -> Floats:
        """``||x - states||`` is at most this, shape (K + 1,), noise included if there is any."""
        return np.concatenate([self.state_radii[:1], self.state_radii[1:] + self.noise_radius])

    def settles(self, r: float) -> int | None:
        """Return the first step from which every system stays within r of 0, without noise.

        Parameters
        ----------
        r : float
            A distance in the 2-norm.

        Returns
        -------
        int or None
            None where that is not proved.

        Raises
        ------
        InputError, InputTypeError
            If r is not a number > 0.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w)
        >>> proof = se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate(0.05)
        >>> proof.tube([1.0], 10).settles(0.1)
        4
        """
        inside = np.flatnonzero(self.later <= validation.positive("r", r))
        return int(inside[0]) if len(inside) else None

    def plot(
        self, *, states: Sequence[str] | None = None, figure: Figure | SubFigure | None = None
    ) -> Figure:
        """Draw the states of the centre with the tube around them, and its inputs.

        Parameters
        ----------
        states : sequence of str, optional
            Which ones; default: all, of a window the outputs or their first filters.
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
        >>> len(proof.tube([1.0], 10).plot().axes)
        2
        """
        at = self.labels.leading if states is None else self.labels.places("states", states)
        free = np.full(self.inputs.shape, np.inf)
        inputs = Inputs(self.inputs, self.labels.input_axes, -free, free)
        return draw_tube(
            self.states[:, at],
            (np.minimum(self.components, self.radii[:, None])[:, at], self._share),
            [self.labels.state_axes[i] for i in at],
            inputs=inputs,
            dt=self.dt,
            figure=figure,
        )

    @property
    def _share(self) -> str:
        return show.percent(self.delta, self.eps or 0.0)

    def __repr__(self) -> str:
        noise = "without noise" if self.eps is None else "with noise"
        K = show.number_of(len(self.inputs))
        if not np.isfinite(self.radii).all():
            return f"<Tube: {K}, unbounded>"
        far = f"every system within {show.at_most(float(self.radii.max()))} of the centre"
        n, m = self.states.shape[1], self.inputs.shape[1]
        if m == 1 and np.isfinite(self.reach[n]):
            size = show.at_most(float(self.reach[n]))
            far += f", |{self.labels.inputs[0]}| at most {size} for ever without noise"
        return f"<Tube: {K}, {far}, {self._share} {noise}>"
