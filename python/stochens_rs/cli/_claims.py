"""``stochens claims``: the paper's statements checked one by one."""

from __future__ import annotations

import json
import re
import tempfile

import click

from .. import paper, plots
from .._base.files import write_listed
from ._options import seed_option
from ._output import note, prepared, show

_NAMES = re.compile(r"claims\.(json|png|svg)")


@click.command()
@seed_option
@click.option("--quick", is_flag=True, help="Fewer runs: a second or two instead of ten.")
@click.option("--out", metavar="DIR", help="Also write claims.json and the figure there.")
@click.option("--force", is_flag=True, help="Replace the files of a run with other options.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of the table.")
@click.pass_context
def claims(
    context: click.Context, seed: int, quick: bool, out: str | None, force: bool, as_json: bool
) -> None:
    """Check every definition, lemma, algorithm and figure of the paper.

    Each row says what the paper says, whether it holds, what is true instead, and what has just
    been computed to show it. Exit code 3 if the evidence contradicts a verdict.

    Files in DIR are replaced if the same options made them, or with --force. One of such a name
    that this command did not write, or that was changed since (claims.json has the SHA-256 of the
    others), is never replaced: nothing is done then.
    """
    directory, options = None, {"seed": seed, "quick": quick}
    if out is not None:
        plots.require_matplotlib()
        directory, earlier = prepared(out, "claims.json", _NAMES, options, force)
    found = paper.claims(seed, quick=quick, progress=True)
    text = json.dumps(found.to_dict(), allow_nan=False, indent=2)
    show(text if as_json else f"{found}\n\n{found.summary}")
    if directory is not None:
        for path in earlier:
            path.unlink(missing_ok=True)
        facts = {**found.to_dict(), "options": options}
        with tempfile.TemporaryDirectory(dir=directory) as made:
            figures = plots.save_figures({"claims": found.plot()}, made)
            for path in write_listed(directory, "claims.json", facts, figures):
                note(f"written: {path}")
    if not found.confirmed:
        context.exit(3)
