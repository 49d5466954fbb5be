"""Messages of a few bits: packed and read by the core, against a NumPy twin; several senders."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.exceptions import InputError, InputTypeError, ShapeError


def packed(indices, negative, n):
    """The codes 2 i + s, the lowest bit first."""
    bits = max(1, int(2 * n - 1).bit_length())
    codes = (2 * indices.astype(np.int64) + negative).ravel()
    return np.packbits((codes[:, None] >> np.arange(bits)) & 1, bitorder="little").tobytes()


@pytest.mark.parametrize("n", [1, 3, 5, 100, 129, 70_000])
def test_bytes_are_those_of_the_twin_and_are_read_again(n):
    x = np.random.default_rng(n).standard_normal(n)
    sent = se.sample(x, 777, rng=2)
    data = sent.to_bytes()
    assert data == packed(sent.indices, x[sent.indices] < 0, n)
    read = se.Ensemble.from_bytes(data, n, np.abs(x).sum(), size=777)
    assert np.array_equal(read.indices, sent.indices)
    assert read.mean() == pytest.approx(sent.mean(), rel=1e-12)
    assert (read.law, read.centre) == (None, None)
    if n >= 100:  # a message of 8 bits or more tells the number
        assert se.Ensemble.from_bytes(data, n, 1.0).size == 777


@pytest.mark.parametrize("axis", ["columns", "rows"])
def test_matrices_have_a_message_for_each_line(axis):
    A = np.random.default_rng(1).standard_normal((3, 7))
    A[:, 2] = A[1] = 0.0
    sent = se.sample(A, 300, axis=axis, rng=3)
    norms = np.abs(A).sum(axis=0 if axis == "columns" else 1)
    read = se.Ensemble.from_bytes(sent.to_bytes(), (3, 7), norms, size=300, axis=axis)
    assert read.mean() == pytest.approx(sent.mean(), rel=1e-12)
    assert np.array_equal(read.indices, sent.indices)


def test_what_nobody_has_sent_is_refused():
    data = se.sample([3.0, -1.0, 0.0], 16, rng=1).to_bytes()
    read = se.Ensemble.from_bytes
    with pytest.raises(InputError, match=r"`size` must be given where a realization has 3 bits"):
        read(data, 3, 4.0)
    with pytest.raises(ShapeError, match=r"`data` must have 6 bytes for 15 realizations"):
        read(data + b"\0", 3, 4.0, size=15)
    with pytest.raises(InputError, match="both signs"):
        read(b"\x04", 2, 1.0, size=2)
    with pytest.raises(InputError, match=r"`data` must be indices of entries, got 3 for 3"):
        read(b"\x06", 3, 1.0, size=1)
    with pytest.raises(InputError, match="filled up with zeros"):
        read(b"\x08", 3, 1.0, size=1)
    for norm in (np.nan, np.inf, -1.0):
        with pytest.raises(InputError):
            read(data, 3, norm, size=16)
    with pytest.raises(ShapeError):
        read(data, 3, [1.0, 2.0], size=16)
    with pytest.raises(InputTypeError, match="`data`"):
        read("text", 3, 1.0)
    with pytest.raises(InputError, match="`shape`"):
        read(data, 0, 1.0, size=16)
    with pytest.raises(InputError, match="dense"):
        se.Ensemble.from_samples([[1.0]]).to_bytes()
    for norm in (0.0, 1e300, 1e-300):
        assert np.isfinite(read(data, 3, norm, size=16).mean()).all()


def test_senders_with_vectors_of_their_own_are_averaged():
    """Each of 3000 nodes has its own sparse histogram; 9 bits from each."""
    rng, n = np.random.default_rng(5), 200
    own = rng.dirichlet(np.full(n, 0.02), 3000)
    nodes = [se.sample(p, 1, rng=rng) for p in own]
    messages = [node.to_bytes() for node in nodes]
    assert {len(message) for message in messages} == {2}
    read = [se.Ensemble.from_bytes(message, n, 1.0, size=1) for message in messages]
    fused = se.fuse(read)
    assert fused.estimate == pytest.approx(np.mean([one.mean() for one in nodes], axis=0))
    mean = own.mean(axis=0)
    error = np.sum((fused.estimate - mean) ** 2)
    # sum_k (||p_k||_1^2 - ||p_k||^2) / N^2, four deviations above
    expected = np.sum(1.0 - np.sum(own**2, axis=1)) / 3000**2
    assert error < 2.0 * expected
    assert se.fuse([nodes[0], se.sample(own[1], 3, rng=1)]).weights.shape == (4,)
    with pytest.raises(ShapeError, match=r"`ensemble\[1\]` must have shape \(200,\)"):
        se.fuse([nodes[0], se.sample([1.0], 1, rng=1)])
    with pytest.raises(InputError, match="at least one Ensemble"):
        se.fuse([])
