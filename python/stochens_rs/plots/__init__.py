"""Figures of arrays: the functions draw them and know none of the package's records."""

from .style import save, save_figures

__all__ = ["save", "save_figures"]
