"""What runs beside a plant: one call in each step."""

from .keep import Keep, Kept
from .readings import Reading, ReadingLoop
from .regulating import regulate
from .regulator import Call, Regulator, WorstTime

__all__ = [
    "Call",
    "Keep",
    "Kept",
    "Reading",
    "ReadingLoop",
    "Regulator",
    "WorstTime",
    "regulate",
]
