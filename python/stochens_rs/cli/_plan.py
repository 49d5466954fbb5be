"""``stochens plan``: how many samples for this accuracy at this confidence."""

from __future__ import annotations

import json
from typing import TypeAlias

import click
import numpy as np
from numpy.typing import NDArray

from .. import cases
from ..planning import required_samples
from ..rng import Key, as_key
from ..system import System
from ._output import show

Floats: TypeAlias = NDArray[np.float64]

CASES = ("ieee14", "ieee39")


@click.command()
@click.option("--case", type=click.Choice(CASES), help="A system that comes with the package.")
@click.option(
    "--file",
    "path",
    metavar="FILE",
    help="Your own: .npz or JSON with A, B and, if you have them, x0 and xf.",
)
@click.option(
    "--error",
    metavar="E",
    default="5%",
    show_default=True,
    help="Error that may be exceeded, relative: 0.05 or 5%; with --absolute in units of the state.",
)
@click.option(
    "--delta",
    type=float,
    default=0.05,
    show_default=True,
    help="Probability with which it may be exceeded.",
)
@click.option(
    "--quantity", type=click.Choice(["state", "control"]), default="state", show_default=True
)
@click.option(
    "--fusion", type=click.Choice(["product", "diagonal"]), default="product", show_default=True
)
@click.option("--absolute", is_flag=True, help="The error is absolute.")
@click.option(
    "--runs",
    type=click.IntRange(min=20),
    default=1000,
    show_default=True,
    help="Simulated fusions.",
)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of the table.")
def plan(
    case: str | None,
    path: str | None,
    error: str,
    delta: float,
    quantity: str,
    fusion: str,
    absolute: bool,
    runs: int,
    seed: int,
    as_json: bool,
) -> None:
    """How many samples for this accuracy at this confidence.

    Prints the number that every bound asks for, the exact root mean square error there, and what a
    simulation says. States that the file does not have: x0 is drawn (standard normal; for a case
    with standard deviation 0.1), xf is the origin.
    """
    key = as_key(seed)
    system, x0, xf = _problem(case, path, key)
    found = required_samples(
        system,
        x0,
        xf,
        _share(error),
        delta=delta,
        relative=not absolute,
        quantity=quantity,  # type: ignore[arg-type]
        fusion=fusion,  # type: ignore[arg-type]
        runs=runs,
        rng=key.child("simulation"),
    )
    show(json.dumps(found.to_dict(), allow_nan=False, indent=2) if as_json else str(found))


def _problem(case: str | None, path: str | None, key: Key) -> tuple[System, Floats, Floats]:
    if (case is None) == (path is None):
        raise click.UsageError("give either --case or --file")
    if path is not None:
        given = cases.from_file(path)
        system, x0, xf, spread = given.system, given.x0, given.xf, 1.0
    else:
        system = cases.ieee14() if case == "ieee14" else cases.ieee39()
        x0, xf, spread = None, None, 0.1  # radians and radians per second
    if x0 is None:
        x0 = spread * key.child("x0").generator().standard_normal(system.n)
    return system, x0, np.zeros(system.n) if xf is None else xf


def _share(text: str) -> float:
    """``5%`` or ``0.05``."""
    number = text.strip().removesuffix("%")
    try:
        value = float(number)
    except ValueError:
        raise click.BadParameter(f"{text!r} is not a number", param_hint="--error") from None
    return value / 100.0 if text.strip().endswith("%") else value
