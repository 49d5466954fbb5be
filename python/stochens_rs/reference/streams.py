"""Random words and categorical draws, version 1 of the stream definition.

A stream is ChaCha8 under a 32-byte key with a 64-bit block counter and the 64-bit nonce
``purpose << 56 | line``. Independent draws take their words from xoshiro256++ generators that are
seeded from that stream, eight lanes for each chunk of 16384 draws, so draw i of a line depends on
(key, line, i) only.

References
----------
D. J. Bernstein, "ChaCha, a variant of Salsa20" (2008); the layout of RFC 8439 with 64-bit counter.
D. Blackman, S. Vigna, "Scrambled linear pseudorandom number generators", ACM TOMS 47 (2021).
M. D. Vose, "A linear algorithm for generating random numbers with a given distribution" (1991).
"""

from __future__ import annotations

import hashlib
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Words32 = NDArray[np.uint32]
Words64 = NDArray[np.uint64]

# purposes (3 = counts and 5 = counts of mean fields, in the core only)
IID, SYSTEMATIC_OFFSET, SYSTEMATIC_PERMUTATION, RUNS = 0, 1, 2, 4
CHUNK = 16384  # draws that share one set of lanes
LANES = 8
CELL = 2**32  # integer mass of one cell of an alias table


def child(key: bytes, name: str) -> bytes:
    """The key of the independent stream called `name`."""
    return hashlib.sha256(b"stochens child v1\0" + key + name.encode()).digest()


def _rotl32(x: Words32, k: int) -> Words32:
    return (x << np.uint32(k)) | (x >> np.uint32(32 - k))


def _rotl64(x: Words64, k: int) -> Words64:
    return (x << np.uint64(k)) | (x >> np.uint64(64 - k))


def _quarter_round(x: list[Words32], a: int, b: int, c: int, d: int) -> None:
    x[a] = x[a] + x[b]
    x[d] = _rotl32(x[d] ^ x[a], 16)
    x[c] = x[c] + x[d]
    x[b] = _rotl32(x[b] ^ x[c], 12)
    x[a] = x[a] + x[b]
    x[d] = _rotl32(x[d] ^ x[a], 8)
    x[c] = x[c] + x[d]
    x[b] = _rotl32(x[b] ^ x[c], 7)


