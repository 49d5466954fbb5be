"""Figures of arrays: the functions draw them and know none of the package's records."""

from .files import save_figures
from .style import require_matplotlib

__all__ = ["require_matplotlib", "save_figures"]
