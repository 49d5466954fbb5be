"""The class of figures that pyplot shows. Imported only when one is drawn."""

from __future__ import annotations

from matplotlib.figure import Figure

__all__ = ["ShownFigure"]


class ShownFigure(Figure):
    """A figure that a notebook shows once, also as the last expression of a cell."""

    def _repr_mimebundle_(self, include: object = None, exclude: object = None) -> None:
        """Add nothing to what matplotlib displays; pyplot shall not show it again afterwards."""
        import matplotlib.pyplot as plt

        plt.close(self)
