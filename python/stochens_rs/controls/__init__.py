"""Controls from estimates, and what is known about their errors."""

from ..theory.records import PlanError, Reachability
from .basis import Basis, Known
from .one_step import control, realization_controls
from .plan import Plan
from .plan_bound import PlanBound
from .planning import Requirement, SamplePlan, required_samples
from .several_steps import control_steps
from .steering import steer
from .trajectory_plan import TrajectoryPlan

__all__ = [
    "Basis",
    "Known",
    "Plan",
    "PlanBound",
    "PlanError",
    "Reachability",
    "Requirement",
    "SamplePlan",
    "TrajectoryPlan",
    "control",
    "control_steps",
    "realization_controls",
    "required_samples",
    "steer",
]
