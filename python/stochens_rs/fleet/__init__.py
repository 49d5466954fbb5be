"""One command for many units, and the risk of a fresh one."""

from .plan import FleetPlan, control_fleet
from .risk import RiskBound

__all__ = ["FleetPlan", "RiskBound", "control_fleet"]
