"""What the results of this package are worth before anything is sampled.

:mod:`~stochens_rs.theory.moments`
    Exact means and covariances of realizations, estimates and controls.
:mod:`~stochens_rs.theory.bounds`
    Tail bounds: radii that hold with a given probability, and the sizes they need.
:mod:`~stochens_rs.theory.reachability`
    What one step or several steps can reach, exactly, for every realization, and on average.
"""

from __future__ import annotations

from . import bounds, moments, reachability

__all__ = ["bounds", "moments", "reachability"]
