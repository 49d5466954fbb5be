"""Limits and weights of controls: given, checked, and the best control within them."""

from .limits import Cost, Forecast, Limits, Uncertain

__all__ = ["Cost", "Forecast", "Limits", "Uncertain"]
