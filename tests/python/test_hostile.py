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
from zlib import crc32

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from stochens_rs._base.records import Record
from stochens_rs.exceptions import NonFiniteError, ResourceError, StochensError
from test_docs import PUBLIC
from test_records import PARTS, PLANS, trusted_records
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
    return se.identify(runs(), noise=se.Noise(design="independent"))


@cache
def to_improve():
    known = se.identify(runs(), checks=False, noise=se.Noise(sigma=1.0))
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
    return se.identify(se.Trajectories(x, u, outputs=True), window=se.Window(lags=1))


@cache
def read_gain():
    return se.gain(read_model(), 1.0, 1.0)


def reading_loop():
    made = se.regulate(read_gain(), offset_free=True)
    made([1.0, 0.0])
    return made


@cache
def proof():
    x, u, w = np.random.default_rng(1).standard_normal((3, 60, 2))
    data = se.Trajectories.from_pairs(x, u, x @ A.T + u @ B.T + 0.1 * w)
    return se.gain(se.identify(data, noise=se.Noise(sigma=0.1)), 1.0, 1.0).certificate()


def of_one_state():
    x, u, w = np.random.default_rng(1).standard_normal((3, 60, 1))
    data = se.Trajectories.from_pairs(x, u, 0.9 * x + u + 0.1 * w)
    return se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate()


TASK = loop()._task
LOG = Path(__file__).parents[2] / "docs" / "data" / "runs.csv"
TABLE = {"t": [0.0, 0.1, 0.2], "x": [1.0, 2.0, 3.0], "u": [1.0, 0.0, 0.0]}


