"""Numbers of realizations: every bound is valid, the simulation has the exact moments."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
import tail_bounds as bounds
from stochens_rs.exceptions import SizeError
from stochens_rs.rng import as_key
from stochens_rs.theory import moments

GEN = np.random.default_rng(0)
SYSTEM = se.System(GEN.standard_normal((4, 4)), GEN.standard_normal((4, 2)))
X0, XF = GEN.standard_normal(4), GEN.standard_normal(4)


@pytest.mark.parametrize("quantity", ["state", "control"])
@pytest.mark.parametrize("fusion", ["product", "diagonal"])
def test_bounds_keep_their_word(quantity: str, fusion: str) -> None:
    plan = se.required_samples(
        SYSTEM, X0, XF, 0.2, delta=0.05, quantity=quantity, fusion=fusion, rng=1
    )
    sizes = [row.size for row in plan.rows]
    assert sizes == sorted(sizes)
    # 1000 runs: 4 standard errors above 5 % are 77 failures
    assert all(row.failures <= 77 for row in plan.rows)
    drawn = bounds.bound("simulated", quantity, SYSTEM, X0, XF, fusion=fusion)
    assert plan.rows[0].name == "simulated"
    size = drawn.required_size(plan.error, 0.05)
    assert plan.size == pytest.approx(size, rel=0.1)  # another stream
    rms_of = moments.control_rms if quantity == "control" else moments.state_rms
    assert rms_of(SYSTEM, X0, XF, plan.expected_size, fusion=fusion) <= plan.error
    assert rms_of(SYSTEM, X0, XF, plan.expected_size - 1, fusion=fusion) > plan.error
    assert plan.expected_size < plan.simulated_size < plan.size
    assert plan.rows[0].rms == rms_of(SYSTEM, X0, XF, plan.size, fusion=fusion)


@pytest.mark.parametrize("quantity", ["state", "control"])
@pytest.mark.parametrize("fusion", ["product", "diagonal"])
def test_the_simulation_has_the_exact_moments(quantity: str, fusion: str) -> None:
    A = SYSTEM.A.copy()
    A[:, 1] = 0.0  # a column that is always exact
    runs = 4000  # relative standard error of the mean square below 2.5 %; 10 % is 4 of them
    law = bounds.bound("simulated", quantity, (A, SYSTEM.B), X0, XF, fusion=fusion).errors(7)
    errors = law.draw(runs, as_key(5))[:, int(quantity == "control")]
    rms_of = moments.control_rms if quantity == "control" else moments.state_rms
    exact = rms_of(SYSTEM, X0, XF, 7, fusion=fusion)
    square = float(np.mean(errors**2))
    assert square == pytest.approx(exact**2, rel=0.1)
    other = rms_of(SYSTEM, X0, XF, 7, fusion="product" if fusion == "diagonal" else "diagonal")
    assert square != pytest.approx(other**2, rel=0.1)


@pytest.mark.parametrize(
    "options", [{}, {"quantity": "control"}, {"fusion": "diagonal"}, {"steps": 3}]
)
@pytest.mark.parametrize("delta", [0.3, 0.01])
def test_the_answer_is_near_the_smallest_sufficient_size(options, delta) -> None:
    """Within 1.3 times: at a size 1.3 times smaller the simulated quantile is too large.

    The share beyond the quantile is known to 5 % at delta 0.01, to 2 % at 0.3 (one standard error).
    """
    count = 40_000 if delta == 0.01 else 6000
    plan = se.required_samples(SYSTEM, X0, XF, 0.1, delta=delta, rng=3, **options)
    kind = options.pop("quantity", "state")
    law = bounds.bound("simulated", kind, SYSTEM, X0, XF, **options).errors
    which = int(kind == "control")
    drawn = law(plan.size).draw(count, as_key(9))[:, which]
    assert np.mean(drawn > plan.error) <= delta * 1.1
    drawn = law(round(plan.size / 1.3)).draw(count, as_key(10))[:, which]
    assert np.mean(drawn > plan.error) > delta


def test_what_no_bound_can_promise_is_said() -> None:
    plan = se.required_samples(SYSTEM, X0, XF, 8e-8, rng=1)
    assert plan.rows[-1].size is None
    assert "none up to 2^53" in str(plan)
    with pytest.raises(SizeError, match="more than 2"):
        se.required_samples(SYSTEM, X0, XF, 1e-12, rng=1)


def test_several_steps_need_a_delta_that_can_be_simulated() -> None:
    with pytest.raises(SizeError, match=r"`delta` must be at least .* got 1e-07"):
        se.required_samples(SYSTEM, X0, XF, 0.1, delta=1e-7, steps=3, rng=1)


def test_a_known_problem_needs_one_realization() -> None:
    plan = se.required_samples(se.System(np.eye(2), np.eye(2)), [0.0, 2.0], [1.0, 0.0], 0.1, rng=1)
    assert plan.size == 1
    assert plan.simulated_size == 1


def test_the_origin_within_reach_is_zero_up_to_rounding() -> None:
    """The error is then relative to x0, or to the control that moves x0 to the origin."""
    system = se.System(SYSTEM.A, GEN.standard_normal((4, 4)))
    for steps in (1, 2):
        state = se.required_samples(system, X0, [0.0] * 4, 0.1, steps=steps, rng=1)
        assert (state.relative_to, state.reference) == ("x0", pytest.approx(np.linalg.norm(X0)))
        assert state.error == pytest.approx(0.1 * np.linalg.norm(X0))
        assert "(10 % of 1.49, the norm of x0, as the exact control leads to" in str(state)
    target = [float(sum(row[::-1] * X0[::-1])) for row in SYSTEM.A]  # A x0 in another order
    same = se.required_samples(system, X0, target, 0.1, quantity="control", rng=1)
    back = np.linalg.norm(np.linalg.solve(system.B, system.A @ X0))
    assert (same.relative_to, same.reference) == ("B^+ A x0", pytest.approx(back))
    plan = se.steer(system, X0, [0.0] * 4, 100, rng=1)
    assert plan.error(system, X0, [0.0] * 4).state_relative_to == state.relative_to
    plan = se.required_samples(system, X0, [0.0] * 4, 0.5, relative=False, rng=1)
    assert plan.size > 1
