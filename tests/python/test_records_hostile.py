"""Files and data of records from anywhere: the saved record, or a clear error; nothing is run."""

from __future__ import annotations

import contextlib
import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from stochens_rs._base import fields
from stochens_rs._base import files as state_file
from stochens_rs._base import running as memory
from stochens_rs.exceptions import (
    InputError,
    InputTypeError,
    ResourceError,
    StateError,
    StateNotFoundError,
    StateRecoveredWarning,
    StochensError,
)
from test_records import PARTS, PLANS, same

ALL = PLANS | PARTS
FILES = [name for name, make in ALL.items() if hasattr(make(), "save")]


def parts(record: Any) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The JSON and the arrays of its file."""
    sections = {name: np.array(array) for name, array in record._to_sections().items()}
    return json.loads(sections.pop("record").tobytes()), sections


def sealed(path: Path, kind: str, tree: Any, arrays: dict[str, np.ndarray]) -> Path:
    """A file with a correct digest."""
    text = tree if isinstance(tree, bytes) else json.dumps(tree).encode()
    state_file.save(path, kind, {**arrays, "record": np.frombuffer(text, np.uint8)})
    return path


def test_every_torn_file_is_refused_or_the_previous_one_taken(tmp_path: Path) -> None:
    """Cut at 60 places, a bit flipped in 150: never another plan."""
    path, plan = tmp_path / "plan", PLANS["limits"]()
    plan.save(path)
    content, gen = path.read_bytes(), np.random.default_rng(1)
    for cut in gen.choice(len(content), 60, replace=False):
        path.write_bytes(content[:cut])
        with pytest.raises(StateError):
            se.Plan.load(path)
    for at in gen.choice(len(content), 150, replace=False):
        flipped = bytearray(content)
        flipped[at] ^= 1 << int(gen.integers(8))
        path.write_bytes(flipped)
        with pytest.raises(StateError):
            se.Plan.load(path)
    path.write_bytes(content)
    assert plan.save(path) == 2
    path.write_bytes(content[:50])
    with pytest.warns(StateRecoveredWarning, match="generation 1 was loaded"):
        assert same(se.Plan.load(path), plan)


def test_a_file_says_what_it_is(tmp_path: Path) -> None:
    PARTS["fit"]().save(tmp_path / "fit")
    before = (tmp_path / "fit").read_bytes()
    for kind in (se.Plan, se.Trajectory, se.Model, se.Certificate):
        with pytest.raises(StateError, match="holds a state of kind"):
            kind.load(tmp_path / "fit")
    with pytest.raises(StateError):
        PLANS["exact"]().save(tmp_path / "fit")
    assert (tmp_path / "fit").read_bytes() == before
    with pytest.raises(StateNotFoundError):
        se.Plan.load(tmp_path / "none")
    for wrong in (3, None, b"x"):
        with pytest.raises(InputTypeError, match="`path` must be a path"):
            se.Fit.load(wrong)
    with pytest.raises(InputError, match=r"`type` must be 'Plan', got str 'Fit'"):
        se.Plan.from_dict(PARTS["fit"]().to_dict())


def put(*where: Any, to: Any) -> Callable[[dict[str, Any], dict[str, np.ndarray]], None]:
    def change(tree: dict[str, Any], _: dict[str, np.ndarray]) -> None:
        for step in where[:-1]:
            tree = tree[step]
        tree[where[-1]] = to

    return change


def without(*where: Any) -> Callable[[dict[str, Any], dict[str, np.ndarray]], None]:
    def change(tree: dict[str, Any], _: dict[str, np.ndarray]) -> None:
        for step in where[:-1]:
            tree = tree[step]
        del tree[where[-1]]

    return change


def array(name: str, to: Any) -> Callable[[dict[str, Any], dict[str, np.ndarray]], None]:
    def change(_: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
        if to is None:
            del arrays[name]
        else:
            arrays[name] = to(arrays.get(name)) if callable(to) else to

    return change


def nan(values: np.ndarray) -> np.ndarray:
    values[0] = np.nan
    return values


BIG = 2**62
LIMITS, MODEL = "limits", "plan of a model"
HOSTILE = [
    (LIMITS, put("schema", to="stochens-record/2"), "`schema` must be 'stochens-record/1'"),
    (LIMITS, without("fusion"), "`fusion` is missing of a Plan"),
    (LIMITS, put("more", to=1), "str 'more' is no field of a Plan"),
    (LIMITS, put("u", "shape", to=[BIG, BIG]), "`u` must have 4 entries"),
    (LIMITS, put("u", "shape", to=[1] * 40 + [4]), "`u` must have 4 entries"),
    (LIMITS, put("u", "dtype", to="object"), "`u` must be an array of numbers"),
    (LIMITS, array("u", nan), r"`u\[0, 0\]` is nan"),
    (LIMITS, array("more", np.zeros(4)), "no array 'more'"),
    (LIMITS, put("limited", "gap", to=10**400), "`limited.gap` must be float, got int of"),
    (LIMITS, put("basis", "type", to="os.system"), "`basis` must be a Basis or a ModelBasis"),
    (LIMITS, put("basis", "type", to=["Basis"]), "`basis` must be a Basis or a ModelBasis"),
    (LIMITS, put("basis", "A", "key", to="00"), "`bytes32` must have 32 bytes"),
    (LIMITS, put("basis", "A", "size", to=None), "`size of A` must be known for kind 'iid'"),
    (
        LIMITS,
        put("info", "x", to={"type": "Region"}),
        r"`info\['x'\].centre` is missing of a Region",
    ),
    (LIMITS, put("info", "x", to={"type": "tuple"}), r"`info\['x'\]` must be a tuple, got None"),
    (MODEL, array("basis.model.data.rows", lambda rows: rows + 1.0), "`triangle` must be that of"),
    (MODEL, array("basis.model.triangle", lambda R: 2.0 * R), "`triangle` must be that of the"),
    (MODEL, put("basis", "model", "data", "n", to=5), "these Trajectories do not fit together"),
    (MODEL, put("basis", "model", "assumptions", "covariance", to="known"), "`known` must be the"),
    (MODEL, put("basis", "model", "data", "n", to=BIG), "`n` must be in"),
    ("model", put("data", "dt", to="nan"), "`data.dt` must be float or None"),
    ("model", put("data", "state_names", to=["a"]), "`state_names` must have 2 names"),
    ("model", put("assumptions", "design", to="any"), "`assumptions.design` must be one of"),
    ("model", put("assumptions", "exact", to=[1, 0]), "`exact` must be different states"),
    ("model", array("triangle", lambda R: R + np.inf), "triangle"),
    ("model", put("checks", "p_values", "tails", to=2.0), "and at most 1"),
    ("model, known entries", array("known", lambda one: one * np.nan), "`known` must have numbers"),
    ("model, covariance", array("assumptions.known", lambda one: -one), "`known` must be posit"),
    ("fit", array("estimate", lambda one: 1.03 * one), "got one that differs from it by 0.03"),
    ("fit", array("weights", nan), r"`weights\[0\]` is nan"),
    ("fit", array("ensemble.indices", lambda i: i * 0 + 9), r"`indices` must lie in \[0, 2\)"),
    ("no steps", put("inputs", "shape", to=[0, BIG]), "`inputs` must have 0 entries"),
    ("fleet", put("support", to=[9]), "`support` must be in"),
    ("counts", put("counts", to=[[1.5, 0], [0, 0]]), "`counts` must be nested lists of int64"),
    ("certificate", put("delta", to=1.5), "`delta` must be in"),
]


@pytest.mark.parametrize(("name", "change", "said"), HOSTILE)
def test_a_sealed_file_with_wrong_contents_is_refused(name, change, said, tmp_path) -> None:
    made = ALL[name]()
    tree, arrays = parts(made)
    change(tree, arrays)
    path = sealed(tmp_path / "a", made._kind, tree, arrays)
    with pytest.raises(StateError, match=said) as caught:
        type(made).load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


TEXTS = [
    (b"", "`record` must be JSON"),
    (b"[]", "`data` must be a dict"),
    (b'{"a": NaN}', "`schema` must be"),
    (b"\xff", "`record` must be JSON"),
    (b"[" * 200_000, "`record` must be JSON"),
    (b'{"a":' * 200_000, "`record` must be JSON"),
    (b'{"schema":"stochens-record/1","type":"Plan","u":' + b"9" * 5000 + b"}", "record|field"),
]


@pytest.mark.parametrize(("text", "said"), TEXTS)
def test_texts_that_are_no_record(text: bytes, said: str, tmp_path: Path) -> None:
    path = sealed(tmp_path / "a", "plan", text, {})
    with pytest.raises(StateError, match=said):
        se.Plan.load(path)
    state_file.save(tmp_path / "b", "plan", {"u": np.zeros(1)})
    with pytest.raises(StateError, match="must have an array 'record'"):
        se.Plan.load(tmp_path / "b")
    state_file.save(tmp_path / "c", "plan", {"record": np.zeros(1)})
    with pytest.raises(StateError, match="`record` must be JSON"):
        se.Plan.load(tmp_path / "c")


def test_dicts_from_anywhere_are_refused() -> None:
    deep: Any = []
    for _ in range(100_000):
        deep = [deep]
    good = PLANS["exact"]().to_dict()
    for wrong, error in (
        (None, InputTypeError),
        ([], InputTypeError),
        ({}, InputError),
        ({**good, "u": np.zeros((3, 1))}, InputTypeError),
        ({**good, "u": deep}, InputTypeError),
        ({**good, "info": {"a": deep}}, InputError),
        ({**good, "info": {"a": object()}}, InputTypeError),
        ({**good, 3: 1}, InputError),
    ):
        with pytest.raises(error):
            se.Plan.from_dict(wrong)
    assert same(se.Plan.from_dict(good), PLANS["exact"]())  # the dict is not changed


def test_only_listed_constructors_are_called(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    """Every call that a file leads to is one of the list, and of the declared class."""
    called: list[Any] = []
    own = fields._made

    def watched(name: str, record: Any, given: Any, get: Any) -> Any:
        called.append(record)
        return own(name, record, given, get)

    monkeypatch.setattr(fields, "_made", watched)
    for name in FILES:
        made = ALL[name]()
        made.save(tmp_path / name.replace(" ", "-"))
        type(made).load(tmp_path / name.replace(" ", "-"))
    assert len(called) > 100
    assert set(called) <= set(fields.RECORDS.values())


WILD = [None, True, 0, -1, 2**53, 2.5, -1e300, "inf", "nan", "", "Plan", [], [[]], [1.0], {}]


def places(tree: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = tree.items() if isinstance(tree, dict) else enumerate(tree)
    found = []
    for name, item in items:
        found.append((*at, name))
        if isinstance(item, (dict, list)):
            found += places(item, (*at, name))
    return found


def test_random_contents_give_a_record_or_a_clear_error(tmp_path: Path) -> None:
    """800 files, in `make test` 250, with correct digests: an entry or an array is another one."""
    gen, path = np.random.default_rng(7), tmp_path / "a"
    made = [ALL[name]() for name in FILES if not isinstance(ALL[name](), se.Model)]
    made = [one for one in made if "record" in one._to_sections()]
    refused, loaded, said, count = 0, 0, [], sets(800, 250)
    for k in range(count):
        record = made[k % len(made)]
        tree, arrays = parts(record)
        if gen.random() < 0.7 or not arrays:
            where = places(tree)
            at = where[int(gen.integers(len(where)))]
            wild = copy.deepcopy(WILD[int(gen.integers(len(WILD)))])
            put(*at, to=wild)(tree, arrays)
        else:
            name = sorted(arrays)[int(gen.integers(len(arrays)))]
            values = arrays[name]
            if not values.size:
                continue
            if values.dtype == np.float64:
                values[int(gen.integers(values.size))] = gen.choice([np.nan, np.inf, -1.0, 1e300])
            else:
                values[int(gen.integers(values.size))] = gen.integers(256)
        path.unlink(missing_ok=True)
        sealed(path, record._kind, tree, arrays)
        try:
            found = type(record).load(path)
        except StateError as error:
            refused += 1
            said.append(str(error))
            continue
        loaded += 1
        assert isinstance(found.to_dict(), dict)
        if isinstance(found, se.Plan):
            with contextlib.suppress(StochensError), np.errstate(all="ignore"):
                found.bound(0.2)
    assert refused > count / 2
    assert not any("\n" in text for text in said)
    assert loaded > 50


def test_memory_is_asked_for_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ensemble = PARTS["drawn models"]()
    ensemble.save(tmp_path / "a")
    monkeypatch.setattr(memory, "_SMALL", 0)
    monkeypatch.setattr(memory, "memory_left", lambda: 100)
    for call in (
        ensemble.to_dict,
        lambda: ensemble.save(tmp_path / "b"),
        lambda: type(ensemble).load(tmp_path / "a"),
    ):
        with pytest.raises(ResourceError):
            call()
    size = (tmp_path / "a").stat().st_size
    monkeypatch.setattr(memory, "memory_left", lambda: 5 * size)  # the file, but not its text
    with pytest.raises(ResourceError, match="the text of a saved record"):
        type(ensemble).load(tmp_path / "a")
    assert not (tmp_path / "b").exists()
