"""Records: files, plain data and pickles give back every bit, or a clear error."""

from __future__ import annotations

import json
import math
import pickle
import re
import struct
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, get_origin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import stochens_rs as se
from declarations import opts
from stochens_rs import _core
from stochens_rs._base import fields
from stochens_rs._base.records import Record, SavedRecord, trusted
from stochens_rs.certificates import Radius
from stochens_rs.exceptions import InputTypeError, StochensError
from stochens_rs.fusion import Alse

SYSTEM = se.System(
    [[1.0, 0.1], [0.0, 0.9]],
    [[0.0], [0.1]],
    dt=0.1,
    states=["Größe", "v"],
    inputs=["F"],
    units={"v": "m/s", "F": "N"},
)
A, B, X0, XF = SYSTEM.A, SYSTEM.B, [1.0, 0.5], [0.0, 0.0]


def key(name: str) -> se.Key:
    return se.Key(bytes(range(32))).child(name)


def data(N: int = 60) -> se.Trajectories:
    x, w, u = np.random.default_rng(3).standard_normal((3, N, 2))
    u = u[:, :1]
    return se.Trajectories.from_pairs(x, u, x @ A.T + u @ B.T + 0.01 * w, dt=0.1)


def model(N: int = 60, **options: Any) -> se.Model:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return se.identify(data(N), **opts(**({"design": "independent"} | options)))


def snapshot() -> Any:
    stream = se.ModelStream(2, 1, noise=se.Noise(sigma=0.1))
    rows = data().rows
    stream.update(rows[:, :2], rows[:, 2:3], rows[:, 3:])
    return stream.model


def unbounded(found: se.Certificate) -> se.Certificate:
    """The same with an infinite target."""
    first = replace(found["target"], radius=math.inf, reason="too few data")
    return replace(found, quantities={**found.quantities, "target": first})


def drawn(name: str, values: Any, size: int = 50, **options: Any) -> se.Ensemble:
    return se.sample(values, size, rng=key(name), **options)


def control(A_: Any = A, x0: Any = X0, xf: Any = XF, **options: Any) -> se.Plan:
    return se.control((A_, B), x0, xf, **options)


def fused() -> Any:
    return se.fuse(
        [(A, B), (0.9 * A, B)], "alse", data=data(), noise=se.Noise(design="independent")
    )


