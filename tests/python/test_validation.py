"""Bad input: the right exception, a message that names the argument, nothing changed.

Good but unusual input (strided, big-endian, single precision, ...) equals the plain array.
"""

from __future__ import annotations

import pickle
import re
from functools import partial

import numpy as np
import pytest

from stochens_rs import exceptions
from stochens_rs._base import running as memory
from stochens_rs._base import validation
from stochens_rs.exceptions import (
    InputTypeError,
    NonFiniteError,
    ResourceError,
    ShapeError,
    StochensError,
)

nan, inf = float("nan"), float("inf")


def label(value):
    """Test ids: pytest's own would print a million characters, or fail on a huge integer."""
    return value.__name__ if isinstance(value, type) else validation.show(value)[:40]


def spoiled(shape, index, value):
    array = np.ones(shape)
    array[index] = value
    return array


class Stubborn:
    def __array__(self, dtype=None, copy=None):
        raise RuntimeError("no array for you")


class Fickle:
    """An array with another shape each time it is read."""

    readings = 0

    def __array__(self, dtype=None, copy=None):
        self.readings += 1
        return np.ones((self.readings, self.readings))


vector, matrix = validation.vector, validation.matrix
vector10, cols3 = partial(validation.vector, length=10), partial(validation.matrix, cols=3)
square, batch = partial(validation.matrix, square=True), partial(validation.array, ndim=(2, 3))

# Rows: what is wrong, the check, the value given for `X`, a pattern of the message.
NOT_FINITE = [
    ("nan first", matrix, spoiled((3, 4), (0, 0), nan), r"`X\[0, 0\]` is nan: entries must be fin"),
    ("inf", matrix, spoiled((3, 4), (1, 2), inf), r"`X\[1, 2\]` is inf"),
    ("nan in vector", vector, [1.0, 2.0, 3.0, nan], r"`X\[3\]` is nan: entries must be finite"),
    ("nan in batch", batch, spoiled((1000, 2, 2), (577, 1, 0), nan), r"`X\[577, 1, 0\]`"),
]
WRONG_SHAPE = [
    ("empty 0x0", matrix, np.ones((0, 0)), r"`X` must have at least one entry, got shape \(0, 0\)"),
    ("empty list", vector, [], r"at least one entry, got shape \(0,\)"),
    ("scalar", matrix, 3.0, r"`X` must have shape \(n, m\), got float 3.0$"),
    ("scalar for a vector", vector, 10, r"`X` must have shape \(n,\), got int 10$"),
    ("1-d for 2-d", matrix, np.ones(3), r"got \(3,\); use X\.reshape\(-1, 1\)"),
    ("2-d for 1-d", vector, np.ones((3, 1)), r"shape \(n,\), got \(3, 1\); use X\.ravel\(\)"),
    ("32-d", matrix, np.ones((1,) * 32), r"got 32 dimensions"),
    ("length", vector10, np.ones(9), r"`X` must have shape \(10,\), got \(9,\)$"),
    ("cols", cols3, np.ones((2, 4)), r"`X` must have shape \(n, 3\), got \(2, 4\)$"),
    ("square", square, np.ones((2, 3)), r"`X` must have shape \(n, n\), got \(2, 3\)$"),
    ("ndim", batch, np.ones(3), r"must have 2 or 3 dimensions, got \(3,\)"),
]
WRONG_TYPE = [
    ("object", matrix, np.array([[1, None]]), r"contain integers or real floats, got dtype object"),
    ("text", vector, "12", r"got str '12'"),
    ("bool", vector, np.array([True]), r"got dtype bool; pass X\.astype\(float\)"),
    ("complex", vector, np.ones(3, complex), r"got dtype complex128; pass X\.real"),
    ("None", vector, None, r"got None"),
    ("masked", vector, np.ma.masked_array([1.0, 2.0], [True, False]), r"masked array.*X\.filled"),
    ("ragged", matrix, [[1.0], [1.0, 2.0]], r"rows of unequal length"),
    ("generator", vector, (float(i) for i in range(3)), r"an object of type generator"),
    ("raising __array__", vector, Stubborn(), r"an object of type Stubborn"),
]
BAD_ARRAYS = [
    pytest.param(check, value, error, message, id=what)
    for error, rows in (
        (NonFiniteError, NOT_FINITE),
        (ShapeError, WRONG_SHAPE),
        (InputTypeError, WRONG_TYPE),
    )
    for what, check, value, message in rows
]


@pytest.mark.parametrize(("check", "value", "error", "message"), BAD_ARRAYS)
def test_bad_array_is_refused_and_left_alone(check, value, error, message):
    before = value.copy() if isinstance(value, np.ndarray) else None
    with pytest.raises(error, match=message) as caught:
        check("X", value)
    assert_one_short_line(caught.value)
    if before is not None:
        np.testing.assert_array_equal(value, before)


