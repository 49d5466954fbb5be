"""What the results of this package are worth before anything is sampled.

:mod:`~stochens_rs.theory.bounds`
    Tail bounds: radii that hold with a given probability, and the sizes they need.
:mod:`~stochens_rs.theory.moments`
    Exact means and covariances of realizations, estimates, controls and simulated ensembles.
:mod:`~stochens_rs.theory.multistep`
    Leading-order covariance of the state that a control over several steps leads to.
:mod:`~stochens_rs.theory.reachability`
    What one step or several steps can reach.
:mod:`~stochens_rs.theory.tracking`
    Exact errors and stability of tracking a reference with fresh estimates in every step.
"""

from __future__ import annotations

from . import bounds, moments, multistep, reachability, tracking

__all__ = ["bounds", "moments", "multistep", "reachability", "tracking"]
