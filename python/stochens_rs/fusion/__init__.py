"""Fusion of realizations, models or experiments into one estimate."""

from .fits import Alse, Fit, Path
from .fused_model import FusedModel
from .fusing import fuse, fuse_path

__all__ = ["Alse", "Fit", "FusedModel", "Path", "fuse", "fuse_path"]
