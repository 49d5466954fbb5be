"""Errors and bounds that can be computed before sampling.

:func:`~stochens_rs.theory.drawn_bound`
    A radius that an error exceeds with a given probability at most.
:mod:`~stochens_rs.theory.moments`
    Exact means and covariances of realizations, estimates, controls and simulated ensembles.
:func:`~stochens_rs.theory.controllability_matrix`, :func:`~stochens_rs.theory.gramian`
    Which states K steps can reach.
:mod:`~stochens_rs.theory.scenario`
    How often a fresh unit misses more than the units a design was made for.
"""

from __future__ import annotations

from . import moments, scenario
from .drawn_bounds import drawn_bound
from .exact import controllability_matrix, gramian

__all__ = ["controllability_matrix", "drawn_bound", "gramian", "moments", "scenario"]
