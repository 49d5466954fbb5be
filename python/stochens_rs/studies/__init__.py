"""Repeated runs: studies of own functions."""

from .results import Failure, Results
from .study import Study
from .summary import Summary
from .templates import coverage, error

__all__ = [
    "Failure",
    "Results",
    "Study",
    "Summary",
    "coverage",
    "error",
]