PLANS = {
    "exact": lambda: control(steps=3),
    "iid": lambda: control(drawn("A", A), drawn("x0", X0), steps=4),
    "rows": lambda: control(drawn("A", A, axis="rows"), drawn("x0", X0)),
    "systematic": lambda: control(drawn("A", A, scheme="systematic"), steps=2),
    "diagonal": lambda: control(drawn("A", A), drawn("x0", X0), fusion="diagonal"),
    "plan of counts": lambda: control(se.sample_counts(A, 10**6, rng=key("A")), steps=3),
    "fits": lambda: control(
        se.fuse(drawn("A", A), "alse", target=A),
        se.fuse(drawn("x0", X0), "slse", target=X0),
        steps=2,
    ),
    "brought": lambda: control(se.Ensemble.from_samples(drawn("A", A).dense()), steps=2),
    "estimate": lambda: control(
        se.Ensemble.from_samples(model().draw(20, rng=1).A, centre="estimate"), steps=2
    ),
    "limits": lambda: control(drawn("A", A), drawn("x0", X0), steps=4, limits=(-2.0, 2.0)),
    "rows of limits": lambda: control(
        A,
        drawn("x0", X0),
        steps=4,
        limits=se.Limits(rate=1.0, previous=[0.0], x=([-3.0, -9.0], None)),
        cost=se.Cost(Q=1.0),
    ),
    "soft": lambda: control(
        steps=3, limits=se.Limits(x=(-0.1, 0.1), soft=5.0), cost=se.Cost(Q=1.0)
    ),
    "reference": lambda: control(xf=None, steps=3, cost=se.Cost(Q=1.0, reference=np.ones((4, 2)))),
    "steer": lambda: se.steer(SYSTEM, X0, XF, 100, steps=3, rng=2),
    "plan of a model": lambda: se.control(model(), X0, XF, steps=3),
    "model, one step": lambda: se.control(model(covariance="diagonal"), X0, XF),
    "model, limits": lambda: se.control(model(sigma=0.01), X0, XF, steps=3, limits=(-9.0, 9.0)),
    "model, known": lambda: se.control(model(known=(None, B)), X0, XF, steps=2),
    "model, intercept": lambda: se.control(model(intercept=True), X0, XF, steps=2),
    "fused model": lambda: se.control(fused(), X0, XF, steps=2),
    "model of a stream": lambda: se.control(snapshot(), X0, XF, steps=2),
    "by hand": lambda: replace(PLANS["exact"](), basis=None, info={}),
}
PARTS = {
    "fit": lambda: se.fuse(drawn("A", A), "alse", target=A),
    "fit per column": lambda: se.fuse(drawn("A", A), Alse("per-column"), target=A),
    "fit without target": lambda: se.fuse(drawn("x0", X0)),
    "fit of samples": lambda: se.fuse(
        se.Ensemble.from_samples(drawn("A", A, 9).dense(), centre="truth"), "alse", target=A
    ),
    "path": lambda: se.fuse_path(drawn("A", A), [1, 5, 50], "alse", target=A, estimates=True),
    "trajectory": lambda: se.simulate(SYSTEM, X0, [[1.0], [0.0]]),
    "no steps": lambda: se.simulate((A, B), X0, np.zeros((0, 1))),
    "mean": lambda: se.simulate_ensemble(SYSTEM, X0, [[1.0], [0.0]], 9, rng=1),
    "runs": lambda: se.simulate_ensemble((A, B), X0, [[1.0]], 9, rng=1, keep="covariance runs"),
    "models": lambda: se.simulate_ensemble(model().draw(7, rng=1), X0, [[1.0]]),
    "tracking": lambda: se.track(SYSTEM, [[1.0, 1.0], [1.1, 1.0]], 10, rng=1),
    "ensemble": lambda: drawn("A", A, axis="rows"),
    "many entries": lambda: drawn("x", np.arange(1.0, 400.0)),
    "part": lambda: drawn("A", A, scheme="systematic").prefix(7),
    "given": lambda: se.Ensemble.from_indices([0, 1, 1], [1.0, -2.0]),
    "counts": lambda: se.sample_counts(A, 10**9, rng=1),
    "drawn models": lambda: model(intercept=True).draw(5, rng=1),
    "model": lambda: model(),
    "model, adaptive": lambda: model(
        design="adaptive", intercept=True, scale=[1.0, 2.0, 3.0], sigma=0.1
    ),
    "model, known columns": lambda: model(known=(None, B), covariance="diagonal"),
    "model, known entries": lambda: model(known=([[np.nan, 0.1], [np.nan, np.nan]], None)),
    "model, covariance": lambda: model(covariance=[[0.01, 0.001], [0.001, 0.02]]),
    "model, bounded": lambda: model(design="adaptive", law="bounded", sigma=1e-60),
    "model, few pairs": lambda: model(2),
    "runs of a model": lambda: se.Trajectories(np.ones((3, 4, 2)), np.ones((3, 3, 1)), dt=0.1),
    "fused": fused,
    "region": lambda: model().region(0.1),
    "bound": lambda: PLANS["iid"]().bound(),
    "certificate": lambda: PLANS["plan of a model"]().bound(),
    "infinite certificate": lambda: unbounded(PLANS["plan of a model"]().bound()),
    "next runs": lambda: se.design(
        se.control(model(design="adaptive", sigma=1.0), X0, XF, steps=3), 3, limits=(-1.0, 1.0)
    ),
    "typical": lambda: PLANS["plan of a model"]().typical(),
    "validation": lambda: PLANS["exact"]().validate([SYSTEM] * 20),
    "infinite validation": lambda: PLANS["exact"]().validate([SYSTEM]),
    "error": lambda: PLANS["iid"]().error(SYSTEM, X0, XF),
    "reachability": lambda: PLANS["iid"]().reachability,
    "fleet": lambda: se.control_fleet([(A, B), (0.9 * A, B)], X0, XF, 3, risk="worst"),
    "key": lambda: key("x"),
}


def same(a: Any, b: Any) -> bool:
    """Equal in every bit, type and field; a number of NumPy comes back as one of Python."""
    a, b = (one.item() if isinstance(one, np.generic) else one for one in (a, b))
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())
    if isinstance(a, float):
        return struct.pack("d", a) == struct.pack("d", b)
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, dict):
        return list(a) == list(b) and all(map(same, a.values(), b.values()))
    if isinstance(a, (Record, _core.RegionPart)) and not isinstance(a, se.Key):
        mine, its = (one.__reduce__()[1] for one in (a, b))
        return len(mine) == len(its) and all(map(same, mine, its))
    return bool(a == b)


