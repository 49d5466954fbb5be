"""``stochens plan``: how many samples for this accuracy at this confidence."""

from __future__ import annotations

import click

from ..controls.planning import required_samples
from ..rng import as_key
from ._command import Command
from ._options import (
    Choice,
    case_option,
    delta_option,
    file_option,
    json_option,
    seed_option,
    steps_option,
)
from ._output import show_result
from ._problem import problem, share


@click.command(
    cls=Command,
    short_help="Find the number of samples for an accuracy.",
    examples=["plan --case ieee14 --error 5%", "plan --file system.json --delta 1% --json"],
)
@case_option
@file_option
@click.option(
    "--error",
    metavar="E",
    default="5%",
    help="Largest error: 5% or 0.05 of the norm of the exact control or state; with --absolute in "
    "their units.",
)
@click.option("--absolute", is_flag=True, help="--error is absolute, not relative.")
@delta_option("Probability with which the error may be larger.")
@click.option(
    "--quantity",
    type=Choice(["state", "control"]),
    default="state",
    help="Error of the state after the last step, or of the control.",
)
@click.option(
    "--fusion",
    type=Choice(["product", "diagonal"]),
    default="product",
    help="Average x0, xf and A, or the controls of single realizations.",
)
@steps_option
@click.option(
    "--runs",
    metavar="R",
    type=click.IntRange(min=20),
    default=1000,
    help="Number of simulated runs.",
)
@seed_option
@json_option
def plan(
    case: str | None,
    path: str | None,
    error: str,
    delta: float,
    quantity: str,
    fusion: str,
    steps: int,
    absolute: bool,
    runs: int,
    seed: int,
    as_json: bool,
) -> None:
    """Find how many samples N keep an error below E with probability 1 - P.

    Prints the N of every bound, the exact root mean square error for it, and from simulated runs:
    the error that a share P of the runs exceeds, and the number of runs with an error above E.

    If the file has no x0, it is drawn from the standard normal distribution (for --case with
    standard deviation 0.1). If it has no xf, the target is the origin.
    """
    key = as_key(seed)
    system, x0, xf = problem(case, path, key)
    found = required_samples(
        system,
        x0,
        xf,
        share(error, "--error", relative=not absolute),
        steps=steps,
        delta=delta,
        relative=not absolute,
        quantity=quantity,  # type: ignore[arg-type]
        fusion=fusion,  # type: ignore[arg-type]
        runs=runs,
        rng=key.child("simulation"),
    )
    show_result(found.to_dict(), str(found), as_json)
