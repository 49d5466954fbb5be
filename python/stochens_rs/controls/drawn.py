"""The figure of a plan."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import gate, html
from .._base.labels import Labels, default_labels, two_states
from ..exceptions import ShapeError
from ..plots.panels import Inputs
from ..plots.states import draw_phase
from ..plots.tube import draw_tube
from .basis import ModelBasis
from .certificate import Certificate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from numpy.typing import ArrayLike

    from .._base.types import Floats
    from .basis import Basis
    from .limited import Limited


class Drawn:
    """What `Plan` draws."""

    u: Floats
    predicted_states: Floats
    limited: Limited | None
    basis: Basis | ModelBasis | None
    labels: Labels | None
    dt: float | None

    def plot(
        self,
        certificate: Certificate | None = None,
        *,
        measured: ArrayLike | None = None,
        figure: Figure | SubFigure | None = None,
    ) -> Figure:
        """Draw the predicted states, each in its panel; within limits the inputs too.

        An input is drawn as steps, its limits as a grey band, thick where it is at one of them,
        and in another colour where it changes by its rate.

        Parameters
        ----------
        certificate : Certificate, optional
            From `bound`, of this plan: draws the tube that contains the true states.
        measured : array_like, shape (K + 1, n) or (R, K + 1, n), optional
            The states of one run under this control, or of R runs.
        figure : matplotlib Figure or SubFigure, optional
            Where to draw; the default is a new figure.

        Returns
        -------
        matplotlib Figure
            With a panel for each state and input.

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        InputError, InputTypeError
            If the arguments do not fit this plan.

        Examples
        --------
        >>> import stochens_rs as se
        >>> len(se.control(([[0.5]], [[1.0]]), [1.0], [0.0], steps=3).plot().axes)
        1
        """
        predicted = self.predicted_states
        tube, says, runs = self._certified(certificate, measured)
        target = self._target
        labels = self._labels
        more: dict[str, Any] = {}
        if self.limited is not None:
            task = self.limited.task
            at_rate = self.limited.rate_active != 0
            more["inputs"] = Inputs(self.u, labels.input_axes, task.low, task.high, at_rate=at_rate)
            if task.follows:
                more["reference"] = task.reference
            if task.state_low is not None and task.state_high is not None:
                more["limits"] = task.state_low, task.state_high
        more |= {"measured": runs, "target": target, "dt": self.dt, "says": says, "figure": figure}
        return draw_tube(predicted, tube, labels.state_axes, **more)

    def plot_phase(
        self,
        across: str | int,
        up: str | int,
        certificate: Certificate | None = None,
        *,
        measured: ArrayLike | None = None,
        ax: Axes | None = None,
    ) -> Axes:
        """Draw two states against each other: a ring at the start, a dot at the end.

        Parameters
        ----------
        across, up : str or int
            The two states, by name or number.
        certificate : Certificate, optional
            From `bound`, of this plan: draws discs that contain the true states.
        measured : array_like, shape (K + 1, n) or (R, K + 1, n), optional
            The states of one run under this control, or of R runs.
        ax : matplotlib Axes, optional
            Where to draw, as for `Trajectory.plot`.

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        InputError, InputTypeError
            If there is no such state, or the arguments do not fit this plan.

        Examples
        --------
        >>> import stochens_rs as se
        >>> cart = se.System([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]], states=["p", "v"])
        >>> plan = se.control(cart, [1.0, 0.0], [0.0, 0.0], steps=20)
        >>> plan.plot_phase("p", "v").get_ylabel()
        'v'
        """
        at = two_states(self._labels, across, up)
        names = self._labels.state_axes
        tube, says, runs = self._certified(certificate, measured)
        target = self._target
        return draw_phase(
            [(self.predicted_states[:, at], "predicted")],
            (names[at[0]], names[at[1]]),
            radii=tube,
            says=says,
            runs=None if runs is None else runs.reshape(-1, *runs.shape[-2:])[:, :, at],
            target=None if target is None else target[at],
            ax=ax,
        )

    @property
    def _labels(self) -> Labels:
        return self.labels or default_labels(self.predicted_states.shape[1], self.u.shape[1])

    @property
    def _target(self) -> Floats | None:
        """Where the states should end, if the plan leads elsewhere."""
        predicted, target = self.predicted_states, None
        if self.limited is not None and self.limited.task.follows:
            return None
        if isinstance(self.basis, ModelBasis):
            target = None if np.array_equal(self.basis.xf, predicted[-1]) else self.basis.xf
        if target is None and self.limited is not None:
            goal: Floats = self.limited.task.reference[-1]
            off = np.abs(goal - predicted[-1]).max()
            target = goal if off > 1e-6 * np.abs(predicted).max() else None
        return target

    def _certified(
        self, certificate: Certificate | None, measured: ArrayLike | None
    ) -> tuple[Floats | None, str, Floats | None]:
        """The tube, what it says, and the checked runs."""
        predicted = self.predicted_states
        tube, says, runs = None, "", None
        if certificate is not None:
            tube = gate.instance("certificate", certificate, Certificate).tube
            if len(tube) != len(predicted):
                raise ShapeError(
                    f"`certificate` must be of this plan, over {html.counted(len(predicted) - 1)}, "
                    f"got one over {html.counted(len(tube) - 1)}"
                )
            says = f"certified, {100 * (1 - certificate.delta):g} %"
        if measured is not None:
            runs = gate.array("measured", measured, ndim=(2, 3))
            if runs.shape[-2:] != predicted.shape:
                raise ShapeError(
                    f"`measured` must have shape {predicted.shape}, or (R, ..) for R runs, got "
                    f"{runs.shape}"
                )
        return tube, says, runs