@pytest.mark.parametrize("name", [*PLANS, *PARTS])
def test_every_record_comes_back_bit_for_bit(name: str, tmp_path: Path) -> None:
    made = (PLANS | PARTS)[name]()
    kind = type(made)
    text = json.dumps(made.to_dict(), allow_nan=False)
    assert same(kind.from_dict(json.loads(text)), made)
    assert same(kind.from_dict(made.to_dict()), made)
    assert same(pickle.loads(pickle.dumps(made)), made)
    if not hasattr(made, "save"):
        return
    assert made.save(tmp_path / "a") == 1
    loaded = kind.load(tmp_path / "a")
    assert same(loaded, made)
    assert loaded == kind.load(tmp_path / "a") == made
    with pytest.raises(TypeError):
        hash(loaded)
    assert repr(loaded) == repr(made)
    assert loaded.save(tmp_path / "b") == 1
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_records_are_compared_by_what_a_file_holds() -> None:
    plan = se.control(SYSTEM, X0, XF, steps=3)
    again = se.control(SYSTEM, X0, XF, steps=3)
    assert plan == again
    assert plan != replace(plan, info={**plan.info, "note": "another"})
    assert plan != se.control(SYSTEM, X0, XF, steps=2)
    assert plan != se.control(SYSTEM, np.nextafter(X0, 9.0), XF, steps=3)
    assert plan != plan.bound()
    assert plan != "a plan"
    units = se.SystemEnsemble([SYSTEM.A, 1.1 * SYSTEM.A], [SYSTEM.B] * 2)
    fleet = se.control_fleet(units, X0, XF, 3, risk="worst")
    assert fleet == se.control_fleet(units, X0, XF, 3, risk="worst")
    assert fleet != se.control_fleet(units, X0, XF, 3)
    path = se.simulate(SYSTEM, X0, plan.u)
    assert path != replace(path, times=2.0 * path.times)


def outcome(call: Any) -> Any:
    """What a call returns as plain data, or what it refuses."""
    try:
        found = call()
    except StochensError as error:
        return type(error), str(error)
    return repr(found.to_dict() if hasattr(found, "to_dict") else found.tolist())


def questions(plan: se.Plan) -> list[Any]:
    goal = None if plan.limited is not None and plan.limited.task.follows else XF
    return [
        outcome(lambda: plan.bound(0.05)),
        outcome(lambda: plan.bound(0.3)),
        outcome(lambda: plan.bound(system=SYSTEM)),
        outcome(lambda: plan.bound(noise=True)),
        outcome(lambda: plan.covariance()),
        outcome(lambda: plan.covariance("control")),
        outcome(lambda: plan.error(SYSTEM, X0, goal)),
        outcome(lambda: plan.states(SYSTEM, X0)),
    ]


@pytest.mark.parametrize("name", PLANS)
def test_a_loaded_plan_answers_as_the_saved_one(name: str, tmp_path: Path) -> None:
    plan = PLANS[name]()
    plan.save(tmp_path / "plan")
    loaded = se.Plan.load(tmp_path / "plan")
    wanted = questions(plan)
    assert questions(loaded) == wanted
    assert questions(se.Plan.from_dict(json.loads(json.dumps(plan.to_dict())))) == wanted
    answers = [one for one in wanted if isinstance(one, str)]
    assert len(answers) >= (2 if name in ("by hand", "brought", "estimate") else 3)


# -- any values ------------------------------------------------------------------------------------


def canonical(value: Any) -> str:
    """A text that tells types and values apart; all nan are one, as JSON has it."""
    if isinstance(value, np.ndarray):
        return f"array {value.dtype.name} {value.shape} {value.tolist()}"
    if isinstance(value, dict):
        return f"dict {[(name, canonical(item)) for name, item in value.items()]}"
    if isinstance(value, (list, tuple)):
        return f"{type(value).__name__} {[canonical(item) for item in value]}"
    return f"{type(value).__name__} {value!r}"


EXACT = PLANS["exact"]()
CERTIFICATE = PLANS["plan of a model"]().bound()


@given(
    arrays.arrays(np.float64, arrays.array_shapes(min_dims=3, max_dims=3, max_side=4)),
    arrays.arrays(np.float64, st.integers(0, 5), elements=st.floats(0.0, allow_nan=False)),
    st.floats(0.0, allow_nan=False, allow_infinity=False),
)
def test_any_numbers_come_back(A_: np.ndarray, tube: np.ndarray, control: float) -> None:
    radii = {
        "tube": Radius(tube, "x", 0.5, "m", "because"),
        "control": Radius(control, "u", 1.0, ""),
    }
    given_ = replace(CERTIFICATE, quantities=radii)
    for back in (
        type(given_).from_dict(json.loads(json.dumps(given_.to_dict(), allow_nan=False))),
        type(given_)._from_sections(given_._to_sections()),
    ):
        assert canonical(back["tube"].radius) == canonical(tube)
        assert repr(back.control) == repr(control)
    if A_.shape[1] == A_.shape[2] and np.isfinite(A_).all():
        models = se.SystemEnsemble(A_, A_[:, :, :1])
        text = json.dumps(models.to_dict(), allow_nan=False)
        assert same(se.SystemEnsemble.from_dict(json.loads(text)), models)
        assert same(se.SystemEnsemble._from_sections(models._to_sections()), models)


