"""Linear feedback `u = K x`: gains, and what is proved of them for all systems of a region."""

from .certificate import LoopCertificate
from .loop import Loop, gain
from .tube import Rest, Tube

__all__ = ["Loop", "LoopCertificate", "Rest", "Tube", "gain"]
