"""How many realizations for this accuracy at this confidence: bounds, moments, simulation."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, inf
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from .._base import gate, html
from .._base.types import Fusion
from ..exceptions import InputError, SizeError
from ..rng import Key, RngLike, as_key
from ..system import System
from ..theory import bounds, moments
from ..theory.dynamics import checked_steps
from ..theory.exact import best_control
from ..theory.records import RELATIVE_TO

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from ..theory.bounds import Bound

    Floats: TypeAlias = NDArray[np.float64]

Quantity: TypeAlias = Literal["state", "control"]
_QUANTITIES = "state", "control"


@dataclass(frozen=True)
class Requirement:
    """What one bound asks for, and what happens then.

    Attributes
    ----------
    name : str
        The bound.
    source : str
        Where it comes from.
    size : int or None
        The smallest number of realizations it accepts (simulated: within 1 %, product and
        diagonal fusion of independent realizations); None if that is beyond 2^53, or `delta` too
        small to simulate.
    rms : float or None
        Exact root mean square error at `size`; None over several steps.
    quantile : float or None
        What a share `delta` of the simulated errors exceeds at `size`.
    failures : int or None
        Simulated errors above `error`.
    """

    name: str
    source: str
    size: int | None
    rms: float | None
    quantile: float | None
    failures: int | None


@dataclass(frozen=True, eq=False)
class SamplePlan:
    """How many realizations it takes; what `required_samples` returns.

    Attributes
    ----------
    error : float
        The error that may be exceeded with probability `delta`, absolute.
    delta : float
        The probability of failure.
    reference : float
        Norm of what a relative error is relative to.
    relative_to : str
        What that is, as in `PlanError`: "x_actual", the state that the exact control leads to, or
        "x0", if that is the origin; for the control "v", the exact one, or "B^+ A x0", the one that
        takes x0 to the origin, if v is zero; "nothing", if all of these are zero.
    quantity, fusion : str
        What was asked for.
    steps : int or None
        Number of steps K; None: one step.
    rows : tuple of Requirement
        One per bound, smallest size first. All hold; the first is the one to use.
    expected_size : int or None
        Where the exact root mean square error comes down to `error`: no guarantee. None over
        several steps.
    simulated_size : int
        Where the simulated errors exceed `error` with probability `delta`: what is really
        needed, up to the accuracy of the simulation.
    runs : int
        Simulated fusions per size.
    key : Key
        What repeats the simulation.
    """

    error: float
    delta: float
    reference: float
    relative_to: str
    quantity: str
    fusion: str
    steps: int | None
    rows: tuple[Requirement, ...]
    expected_size: int | None
    simulated_size: int
    runs: int
    key: Key

    @property
    def size(self) -> int:
        """The smallest size that a bound guarantees."""
        smallest = self.rows[0].size
        if smallest is None:
            raise SizeError("no bound is satisfied by up to 2^53 realizations")
        return smallest

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain numbers and text."""
        return {
            "schema": "stochens-plan/1",
            "error": self.error,
            "relative_error": self.error / self.reference if self.reference else None,
            "relative_to": self.relative_to,
            "delta": self.delta,
            "quantity": self.quantity,
            "fusion": self.fusion,
            "steps": self.steps,
            "expected_size": self.expected_size,
            "simulated_size": self.simulated_size,
            "runs": self.runs,
            "key": self.key.hex,
            "bounds": [vars(row) for row in self.rows],
        }

    def _repr_html_(self) -> str:
        head = ("bound", "N", "exact rms", "quantile", "failures")
        body = [
            (
                one.name,
                "more than 2^53" if one.size is None else html.grouped(one.size),
                html.text(one.rms),
                html.text(one.quantile),
                "" if one.failures is None else f"{one.failures} of {self.runs}",
            )
            for one in self.rows
        ]
        size, expected = self.rows[0].size, self.expected_size
        rows = [
            ("enough", "nothing up to 2^53" if size is None else f"N = {html.grouped(size)}"),
            (f"error of the {self.quantity}", self._limit),
            ("with probability", f"{1.0 - self.delta:g}"),
            ("fusion", self.fusion),
            (
                "no guarantee, exact rms",
                None if expected is None else f"N = {html.grouped(expected)}",
            ),
            ("no guarantee, simulated", f"N = {html.grouped(self.simulated_size)}"),
        ]
        return html.card(self, rows, html.grid(head, body))

    @property
    def _limit(self) -> str:
        """The error, and what it is relative to."""
        words = RELATIVE_TO.get(self.relative_to)
        text = f"at most {self.error:.3g}"
        if words is None:
            return text
        share = 100 * self.error / self.reference
        return f"{text} ({share:.3g} % of {self.reference:.3g}, the norm of {words})"

    def __str__(self) -> str:
        over = "" if self.steps is None else f" over {html.counted(self.steps)}"
        lines = [
            f"error of the {self.quantity}{over}: {self._limit},",
            f"with probability {1.0 - self.delta:g}, {self.fusion} fusion",
            "",
            f"{'bound':<24}{'N':>16}{'exact rms':>12}{'quantile':>12}{'failures':>18}",
        ]
        for row in self.rows:
            if row.size is None:
                lines.append(f"{row.name:<24}{'none up to 2^53':>16}")
                continue
            size, failed = _grouped(row.size), f"{row.failures} of {self.runs}"
            rms = "" if row.rms is None else f"{row.rms:.3g}"
            lines.append(f"{row.name:<24}{size:>16}{rms:>12}{row.quantile:>12.3g}{failed:>18}")
        lines += ["", "no guarantee:"]
        if self.expected_size is not None:
            lines.append(
                f"the exact rms comes down to this error at N = {_grouped(self.expected_size)},"
            )
        lines.append(f"the simulated quantile at N = {_grouped(self.simulated_size)}")
        return "\n".join(lines)


