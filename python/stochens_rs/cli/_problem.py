"""The control problem of `plan` and `stream`, and numbers given in percent."""

from __future__ import annotations

import math

import click
import numpy as np

from .. import cases
from .._base.reading import number
from .._base.types import Floats
from ..rng import Key
from ..system import System


def problem(case: str | None, path: str | None, key: Key) -> tuple[System, Floats, Floats]:
    """System, x0 and xf; an x0 that is not in the file is drawn, and such an xf is 0."""
    if (case is None) == (path is None):
        raise click.UsageError("give either --case or --file")
    if path is not None:
        given = cases.from_file(path)
        system, x0, xf, spread = given.system, given.x0, given.xf, 1.0
    else:
        system = cases.CASES[str(case)]()
        x0, xf, spread = None, None, 0.1  # rad and rad/s
    if x0 is None:
        x0 = spread * key.child("x0").generator().standard_normal(system.n)
    return system, x0, np.zeros(system.n) if xf is None else xf


def share(text: str, option: str, *, relative: bool = True) -> float:
    """Read ``5%`` or ``0.05``; refuse a relative 5 without percent sign as a likely mistake."""
    figure = text.strip().removesuffix("%")
    try:
        value = number(figure)
    except ValueError:
        raise click.BadParameter(f"{text!r} is not a number", param_hint=option) from None
    if text.strip().endswith("%"):
        return value / 100.0
    if relative and 1.0 <= value < math.inf:
        raise click.UsageError(
            f"{option}: {figure} is {100 * value:g} %: give {figure}%, or a number below 1"
        )
    return value
