"""Every argument of every public callable with unsuitable values.

Whatever is given, nothing but an exception of this package comes out, and its message is one short
line. The callables are found by walking the package: a new one is swept without being named here.
"""

from __future__ import annotations

import dataclasses
import datetime
import inspect
import time
from decimal import Decimal
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.exceptions import InputTypeError, NonFiniteError, ResourceError, StochensError
from test_docs import PUBLIC, unwrap
from test_validation import Stubborn

nan, inf = float("nan"), float("inf")


class Refuses:
    """An object that raises its own exception for every operation."""

    def _no(self, *_):
        raise RuntimeError("no answer")

    __index__ = __int__ = __float__ = __bool__ = __len__ = __iter__ = __fspath__ = __array__ = _no
    __eq__ = __lt__ = __gt__ = __str__ = __repr__ = _no
    __hash__ = None
    A = B = to_ss = property(_no)


def generator():
    yield "x"


# No argument of any callable stands for one of these.
NEVER = {
    "timedelta64": np.timedelta64(3, "s"),
    "timedelta64 without unit": np.timedelta64(3),
    "datetime64": np.datetime64("2020-01-01"),
    "timedelta": datetime.timedelta(seconds=3),
    "timedelta64 array": np.array([1, 1], "m8[s]"),
    "timedelta64 matrix": np.ones((2, 2), "m8[s]"),
    "timedelta64 0-d": np.array(3, "m8[s]"),
    "set": {1, 2},
    "frozenset": frozenset({1, 2}),
    "dict": {"a": 1, "b": 2},
    "complex": 1j,
    "complex vector": np.ones(2, complex),
    "complex matrix": np.ones((2, 2), complex),
    "object vector": np.array([1, None], object),
    "object matrix": np.array([[1, 2], [3, 4]], object),
    "masked vector": np.ma.masked_array([1.0, 2.0], [False, True]),
    "masked matrix": np.ma.masked_array(np.eye(2), np.eye(2) > 0.0),
    "masked integers": np.ma.masked_array([0, 1], [True, False]),
    "structured": np.zeros(2, [("a", float)]),
    "mask": np.array([True, False]),
    "mask matrix": np.eye(2) > 0.0,
    "list of bool": [True, False],
    "nan": nan,
    "nan vector": np.array([nan, 1.0]),
    "nan matrix": np.array([[nan, 1.0], [0.0, 1.0]]),
    "bytes": b"x",
    "Decimal": Decimal(1),
    "text": "no such word",
    "text array": np.array(["a", "b"]),
    "lone surrogate": "\ud800",
    "ragged": [[1.0], [1.0, 2.0]],
    "deep": np.ones((1,) * 32),
    "object": object(),
    "refusing object": Refuses(),
    "refusing array": Stubborn(),
    "list of refusing objects": [Refuses(), Refuses()],
    "class": int,
    "list of None": [None, None],
}
# An argument may stand for one of these, or not.
PERHAPS = {
    "None": None,
    "True": True,
    "zero": 0,
    "minus one": -1,
    "half": 0.5,
    "inf": inf,
    "huge": 10**400,
    "huge negative": -(10**5000),
    "large float": 1e300,
    "small float": 5e-324,
    "large vector": np.full(2, 1.7e308),
    "large matrix": np.full((2, 2), 1.7e308),
    "small vector": np.full(2, 5e-324),
    "small matrix": np.full((2, 2), 5e-324),
    "zero vector": np.zeros(2),
    "zero matrix": np.zeros((2, 2)),
    "empty list": [],
    "empty dict": {},
    "empty tuple": (),
    "empty text": "",
    "no entries": np.ones(0),
    "no rows": np.ones((0, 2)),
    "too long": np.ones(7),
    "too large": np.ones((3, 3)),
    "one entry": np.ones(1),
    "three items": (1, 2, 3),
    "list of huge": [10**400, 1],
    "function": generator,
    "ensemble": se.sample([1.0, 2.0], 5, rng=1),
    "matrix ensemble": se.sample(np.eye(2), 5, rng=1),
    "larger ensemble": se.sample(np.eye(3), 4, rng=1),
    "counts": se.sample_counts([1.0, 2.0], 5, rng=1),
    "fit": se.fuse(se.sample([1.0, 2.0], 5, rng=1)),
    "system": se.System(np.eye(2), np.eye(2)),
    "larger system": se.System(np.eye(3), np.eye(3)),
    "plan": se.control((np.eye(2), np.eye(2)), [1.0, 2.0], [0.0, 0.0]),
    "key": se.Key(bytes(32)),
    "generator of random numbers": np.random.default_rng(1),
    "range": range(5),
    "memoryview": memoryview(b"ab"),
    "lists": [[1.0, 0.0], [0.0, 1.0]],
    "integers": np.array([0, 1], np.int8),
    "unsigned": np.array([2**64 - 1, 0], np.uint64),
    "float16": np.ones(2, np.float16),
    "big-endian": np.ones(2, ">f8"),
    "0-d": np.array(2.0),
}

