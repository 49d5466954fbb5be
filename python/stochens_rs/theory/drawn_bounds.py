r"""Bounds on the errors of averages and of fused controls, before anything is sampled.

R independent errors are simulated and sorted; the bound is ``e_(R-j)``, the one that j of them
exceed. It is too small if at most j errors lie beyond ``q``, the ``1 - d`` quantile of the error:
``P(e_(R-j) < q) <= P(Bin(R, d) <= j)`` (Clopper and Pearson, 1934). With ``d = 0.9 delta`` and j
the largest for which that probability is at most ``0.01 delta``, the error exceeds the bound with
probability at most ``0.91 delta``. A search for a size tries ten of them, each of which may be too
small with probability ``0.01 delta``: ``0.9 + 10 * 0.01 = 1``.

Where R is too small for that, about ``12 / delta``, the bound is the largest of ``R >= 4 / delta``
errors. The error of the plan and the R simulated ones are exchangeable, so that it is the largest
of all with probability at most ``1 / (R + 1) < delta / 4``. Of ten sizes in a search, one with the
quantile p beyond eps passes and fails with probability ``p (1 - p)^R <= 1 / (e R)``, together at
most ``10 / (e R) <= 0.92 delta``.

Smaller delta have formulas, for independent realizations (``rust/tails/``), and systematic samples
of a vector or a matrix a bound that is never exceeded.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from .. import _core
from .._base import running, types, validation
from .._base.running import get_num_threads
from .._base.types import Axis, Floats, Fusion, Scheme, norm, smallest_size
from ..exceptions import InputError, InputTypeError, SizeError
from ..rng import Key, RngLike, as_key
from .exact import EPS, best_control, checked_ends, checked_finite
from .moments import Sizes, count, counts, lines_of

# The norms of the error of each quantity, the default first.
NORMS = {
    "vector": ("2", "1"),
    "matrix": ("spectral", "Frobenius"),
    "state": ("2",),
    "control": ("2",),
}

# The formulas for averages, by the norm of the error.
_FORMULAS = {
    "2": ("Bousquet", "Weissman"),
    "1": ("Weissman",),
    "spectral": ("Bernstein", "Bousquet"),
    "Frobenius": ("Bousquet",),
}
_LOOKS = 10  # sizes that share delta: see above
# Number of errors: 200 / delta of them give a bound of 1.02 to 1.1 times the quantile.
_RUNS, _LEAST = 200.0, 4.0
_TINY = 1e-9  # relative; delta comes as exp(-log(1 / delta))
_FEWEST, _ENOUGH, _MOST = 8192, 1 << 17, 1 << 21
_BUDGET = 5e8  # ns: no more errors than 4 / delta if they would take longer
_LONGEST = 1e10  # ns: no bound if 4 / delta errors would take longer
# Costs [ns], measured on one thread (x86-64) for n from 5 to 100, most within a factor of two. They
# decide how many errors are drawn, and change no probability.
_DRAW = 100.0  # one binomial draw
_PER_PRODUCT = 30.0  # an entry in one product of the spectral norm
_PER_PAIR = 15.0  # a pair of systematic realizations
# The factors of C_K: fixed, per entry, and per entry and row; singular values, and of full rank
_SINGULAR, _FULL_RANK = (1.5e4, 100.0, 1.3), (5e3, 20.0, 0.1)
# The search for a size.
_START = 1000  # the first size
_PILOT, _PILOTS, _GUESSED = 1024, 30, 1.1  # errors, sizes, and the factor that is near enough
_CLOSE, _NEAR = 1.01, 1.05  # it ends so near the smallest size; if a size takes the budget or more
_SLOPES = -2.0, -0.3  # range of the fitted power of the size; -1/2 for many realizations
_ROUNDING = 16.0 * EPS  # of a sum, per term and unit


def drawn_bound(
    quantity: str,
    *data: Any,
    size: Sizes,
    delta: float,
    norm: str | None = None,
    fusion: Fusion = "product",
    axis: Axis = "columns",
    scheme: Scheme = "iid",
    steps: int = 1,
    rng: RngLike = 0,
) -> tuple[float, str]:
    """Bound the error of an average, a state or a control that is exceeded with probability delta.

    Parameters
    ----------
    quantity : {"vector", "matrix", "state", "control"}
        The quantity whose error is bounded.
    *data : System or array_like
        ``w``; ``A``; ``system, x0, xf`` for a state or a control. `system` is a System or what
        `System.from_any` takes, such as ``(A, B)``.
    size : int, None or (N0, Nf, NA)
        Number of realizations, up to 2^53; None or inf: known exactly. For a state or a control
        one number for all entities or one each.
    delta : float
        Probability of failure, in (0, 1).
    norm : str, optional
        Vector: "2" (default) or "1". Matrix: "spectral" (default) or "Frobenius". The others are
        in the 2-norm.
    fusion : {"product", "diagonal"}, default "product"
        For a state or a control; "diagonal" has one size, and one step.
    axis : {"columns", "rows"}, default "columns"
        Which lines of the matrix are sampled; not for a vector.
    scheme : {"iid", "systematic"}, default "iid"
        How the realizations are drawn.
    steps : int, default 1
        For a state or a control: number of steps K.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, default 0
        Source of randomness; with the default equal errors in every call.

    Returns
    -------
    radius : float
        The bound, in the units of the quantity.
    method : str
        "simulated": the order statistic of errors drawn from their law. Otherwise the smallest of
        the formulas, by its name: "Bousquet", "McDiarmid", "Weissman", "Bernstein", "systematic";
        "exact" if nothing is random.

    Raises
    ------
    InputError, InputTypeError
        A choice is unknown or has no effect, the data do not fit, or `delta` is too small to be
        simulated where there is no formula: over several steps, and for systematic samples of a
        state or a control.

    Notes
    -----
    Holds for uniform weights. The order statistic is within a few percent of the quantile. It is
    taken where ``4 / delta`` errors can be drawn in 10 seconds of one thread: for delta from 2e-6
    on for a few states, 3e-5 for n = 20 over four steps, 7e-4 for n = 100. The formulas are one and
    a half to several times as large.

    Examples
    --------
    >>> import stochens_rs as se
    >>> radius, method = se.theory.drawn_bound("vector", [3.0, -1.0, 0.5], size=10_000, delta=0.01)
    >>> 0.07 < radius < 0.08, method
    (True, 'simulated')
    >>> radius, method = se.theory.drawn_bound("vector", [3.0, -1.0, 0.5], size=10_000, delta=1e-9)
    >>> round(radius, 3), method
    (0.211, 'Bousquet')
    """
    of = Bounded(quantity, data, norm, fusion, axis, scheme, steps)
    delta, sizes = validation.probability("delta", delta), of.sizes(size)
    least = of.least(sizes, delta)
    if least[0] == 0.0 or not any(sizes):
        return 0.0, "exact"
    law = of.law(sizes)
    drawn = radii(law, delta, as_key(rng).child("simulated bound"))
    if drawn is not None:
        return drawn[of.which], "simulated"
    if least[0] == math.inf:
        raise SizeError(not_simulated(delta, law.cost))
    return least


class Bounded:
    """A quantity to be bounded, checked: the law of its error, and the formulas that bound it."""

    def __init__(
        self,
        quantity: object,
        data: tuple[Any, ...],
        norm: object = None,
        fusion: object = "product",
        axis: object = "columns",
        scheme: object = "iid",
        steps: object = 1,
    ) -> None:
        self.quantity = validation.choice("quantity", quantity, tuple(NORMS))
        control = self.quantity in types.QUANTITIES
        if len(data) != (3 if control else 1):
            expected = "system, x0, xf" if control else "one array"
            raise InputTypeError(f"`data` of a {self.quantity} must be {expected}, got {len(data)}")
        norms = NORMS[self.quantity]
        self.norm = norms[0] if norm is None else validation.choice("norm", norm, norms)
        self.paired = validation.choice("fusion", fusion, types.FUSIONS) == "diagonal"
        lines = validation.choice("axis", axis, types.AXES)
        self.rows = lines == "rows"
        self.scheme: Scheme = validation.choice("scheme", scheme, types.SCHEMES)
        K = validation.size("steps", steps)
        self.which = int(self.quantity == "control")  # column of the drawn errors
        vector = self.quantity == "vector"
        for name, value, default, refused in (
            ("fusion", fusion, "product", not control),
            ("steps", steps, 1, not control),
            ("axis", axis, "columns", vector),
        ):
            if refused and value != default:
                raise InputError(
                    f"`{name}` must be {default!r} of a {self.quantity}, got {value!r}"
                )
        self.plan: PlanErrors | None = None
        if control:
            if self.paired and (K > 1 or (self.rows and self.scheme == "systematic")):
                text = "`fusion` must be 'product' over several steps and for systematic rows"
                raise InputError(f"{text}, got 'diagonal'")
            system, x0, xf = checked_ends(*data)
            entities = (DrawnEntity(value, scheme=self.scheme) for value in (x0, xf, system.A))
            self.plan = PlanErrors(system.B, *entities, steps=K, paired=self.paired, rows=self.rows)
        elif vector:
            self.lines = validation.vector("w", data[0])[None, :]
        else:
            self.lines = lines_of(validation.matrix("A", data[0]), lines)
        self._cores: dict[str, _core.TailBounds] = {}

    def sizes(self, size: Sizes) -> tuple[int | None, ...]:
        """The checked number of realizations of each entity; None: known exactly."""
        given = (count("size", size),) if self.plan is None else counts(size)
        sizes = tuple(int(N) or None for N in given)
        if self.paired and _differ(sizes):
            raise InputError(
                "`size` must be one number here (diagonal fusion pairs the realizations), "
                f"got N0, Nf, NA = {', '.join(map(str, sizes))}"
            )
        return sizes

    def law(self, sizes: tuple[int | None, ...]) -> ErrorLaw:
        """The law of the errors for these numbers of realizations."""
        if self.plan is not None:
            return self.plan.sized(sizes)
        assert sizes[0] is not None  # or there is no error
        return EstimateErrors(self.lines, self.norm, sizes[0], self.scheme)

    def names(self, sizes: tuple[int | None, ...]) -> tuple[str, ...]:
        """The formulas that hold."""
        if self.scheme == "systematic":
            return ("systematic",) if self.plan is None and self.norm != "1" else ()
        if self.plan is None:
            return _FORMULAS[self.norm]
        if self.plan.several:
            return ()
        if self.paired:
            return ("Bousquet",)
        # of product fusion it has one linear term for each index
        return ("McDiarmid",) if _differ(sizes) else ("McDiarmid", "Bousquet")

    def radius(self, name: str, sizes: tuple[int | None, ...], delta: float) -> float:
        """The radius of a formula, at most the largest possible error."""
        core = self._core(name)
        rates = [0.0 if N is None else 1.0 / N for N in sizes]
        found = min(core.radius(name, rates, -math.log(delta)), core.cap(rates))
        return checked_finite(float(found * core.unit), "radius")

    def least(self, sizes: tuple[int | None, ...], delta: float) -> tuple[float, str]:
        """The smallest radius of all formulas that hold, with its name; inf if none does."""
        found = [(self.radius(name, sizes, delta), name) for name in self.names(sizes)]
        return min(found, key=lambda one: one[0], default=(math.inf, "none"))

    def required_size(self, name: str, eps: float, delta: float) -> int | None:
        """The smallest size with a radius of at most `eps` by a formula; None: above 2^53."""
        entities = 1 if self.plan is None else 3
        return smallest_size(lambda N: self.radius(name, (N,) * entities, delta) <= eps)

    def _core(self, name: str) -> _core.TailBounds:
        """The numbers of the formulas; of a matrix all but Bernstein's bound the Frobenius norm."""
        norm = self.norm if self.quantity != "matrix" or name == "Bernstein" else "Frobenius"
        if norm not in self._cores:
            if self.plan is None:
                self._cores[norm] = _core.TailBounds(self.lines, norm)
            else:
                x0, xf, A = (entity.values for entity in self.plan.entities)
                running.need("the moments of the control", 20 * A.nbytes)  # that live at once
                how = self.rows, self.quantity == "control", self.paired
                data = A, self.plan.B, x0.copy(), xf.copy()
                self._cores[norm] = _core.TailBounds(*data, *how)
        return self._cores[norm]


