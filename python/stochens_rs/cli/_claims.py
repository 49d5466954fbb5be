"""``stochens claims``: the paper's statements checked one by one."""

from __future__ import annotations

import json

import click

from .. import paper, plots
from ._options import seed_option
from ._output import note, show, writable


@click.command()
@seed_option
@click.option("--quick", is_flag=True, help="Fewer runs: a second or two instead of ten.")
@click.option("--out", metavar="DIR", help="Also write claims.json and the figure there.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of the table.")
@click.pass_context
def claims(context: click.Context, seed: int, quick: bool, out: str | None, as_json: bool) -> None:
    """Check every definition, lemma, algorithm and figure of the paper.

    Each row says what the paper says, whether it holds, what is true instead, and what has just
    been computed to show it. Exit code 3 if the evidence contradicts a verdict.
    """
    directory = None
    if out is not None:
        plots.require_matplotlib()
        directory = writable(out)
    found = paper.claims(seed, quick=quick, progress=True)
    text = json.dumps(found.to_dict(), allow_nan=False, indent=2)
    show(text if as_json else f"{found}\n\n{found.summary}")
    if directory is not None:
        data = directory / "claims.json"
        data.write_text(text + "\n", encoding="utf-8")
        for path in (data, *plots.save_figures({"claims": found.plot()}, directory)):
            note(f"written: {path}")
    if not found.confirmed:
        context.exit(3)