def test_running_out_of_memory_is_not_called_a_wrong_type():
    class Huge:
        def __array__(self, dtype=None, copy=None):
            raise MemoryError

    with pytest.raises(MemoryError):
        validation.vector("X", Huge())


def test_input_is_read_once():
    fickle = Fickle()
    assert validation.matrix("X", fickle).shape == (1, 1)
    assert fickle.readings == 1


def misaligned(array):
    raw = np.zeros(array.nbytes + 1, dtype=np.uint8)
    view = raw[1:].view(array.dtype).reshape(array.shape)
    view[...] = array
    assert not view.flags.aligned
    return view


def read_only(array):
    array = array.copy()
    array.flags.writeable = False
    return array


PLAIN = np.arange(12.0).reshape(3, 4) - 5.0
UNUSUAL = {
    "list": PLAIN.tolist(),
    "tuple of lists": tuple(PLAIN.tolist()),
    "list of arrays": list(PLAIN),
    "int64": PLAIN.astype(np.int64),
    "int8": PLAIN.astype(np.int8),
    "float32": PLAIN.astype(np.float32),
    "float16": PLAIN.astype(np.float16),
    "longdouble": PLAIN.astype(np.longdouble),
    "big-endian": PLAIN.astype(">f8"),
    "big-endian int": PLAIN.astype(">i4"),
    "Fortran": np.asfortranarray(PLAIN),
    "reversed": PLAIN[::-1, ::-1].copy()[::-1, ::-1],
    "strided": np.repeat(np.repeat(PLAIN, 2, 0), 3, 1)[::2, ::3],
    "read-only": read_only(PLAIN),
    "misaligned": misaligned(PLAIN),
    "np.matrix": PLAIN.view(np.matrix),
    "memoryview": memoryview(PLAIN),
}


@pytest.mark.parametrize("value", UNUSUAL.values(), ids=UNUSUAL.keys())
def test_unusual_array_equals_the_plain_one(value):
    got = validation.matrix("X", value)
    np.testing.assert_array_equal(got, PLAIN)
    assert type(got) is np.ndarray
    assert got.dtype == np.float64
    assert got.dtype.isnative
    assert got.flags.c_contiguous
    assert got.flags.aligned


def test_broadcast_and_memmap(tmp_path):
    wide = np.broadcast_to(np.arange(4.0), (3, 4))
    got = validation.matrix("X", wide)
    assert got.flags.c_contiguous
    np.testing.assert_array_equal(got, wide)
    mapped = np.memmap(tmp_path / "m", dtype=float, mode="w+", shape=(3, 4))
    mapped[:] = PLAIN
    np.testing.assert_array_equal(validation.matrix("X", mapped), PLAIN)


def test_no_copy_when_none_is_needed():
    assert np.shares_memory(validation.matrix("X", PLAIN), PLAIN)


@pytest.mark.parametrize(
    "value",
    [
        np.zeros((2, 2)),
        np.full((2, 2), 1e300),
        np.full((2, 2), 5e-324),
        np.full((2, 2), -0.0),
        np.full((2, 2), 2**53 + 1, dtype=np.int64),
    ],
)
def test_extreme_but_finite_values_pass_unchanged(value):
    np.testing.assert_array_equal(validation.matrix("X", value), value.astype(float))


def test_long_double_beyond_float64_is_not_finite():
    beyond = np.array([1.0, np.finfo(np.longdouble).max])
    if beyond[1] == np.finfo(np.float64).max:
        pytest.skip("long double is float64 here")
    with pytest.raises(NonFiniteError, match=r"`X\[1\]` is inf"):
        validation.vector("X", beyond)


# -- scalars -----------------------------------------------------------------------------------

size, sizes = validation.size, partial(validation.sizes, maximum=10)
small = partial(validation.size, minimum=0, maximum=5)
choice = partial(validation.choice, allowed=("uniform", "alse", "slse"))
TAKEN = [
    *((size, value, 7) for value in (7, 7.0, np.uint8(7), np.float32(7), np.array(7))),
    *((size, 2**53, 2**53), (small, 0, 0), (choice, "alse", "alse")),
    *((validation.positive, value, float(value)) for value in (1, 5e-324, np.float32(0.5), 1e308)),
]


@pytest.mark.parametrize(("check", "value", "expected"), TAKEN, ids=label)
def test_good_scalars(check, value, expected):
    got = check("X", value)
    assert (got, type(got)) == (expected, type(expected))


@pytest.mark.parametrize("value", [[1, 2, 10], np.array([1.0, 2.0, 10.0]), range(1, 11)])
def test_sizes_accepts(value):
    got = sizes("X", value)
    assert got.dtype == np.int64
    assert got.tolist() == list(value)


# -- memory ------------------------------------------------------------------------------------


def test_memory_refuses_what_no_machine_has():
    if memory.memory_left() is None:
        pytest.skip("this system does not tell how much memory is left")
    with pytest.raises(
        ResourceError, match=r"^Ensemble\.dense\(\) needs .* GiB, but only"
    ) as caught:
        memory.need("Ensemble.dense()", 2**62)
    assert_one_short_line(caught.value)
    assert caught.value.needed_bytes == 2**62
    assert 0 <= caught.value.limit_bytes < 2**62
    assert isinstance(caught.value, MemoryError)


