"""Realizations of vectors, matrices and systems, and counts of realizations."""

from .ensemble import Counts, Ensemble, Law, sample, sample_counts
from .systems import SystemEnsemble

__all__ = ["Counts", "Ensemble", "Law", "SystemEnsemble", "sample", "sample_counts"]
