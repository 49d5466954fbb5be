"""``stochens claims``: the paper's statements checked one by one."""

from __future__ import annotations

from typing import Any

import click

from .. import paper
from ._command import Command
from ._options import force_option, json_option, out_option, seed_option
from ._output import Out, show_result


@click.command(
    cls=Command,
    short_help="Check the statements of the paper.",
    examples=["claims --quick", "claims --out checked", "claims --json | jq .confirmed"],
    codes={3: "a verdict is contradicted"},
)
@seed_option
@click.option("--quick", is_flag=True, help="Fewer runs: a second or two instead of ten.")
@out_option("claims")
@force_option
@json_option
@click.pass_context
def claims(context: click.Context, /, seed: int, quick: bool, as_json: bool, **_: Any) -> None:
    """Check every definition, lemma, algorithm and figure of the paper.

    For each: what the paper says, whether it holds, what is true instead, and the evidence, which
    is computed anew.

    Notation: v is the exact control, u a computed one, B^+ the pseudoinverse, P = B B^+; x(s) is
    realization s of x and x_hat an estimate; g(w) is the sum of the absolute values of a vector,
    g(A) the largest of the columns of A.

    Files in DIR are replaced if a run with the same options wrote them, or with --force; other
    files never are (claims.json lists its files with their SHA-256).
    """
    files = Out(context)
    found = paper.claims(seed, quick=quick, progress=True)
    show_result(found.to_dict(), f"{found}\n\n{found.summary}", as_json)
    files.write(found.to_dict(), found.plot)
    if not found.confirmed:
        context.exit(3)