def _differ(sizes: tuple[int | None, ...]) -> bool:
    """Whether the entities that are not exact have different sizes."""
    return len(set(sizes) - {None}) > 1


# -- laws of errors ----------------------------------------------------------------------------


class ErrorLaw(Protocol):
    """The law of one or several errors."""

    @property
    def cost(self) -> float:
        """Approximate time of one run [ns]."""

    def rounded(self, radii: tuple[float, ...]) -> tuple[float, ...]:
        """The radii with what rounding can add to each."""

    def draw(self, runs: int, key: Key) -> Floats:
        """Independent errors, (runs, number of errors)."""


@dataclass(frozen=True, eq=False)
class EstimateErrors:
    """``||average - mean||`` for `size` realizations of the lines of a vector or a matrix."""

    lines: Floats
    norm: str
    size: int
    scheme: Scheme

    @property
    def cost(self) -> float:
        """As `ErrorLaw.cost`."""
        products = min(self.lines.shape) if self.norm == "spectral" else 0
        return (_DRAW + _PER_PRODUCT * products) * self.lines.size

    def rounded(self, radii: tuple[float, ...]) -> tuple[float, ...]:
        """As `ErrorLaw.rounded`."""
        return (radii[0] + _ROUNDING * float(np.abs(self.lines).sum()),)

    def draw(self, runs: int, key: Key) -> Floats:
        """Independent errors, (runs, 1)."""
        norm = "2" if self.norm == "Frobenius" else self.norm
        how = norm, runs, self.cost, key.bytes32, get_num_threads()
        return _core.simulate_estimates(self.lines, self.size, self.scheme, *how)[:, None]


