"""Options that several subcommands take."""

from __future__ import annotations

import click

from ..cases import CASES

case_option = click.option(
    "--case",
    type=click.Choice(tuple(CASES)),
    help="An example system of the package.",
)
file_option = click.option(
    "--file",
    "path",
    metavar="FILE",
    help="Your own system: .npz, .mat, .csv or JSON with A, B and optionally x0, xf.",
)
seed_option = click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    help="Seed of all random numbers.",
)
force_option = click.option(
    "--force", is_flag=True, help="Replace the files of a run with other options."
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
