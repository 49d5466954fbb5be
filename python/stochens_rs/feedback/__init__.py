"""Linear feedback `u = K x`: gains, and what is proved of them for all systems of a region."""

from .certificate import LoopCertificate
from .loop import Loop, gain
from .margins import Margins, Rounding
from .tube import Rest, Tube
from .watch import Watch, Watched

__all__ = [
    "Loop",
    "LoopCertificate",
    "Margins",
    "Rest",
    "Rounding",
    "Tube",
    "Watch",
    "Watched",
    "gain",
]
