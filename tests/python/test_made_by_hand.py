"""Objects made by hand, unpickled, or shared with the caller are checked as well."""

from __future__ import annotations

import contextlib
import copy
import pickle

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.exceptions import NonFiniteError
from stochens_rs.fusion import Alse

A, X0 = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([1.0, 2.0])


# -- pickles -----------------------------------------------------------------------------------


def dense():
    return se.Ensemble.from_samples(np.arange(8.0).reshape(2, 2, 2))


# -- shared memory -----------------------------------------------------------------------------


def bases(array):
    while isinstance(array, np.ndarray):
        yield array
        array = array.base


@pytest.mark.parametrize("how", ["own", "prefix", "unpickled", "copied"])
def test_dense_realizations_cannot_be_changed_from_outside(how):
    given = np.arange(12.0).reshape(3, 2, 2)
    made = se.Ensemble.from_samples(given)
    made = {
        "own": made,
        "prefix": made.prefix(2),
        "unpickled": pickle.loads(pickle.dumps(made)),
        "copied": copy.deepcopy(made),
    }[how]
    before = made.dense()
    given[:] = -1.0
    made.dense()[:] = -1.0
    made.mean()[:] = -1.0
    for array in bases(made.samples):
        with pytest.raises(ValueError, match=r"WRITEABLE|read-only"):
            array.flags.writeable = True
        with pytest.raises(ValueError, match="read-only"):
            array[...] = -1.0
        assert memoryview(array).readonly
    np.testing.assert_array_equal(made.dense(), before)


# -- what is not finite ------------------------------------------------------------------------


def every_way(made, target):
    for method in ("uniform", "slse", "slse-safeguarded", "alse"):
        yield lambda method=method: se.fuse(made, method, target=target)
        yield lambda method=method: se.fuse_path(made, [1, made.size], method, target=target)
    if made.shape == (2, 2):
        yield lambda: se.fuse(made, Alse("per-column"), target=target)
    yield lambda: se.fuse(made, Alse("subsimplex"), target=target)


@pytest.mark.parametrize("scale", [1e150, 1e154, 1e160, 1e200, 1e300, 8e307])
@pytest.mark.parametrize("kind", ["drawn vector", "drawn matrix", "dense vector", "dense matrix"])
def test_no_result_of_fuse_is_silently_not_finite(kind, scale):
    """All results are finite, or the call raises an error."""
    target = scale * (X0 if "vector" in kind else A) / 4.0
    made = se.sample(target, 5, rng=3)
    if "dense" in kind:
        made = se.Ensemble.from_samples(made.dense())
    returned = []
    for call in every_way(made, target / 3.0):
        returned.append(False)
        with contextlib.suppress(NonFiniteError):
            found = call()
            returned[-1] = True
        if not returned[-1]:
            continue
        values = [v for v in vars(found).values() if isinstance(v, (float, np.ndarray))]
        assert len(values) >= 2
        assert all(np.isfinite(value).all() for value in values), f"{found}: {vars(found)}"
    # without squares in the result, and with squares that do not overflow
    assert all(returned[:6])
    assert all(returned) or scale > 1e160
