"""The random streams: known answers for the NumPy twin, then the core, bit for bit.

The order is: published vectors of ChaCha and xoshiro256++; exact facts about the table, the
shuffle and systematic counts; a chi-square test with a negative control; golden digests; and the
same draws from the compiled core for all shapes, schemes, axes and chunk boundaries.
"""

from __future__ import annotations

import hashlib
import itertools
import os
import subprocess
import sys
import textwrap
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import stochens_rs as se
from stochens_rs import reference as twin

CHUNK = 16384
SIZES = [1, 7, CHUNK - 1, CHUNK, CHUNK + 1, 2 * CHUNK + 3]


def root_key(seed: int) -> bytes:
    """The key of an integer seed, from its definition."""
    return hashlib.sha256(b"stochens key v1\0int\0" + str(seed).encode()).digest()


def vector(n: int) -> NDArray[np.float64]:
    """Signed weights of very different sizes, every fifth one 0; no generator may change them."""
    i = np.arange(n)
    w: NDArray[np.float64] = (37 * i % 101 - 50.3) * 4.0 ** (i % 7 - 3)
    w[4::5] = 0.0
    return w


def matrix() -> NDArray[np.float64]:
    """3 x 4 with a column of zeros and a zero elsewhere."""
    return np.array([[1.5, 0.0, -2.0, 4.0], [-0.25, 0.0, 7.0, 0.0], [3.0, 0.0, 1.0, -0.125]])


TARGETS: dict[str, tuple[NDArray[np.float64], str]] = {
    **{f"vector{n}": (vector(n), "columns") for n in (1, 3, 10, 257, 300)},
    "matrix-columns": (matrix(), "columns"),
    "matrix-rows": (matrix(), "rows"),
    "matrix-zero-row": (matrix().T.copy(), "rows"),
    "zero-vector": (np.zeros(3), "columns"),
}


def digest(indices: NDArray[Any]) -> str:
    return hashlib.sha256(np.ascontiguousarray(indices, dtype="<u4").tobytes()).hexdigest()


# --- known answers --------------------------------------------------------------------------------


def test_chacha8_known_answers() -> None:
    # TC1 and TC2 of draft-strombergson-chacha-test-vectors-01: 256-bit key, 8 rounds, IV 0.
    expected = {
        0: "3e00ef2f895f40d67f5bb8e81f09a5a12c840ec3ce9a7f3b181be188ef711a1e"
        "984ce172b9216f419f445367456d5619314a42a3da86b001387bfdb80e0cfe42",
        1: "cf5ee9a0494aa9613e05d5ed725b804b12f4a465ee635acc3a311de8740489ea"
        "289d04f43c7518db56eb4433e498a1238cd8464d3763ddbb9222ee3bd8fae3c8",
    }
    for first_byte, stream in expected.items():
        words = twin.streams.chacha_blocks(bytes([first_byte]) + bytes(31), 0, 0, 1)
        assert words.astype("<u4").tobytes().hex() == stream


def test_chacha20_known_answers() -> None:
    # RFC 8439, appendix A.1: vector 1 (block 0), vector 2 (block 1) and vector 5, whose 96-bit
    # nonce ends in 2: as a 64-bit stream id that is 2 << 56.
    block0 = twin.streams.chacha_blocks(bytes(32), 0, 0, 2, rounds=20)
    assert block0[0, :4].tolist() == [0xADE0B876, 0x903DF1A0, 0xE56A5D40, 0x28BD8653]
    assert block0[0, 12:].tolist() == [0xF4B8436A, 0x1CA11815, 0x69B687C3, 0x8665EEB2]
    assert block0[1, :4].tolist() == [0xBEE7079F, 0x7A385155, 0x7C97BA98, 0x0D082D73]
    nonce2 = twin.streams.chacha_blocks(bytes(32), 2 << 56, 0, 1, rounds=20)
    assert nonce2[0, :4].tolist() == [0x374DC6C2, 0x3736D58C, 0xB904E24A, 0xCD3F93EF]


