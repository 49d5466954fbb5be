"""Measured runs: arrays, tables and CSV files as pairs ((x, u), x_next) in runs and pieces."""

from .trajectories import Trajectories

__all__ = ["Trajectories"]