A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[1.0, 0.0], [0.5, 1.0]])
X0, XF = np.array([1.0, 2.0]), np.array([0.5, 0.0])
REFERENCE = np.outer(np.cos(0.3 * np.arange(4)), [1.0, 2.0])


@cache
def ensemble():
    return se.sample(A, 5, rng=1)


@cache
def runs():
    draws = np.random.default_rng(1).standard_normal((12, 6))
    return se.Trajectories.from_pairs(draws[:, :2], draws[:, 2:4], draws[:, 4:])


@cache
def model():
    return se.identify(runs(), design="independent")


@cache
def to_improve():
    known = se.identify(runs(), sigma=1.0, checks=False)
    return se.control(known, X0, XF, steps=2)


@cache
def fused_model():
    return se.fuse([(A, B), (0.5 * A, B)], "alse", data=model())


def drawn(key, a):
    return {"x": a * key.generator().normal()}


def study():
    return se.Study(drawn, {"a": [1, 2]}, replicates=2, rng=1)


def loop():
    made = se.regulate((A, B), 3, limits=(-1.0, 1.0))
    made(X0)
    return made


@cache
def read_model():
    gen = np.random.default_rng(1)
    u, x = gen.standard_normal((400, 2)), np.zeros((401, 2))
    for k in range(400):
        x[k + 1] = A @ x[k] + B @ u[k] + 0.01 * gen.standard_normal(2)
    return se.identify(se.Trajectories(x, u, outputs=True), lags=1)


def reading_loop():
    made = se.regulate(se.gain(read_model(), 1.0, 1.0), offset_free=True)
    made([1.0, 0.0])
    return made


def proof():
    x, u = np.random.default_rng(1).standard_normal((2, 60, 2))
    y = (
        x @ np.array(A).T
        + u @ np.array(B).T
        + 0.1 * np.random.default_rng(2).standard_normal((60, 2))
    )
    data = se.Trajectories.from_pairs(x, u, y)
    return se.gain(se.identify(data, sigma=0.1), 1.0, 1.0).certificate()


TASK = loop()._task
LOG = Path(__file__).parents[2] / "docs" / "data" / "runs.csv"
TABLE = {"t": [0.0, 0.1, 0.2], "x": [1.0, 2.0, 3.0], "u": [1.0, 0.0, 0.0]}


def model_stream():
    draws = np.random.default_rng(1).standard_normal((12, 6))
    stream = se.ModelStream(2, 2)
    stream.update(draws[:, :2], draws[:, 2:4], draws[:, 4:])
    return stream


def data_stream():
    stream = se.DataStream(B, ranges=dict.fromkeys(("x0", "xf", "A"), 0.0))
    stream.update(x0=X0, xf=XF, A=A)
    return stream


