"""The paper's two numerical experiments, as data.

`power` is the experiment of section 5.1 (a power network steered to the origin in one step,
figures 1 and 2), `tracking` the one of section 5.2 (a reference of two states tracked in
dimension 100, figure 3). Both return an `Experiment`: every error of every replicate, the
exact values theory predicts for uniform weights, and what is needed to repeat the run.
"""

from __future__ import annotations

from .power import power
from .tracking import tracking

__all__ = ["power", "tracking"]
