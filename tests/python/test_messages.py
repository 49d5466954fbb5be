"""Messages for arguments of another kind: what was expected, what was found, what to pass."""

from __future__ import annotations

import re
import warnings
from types import SimpleNamespace

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.exceptions import DataWarning, InputError, StochensError
from stochens_rs.theory import drawn_bound, moments, scenario

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
    (lambda: se.DataStream((A, B)), "`B` must be an array, got a tuple of arrays: pass B alone"),
    (
        lambda: se.control((FIT, B, 0.1, 2), X0, XF),
        "`system` must be a pair (A, B) or (A, B, dt) when A is a Fit, got 4 items",
    ),
    (
        lambda: se.realization_controls((ENSEMBLE, B, 0.1, 2), X0, XF),
        "`system` must be a pair (A, B) or (A, B, dt) when A is an Ensemble, got 4 items",
    ),
    (lambda: se.control(se.System, X0, XF), "`system` must be a System, got the class System"),
    (lambda: se.steer(SYSTEM, 10, X0, XF), "`x0` must have shape (3,), got int 10"),
    (lambda: se.simulate(SYSTEM, X0, 2.0), "`u` must have shape (K, 3), one row per step, got fl"),
    (
        lambda: se.fuse(ENSEMBLE, "alse", target=X0),
        "`target` must have shape (3, 3), got (3,)",
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
        "`data` of a state must be system, x0, xf, got 4",
    ),
    (
        lambda: drawn_bound("vector", size=5, delta=0.1),
        "`data` of a vector must be one array, got 0",
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

W, PAIRS, GAINS = np.array([1.0, -2.0]), se.sample([1.0, -2.0], 5, rng=1), np.ones((2, 1, 1))
STATES, INPUTS = np.random.default_rng(1).standard_normal((2, 30, 1))
RUNS, CLIENT = se.Trajectories(STATES, INPUTS[1:]), SimpleNamespace(get_executor=None)
ONE, TWO = ([[1.0]], [[1.0]]), se.SystemEnsemble(GAINS, GAINS)
# A prefix of the message.
CALLS += [
    (lambda: se.cases.ieee14(method="zo"), "`method` must be one of 'zoh', 'euler', got str 'zo'"),
    (lambda: se.cases.ieee14(dt=0.0), "`dt` must be > 0"),
    (lambda: se.System(A[:2], B), "`A` must have shape (n, n), got (2, 3)"),
    (lambda: se.System(A, B[:2]), "`B` must have shape (3, m), got (2, 3)"),
    (lambda: se.System.from_any((A,)), "`system` must be "),
    (lambda: se.sample([np.nan, 1.0], 5), "`target[0]` is nan: entries must be finite"),
    (lambda: se.sample([1.0], 0), "`size` must be in [1, 9007199254740992], got int 0"),
    (lambda: se.sample([1.0], 5, scheme="idd"), "`scheme` must be one of 'iid', 'systematic'"),
    (lambda: se.sample([1.0], 5, rng=-1), "`rng` must be an integer in [0, 2**4096), got int -1"),
    (lambda: se.sample([1.0], 2**50), "a sample of 1125899906842624 realizations needs "),
    (lambda: se.Key(b"short"), "`bytes32` must have 32 bytes, got 5"),
    (lambda: se.fuse(PAIRS, "alse"), "`target` is required"),
    (lambda: se.fuse(PAIRS, "als", target=W), "`method` must be one of "),
    (lambda: se.fusion.Alse(time_limit=0.0), "`time_limit` must be > 0"),
    (lambda: se.fuse_path(PAIRS, [3, 2], target=W), "`sizes[1]` is 2 after 3: sizes must increa"),
    (lambda: PAIRS.combine([1.0]), "`weights` must have shape (5,), got (1,)"),
    (lambda: se.control(SYSTEM, X0, XF, steps=0), "`steps` must be in [1, "),
    (lambda: se.track(SYSTEM, U, 0), "`size` must be in [1, "),
    (lambda: PLAN.bound(delta=0.0), "`delta` must be in (0, 1), got float 0.0"),
    (lambda: se.gain(ONE, 1.0), "`Q` and `R` must be given both"),
    (lambda: se.gain(ONE, 1.0, 0.0), "`R` must be > 0, got float 0.0"),
    (lambda: se.gain(ONE, 1.0, 1.0).certificate(), "`certificate` needs a loop for a model"),
    (lambda: se.control_fleet([], [0.0], [1.0], 1), "`systems` must"),
    (lambda: se.control_fleet(TWO, [0.0], [1.0], 1, discard=1), "`discard` needs risk='worst'"),
    (lambda: se.SystemEnsemble(A, B), "`A` must have 3 dimensions, got (3, 3)"),
    (lambda: se.Trajectories(np.ones((4, 2)), np.ones((4, 1))), "`inputs` must have "),
    (lambda: se.Window(lags=0), "`lags` must be "),
    (lambda: se.Noise("gauss"), "`law` must be one of "),
    (lambda: se.regulate(ONE, 0), "`steps` must be in [1, "),
    (lambda: se.simulate_ensemble(TWO, [1.0], [[1.0]], 4), "`size` must be left out"),
    (lambda: se.DataStream(B).u, "`u` needs at least one realization of x0, xf, A"),
    (lambda: se.System.from_any(SYSTEM, dt=0.2), "`dt` must be left out for a system in discrete"),
    (lambda: se.System.from_any((A, B, 0)), "`dt` is 0, which means continuous time: discretize "),
    (lambda: se.System(A, B, states=["a", "a", "b"]), "`states` must be different names, got 'a'"),
    (lambda: se.control(SYSTEM, X0, XF, limits=(1, -1)), "`limits` must have low <= high, got 1 >"),
    (
        lambda: se.control(SYSTEM, X0, XF, time_limit=1.0),
        "`time_limit` must be left out without li",
    ),
    (
        lambda: se.control((ENSEMBLE, B), X0, XF, steps=2, fusion="diagonal"),
        "`fusion` must be 'product' with steps=2, got 'diagonal'",
    ),
    (
        lambda: se.identify(RUNS, noise=se.Noise(design="independent")),
        "`design` must be 'adaptive' for runs of several steps",
    ),
    (
        lambda: se.identify(RUNS, noise=se.Noise("bounded")),
        "`sigma` must be given for law='bounded'",
    ),
    (
        lambda: se.identify(RUNS, checks=False).region(0.05, future=1),
        "`future` needs a region of all rows at once",
    ),
    (lambda: se.ModelStream(1, 1, first=10), "`first` needs design='independent'"),
    (
        lambda: se.Stream(SYSTEM, X0, XF).run(),
        "one of `tol`, `max_steps` and `time_limit` must be given",
    ),
    (lambda: se.Study(len, {"a": []}, replicates=2), "`grid['a']` must have at least one value"),
    (lambda: se.Study(len, {}, replicates=2).run(3), "`executor` must be of concurrent.futures"),
    (
        lambda: se.Study(len, {}, replicates=2).run(CLIENT),
        "`executor` must be of concurrent.futures, got an object of type SimpleNamespace: ",
    ),
    (lambda: scenario.judged(5, 6, 0.1), "`support` must be in [0, 5], got int 6"),
]


@pytest.mark.parametrize(("call", "message"), CALLS)
def test_the_message_says_what_to_pass(call, message):
    with pytest.raises(StochensError, match=f"^{re.escape(message)}"):
        call()


def test_a_tuple_of_rows_is_a_matrix():
    assert se.DataStream(((1.0,), (2.0,)))._shape == (2, 1)


def test_a_confidence_in_place_of_a_chance_of_error_is_warned_of():
    """0.95, meant as 95 %: whatever takes `delta` or `guarantee` says what holds then."""
    x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
    data = se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w)
    model = se.identify(data, noise=0.1)
    loop = se.gain(model, 1.0, 1.0)
    plan = se.control(model, [1.0], [0.0], steps=3)
    text = "`delta` = 0.95 is the probability of an error: what follows holds with 5 % only; for 95"
    for call in (loop.certificate, model.region, plan.bound):
        with pytest.warns(DataWarning, match=text):
            call(0.95)
    with (
        pytest.warns(DataWarning, match=r"`guarantee` = 0.9 is .*; for 90 % pass 0.1"),
        pytest.warns(DataWarning, match=r"`delta` = 0.9 is"),
    ):
        se.gain(model, 1.0, 1.0, guarantee=0.9)
    assert loop.certificate(0.5).status == "certified"


def test_accepts_and_watch_say_why_a_model_cannot_be_refuted():
    """A log that fails a test leaves no region: the message is about that, not an argument."""
    x, u, w = np.random.default_rng(3).standard_normal((3, 80, 1))
    data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + u**3 + 0.1 * w)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = se.identify(data, noise=se.Noise(sigma=0.1), checks=False)
    text = r"^`accepts` and `watch` need a model of which something is certain.*; but .*accept='"
    for asked in (lambda: model.accepts(data), se.gain(model, 1.0, 1.0).certificate().watch):
        with pytest.raises(InputError, match=text):
            asked()
