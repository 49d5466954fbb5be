"""Units of the numbers and axes of a study: texts that its function names."""

from __future__ import annotations

import functools
from collections.abc import Mapping

from .._base import validation
from .._base.signal_names import Labels
from ..exceptions import InputTypeError

PURE = "1"  # of a number without unit, as in the conventions of netCDF


def units_of(function: object) -> dict[str, str]:
    """The attribute ``units`` of a function, checked; empty if it has none."""
    while isinstance(function, functools.partial) and not hasattr(function, "units"):
        function = function.func
    return checked_units(getattr(function, "units", {}))


def checked_units(given: object) -> dict[str, str]:
    """A mapping of names to texts."""
    if not isinstance(given, Mapping):
        raise InputTypeError(
            f"`function.units` must be a mapping of names to texts, got {validation.show(given)}"
        )
    names = {validation.text("function.units", name): unit for name, unit in given.items()}
    return {
        name: validation.text(f"function.units[{name!r}]", unit) for name, unit in names.items()
    }


def of_states(labels: Labels, *numbers: str) -> dict[str, str]:
    """The unit of numbers that are lengths of states: the one of all states, if they share one."""
    units = dict(labels.units)
    found = {units.get(name, "") for name in labels.states}
    return dict.fromkeys(numbers, found.pop()) if len(found) == 1 and "" not in found else {}


def labelled(name: str, units: Mapping[str, str]) -> str:
    """``u[0] [N]``: a number or an axis with its unit, if there is one."""
    unit = suffix(name.partition("[")[0], units).strip()
    return f"{name} [{unit}]" if unit else name


def suffix(name: str, units: Mapping[str, str]) -> str:
    """What follows a value in a text: `` N``, or nothing for a pure number."""
    unit = units.get(name, PURE)
    return "" if unit in (PURE, "") else f" {unit}"
