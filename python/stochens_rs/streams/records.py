"""Records of a stream: how a run ended, and its errors over the steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .._base import html
from .._base.types import Floats, Status
from ..plots.lines import draw_trace

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.axes import Axes
    from numpy.typing import NDArray


@dataclass(frozen=True)
class StreamRun:
    """The result of `Stream.run`.

    Attributes
    ----------
    status : {"converged", "max_steps", "time_limit", "interrupted"}
        How the run ended. "converged": the stopping rule is satisfied. "max_steps", "time_limit":
        this limit was reached first. "interrupted": Ctrl-C.
    steps : int
        Steps of this run.
    seconds : float
        Duration of this run [s].
    rule : str or None
        "certificate", "printed", or None if no tolerance was given.
    certificate : float or None
        The bound on ``||B (v - v*)||`` at the end.
    error : float
        ``||B (v - v*)||`` at the end.
    """

    status: Status
    steps: int
    seconds: float
    rule: str | None
    certificate: float
    error: float

    def _repr_html_(self) -> str:
        return html.record(self)


@dataclass(frozen=True, eq=False, repr=False)
class Trace:
    """Errors of a stream over its steps: the first 16, then 8 between k and 2 k.

    Attributes
    ----------
    steps : ndarray of int64, shape (k,)
        Number of steps taken.
    certificates : ndarray, shape (k,)
        The bound on ``||B (v - v*)||``.
    errors : ndarray, shape (k,)
        ``||B (v - v*)||`` without the rounding of v to doubles.
    step_sizes : ndarray, shape (k,)
        The step size t of each of these steps (1 at the start).
    """

    steps: NDArray[np.int64]
    certificates: Floats
    errors: Floats
    step_sizes: Floats

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Draw the error and the certificate over the steps, both axes logarithmic.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw. Default: a new figure (``ax.figure``).

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        ImportError
            If matplotlib is not installed.

        Notes
        -----
        Step 0 and zeros cannot be drawn on logarithmic axes and are left out.

        Examples
        --------
        >>> import stochens_rs as se
        >>> system = ([[0.9, 0.2], [0.0, 1.0]], [[1.0], [0.5]])
        >>> stream = se.Stream(system, [1.0, 2.0], [0.0, 0.0], rng=1)
        >>> stream.step(100)
        >>> stream.trace.plot().get_xlabel()
        'step'
        """
        return draw_trace(self.steps, self.errors, self.certificates, ax)

    def _repr_html_(self) -> str:
        return html.card(self, [], html.errors(self.steps, self.errors))

    def __len__(self) -> int:
        return len(self.steps)

    def __repr__(self) -> str:
        last = f"{self.errors[-1]:.3g}" if len(self) else "none"
        end = int(self.steps[-1]) if len(self) else 0
        return f"<Trace: {len(self)} entries up to step {end}, last error {last}>"
