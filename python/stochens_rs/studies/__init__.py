"""Repeated runs: studies of own functions; experiments, with their curves and figures."""

from .curves import Curve, Panel
from .experiment import Experiment
from .ready import error
from .results import Results
from .study import Study
from .summary import Summary
from .tables import Failure

__all__ = ["Curve", "Experiment", "Failure", "Panel", "Results", "Study", "Summary", "error"]
