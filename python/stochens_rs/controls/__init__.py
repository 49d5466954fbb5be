"""Controls from estimates, and what is known about their errors."""

from ..limits.problem import Limited
from ..theory.exact import PlanError, Reachability
from .bounds import Typical
from .control import control, realization_controls, steer
from .experiments import NextRuns, SamplePlan, design, required_samples
from .of_model import predict
from .plan import Plan

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