def chacha_blocks(
    key: bytes, nonce: int, first_block: int, blocks: int, rounds: int = 8
) -> Words32:
    """ChaCha key stream: (blocks, 16) words of 32 bits, block counters from `first_block` on."""
    counter = np.uint64(first_block) + np.arange(blocks, dtype=np.uint64)
    low, high = counter.astype(np.uint32), (counter >> np.uint64(32)).astype(np.uint32)
    fixed = np.frombuffer(b"expand 32-byte k" + key, dtype="<u4")
    tail = np.array([nonce & 0xFFFFFFFF, nonce >> 32], dtype=np.uint32)
    start = [np.full(blocks, word, dtype=np.uint32) for word in fixed]
    start += [low, high] + [np.full(blocks, word, dtype=np.uint32) for word in tail]
    x = list(start)
    for _ in range(rounds // 2):
        for j in range(4):  # columns
            _quarter_round(x, j, 4 + j, 8 + j, 12 + j)
        for j in range(4):  # diagonals
            _quarter_round(x, j, 4 + (j + 1) % 4, 8 + (j + 2) % 4, 12 + (j + 3) % 4)
    return np.stack([a + b for a, b in zip(x, start, strict=True)], axis=1)


def chacha8_words(key: bytes, purpose: int, line: int, first: int, count: int) -> Words64:
    """`count` words of 64 bits of stream(key, purpose, line), from byte ``8 * first`` on."""
    first_block, skip = divmod(first, 8)  # a block holds 8 words of 64 bits
    blocks = -(-(skip + count) // 8)
    words = chacha_blocks(key, purpose << 56 | line, first_block, blocks)
    pairs = words.astype("<u4").view("<u8").reshape(-1)  # the low half comes first
    return pairs.astype(np.uint64)[skip : skip + count]


def xoshiro256pp(state: ArrayLike, count: int) -> Words64:
    """`count` outputs of each generator: `state` is (4, generators), the result (count, ...)."""
    s0, s1, s2, s3 = np.array(state, dtype=np.uint64)
    out = np.empty((count, *s0.shape), dtype=np.uint64)
    for i in range(count):
        out[i] = _rotl64(s0 + s3, 23) + s0
        t = s1 << np.uint64(17)
        s2 = s2 ^ s0
        s3 = s3 ^ s1
        s1 = s1 ^ s2
        s0 = s0 ^ s3
        s2 = s2 ^ t
        s3 = _rotl64(s3, 45)
    return out


def iid_words(key: bytes, line: int, count: int, purpose: int = IID) -> Words64:
    """The words of the draws 0..count-1 of a line, (count,).

    Chunk c, lane l is seeded by the four words at byte ``256 c + 32 l`` of
    stream(key, purpose, line); draw i of a chunk is output ``i // 8`` of lane ``i % 8``.
    """
    chunks = -(-count // CHUNK)
    steps = -(-min(count, CHUNK) // LANES)
    seeds = chacha8_words(key, purpose, line, 0, chunks * LANES * 4)
    state = seeds.reshape(chunks * LANES, 4).T
    outputs = xoshiro256pp(state, steps).reshape(steps, chunks, LANES)
    return outputs.transpose(1, 0, 2).reshape(-1)[:count]


class AliasTable(NamedTuple):
    """2^k cells: cell c gives c if coin < threshold[c], else alias[c]; the coin has 32 bits."""

    threshold: Words64
    alias: NDArray[np.int64]


def masses(weights: ArrayLike, total: int) -> list[int]:
    """Integer masses proportional to abs(weights): they sum to `total`, zeros get 0.

    With C_i the running sum of abs(w): M_i = floor(total * (C_i / C_last) + 1/2), and the mass of
    i is M_i - M_{i-1}, M_{-1} = 0.
    """
    cum = np.cumsum(np.abs(np.asarray(weights, dtype=np.float64)))
    M = [int(x) for x in np.floor(float(total) * (cum / cum[-1]) + 0.5)]
    return [b - a for a, b in zip([0, *M[:-1]], M, strict=True)]


def alias_table(weights: ArrayLike) -> AliasTable:
    """Vose's table with 2^k >= len(weights) cells, in integers, for a vector that is not zero."""
    n = np.size(weights)
    cells = 1
    while cells < n:
        cells *= 2
    mass = masses(weights, cells * CELL) + [0] * (cells - n)
    threshold, alias = [0] * cells, list(range(cells))
    small = [i for i in range(cells) if mass[i] < CELL]
    large = [i for i in range(cells) if mass[i] >= CELL]
    while small:  # the remaining masses have mean CELL, so `large` is not empty
        s, big = small.pop(), large[-1]
        threshold[s], alias[s] = mass[s], big
        mass[big] -= CELL - mass[s]
        if mass[big] < CELL:
            small.append(large.pop())
    # What stays in `large` has mass CELL exactly: threshold 0 and alias = itself.
    return AliasTable(np.array(threshold, dtype=np.uint64), np.array(alias, dtype=np.int64))


def draw(table: AliasTable, words: Words64) -> NDArray[np.int64]:
    """One index for each word: its low k bits choose the cell, its high 32 bits are the coin."""
    cell = (words & np.uint64(len(table.alias) - 1)).astype(np.int64)
    coin = words >> np.uint64(32)
    return np.where(coin < table.threshold[cell], cell, table.alias[cell])


def shuffle(values: NDArray[np.int64], words: Words64) -> NDArray[np.int64]:
    """Fisher-Yates from the end: swap i = N-1..1 with j = floor(word * (i + 1) / 2^64)."""
    out = values.tolist()
    for i, word in zip(range(len(out) - 1, 0, -1), words.tolist(), strict=True):
        j = (word * (i + 1)) >> 64
        out[i], out[j] = out[j], out[i]
    return np.array(out, dtype=np.int64)
