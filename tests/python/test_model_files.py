"""Files of models and trajectories: what is loaded is what was saved, or a clear error."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

import stochens_rs as se
from declarations import opts
from stochens_rs._base import files as state_file
from stochens_rs.exceptions import InputTypeError, StateError, StateNotFoundError

A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[0.0], [1.0]])
NAMED = {"state_names": ["Größe", ""], "input_names": ["u 0"], "dt": 0.1}


def pairs(N: int = 60, **about) -> se.Trajectories:
    gen = np.random.default_rng(3)
    x, u, w = gen.standard_normal((N, 2)), gen.standard_normal((N, 1)), gen.standard_normal((N, 2))
    return se.Trajectories.from_pairs(x, u, x @ A.T + u @ B.T + 0.1 * w, **about)


def runs() -> se.Trajectories:
    """Runs of unequal lengths."""
    gen, states, inputs = np.random.default_rng(4), [], []
    for T in (3, 11, 1, 25):
        x, u = [gen.standard_normal(2)], gen.standard_normal((T, 1))
        for k in range(T):
            x.append(A @ x[-1] + B @ u[k] + 0.1 * gen.standard_normal(2))
        states.append(np.array(x))
        inputs.append(u)
    return se.Trajectories(states, inputs, **NAMED)


def identify(data: se.Trajectories, **options) -> se.Model:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return se.identify(data, **opts(**options))


NAN = np.nan
MODELS = {
    "plain": lambda: identify(runs()),
    "independent": lambda: identify(
        pairs(**NAMED), checks=False, noise=se.Noise(design="independent")
    ),
    "intercept": lambda: identify(
        runs(), intercept=True, scale=[1.0, 2.0, 3.0], noise=se.Noise(sigma=0.1)
    ),
    "known columns": lambda: identify(runs(), known_B=B, noise=se.Noise(covariance="diagonal")),
    "known entries": lambda: identify(runs(), known_A=[[NAN, 0.2], [NAN, NAN]]),
    "covariance": lambda: identify(
        runs(), noise=se.Noise(covariance=[[0.01, 0.001], [0.001, 0.02]])
    ),
    "sub-gaussian": lambda: identify(runs(), noise=se.Noise(law="sub-gaussian", sigma=0.2)),
    "bounded": lambda: identify(runs(), noise=se.Noise(law="bounded", sigma=1e-60)),
    "scalar": lambda: identify(pairs(), noise=se.Noise(design="independent", covariance="scalar")),
    "rank deficient": lambda: identify(pairs(2)),
}


def same_bits(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())
    return type(a) is type(b) and a == b


@pytest.mark.parametrize("name", MODELS)
def test_a_loaded_model_is_the_saved_one_bit_for_bit(name: str, tmp_path: Path) -> None:
    model = MODELS[name]()
    assert model.save(tmp_path / "model") == 1
    loaded = se.Model.load(tmp_path / "model")
    assert loaded.data == model.data
    assert same_bits(loaded.data._rows, model.data._rows)
    assert loaded.data.state_names == model.data.state_names
    for field in ("triangle", "scale", "intercept", "known"):
        assert same_bits(getattr(loaded, field), getattr(model, field)), field
    for field in ("design", "noise", "covariance", "known"):
        mine, its = getattr(model.assumptions, field), getattr(loaded.assumptions, field)
        assert same_bits(its, mine), field
    for field in ("A", "B", "c", "covariance", "missing", "warnings", "rank"):
        assert same_bits(getattr(loaded, field), getattr(model, field)), field
    if model.checks is None:
        assert loaded.checks is None
    else:
        mine, its = model.checks, loaded.checks
        assert (its.p_values, its.draws, its.exact) == (mine.p_values, mine.draws, mine.exact)
        assert its.distances == mine.distances
    assert repr(loaded) == repr(model)
    mine, its = model.region(0.1), loaded.region(0.1)
    assert same_bits(its.centre, mine.centre)
    assert (its.assumption, its.missing) == (mine.assumption, mine.missing)
    x, u = [1.0, -2.0], np.ones(model.m)
    assert same_bits(its.bound(x, u), mine.bound(x, u))
    assert same_bits(its.component_bounds(x, u), mine.component_bounds(x, u))
    for part, other in zip(mine.parts, its.parts, strict=True):
        for field in ("rows", "columns", "white", "root", "missing", "ratio", "S", "factor"):
            assert same_bits(getattr(part, field), getattr(other, field)), field
    near = [model.A, model.A + 0.2]
    assert [its.contains(a, model.B, model.c) for a in near] == [
        mine.contains(a, model.B, model.c) for a in near
    ]


def test_a_file_says_what_it_is(tmp_path: Path) -> None:
    identify(runs()).save(tmp_path / "model")
    runs().save(tmp_path / "data")
    stream = se.Stream(([[3.0]], [[1.0]]), [2.0], [0.5], rng=1)
    stream.save(tmp_path / "stream")
    for kind, file in ((se.Model, "data"), (se.Trajectories, "model"), (se.Model, "stream")):
        with pytest.raises(StateError, match="holds a state of kind"):
            kind.load(tmp_path / file)
    before = (tmp_path / "data").read_bytes()
    with pytest.raises(StateError):
        identify(runs()).save(tmp_path / "data")
    assert (tmp_path / "data").read_bytes() == before
    with pytest.raises(StateNotFoundError):
        se.Model.load(tmp_path / "none")
    for wrong in (3, None, b"x"):
        with pytest.raises(InputTypeError, match="`path` must be a path"):
            se.Model.load(wrong)


def test_any_safetensors_reader_reads_a_model(tmp_path: Path) -> None:
    safetensors = pytest.importorskip("safetensors")
    model = MODELS["known entries"]()
    model.save(tmp_path / "model")
    with safetensors.safe_open(tmp_path / "model", framework="numpy") as file:
        assert file.metadata()["kind"] == "model"
        np.testing.assert_array_equal(file.get_tensor("known").reshape(2, 3), model.known)
        rows = file.get_tensor("data.rows").reshape(-1, 5)
    np.testing.assert_array_equal(rows, np.hstack(model.data.pairs()))


# -- faults --------------------------------------------------------------------------------------


def sealed(tmp_path: Path, model: se.Model, changes: dict[str, object]) -> Path:
    """A file with a correct digest and other contents: arrays by name, None for none, or fields."""
    sections = {name: np.array(array) for name, array in model._to_sections().items()}
    tree = json.loads(sections["record"].tobytes())
    for name, value in changes.items():
        *above, field = name.split("/")
        within = tree
        for one in above:
            within = within[one]
        if value is None:
            del sections[name]
        elif isinstance(value, np.ndarray) or callable(value):
            sections[name] = value(sections[name]) if callable(value) else value
        else:
            within[field] = value
    sections["record"] = np.frombuffer(json.dumps(tree).encode(), np.uint8)
    path = tmp_path / "model"
    state_file.save(path, "model", sections)
    return path


def whole(*values: int) -> np.ndarray:
    return np.array(values, dtype=np.int64).view(np.uint8)


def put(at: int, value: float):
    def change(array: np.ndarray) -> np.ndarray:
        array[at] = value
        return array

    return change


BIG = 2**62
PLACE = {"type": "array", "name": "more", "dtype": "float64"}
HOSTILE = [
    ("plain", {"data.rows": None}, "`data.rows` must be one list or array of float64"),
    ("plain", {"more": np.zeros(1)}, "no array 'more'"),
    ("plain", {"schema": "stochens-record/2"}, "`schema` must be"),
    ("plain", {"type": "Region"}, "`type` must be 'Model'"),
    ("plain", {"more": 1}, "more.* is no field of"),
    ("plain", {"data/n": 0}, "`n` must be in"),
    ("plain", {"data/n": BIG}, "`n` must be in"),
    ("plain", {"data.rows": np.zeros(0)}, "`data.rows` must have 0 entries"),
    ("plain", {"data/rows/shape": [50, 4]}, "do not fit together"),
    ("plain", {"data.rows": put(7, NAN)}, r"`rows\[1, 2\]` is nan"),
    ("plain", {"data.rows": put(7, 3.0)}, "`triangle` must be that of the data"),
    ("plain", {"data.lengths": whole(3, 11, 1, 24)}, "do not fit together"),
    ("plain", {"data.lengths": whole(3, 11, 0, 26)}, "`lengths` must be in"),
    ("plain", {"data.lengths": whole(3, 11, BIG, 26)}, "`lengths` must be in"),
    ("plain", {"data.lengths": whole()}, "`data.lengths` must have 0 entries"),
    ("plain", {"data/dt": 0.0}, "`dt` must be > 0"),
    ("plain", {"data/dt": "nan"}, "`data.dt` must be float or None"),
    ("plain", {"data/state_names": ["a"]}, "`state_names` must have 2 names"),
    ("plain", {"data/state_names": ["a", "\ud800"]}, "state_names"),
    ("plain", {"assumptions/design": "any"}, "`assumptions.design` must be one of 'independent'"),
    ("plain", {"assumptions/design": "independent"}, "`design` must be 'adaptive'"),
    ("plain", {"assumptions/noise": "sub-gaussian"}, "`known` must be given for sub-g"),
    ("plain", {"assumptions/covariance": "known"}, "`known` must be the covariance"),
    ("plain", {"assumptions/exact": [2]}, "`exact` must have numbers of states, below 2"),
    ("plain", {"assumptions/exact": [1, 0]}, "`exact` must be different states"),
    ("plain", {"intercept": 2}, "`intercept` must be"),
    ("plain", {"intercept": True}, "`triangle` must have shape"),
    ("plain", {"triangle": np.ones(24)}, "`triangle` must have 24 entries"),
    ("plain", {"triangle": put(5, 1.0)}, "`triangle` must be upper triangular"),
    ("plain", {"triangle": put(0, np.inf)}, "triangle"),
    ("plain", {"triangle": put(24, 1e-3)}, "`triangle` must be that of the data"),
    ("plain", {"scale": {**PLACE, "shape": [2]}, "more": np.ones(2)}, "`scale` must have shape"),
    ("plain", {"scale": {**PLACE, "shape": [3]}, "more": -np.ones(3)}, "`scale` must be in"),
    ("plain", {"checks/p_values": {}}, "must be"),
    ("plain", {"checks/p_values/tails": 2.0}, "must be at most 1"),
    ("plain", {"checks/draws": 0}, "`draws` must be in"),
    ("plain", {"checks/exact": 5}, "exact` must be"),
    ("plain", {"checks/distances": {}}, "`distances` must have a number for"),
    ("plain", {"checks/distances/tails": "nan"}, "`checks.distances.*` must be float"),
    ("known entries", {"known": np.full(6, NAN)}, "`known` must have numbers, and nan"),
    ("known entries", {"known": np.full(6, np.inf)}, "`known` must contain numbers up to"),
    ("known entries", {"known": np.ones(6)}, "`known` must have numbers, and nan"),
    ("known entries", {"known/shape": [3, 2]}, "`known` must have shape"),
    ("covariance", {"assumptions.known": -np.ones(4)}, "`known` must be positive semi"),
    ("covariance", {"assumptions.known": np.arange(4.0)}, "`known` must be symmetric"),
    ("covariance", {"assumptions.known": np.ones(2)}, "`assumptions.known` must have 2 entries"),
]


@pytest.mark.parametrize(("name", "changes", "said"), HOSTILE)
def test_a_sealed_file_with_wrong_contents_is_refused(name, changes, said, tmp_path) -> None:
    path = sealed(tmp_path, MODELS[name](), changes)
    with pytest.raises(StateError, match=said) as caught:
        se.Model.load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
