"""The figure of a plan."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import gate, html
from .._base.labels import Labels, default_labels
from ..exceptions import ShapeError
from ..plots.panels import Inputs
from ..plots.tube import draw_tube
from .basis import ModelBasis
from .certificate import Certificate

if TYPE_CHECKING:
    from matplotlib.figure import Figure
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

    def plot(
        self, certificate: Certificate | None = None, *, measured: ArrayLike | None = None
    ) -> Figure:
        """Draw the predicted states, each in its panel; within limits the inputs too.

        An input is drawn as steps, its limits as a grey band, thick where it is at one of them.

        Parameters
        ----------
        certificate : Certificate, optional
            From `bound`, of this plan: draws the tube that contains the true states.
        measured : array_like, shape (K + 1, n) or (R, K + 1, n), optional
            The states of one run under this control, or of R runs.

        Returns
        -------
        matplotlib Figure

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
        predicted, basis = self.predicted_states, self.basis
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
        dt, target = None, None
        labels = self.labels or default_labels(predicted.shape[1], self.u.shape[1])
        if isinstance(basis, ModelBasis):
            dt = basis.model.dt
            target = None if np.array_equal(basis.xf, predicted[-1]) else basis.xf
        more: dict[str, Any] = {}
        if self.limited is not None:
            task = self.limited.task
            off = np.abs(task.reference[-1] - predicted[-1]).max()
            if target is None and off > 1e-6 * np.abs(predicted).max():
                target = task.reference[-1]
            more["inputs"] = Inputs(self.u, labels.input_axes, task.low, task.high)
            if task.follows:
                more["reference"], target = task.reference, None
            if task.state_low is not None and task.state_high is not None:
                more["limits"] = task.state_low, task.state_high
        names = labels.state_axes
        return draw_tube(
            predicted, tube, names, measured=runs, target=target, dt=dt, says=says, **more
        )
