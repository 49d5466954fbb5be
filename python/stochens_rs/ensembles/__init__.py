"""Realizations of vectors, matrices and systems, and counts of realizations."""

from .ensemble import Ensemble, sample, sample_counts
from .law import Counts, Law
from .systems import SystemEnsemble

__all__ = ["Counts", "Ensemble", "Law", "SystemEnsemble", "sample", "sample_counts"]
