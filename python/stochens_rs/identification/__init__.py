"""Models from measured runs, and regions that contain the true system."""

from ..data import Trajectories
from .assumptions import Assumptions, Misfit, Noise, Pilot, Window
from .changes import Changes
from .checks import Checks
from .identifying import identify
from .model import Model
from .region import Region
from .window import Regressors

__all__ = [
    "Assumptions",
    "Changes",
    "Checks",
    "Misfit",
    "Model",
    "Noise",
    "Pilot",
    "Region",
    "Regressors",
    "Trajectories",
    "Window",
    "identify",
]
