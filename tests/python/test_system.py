"""The system: checked once; comparable, hashable, picklable, immutable."""

from __future__ import annotations

import copy
import pickle
from types import SimpleNamespace

import numpy as np
import pytest

from stochens_rs.system.system import System

A = np.array([[1.0, 0.1], [0.0, 1.0]])
B = np.array([[0.0], [0.1]])


@pytest.fixture
def system():
    return System(A, B, dt=0.1, name="cart")


def test_attributes(system):
    np.testing.assert_array_equal(system.A, A)
    np.testing.assert_array_equal(system.B, B)
    assert (system.n, system.m, system.dt, system.name) == (2, 1, 0.1, "cart")
    assert System(A, B).dt is None
    assert System(A, B).name is None


@pytest.mark.parametrize(
    ("given", "kept"),
    [(None, None), (True, True), (np.True_, True), (1, 1.0), (np.float32(0.5), 0.5)],
)
def test_dt(given, kept):
    dt = System(A, B, dt=given).dt
    assert dt == kept
    assert type(dt) is type(kept)


# -- immutability ------------------------------------------------------------------------------


def test_later_changes_of_the_input_do_not_reach_the_system():
    mine = A.copy()
    system = System(mine, B)
    mine[0, 0] = 99.0
    assert system.A[0, 0] == 1.0


def test_attributes_cannot_be_set_or_deleted(system):
    for attribute in ("A", "B", "n", "dt", "name", "_A", "anything"):
        with pytest.raises(AttributeError, match=f"immutable: `{attribute}` cannot be set"):
            setattr(system, attribute, 1)
    with pytest.raises(AttributeError, match="cannot be deleted"):
        del system.A


def test_arrays_cannot_be_made_writeable(system):
    for array in (system.A, system.B, pickle.loads(pickle.dumps(system)).A):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 1.0
        with pytest.raises(ValueError, match="WRITEABLE"):
            array.flags.writeable = True


# -- a value -----------------------------------------------------------------------------------


def test_equality_and_hash(system):
    same = System(A.tolist(), np.asfortranarray(B), dt=0.1)  # the name is a label only
    assert system == same
    assert hash(system) == hash(same)
    others = [
        System(A, B),
        System(A, B, dt=0.2),
        System(A + 1e-16 * np.eye(2)[::-1], B, dt=0.1),
        System(A, 2 * B, dt=0.1),
        System([[1.0]], [[1.0]], dt=0.1),
        (A, B, 0.1),
    ]
    assert all(system != other for other in others)
    assert len({system, same, *others[:-1]}) == len(others)

    assert System(A, B, dt=True) != System(A, B, dt=1.0)
    plus, minus = System([[0.0]], [[1.0]]), System([[-0.0]], [[1.0]])
    assert plus == minus
    assert hash(plus) == hash(minus)


def test_pickle_and_copy(system):
    for protocol in range(2, pickle.HIGHEST_PROTOCOL + 1):
        back = pickle.loads(pickle.dumps(system, protocol))
        assert back == system
        assert back.name == "cart"
    assert copy.copy(system) is system
    assert copy.deepcopy([system])[0] is system


# -- from_any ----------------------------------------------------------------------------------


def test_from_any_takes_tuples_and_anything_with_A_and_B(system):
    assert System.from_any(system) is system
    assert System.from_any((A, B)) == System(A, B)
    assert System.from_any((A, B, 0.1)) == System(A, B, dt=0.1)
    assert System.from_any(SimpleNamespace(A=A, B=B)) == System(A, B)
    named = System.from_any(SimpleNamespace(A=A, B=B, dt=0.1, name="drone"))
    assert (named.dt, named.name) == (0.1, "drone")
    assert System.from_any(SimpleNamespace(A=A, B=B, name="sys[12]")).name is None
