"""What runs beside a plant: one call in each step."""

from .keep import Kept
from .loop import Call
from .readings import Reading, ReadingLoop
from .regulating import regulate
from .regulator import Regulator

__all__ = ["Call", "Kept", "Reading", "ReadingLoop", "Regulator", "regulate"]
