"""Functions for studies: what is compared most often."""

from .certificates import coverage
from .sampling_errors import error

__all__ = ["coverage", "error"]
