"""`Template`: the function of a study, with all its arguments but the axes of the grid."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..._base import validation
from ...exceptions import InputTypeError
from ...rng import Key
from ..units import PURE


class Template(functools.partial[Mapping[str, Any]]):
    """A function ``function(key, **values)`` for a `Study`; pickled with its arguments.

    `axes` names the arguments that a grid may vary, `units` has the units of numbers and axes.
    """

    axes: tuple[str, ...]
    units: dict[str, str]

    def __call__(self, key: Key, **values: Any) -> Mapping[str, Any]:
        """Return the numbers of one replicate, with `values` in place of the arguments here."""
        for name in values:
            validation.choice("axis", name, self.axes)
        return super().__call__(key, **values)


def template(
    function: Callable[..., Mapping[str, Any]],
    axes: tuple[str, ...],
    pure: tuple[str, ...],
    units: Mapping[str, str],
    **fixed: Any,
) -> Template:
    """Fix copies of the arguments of `function`; those named in `pure` have no unit."""
    kept = {k: v.copy() if isinstance(v, np.ndarray) else v for k, v in fixed.items()}
    made = Template(function, **kept)
    made.axes, made.units = axes, {**dict.fromkeys(pure, PURE), **units}
    return made


def options(
    name: str, value: object, function: Callable[..., Any], taken: tuple[str, ...]
) -> dict[str, Any]:
    """Check a mapping of arguments for `function` that the study does not give itself."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        shown = validation.show(value)
        raise InputTypeError(f"`{name}` must be a mapping of arguments, got {shown}")
    known = inspect.signature(function).parameters.values()
    own = tuple(one.name for one in known if one.kind is one.KEYWORD_ONLY and one.name not in taken)
    return {validation.choice(f"{name} argument", key, own): one for key, one in value.items()}


def compared(bound: float, error: float) -> dict[str, float]:
    """The numbers of a bound beside the true error."""
    return {
        "covered": float(error <= bound),
        "bound": bound,
        "error": error,
        "ratio": bound / error if error else np.inf,
    }
