"""Options that several subcommands take."""

from __future__ import annotations

import click

from ..cases import CASES

case_option = click.option(
    "--case",
    type=click.Choice(tuple(CASES)),
    help="A system that comes with the package.",
)
file_option = click.option(
    "--file",
    "path",
    metavar="FILE",
    help="Your own: .npz or JSON with A, B and, if you have them, x0 and xf.",
)
seed_option = click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    help="Source of all randomness.",
)