@dataclass(frozen=True, eq=False)
class DrawnEntity:
    """One entity of a control: its exact values, and what the control uses in their place.

    That is the `estimate`, the same in every run; or the average of `size` realizations, drawn anew
    in every run; or, without both, the values themselves.
    """

    values: Floats
    estimate: Floats | None = None
    size: int | None = None
    scheme: Scheme = "iid"

    @property
    def drawn(self) -> bool:
        """Whether every run draws an average anew."""
        return self.estimate is None and self.size is not None

    def argument(self, transpose: bool = False) -> Any:
        """The argument of the core: lines, and size and scheme if they are drawn."""
        lines = np.atleast_2d(self.values if self.estimate is None else self.estimate)
        drawn = (self.size, self.scheme) if self.drawn else None
        return np.ascontiguousarray(lines.T if transpose else lines), drawn


class PlanErrors:
    """The errors of a fused control: ``||C (u - v)||`` and ``||u - v||``.

    ``v = C^+ (xf - A^K x0)`` is the exact control, ``C = C_K = [B, A B, ..., A^{K-1} B]`` for
    K = `steps`; `entities` are x0, xf and A.
    """

    def __init__(
        self, B: Floats, *entities: DrawnEntity, steps: int, paired: bool, rows: bool
    ) -> None:
        self.B, self.entities, self.paired, self.rows = B, entities, paired, rows
        self.several = steps > 1
        x0, xf, A = (entity.values for entity in entities)
        self.best = best_control(A, B, x0, xf, steps)

    def sized(self, sizes: tuple[int | None, ...]) -> PlanErrors:
        """The same problem with other numbers of realizations ``(N0, Nf, NA)``."""
        other = copy(self)  # shares the factors
        pairs = zip(self.entities, sizes, strict=True)
        other.entities = tuple(replace(entity, size=N) for entity, N in pairs)
        return other

    @property
    def random(self) -> bool:
        """Whether anything is drawn."""
        return any(entity.drawn for entity in self.entities)

    @property
    def cost(self) -> float:
        """As `ErrorLaw.cost`."""
        (n, m), s = self.B.shape, self.best.factors.s
        width = m * self.best.steps
        cost: float = _DRAW * (n * n + 2 * n)
        if self.several:
            # as `rust/control/steps.rs` chooses, here for the exact C_K
            condition = norm(s) * norm(1.0 / s) if len(s) == n <= width else math.inf
            fast = condition**3 * width * EPS <= 1.0
            fixed, entry, product = _FULL_RANK if fast else _SINGULAR
            cost += fixed + (entry + product * min(n, width)) * n * width
        x0, _, A = self.entities
        if self.paired and x0.drawn and A.drawn and A.scheme == "systematic":
            cost += _PER_PAIR * float(A.size or 0)
        return cost

    def rounded(self, radii: tuple[float, ...]) -> tuple[float, float]:
        """The radii with what rounding can add to the errors drawn, and to a control like v."""
        # ||y_hat - y|| at most: g_f + g_A g_0 for averages, and ||y||
        x0, xf, A = (np.abs(e.values if e.estimate is None else e.estimate) for e in self.entities)
        lines = A.sum(axis=1 if self.rows else 0)
        g_A = float(np.linalg.norm(lines) if self.rows else lines.max())
        state, control = radii
        largest = norm(self.best.needed) + float(xf.sum()) + g_A * float(x0.sum())
        return self.best.with_rounding(state, control, largest)

    def draw(self, runs: int, key: Key) -> Floats:
        """Independent errors of the state and of the control, (runs, 2)."""
        x0, xf, A = self.entities
        lines = A.argument(transpose=not (self.rows and A.drawn))
        how = self.rows, self.paired, self.best, runs, self.cost, key.bytes32, get_num_threads()
        return _core.simulate_plans(x0.argument(), xf.argument(), lines, *how)


