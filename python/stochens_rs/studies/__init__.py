"""Repeated runs: studies of own functions; experiments, with their curves and figures."""

from .curves import Curve, Panel
from .experiment import Experiment
from .ready import error
from .ready_coverage import coverage
from .ready_fleet import fleet
from .ready_loop import closed_loop
from .ready_sampling import sampling_coverage
from .results import Failure, Results
from .study import Study
from .summary import Summary

__all__ = [
    "Curve",
    "Experiment",
    "Failure",
    "Panel",
    "Results",
    "Study",
    "Summary",
    "closed_loop",
    "coverage",
    "error",
    "fleet",
    "sampling_coverage",
]
