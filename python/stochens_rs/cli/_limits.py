"""Options for controls within limits, and what is printed of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import click
import numpy as np

from .._base.reading import number
from .._base.validation import nearest
from ..controls import Cost, Limits
from ..controls.plan_summary import at_limits, least
from ..data.units import titled
from ..exceptions import SolverError
from ..feedback import Loop, gain
from ._output import finite

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..controls import Plan
    from ..identification import Model

F = TypeVar("F", bound=Callable[..., Any])

_OPTIONS: dict[str, dict[str, Any]] = {
    "limits": {
        "metavar": "LOW,HIGH",
        "multiple": True,
        "help": "Of all inputs, or INPUT=LOW,HIGH; repeatable.",
    },
    "rate": {"metavar": "R", "help": "Largest change of an input in a step; one or each."},
    "previous": {"metavar": "U", "help": "The inputs applied now; required with --rate."},
    "Q": {"metavar": "W", "help": "Weight of the states, one or each; default: 0."},
    "Qf": {"metavar": "W", "help": "Weight of the last state; default: --Q, or 1."},
    "R": {"metavar": "W", "help": "Weight of the inputs; default: almost 0."},
    "state_limits": {
        "metavar": "LOW,HIGH",
        "multiple": True,
        "help": "As --limits, of the states; soft unless --hard.",
    },
    "hard": {"is_flag": True, "help": "The limits of the states must hold."},
}
LIMIT_NAMES = tuple(_OPTIONS)


def limit_options(command: F) -> F:
    """Add the options to a command."""
    for name, how in reversed(_OPTIONS.items()):
        command = click.option(f"--{name.replace('_', '-')}", name, **how)(command)
    return command


def limits_given(options: dict[str, Any], names: tuple[Sequence[str], ...]) -> dict[str, Any]:
    """The limits and weights of `control` for the given options; `names` of states and inputs."""
    states, inputs = names

    def each(name: str, of: Sequence[str]) -> Any:
        text = options[name]
        return None if text is None else entries_of(f"--{name}", text, len(of))

    u, x = options["limits"], options["state_limits"]
    if options["hard"] and not x:
        raise click.UsageError("--hard is for --state-limits")
    limits = Limits(
        u=sides_of("--limits", u, inputs) if u else None,
        rate=each("rate", inputs),
        previous=each("previous", inputs),
        x=sides_of("--state-limits", x, states) if x else None,
        soft=False if options["hard"] else None,
    )
    cost = Cost(Q=each("Q", states), Qf=each("Qf", states), R=each("R", inputs))
    return {"limits": limits, "cost": cost}


def feedback_for(model: Model, options: dict[str, Any], widest: float | None = None) -> Loop:
    """The gain of least squares with ``--Q`` and ``--R``, 1 where they are left out.

    With `widest` that of the widest margin in the region of this probability.
    """
    try:
        if widest is not None:
            return gain(model, guarantee=widest)
        texts = {name: options[name] or "1" for name in ("Q", "R")}
        states = texts["Q"].count(",") + 1 == model.n
        sizes = {"Q": model.n if states else model.n_outputs, "R": model.m}
        weights = (np.diag(entries_of(f"--{name}", texts[name], sizes[name])) for name in sizes)
        return gain(model, *weights)
    except SolverError as error:
        raise click.UsageError(f"no gain: {error}") from error


def limit_facts(plan: Plan) -> dict[str, Any] | None:
    """What the limits did, for JSON."""
    limited = plan.limited
    if limited is None:
        return None
    return {
        "low": finite(limited.task.low),
        "high": finite(limited.task.high),
        "active": limited.active.tolist(),
        "rate_active": limited.rate_active.tolist(),
        "state_active": None if limited.state_active is None else limited.state_active.tolist(),
        "multipliers": limited.multipliers.tolist(),
        "R": limited.R.tolist(),
        "objective": limited.objective,
        "missed": limited.missed,
        "gap": limited.gap,
        "status": limited.status,
        "missing": limited.missing,
    }


def limit_lines(plan: Plan) -> list[str]:
    """The same in words."""
    limited = plan.limited
    if limited is None:
        return []
    lines = [
        f"limits     {at_limits(limited)} (*); {limited.missed:.4g} of the cost "
        f"{limited.objective:.4g} is for the limits",
        f"solved     {limited.status}, {least(limited)}",
    ]
    if limited.missing > 0.0:
        lines.append(f"infeasible the limits of the states are missed by {limited.missing:.4g}")
    return lines


def sides_of(option: str, texts: Sequence[str], names: Sequence[str]) -> tuple[Floats, Floats]:
    """Read ``-1,1`` and ``force=-1,1``."""
    low, high = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    for text in sorted(texts, key=lambda text: "=" in text):  # those of all, then those of one
        name, equals, pair = text.rpartition("=")
        name = titled(name, names)
        if equals and name not in names:
            known = f"{', '.join(names)}{nearest(name, names)}"
            raise click.BadParameter(f"{name!r} must be one of {known}", param_hint=option)
        values = _numbers(option, pair)
        if len(values) != 2 or any(map(math.isnan, values)):
            raise click.BadParameter(f"{pair!r} must be LOW,HIGH", param_hint=option)
        chosen = names.index(name) if equals else slice(None)
        low[chosen], high[chosen] = values
    return low, high


def entries_of(option: str, text: str, count: int) -> float | Floats:
    """Read ``1`` or ``1,0,2``, one number for each."""
    values = _numbers(option, text)
    if len(values) not in (1, count) or not all(map(math.isfinite, values)):
        wanted = "a finite number" if count == 1 else f"1 or {count} finite numbers"
        raise click.BadParameter(f"must be {wanted}, got {text!r}", param_hint=option)
    return np.full(count, values[0]) if len(values) == 1 else np.array(values)


def _numbers(option: str, text: str) -> list[float]:
    try:
        return [number(cell) for cell in text.split(",")]
    except ValueError:
        raise click.BadParameter(
            f"{text!r} must be numbers with commas", param_hint=option
        ) from None
