"""Bounds from simulated errors, within a few percent of the quantile they bound."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ..._base import gate
from ..._base.types import Axis, Fusion, Scheme
from ...exceptions import InputError, InputTypeError, SizeError
from ...rng import RngLike, as_key
from ..formulas import AXES, Sizes, inverse_size, one_each
from ._base import Bound, Rates
from ._simulation import (
    Entity,
    Errors,
    EstimateErrors,
    PlanErrors,
    exceedances,
    radii,
    runs_for,
    smallest_size,
)
from .fused import _check_equal

SimulatedOf: TypeAlias = Literal["vector", "matrix", "state", "control"]

_NORMS = {
    "vector": ("2", "1"),
    "matrix": ("spectral", "Frobenius"),
    "state": ("2",),
    "control": ("2",),
}


class Simulated(Bound):
    """The order statistic of simulated errors: a bound within a few percent of the quantile.

    Parameters
    ----------
    quantity : {"vector", "matrix", "state", "control"}
        What the error is of.
    *data : array_like
        ``w``; ``A``; ``B, x0, xf, A`` for a state or a control, as in :func:`candidates`.
    norm : str, optional
        Vector: "2" (default) or "1". Matrix: "spectral" (default) or "Frobenius".
    fusion : {"product", "diagonal"}, default "product"
        For a state or a control.
    axis : {"columns", "rows"}, default "columns"
        Which lines of the matrices are sampled.
    scheme : {"iid", "systematic"}, default "iid"
        How the realizations are drawn.
    steps : int, optional
        For a state or a control over so many steps, ``C_K`` in place of ``B``; product fusion.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, default 0
        Source of randomness, in streams of its own; with the default the same errors in every
        call.

    Raises
    ------
    InputError, InputTypeError
        An array does not fit, a choice is unknown, or diagonal fusion is asked for where it is
        not defined: over several steps, and for systematic rows.

    Notes
    -----
    R independent errors are drawn from the law, each from counts at a cost of O(n^2), and one of
    the largest is taken: the one that j others exceed, j the largest number with
    ``P(Bin(R, 0.9 delta) <= j) <= 0.01 delta`` (Clopper and Pearson, 1934). It fails with
    probability delta at most, over the realizations and the simulation together. R is at most
    131072: as many as take about half a second, and more where delta needs them. There is no bound
    for delta below about 1e-4, nor where the runs would take more than 10 seconds of one thread.
    `required_size` looks at ten sizes at most and ends within 1 % of the smallest sufficient one.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> data = [[1.0], [0.0]], [1.0, 1.0], [2.0, 2.0], [[1.0, 0.0], [2.0, 5.0]]
    >>> every = bounds.Simulated("state", *data), bounds.ProductMcDiarmid(*data)
    >>> [round(bound.radius(1000, 0.01), 1) for bound in every]
    [0.2, 0.4]
    """

    name = "simulated"
    source = "order statistic of errors drawn from the law; its own chance of failure is in delta"

    def __init__(
        self,
        quantity: SimulatedOf,
        *data: ArrayLike,
        norm: str | None = None,
        fusion: Fusion = "product",
        axis: Axis = "columns",
        scheme: Scheme = "iid",
        steps: int | None = None,
        rng: RngLike = 0,
    ) -> None:
        self.quantity = gate.choice("quantity", quantity, tuple(_NORMS))
        norms = _NORMS[self.quantity]
        self.norm = norms[0] if norm is None else gate.choice("norm", norm, norms)
        self._rows = gate.choice("axis", axis, AXES) == "rows"
        iid = gate.choice("scheme", scheme, ("iid", "systematic")) == "iid"
        self._scheme: Scheme = "iid" if iid else "systematic"
        paired = gate.choice("fusion", fusion, ("product", "diagonal")) == "diagonal"
        self._key = as_key(rng).child("simulated bound")
        self._plan: PlanErrors | None = None
        expected = 4 if self.quantity in ("state", "control") else 1
        if len(data) != expected:
            raise InputTypeError(f"`data` must be {expected} arrays here, got {len(data)}")
        if expected == 1:
            if self.quantity == "vector":
                lines = gate.vector("w", data[0])[None]
            else:
                A = gate.matrix("A", data[0])
                lines = A if self._rows else A.T
            self._lines = np.ascontiguousarray(lines)
            return
        B = gate.matrix("B", data[0])
        x0, xf = (
            gate.vector(name, value, length=len(B))
            for name, value in zip(("x0", "xf"), data[1:3], strict=True)
        )
        A = gate.matrix("A", data[3], rows=len(B), cols=len(B))
        if paired and (steps is not None or (self._rows and not iid)):
            raise InputError(
                "`fusion` must be 'product' over several steps and for systematic rows, got "
                "'diagonal'"
            )
        self._plan = PlanErrors(
            B,
            Entity(x0, scheme=self._scheme),
            Entity(xf, scheme=self._scheme),
            Entity(A, scheme=self._scheme),
            steps=None if steps is None else gate.size("steps", steps),
            paired=paired,
            rows=self._rows,
        )

    @property
    def _which(self) -> int:
        return int(self.quantity == "control")

    def _errors(self, rates: Rates) -> Errors:
        sizes = tuple(round(1.0 / rate) if rate > 0.0 else None for rate in rates)
        if self._plan is not None:
            return self._plan.sized(sizes)
        assert sizes[0] is not None  # `_radius` and `_level` see to it
        return EstimateErrors(self._lines, self.norm, sizes[0], self._scheme)

    def errors(self, size: Sizes) -> Errors:
        """The law of the errors for a number of realizations.

        Parameters
        ----------
        size : int, None or (N0, Nf, NA)
            As in :meth:`radius`.

        Returns
        -------
        Errors
            ``errors.draw(runs, key)`` gives independent errors, (runs, 1); for a state or a
            control (runs, 2), of both.

        Raises
        ------
        InputError, InputTypeError
            As :meth:`radius`; or the size of a vector or matrix is None: nothing is random.
        """
        rates = self._rates(size)
        if self._plan is None and not any(rates):
            raise SizeError("`size` must be a number here: exact values have no errors")
        return self._errors(rates)

    def require(self, delta: float) -> None:
        """Refuse a probability of failure that cannot be simulated.

        Parameters
        ----------
        delta : float
            Probability of failure, in (0, 1).

        Raises
        ------
        InputError, InputTypeError
            `delta` is none, or too small: below about 1e-4, more where one run is slow.
        """
        if not self._possible(1, gate.probability("delta", delta)):
            raise SizeError(_no_bound(delta))

    def _possible(self, size: Sizes, delta: float) -> bool:
        """Whether there is a bound for this delta: not below about 1e-4, nor if a run is slow."""
        rates = self._rates(size)
        return not any(rates) or runs_for(delta, self._errors(rates).cost) is not None

    def _radius(self, rates: Rates, level: float) -> float:
        if not any(rates):
            return 0.0
        found = radii(self._errors(rates), math.exp(-level), self._key)
        return math.inf if found is None else found[self._which]

    def _level(self, rates: Rates, eps: float) -> float:
        if not any(rates):
            return math.inf
        errors = self._errors(rates)
        runs = runs_for(0.01, errors.cost)
        if runs is None:
            return 0.0
        drawn = errors.draw(runs, self._key)
        # what rounding adds to an error in the middle
        off = errors.rounded(tuple(float(np.median(one)) for one in drawn.T))[self._which]
        drawn = drawn[:, self._which]
        beyond = int((drawn + (off - float(np.median(drawn))) > eps).sum())
        known, unknown = 0.0, math.log(runs)
        for _ in range(40):
            middle = (known + unknown) / 2.0
            allowed = exceedances(runs, math.exp(-middle))
            if allowed is not None and beyond <= allowed:
                known = middle
            else:
                unknown = middle
        return known

    def _required(self, eps: float, delta: float, same: Callable[[float], Rates]) -> int:
        eps, delta = gate.positive("eps", eps), gate.probability("delta", delta)
        self.require(delta)
        found = smallest_size(
            lambda size: self._errors(same(1.0 / size)), self._which, eps, delta, self._key
        )
        if found is None:
            raise SizeError(f"`eps` is {eps:.3g}: more than 2^53 realizations would be needed")
        return found

    def _rates(self, size: Sizes) -> Rates:
        if self._plan is None:
            return (inverse_size("size", size),)
        rates = tuple(inverse_size(f"size[{k}]", N) for k, N in enumerate(one_each(size)))
        if self._plan.paired:
            _check_equal(rates, "diagonal fusion pairs the realizations")
        return rates

    def _same(self, rate: float) -> Rates:
        return (rate,) if self._plan is None else (rate, rate, rate)

    def _in_units(self, radius: float) -> float:
        if radius == math.inf:
            raise SizeError(_no_bound(None))
        return super()._in_units(radius)


def _no_bound(delta: float | None) -> str:
    found = "" if delta is None else f", got {delta:.3g}"
    return (
        f"`delta` must be at least about 1e-4, and more for large systems, to be simulated{found}"
    )
