"""The paper reproduced: its experiments, its statements, and a report on both.

A program of its own beside the package, on whose public names it stands. `power` and `tracking`
repeat the two experiments, `claims` checks the statements one by one, `write_report` makes a page
of both. :mod:`paper.bounds` has the tail bounds as printed, :mod:`paper.reachability`
counterexamples to two lemmas. ``python -m paper reproduce`` and ``python -m paper claims`` run it.
"""

from . import bounds, reachability
from .curves import Curve, Panel
from .experiment import Experiment
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