def test_chacha8_words_start_anywhere() -> None:
    key = bytes(range(32))
    words = twin.streams.chacha8_words(key, 2, 5, 0, 64)
    block = twin.streams.chacha_blocks(key, 2 << 56 | 5, 0, 1)[0]
    assert int(words[0]) == int(block[0]) | int(block[1]) << 32
    for first, count in itertools.product((0, 1, 7, 8, 9, 31), (0, 1, 8, 33)):
        part = twin.streams.chacha8_words(key, 2, 5, first, count)
        assert part.tolist() == words[first : first + count].tolist()
    assert twin.streams.chacha8_words(key, 1, 5, 0, 1)[0] != words[0]
    assert twin.streams.chacha8_words(key, 2, 6, 0, 1)[0] != words[0]


def test_xoshiro256pp_known_answers() -> None:
    # The reference implementation (prng.di.unimi.it), state {1, 2, 3, 4}.
    expected = [
        41943041,
        58720359,
        3588806011781223,
        3591011842654386,
        9228616714210784205,
        9973669472204895162,
        14011001112246962877,
        12406186145184390807,
        15849039046786891736,
        10450023813501588000,
    ]
    state = np.array([[1, 9], [2, 9], [3, 9], [4, 9]], dtype=np.uint64)
    assert twin.streams.xoshiro256pp(state, 10)[:, 0].tolist() == expected


def xoshiro_scalar(state: list[int], count: int) -> list[int]:
    """xoshiro256++ in Python integers."""
    mask = 2**64 - 1

    def rotl(x: int, k: int) -> int:
        return ((x << k) | (x >> (64 - k))) & mask

    s, out = list(state), []
    for _ in range(count):
        out.append((rotl((s[0] + s[3]) & mask, 23) + s[0]) & mask)
        t = (s[1] << 17) & mask
        s[2] ^= s[0]
        s[3] ^= s[1]
        s[1] ^= s[2]
        s[0] ^= s[3]
        s[2] ^= t
        s[3] = rotl(s[3], 45)
    return out


