"""Curves of errors against the number of samples, and the panels that hold them.

The errors of every replicate are kept, so that each number shown anywhere (median, band, root
mean square, z-score) can be recomputed from the saved file alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._base import validation
from .._base.numbers import ROUNDING, TINY
from .._base.records import Record
from .._base.types import FUSIONS, Fusion
from ..exceptions import InputError
from ..fusion.fusing import Method

BAND = (0.1, 0.9)  # the shaded band holds the middle 80 % of the replicates

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Curve(Record):
    """The relative error of one method against the number of samples.

    Attributes
    ----------
    method : str
        As in :func:`stochens_rs.fuse`: "uniform", "alse", ...
    fusion : str or None
        "product" or "diagonal" for a control or a state, None for the estimate of one entity.
    errors : (replicates, k) array
        ``errors[r, i]``: relative error of replicate r after ``sizes[i]`` samples.
    exact_rms : (k,) array or None
        Root mean square relative error by the exact second moments; known for uniform weights only.
    exact_spread : (k,) array or None
        ``sqrt(2 tr C^2)`` with the exact (relative) error covariance C: the standard deviation of
        the squared error if the error were Gaussian, which a mean of many samples nearly is.
    """

    method: Method
    fusion: Fusion | None
    errors: FloatArray
    exact_rms: FloatArray | None = None
    exact_spread: FloatArray | None = None

    @property
    def name(self) -> str:
        """The method, followed by "(diagonal)" for diagonal fusion."""
        return f"{self.method} (diagonal)" if self.fusion == "diagonal" else self.method

    @property
    def look(self) -> tuple[Method, Fusion]:
        """The row of `studies.methods.STYLES` that says how the curve is drawn."""
        return self.method, self.fusion or "product"

    @property
    def _quantiles(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        low, median, high = np.quantile(self.errors, (BAND[0], 0.5, BAND[1]), axis=0)
        return low, median, high

    @property
    def median(self) -> FloatArray:
        """(k,) median over the replicates."""
        return self._quantiles[1]

    @property
    def band(self) -> tuple[FloatArray, FloatArray]:
        """The 10 % and the 90 % quantile over the replicates, (k,) each."""
        low, _, high = self._quantiles
        return low, high

    @property
    def single(self) -> FloatArray:
        """(k,) errors of replicate 0: one run, as the paper shows it."""
        single: FloatArray = self.errors[0]
        return single

    @property
    def rms(self) -> FloatArray:
        """(k,) root mean square over the replicates."""
        rms: FloatArray = np.sqrt(np.mean(self.errors**2, axis=0))
        return rms

    @property
    def z(self) -> FloatArray | None:
        r"""(k,) distance of the mean square from its exact value, in standard errors of that mean.

        ``z = (mean(e^2) - exact^2) / (max(std(e^2), exact_spread) / sqrt(replicates))``; None
        without an exact value. The sample standard deviation alone would be far too small
        whenever a rare large error has not occurred yet. For many replicates \|z\| is at most
        standard normal; the sizes of one curve are prefixes of the same samples, so their z are
        correlated.
        """
        if self.exact_rms is None or self.exact_spread is None:
            return None
        squares = self.errors**2
        replicates = squares.shape[0]
        spread = np.maximum(squares.std(axis=0, ddof=min(1, replicates - 1)), self.exact_spread)
        # An error that cannot vary (samples of a vector with one entry) must hit its value to
        # rounding.
        rounding = ROUNDING * self.exact_rms**2 + TINY
        z: FloatArray = (squares.mean(axis=0) - self.exact_rms**2) / np.maximum(
            spread / math.sqrt(replicates), rounding
        )
        return z


@dataclass(frozen=True, eq=False)
class Panel(Record):
    """One axes of a figure: the same quantity by every method.

    Attributes
    ----------
    name : str
        "1a", "1b", ...: the paper's figure and letter.
    figure : str or None
        Number of the figure that shows it; None if it appears in the table only.
    quantity : str
        What is estimated, in words.
    symbol : str
        The relative error as a formula (mathtext).
    norm : float
        What the errors were divided by.
    zero_level : float
        Relative errors up to here cannot be told from zero.
    zero_label : str
        Why not: rounding, or the solver's tolerance.
    curves : tuple of Curve
        One per method (and fusion).
    """

    name: str
    figure: str | None
    quantity: str
    symbol: str
    norm: float
    zero_level: float
    zero_label: str
    curves: tuple[Curve, ...]

    def curve(self, method: str, fusion: str | None = None) -> Curve:
        """The curve of one method.

        Parameters
        ----------
        method : str
            As in :func:`stochens_rs.fuse`: "uniform", "alse", ...
        fusion : str, optional
            "product" or "diagonal"; default: product where the panel distinguishes them.

        Returns
        -------
        Curve

        Raises
        ------
        InputError, InputTypeError
            There is no such curve.
        """
        validation.choice("method", method, tuple(dict.fromkeys(one.method for one in self.curves)))
        if fusion is not None:
            validation.choice("fusion", fusion, FUSIONS)
        for curve in self.curves:
            if curve.method == method and (
                curve.fusion == fusion or (fusion is None and curve.fusion == "product")
            ):
                return curve
        raise InputError(f"panel {self.name} has no curve {method!r} with fusion {fusion!r}")
