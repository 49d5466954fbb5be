"""Messages about limits and weights, and whatever else is given for them."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from limit_plans import within
from stochens_rs.exceptions import InputError
from test_hostile import PERHAPS

TWO = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.0], [1.0]])  # the double integrator


# -- messages --------------------------------------------------------------------------------------


def test_limits_by_name_leave_the_others_free():
    names = {"states": ["pos [m]", "speed"], "inputs": ["force [N]", "brake"]}
    cart = se.System(TWO[0], [[0.0, 0.1], [1.0, -0.5]], **names)
    start = [3.0, 0.0], [0.0, 0.0]
    whole = (np.array([-np.inf, -0.2]), np.array([np.inf, 0.3]))
    plan = se.control(cart, *start, steps=4, limits=whole)
    named = se.control(cart, *start, steps=4, limits={"brake": (-0.2, 0.3)})
    np.testing.assert_array_equal(named.u, plan.u)
    assert plan.limited.active.any()
    # without the unit, on one side, beside limits of states
    sides = {"force": (None, 0.1), "brake": None}, (-0.5, 0.5)
    both = se.Limits(u=sides[0], x={"speed": sides[1]})
    given = se.Limits(u=(None, [0.1, np.inf]), x=([-np.inf, -0.5], [np.inf, 0.5]))
    plans = [se.control(cart, *start, steps=4, limits=one) for one in (both, given)]
    np.testing.assert_array_equal(plans[0].u, plans[1].u)
    assert se.Limits.from_dict(both.to_dict()) == both
    loops = [se.regulate(cart, 4, limits=one) for one in ({"brake": (-0.2, 0.3)}, whole)]
    np.testing.assert_array_equal(*(loop(start[0]) for loop in loops))
    said = (
        r"`limits\[0\]` names 'brakes', but there are 'force \[N\]', 'brake'; did you mean 'brake'"
    )
    with pytest.raises(InputError, match=said):
        se.control(cart, *start, limits={"brakes": (-1.0, 1.0)})
    with pytest.raises(InputError, match=r"`limits.x\[0\]` names 'force', but there are 'pos"):
        se.control(cart, *start, limits=se.Limits(x={"force": (-1.0, 1.0)}))


WITH = {"limits": (-1.0, 1.0), "Q": 1.0, "Qf": [1.0, 2.0], "R": 0.1, "time_limit": 10.0}
WITH |= {"state_limits": (None, 0.5), "soft": 10.0, "rate": 1.0, "previous": [0.0]}


@pytest.mark.parametrize("name", WITH)
def test_whatever_is_given_with_the_others(name):
    """Nothing but an exception of the package, or a control within its limits."""
    passed = 0
    for what, value in PERHAPS.items():
        try:
            plan = se.control(
                TWO, [1.0, 0.0], [0.0, 0.0], steps=3, **within(**WITH | {name: value})
            )
        except se.exceptions.StochensError:
            continue
        passed += 1
        assert np.all(plan.u >= plan.limited.task.low), what
        assert np.all(plan.u <= plan.limited.task.high), what
        assert plan.limited.gap >= 0.0, what
        assert "inputs at a limit" in repr(plan)
        assert "inputs at a limit" in plan._repr_html_()
    assert passed
