"""What the results of this package are worth before anything is sampled.

:mod:`~stochens_rs.theory.moments`
    Exact means and covariances of realizations, estimates and controls.
"""

from __future__ import annotations

from . import moments

__all__ = ["moments"]