@pytest.mark.parametrize(("needed", "refused"), [(800 * 2**20, False), (800 * 2**20 + 1, True)])
def test_memory_leaves_a_fifth_free(monkeypatch, needed, refused):
    monkeypatch.setattr(memory, "memory_left", lambda: 1000 * 2**20)
    if refused:
        with pytest.raises(ResourceError):
            memory.need("it", needed)
    else:
        memory.need("it", needed)


def test_memory_passes_where_nothing_is_known(monkeypatch):
    monkeypatch.setattr(memory, "_text", lambda path: "")
    monkeypatch.setattr(memory, "_address_space_left", list)
    assert memory.memory_left() is None
    memory.need("it", 2**62)


GIB = 2**30
MEMINFO = f"MemTotal: {16 * 2**20} kB\nMemAvailable: {8 * 2**20} kB\n"
V2 = {
    "/proc/self/cgroup": "0::/user/job\n",
    "/sys/fs/cgroup/user/job/memory.max": "max\n",
    "/sys/fs/cgroup/user/job/memory.current": f"{GIB}\n",
    "/sys/fs/cgroup/user/memory.max": f"{4 * GIB}\n",
    "/sys/fs/cgroup/user/memory.current": f"{3 * GIB}\n",
    "/sys/fs/cgroup/user/memory.stat": f"anon {GIB}\ninactive_file {GIB}\n",
    "/proc/meminfo": MEMINFO,
}
V1 = {
    "/proc/self/cgroup": "5:cpu,cpuacct:/a\n4:memory:/not/visible\n",
    "/sys/fs/cgroup/memory/memory.limit_in_bytes": f"{3 * GIB}\n",
    "/sys/fs/cgroup/memory/memory.usage_in_bytes": f"{2 * GIB}\n",
    "/sys/fs/cgroup/memory/memory.stat": "total_inactive_file 0\n",
    "/proc/meminfo": MEMINFO,
}


@pytest.mark.parametrize(
    ("files", "left"),
    [
        (V2, 2 * GIB),  # the parent group: 4 - 3 used, of which 1 is cache
        (V1, GIB),  # a container: only the root group is there
        ({"/proc/meminfo": MEMINFO}, 8 * GIB),
        ({"/proc/meminfo": MEMINFO, "/proc/self/cgroup": "words of another kernel"}, 8 * GIB),
    ],
    ids=["cgroup v2", "cgroup v1", "no cgroup", "unreadable"],
)
def test_memory_left_reads_the_least_limit(monkeypatch, files, left):
    monkeypatch.setattr(memory, "_text", lambda path: files.get(path, ""))
    monkeypatch.setattr(memory, "_address_space_left", list)
    assert memory.memory_left() == left


def test_address_space_limit_counts(monkeypatch):
    resource = pytest.importorskip("resource")
    monkeypatch.setattr(resource, "getrlimit", lambda which: (5 * GIB, 6 * GIB))
    monkeypatch.setattr(
        memory, "_text", lambda path: f"{GIB // resource.getpagesize()} 1 1" * ("statm" in path)
    )
    assert memory.memory_left() == 4 * GIB


# -- the family of exceptions ------------------------------------------------------------------


EXCEPTIONS = [getattr(exceptions, name) for name in exceptions.__all__]


@pytest.mark.parametrize("error", EXCEPTIONS, ids=lambda error: error.__name__)
def test_exceptions_are_one_documented_picklable_family(error):
    assert issubclass(error, StochensError)
    assert error.__doc__
    back = pickle.loads(pickle.dumps(error("what happened")))
    assert type(back) is error
    assert str(back) == "what happened"


@pytest.mark.parametrize(
    ("name", "builtin"),
    [("InputError", ValueError), ("ShapeError", ValueError), ("NonFiniteError", ValueError),
     ("SeedError", ValueError), ("SizeError", ValueError),
     ("SizeError", OverflowError), ("InputTypeError", TypeError), ("ResourceError", MemoryError),
     ("SolverError", RuntimeError), ("InternalError", RuntimeError)],
)  # fmt: skip
def test_old_except_clauses_still_work(name, builtin):
    assert issubclass(getattr(exceptions, name), builtin)


def assert_one_short_line(error):
    assert len(str(error)) <= 300
    assert re.search(r"[\r\n]", str(error)) is None


def test_exceptions_come_back_from_a_cluster():
    """Dask pickles exceptions by tblib, which makes them by `__new__` alone."""
    tblib = pytest.importorskip("tblib.pickling_support")
    error = ResourceError("m", 7, 5)
    make, given = tblib.pickle_exception(error)[:2]
    back = make(*given)
    assert (type(back), back.needed_bytes, back.limit_bytes) == (ResourceError, 7, 5)
