"""Measured runs of a system."""

from .trajectories import Trajectories

__all__ = ["Trajectories"]
