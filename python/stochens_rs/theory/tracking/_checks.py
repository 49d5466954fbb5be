"""Checks that the theory and the simulation of tracking share."""

from __future__ import annotations

import numpy as np

from ... import _gate
from ...exceptions import InputError, InputTypeError
from ..moments._formulas import Array


def flag(name: str, value: object) -> bool:
    """Check a switch."""
    if not isinstance(value, (bool, np.bool_)):
        raise InputTypeError(f"`{name}` must be True or False, got {_gate.show(value)}")
    return bool(value)


def checked_reference(reference: object, n: int) -> Array:
    """Check that there is at least one step."""
    r = _gate.matrix("reference", reference, cols=n)
    if len(r) < 2:
        raise InputError(f"`reference` must have shape (K + 1, {n}) with K >= 1, got {r.shape}")
    return r
