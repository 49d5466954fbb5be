"""Simulation of systems under controls: open loop, and tracking of a reference."""

from .closed_loop import StepEstimate, Tracking, track
from .trajectory import EnsembleTrajectory, Trajectory, simulate, simulate_ensemble

__all__ = [
    "EnsembleTrajectory",
    "StepEstimate",
    "Tracking",
    "Trajectory",
    "simulate",
    "simulate_ensemble",
    "track",
]
