"""``stochens claims``: the paper's statements checked one by one."""

from __future__ import annotations

import re
import tempfile

import click

from .. import paper, plots
from .._base.files import write_listed
from ..plots.style import require_matplotlib
from ._options import force_option, json_option, seed_option
from ._output import note, prepared, show_result

_NAMES = re.compile(r"claims\.(json|png|svg)")


@click.command(short_help="Check the statements of the paper.")
@seed_option
@click.option("--quick", is_flag=True, help="Fewer runs: a second or two instead of ten.")
@click.option("--out", metavar="DIR", help="Also write claims.json and the figure there.")
@force_option
@json_option
@click.pass_context
def claims(
    context: click.Context, seed: int, quick: bool, out: str | None, force: bool, as_json: bool
) -> None:
    """Check every definition, lemma, algorithm and figure of the paper.

    For each: what the paper says, whether it holds, what is true instead, and the evidence, which
    is computed anew.

    Notation: v is the exact control, u a computed one, B^+ the pseudoinverse, P = B B^+; x(s) is
    realization s of x and x_hat an estimate; g(w) is the sum of the absolute values of a vector,
    g(A) the largest of the columns of A.

    Files in DIR are replaced if a run with the same options wrote them, or with --force. If DIR has
    a file of the same name that this command did not write, or that was changed since, the command
    stops before it computes anything (claims.json lists the files with their SHA-256).
    """
    directory, options = None, {"seed": seed, "quick": quick}
    if out is not None:
        require_matplotlib()
        directory, earlier = prepared(out, "claims.json", _NAMES, options, force)
    found = paper.claims(seed, quick=quick, progress=True)
    show_result(found.to_dict(), f"{found}\n\n{found.summary}", as_json)
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