# -- from errors to bounds ---------------------------------------------------------------------


def radii(errors: ErrorLaw, delta: float, key: Key) -> tuple[float, ...] | None:
    """Bounds of the errors, each exceeded with probability `delta`; None: too many runs."""
    runs = runs_for(delta, errors.cost)
    if runs is None:
        return None
    found = errors.draw(runs, key)
    return errors.rounded(tuple(_core.drawn_bounds(found, delta)))


def runs_for(delta: float, cost: float) -> int | None:
    """Number of errors to simulate at this cost [ns] of each; None: too many would be needed."""
    if delta < least_delta(cost) * (1.0 - _TINY):
        return None
    wanted = min(max(_FEWEST, math.ceil(_RUNS / delta)), _ENOUGH, int(_BUDGET / cost))
    return max(wanted, math.ceil(_LEAST / delta))


def least_delta(cost: float) -> float:
    """The smallest delta that is simulated at this cost [ns] of each error."""
    return _LEAST / min(_MOST, _LONGEST / cost)


def not_simulated(delta: float, cost: float) -> str:
    """Why there is no simulated bound."""
    return (
        f"`delta` must be at least {least_delta(cost):.2g} to be simulated here, got {delta:.3g}: "
        f"{_LEAST:g} / delta errors are needed, and {min(_MOST, _LONGEST / cost):.2g} can be drawn "
        "(in 10 s of one thread at most)"
    )


