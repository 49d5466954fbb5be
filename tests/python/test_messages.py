"""Messages for arguments of another kind: what was expected, what was found, what to pass."""

from __future__ import annotations

import re

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs import _core
from stochens_rs.exceptions import InputError, InputTypeError, ShapeError
from stochens_rs.fusion.fusing import METHODS
from stochens_rs.theory import drawn_bound, moments

A, B = np.diag([0.9, 0.8, 0.7]), np.eye(3)
X0, XF, U = np.ones(3), np.zeros(3), np.ones((2, 3))
ENSEMBLE = se.sample(A, 20, rng=1)
FIT, COUNTS = se.fuse(ENSEMBLE), se.sample_counts(A, 20, rng=1)
SYSTEM = se.System(A, B)
PLAN = se.control(SYSTEM, X0, XF)

FIT_HERE = "`A` must be an array here, got a Fit: pass fit.estimate"
CALLS = [
    (lambda: se.simulate((FIT, B), X0, U), FIT_HERE),
    (lambda: se.steer((FIT, B), X0, XF, 10), FIT_HERE),
    (lambda: moments.control_rms((FIT, B), X0, XF, 10), FIT_HERE),
    (lambda: PLAN.error((FIT, B), X0, XF), FIT_HERE),
    (
        lambda: se.simulate((ENSEMBLE, B), X0, U),
        "`A` must be an array here, got an Ensemble: pass ensemble.mean()",
    ),
    (
        lambda: se.simulate((COUNTS, B), X0, U),
        "`A` must be an array here, got Counts: pass counts.estimate",
    ),
    (lambda: se.simulate(SYSTEM, X0, PLAN), "`u` must be an array, got a Plan: pass plan.u"),
    (lambda: se.DataStream(SYSTEM), "`B` must be an array, got a System: pass system.B"),
    (
        lambda: se.DataStream((A, B)),
        "`B` must be an array, got a tuple of arrays: pass B alone",
    ),
    (
        lambda: se.control((FIT, B, 0.1, 2), X0, XF),
        "`system` must be a pair (A, B) or (A, B, dt) when A is a Fit, got 4 items",
    ),
    (
        lambda: se.realization_controls((ENSEMBLE, B, 0.1, 2), X0, XF),
        "`system` must be a pair (A, B) or (A, B, dt) when A is an Ensemble, got 4 items",
    ),
    (
        lambda: se.control(se.System, X0, XF),
        "`system` must be a System, got the class System",
    ),
    (lambda: se.steer(SYSTEM, 10, X0, XF), "`x0` must have shape (3,), got int 10"),
    (lambda: se.simulate(SYSTEM, X0, 2.0), "`u` must have shape (K, 3), one row per step, got fl"),
    (
        lambda: se.fuse(ENSEMBLE, "alse", target=X0),
        "`target` must have shape (3, 3) as a realization, got (3,)",
    ),
    (
        lambda: se.track(SYSTEM, np.ones((3, 4)), 5),
        "`reference` must have shape (K + 1, 3), one row per step, got (3, 4)",
    ),
    (
        lambda: moments.trajectory_rms(SYSTEM, X0, np.ones((2, 4))),
        "`u` must have shape (K, 3), one row per step, got (2, 4)",
    ),
    (
        lambda: drawn_bound("state", B, X0, XF, A, size=5, delta=0.1),
        "`data` must be system, x0, xf for a state, got 4 arguments",
    ),
    (
        lambda: drawn_bound("vector", size=5, delta=0.1),
        "`data` must be one array for a vector, got 0 arguments",
    ),
    (
        lambda: drawn_bound("state", SYSTEM, X0, XF, size=5, delta=0.1, norm="1"),
        "`norm` must be '2', got str '1'",
    ),
    (
        lambda: moments.final_state_covariance((A, B[:, :1]), X0, XF, 1),
        "`steps` must be large enough for C_K to have rank n=3, got rank 1 with steps=1:",
    ),
]


@pytest.mark.parametrize(("call", "message"), CALLS)
def test_the_message_says_what_to_pass(call, message):
    with pytest.raises((InputError, InputTypeError, ShapeError), match=f"^{re.escape(message)}"):
        call()


def test_a_tuple_of_rows_is_a_matrix():
    assert se.DataStream(((1.0,), (2.0,)))._shape == (2, 1)


def test_the_core_refuses_unknown_words():
    lines, draws = np.ascontiguousarray(A.T), ENSEMBLE._core_realizations()
    words = str(METHODS).strip("()")
    factors, key = (B, B, np.ones(3)), bytes(32)
    for word in ("", "SLSE", "slse-", "greedy"):
        message = f"`method` must be one of {words}, got '{word}'"
        with pytest.raises(InputError, match=message):
            _core.fuse_path(draws, lines, word, [20], False)
        with pytest.raises(InputError, match=message):
            _core.track(lines, B, X0, U, factors, 5, word, True, False, 1, key, 1)
    with pytest.raises(InputError, match="`method` must be one without a solver, got 'alse'"):
        _core.fuse_path(draws, lines, "alse", [20], False)
    with pytest.raises(InputError, match="`norm` must be '1', '2' or 'spectral', got 'F'"):
        _core.simulate_estimates(lines, 5, "iid", "F", 1, 1.0, key, 1)