def watched():
    watch = proof().watch()
    watch(X0, X0)
    return watch


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
    "A": A, "B": B, "M": A, "x0": X0, "xf": XF, "w": X0, "d": X0, "u": np.ones((1, 2)),
    "target": A, "reference": REFERENCE, "size": 5, "sizes": [2, 5], "steps": 3, "delta": 0.1,
    "error": 0.5, "weights": np.full(5, 0.2), "rng": 1, "n": 2, "m": 1, "threads": 1,
    "indices": [[0, 0], [1, 0]], "system": (A, B), "samples": np.ones((4, 2)),
    "bytes32": bytes(32), "digits": "0" * 64, "name": "x", "ensemble": ensemble,
    "path": "no/such/file.npz", "data": runs, "x": X0, "plan": to_improve, "runs": 2, "y": X0,
    "share": 0.5, "paths": [], "values": X0, "radius": 1.0, "model": model, "beta": 0.1,
    "epsilon": 0.5, "dimension": 2, "support": 1, "discarded": 1, "violations": 1,
    "systems": [(A, B), (A, B)], "other": lambda: MADE["Certificate"](),
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
    "control": {"x0": X0, "xf": XF},
    "regulate": {"steps": 3},
    "Regressors.loop": {"Theta": np.ones((2, 4))},
    "Regressors.state_of": {"outputs": np.ones((3, 2)), "inputs": np.ones((2, 2))},
    "ReadingLoop.swap": {"gain": read_gain()},
    "ReadingLoop.start": {"record": (np.ones((3, 2)), np.ones((2, 2)))},
    "Plan.error": {"xf": XF},
    "Results.save": {"path": "results.json"},
    "drawn_bound": {"quantity": "state", "size": 5, "data": [(A, B), X0, XF]},
    "Regressors.stretches": {"steps": 1},
    "predict": {"x0": X0, "inputs": np.ones((2, 2))},
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
    "from_systems": {"systems": [(A, B), (A, B)]},
    "identify": {"checks": False},
    "simulate_ensemble": {"size": 5},
    "track": {"controller": 5},
    "Regulator": {"task": TASK},
    "FleetPlan.validate": {"new_units": [(0.9 * A, B)]},
    "Region.bound": {"u": X0},
    "Region.contains": {"B": B},
    "Region.component_bounds": {"u": X0},
    "from_matpower": {"case": TWO_BUSES, "machines": MACHINES, "base": "system", "method": "zoh"},
    "ieee14": {"method": "zoh"},
    "swing": {"branches": [[1, 2, 0.1]], "machines": MACHINES, "base": "system", "method": "zoh"},
    "ieee39": {"method": "zoh"},
    "Stream.run": {"max_steps": 3},
    "Study.run": {"executor": None},
    "Study": {"function": drawn, "grid": {"a": [1, 2]}, "replicates": 2},
    "gain": {"Q": 1.0, "R": 1.0},
    "Loop.certificate": {"delta": 0.1},
    "LoopCertificate.of": {"region": None},
    "Watch.__call__": {"y": X0, "u": X0},
    "Model.accepts": {"runs": runs()},
    "Tube.settles": {"r": 0.1},
    "LoopCertificate.allows": {"on": "x[0]", "of": "x[0]"},
    "LoopCertificate.attracts": {"inputs": (-1.0, 1.0), "x0": X0},
    "LoopCertificate.rounding": {"x0": X0},
    "Misfit": {"on": "x[0]", "of": "x[0]", "at_most": 0.1},
    "LoopCertificate.holds": {"inputs": (-1.0, 1.0)},
    "LoopCertificate.tube": {"inputs": np.ones((2, 2))},
    "Regulator.__call__": {"x": X0},
    "design": {"limits": (-1.0, 1.0)},
    "Plan.validate": {"runs": np.ones((3, 2, 2))},
    "Regulator.validate": {"runs": np.ones((3, 2, 2))},
    "ReadingLoop.validate": {"runs": np.ones((3, 4, 2))},
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
    ("Key.child", "name"): {"text"},
    ("control", "limits"): {"object vector", "list of None"},
    ("ModelStream.look", "limits"): {"object vector", "list of None"},
    ("realization_controls", "limits"): {"object vector", "list of None"},
    ("steer", "limits"): {"object vector", "list of None"},
    ("regulate", "limits"): {"object vector", "list of None"},
    ("control_fleet", "limits"): {"object vector", "list of None"},
    ("Regulator.__call__", "x"): {"nan vector"},  # the last safe input is held
    ("LoopCertificate.of", "reason"): {"text"},
    ("Watch.__call__", "y"): {"nan vector"},  # a missing reading
    ("Watch.__call__", "u"): {"nan vector"},
    ("Watch.__call__", "applied"): {"nan vector"},
    ("ReadingLoop.__call__", "y"): {"nan vector"},
    ("ReadingLoop.__call__", "applied"): {"nan vector"},
    ("ReadingLoop.__call__", "target"): {"nan vector"},  # of an output that is free
    # numbers, which are checked where the problem is known
    **{("Limits", name): {"object vector", "ragged", "list of None"} for name in ("u", "x")},
    **{("Limits", name): {"deep", "dict", "list of None"} for name in ("rate", "previous")},
    ("Limits", "forecast"): {"dict"},
    **{("Cost", name): {"deep"} for name in ("Q", "Qf", "R", "reference")},
    ("Uncertain", "values"): {"deep"},
    # runs that diverged
    ("Plan.validate", "runs"): {"nan matrix"},
    ("Regulator.validate", "runs"): {"nan matrix"},
    ("ReadingLoop.validate", "runs"): {"nan matrix"},
    ("identify", "known"): {"list of None"},
    ("Stream.run", "checkpoint"): {"text"},
    ("Study", "function"): {"class"},
    ("Study", "version"): {"text"},
    ("Study.run", "path"): {"text"},
    ("Region.plot", "label"): {"text"},
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
    "Regressors": lambda: read_model().window,
    "Certificate": lambda: se.control(model(), X0, XF).bound(),
    "Loop": lambda: se.gain(model(), 1.0, 1.0),
    "LoopCertificate": proof,
    "Margins": lambda: of_one_state().margins(),
    "Tube": lambda: proof().tube(X0, 3),
    "Watch": watched,
    "Typical": lambda: se.control(model(), X0, XF).typical(),
    "NextRuns": lambda: se.design(to_improve(), 2, limits=(-1.0, 1.0)),
    "Validation": lambda: se.control((A, B), X0, XF).validate([se.System(A, B)] * 20),
    "Stream": lambda: se.Stream((A, B), X0, XF, rng=1),
    "Study": study,
    "Trajectory": lambda: se.simulate((A, B), X0, [[1.0, 0.0]]),
    "EnsembleTrajectory": lambda: se.simulate_ensemble((A, B), X0, [[1.0, 0.0]], 3, rng=1),
    "Results": lambda: study().run(),
}

