"""Objects made by hand, unpickled, or shared with the caller are checked as well."""

from __future__ import annotations

import contextlib
import copy
import pickle

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.exceptions import InputError, NonFiniteError
from stochens_rs.fusion import Alse

A, X0 = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([1.0, 2.0])


def honest_fits():
    gen = np.random.default_rng(5)
    for shape in ((5,), (4, 3)):
        target = gen.standard_normal(shape) * 10.0 ** gen.integers(-8, 9, shape)
        for axis in ("columns", "rows"):
            for N in (1, 2, 300, 20_000):
                yield se.sample(target, N, rng=N, axis=axis), target
        for N in (1, 40):
            samples = target + gen.standard_normal((N, *shape)) * np.abs(target)
            yield se.Ensemble.from_samples(samples), target


def test_honest_fits_come_back_and_others_do_not():
    count = 0
    for ensemble, target in honest_fits():
        made = [se.fuse(ensemble), se.fuse(ensemble, "slse", target=target)]
        made += [se.fuse(ensemble, "slse-safeguarded", target=target)]
        if ensemble.size <= 300:
            kinds = ["simplex", "subsimplex"]
            if target.ndim == 2:
                kinds.append("per-row" if ensemble.axis == "rows" else "per-column")
            if target.ndim == 2 and not ensemble.is_singleton:
                kinds.append("per-row")
            made += [se.fuse(ensemble, Alse(one), target=target) for one in kinds]
            made.append(se.fuse(ensemble, weights=np.arange(1.0, ensemble.size + 1.0)))
        for one in made:
            again = pickle.loads(pickle.dumps(one))
            np.testing.assert_array_equal(again.estimate, one.estimate)
            wrong = one.estimate.copy()
            largest = np.unravel_index(np.abs(wrong).argmax(), wrong.shape)
            wrong[largest] *= 1.03
            if wrong[largest] != one.estimate[largest]:
                with pytest.raises(InputError, match="differs from it by"):
                    pickle.loads(pickle.dumps(forged(one, estimate=wrong)))
                count += 1
    assert count > 80


# -- pickles -----------------------------------------------------------------------------------


def dense():
    return se.Ensemble.from_samples(np.arange(8.0).reshape(2, 2, 2))


def forged(record, **changed):
    """The same record with other fields, past the checks of its constructor."""
    made = copy.copy(record)
    for name, value in changed.items():
        object.__setattr__(made, name, value)
    return made


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
