r"""Tail bounds that hold: with what probability an estimate, a control or a state is how wrong.

Every bound is an object made from the exact data, with three methods inverse to each other:
``radius(size, delta)``, ``probability(size, eps)``, ``required_size(eps, delta)``; see
:class:`Bound`. :func:`best` picks one. All of them hold for every size and every delta,
not only in the limit, for independent realizations (``scheme="iid"``) under uniform weights;
:class:`Systematic` and :class:`Simulated` are for the other scheme, too, :func:`from_errors` for
all other weights. :class:`Simulated` draws errors from the law: within a few percent of the
quantile, for delta of about 1e-4 and more; the others are formulas, several times larger, but none
larger than the largest error that can happen at all.

=============================  =====================================================================
all but averages of runs       `Simulated`
vector, matrix                 `McDiarmid`, `Bousquet`, `Hoeffding`, `Chebyshev`, `Systematic`
vector, 1-norm                 `Weissman` (divided by ``sqrt(2)``: 2-norm)
matrix, spectral norm          `Bernstein`
diagonal fusion                `DiagonalMcDiarmid`, `DiagonalBousquet`, `FusedChebyshev`
product fusion                 `ProductMcDiarmid`, `ProductBousquet`, `ProductParts`,
                               `ProductHoeffding`, `FusedChebyshev`
average of runs over K steps   `TrajectoryMcDiarmid`, `TrajectoryBousquet`, `TrajectoryChebyshev`,
                               `OneStepMcDiarmid`, `OneStepHoeffding`
=============================  =====================================================================

Rows (``axis="rows"``) are covered wherever the argument `axis` exists; the bounds for one step of
a trajectory are for columns only. The paper's own formulas are in :mod:`stochens_rs.paper.bounds`,
each with a text that says what is wrong with it.

Notation: ``g = ||w||_1``, ``g_j`` for line j of a matrix, ``L = log(1/delta)``.
"""

from ._base import Bound
from .averages import Average, Bousquet, Chebyshev, Hoeffding, McDiarmid, Systematic
from .certificate import from_errors
from .choice import Best, best, candidates
from .fused import DiagonalBousquet, DiagonalMcDiarmid, Fused, FusedChebyshev
from .norms import Bernstein, Weissman
from .one_step import OneStepHoeffding, OneStepMcDiarmid
from .product import ProductBousquet, ProductHoeffding, ProductMcDiarmid, ProductParts
from .simulated import Simulated
from .trajectories import Trajectory, TrajectoryBousquet, TrajectoryChebyshev, TrajectoryMcDiarmid

__all__ = [
    "Average",
    "Bernstein",
    "Best",
    "Bound",
    "Bousquet",
    "Chebyshev",
    "DiagonalBousquet",
    "DiagonalMcDiarmid",
    "Fused",
    "FusedChebyshev",
    "Hoeffding",
    "McDiarmid",
    "OneStepHoeffding",
    "OneStepMcDiarmid",
    "ProductBousquet",
    "ProductHoeffding",
    "ProductMcDiarmid",
    "ProductParts",
    "Simulated",
    "Systematic",
    "Trajectory",
    "TrajectoryBousquet",
    "TrajectoryChebyshev",
    "TrajectoryMcDiarmid",
    "Weissman",
    "best",
    "candidates",
    "from_errors",
]
