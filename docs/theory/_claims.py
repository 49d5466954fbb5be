"""Write claims.md, what the paper says and what is true: python docs/theory/_claims.py [--quick].

The verdicts and the corrected statements are those of `paper/`; the evidence is computed anew,
with a fixed key, so that equal versions write equal pages. --quick: with fewer simulated runs.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # for paper

import paper
from paper.report import formulas

PAGE = Path(__file__).with_name("claims.md")
HEAD = """# What the paper says, and what is true

The paper is N. Mandal, M. Khajenejad, S. Martínez, *Control of Discrete-Time LTI Systems using
Stochastic Ensemble Systems*, 2023, [arXiv:2304.11755](https://arxiv.org/abs/2304.11755).
Of {total} statements {holds} are true as printed, {corrected} with a correction, and {false} are
false. The evidence for each verdict was computed when this page was made: an exact counterexample,
an enumeration of all cases, a simulation, or one of the paper's experiments; {confirmed}.

`paper.claims` and `python -m paper claims` compute it again; each piece of evidence has a test that
fails if it is altered. v is the exact control, u a computed one, B⁺ the pseudoinverse, P = B B⁺;
x(s) is realization s of x, x̂ an estimate; g(w) is the sum of the absolute values of a vector, g(A)
the largest of the columns of A.

| statement | verdict |
|---|---|
"""


def readable(text: str) -> str:
    """A statement as Markdown, with HTML for the indices and powers in its formulas."""
    return re.sub(r"([\\`*_{}\[\]$|^~#])", r"\\\1", formulas.readable(text))


def page(claims: paper.Claims) -> str:
    """The text of the page."""
    verdicts = [row.verdict for row in claims.rows]
    head = HEAD.format(
        total=len(verdicts),
        holds=verdicts.count("holds"),
        corrected=verdicts.count("holds with a correction"),
        false=verdicts.count("false"),
        confirmed="it supports all verdicts" if claims.confirmed else "IT CONTRADICTS A VERDICT",
    )
    lines = [
        f"| [{readable(row.item)}](#claim-{k}) | {row.verdict} |"
        for k, row in enumerate(claims.rows, start=1)
    ]
    parts = [head + "\n".join(lines)]
    for k, row in enumerate(claims.rows, start=1):
        parts += [f"(claim-{k})=\n## {readable(row.item)}", f"**{row.verdict.capitalize()}.**"]
        parts.append(f"*The paper*: {readable(row.says)}")
        if row.corrected:
            parts.append(f"*True*: {readable(row.corrected)}")
        parts.append("\n".join(f"- *{e.kind}*: {readable(e.text)}" for e in row.evidence))
    return "\n\n".join(parts) + "\n"


def write(path: Path = PAGE, *, quick: bool = False) -> None:
    """Compute the evidence and write the page."""
    path.write_text(page(paper.claims(rng=1, quick=quick)), "utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    write(quick=parser.parse_args().quick)
    print(PAGE)
