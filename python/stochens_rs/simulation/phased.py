"""What a trajectory draws of its states: some of them, or two against each other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .._base.labels import Labels, default_labels, two_states
from ..plots.states import draw_phase

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .._base.types import Floats


class Phased:
    """The phase portrait of `Trajectory` and `EnsembleTrajectory`."""

    inputs: Floats
    dt: float | None
    labels: Labels | None

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
        curves: Floats = getattr(self, "mean" if hasattr(self, "mean") else "states")
        return curves

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
