"""The system: checked once; comparable, hashable, picklable, immutable."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from stochens_rs.exceptions import InputError
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


def test_dt_true_is_not_dt_one():
    assert System(A, B, dt=True) != System(A, B, dt=1.0)


def test_equal_zeros_have_equal_hashes():
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


def test_repr():
    assert repr(System(A, B, dt=0.01, name="IEEE 14")) == "<System IEEE 14: n=2 m=1 dt=0.01>"
    assert repr(System(A, B)) == "<System: n=2 m=1 dt=None>"
    assert repr(System(A, B, dt=True, name="two\nlines")) == "<System two lines: n=2 m=1 dt=True>"


def test_repr_html_escapes_the_name():
    text = System(A, B, dt=0.1, name="<script>")._repr_html_()
    assert "<script>" not in text
    assert "&lt;script&gt;" in text
    assert ">0.1 s</td>" in text


# -- from_any ----------------------------------------------------------------------------------


def test_from_any_returns_a_system_as_it_is(system):
    assert System.from_any(system) is system


def test_from_any_takes_tuples():
    assert System.from_any((A, B)) == System(A, B)
    assert System.from_any((A, B, 0.1)) == System(A, B, dt=0.1)


def test_from_any_takes_anything_with_A_and_B():
    assert System.from_any(SimpleNamespace(A=A, B=B)) == System(A, B)
    named = System.from_any(SimpleNamespace(A=A, B=B, dt=0.1, name="drone"))
    assert (named.dt, named.name) == (0.1, "drone")
    assert System.from_any(SimpleNamespace(A=A, B=B, name="sys[12]")).name is None


def test_from_any_takes_discrete_scipy_systems():
    signal = pytest.importorskip("scipy.signal")
    C, D = np.eye(2), np.zeros((2, 1))
    assert System.from_any(signal.dlti(A, B, C, D, dt=0.1)) == System(A, B, dt=0.1)
    assert System.from_any(signal.StateSpace(A, B, C, D, dt=0.1)) == System(A, B, dt=0.1)
    assert System.from_any(signal.StateSpace(A, B, C, D, dt=True)) == System(A, B, dt=True)


def test_from_any_refuses_continuous_scipy_systems():
    signal = pytest.importorskip("scipy.signal")
    C, D = np.eye(2), np.zeros((2, 1))
    with pytest.raises(InputError, match=r"scipy\.signal\.lti.*discretize"):
        System.from_any(signal.lti(A, B, C, D))


def test_from_any_takes_python_control_systems():
    control = pytest.importorskip("control")
    C, D = np.eye(2), np.zeros((2, 1))
    assert System.from_any(control.ss(A, B, C, D, 0.1)) == System(A, B, dt=0.1)
    with pytest.raises(InputError, match="discretize"):
        System.from_any(control.ss(A, B, C, D, 0))


def test_no_optional_package_is_imported():
    code = (
        "import sys, stochens_rs.system.system; "
        "print({'scipy', 'control', 'matplotlib', 'pandas'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
