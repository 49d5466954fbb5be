"""One command for many units, and the risk of a fresh one."""

from .plan import FleetPlan, RiskBound, control_fleet

__all__ = ["FleetPlan", "RiskBound", "control_fleet"]
