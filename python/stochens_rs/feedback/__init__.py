"""Linear feedback `u = K x`: gains, and what is proved of them for all systems of a region."""

from .certificate import LoopCertificate
from .gaining import gain
from .loop import Loop
from .rest import Rest
from .tube import Tube

__all__ = ["Loop", "LoopCertificate", "Rest", "Tube", "gain"]
