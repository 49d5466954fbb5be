"""Fusion of realizations into one estimate."""

from .fits import Fit, Path
from .fusing import fuse, fuse_path

__all__ = ["Fit", "Path", "fuse", "fuse_path"]
