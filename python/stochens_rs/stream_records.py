"""What a stream hands out: how a run ended, what it wrote down, what the data say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from . import _html

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

__all__ = ["Confidence", "StreamRun", "Trace"]


@dataclass(frozen=True)
class StreamRun:
    """How one `Stream.run` ended.

    Attributes
    ----------
    status : str
        "converged": the rule is satisfied. "max_steps", "time_limit": the limit was met first.
        "interrupted": Ctrl-C.
    steps : int
        Steps of this run.
    seconds : float
        Time it took [s].
    rule : str or None
        "certificate", "printed", or None if no tolerance was given.
    certificate : float or None
        The bound on ``||B (v - v*)||`` at the end; None for a variant without one.
    error : float
        ``||B (v - v*)||`` at the end.
    """

    status: str
    steps: int
    seconds: float
    rule: str | None
    certificate: float | None
    error: float

    def _repr_html_(self) -> str:
        return _html.record(self)


@dataclass(frozen=True, eq=False, repr=False)
class Trace:
    """What a stream wrote down: the first 16 steps, then 8 in every octave.

    Attributes
    ----------
    steps : ndarray of int64, shape (k,)
        After how many steps.
    certificates : ndarray, shape (k,)
        The bound on ``||B (v - v*)||``; nan for a variant without one.
    errors : ndarray, shape (k,)
        ``||B (v - v*)||``.
    sizes : ndarray, shape (k,)
        The step size t of each of these steps (1 at the start).
    """

    steps: NDArray[np.int64]
    certificates: NDArray[np.float64]
    errors: NDArray[np.float64]
    sizes: NDArray[np.float64]

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Draw the error and the certificate over the steps, both axes logarithmic.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw. Default: new axes on a figure of their own (``ax.figure``).

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        ImportError
            If matplotlib is not installed.

        Notes
        -----
        A logarithmic axis has no place for step 0 and for zeros; they are left out.

        Examples
        --------
        >>> import stochens_rs as se
        >>> stream = se.Stream([[1.0], [0.5]], [1.0, 2.0], [0.0, 0.0], [[0.9, 0.2], [0, 1]], rng=1)
        >>> stream.step(100)
        >>> stream.trace.plot().get_xlabel()
        'step'
        """
        from ._stream_drawing import draw_trace
        from .plots import require_matplotlib

        require_matplotlib()
        return draw_trace(self, ax)

    def _repr_html_(self) -> str:
        return _html.trace(self)

    def __len__(self) -> int:
        return len(self.steps)

    def __repr__(self) -> str:
        last = f"{self.errors[-1]:.3g}" if len(self) else "none"
        end = int(self.steps[-1]) if len(self) else 0
        return f"<Trace: {len(self)} steps written down, up to {end}, last error {last}>"


@dataclass(frozen=True)
class Confidence:
    """How far running means can be from what they estimate, as far as the data say.

    Attributes
    ----------
    state : float
        Radius for the state: ``||B (v - v*)|| <= state``.
    x0, xf, A : float
        Radii for the entities, 2-norm (Frobenius for A). Infinite, and with it `state`, where
        there is one realization and no range.
    delta : float
        The probability that one of them is exceeded, at any time, is at most this, if
        `guaranteed`.
    guaranteed : bool
        Whether every range was given. Otherwise observed ranges took their place: the law may
        have larger values that were not seen, and nothing is guaranteed.
    """

    state: float
    x0: float
    xf: float
    A: float
    delta: float
    guaranteed: bool

    def _repr_html_(self) -> str:
        return _html.record(self)


def mean_radius(count: int, deviation: float, diameter: float, delta: float) -> float:
    """``||mean - E||`` for all numbers of realizations at once (see `DataStream.confidence`).

    `deviation` is ``sqrt(sum_i ||E_i - mean||^2)``, `diameter` bounds ``||E - E'||``.
    """
    if count < 2 or diameter == 0.0:
        return diameter if count > 0 else float("inf")
    # the union over all N >= 2: sum 1 / (N (N - 1)) = 1; one half for V, one for the mean
    log = float(np.log(2.0) + np.log(count) + np.log(count - 1.0) - np.log(delta))
    part = diameter * np.sqrt(log / count)
    sigma = np.hypot(deviation / np.sqrt(count - 1.0), part) + part
    sigma = min(sigma, diameter / np.sqrt(2.0))  # 2 V = E ||E - E'||^2 <= R^2
    double = log + np.log(2.0)  # a norm has two sides
    a = diameter * double / (3.0 * count)
    radius = a + np.hypot(a, sigma * np.sqrt(2.0 * double / count))
    return float(min(radius, diameter))