OPTIONS = {"Limits", "Cost", "Uncertain", "Key"}  # records that users make
# made by functions
SEPARATE = {"Ensemble", "ReadingLoop", "Watch", "Kept", "WorstTime", "Call", "Reading"}
# programs, and what ends in files of Matplotlib
SEPARATE |= {"Plan.typical", "main", "save", "save_figures"}
STATEFUL = {"DataStream", "ModelStream", "Regulator", "ReadingLoop", "Stream", "Study"}
MADE = {n: make if n in STATEFUL else cache(make) for n, make in MADE.items()}


def targets():
    """How to get at every public callable with arguments, by its name, and the arguments."""
    found = {}
    for path, obj in PUBLIC.items():
        home, name = path.split(".")[-2:]
        if home[0].isupper() or (inspect.isclass(obj) and issubclass(obj, Exception)):
            continue  # a method, which its class has; an error
        if not dataclasses.is_dataclass(obj) or name in OPTIONS:
            found[name] = lambda obj=obj: obj
        for inner in dir(obj) if inspect.isclass(obj) else ():
            member = inspect.getattr_static(obj, inner)
            if inner.startswith("_") and inner != "__call__":
                continue
            if isinstance(member, (classmethod, staticmethod)):
                found[f"{name}.{inner}"] = lambda obj=obj, inner=inner: getattr(obj, inner)
            elif inspect.isfunction(member) and name in MADE:
                found[f"{name}.{inner}"] = lambda n=name, inner=inner: getattr(MADE[n](), inner)
    with_arguments = {}
    for label, get in found.items():
        parameters = inspect.signature(get()).parameters.values()
        if parameters and label not in SEPARATE:
            with_arguments[label] = (
                get,
                [p for p in parameters if p.name != "_" and p.kind is not p.VAR_KEYWORD],
            )
    return with_arguments


def missing(label, name):
    """What to do for a callable whose argument has no good value here."""
    return (
        f"no good value of `{name}` for {label}: add it to GOOD of {Path(__file__).name}, for this "
        f"callable alone to OWN[{label!r}], or, if it is made by a function, its name to SEPARATE"
    )


def call(label, function, parameters, tried=None, value=None):
    """Call with one bad argument."""
    name = label.rpartition(".")[2]
    own = OWN.get(label, OWN.get(name, {}))
    args, kwargs, skipped = [], {}, False
    for p in parameters:
        if p.name == tried:
            given = value
        elif p.name in own:
            given = own[p.name]
        elif p.default is not p.empty or p.kind is p.VAR_KEYWORD:
            skipped = True
            continue
        else:
            assert p.name in GOOD, missing(label, p.name)
            given = GOOD[p.name]
            given = given() if callable(given) else given
        if p.kind is p.VAR_KEYWORD:
            kwargs["a"] = given
        elif p.kind is p.VAR_POSITIONAL:
            args += [value, *OWN[label][p.name][1:]] if p.name == tried else given
        elif p.kind is p.KEYWORD_ONLY or (skipped and p.kind is p.POSITIONAL_OR_KEYWORD):
            kwargs[p.name] = given
        else:
            args.append(given)
    return function(*args, **kwargs)


SWEPT = targets()
RECORDS = {name: PLANS[name] for name in ("exact", "limits", "plan of a model")} | PARTS
RECORDS |= {name: make for name, make in MADE.items() if issubclass(type(make()), Record)}
RECORDS |= {name: lambda made=made: made for name, made in trusted_records().items()}
RECORDS = {n: make for n, make in RECORDS.items() if dataclasses.is_dataclass(make())}
WAYS = ("__repr__", "_repr_html_", "to_xarray", "to_dict")
SLOW = 10.0  # seconds of a call that hangs, on a busy machine


