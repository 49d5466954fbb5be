"""Controls from estimates, and what is known about their errors."""

from ..theory.records import PlanError, Reachability
from .fleet import control_fleet
from .fleet_plan import FleetPlan
from .fleet_risk import RiskBound
from .fused import control, realization_controls
from .plan import Plan
from .plan_bound import PlanBound
from .planning import required_samples
from .sample_plan import SamplePlan
from .steering import steer

__all__ = [
    "FleetPlan",
    "Plan",
    "PlanBound",
    "PlanError",
    "Reachability",
    "RiskBound",
    "SamplePlan",
    "control",
    "control_fleet",
    "realization_controls",
    "required_samples",
    "steer",
]
