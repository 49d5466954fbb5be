"""Realizations of vectors and matrices, and counts of realizations."""

from .counts import Counts
from .ensemble import Ensemble
from .law import Law
from .sampling import sample, sample_counts

__all__ = ["Counts", "Ensemble", "Law", "sample", "sample_counts"]
