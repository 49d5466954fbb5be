"""The table of means and quantiles over the replicates of a study."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import html
from .._base.extras import extra

if TYPE_CHECKING:
    import pandas
    from numpy.typing import NDArray

    from .._base.types import Floats

_QUANTILES = {"q10": 0.1, "median": 0.5, "q90": 0.9}


@dataclass(frozen=True, eq=False, repr=False)
class Summary:
    """Statistics over the replicates, a row for each number of each configuration.

    Attributes
    ----------
    columns : dict of str to list
        The axes, "name" of the number, "done" and "failed" replicates, how many numbers of these
        are "infinite", "mean", "standard_error" of the mean, both infinite where a number is, and
        the quantiles "q10", "median", "q90"; nan without replicates.
    """

    columns: dict[str, list[Any]]

    def to_pandas(self) -> pandas.DataFrame:
        """The same as a table of pandas.

        Returns
        -------
        pandas.DataFrame

        Raises
        ------
        ImportError
            If pandas is not installed (extra ``tables``).
        """
        with extra("tables need pandas", "tables"):
            import pandas
        return pandas.DataFrame(self.columns)

    def texts(self) -> list[list[str]]:
        """The head and the rows as texts, numbers with four digits.

        Returns
        -------
        list of list of str
        """
        rows = zip(*self.columns.values(), strict=True)
        return [list(self.columns), *([html.text(cell) for cell in row] for row in rows)]

    def to_latex(self) -> str:
        """The table for LaTeX, with the rules of the package booktabs.

        Returns
        -------
        str
        """
        special = str.maketrans({mark: f"\\{mark}" for mark in "%&_#$"})
        head, *body = [
            " & ".join(cell.translate(special) for cell in row) + r" \\" for row in self.texts()
        ]
        numeric = list(self.columns).index("done")
        sides = "l" * numeric + "r" * (len(self.columns) - numeric)
        rules = rf"\begin{{tabular}}{{{sides}}}", r"\toprule", head, r"\midrule", *body
        return "\n".join([*rules, r"\bottomrule", r"\end{tabular}", ""])

    def __repr__(self) -> str:
        texts = self.texts()
        widths = [max(map(len, column)) for column in zip(*texts, strict=True)]
        numeric = list(self.columns).index("done")
        lines = []
        for row in texts:
            cells = zip(row, widths, itertools.count(), strict=False)
            padded = [c.ljust(w) if k < numeric else c.rjust(w) for c, w, k in cells]
            lines.append("  ".join(padded).rstrip())
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        texts = self.texts()
        return html.grid(texts[0], texts[1:])


def summarized(
    grid: Mapping[str, tuple[Any, ...]],
    entries: Iterable[tuple[str, Floats]],
    done: NDArray[np.bool_],
    failed: NDArray[np.bool_],
) -> Summary:
    """The summary of numbers over the axes of a grid and the replicates."""
    names = ["name", "done", "failed", "infinite", "mean", "standard_error", *_QUANTILES]
    columns: dict[str, list[Any]] = {name: [] for name in (*grid, *names)}
    for name, rows in entries:
        for where in itertools.product(*(range(len(labels)) for labels in grid.values())):
            kept = rows[where][done[where]]
            count = len(kept)
            row: dict[str, Any] = {
                axis: labels[at] for (axis, labels), at in zip(grid.items(), where, strict=True)
            }
            infinite = int(np.isinf(kept).sum())
            row |= {"name": name, "done": count, "failed": int(failed[where].sum())}
            row["infinite"] = infinite
            with np.errstate(invalid="ignore"):  # infinite numbers
                row["mean"] = float(kept.mean()) if count else np.nan
                spread = float(kept.std(ddof=1)) if count > 1 else np.nan
                spread = math.inf if infinite else spread
                row["standard_error"] = spread / math.sqrt(count) if count else np.nan
                for key, q in _QUANTILES.items():
                    row[key] = float(np.quantile(kept, q)) if count else np.nan
            for key, value in row.items():
                columns[key].append(value)
    return Summary(columns)
