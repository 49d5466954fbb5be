"""Repeated runs: their errors, curves and figures."""

from .curves import Curve, Panel
from .experiment import Experiment

__all__ = ["Curve", "Experiment", "Panel"]
