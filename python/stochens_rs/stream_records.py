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
    """How far running means can be from the means of the laws their realizations come from.

    Attributes
    ----------
    state : float
        Radius for the state: ``||B (v - v*)|| <= state``, v* the control of the laws' means.
    x0, xf, A : float
        Radii for the entities, 2-norm (Frobenius for A).
    delta : float
        The probability that one of the radii is exceeded, at any number of realizations, is at
        most this, if `finite_sample`.
    finite_sample : bool
        Whether every range was given, so that the radii hold for any number of realizations,
        however small. Otherwise observed ranges took the place of those missing: larger values
        may not have been seen yet, and the radii are estimates.
    bounds : dict of str to str
        For "x0", "xf" and "A": which bound the radius comes from.
    reason : str or None
        Why a radius is infinite; None if none is.
    covers : str
        What the radii are about. A truth that the laws are biased about is not covered: the mean
        of least-squares fits to noisy states, for example, is not the matrix of the system.
    """

    state: float
    x0: float
    xf: float
    A: float
    delta: float
    finite_sample: bool
    bounds: dict[str, str]
    reason: str | None
    covers: str = "the means of the laws that the realizations come from"

    def _repr_html_(self) -> str:
        return _html.confidence(self)


_SHARE = 0.75  # of delta for the mean, the rest for its variance: about the best for N > 100


def mean_radius(
    count: int, deviation: float, diameter: float, delta: float, size: int | None = None
) -> float:
    """Bound ``||mean - mu||`` for all numbers N of realizations at once.

    `deviation` is ``D = sqrt(sum_i ||E_i - mean||^2)``, `diameter` bounds ``||E - E'||`` by R.
    The bound is tightest at `size`, which must not depend on the data; without one it is nearly
    as tight at every N.

    *Mean.* With ``S_n = sum_i (E_i - mu)``, ``||E_i - mu|| <= R`` and ``V = E ||E - mu||^2``,
    ``cosh(lam ||S_n||) exp(-n V psi(lam))`` is a supermartingale in any Hilbert space,
    ``psi(lam) = lam^2 / (2 (1 - lam R / 3))`` (Pinelis 1994, proof of theorem 3.2 with D = 1, and
    ``e^x - 1 - x <= x^2 / (2 (1 - x / 3))``). As cosh(x) >= e^x / 2, Ville's inequality gives
    ``||S_n|| < (l + n V psi(lam)) / lam`` for all n, but for a probability ``2 e^-l``. With
    ``1 / lam = R / 3 + sqrt(m V / (2 l))`` that is ``||S_n|| < R l / 3 + w sqrt(2 l V n)``,
    ``w = (sqrt(n / m) + sqrt(m / n)) / 2``: at n = m Bernstein's inequality for one size.

    *Variance.* ``Q_n = sum_i ||E_i - mu||^2`` has terms Y in [0, R^2] with ``E Y^2 <= R^2 V``,
    so ``E exp(-lam Y) <= exp(-lam V + lam^2 R^2 V / 2)``, and by Ville's inequality with
    ``lam = sqrt(2 l / (m V R^2))``: ``V - Q_n / n < 2 beta sqrt(V)`` for all n, but for a
    probability ``e^-l``, with ``beta = w R sqrt(l / (2 n))``. And
    ``Q_n / n = D^2 / n + ||S_n / n||^2``.

    *Both.* ``sigma = sqrt(V)`` and ``x = ||S_n / n||`` satisfy ``x <= alpha + gamma sigma`` and
    ``sigma^2 - 2 beta sigma <= D^2 / n + x^2``; the largest such sigma solves a quadratic
    equation. Besides, ``2 V = E ||E - E'||^2 <= R^2``.

    *All sizes.* Epoch k = 1, 2, ... is ``4^k <= n < 4^(k+1)``; it has m = 2 4^k, so w < 1.07, and
    ``delta / (k (k + 1))``, in total delta.
    """
    if count < 2 or diameter == 0.0:
        return diameter if count > 0 else float("inf")
    if size is None:
        k = (count.bit_length() - 1) // 2
        if k == 0:
            return diameter
        size, delta = 2 * 4**k, delta / (k * (k + 1))
    n = float(count)
    w = (np.sqrt(n / size) + np.sqrt(size / n)) / 2.0
    log_mean, log_variance = np.log(2.0 / (_SHARE * delta)), -np.log((1.0 - _SHARE) * delta)
    # x <= alpha + gamma sigma
    alpha, gamma = diameter * log_mean / (3.0 * n), w * np.sqrt(2.0 * log_mean / n)
    beta = w * diameter * np.sqrt(log_variance / (2.0 * n))
    sigma = diameter / np.sqrt(2.0)
    if gamma < 1.0:
        # (1 - gamma^2) sigma^2 - 2 (beta + alpha gamma) sigma - (D^2 / n + alpha^2) <= 0
        half, rest = beta + alpha * gamma, 1.0 - gamma**2
        last = np.sqrt(rest) * np.hypot(deviation / np.sqrt(n), alpha)
        sigma = min(sigma, (half + np.hypot(half, last)) / rest)
    return float(min(alpha + gamma * sigma, diameter))
