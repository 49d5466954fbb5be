"""Plans and loops against runs and systems that they were not made from."""

from .fresh_systems import Validation

__all__ = ["Validation"]