def test_iid_words_are_where_the_definition_puts_them() -> None:
    key, line, count = root_key(11), 3, 2 * CHUNK + 20
    words = twin.streams.iid_words(key, line, count)
    assert words.shape == (count,)
    for chunk, lane in [(0, 0), (0, 7), (1, 3), (2, 1)]:
        seed = twin.streams.chacha8_words(key, 0, line, (chunk * 256 + lane * 32) // 8, 4).tolist()
        drawn = words[chunk * CHUNK : (chunk + 1) * CHUNK][lane::8].tolist()
        assert drawn == xoshiro_scalar(seed, len(drawn))
    for shorter in (1, 8, 9, CHUNK, CHUNK + 1):
        assert np.array_equal(twin.streams.iid_words(key, line, shorter), words[:shorter])


# --- the table, the shuffle, systematic counts ----------------------------------------------------

TABLE_WEIGHTS = {
    "one": [2.5],
    "two": [1.0, 3.0],
    "halves": [1.0, 1.0, 1.0, 1.0],
    "zeros": [0.0, 3.0, 0.0, -1.0, 0.5, 0.0],
    "tiny": [1.0, 1e-300, 1e-12, 1.0],
    "subnormal": [5e-324, 0.0, 5e-324],
    "huge": [1e307, -3e307, 0.0],
    "vector257": vector(257).tolist(),
    "vector300": vector(300).tolist(),
}


@pytest.mark.parametrize("name", TABLE_WEIGHTS)
def test_table_masses_are_exact(name: str) -> None:
    w = TABLE_WEIGHTS[name]
    table = twin.streams.alias_table(w)
    cells = len(table.alias)
    assert len(w) <= cells < 2 * len(w)
    total = cells * 2**32
    mass = twin.streams.masses(w, total)
    reached = [0] * cells  # out of `total`, the words that end in each index
    for cell in range(cells):
        coin = int(table.threshold[cell])
        reached[cell] += coin
        reached[int(table.alias[cell])] += 2**32 - coin
    assert sum(mass) == total
    assert reached == mass + [0] * (cells - len(w))
    exact = [Fraction(abs(x)) for x in w]
    # each running sum is rounded to the nearest integer; the rest is its own float64 rounding
    slack = Fraction(1, 2) + Fraction((len(w) + 2) * total, 2**53)
    for i, x in enumerate(exact):
        wanted = total * sum(exact[: i + 1]) / sum(exact)
        assert abs(sum(mass[: i + 1]) - wanted) <= slack
        assert x != 0 or mass[i] == 0


def test_draw_at_the_threshold() -> None:
    # w = (1, 3): cell 0 keeps half of its mass, the rest of it and all of cell 1 belong to 1.
    table = twin.streams.alias_table([1.0, 3.0])
    assert table.threshold.tolist() == [2**31, 0]
    assert table.alias.tolist() == [1, 1]
    coins = [0, 2**31 - 1, 2**31, 2**32 - 1]
    words = np.array([coin << 32 | cell for cell in (0, 1) for coin in coins], dtype=np.uint64)
    assert twin.streams.draw(table, words).tolist() == [0, 0, 1, 1, 1, 1, 1, 1]


def test_shuffle_reaches_every_order_equally() -> None:
    # One word in each of the 4, 3 and 2 equal intervals of the three swaps: 24 different orders.
    middles = [[((2 * j + 1) << 63) // k for j in range(k)] for k in (4, 3, 2)]
    orders = [
        tuple(twin.streams.shuffle(np.arange(4), np.array(words, dtype=np.uint64)).tolist())
        for words in itertools.product(*middles)
    ]
    assert sorted(orders) == sorted(itertools.permutations(range(4)))


def test_systematic_counts_law() -> None:
    w = np.array([3.0, -1.0, 0.5, 0.0, 2.0])
    gamma = np.abs(w).sum()
    for size in (1, 7, 50, 1000):
        expected = size * np.abs(w) / gamma
        mean_square = []
        for offset in (np.arange(104) + 0.5) / 104:  # c_i is a multiple of 1/13: the mean is exact
            n_i = twin.sampling.systematic_counts(w, size, float(offset))
            assert n_i.sum() == size
            assert n_i[3] == 0
            assert np.all(np.abs(n_i - expected) < 1.0)
            mean_square.append(np.sum((gamma * n_i / size - np.abs(w)) ** 2))
        f = expected % 1.0
        law = (gamma / size) ** 2 * np.sum(f * (1 - f))
        assert np.isclose(np.mean(mean_square), law, rtol=1e-10, atol=1e-25)
    assert twin.sampling.systematic_counts(w, 6500, 0.9).tolist() == [3000, 1000, 500, 0, 2000]
    assert twin.sampling.systematic_counts([0.0, 0.0], 9, 0.3).tolist() == [0, 0]
    # The last offset below 1 must not lose a sample to rounding, nor give it to a zero.
    assert twin.sampling.systematic_counts([1.0, 2.0, 0.0], 3, 1 - 2.0**-53).tolist() == [1, 2, 0]


def chi_square(indices: NDArray[Any], p: NDArray[np.float64]) -> float:
    observed = np.bincount(indices, minlength=len(p))
    assert np.all(observed[p == 0] == 0)
    expected = len(indices) * p[p > 0]
    return float(np.sum((observed[p > 0] - expected) ** 2 / expected))


def test_draws_have_the_law_and_a_wrong_law_is_seen() -> None:
    w = np.array([1.0, -2.0, 3.0, 0.0, 5.0, -0.5, 2.5, 4.0])
    p = np.abs(w) / np.abs(w).sum()
    indices = twin.sampling.sample_indices(w, 100_000, key=root_key(1))[:, 0]
    # 6 degrees of freedom: chi-square exceeds 38.3 with probability 1e-6.
    assert chi_square(indices, p) < 38.3
    wrong = p.copy()
    wrong[[1, 2]] += [0.01, -0.01]
    assert chi_square(indices, wrong) > 38.3
    pairs = 8 * indices[0::2] + indices[1::2]  # independence of neighbours: other lanes
    assert chi_square(pairs, np.outer(p, p).ravel()) < 109.7  # 48 degrees of freedom, 1e-6
    pairs = 8 * indices[0:-8][::16] + indices[8:][::16]  # and of successive outputs of one lane
    assert chi_square(pairs, np.outer(p, p).ravel()) < 109.7


# --- golden digests: a change here changes every result ever computed ----------------------------

GOLDEN = {
    ("vector10", "iid", 20_000): (
        "ee5a4d3df2c5318db72813c386486366c5ed42b28992a466a6d1e53389292336"
    ),
    ("vector300", "iid", 5_000): (
        "507a993664b59993146b437b7d0a446a94bc7f94c5f88347cf71b6a050c48452"
    ),
    ("matrix-columns", "iid", 1_000): (
        "abc10c94c2bb3c14c9a00bdd177ccc4c98b5f69d122c03edabd1064f364563af"
    ),
    ("matrix-rows", "systematic", 1_000): (
        "0fac86eecbc7e6804d325f2f7e2a078fadadff5ce40698d1eef634cc2b06fb5e"
    ),
}


@pytest.mark.parametrize(("name", "scheme", "size"), GOLDEN)
def test_golden_draws(name: str, scheme: str, size: int) -> None:
    target, axis = TARGETS[name]
    expected = GOLDEN[name, scheme, size]
    ours = twin.sampling.sample_indices(target, size, key=root_key(2024), scheme=scheme, axis=axis)
    assert digest(ours) == expected
    ensemble = se.sample(target, size, rng=2024, scheme=scheme, axis=axis)
    assert digest(ensemble.indices) == expected


# --- the core against the twin --------------------------------------------------------------------


@cache
def twin_indices(name: str, size: int, scheme: str) -> NDArray[np.int64]:
    target, axis = TARGETS[name]
    return twin.sampling.sample_indices(target, size, key=root_key(7), scheme=scheme, axis=axis)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", TARGETS)
def test_iid_draws_equal_the_twin(name: str, size: int) -> None:
    target, axis = TARGETS[name]
    ensemble = se.sample(target, size, rng=7, axis=axis)
    assert bytes.fromhex(ensemble.key.hex) == root_key(7)
    # draw i does not depend on the size, so one long run of the twin serves all sizes
    assert np.array_equal(ensemble.indices, twin_indices(name, max(SIZES), "iid")[:size])


@pytest.mark.parametrize("size", [1, 2, 7, CHUNK + 1])
@pytest.mark.parametrize("name", TARGETS)
def test_systematic_draws_equal_the_twin(name: str, size: int) -> None:
    target, axis = TARGETS[name]
    ensemble = se.sample(target, size, rng=7, scheme="systematic", axis=axis)
    assert np.array_equal(ensemble.indices, twin_indices(name, size, "systematic"))


@pytest.mark.parametrize("size", [1, 1000, 10**12, 2**53])
@pytest.mark.parametrize("name", TARGETS)
def test_systematic_counts_equal_the_twin(name: str, size: int) -> None:
    target, axis = TARGETS[name]
    counts = se.sample_counts(target, size, rng=7, scheme="systematic", axis=axis)
    lines = []
    for j, w in enumerate(twin.sampling.to_lines(target, axis).T):
        word = int(twin.streams.chacha8_words(root_key(7), 1, j, 0, 1)[0])
        lines.append(twin.sampling.systematic_counts(w, size, (word >> 11) * 2.0**-53))
    expected = twin.sampling.from_lines(np.stack(lines, axis=1), target.ndim, axis)
    assert counts.counts.dtype == np.int64
    assert np.array_equal(counts.counts, expected)
    drawn = np.any(twin.sampling.to_lines(target, axis) != 0, axis=0)  # a zero line is hit nowhere
    assert np.array_equal(twin.sampling.to_lines(counts.counts, axis).sum(axis=0), size * drawn)
    if size <= 1000:
        ensemble = se.sample(target, size, rng=7, scheme="systematic", axis=axis)
        assert np.array_equal(ensemble.counts(), expected)


@pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="reads Linux's accounts")
def test_a_million_matrices_take_their_bytes() -> None:
    script = """
        import numpy as np, stochens_rs as se
        def kilobytes(name):
            return int(next(line.split()[1] for line in open("/proc/self/status") if name in line))
        A = np.random.default_rng(0).standard_normal((100, 100))
        se.sample(A, 100, rng=1)
        before = kilobytes("VmRSS")
        E = se.sample(A, 1_000_000, rng=1)
        assert E.nbytes == 10**8
        print(kilobytes("VmRSS") - before, kilobytes("VmHWM") - before)
    """
    run = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True, timeout=120
    )
    assert run.returncode == 0, run.stderr
    resident, peak = (1024 * int(kilobytes) for kilobytes in run.stdout.split())
    assert 10**8 <= resident <= 110 * 10**6
    assert peak <= 110 * 10**6