def required_samples(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    error: float,
    *,
    delta: float = 0.05,
    relative: bool = True,
    quantity: Quantity = "state",
    fusion: Fusion = "product",
    steps: int | None = None,
    runs: int = 1000,
    rng: RngLike = None,
) -> SamplePlan:
    """Find how many realizations of x0, xf and A give a control of a given accuracy.

    Parameters
    ----------
    system : System
        The exact (or nominal) system, or anything `System.from_any` takes.
    x0, xf : array_like, shape (n,)
        Initial state and target.
    error : float
        The error that may be exceeded with probability `delta`.
    delta : float, default 0.05
        Probability of failure, in (0, 1).
    relative : bool, default True
        Whether `error` is relative: to the norm of the state that the exact control leads to
        (of that control, for "control"), or where that is zero, to that of x0 (of the control that
        takes x0 to the origin); the result says which.
    quantity : {"state", "control"}, default "state"
        ``||B (u - v)||``, the distance from the state that the exact control ``v`` leads to, or
        ``||u - v||``; over several steps with ``C_K`` in place of ``B``.
    fusion : {"product", "diagonal"}, default "product"
        How the realizations are fused, with uniform weights.
    steps : int, optional
        Number of steps K of the control, as in `control_steps`; None: one step, as in `control`.
    runs : int, default 1000
        Simulated fusions per bound, for the columns `quantile` and `failures`.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
        Source of randomness for the simulation.

    Returns
    -------
    SamplePlan
        Every bound's number of realizations with the exact error and the simulated ones there.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.

    Notes
    -----
    The bounds are those of `theory.bounds`, the exact root mean square that of `theory.moments`.
    "simulated" asks for little more than what is needed; the formulas hold for every delta. Over
    several steps there is the simulated bound only. The simulation draws counts, not realizations,
    so that its cost does not depend on N.

    Examples
    --------
    >>> import stochens_rs as se
    >>> system = se.System([[0.9, 0.2], [-0.1, 0.8]], [[1.0, 0.0], [0.5, 1.0]])
    >>> plan = se.required_samples(system, [1.0, 2.0], [1.0, 1.0], 0.1, rng=1, runs=100)
    >>> plan.simulated_size < plan.size, plan.rows[0].name
    (True, 'simulated')
    """
    checked = System.from_any(system)
    start = gate.vector("x0", x0, length=checked.n)
    goal = gate.vector("xf", xf, length=checked.n)
    error = gate.positive("error", error)
    delta = gate.probability("delta", delta)
    runs = gate.size("runs", runs, maximum=10**6)
    kind: Quantity
    kind = "control" if gate.choice("quantity", quantity, _QUANTITIES) == "control" else "state"
    how = gate.choice("fusion", fusion, ("product", "diagonal"))
    K = None if steps is None else checked_steps(steps, checked.n, checked.m)
    if K is not None and how == "diagonal":
        raise InputError("`fusion` must be 'product' over several steps, got 'diagonal'")
    relative = gate.flag("relative", relative)
    key = as_key(rng)
    best = best_control(checked.A, checked.B, start, goal, K or 1)
    relative_to, reference = best.compared(kind, start)
    if relative and not reference:
        raise InputError(
            f"`error` cannot be relative here: the exact {kind} is zero, and so is what x0 would "
            "be compared with (use relative=False, on the command line --absolute)"
        )
    allowed = error * reference if relative else error
    rms_of = moments.control_rms if kind == "control" else moments.state_rms
    rms_of(checked, start, goal, 1, fusion=how)  # type: ignore[arg-type]  # refuses what overflows
    if allowed * allowed < np.finfo(np.float64).tiny:
        raise SizeError(f"`error` is {allowed:.3g}, its square underflows: scale the problem up")
    simulated = bounds.bound(
        "simulated",
        kind,
        checked,
        start,
        goal,
        fusion=how,
        steps=1 if K is None else K,
        rng=key.child("bound"),
    )
    if K is not None:
        simulated.require(delta)  # there is no formula
    which, law = int(kind == "control"), simulated.errors

    def errors(size: int) -> Floats:
        return law(size).draw(runs, key.child("runs"))[:, which]

    found: list[Bound] = [simulated]
    if K is None:
        found += bounds.candidates(kind, checked, start, goal, fusion=how)  # type: ignore[arg-type]
    rows = []
    for bound in found:
        size = _size(bound, allowed, delta)
        if size is None:
            rows.append(Requirement(bound.name, bound.source, None, None, None, None))
            continue
        drawn = errors(size)
        rms = rms_of(checked, start, goal, size, fusion=how) if K is None else None  # type: ignore[arg-type]
        quantile = float(np.quantile(drawn, 1.0 - delta))
        failures = int((drawn > allowed).sum())
        rows.append(Requirement(bound.name, bound.source, size, rms, quantile, failures))
    rows.sort(key=lambda row: inf if row.size is None else row.size)
    expected = None
    if K is None:
        expected = _smallest(
            lambda N: rms_of(checked, start, goal, N, fusion=how) <= allowed  # type: ignore[arg-type]
        )
    return SamplePlan(
        error=allowed,
        delta=delta,
        reference=reference,
        relative_to=relative_to,
        quantity=kind,
        fusion=how,
        steps=K,
        rows=tuple(rows),
        expected_size=expected,
        simulated_size=_needed(errors, allowed, delta, expected or rows[0].size or 1000),
        runs=runs,
        key=key,
    )


def _needed(errors: Callable[[int], Floats], allowed: float, delta: float, start: int) -> int:
    """Where the simulated quantile meets the error: a few steps of ``N <- N (q / error)^2``."""
    size = start
    for _ in range(4):
        ratio = float(np.quantile(errors(size), 1.0 - delta)) / allowed
        size = int(min(max(1, ceil(size * ratio**2)), gate.EXACT))
    return size


def _size(bound: Bound, error: float, delta: float) -> int | None:
    try:
        return bound.required_size(error, delta)
    except SizeError:
        return None


def _grouped(size: int) -> str:
    """Thousands apart."""
    return f"{size:,}".replace(",", " ")


def _smallest(enough: Any) -> int:
    """The smallest size that is enough; the error falls with the size."""
    if enough(1):
        return 1
    low, high = 1, 2
    while not enough(high):
        if high >= gate.EXACT:
            raise SizeError("`error` is so small that more than 2^53 realizations are needed")
        low, high = high, min(2 * high, gate.EXACT)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high
