"""Errors and bounds that can be computed before sampling.

:func:`~stochens_rs.theory.drawn_bound`
    A radius that an error exceeds with a given probability at most.
:mod:`~stochens_rs.theory.moments`
    Exact means and covariances of realizations, estimates, controls and simulated ensembles.
:mod:`~stochens_rs.theory.reachability`
    Which states K steps can reach: the controllability matrix and the Gramian.
:mod:`~stochens_rs.theory.scenario`
    How often a fresh unit misses more than the units a design was made for.
"""

from __future__ import annotations

from . import moments, reachability, scenario
from .drawn_bounds import drawn_bound

__all__ = ["drawn_bound", "moments", "reachability", "scenario"]
