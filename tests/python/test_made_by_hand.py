"""Objects made by hand, unpickled, or shared with the caller are checked as well."""

from __future__ import annotations

import contextlib
import copy
import pickle

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.exceptions import InputError, InputTypeError, NonFiniteError
from stochens_rs.fusion import Alse

nan, inf = float("nan"), float("inf")
A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[1.0, 0.0], [0.5, 1.0]])
X0, XF = np.array([1.0, 2.0]), np.array([0.5, 0.0])
BAD = np.array([[nan, 0.0], [0.0, 1.0]])


def fit(**changed):
    made = {"estimate": A, "weights": np.ones(1), "error": None, "gap": None}
    return se.Fit(**made | {"status": "completed", "method": "uniform"} | changed)


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


def drawn():
    return se.sample(A, 4, rng=1, axis="rows")


def dense():
    return se.Ensemble.from_samples(np.arange(8.0).reshape(2, 2, 2))


def counts():
    return se.sample_counts(A, 5, rng=1)


def plan():
    return se.control((se.sample(A, 5, rng=1), B), se.sample(X0, 5, rng=2), XF)


def steps():
    return se.control((se.sample(A, 5, rng=1), B), X0, XF, steps=3)


def forged(record, **changed):
    """The same record with other fields, past the checks of its constructor."""
    made = copy.copy(record)
    for name, value in changed.items():
        object.__setattr__(made, name, value)
    return made


def forged_law(**changed):
    return forged(counts().law, **changed)


MAKERS = (
    drawn,
    dense,
    counts,
    fit,
    plan,
    steps,
    lambda: se.System(A, B),
    lambda: se.Key(bytes(32)),
)
# What is in the pickle in place of one attribute.
FORGED = [
    (drawn, "axis", "diagonal"),
    (drawn, "axis", None),
    (drawn, "scheme", "systematically"),
    (drawn, "key", "key"),
    (dense, "samples", np.full((2, 2, 2), nan)),
    (dense, "samples", np.ones(2)),
    (dense, "samples", np.array([["a"]])),
    (dense, "samples", np.ones((2, 2, 2), complex)),
    (counts, "counts", np.array([[-1, 1], [1, 1]])),
    (counts, "counts", np.array([[50, 1], [1, 1]])),
    (counts, "estimate", BAD),
    (counts, "estimate", X0),
    (counts, "size", -5),
    (counts, "key", None),
    (counts, "law", forged_law(values=BAD)),
    (counts, "law", forged_law(values=X0)),
    (counts, "law", forged_law(values=np.eye(2)[::-1])),
    (counts, "law", forged_law(axis="diagonal")),
    (counts, "law", forged_law(scheme="other")),
    (counts, "law", "law"),
    (MAKERS[-2], "_A", BAD),
    (MAKERS[-2], "_B", np.ones((3, 1))),
    (MAKERS[-2], "_dt", "now"),
    (MAKERS[-1], "bytes32", b"short"),
    (MAKERS[-1], "bytes32", "0" * 32),
]


@pytest.mark.parametrize(("make", "attribute", "value"), FORGED)
def test_unpickling_checks_what_it_finds(make, attribute, value):
    with pytest.raises((InputError, InputTypeError)):
        pickle.loads(pickle.dumps(forged(make(), **{attribute: value})))


@pytest.mark.parametrize(
    "changed",
    [
        {0: np.array([[0, 2], [1, 0]])},
        {0: np.array([[0, -1], [1, 0]])},
        {0: np.array([[0.5, 0.5]])},
        {0: np.array([[True, False]])},
        {0: np.zeros((0, 2), int)},
        {0: np.zeros((4, 3), int)},
        {0: "indices"},
        {1: BAD},
        {1: X0},
        {1: np.ones((2, 2, 2))},
    ],
)
def test_unpickling_checks_the_realizations(changed):
    """The values of the pickle of drawn realizations, one of them replaced."""
    remake, values = drawn().__reduce__()
    assert remake(*values) == drawn()
    with pytest.raises((InputError, InputTypeError)):
        remake(*(changed.get(k, value) for k, value in enumerate(values)))


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize(
    "way", [lambda it: pickle.loads(pickle.dumps(it)), copy.copy, copy.deepcopy]
)
def test_honest_pickles_and_copies_come_back(make, way):
    again, made = way(make()), make()
    assert type(again) is type(made)
    assert repr(again) == repr(made)
    if make in (drawn, dense):
        assert again == made
        assert (again.key, again.scheme, again.axis) == (made.key, made.scheme, made.axis)
    if make is counts:
        np.testing.assert_array_equal(again.counts, made.counts)
        assert (again.law.axis, again.law.scheme) == (made.law.axis, made.law.scheme)
        np.testing.assert_array_equal(again.law.values, made.law.values)
    if make is plan:
        assert again.bound() == made.bound()
    if make is steps:
        np.testing.assert_array_equal(again.covariance(), made.covariance())


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


@pytest.mark.parametrize(
    "made",
    [se.Ensemble.from_samples([[1e300], [1e300]]), se.sample([1e300], 2, rng=1)],
    ids=["dense", "drawn"],
)
@pytest.mark.parametrize("weights", [[1e10, 1.0], [1e308, 1e308]])
def test_a_combination_that_overflows_is_refused(made, weights):
    with pytest.raises(NonFiniteError, match="overflows: scale"):
        made.combine(weights)


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


def test_what_overflows_in_fuse_is_named():
    """The squares overflow, the errors do not; so "uniform" and "slse" have results."""
    target = 1e200 * A
    made = se.sample(target, 5, rng=3)
    for method in ("uniform", "slse"):
        assert np.isfinite(se.fuse(made, method, target=target).error)
    with pytest.raises(NonFiniteError, match=r"the gap of the fit overflows \(inf\): scale"):
        se.fuse(made, "alse", target=target)
    with pytest.raises(NonFiniteError, match=r"gap of the fit overflows"):
        se.fuse_path(made, [2, 5], "alse", target=target)
