"""Repeated runs: studies of own functions; experiments, with their curves and figures."""

from .curves import Curve, Panel
from .experiment import Experiment
from .results import Failure, Results
from .study import Study
from .summary import Summary
from .templates import coverage, error

__all__ = [
    "Curve",
    "Experiment",
    "Failure",
    "Panel",
    "Results",
    "Study",
    "Summary",
    "coverage",
    "error",
]
