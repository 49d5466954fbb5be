"""Everything that is about the paper: its experiments, its statements, a report on both.

`power` and `tracking` repeat its two experiments, `claims` checks its statements one by one,
`write_report` makes a page of both. :mod:`~stochens_rs.paper.bounds` has its tail bounds as
printed, :mod:`~stochens_rs.paper.reachability` counterexamples to two of its lemmas. Nothing else
in the package needs any of this, but for the command line.
"""

from ..studies import Curve, Experiment, Panel
from . import bounds, reachability
from .experiments import power, tracking
from .report import final_errors, write_report
from .verdicts import Claim, Claims, Comparison, Evidence, Tails, claims

__all__ = [
    "Claim",
    "Claims",
    "Comparison",
    "Curve",
    "Evidence",
    "Experiment",
    "Panel",
    "Tails",
    "bounds",
    "claims",
    "final_errors",
    "power",
    "reachability",
    "tracking",
    "write_report",
]
