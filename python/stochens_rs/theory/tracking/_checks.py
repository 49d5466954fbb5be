"""Checks that the theory and the simulation of tracking share."""

from __future__ import annotations

from ..._base import gate
from ...exceptions import InputError
from ..formulas import Array


def checked_reference(reference: object, n: int) -> Array:
    """Check that there is at least one step."""
    r = gate.matrix("reference", reference, cols=n)
    if len(r) < 2:
        raise InputError(f"`reference` must have shape (K + 1, {n}) with K >= 1, got {r.shape}")
    return r
