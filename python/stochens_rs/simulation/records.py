"""The records that simulations return.

``times[k]`` is ``k dt`` where the system states a step length, otherwise the step number k.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from .._base import show
from .._base.names import Labels, default_labels, two_states
from .._base.records import Count, Positive, SavedRecord
from .._base.tables import Timed
from .._base.types import Centre, Floats
from ..exceptions import ShapeError
from ..plots.lines import draw_phase, draw_states

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

    from ..rng import Key


class _OverTime(SavedRecord, Timed, listed=False):
    """What both trajectories have: a phase portrait, and names of the states that are drawn."""

    inputs: Floats
    dt: float | None
    labels: Labels | None

    @property
    def steps(self) -> int:
        """The number of steps K."""
        return len(self.inputs)

    def plot_phase(self, across: str | int, up: str | int, *, ax: Axes | None = None) -> Axes:
        """Draw two states, or their means, against each other.

        A ring is at the start, a dot at the end.

        Parameters
        ----------
        across, up : str or int
            The two states, by name or number.
        ax : matplotlib Axes, optional
            Where to draw, as for `plot`.

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        ImportError
            matplotlib is not installed.
        InputError, InputTypeError
            There is no such state.

        Examples
        --------
        >>> import stochens_rs as se
        >>> path = se.simulate(([[1.0, 0.1], [-0.1, 1.0]], [[0.0], [0.1]]), [1.0, 0.0], [[0.0]] * 9)
        >>> path.plot_phase(0, 1).get_xlabel()
        'x[0]'
        """
        labels = self._labels
        at = two_states(labels, across, up)
        names = labels.state_axes
        return draw_phase([(self._curves[:, at], None)], (names[at[0]], names[at[1]]), ax=ax)

    @property
    def _curves(self) -> Floats:
        """The states, or their means, (K + 1, n)."""
        raise NotImplementedError

    @property
    def _labels(self) -> Labels:
        return self.labels or default_labels(self._curves.shape[1], self.inputs.shape[1])

    def _shown(self, states: object) -> tuple[list[int], dict[str, Any]]:
        """The places of the chosen states, and how they are named."""
        labels = self._labels
        at = labels.places("states", states)
        unit = labels.units_of(at)
        said = labels.state_axes if unit is None else labels.states
        up = "state" if unit is None else f"state [{unit}]"
        return at, {"names": [said[i] for i in at], "up": up, "timed": self.dt is not None}


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(_OverTime):
    """The trajectory of an exact system under given inputs.

    Attributes
    ----------
    states : ndarray, shape (K + 1, n)
        ``states[k]`` is ``x(k)``; the first is the initial state.
    inputs : ndarray, shape (K, m)
        ``inputs[k]`` is ``u(k)``, which leads from ``x(k)`` to ``x(k + 1)``.
    times : ndarray, shape (K + 1,)
        ``k dt`` [s], or k if the system states no step length.
    dt : float or None
        The step length [s]; None if the system states none.
    labels : Labels or None
        Names and units of the states and inputs, as those of the system.
    """

    states: Annotated[Floats, "step+1 state"]
    inputs: Annotated[Floats, "step input"]
    times: Annotated[Floats, "step+1"]
    dt: Positive | None = None
    labels: Labels | None = None

    @property
    def _curves(self) -> Floats:
        return self.states

    def plot(
        self, states: str | int | Sequence[str | int] | None = None, *, ax: Axes | None = None
    ) -> Axes:
        """Draw every state over time.

        Parameters
        ----------
        states : str, int or list of them, optional
            Which states, by name or number. Default: all.
        ax : matplotlib Axes, optional
            Where to draw. Default: new axes on a figure of their own, which a notebook shows. In a
            script ``path.plot().figure.savefig("path.png")`` saves it; for a window, pass
            ``ax=plt.subplots()[1]`` and call ``plt.show()``.

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        ImportError
            matplotlib is not installed.
        InputError, InputTypeError
            There is no such state.

        Examples
        --------
        >>> import stochens_rs as se
        >>> path = se.simulate(([[0.5]], [[1.0]]), [0.0], [[1.0], [0.0]])
        >>> path.plot().get_ylabel()
        'state'
        """
        at, how = self._shown(states)
        return draw_states(self.times, self.states[:, at], None, ax=ax, **how)

    def __repr__(self) -> str:
        return f"<Trajectory: n={self.states.shape[1]}, {show.number_of(self.steps)}>"


@dataclass(frozen=True, eq=False, repr=False)
class EnsembleTrajectory(_OverTime):
    """Mean and covariance of random trajectories, or of those of several models of a system.

    Attributes
    ----------
    mean : ndarray, shape (K + 1, n)
        ``mean[k]`` is the average of ``x(k)`` over the trajectories.
    variance : ndarray, shape (K + 1, n), or None
        Unbiased variance of one trajectory, entry by entry; None for a single trajectory. Over
        many steps single runs have heavy tails, and a few thousand of them can show far too small
        a variance; `theory.moments.trajectory_covariance` is exact.
    covariance : ndarray, shape (K + 1, n, n), or None
        ``covariance[k]`` is the unbiased covariance of one trajectory at step k; None unless
        asked for, and for a single trajectory.
    runs : ndarray, shape (replicates, K + 1, n), or None
        The trajectories themselves; None unless asked for.
    inputs : ndarray, shape (K, m)
        ``inputs[k]`` is ``u(k)``.
    times : ndarray, shape (K + 1,)
        ``k dt`` [s], or k if the system states no step length.
    size : int
        Realizations N of every entity at every step; the number of models for "systems".
    replicates : int
        Independent trajectories behind the moments: N for "runs" and "systems".
    averaging : str
        "runs", "mean-field", or "systems" for the models of a SystemEnsemble.
    sampled : tuple of str
        Which of "A", "B", "x0" were drawn; the others were exact.
    dt : float or None
        The step length [s]; None if the system states none.
    key : Key or None
        The same key, with the same other arguments, repeats the result; None for "systems", of
        which nothing is drawn.
    status : str
        "completed".
    centre : {"truth", "estimate"} or None
        For "systems": what the models scatter about, as in `SystemEnsemble`. With "estimate" the
        spread is that of the estimate, and no statement about the true trajectory.
    labels : Labels or None
        Names and units of the states and inputs, as those of the system.
    """

    mean: Annotated[Floats, "step+1 state"]
    variance: Annotated[Floats, "step+1 state", "own unit"] | None
    covariance: Annotated[Floats, "step+1 state other_state", "own unit"] | None
    runs: Annotated[Floats, "run step+1 state"] | None
    inputs: Annotated[Floats, "step input"]
    times: Annotated[Floats, "step+1"]
    size: Count
    replicates: Count
    averaging: str
    sampled: tuple[str, ...]
    dt: Positive | None
    key: Key | None
    status: str = "completed"
    centre: Centre | None = None
    labels: Labels | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.runs is not None and len(self.runs) != self.replicates:
            raise ShapeError(f"`runs` must be {self.replicates}, got {len(self.runs)}")

    @property
    def _curves(self) -> Floats:
        return self.mean

    @property
    def standard_error(self) -> Floats | None:
        """The estimated rms error of `mean`, ``sqrt(variance / replicates)``, shape (K + 1, n).

        None for a single trajectory.
        """
        if self.variance is None:
            return None
        error: Floats = np.sqrt(self.variance / self.replicates)
        return error

    def plot(
        self, states: str | int | Sequence[str | int] | None = None, *, ax: Axes | None = None
    ) -> Axes:
        """Draw the mean of every state over time, with a band of two standard errors.

        For the models of a SystemEnsemble the band is two standard deviations of the models.

        Parameters
        ----------
        states : str, int or list of them, optional
            Which states, by name or number. Default: all.
        ax : matplotlib Axes, optional
            Where to draw, as for `Trajectory.plot`.

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        ImportError
            matplotlib is not installed.

        Examples
        --------
        >>> import stochens_rs as se
        >>> path = se.simulate_ensemble(([[0.5]], [[1.0]]), [2.0], [[1.0]], 100, rng=1)
        >>> path.plot().get_xlabel()
        'step k'
        """
        at, how = self._shown(states)
        error = self.standard_error
        if self.averaging == "systems":
            error = None if self.variance is None else np.sqrt(self.variance)
            how["band"] = "± 2 standard deviations"
        error = None if error is None else error[:, at]
        return draw_states(self.times, self.mean[:, at], error, ax=ax, **how)

    def __repr__(self) -> str:
        about = "" if self.centre is None else f", about the {self.centre}"
        return (
            f"<EnsembleTrajectory {self.averaging}: n={self.mean.shape[1]}, "
            f"{show.number_of(self.steps)}, N={self.size}, {self.replicates} trajectories{about}>"
        )
