"""`realization_controls(..., out=)`: the same numbers in the caller's array."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs import reference as twin
from stochens_rs.exceptions import InputError, StochensError

N = 700  # more than two blocks, and not a whole number of them


def problem(n: int, m: int, kind: str) -> tuple[Any, ...]:
    gen = np.random.default_rng(n + 100 * m)
    A, B = gen.standard_normal((n, n)), gen.standard_normal((n, m))
    x0, xf = gen.standard_normal(n), gen.standard_normal(n)
    if kind == "singletons":
        return (se.sample(A, N, rng=3), B), se.sample(x0, N, rng=1), se.sample(xf, N, rng=2)
    if kind == "exact xf":
        return (se.sample(A, N, rng=3), B), se.sample(x0, N, rng=1), xf
    if kind == "rows":
        ensembles = (se.sample(x0, N, rng=1), se.sample(xf, N, rng=2))
        return (se.sample(A, N, rng=3, axis="rows"), B), *ensembles
    samples = [gen.standard_normal((N, *v.shape)) for v in (x0, xf, A)]
    dense = [se.Ensemble.from_samples(v) for v in samples]
    if kind == "exact A":
        return (A, B), dense[0], dense[1]
    if kind == "exact x0":
        return (dense[2], B), x0, dense[1]
    return (dense[2], B), *dense[:2]


def written_out(entity: Any) -> Any:
    if isinstance(entity, se.Ensemble):
        return entity.dense()
    return np.broadcast_to(entity, (N, *entity.shape))


KINDS = ["singletons", "exact xf", "rows", "dense", "exact A", "exact x0"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("n", "m"), [(1, 1), (5, 2), (9, 4), (19, 10), (20, 13), (21, 16), (18, 20)]
)
def test_controls_equal_the_reference(n: int, m: int, kind: str) -> None:
    (A, B), x0, xf = problem(n, m, kind)
    out = np.full((N, m), np.nan)
    assert se.realization_controls((A, B), x0, xf, out=out) is out
    expected = twin.controls.realization_controls(
        written_out(A), B, written_out(x0), written_out(xf)
    )
    assert np.abs(out - expected).max() <= 1e-12 * np.abs(expected).max()
    assert np.array_equal(out, se.realization_controls((A, B), x0, xf))


def test_bad_output_is_refused() -> None:
    unaligned = np.frombuffer(bytearray(16 * N + 1), np.float64, 2 * N, offset=1).reshape(N, 2)
    read_only = np.zeros((N, 2))
    read_only.setflags(write=False)
    for out, message in (
        ([[0.0, 0.0]] * N, "an ndarray of float64, got an obj"),
        (np.ma.zeros((N, 2)), "an ndarray of float64"),
        (np.zeros((N, 2), np.float32), "an .* of float64, got ndarray .* of float32"),
        (np.zeros((N, 2), ">f8"), "an .* of float64, got ndarray .* of >f8"),
        (np.zeros((2, N)), r"shape \(700, 2\), got \(2, 700\)"),
        (np.zeros((2, N)).T, "C-contiguous"),
        (np.zeros((N, 4))[:, ::2], "C-contiguous"),
        (unaligned, ".*aligned"),
        (read_only, ".*writeable"),
    ):
        with pytest.raises(StochensError, match=f"`out` must (be|have) {message}"):
            se.realization_controls(*problem(5, 2, "singletons"), out=out)


def test_output_must_not_be_an_input() -> None:
    (A, B), x0, xf = problem(5, 2, "singletons")
    memory = np.arange(1.0, 2 * N + 1)
    out = memory.reshape(N, 2)
    for name, inputs in {
        "B": ((A, memory[:10].reshape(5, 2)), x0, xf),
        "x0": ((A, B), memory[:5], xf),
        "xf": ((A, B), x0, memory[10:20:2]),
        "A": ((memory[3:28].reshape(5, 5), B), x0, xf),
    }.items():
        with pytest.raises(InputError, match=f"`out` must not share memory with `{name}`"):
            se.realization_controls(*inputs, out=out)
    assert np.array_equal(memory, np.arange(1.0, 2 * N + 1))


LARGE = 32 << 20  # bytes: from here on, memory that was used before is written past the caches


@pytest.mark.parametrize("shift", [0, 1], ids=["aligned", "odd multiple of 8 bytes"])
@pytest.mark.parametrize(("n", "m"), [(3, 1), (4, 2), (5, 3), (300, 27)])
def test_large_outputs_hold_the_same_bits(n: int, m: int, shift: int) -> None:
    gen = np.random.default_rng(n)
    size = LARGE // (8 * m) + 3
    B, x0, xf = gen.standard_normal((n, m)), gen.standard_normal(n), gen.standard_normal(n)
    A = se.sample(gen.standard_normal((n, n)), size, rng=3)
    given = ((A, B), se.sample(x0, size, rng=1), se.sample(xf, size, rng=2))
    memory = np.full(size * m + 8, np.nan)
    start = (-memory.ctypes.data // 8) % 2 + shift  # 16-byte boundary, or 8 bytes beyond
    out = memory[start : start + size * m].reshape(size, m)
    se.realization_controls(*given, out=out)
    assert np.array_equal(out, se.realization_controls(*given))
    assert np.isnan(memory[:start]).all()
    assert np.isnan(memory[start + size * m :]).all()
