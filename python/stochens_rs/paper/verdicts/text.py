"""The claims as a table of plain text."""

from __future__ import annotations

from collections.abc import Iterable
from textwrap import wrap
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .records import Claim

WIDTH = 96
_HANG = 11


def table(rows: Iterable[Claim]) -> str:
    """One block per claim: what is said, the verdict, what is true, the evidence."""
    return "\n\n".join(_block(row) for row in rows)


def _block(row: Claim) -> str:
    mark = "" if row.confirmed else "  [NOT CONFIRMED]"
    lines = [f"{row.item}: {row.verdict.upper()}{mark}"]
    lines += _part("paper", row.says)
    if row.corrected:
        lines += _part("true", row.corrected)
    for one in row.evidence:
        lines += _part("evidence" if one.confirms else "CONTRARY", f"[{one.kind}] {one.text}")
    return "\n".join(lines)


def _part(name: str, text: str) -> list[str]:
    first, *rest = wrap(text, WIDTH - _HANG) or [""]
    return [f"  {name:<9}{first}", *(" " * _HANG + line for line in rest)]
