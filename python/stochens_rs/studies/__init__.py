"""Repeated runs: studies of own functions."""

from .results import Failure, Results
from .study import Study

__all__ = ["Failure", "Results", "Study"]
