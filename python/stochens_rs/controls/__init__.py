"""Controls from estimates, and what is known about their errors."""

from ..theory.records import PlanError, Reachability
from .basis import Basis, Known
from .fused import control, realization_controls
from .plan import Plan
from .plan_bound import PlanBound
from .planning import required_samples
from .sample_plan import Requirement, SamplePlan
from .steering import steer

__all__ = [
    "Basis",
    "Known",
    "Plan",
    "PlanBound",
    "PlanError",
    "Reachability",
    "Requirement",
    "SamplePlan",
    "control",
    "realization_controls",
    "required_samples",
    "steer",
]
