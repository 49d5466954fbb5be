"""Linear feedback `u = K x`: gains, and what is proved of them for all systems of a region."""

from .certificate import LoopCertificate
from .loop import Loop, gain
from .margins import Margins, Rounding
from .tube import Rest, Tube

__all__ = ["Loop", "LoopCertificate", "Margins", "Rest", "Rounding", "Tube", "gain"]
