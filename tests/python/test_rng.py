"""Keys: fixed values, distinct where they must be, and without side effects.

The golden values are stream version 1. If one of them changes, every stored result changes:
that belongs under "Value-breaking changes" in the changelog and makes version 2.
"""

from __future__ import annotations

import copy
import hashlib
import pickle

import numpy as np
import pytest

from stochens_rs.rng import Key, as_key

SeedSequence = np.random.SeedSequence

GOLDEN = [
    (0, "c91608bb82810e7c2adba867a9583a6c709651180e4fabe037c3d0e2c46fee9d"),
    (42, "cd28030fc5ff254ebb07d4d3d97389a7047c19d417113457a6f7a947856047ac"),
    (2**4096 - 1, "ff1f0f71409ddedef8c34dabe3160782b7ca38ef951ebb6d5976704345465f77"),
    (SeedSequence(42), "66ee137e9f0139fcf15ad137b86e49ff87bafe19c755c2e83b444b2382a76207"),
    (
        SeedSequence([1, 2, 3], spawn_key=(7,), pool_size=8),
        "5ae55f0672a50f46f5d7e82a9f2765397ea32e15d31385f742a1ff6c893b76d2",
    ),
]
GOLDEN_CHILD_A_OF_42 = "4480e4dbe4a7f6fa82c1ad1b6d89e4baf742337ac67dc0d9f9b6242ceb5a99cb"


def formula(tag, payload):
    return hashlib.sha256(b"stochens key v1\0" + tag + b"\0" + payload).hexdigest()


# -- value stability ---------------------------------------------------------------------------


@pytest.mark.parametrize(("rng", "expected"), GOLDEN, ids=["0", "42", "largest", "ss", "ss child"])
def test_golden_keys(rng, expected):
    assert as_key(rng).hex == expected


def test_golden_child():
    assert as_key(42).child("A").hex == GOLDEN_CHILD_A_OF_42


def test_formula():
    assert as_key(17).hex == formula(b"int", b"17")
    assert as_key(SeedSequence(17)).hex == formula(b"seedseq", b"17|[]|4")
    assert as_key(SeedSequence([17, 4])).hex == formula(b"seedseq", b"[17,4]|[]|4")
    assert as_key(SeedSequence(17).spawn(3)[2]).hex == formula(b"seedseq", b"17|[2]|4")
    words = np.random.default_rng(17).bytes(32)
    assert as_key(np.random.default_rng(17)).hex == formula(b"bytes", words)
    child = hashlib.sha256(b"stochens child v1\0" + bytes(as_key(17)) + "ünï".encode())
    assert as_key(17).child("ünï").hex == child.hexdigest()


# -- distinctness ------------------------------------------------------------------------------


def test_root_and_descendants_are_distinct():
    roots = [as_key(seed) for seed in range(50)]
    names = ["", "x0", "xf", "A", "B", "0", "1", "a" * 100]
    children = [root.child(name) for root in roots for name in names]
    grandchildren = [child.child(name) for child in children[:50] for name in names]
    everyone = roots + children + grandchildren
    assert len(set(everyone)) == len(everyone)


def test_none_is_fresh_every_time():
    assert as_key(None) != as_key(None)


# -- side effects ------------------------------------------------------------------------------


def test_seed_sequence_is_not_modified():
    sequence = SeedSequence(42)
    first = as_key(sequence)
    assert sequence.n_children_spawned == 0
    assert as_key(sequence) == first
    np.testing.assert_array_equal(sequence.generate_state(8), SeedSequence(42).generate_state(8))


@pytest.mark.parametrize("kind", ["PCG64", "MT19937", "Philox", "SFC64"])
def test_generator_advances_by_exactly_32_bytes(kind):
    make = getattr(np.random, kind)
    given, twin = np.random.Generator(make(5)), np.random.Generator(make(5))
    first, second = as_key(given), as_key(given)
    assert first != second
    twin.bytes(32)
    twin.bytes(32)
    assert given.bytes(64) == twin.bytes(64)


def test_bit_generator_is_its_generator():
    bits = np.random.PCG64(5)
    assert as_key(bits) == as_key(np.random.default_rng(5))
    assert as_key(bits) != as_key(np.random.default_rng(5))  # it has advanced


# -- the object --------------------------------------------------------------------------------


def test_key_is_a_plain_value():
    key = as_key(42)
    assert as_key(key) is key
    assert Key(bytes(key)) == key
    assert Key.from_hex(key.hex) == key == Key.from_hex(key.hex.upper())
    assert hash(Key(bytes(key))) == hash(key)
    assert key != bytes(key)
    assert repr(key) == "Key('cd28030fc5ff254e...')"
    for twin in (copy.copy(key), copy.deepcopy(key)):
        assert twin == key
    for protocol in range(2, pickle.HIGHEST_PROTOCOL + 1):
        assert pickle.loads(pickle.dumps(key, protocol)) == key


def test_key_is_immutable():
    key = as_key(42)
    with pytest.raises(AttributeError):
        key.bytes32 = bytes(32)
