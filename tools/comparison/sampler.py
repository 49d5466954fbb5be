"""The column of nutpie. A model is given by its log density, without PyMC or Stan."""

from __future__ import annotations

import pickle
from functools import partial
from importlib import metadata
from inspect import signature

import numpy as np

from . import annotated, cell, has_wheels, is_typed, no

IT = "nutpie"
SIGMA = 0.1
TRUE = np.array([0.9, 0.2])  # x(k+1) = 0.9 x(k) + 0.2 u(k)
Z = np.random.default_rng(1).standard_normal((60, 2))
Y = Z @ TRUE + SIGMA * np.random.default_rng(2).standard_normal(60)


def compiled(log_density, size=2, **options):
    """Return a model of `size` unknowns from a function for the log density and its gradient."""
    from nutpie.compiled_pyfunc import from_pyfunc

    kind, make = [np.dtype("float64")], partial(same, log_density)
    return from_pyfunc(size, make, expanded, kind, [(size,)], ["theta"], **options)


def same(function):
    """Return the function itself."""
    return function


def expanded(*_):
    """Return the function that names the unknowns of a draw."""
    return named


def named(theta):
    """Return a draw under its name."""
    return {"theta": np.asarray(theta)}


def likelihood(theta):
    """Return the log density of the measured pairs, and its gradient."""
    residual = (Y - Z @ theta) / SIGMA
    return -0.5 * residual @ residual, Z.T @ residual / SIGMA


def drawn(model, **options):
    """Return draws of the unknowns, shape (draws, size)."""
    import nutpie

    asked = {"draws": 300, "tune": 300, "chains": 2, "seed": 3, "progress_bar": False}
    found = nutpie.sample(model, **asked | options).posterior
    return found.theta.values.reshape(-1, found.theta.shape[-1])


@cell(IT, "model", "yes", "as a density that you write; the draws are models")
def _model():
    assert np.linalg.norm(drawn(compiled(likelihood)).mean(axis=0) - TRUE) < 0.1


@cell(
    IT,
    "region",
    "partly",
    "credible regions of the draws: they hold on average over the prior that you choose, and up to "
    "the error of the draws",
)
def _region():
    low, high = np.quantile(drawn(compiled(likelihood)), [0.005, 0.995], axis=0)
    assert ((low < TRUE) & (high > TRUE)).all()


@cell(IT, "posterior", "yes")
def _posterior():
    draws = drawn(compiled(lambda t: (-0.5 * t @ t, -t)), draws=2000)
    assert abs(draws.mean()) < 0.2
    assert abs(draws.std() - 1.0) < 0.2


@cell(IT, "fused", "yes", "as a density of the weights that you write")
def _fused():
    models = np.array([[1.0, 0.0], [0.8, 0.4]])  # the true one is their mean

    def density(theta):  # weights (1 - w, w), w = 1 / (1 + exp(-theta)), uniform prior on w
        w = 1.0 / (1.0 + np.exp(-theta[0]))
        value, slope = likelihood((1.0 - w) * models[0] + w * models[1])
        inner = slope @ (models[1] - models[0]) * w * (1.0 - w)
        return value + np.log(w * (1.0 - w)), np.array([inner + 1.0 - 2.0 * w])

    weight = 1.0 / (1.0 + np.exp(-drawn(compiled(density, 1))))
    assert abs(weight.mean() - 0.5) < 0.25


@cell(IT, "update", "no", "`with_data` gives a model other data; the draws are made anew")
def _update():
    import nutpie

    assert hasattr(nutpie.compiled_pyfunc.PyFuncModel, "with_data")
    assert not [name for name in signature(nutpie.sample).parameters if "previous" in name]


# `stop_value` ends the training of a normalizing flow.
no(IT, "stop", r"stop|sequential|enough|anytime", but=["stop_value"])


@cell(IT, "filter", "yes", "smoothing, as a density of all states that you write; no filter")
def _filter():
    readings = np.array([0.3, 0.9, 1.2, 2.2])  # a random walk from 0, steps and errors of size 1
    steps = np.eye(4) - np.eye(4, k=-1)
    precision = steps.T @ steps + np.eye(4)

    def density(x):
        slope = readings - precision @ x
        return readings @ x - 0.5 * x @ precision @ x, slope

    smoothed = np.linalg.solve(precision, readings)
    found = drawn(compiled(density, 4), draws=1000).mean(axis=0)
    assert np.linalg.norm(found - smoothed) < 0.2


