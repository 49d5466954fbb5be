"""Models from measured runs, and regions that contain the true system."""

from ..data import Trajectories
from .assumptions import Assumptions
from .checks import Checks
from .identifying import identify
from .model import Model
from .region import Region
from .window import Window

__all__ = ["Assumptions", "Checks", "Model", "Region", "Trajectories", "Window", "identify"]
