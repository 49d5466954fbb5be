"""Controls from estimates, and what is known about their errors."""

from ..theory.records import PlanError, Reachability
from .control import control
from .cost import Cost
from .fleet import control_fleet
from .fleet_plan import FleetPlan
from .fleet_risk import RiskBound
from .keeping import Kept
from .limits import Limits
from .next_runs import NextRuns, design
from .plan import Plan
from .plan_validation import Validation
from .planning import required_samples
from .predicting import predict
from .reading_loop import Reading, ReadingLoop
from .realization import realization_controls
from .regulating import regulate
from .regulator import Regulator
from .regulator_log import Call
from .sample_plan import SamplePlan
from .steering import steer
from .typical import Typical
from .uncertain import Uncertain

__all__ = [
    "Call",
    "Cost",
    "FleetPlan",
    "Kept",
    "Limits",
    "NextRuns",
    "Plan",
    "PlanError",
    "Reachability",
    "Reading",
    "ReadingLoop",
    "Regulator",
    "RiskBound",
    "SamplePlan",
    "Typical",
    "Uncertain",
    "Validation",
    "control",
    "control_fleet",
    "design",
    "predict",
    "realization_controls",
    "regulate",
    "required_samples",
    "steer",
]
