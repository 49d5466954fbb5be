"""Errors and bounds that can be computed before sampling.

:mod:`~stochens_rs.theory.bounds`
    Tail bounds: radii that hold with a given probability, and the sizes they need.
:mod:`~stochens_rs.theory.moments`
    Exact means and covariances of realizations, estimates, controls and simulated ensembles.
:mod:`~stochens_rs.theory.reachability`
    Which states K steps can reach: the controllability matrix and the Gramian.
:mod:`~stochens_rs.theory.scenario`
    How often a fresh unit misses more than the units a design was made for.
:mod:`~stochens_rs.theory.tracking`
    Exact errors of tracking a reference with new estimates in every step.
"""

from __future__ import annotations

from . import bounds, moments, reachability, scenario, tracking

__all__ = ["bounds", "moments", "reachability", "scenario", "tracking"]
