"""Controls from estimates, and what is known about their errors."""

from ..limits.problem import Limited
from ..theory.exact import PlanError, Reachability
from .control import control, realization_controls, steer
from .errors import Typical
from .next_runs import NextRuns, design
from .of_model import predict
from .plan import Plan
from .sample_size import SamplePlan, required_samples

__all__ = [
    "Limited",
    "NextRuns",
    "Plan",
    "PlanError",
    "Reachability",
    "SamplePlan",
    "Typical",
    "control",
    "design",
    "predict",
    "realization_controls",
    "required_samples",
    "steer",
]
