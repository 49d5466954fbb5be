"""Figures of arrays."""

from .files import save_figures
from .style import require_matplotlib

__all__ = ["require_matplotlib", "save_figures"]
