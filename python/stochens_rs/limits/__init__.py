"""Limits and weights of controls: given, checked, and the best control within them."""

from .limits import Cost, Limits, Uncertain

__all__ = ["Cost", "Limits", "Uncertain"]
