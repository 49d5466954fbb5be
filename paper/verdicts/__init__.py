"""The paper's statements checked one by one."""

from .check import claims
from .comparison import Comparison
from .records import Claim, Claims, Evidence
from .tails import Tails

__all__ = ["Claim", "Claims", "Comparison", "Evidence", "Tails", "claims"]
