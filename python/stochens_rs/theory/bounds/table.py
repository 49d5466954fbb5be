"""The table of all bounds: which inequality holds in which setting, and where it comes from."""

from __future__ import annotations

from dataclasses import dataclass

# The settings in which an error can be bounded, by its quantity and by norm or fusion; the first is
# the default. A bound on the Frobenius norm of a matrix is one on its spectral norm, too.
SETTINGS: dict[str, dict[str, tuple[str, ...]]] = {
    "vector": {"2": ("vector",), "1": ("1-norm",)},
    "matrix": {"spectral": ("spectral norm", "matrix"), "Frobenius": ("matrix",)},
    "state": {"product": ("product",), "diagonal": ("diagonal",)},
    "control": {"product": ("product",), "diagonal": ("diagonal",)},
}


@dataclass(frozen=True)
class Row:
    """The name of an inequality of the core, where it holds, its source, why sizes are equal."""

    name: str
    settings: tuple[str, ...]
    source: str
    equal: str = ""


# In the order in which `candidates` lists them.
TABLE = (
    Row("Bernstein", ("spectral norm",),
        "N m independent matrices of rank one, matrix Bernstein"),
    Row("McDiarmid", ("product",),
        "bounded martingale differences, xf then x0 then A; mean at most the exact rms"),
    Row("Bousquet", ("vector", "matrix"),
        "supremum of <v, average - mean> over unit vectors v, N independent terms"),
    Row("Bousquet", ("product",),
        "Bousquet for the linear part, McDiarmid for the product of two errors",
        "one linear term for each index"),
    Row("Bousquet", ("diagonal",),
        "supremum of <v, M (average of pairs - mean)> over unit vectors v"),
    Row("Weissman", ("vector", "1-norm"),
        "union bound over all sets of atoms, Hoeffding for each"),
)  # fmt: skip
# For systematic samples, to which no other row applies: their realizations are dependent.
DEPENDENT = (Row("systematic", ("vector", "matrix"), "every count is within 1 of N p_i"),)
