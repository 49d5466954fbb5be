"""The column of python-control."""

from __future__ import annotations

import inspect
import logging
import pickle
from importlib import metadata

import numpy as np

from . import annotated, cell, is_typed, no

IT = "control"
A, B = np.array([[1.0, 0.1], [0.0, 0.95]]), np.array([[0.0], [0.1]])
TIMES = np.arange(0.0, 1.01, 0.1)


def system(**options):
    """Return a cart as its state space system, in steps of 0.1 s."""
    import control

    return control.ss(A, B, np.eye(2), 0, 0.1, **options)


def task():
    """Return system, cost and constraint of a control within limits."""
    import control.optimal as optimal

    cart = system()
    cost = optimal.quadratic_cost(cart, np.eye(2), 0.1 * np.eye(1))
    return cart, cost, [optimal.input_range_constraint(cart, [-1.0], [1.0])]


@cell(
    IT,
    "model",
    "partly",
    "`markov` estimates the impulse response from inputs and outputs, `era` makes a state space "
    "system of it, in coordinates of its own; nothing fits A and B to measured states",
)
def _model():
    import control

    u = np.random.default_rng(1).standard_normal(400)
    response = control.forced_response(control.ss(A, B, [[1.0, 0.0]], 0, 0.1), U=u)
    impulse = control.markov(response.outputs, u, 41, dt=0.1)
    found, _ = control.eigensys_realization(impulse[1:], 2, dt=0.1)
    assert found.nstates == 2


no(IT, "region", r"confiden|credib|bootstrap|uncertain_(region|set)")
no(IT, "posterior", r"posterior|nuts|mcmc|hamiltonian")
no(IT, "fused", r"fuse|mixture|average_models|model_weight")
no(IT, "update", r"recursive|rls|partial_fit|^update$|model_?stream")
no(IT, "stop", r"stop_rule|sequential|enough|anytime")


@cell(IT, "filter", "yes")
def _filter():
    import control

    gain, *_ = control.dlqe(A, np.eye(2), [[1.0, 0.0]], np.eye(2), [[1.0]])
    assert abs(np.linalg.eigvals(A - A @ gain @ [[1.0, 0.0]])).max() < 1.0
    assert control.create_estimator_iosystem(system(), np.eye(1), np.eye(2)).nstates


@cell(IT, "limits", "yes", "by a general nonlinear solver of SciPy")
def _limits():
    import control.optimal as optimal

    cart, cost, limits = task()
    found = optimal.solve_ocp(cart, TIMES, [1.0, 0.0], cost, limits, print_summary=False)
    assert found.success
    assert abs(found.inputs).max() <= 1.0 + 1e-6


@cell(IT, "feedback", "yes")
def _feedback():
    import control
    import control.optimal as optimal

    cart, cost, limits = task()
    loop = optimal.create_mpc_iosystem(cart, TIMES, cost, limits)
    closed = control.feedback(cart, loop, 1)
    response = control.input_output_response(closed, TIMES[:4], 0, [1.0, 0.0])
    assert response.outputs.shape[-1] == 4


@cell(
    IT,
    "log",
    "partly",
    "`log=True` logs evaluations of the cost, not the calls or how they end",
)
def _log():
    import control.optimal as optimal

    cart, cost, limits = task()
    logger, kept = logging.getLogger(), []
    handler, level = logging.Handler(), logger.level
    handler.emit = lambda record: kept.append(record.getMessage())
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        loop = optimal.create_mpc_iosystem(cart, TIMES[:4], cost, limits, log=True)
        loop.output(0.0, np.zeros(loop.nstates), [1.0, 0.0])
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
    assert [line for line in kept if "_cost_function" in line]
    assert not [line for line in kept if "success" in line or "status" in line]


@cell(IT, "gap", "no")
def _gap():
    import control.optimal as optimal

    cart, cost, limits = task()
    found = optimal.solve_ocp(cart, TIMES, [1.0, 0.0], cost, limits, print_summary=False)
    assert not [name for name in dir(found) if "gap" in name or "dual" in name]


no(IT, "tube", r"tube|confiden|error_?bar|error_?band")
no(IT, "fleet", r"fleet|scenario|chance|risk")


@cell(IT, "gains", "yes")
def _gains():
    import control

    gain, *_ = control.dlqr(system(), np.eye(2), np.eye(1))
    assert abs(np.linalg.eigvals(A - B @ gain)).max() < 1.0
    assert control.place(A, B, [0.5, 0.6]).shape == (1, 2)


@cell(
    IT, "robust", "partly", "`h2syn` and `hinfsyn` need slycot, which pip does not install with it"
)
def _robust():
    import control

    plant = control.ss([[0.0, 1], [-1, -1]], [[0, 0], [1, 1]], [[1, 0], [1, 0]], [[0, 0], [1, 0]])
    assert [line for line in metadata.requires(IT) if "slycot" in line and "extra" in line]
    try:
        control.hinfsyn(plant, 1, 1)
    except control.ControlSlycot:
        return
    raise AssertionError("slycot is installed: nothing was checked")


