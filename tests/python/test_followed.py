"""`Plan.bound` of a plan that is followed with a certified feedback."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import at_most
from stochens_rs.exceptions import InputError
from test_feedback import WEIGHTS
from test_keep import A, B, model_of_runs

pytestmark = pytest.mark.filterwarnings("ignore:accepted:stochens_rs.exceptions.DataWarning")
X0 = np.array([0.1, 0.0, 0.0, 0.0])
STEPS = 20


def planned(seed=1, N=30, **options):
    model = model_of_runs(N, seed=seed, accept="variance")  # by chance, once in 40
    cost = se.Cost(Q=WEIGHTS[0], R=WEIGHTS[1])
    plan = se.control(model, options.pop("x0", X0), np.zeros(4), steps=STEPS, cost=cost, **options)
    return plan, se.gain(model, *WEIGHTS)


def ride(plan, K, x0, noise=0.0, gen=None):
    x, states, inputs = np.array(x0), [np.array(x0)], []
    for u, xh in zip(plan.u, plan.predicted_states, strict=False):
        inputs.append(u + K @ (x - xh))
        x = A @ x + B @ inputs[-1] + (noise * gen.standard_normal(4) if noise else 0.0)
        states.append(x)
    return np.array(states), np.array(inputs)


def inside(bound, plan, states, inputs):
    off = np.linalg.norm(states - plan.predicted_states, axis=1)
    return (
        (off <= bound.tube * (1 + 1e-9) + 1e-12).all()
        and np.linalg.norm(states[-1]) <= bound.target
        and (np.abs(states[-1]) <= bound.components).all()
        and (np.abs(inputs - plan.u).max(axis=0) <= bound["inputs"].radius).all()
    )


def test_the_true_system_stays_in_the_tube_of_the_plan():
    """40 data sets at 10 % without noise; with noise, 5 % for the region and 5 % for 20 steps."""
    gen, missed, noisy = np.random.default_rng(1), 0, 0
    for seed in range(40):
        plan, gain = planned(seed)
        bound = plan.bound(0.1, gain=gain)
        missed += not inside(bound, plan, *ride(plan, gain.K, X0))
        assert bound.target <= sum(bound.parts.values()) * (1 + 1e-12)
        with_noise = plan.bound(0.1, gain=gain, noise=True)
        assert with_noise.target > bound.target
        assert with_noise.parts["noise"] > 0.0
        noisy += not inside(with_noise, plan, *ride(plan, gain.K, X0, 0.0005, gen))
    at_most(missed, 40, 0.1)
    at_most(noisy, 40, 0.1)


def test_with_feedback_an_unstable_plan_is_certified_far_better():
    plan, gain = planned()
    open_loop, followed = plan.bound(0.05), plan.bound(0.05, gain=gain)
    assert followed.target < 0.5 * open_loop.target
    # the anti-test: without the feedback the tube does not hold
    states, _ = ride(plan, 0.0 * gain.K, X0)
    assert not inside(followed, plan, states, plan.u)
    assert followed.quantities["tube"].method == "a certified feedback, without noise"
    assert "K (x(k) - xh(k))" in followed.assumption
    assert se.Certificate.from_dict(followed.to_dict()).target == followed.target


def test_a_start_that_is_not_known():
    x0 = se.Uncertain(X0, 0.01)
    plan, gain = planned(x0=x0)
    bound = plan.bound(0.05, gain=gain)
    assert bound.parts["start"] > 0.0
    assert bound.target <= sum(bound.parts.values()) * (1 + 1e-12)
    for d in np.eye(4):
        assert inside(bound, plan, *ride(plan, gain.K, X0 + 0.01 * d))


@pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
def test_what_is_refused_or_infinite():
    plan, gain = planned()
    with pytest.raises(InputError, match="must be the model"):
        plan.bound(gain=se.gain(model_of_runs(31), *WEIGHTS))
    with pytest.raises(InputError, match="`bands` must be False with `gain`"):
        plan.bound(gain=gain, bands=True)
    with pytest.raises(InputError, match="`delta` must be at least"):
        plan.bound(0.04, gain=gain.certificate(0.05))
    with pytest.raises(InputError, match="`delta` must be above"):
        plan.bound(0.05, gain=gain.certificate(0.05), noise=True)
    with pytest.raises(se.exceptions.InputTypeError, match="`gain`"):
        plan.bound(gain=gain.K)
    model, accepted = (model_of_runs(100, declared=0.0003, accept=of) for of in ((), "noise size"))
    accepted = se.gain(accepted, *WEIGHTS)
    assert accepted.certificate(0.05).status == "certified"
    with pytest.raises(InputError, match=r"got another: residuals are 1\.7 times as large"):
        se.control(model, X0, np.zeros(4), steps=20).bound(gain=accepted)
    known = se.control((A, B), X0, np.zeros(4), steps=20)
    with pytest.raises(InputError, match="`gain` must be left out"):
        known.bound(gain=gain)
    few, weak = planned(N=2)
    bound = few.bound(0.05, gain=weak)
    assert bound.target == np.inf
    assert bound.quantities["target"].reason
