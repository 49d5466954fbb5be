"""Curves of errors against the number of samples, and the panels that hold them.

The errors of every replicate are kept, so that each number shown anywhere (median, band, root
mean square, z-score) can be recomputed from the saved file alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from stochens_rs.exceptions import InputError

from . import common as check
from .common import FUSIONS, ROUNDING, TINY, Floats, Fusion, Method

BAND = (0.1, 0.9)  # the shaded band holds the middle 80 % of the replicates


@dataclass(frozen=True, eq=False)
class Curve:
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
    errors: Floats
    exact_rms: Floats | None = None
    exact_spread: Floats | None = None

    @property
    def name(self) -> str:
        """The method, followed by "(diagonal)" for diagonal fusion."""
        return f"{self.method} (diagonal)" if self.fusion == "diagonal" else self.method

    @property
    def look(self) -> tuple[Method, Fusion]:
        """The row of `paper.methods.STYLES` that says how the curve is drawn."""
        return self.method, self.fusion or "product"

    @property
    def _quantiles(self) -> tuple[Floats, Floats, Floats]:
        low, median, high = np.quantile(self.errors, (BAND[0], 0.5, BAND[1]), axis=0)
        return low, median, high

    @property
    def median(self) -> Floats:
        """(k,) median over the replicates."""
        return self._quantiles[1]

    @property
    def band(self) -> tuple[Floats, Floats]:
        """The 10 % and the 90 % quantile over the replicates, (k,) each."""
        low, _, high = self._quantiles
        return low, high

    @property
    def single(self) -> Floats:
        """(k,) errors of replicate 0: one run, as the paper shows it."""
        single: Floats = self.errors[0]
        return single

    @property
    def rms(self) -> Floats:
        """(k,) root mean square over the replicates."""
        rms: Floats = np.sqrt(np.mean(self.errors**2, axis=0))
        return rms

    @property
    def z(self) -> Floats | None:
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
        z: Floats = (squares.mean(axis=0) - self.exact_rms**2) / np.maximum(
            spread / math.sqrt(replicates), rounding
        )
        return z


@dataclass(frozen=True, eq=False)
class Panel:
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
        check.choice("method", method, tuple(dict.fromkeys(one.method for one in self.curves)))
        if fusion is not None:
            check.choice("fusion", fusion, FUSIONS)
        for curve in self.curves:
            if curve.method == method and (
                curve.fusion == fusion or (fusion is None and curve.fusion == "product")
            ):
                return curve
        raise InputError(f"panel {self.name} has no curve {method!r} with fusion {fusion!r}")


def panel_from(data: Mapping[str, Any]) -> Panel:
    """The panel of plain data, as `plain` makes them."""

    def curve(one: Mapping[str, Any]) -> Curve:
        exact = [
            None if one[name] is None else np.array(one[name], dtype=np.float64)
            for name in ("exact_rms", "exact_spread")
        ]
        errors = np.array(one["errors"], dtype=np.float64)
        return Curve(one["method"], one["fusion"], errors, *exact)

    values = {one.name: data[one.name] for one in fields(Panel)}
    return Panel(**{**values, "curves": tuple(map(curve, values["curves"]))})
