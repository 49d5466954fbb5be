"""The column of this package."""

from __future__ import annotations

import pickle
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

import stochens_rs as se
from stochens_rs import _core, cli

from . import annotated, cell, has_wheels, is_typed, no

US = "stochens_rs"
DECLARED = "under the assumptions on noise and design that you declare"
A, B = np.array([[1.0, 0.1], [0.0, 0.95]]), np.array([[0.0], [0.1]])
START, REST = [1.0, 0.0], [0.0, 0.0]


def measured(N: int = 40) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measured pairs of the cart, with noise of 0.01."""
    rng = np.random.default_rng(1)
    x, u = rng.standard_normal((N, 2)), rng.standard_normal((N, 1))
    return x, u, x @ A.T + u @ B.T + 0.01 * rng.standard_normal((N, 2))


def identified() -> se.Model:
    """Return the model of the measured pairs."""
    return se.identify(se.Trajectories.from_pairs(*measured()), sigma=0.01)


@cell(US, "model", "yes")
def _model():
    assert np.linalg.norm(identified().A - A) < 0.02


@cell(US, "region", "yes", DECLARED)
def _region():
    region = identified().region(0.05)
    assert region.contains(A, B)
    assert not region.contains(2 * A, B)


no(US, "posterior", r"posterior|nuts|mcmc|hamiltonian")


@cell(US, "fused", "yes", "models that were fixed before the data")
def _fused():
    models = se.SystemEnsemble(np.array([A, A + 0.2, A - 0.2]), np.array([B] * 3))
    data = se.Trajectories.from_pairs(*measured())
    fused = se.fuse(models, "alse", data=data, design="independent", sigma=0.01)
    assert np.linalg.norm(fused.A - A) < 0.02
    assert fused.region(0.05).contains(A, B)


@cell(US, "update", "yes")
def _update():
    stream = se.ModelStream(2, 1, sigma=0.01)
    for x, u, following in zip(*measured(), strict=True):
        stream.update(x, u, following)
    assert np.allclose(stream.model.A, identified().A)


@cell(US, "stop", "yes", DECLARED)
def _stop():
    stream = se.ModelStream(2, 1, sigma=0.01)
    for x, u, following in zip(*measured(400), strict=True):
        stream.update(x, u, following)
        look = stream.look(START, REST, steps=5, tol=0.2)
        if look.stop:
            break
    assert 1 < look.size < 400
    assert look.certificate <= 0.2


no(US, "filter", r"kalman|smoother|observer|lqe")


def _plan() -> se.controls.Plan:
    return se.control((A, B), START, REST, steps=20, limits=(-1.0, 1.0), cost=se.Cost(Q=1.0, R=0.1))


@cell(US, "limits", "yes")
def _limits():
    assert abs(_plan().u).max() == 1.0


def called() -> se.Regulator:
    """Return a feedback that was called once."""
    loop = se.regulate((A, B), 10, limits=(-1.0, 1.0), cost=se.Cost(Q=1.0, R=0.1))
    assert loop(START) == -1.0
    return loop


cell(US, "feedback", "yes")(called)


@cell(US, "log", "yes")
def _log():
    (call,) = called().log
    assert call.seconds > 0.0
    assert call.status == "optimal"


@cell(US, "gap", "yes")
def _gap():
    assert 0.0 <= _plan().gap < 1e-9


@cell(US, "tube", "yes", DECLARED)
def _tube():
    found = se.control(identified(), START, REST, steps=5)
    off = np.linalg.norm(found.states((A, B), START) - found.predicted_states, axis=1)
    assert (off <= found.bound(0.05).tube).all()


@cell(US, "fleet", "yes", "of units drawn independently from the same law")
def _fleet():
    rng = np.random.default_rng(2)
    units = A + 0.01 * rng.standard_normal((400, 2, 2))
    design = se.SystemEnsemble(units[:200], np.array([B] * 200))
    found = se.control_fleet(design, START, REST, 10, limits=(-5.0, 5.0), risk="worst")
    fresh = se.SystemEnsemble(units[200:], np.array([B] * 200))
    assert 0.0 < found.validate(fresh, 1e-3).epsilon < 0.2


no(US, "gains", r"lqr|riccati|pole|acker")
no(US, "robust", r"hinf|h2syn|h_inf")


@cell(US, "convex", "partly", "quadratic costs; limits on inputs, their rates and states")
def _convex():
    limited = se.control(
        (A, B),
        START,
        REST,
        steps=20,
        limits=se.Limits(u=(-1.0, 1.0), rate=0.2, previous=[0.0], x=(-2.0, 2.0)),
    )
    assert abs(np.diff(limited.u[:, 0])).max() < 0.2 + 1e-6


no(US, "integers", r"integer|boolean|binary")


@cell(US, "discrete", "partly", "zero-order hold only")
def _discrete():
    import control

    system = se.System.from_any(
        control.ss([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], np.eye(2), 0), dt=0.1
    )
    assert np.allclose(system.B[:, 0], [0.005, 0.1])


no(US, "continuous", r"continuous|solve_ivp|odeint")


@cell(
    US,
    "transfer",
    "partly",
    "transfer functions of python-control and SciPy are read and brought into state space; "
    "their outputs are left out",
)
def _transfer():
    import control

    system = se.System.from_any(control.tf([1.0], [1.0, 2.0, 1.0]), dt=0.1)
    assert (system.n, system.m) == (2, 1)
    assert not hasattr(system, "C")


# The names are about the nominal frequency of a power grid.
no(US, "frequency", r"bode|nyquist|locus|frequency|margin", but=("frequency", "checked_frequency"))
no(US, "nonlinear", r"nonlinear|nlsys")


@cell(US, "random", "yes")
def _random():
    cloud = se.simulate_ensemble((A, B), START, np.zeros((5, 1)), 1000, rng=1)
    assert np.isfinite(cloud.mean).all()


@cell(US, "sparse", "no")
def _sparse():
    from scipy.sparse import csr_matrix

    try:
        se.System(csr_matrix(A), B)
    except se.exceptions.InputTypeError:
        return
    raise AssertionError("a sparse matrix was taken")


@cell(US, "draws", "yes")
def _draws():
    one, threads = [], se.get_num_threads()
    for count in (1, 2):
        se.set_num_threads(count)
        one.append(se.sample(A, 5000, rng=1).mean())
    se.set_num_threads(threads)
    assert np.array_equal(*one)


def _error(key: se.Key, size: int) -> dict[str, float]:
    return {"error": float(np.linalg.norm(se.sample(A, size, rng=key).mean() - A))}


def _study() -> se.Study:
    return se.Study(_error, {"size": [10, 100]}, replicates=5, rng=1)


@cell(US, "studies", "yes")
def _studies():
    with ThreadPoolExecutor(2) as threads:
        assert _study().run(threads).digest == _study().run().digest


@cell(US, "killed", "yes", "with one version on one platform")
def _killed():
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stream.state"
        stream = se.Stream((A, B), START, REST, rng=1)
        stream.step(100)
        stream.save(path)
        again = se.Stream.load(path)
    stream.step(100)
    again.step(100)
    assert np.array_equal(stream.u, again.u)


@cell(US, "partial", "yes")
def _partial():
    def stopped(key, size):
        if size == 100:
            raise KeyboardInterrupt
        return _error(key, size)

    seen = []
    results = se.Study(stopped, {"size": [10, 100]}, replicates=5, rng=1).run(
        progress=lambda *done: seen.append(done)
    )
    assert results.status == "interrupted"
    assert np.isfinite(results.values["error"][0]).any()
    assert seen


@cell(US, "pickle", "yes")
def _pickle():
    assert pickle.loads(pickle.dumps(se.System(A, B))) == se.System(A, B)
    assert np.array_equal(pickle.loads(pickle.dumps(_plan())).u, _plan().u)
    loop = pickle.loads(pickle.dumps(called()))
    assert loop(START) == -1.0


def _named() -> se.System:
    units = {"position": "m"}
    return se.System(A, B, dt=0.1, states=["position", "speed"], inputs=["force"], units=units)


@cell(US, "names", "yes")
def _names():
    assert se.control(_named(), START, REST, steps=3).labels.inputs == ("force",)


@cell(US, "matched", "yes")
def _matched():
    import pandas as pd

    shuffled = pd.Series({"speed": 0.0, "position": 1.0})
    same = se.control(_named(), START, REST, steps=3).u
    assert np.array_equal(se.control(_named(), shuffled, REST, steps=3).u, same)
    try:
        se.control(_named(), shuffled.rename({"speed": "v"}), REST, steps=3)
    except se.exceptions.InputError:
        return
    raise AssertionError("other names were taken")


@cell(US, "units", "partly", "texts in tables, data sets and figures; nothing is converted")
def _units():
    assert se.control(_named(), START, REST, steps=3).labels.state_axes[0] == "position [m]"


@cell(US, "tables", "yes")
def _tables():
    run = se.simulate(_named(), START, np.zeros((3, 1)))
    assert list(run.to_pandas().columns) == ["position", "speed", "force"]
    assert run.to_xarray()["states"].dims == ("time", "state")


@cell(US, "types", "yes")
def _types():
    assert is_typed(US)
    assert annotated(US) > 0.95


@cell(US, "shell", "yes", "`stochens`")
def _shell():
    assert "identify" in cli.cli.commands


@cell(US, "wheels", "no", "not on the index; `make wheel` writes a wheel, which takes Rust")
def _wheels():
    assert has_wheels("cvxpy")  # the index answers
    assert not has_wheels(US)


@cell(US, "abi", "yes")
def _abi():
    assert ".abi3." in Path(_core.__file__).name or _core.__file__.endswith(".pyd")
