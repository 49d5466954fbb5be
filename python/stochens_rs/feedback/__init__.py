"""Linear feedback `u = K x`: gains, and what is proved of them for all systems of a region."""

from .certificate import LoopCertificate
from .loop import Loop, gain
from .tube import Rest, Tube
from .watch import Watch, Watched

__all__ = ["Loop", "LoopCertificate", "Rest", "Tube", "Watch", "Watched", "gain"]