# What each argument is when it is not the one that is tried, by its name.
GOOD = {
    "A": A, "A_hat": A, "B": B, "M": A, "x0": X0, "x0_hat": X0, "xf": XF, "w": X0, "d": X0,
    "u": np.ones((1, 2)), "target": A, "reference": REFERENCE, "size": 5, "sizes": [2, 5],
    "steps": 3, "delta": 0.1, "eps": 0.5, "error": 0.5, "weights": np.full(5, 0.2), "rng": 1,
    "n": 2, "m": 1, "count": 2, "threads": 1, "indices": [[0, 0], [1, 0]],
    "system": (A, B), "samples": np.ones((4, 2)), "bytes32": bytes(32), "digits": "0" * 64,
    "name": "x", "ensemble": ensemble, "quantity": "state", "method": "uniform",
    "path": "no/such/file.npz", "data": runs, "x": X0, "lags": 1,
    "share": 0.5, "open_loop": True, "model": model, "beta": 0.1, "epsilon": 0.5, "dimension": 2,
    "support": 1, "discarded": 1, "violations": 1, "systems": [(A, B), (A, B)],
    "new_units": [(A, B)], "other": lambda: MADE["Certificate"](),
}  # fmt: skip
# The same where the name alone does not say it, and arguments that keep a call short.
TWO_BUSES = {
    "baseMVA": 100.0,
    "bus": [[1, 3, 0, 0, 0, 0, 1, 1.0, 0.0], [2, 2, 0, 0, 0, 0, 1, 1.0, 0.0]],
    "gen": [[1, 0, 0, 0, 0, 1, 100, 1], [2, 0, 0, 0, 0, 1, 100, 1]],
    "branch": [[1, 2, 0, 0.5, 0, 0, 0, 0, 0, 0, 1]],
}
MACHINES = {"bus": [1, 2], "H": [4.0, 5.0], "D": [2.0, 0.0], "xd1": [0.3, 0.2]}
OWN = {
    "best": {"size": 5, "data": [(A, B), X0, XF]},
    "candidates": {"data": [(A, B), X0, XF]},
    "control": {"x0": X0, "xf": XF},
    "regulate": {"steps": 3},
    "Ensemble.from_bytes": {
        "data": se.sample(A, 5, rng=1).to_bytes(),
        "shape": (2, 2),
        "norm": np.abs(A).sum(axis=0),
        "size": 5,
    },
    "Window.loop": {"Theta": np.ones((2, 4))},
    "Window.state_of": {"outputs": np.ones((3, 2)), "inputs": np.ones((2, 2))},
    "ReadingLoop.start": {"record": (np.ones((3, 2)), np.ones((2, 2)))},
    "Plan.error": {"xf": XF},
    "Results.save": {"path": "results.json"},
    "bound": {"name": "simulated", "data": [(A, B), X0, XF]},
    "Window.stretches": {"steps": 1},
    "predict": {"x0": X0, "inputs": np.ones((2, 2))},
    "coverage": {"noise": 0.1},
    "fleet": {"units": [(A, B), (A, B)]},
    "fuse": {"method": "alse", "target": A},
    "fuse_path": {"method": "alse"},
    "from_indices": {"target": A},
    "DataStream.update": {"A": A},
    "ModelStream": {"m": 2},
    "ModelStream.update": {"x": X0, "u": X0, "x_next": X0},
    "ModelStream.look": {"tol": 1.0, "x0": X0, "xf": XF, "steps": 1},
    "Trajectories": {"states": np.ones((3, 2)), "inputs": np.ones((2, 2))},
    "from_pairs": {"x": np.ones((3, 2)), "u": np.ones((3, 1)), "x_next": np.ones((3, 2))},
    "from_table": {"table": TABLE, "states": ["x"], "inputs": ["u"]},
    "from_csv": {"source": LOG, "states": ["position"], "inputs": ["force"]},
    "Trajectories.k_step": {"steps": 1},
    "from_systems": {"systems": [(A, B), (A, B)]},
    "identify": {"checks": False},
    "simulate_ensemble": {"size": 5},
    "track": {"size": 5},
    "Regulator": {"task": TASK},
    "FleetPlan.validate": {"new_units": [(0.9 * A, B)]},
    "Region.bound": {"u": X0},
    "Region.contains": {"B": B},
    "Region.component_bounds": {"u": X0},
    "approximately": {"sizes": (2, 5)},
    "required_samples": {"runs": 5},
    "power": {"replicates": 1, "samples": 5, "sizes": None, "method": "zoh"},
    "tracking": {"replicates": 1, "samples": 5, "sizes": None, "n": 2, "m": 1},
    "from_matpower": {"case": TWO_BUSES, "machines": MACHINES, "base": "system", "method": "zoh"},
    "ieee14": {"method": "zoh"},
    "swing": {"branches": [[1, 2, 0.1]], "machines": MACHINES, "base": "system", "method": "zoh"},
    "ieee39": {"method": "zoh"},
    "tracking_moments": {"feedback": False},
    "tracking_rms": {"feedback": False},
    "Stream.run": {"max_steps": 3},
    "Study.run": {"executor": None},
    "Study.retry": {"executor": None},
    "Study": {"function": drawn, "grid": {"a": [1, 2]}, "replicates": 2},
    "panel": {"name": "3a"},
    "Experiment.panel": {"name": "3a"},
    "gain": {"Q": 1.0, "R": 1.0},
    "Loop.certificate": {"delta": 0.1},
    "Tube.settles": {"r": 0.1},
    "LoopCertificate.holds": {"inputs": (-1.0, 1.0)},
    "LoopCertificate.tube": {"inputs": np.ones((2, 2))},
    "Plan.validate": {"runs": np.ones((3, 2, 2))},
    "Regulator.validate": {"runs": np.ones((3, 2, 2))},
    "Plan.plot_phase": {"across": 0, "up": 1},
    "Trajectory.plot_phase": {"across": 0, "up": 1},
    "EnsembleTrajectory.plot_phase": {"across": 0, "up": 1},
}
# Arguments that do take one of the values of NEVER.
TAKEN = {
    ("System", "name"): {"text"},
    ("System", "states"): {"text array"},
    ("System", "inputs"): {"text array"},
    ("swing", "name"): {"text"},
    ("Trajectories", "state_names"): {"text array"},
    ("Trajectories", "input_names"): {"text array"},
    ("ModelStream", "state_names"): {"text array"},
    ("ModelStream", "input_names"): {"text array"},
    ("Trajectories.from_pairs", "state_names"): {"text array"},
    ("identify", "known_A"): {"nan matrix"},
    ("identify", "known_B"): {"nan matrix"},
    ("Key.child", "name"): {"text"},
    ("control", "limits"): {"object vector", "list of None"},
    ("ModelStream.look", "limits"): {"object vector", "list of None"},
    ("realization_controls", "limits"): {"object vector", "list of None"},
    ("steer", "limits"): {"object vector", "list of None"},
    ("regulate", "limits"): {"object vector", "list of None"},
    ("control_fleet", "limits"): {"object vector", "list of None"},
    # runs that diverged
    ("Plan.validate", "runs"): {"nan matrix"},
    ("Regulator.validate", "runs"): {"nan matrix"},
    ("Stream.run", "checkpoint"): {"text"},
    ("Study", "function"): {"class"},
    ("closed_loop", "limits"): {"object vector", "list of None"},
    ("fleet", "limits"): {"object vector", "list of None"},
    ("sampling_coverage", "limits"): {"object vector", "list of None"},
    ("power", "path"): {"text"},
    ("tracking", "path"): {"text"},
    ("Study.run", "path"): {"text"},
    ("Region.plot", "label"): {"text"},
    ("Study.retry", "path"): {"text"},
}
CALLED = {"class", "function"}  # what `progress` does is its own affair
MADE = {
    "DataStream": data_stream,
    "ModelStream": model_stream,
    "Snapshot": lambda: model_stream().model,
    "Ensemble": ensemble,
    "Key": lambda: se.Key(bytes(32)),
    "Trajectories": runs,
    "Model": model,
    "FusedModel": fused_model,
    "Region": lambda: model().region(),
    "Checks": lambda: model().checks,
    "FleetPlan": lambda: se.control_fleet([(A, B), (-A, B)], X0, XF, 2, risk="worst"),
    "Plan": lambda: se.control((ensemble(), B), se.sample(X0, 5, rng=2), XF),
    "Regulator": loop,
    "ReadingLoop": reading_loop,
    "Window": lambda: read_model().window,
    "Certificate": lambda: se.control(model(), X0, XF).bound(),
    "Loop": lambda: se.gain(model(), 1.0, 1.0),
    "LoopCertificate": proof,
    "Tube": lambda: proof().tube(X0, 3),
    "Typical": lambda: se.control(model(), X0, XF).typical(),
    "NextRuns": lambda: se.design(to_improve(), 2, limits=(-1.0, 1.0)),
    "Validation": lambda: se.control((A, B), X0, XF).validate([se.System(A, B)] * 20),
    "Stream": lambda: se.Stream((A, B), X0, XF, rng=1),
    "Study": study,
    "Bound": lambda: se.theory.bounds.bound("McDiarmid", "state", (A, B), X0, XF),
    "Simulated": lambda: se.theory.bounds.bound("simulated", "vector", X0),
    "Trajectory": lambda: se.simulate((A, B), X0, [[1.0, 0.0]]),
    "EnsembleTrajectory": lambda: se.simulate_ensemble((A, B), X0, [[1.0, 0.0]], 3, rng=1),
    "Results": lambda: study().run(),
}