def trusted_records() -> dict[str, Record]:
    """Records that calls return and make on their way, without a check of their fields."""
    found = model()
    plan = se.control((se.fuse(se.sample(A, 50, rng=1)), B), se.sample(X0, 50, rng=2), XF, steps=3)
    limited = se.control(found, X0, XF, steps=3, limits=(-1.0, 1.0), cost=se.Cost(Q=1.0))
    assert plan.basis is not None
    assert limited.limited is not None
    law = se.sample(A, 50, rng=1).law
    assert law is not None
    return {
        "plan": plan,
        "basis": plan.basis,
        **{f"known {one.name}": one for one in plan.basis.entities},  # type: ignore[union-attr]
        "bound": plan.bound(0.1),
        "radius": plan.bound(0.1)["state"],
        "certificate": se.control(found, X0, XF).bound(),
        "certificate within limits": limited.bound(),
        "limited": limited,
        "model basis": limited.basis,  # type: ignore[dict-item]
        "task": limited.limited.task,
        "region": found.region(0.1),
        "checks": found.checks,  # type: ignore[dict-item]
        "law": law,
    }


@pytest.mark.parametrize("name", trusted_records())
def test_records_made_without_checks_pass_them(name: str) -> None:
    record = trusted_records()[name]
    record.__post_init__()
    assert "__post_init__" not in vars(record)
    assert same(pickle.loads(pickle.dumps(record)), record)


def test_records_of_users_are_checked() -> None:
    wrong = {"u": np.full((3, 1), np.nan)}
    made = trusted(se.Plan, **{**vars(EXACT), **wrong})
    with pytest.raises(StochensError, match="`u"):
        made.__post_init__()
    with pytest.raises(StochensError, match="`u"):
        pickle.loads(pickle.dumps(made))
    with pytest.raises(StochensError, match="`u"):
        replace(EXACT, **wrong)


def test_the_pages_list_every_kind_of_file() -> None:
    page = (Path(__file__).parents[2] / "docs" / "systems.md").read_text()
    saving, formats = page.split("\n## State files\n")
    kinds = [one for one in fields.RECORDS.values() if issubclass(one, SavedRecord)]
    assert len(kinds) > 20
    for kind in kinds:
        assert f"`{kind._kind}`" in formats, kind
        assert re.search(rf"`(\w+\.)?{kind.__name__}`", saving), kind


def test_all_declared_types_can_be_read() -> None:
    """Every field of every listed class is of a type that `fields` knows."""
    assert len(fields.RECORDS) > 30
    assert not {"Estimate", "Identified", "Record", "SavedRecord"} & set(fields.RECORDS)
    for name, record in fields.RECORDS.items():
        assert record.__module__.startswith("stochens_rs.")
        for field, kind in fields.declared(record).items():
            for one in fields.kinds(kind):
                known = (
                    one in (Any, bool, int, float, str, bytes, type(None))
                    or fields.RECORDS.get(getattr(one, "__name__", "")) is one
                    or get_origin(one) in (Literal, tuple, dict, np.ndarray)
                    or one is se.identification.identified.Identified
                )
                assert known, (name, field, one)


def test_what_is_not_of_the_package_is_refused(tmp_path: Path) -> None:
    class Plan(se.Plan):
        """A class of a user with a name of the package."""

    assert fields.RECORDS["Plan"] is se.Plan
    own = Plan(EXACT.u, EXACT.predicted_states, EXACT.reachability, "product", "completed")
    with pytest.raises(InputTypeError, match="cannot be saved"):
        own.save(tmp_path / "own")
    for wrong in (object(), 1j, {1: 2}, {1, 2}, np.array(["a"]), np.datetime64("now"), 2**70):
        plan = replace(EXACT, info={"mine": wrong})
        for call in (plan.to_dict, lambda plan=plan: plan.save(tmp_path / "wrong")):
            with pytest.raises(InputTypeError, match=r"`info.0` "):
                call()
    assert not (tmp_path / "wrong").exists()


@pytest.mark.parametrize("ending", [".csv", ".JSON", ".png"])
def test_a_state_file_has_no_ending_of_a_table_or_figure(ending, tmp_path):
    plan = se.control(([[0.5]], [[1.0]]), [1.0], [0.0])
    with pytest.raises(se.exceptions.InputError, match=rf"`path` must not end in {ending}"):
        plan.save(tmp_path / f"plan{ending}")
    assert list(tmp_path.iterdir()) == []
