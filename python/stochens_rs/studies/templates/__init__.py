"""Functions for studies: what is compared most often."""

from .bounds import sampling_coverage
from .certificates import coverage
from .feedback import closed_loop
from .fleets import fleet
from .sampling_errors import error

__all__ = ["closed_loop", "coverage", "error", "fleet", "sampling_coverage"]