def swept():
    """Name, callable and parameters of every public callable with arguments from users."""
    found = {}
    for name, obj in PUBLIC.items():
        plain = unwrap(obj)
        parts = name.removeprefix("stochens_rs.").split(".")
        if (
            isinstance(obj, property)
            or SEPARATE & {parts[0], ".".join(parts[:2])}
            or is_record(plain)
        ):
            continue
        if inspect.isclass(plain) and issubclass(plain, BaseException):
            continue
        owner = parts[-2] if parts[-2][0].isupper() else None
        label = f"{owner}.{parts[-1]}" if owner else parts[-1]
        parameters = {
            p.name: p
            for p in inspect.signature(plain).parameters.values()
            if p.name not in ("self", "cls", "ax") and p.name != "_"
        }
        if parameters and label not in SEPARATE:
            found[label] = (name, obj, owner, parameters)
    return found


# Not swept: programs, pictures, long runs, abstract classes, and what the next tests try.
SEPARATE = {"cli", "plots", "Ensemble"}
SEPARATE |= {"Bound", "Simulated", "Results.select", "Results.plot"}
SEPARATE |= {"Study.resume", "Study.merge", "Plan.typical", "design"}
SEPARATE |= {"Kept", "ReadingLoop"}  # made by `regulate`, which checks
SEPARATE |= {
    f"{kind}.{name}"
    for kind in ("Stream", "DataStream", "ModelStream")
    for name in ("save", "load")
}


