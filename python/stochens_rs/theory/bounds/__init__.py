r"""Tail bounds on the error of an estimate, a control or a state.

Every bound is a :class:`Bound`, an inequality for one quantity, with three methods inverse to each
other: ``radius(size, delta)``, ``probability(size, eps)``, ``required_size(eps, delta)``.
:func:`best` picks one, :func:`candidates` gives all that apply, :func:`bound` one by its name. They
hold for every size and every delta, for independent realizations (``scheme="iid"``) under uniform
weights. For systematic samples there are "systematic" and "simulated", for other weights
:func:`from_errors`.

==================  ====================================================  =====================
quantity            choice                                                names of the bounds
==================  ====================================================  =====================
vector ``w``        ``norm="2"`` (default)                                Bousquet, Weissman,
                                                                          systematic
..                  ``norm="1"``                                          Weissman
matrix ``A``        ``norm="Frobenius"``                                  Bousquet, systematic
..                  ``norm="spectral"`` (default)                         Bernstein, and those
                                                                          of the Frobenius norm
state, control      ``fusion="product"`` (default)                        McDiarmid, Bousquet
..                  ``fusion="diagonal"``                                 Bousquet
all                 errors drawn from the law, delta >= `least_delta`     simulated
==================  ====================================================  =====================

"simulated" is within a few percent of the quantile; the others are formulas, several times larger,
but at most the largest possible error. Among them Weissman's is best for few entries, Bousquet's
for many realizations, Bernstein's for large matrices; McDiarmid's is for few realizations, or
different numbers of them. `candidates` leaves out "simulated" and "systematic".

`table` has a row for each bound, with the settings it holds in and the text of its source; the
formulas, with their sources in the literature, are in `rust/tails/`. All bounds hold for
``axis="rows"``, too.
"""

from .base import Bound
from .certificate import from_errors
from .choosing import Best, best, bound, candidates
from .simulated import Simulated

__all__ = ["Best", "Bound", "Simulated", "best", "bound", "candidates", "from_errors"]
