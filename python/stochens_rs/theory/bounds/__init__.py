r"""Tail bounds: the probability that the error of an estimate, a control or a state is large.

Every bound is a :class:`Bound`, an inequality for one quantity, with three methods inverse to each
other: ``radius(size, delta)``, ``probability(size, eps)``, ``required_size(eps, delta)``.
:func:`best` picks one, :func:`candidates` gives all that apply, :func:`bound` one by its name. They
hold for every size and every delta, not only in the limit, for independent realizations
(``scheme="iid"``) under uniform weights; "systematic" and "simulated" are for the other scheme,
too, :func:`from_errors` for all other weights.

==================  ====================================================  =====================
quantity            choice                                                names of the bounds
==================  ====================================================  =====================
vector ``w``        ``norm="2"`` (default)                                McDiarmid, Bousquet,
                                                                          Weissman, Hoeffding,
                                                                          Chebyshev, systematic
..                  ``norm="1"``                                          Weissman
matrix ``A``        ``norm="Frobenius"``                                  McDiarmid, Bousquet,
                                                                          Hoeffding, Chebyshev,
                                                                          systematic
..                  ``norm="spectral"`` (default)                         Bernstein, and those
                                                                          of the Frobenius norm
state, control      ``fusion="product"`` (default)                        McDiarmid, Bousquet,
                                                                          sum of parts,
                                                                          Chebyshev; state:
                                                                          Hoeffding
..                  ``fusion="diagonal"``                                 McDiarmid, Bousquet,
                                                                          Chebyshev
trajectory          average of runs over K steps                          McDiarmid, Bousquet,
                                                                          Chebyshev
..                  one step, ``axis="columns"``                          McDiarmid, one step;
                                                                          Hoeffding, one step
all but trajectory  errors drawn from the law, delta from about 1e-4 on   simulated
==================  ====================================================  =====================

"simulated" is within a few percent of the quantile; the others are formulas, several times larger,
but none larger than the largest error that can happen at all. Among them Weissman's is best for few
entries, Bousquet's for many realizations, McDiarmid's for few, Bernstein's for large matrices,
Chebyshev's for large delta. `candidates` leaves out "simulated" and "systematic".

The code is a table *setting x inequality*: `table` has a row for each bound, with the text of its
source; `_settings` what the error is of, with the numbers that inequalities need; `_inequalities`
the formulas, with their sources in the literature. A new bound is a row and its formula, a new
quantity a setting. Rows (``axis="rows"``) are covered except for one step of a trajectory. The
paper's own formulas are in :mod:`stochens_rs.paper.bounds`, each with a text that says what is
wrong with it.
"""

from ._base import Bound
from .certificate import from_errors
from .simulated import Simulated
from .table import Best, best, bound, candidates

__all__ = ["Best", "Bound", "Simulated", "best", "bound", "candidates", "from_errors"]