def outcome(work):
    """What is wrong with a call, and whether it was refused."""
    began = time.perf_counter()
    try:
        found = work()
    except StochensError as error:
        wrong = f"no short line: {error}" if "\n" in str(error) or len(str(error)) > 300 else ""
        return wrong, True, None
    except (FileNotFoundError, IsADirectoryError, KeyboardInterrupt) as error:
        return f"{type(error).__name__}: {error}" * (not error.filename), True, None
    except Exception as error:
        return f"{type(error).__name__}: {error}", True, None
    took = time.perf_counter() - began
    wrong = f"{took:.1f} s" if took > SLOW else "nan" if has_nan(found) else ""
    return wrong, False, found


def has_nan(found):
    if isinstance(found, (float, np.ndarray)):
        return np.asarray(found).dtype.kind == "f" and bool(np.isnan(found).any())
    if isinstance(found, tuple):
        return any(has_nan(one) for one in found)
    return dataclasses.is_dataclass(found) and any(
        has_nan(getattr(found, one.name))
        for one in dataclasses.fields(found)
        if one.name != "known"  # nan for what is estimated
    )


def tried(*place):
    """What is given in one place: all of it, in `make test` what is never right and a fifth."""
    perhaps, first = list(PERHAPS.items()), crc32(repr(place).encode()) % 5
    return (NEVER | dict(perhaps if sets(1, 0) else perhaps[first::5])).items()


@pytest.mark.parametrize("label", SWEPT)
def test_no_argument_lets_a_foreign_exception_out(label, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    get, parameters = SWEPT[label]
    function = get()
    said, refused, _ = outcome(lambda: call(label, function, parameters))
    files = {p.name for p in parameters} & {"path", "paths", "data", "digits"}
    wrong = ["good arguments"] if refused and not files else []
    for p in parameters:
        for what, value in tried(label, p.name):
            if p.name in ("progress", "controller") and what in CALLED:
                continue
            if not refused:  # a refused call leaves everything as it was
                function = get()
            said, refused, _ = outcome(lambda: call(label, function, parameters, p.name, value))  # noqa: B023
            taken = what in PERHAPS or what in TAKEN.get((label, p.name), ())
            free = what == "text" and p.name == "path"
            if not said and what in NEVER and refused == taken and not free:
                said = "refused" if refused else "accepted"
            if said:
                wrong.append(f"{p.name} = {what}: {said}"[:160])
    se.set_num_threads(None)
    assert not wrong, "\n".join(["", *wrong])


def test_a_callable_without_good_arguments_says_what_to_do():
    def new(surprise):
        return surprise

    with pytest.raises(
        AssertionError, match=r"no good value of `surprise` for new: add it to GOOD"
    ):
        call("new", new, list(inspect.signature(new).parameters.values()))


@pytest.mark.parametrize("name", RECORDS)
def test_no_field_of_a_record_lets_one_out(name):
    """By the constructor, which pickles and files call too; what it takes is shown."""
    made = RECORDS[name]()
    for way in WAYS:  # imports at the first use take their time
        getattr(made, way, str)()
    fields = [one for one in dataclasses.fields(made) if one.init]
    wrong, count = [], 0
    for one in fields:
        for what, value in tried(name, one.name):
            work = lambda: dataclasses.replace(made, **{one.name: value})  # noqa: B023, E731
            said, refused, found = outcome(work)
            count += refused
            if said == "nan" and isinstance(value, np.ndarray):
                said = ""  # runs diverge
            for way in WAYS if found is not None and not said else ():
                said = said or outcome(getattr(found, way, str))[0]
            if said:
                wrong.append(f"{one.name} = {what}: {said}"[:160])
    assert not wrong, "\n".join(["", *wrong])
    assert count > 30 * len(fields)


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