@cell(IT, "convex", "partly", "takes any function, and searches for a local minimum")
def _convex():
    import control.optimal as optimal
    from scipy.optimize import OptimizeResult

    cart, _, limits = task()

    def cost(x, u):
        return np.sum(np.sqrt(1.0 + x**2)) + np.sum(u**4)

    found = optimal.solve_ocp(cart, TIMES[:6], [1.0, 0.0], cost, limits, print_summary=False)
    assert found.success
    assert isinstance(found, OptimizeResult)  # of a local method of SciPy


no(IT, "integers", r"integer|boolean|binary")


@cell(IT, "discrete", "yes")
def _discrete():
    import control

    second = control.ss([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], np.eye(2), 0)
    for method in ("zoh", "bilinear", "euler", "backward_diff"):
        assert control.sample_system(second, 0.1, method).dt == 0.1


@cell(IT, "continuous", "yes")
def _continuous():
    import control

    response = control.step_response(control.tf([1.0], [1.0, 1.0]), np.linspace(0, 20, 50))
    assert abs(response.outputs[-1] - 1.0) < 1e-6


@cell(IT, "transfer", "yes")
def _transfer():
    import control

    assert control.tf2ss(control.tf([1.0], [1.0, 2.0, 1.0])).C.shape == (1, 2)


@cell(IT, "frequency", "yes")
def _frequency():
    import control

    third = control.tf([1.0], [1.0, 3.0, 3.0, 1.0])
    assert abs(control.margin(third)[0] - 8.0) < 1e-6
    assert control.frequency_response(third, [1.0]).magnitude[0] < 1.0
    assert control.root_locus_map(third).loci.shape[1] == 3


@cell(IT, "nonlinear", "yes")
def _nonlinear():
    import control

    pendulum = control.nlsys(
        lambda t, x, u, params: [x[1], -np.sin(x[0]) - x[1] + u[0]], None, inputs=1, states=2
    )
    response = control.input_output_response(pendulum, np.linspace(0, 30, 100), 0, [1.0, 0.0])
    assert abs(response.states[:, -1]).max() < 1e-2


@cell(IT, "random", "partly", "`white_noise` makes random inputs; the loop over runs is yours")
def _random():
    import control

    noise = control.white_noise(TIMES, np.eye(1), dt=0.1)
    assert control.forced_response(system(), TIMES, noise).states.shape == (2, 11)


@cell(IT, "sparse", "no")
def _sparse():
    import control
    from scipy.sparse import csr_matrix

    try:
        control.ss(csr_matrix(A), B, np.eye(2), 0, 0.1)
    except ValueError:
        return
    raise AssertionError("a sparse matrix was taken")


@cell(IT, "draws", "no", "its only draws, `white_noise`, come from the global generator of NumPy")
def _draws():
    import control

    drawn = []
    for _ in range(2):
        np.random.seed(1)  # noqa: NPY002
        drawn.append(control.white_noise(TIMES, np.eye(1), dt=0.1))
    assert np.array_equal(*drawn)
    assert not {"rng", "seed"} & set(inspect.signature(control.white_noise).parameters)


no(IT, "studies", r"executor|dask|replicate|monte")
no(IT, "killed", r"checkpoint|resume|save_state|load_state")
no(IT, "partial", r"progress|interrupt|tqdm")


@cell(IT, "pickle", "partly", "time responses can; state space systems cannot")
def _pickle():
    import control

    response = control.forced_response(system(), TIMES, np.ones(11))
    assert np.array_equal(pickle.loads(pickle.dumps(response)).states, response.states)
    try:
        pickle.dumps(system())
    except (AttributeError, pickle.PicklingError):
        return
    raise AssertionError("a system was pickled")


@cell(IT, "names", "yes")
def _names():
    import control

    cart = system(states=["position", "speed"], inputs=["force"])
    response = control.forced_response(cart, TIMES, np.ones(11))
    assert response.state_labels == ["position", "speed"]


@cell(IT, "matched", "no", "the numbers of a table are taken in their order, its names are lost")
def _matched():
    import control
    import pandas as pd

    shuffled = pd.DataFrame(A, ["speed", "position"], ["position", "speed"])
    cart = control.ss(shuffled, B, np.eye(2), 0, 0.1, states=["position", "speed"])
    assert np.array_equal(cart.A, A)


# `dB`, `Hz`, `deg` choose the axes of frequency plots.
no(IT, "units", r"^units?$|_units?$")


@cell(IT, "tables", "partly", "time responses as pandas; nothing as xarray")
def _tables():
    import control

    response = control.forced_response(system(), TIMES, np.ones(11))
    assert "x[1]" in response.to_pandas().columns
    assert not hasattr(response, "to_xarray")


@cell(IT, "types", "no")
def _types():
    assert not is_typed(IT)
    assert annotated(IT) < 0.1


@cell(IT, "shell", "no")
def _shell():
    assert not metadata.distribution(IT).entry_points.select(group="console_scripts")


@cell(IT, "wheels", "yes")
def _wheels():
    assert "py3-none-any" in metadata.distribution(IT).read_text("WHEEL")


cell(IT, "abi", "yes", "no compiled code")(_wheels)
