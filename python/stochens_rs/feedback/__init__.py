"""Linear feedback `u = K x`: gains, and what is proved of them for all systems of a region."""

from .bounds import Margins, Rest, Rounding, Tube
from .certificate import LoopCertificate
from .loop import Loop, gain
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