def searched_size(
    errors_at: Callable[[int], ErrorLaw], which: int, eps: float, delta: float, key: Key
) -> int | None:
    """A size whose bound for error `which` is at most `eps`, within 1 or 5 % of the smallest.

    A pilot with its own random stream finds the first of at most ten sizes. None: no size up to
    2^53, or no bound for this `delta`.
    """
    pilot_key = key.child("pilot")

    def pilot(size: int) -> float:
        errors = errors_at(size)
        runs = runs_for(delta, errors.cost)
        if runs is None:
            return math.inf
        level = 1.0 - (_core.exceedances(runs, delta) or 0) / runs
        drawn = errors.draw(min(runs, _PILOT), pilot_key)
        return errors.rounded(tuple(float(np.quantile(one, level)) for one in drawn.T))[which]

    def bound(size: int) -> float:
        found = radii(errors_at(size), delta, key)
        return math.inf if found is None else found[which]

    start, _ = _approach(pilot, eps, _START, rounds=_PILOTS, close=_GUESSED)
    if start is None:
        return None
    cost = errors_at(start).cost
    close = _CLOSE if cost * (runs_for(delta, cost) or 0) < _BUDGET else _NEAR
    _, found = _approach(bound, eps, start, rounds=_LOOKS, close=close)
    return found


def _approach(
    radius: Callable[[int], float], eps: float, start: int, *, rounds: int, close: float
) -> tuple[int | None, int | None]:
    """The last size guessed, and the smallest one found with ``radius(size) <= eps``.

    A power of the size is fitted to the radius in every round. `smallest_size` would need
    up to 106 radii, but delta is shared among ten.
    """
    size, slope = start, -0.5  # the power of an average of many realizations
    failing, passing, last = 0, None, None
    for _ in range(rounds):
        found = radius(size)
        if found == math.inf:
            return None, passing
        if found <= eps:
            passing = size if passing is None else min(passing, size)
        else:
            failing = max(failing, size)
        if last is not None and last[0] != size and 0.0 < found != last[1] > 0.0:
            fitted = math.log(found / last[1]) / math.log(size / last[0])
            slope = min(max(fitted, _SLOPES[0]), _SLOPES[1])
        last = size, found
        # a little beyond the size at which the fitted power meets eps
        ratio = (eps / found) ** (1.0 / slope) if found > 0.0 else 0.0
        aim = min(max(1, math.ceil(size * ratio * math.sqrt(close))), validation.EXACT)
        if passing is not None and (passing <= failing + 1 or passing <= aim * math.sqrt(close)):
            return passing, passing
        if failing >= validation.EXACT:
            return None, passing
        if aim <= failing or (passing is not None and aim >= passing):
            upper = passing if passing is not None else min(4 * failing, validation.EXACT)
            aim = (failing + upper + 1) // 2
        size = aim
    return size, passing
