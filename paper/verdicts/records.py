"""A statement of the paper, what is true of it, and the evidence, as records."""

from __future__ import annotations

import shutil
from configparser import ConfigParser
from dataclasses import asdict, dataclass
from fractions import Fraction
from functools import cache
from pathlib import Path
from string import Formatter
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from .comparison import Comparison
from .drawing import draw_claims
from .tails import Tails

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Verdict: TypeAlias = Literal["holds", "holds with a correction", "false"]
Kind: TypeAlias = Literal["exact", "enumeration", "Monte Carlo", "experiment"]


@dataclass(frozen=True)
class Evidence:
    """One computation that bears on a statement.

    Attributes
    ----------
    kind : str
        "exact": one case without sampling, in rational arithmetic or by a formula that is exact but
        for rounding; "enumeration": all cases, with their probabilities;
        "Monte Carlo": random cases, with their number; "experiment": one of the paper's runs.
    text : str
        What was computed and what came out.
    confirms : bool
        Whether the numbers that came out support the verdict. Decided by the computation.
    """

    kind: Kind
    text: str
    confirms: bool


@dataclass(frozen=True)
class Claim:
    """One definition, lemma, remark, algorithm or figure of the paper.

    Attributes
    ----------
    item : str
        "Lemma 4.2" and the like.
    says : str
        What the paper says.
    verdict : str
        "holds", "holds with a correction" or "false".
    corrected : str
        The statement that is true instead; empty if it holds as it stands.
    evidence : tuple of Evidence
        What was computed.
    """

    item: str
    says: str
    verdict: Verdict
    corrected: str
    evidence: tuple[Evidence, ...]

    @property
    def confirmed(self) -> bool:
        """Whether all the evidence supports the verdict."""
        return all(one.confirms for one in self.evidence)


@cache
def statements() -> ConfigParser:
    """What the paper says, the verdict, what is true and the texts of the evidence."""
    parser = ConfigParser(delimiters=("=",), interpolation=None)
    parser.read_string(Path(__file__).with_name("statements.ini").read_text("utf-8"))
    return parser


Outcome: TypeAlias = tuple[bool, dict[str, Any]]


def outcome(confirms: object, **values: Any) -> Outcome:
    """Whether a computation supports a verdict, and the values that its text shows."""
    return bool(confirms), values


class _Texts(Formatter):
    """Formats lists and arrays item by item, with commas; and fractions as decimals if asked."""

    def format_field(self, value: Any, format_spec: str) -> str:
        """One field of a text."""
        if isinstance(value, (list, tuple, np.ndarray)):
            return ", ".join(self.format_field(one, format_spec) for one in value)
        decimal = isinstance(value, Fraction) and format_spec
        return str(super().format_field(float(value) if decimal else value, format_spec))


def claim(item: str, *found: Outcome) -> Claim:
    """One statement, with the outcome of each computation on it."""
    said = {key: " ".join(text.split()) for key, text in statements()[item].items()}
    evidence = []
    for k, (confirms, values) in enumerate(found, start=1):
        kind, _, text = said[f"evidence {k}"].partition(": ")
        evidence.append(Evidence(kind, _Texts().format(text, **values), confirms))  # type: ignore[arg-type]
    return Claim(item, said["says"], said["verdict"], said.get("true", ""), tuple(evidence))  # type: ignore[arg-type]


@dataclass(frozen=True)
class Claims:
    """The paper's statements, checked one by one; what `claims` returns.

    Attributes
    ----------
    rows : tuple of Claim
        In the order of the paper.
    tails : Tails
        Empirical quantiles of an error and the bounds on it, for a figure.
    comparison : Comparison
        SLSE against uniform weights, run by run and in the mean square, for a figure.
    key : str
        Hexadecimal key of all randomness.
    """

    rows: tuple[Claim, ...]
    tails: Tails
    comparison: Comparison
    key: str

    @property
    def confirmed(self) -> bool:
        """Whether every verdict is supported by what was computed."""
        return all(row.confirmed for row in self.rows)

    @property
    def summary(self) -> str:
        """One line: how many statements hold, and whether the evidence supports that."""
        counts = {v: sum(row.verdict == v for row in self.rows) for v in _ORDER}
        end = "all verdicts confirmed" if self.confirmed else "NOT ALL VERDICTS CONFIRMED"
        return (
            f"{len(self.rows)} statements of the paper: {counts['holds']} true as printed, "
            f"{counts['holds with a correction']} true with a correction, {counts['false']} false; "
            f"{end}"
        )

    def __getitem__(self, item: str) -> Claim:
        for row in self.rows:
            if row.item == item:
                return row
        raise KeyError(item)

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain lists, numbers and text."""
        return {
            "schema": "stochens-claims/1",
            "key": self.key,
            "confirmed": self.confirmed,
            "claims": [asdict(row) | {"confirmed": row.confirmed} for row in self.rows],
            "tails": self.tails.to_dict(),
            "comparison": self.comparison.to_dict(),
        }

    def plot(self) -> Figure:
        """Draw the tail bounds, and SLSE against uniform weights, side by side.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        ImportError
            matplotlib is not installed.
        """
        return draw_claims(self.tails, self.comparison)

    def __str__(self) -> str:
        return "\n\n".join(map(_block, self.rows))

    def __repr__(self) -> str:
        return f"<Claims: {self.summary}>"


_ORDER: tuple[Verdict, ...] = ("holds", "holds with a correction", "false")

_WIDTH = 96  # at most, where the terminal is wider
_HANG = 11


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
    width = min(_WIDTH, shutil.get_terminal_size((_WIDTH, 0)).columns)
    first, *rest = wrap(text, width - _HANG) or [""]
    return [f"  {name:<9}{first}", *(" " * _HANG + line for line in rest)]