def is_record(obj):
    return dataclasses.is_dataclass(obj) and obj is not se.Key


def call(label, parameters, obj, owner, tried, value):
    """Call with one bad argument."""
    own = OWN.get(label, OWN.get(label.rpartition(".")[2], {}))
    args, kwargs = [], {}
    for p in parameters.values():
        if p.name == tried:
            given = value
        elif p.name in own:
            given = own[p.name]
        elif p.default is not p.empty:
            continue
        else:
            given = GOOD[p.name]
            given = given() if callable(given) else given
        if p.kind is p.VAR_POSITIONAL:
            args += [value, *OWN[label][p.name][1:]] if p.name == tried else given
        elif p.kind is p.KEYWORD_ONLY:
            kwargs[p.name] = given
        else:
            args.append(given)
    function = obj
    if isinstance(obj, classmethod):
        function = getattr(getattr(se, owner), obj.__func__.__name__)
    elif owner is not None:
        function = getattr(MADE[owner](), obj.__name__)
    return function(*args, **kwargs)


SWEPT = swept()


@pytest.mark.parametrize("label", SWEPT)
def test_good_arguments_pass(label, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, obj, owner, parameters = SWEPT[label]
    if label == "from_file":
        A, B = np.array([[0.9, 0.2], [0.0, 0.8]]), np.array([[0.0], [1.0]])
        np.savez(tmp_path / "problem.npz", A=A, B=B)
        monkeypatch.setitem(GOOD, "path", tmp_path / "problem.npz")
        found = call(label, parameters, obj, owner, None, None)
        assert (found.system.A == A).all()
        assert (found.system.B == B).all()
        assert found.x0 is found.xf is None
        return
    if label == "read_matpower":
        path = tmp_path / "two.m"
        tables = ["mpc.baseMVA = 100"]
        for name in ("bus", "gen", "branch"):
            rows = ";\n".join(" ".join(map(str, row)) for row in TWO_BUSES[name])
            tables.append(f"mpc.{name} = [\n{rows};\n]")
        path.write_text("function mpc = two\n" + ";\n".join([*tables, ""]))
        monkeypatch.setitem(GOOD, "path", path)
    call(label, parameters, obj, owner, None, None)


@pytest.mark.parametrize("label", SWEPT)
def test_no_argument_lets_a_foreign_exception_out(label, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, obj, owner, parameters = SWEPT[label]
    wrong = []
    for tried in parameters:
        for what, value in (NEVER | PERHAPS).items():
            if tried == "progress" and what in CALLED:
                continue
            taken = what in PERHAPS or what in TAKEN.get((label, tried), ())
            try:
                call(label, parameters, obj, owner, tried, value)
            except StochensError as error:
                if "\n" in str(error) or len(str(error)) > 300:
                    wrong.append(f"{tried} = {what}: no short line: {error}"[:160])
                if taken and what in NEVER:
                    wrong.append(f"{tried} = {what}: refused: {error}"[:160])
            except (FileNotFoundError, KeyboardInterrupt):
                if label not in ("from_file", "from_matpower", "swing", "Trajectories.from_csv"):
                    raise
            except Exception as error:
                wrong.append(f"{tried} = {what}: {type(error).__name__}: {error}"[:160])
            else:
                if not taken:
                    wrong.append(f"{tried} = {what}: accepted")
    se.set_num_threads(None)
    assert not wrong, "\n".join(["", *wrong])


TOLD_APART = {
    "Study.resume": se.Study.resume,
    "Study.resume, the grid": lambda value: se.Study.resume("no.study", None, value),
    "Study.merge": se.Study.merge,
    "Study.merge, a path": lambda value: se.Study.merge([value]),
    "Results.save": lambda value: study().run().save(value),
    "Results.select": lambda value: study().run().select(a=value),
    "Results.plot": lambda value: study().run().plot(value, "x"),
    "Results.plot, the number": lambda value: study().run().plot("a", value),
    "Results.plot, the lines": lambda value: study().run().plot("a", "x", value),
    "Stream.load": se.Stream.load,
    "Stream.save": lambda value: MADE["Stream"]().save(value),
    "DataStream.save": lambda value: se.DataStream(B).save(value),
    "ModelStream.save": lambda value: se.ModelStream(1, 1).save(value),
    "ModelStream.load": se.ModelStream.load,
    "a mask of indices": lambda value: se.Ensemble.from_indices(value, X0),
}


@pytest.mark.parametrize("label", TOLD_APART)
def test_what_is_not_swept_refuses_too(label, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for what, value in NEVER.items():
        if label.endswith(".save") and what == "text":
            continue
        with pytest.raises(StochensError):
            TOLD_APART[label](value)


NO_NUMBERS = {
    "Limits(u)": lambda bad: se.Limits(u=(bad, 1.0)),
    "Limits(u) by name": lambda bad: se.Limits(u={"force": (-1.0, bad)}),
    "Limits(x)": lambda bad: se.Limits(x=(0.0, bad)),
    "Limits(rate)": lambda bad: se.Limits(rate=bad),
    "Limits(previous)": lambda bad: se.Limits(previous=bad),
    "Cost(Q)": lambda bad: se.Cost(Q=bad),
    "Cost(Qf)": lambda bad: se.Cost(Qf=bad),
    "Cost(R)": lambda bad: se.Cost(R=bad),
    "Cost(reference)": lambda bad: se.Cost(reference=np.full((2, 2), bad)),
    "Uncertain(values)": lambda bad: se.Uncertain(bad, 1.0),
}


@pytest.mark.parametrize("label", NO_NUMBERS)
@pytest.mark.parametrize(
    "bad", [nan, [nan, 1.0], 10**400, [10**400, 1]], ids=["nan", "some nan", "huge", "some huge"]
)
def test_what_is_no_number_is_refused_where_it_is_given(label, bad):
    with pytest.raises(StochensError):
        NO_NUMBERS[label](bad)


HUGE = {
    "regulate": lambda: se.regulate((A, B), 10**11, limits=(-1.0, 1.0)),
    "control": lambda: se.control((A, B), X0, XF, steps=10**11, limits=(-1.0, 1.0)),
    "track": lambda: se.track((A, B), REFERENCE, controller=lambda x: x, runs=5 * 10**10),
    "design": lambda: se.design(to_improve(), 5 * 10**10, limits=(-1.0, 1.0)),
    "draw": lambda: model().draw(5 * 10**10),
}


@pytest.mark.parametrize("label", HUGE)
def test_what_no_memory_holds_is_refused_at_once(label):
    began = time.perf_counter()
    with pytest.raises(ResourceError, match="GiB may be used"):
        HUGE[label]()
    assert time.perf_counter() - began < 1.0


def test_no_tube_has_nan():
    with pytest.raises(NonFiniteError, match="lead beyond the largest number"):
        proof().tube([1.0, 1e308], 5)
    for tube in (proof().tube([1.0, 1e300], 5), proof().tube(X0, 5, start=1e308)):
        found = [tube.states, tube.inputs, tube.radii, tube.components, tube.later, tube.reach]
        assert not any(np.isnan(one).any() for one in found)
        assert np.isinf(tube.radii[1:]).all()


@pytest.mark.parametrize("field", ["type", "schema", "data", "delta"])
@pytest.mark.parametrize("bad", [np.ones(2), {"type": np.ones(2)}, np.array(["Model", "b"])])
def test_plain_data_with_arrays_in_the_place_of_words(field, bad):
    with pytest.raises(StochensError):
        se.Model.from_dict({**model().to_dict(), field: bad})


def test_a_class_is_no_controller():
    with pytest.raises(InputTypeError, match="`controller` must be a function"):
        se.track((A, B), REFERENCE, controller=int)
