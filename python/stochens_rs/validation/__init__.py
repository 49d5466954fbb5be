"""Plans and loops against runs and systems that they were not made from."""

from .held_out import Validation

__all__ = ["Validation"]
