"""The records of `required_samples`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .._base import html
from ..exceptions import SizeError
from ..rng import Key
from ..theory.records import RELATIVE_TO

_UPPER = "the errors are those without limits, which are no smaller"


@dataclass(frozen=True)
class Requirement:
    """The number of realizations that one bound requires, and the errors with that number.

    Attributes
    ----------
    name : str
        Name of the bound.
    source : str
        The inequality and the numbers that it is used with.
    size : int or None
        The smallest sufficient number of realizations ("simulated": within 1 to 5 %); None if that
        is above 2^53, or `delta` too small to simulate.
    rms : float or None
        Exact root mean square error at `size`; None over several steps.
    quantile : float or None
        The ``1 - delta`` quantile of the simulated errors at `size`.
    failures : int or None
        Number of simulated errors above `error`.
    """

    name: str
    source: str
    size: int | None
    rms: float | None
    quantile: float | None
    failures: int | None


@dataclass(frozen=True, eq=False)
class SamplePlan:
    """Numbers of realizations for a given error; what `required_samples` returns.

    Attributes
    ----------
    error : float
        The error that may be exceeded with probability `delta`, absolute.
    delta : float
        The probability of failure.
    reference : float
        The norm that a relative error is divided by.
    relative_to : str
        The vector with that norm, as in `PlanError`: "x_actual", the state that the exact control
        leads to, or if that is zero "x0"; for the control "v", the exact one, or if that is zero
        "B^+ A x0", which takes x0 to the origin; "nothing" if all of these are zero.
    quantity, fusion : str
        As given.
    steps : int
        Number of steps K.
    rows : tuple of Requirement
        One per bound, smallest size first. All hold; use the first.
    expected_size : int or None
        Smallest size whose exact root mean square error is at most `error`: no guarantee. None
        over several steps.
    simulated_size : int
        The size needed in the simulation (no guarantee): there a share `delta` of the simulated
        errors exceeds `error`.
    runs : int
        Simulated fusions per size.
    key : Key
        The key of the simulation.
    limited : bool, default False
        Whether the control has limits: then all errors are those without, which are no smaller.
    """

    error: float
    delta: float
    reference: float
    relative_to: str
    quantity: str
    fusion: str
    steps: int
    rows: tuple[Requirement, ...]
    expected_size: int | None
    simulated_size: int
    runs: int
    key: Key
    limited: bool = False

    @property
    def size(self) -> int:
        """The smallest size that a bound guarantees."""
        smallest = self.rows[0].size
        if smallest is None:
            raise SizeError("no bound is satisfied by up to 2^53 realizations")
        return smallest

    def to_dict(self) -> dict[str, Any]:
        """The plan as a dict of plain numbers and text."""
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
            ("within limits", _UPPER if self.limited else None),
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
        over = "" if self.steps == 1 else f" over {html.counted(self.steps)}"
        lines = [
            f"error of the {self.quantity}{over}: {self._limit},",
            f"with probability {1.0 - self.delta:g}, {self.fusion} fusion",
            *([f"within limits: {_UPPER}"] if self.limited else []),
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


def _grouped(size: int) -> str:
    """A number with spaces between the thousands."""
    return f"{size:,}".replace(",", " ")
