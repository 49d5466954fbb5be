"""The table of all bounds: which inequality holds in which setting, and where it comes from."""

from __future__ import annotations

from dataclasses import dataclass

from . import fused_inequalities as fused
from . import inequalities as of
from .base import Inequality

# The settings in which an error can be bounded, by its quantity and by norm or fusion; the first is
# the default. A bound on the Frobenius norm of a matrix is one on its spectral norm, too.
SETTINGS: dict[str, dict[str, tuple[str, ...]]] = {
    "vector": {"2": ("vector",), "1": ("1-norm",)},
    "matrix": {"spectral": ("spectral norm", "matrix"), "Frobenius": ("matrix",)},
    "state": {"product": ("product", "product, state"), "diagonal": ("diagonal",)},
    "control": {"product": ("product",), "diagonal": ("diagonal",)},
    "trajectory": {"2": ("runs", "one step")},
}


@dataclass(frozen=True)
class Row:
    """A name, the settings it holds in, the inequality, and the source of the bound."""

    name: str
    settings: tuple[str, ...]
    inequality: type[Inequality]
    source: str


# In the order in which `candidates` lists them.
TABLE = (
    Row("Bernstein", ("spectral norm",), of.Bernstein,
        "N m independent matrices of rank one, matrix Bernstein"),
    Row("McDiarmid", ("vector", "matrix"), of.McDiarmid,
        "bounded differences sqrt(2) g_j / N; mean at most sqrt(sum g_j^2 - ||a_j||^2) / N^.5"),
    Row("McDiarmid", ("product",), fused.ProductMcDiarmid,
        "bounded martingale differences, xf then x0 then A; mean at most the exact rms"),
    Row("McDiarmid", ("diagonal",), of.McDiarmid,
        "bounded differences in N pairs xf^s, A^s x0^s; mean at most the exact rms"),
    Row("McDiarmid", ("runs",), of.McDiarmid,
        "bounded differences 2 R_K / N in N independent runs; mean at most the exact rms"),
    Row("Bousquet", ("vector", "matrix"), of.Bousquet,
        "supremum of <v, average - mean> over unit vectors v, N independent terms"),
    Row("Bousquet", ("product",), fused.ProductBousquet,
        "Bousquet for the linear part, McDiarmid for the product of two errors"),
    Row("Bousquet", ("diagonal",), of.Bousquet,
        "supremum of <v, M (average of pairs - mean)> over unit vectors v"),
    Row("Bousquet", ("runs",), of.Bousquet,
        "supremum of <v, average of the runs - x(K)> over unit vectors v"),
    Row("Weissman", ("vector", "1-norm"), of.Weissman,
        "union bound over all sets of atoms, Hoeffding for each"),
    Row("Hoeffding", ("vector", "matrix"), of.Hoeffding,
        "every entry has the range g_j; union bound over the nonzero entries"),
    Row("Hoeffding", ("product, state",), fused.ProductHoeffding,
        "Hoeffding for every entry; triangle inequality with eps/3 for each entity"),
    Row("Chebyshev", ("vector", "matrix", "product", "diagonal", "runs"), of.Chebyshev,
        "Markov's inequality for the squared error"),
    Row("McDiarmid, one step", ("one step",), of.McDiarmid,
        "bounded differences in A^s x0^s and in every column of B^s"),
    Row("Hoeffding, one step", ("one step",), fused.OneStepHoeffding,
        "implied by the sharp form: its exponent is at most 4/3 above, and e^(4/3) < 4"),
)  # fmt: skip
# For systematic samples, to which no other row applies: their realizations are dependent.
DEPENDENT = (
    Row("systematic", ("vector", "matrix"), of.Systematic, "every count is within 1 of N p_i"),
)
