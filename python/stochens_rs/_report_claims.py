"""The section of the report on the paper's statements; every number comes from `claims`."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .verdicts import Claim, Claims

__all__ = ["CAPTION", "claims_table"]

CAPTION = """<b>Left:</b> the error of the state that all but a given share of the runs stay
below, beside a bound that holds, named in the legend, and Lemma 4.2 with ‖A‖ in its constant: in
the shaded range the lemma promises what does not happen. <b>Right:</b> mean squared errors of one
vector; SLSE stays below V/N in the mean, while on single runs (bars) it can be worse than uniform
weights."""

_CLASSES = {"holds": "holds", "holds with a correction": "corrected", "false": "false"}


def claims_table(found: Claims) -> str:
    """One row per statement: what the paper says, the verdict, what is true, the evidence."""
    head = "<tr><th>item</th><th>the paper says</th><th>what is true, and how it was seen</th></tr>"
    body = "".join(map(_row, found.rows))
    return (
        f"<p>{escape(found.summary)}. The evidence was computed for this page.</p>"
        f'<div class="wide"><table class="claims">{head}{body}</table></div>'
    )


def _row(row: Claim) -> str:
    evidence = "".join(
        f'<p class="evidence"><i>{escape(one.kind)}</i>{"" if one.confirms else " (CONTRARY)"}: '
        f"{escape(one.text)}</p>"
        for one in row.evidence
    )
    return (
        f"<tr><td><b>{escape(row.item)}</b><br>"
        f'<span class="verdict {_CLASSES[row.verdict]}">{row.verdict}</span></td>'
        f"<td>{escape(row.says)}</td><td>{escape(row.corrected)}{evidence}</td></tr>"
    )
