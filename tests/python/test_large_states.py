"""Certificates of plans whose squares overflow: infinite, or scaled, without a warning."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from limit_plans import within
from stochens_rs.exceptions import NonFiniteError
from test_limit_bounds import measured

A, B = np.array([[0.9, 0.1], [0.0, 0.8]]), np.array([[0.0], [1.0]])
WAYS = {
    "free": {},
    "limits": {"limits": (-1.0, 1.0), "R": 1e-8},
    "rate": {"rate": 0.1, "previous": 0.0, "R": 1e-8},
    "state limits": {"limits": (-1.0, 1.0), "state_limits": (-2.0, 2.0), "R": 1e-8},
}


def planned(model, size, K, way):
    """The task of WAYS with all states and inputs `size` times as large."""
    kept = ("R",)
    more = {
        name: value if name in kept else tuple(size * v for v in value)
        if isinstance(value, tuple) else size * value
        for name, value in WAYS[way].items()
    }  # fmt: skip
    return se.control(model, [size, 0.0], [0.0, size / 3.0], steps=K, **within(**more))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("K", [1, 3])
@pytest.mark.parametrize("way", WAYS)
def test_bounds_of_large_states_are_scaled_or_infinite(gen, way, K):
    model = measured(gen, A, B, 60, 0.01)
    once = planned(model, 1.0, K, way).bound(0.1)
    for power in (300, 500, 506, 509, 530, 660, 990):
        size = 2.0**power
        try:
            found = planned(model, size, K, way).bound(0.1)
        except NonFiniteError:
            assert power > 506
            continue
        for name in ("state", "control"):
            small, large = getattr(once, name), getattr(found, name)
            assert large == np.inf or large == pytest.approx(size * small, rel=1e-3), (power, name)
        # the states themselves are far from overflow
        assert power > 506 or np.isfinite(found.state)
