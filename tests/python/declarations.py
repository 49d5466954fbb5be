"""Options of `identify`, `ModelStream` and `fuse` by their fields: flat words as objects."""

from __future__ import annotations

from typing import Any

import stochens_rs as se

NOISE = ("law", "covariance", "sigma", "exact", "design")
WINDOW = ("lags", "filters", "order", "delay", "tail")
PILOT = ("reference", "inputs", "dither", "lengths_fixed")


def opts(**words: Any) -> dict[str, Any]:
    """The words, those of noise, window and pilot as `Noise`, `Window` and `Pilot`."""
    noise = {name: words.pop(name) for name in NOISE if name in words}
    if isinstance(words.get("noise"), str):
        noise["law"] = words.pop("noise")
    window = {name: words.pop(name) for name in WINDOW if name in words}
    pilot = {name: words.pop(name) for name in PILOT if name in words}
    if noise:
        words["noise"] = se.Noise(**noise)
    if window:
        words["window"] = se.Window(**window)
    if pilot:
        words["pilot"] = se.Pilot(words.get("pilot"), **pilot)
    return words
