"""``stochens plan``: how many samples for this accuracy at this confidence."""

from __future__ import annotations

import json

import click

from ..controls.planning import required_samples
from ..rng import as_key
from ._options import case_option, file_option, seed_option
from ._output import show
from ._problem import problem, share


@click.command()
@case_option
@file_option
@click.option(
    "--error",
    metavar="E",
    default="5%",
    show_default=True,
    help="Error to stay below, 5% or 0.05 of what the table says; with --absolute in units of the "
    "quantity.",
)
@click.option(
    "--delta",
    metavar="P",
    default="5%",
    show_default=True,
    help="Probability with which it may be exceeded all the same.",
)
@click.option(
    "--quantity",
    type=click.Choice(["state", "control"]),
    default="state",
    show_default=True,
    help="Whose error: that of the state after the step, or of the control.",
)
@click.option(
    "--fusion",
    type=click.Choice(["product", "diagonal"]),
    default="product",
    show_default=True,
    help="Each entity averaged first, or one control per realization, then averaged.",
)
@click.option(
    "--steps",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Number of steps of the control.",
)
@click.option("--absolute", is_flag=True, help="The error is absolute.")
@click.option(
    "--runs",
    type=click.IntRange(min=20),
    default=1000,
    show_default=True,
    help="Simulated fusions.",
)
@seed_option
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of the table.")
def plan(
    case: str | None,
    path: str | None,
    error: str,
    delta: str,
    quantity: str,
    fusion: str,
    steps: int,
    absolute: bool,
    runs: int,
    seed: int,
    as_json: bool,
) -> None:
    """How many samples for this accuracy at this confidence.

    Prints the number N that every bound asks for, the exact root mean square error there, and what
    a simulation says: the error that all but the share delta of the runs stay below, and in how
    many runs the error was too large.

    States that the file does not have: x0 is drawn (standard normal; for a case with standard
    deviation 0.1), xf is the origin.
    """
    key = as_key(seed)
    system, x0, xf = problem(case, path, key)
    found = required_samples(
        system,
        x0,
        xf,
        share(error, "--error", relative=not absolute),
        steps=steps,
        delta=share(delta, "--delta"),
        relative=not absolute,
        quantity=quantity,  # type: ignore[arg-type]
        fusion=fusion,  # type: ignore[arg-type]
        runs=runs,
        rng=key.child("simulation"),
    )
    show(json.dumps(found.to_dict(), allow_nan=False, indent=2) if as_json else str(found))