no(IT, "limits", r"control|input_|horizon")
no(IT, "feedback", r"mpc|feedback|controller|horizon")
no(IT, "log", r"latency|solve_time|controller")
no(IT, "gap", r"gap|dual|kkt")


@cell(
    IT,
    "tube",
    "partly",
    "by simulating each draw of the model yourself: a credible band, for the prior that you choose",
)
def _tube():
    states = [np.ones(len(drawn(compiled(likelihood))))]
    draws = drawn(compiled(likelihood))
    for _ in range(5):
        states.append(draws[:, 0] * states[-1] + 0.1 * draws[:, 1])
    low, high = np.quantile(states[-1], [0.005, 0.995])
    exact = 1.0
    for _ in range(5):
        exact = TRUE[0] * exact + 0.1 * TRUE[1]
    assert low < exact < high


no(IT, "fleet", r"fleet|scenario|chance|risk")
no(IT, "gains", r"lqr|riccati|^place$")
no(IT, "robust", r"hinf|h2syn|robust")
no(IT, "convex", r"convex|minimi[sz]e|constraint")
no(IT, "integers", r"integer|boolean|binary")
no(IT, "discrete", r"discreti|sample_system|c2d")
no(IT, "continuous", r"^ode|simulate")
no(IT, "transfer", r"transfer_function|zpk|state_space")
no(IT, "frequency", r"bode|nyquist|locus|margin")
no(IT, "nonlinear", r"simulate|nlsys")
no(IT, "random", r"simulate|ensemble")
no(IT, "sparse", r"sparse|csr|csc")


@cell(IT, "draws", "yes")
def _draws():
    model = compiled(likelihood)
    assert np.array_equal(drawn(model, cores=1), drawn(model, cores=2))


no(IT, "studies", r"executor|dask|replicate")


@cell(
    IT,
    "killed",
    "partly",
    "draws can be kept in a zarr store as they come, and a run can be paused within its process; "
    "no run goes on from such a store",
)
def _killed():
    import nutpie

    asked = signature(nutpie.sample).parameters
    assert "zarr_store" in asked
    assert not [name for name in asked if "resume" in name or "restart" in name]
    run = background()
    assert hasattr(run, "pause")
    run.abort()


def background(**options):
    """Return a run that goes on beside the program."""
    import nutpie

    asked = {"draws": 300, "chains": 2, "seed": 1, "progress_bar": False, "blocking": False}
    return nutpie.sample(compiled(likelihood), **asked | options)


@cell(IT, "partial", "yes")
def _partial():
    seen = []
    run = background(draws=100_000, progress_callback=lambda *_: seen.append(1), progress_rate=10)
    while not seen:
        pass
    assert run.abort().posterior.sizes["draw"] < 100_000


@cell(IT, "pickle", "partly", "draws can; a model from `from_pyfunc` cannot (others: not checked)")
def _pickle():
    draws = drawn(compiled(likelihood))
    assert np.array_equal(pickle.loads(pickle.dumps(draws)), draws)
    try:
        pickle.dumps(compiled(likelihood))
    except TypeError as error:
        said = str(error)
    assert "PyVariable" in said


@cell(IT, "names", "yes")
def _names():
    model = compiled(likelihood, dims={"theta": ("of",)}, coords={"of": ["state", "input"]})
    import nutpie

    found = nutpie.sample(model, draws=50, tune=100, chains=1, progress_bar=False).posterior
    assert list(found["of"].values) == ["state", "input"]


no(IT, "matched", r"align|reindex|match")
no(IT, "units", r"unit")


@cell(IT, "tables", "yes")
def _tables():
    import nutpie
    import xarray

    found = nutpie.sample(compiled(likelihood), draws=50, tune=100, chains=1, progress_bar=False)
    assert isinstance(found.posterior["theta"], xarray.DataArray)


@cell(
    IT, "types", "no", "some functions have annotations; without py.typed, type checkers skip them"
)
def _types():
    assert not is_typed(IT)
    assert 0.1 < annotated(IT) < 0.95


@cell(IT, "shell", "no")
def _shell():
    assert not metadata.distribution(IT).entry_points.select(group="console_scripts")


@cell(IT, "wheels", "yes")
def _wheels():
    assert has_wheels(IT)


@cell(IT, "abi", "no")
def _abi():
    tags = metadata.distribution(IT).read_text("WHEEL")
    assert "abi3" not in tags
    assert "cp3" in tags
