"""The column of CVXPY."""

from __future__ import annotations

import pickle
import subprocess
import sys
from importlib import metadata

import numpy as np

from . import annotated, cell, has_wheels, is_typed, no

IT = "cvxpy"
WRITTEN = "as a problem that you write"
A, B = np.array([[1.0, 0.1], [0.0, 0.95]]), np.array([[0.0], [0.1]])


def measured(N=40):
    """Return measured pairs of the cart, with noise of 0.01."""
    rng = np.random.default_rng(1)
    x, u = rng.standard_normal((N, 2)), rng.standard_normal((N, 1))
    return x, u, x @ A.T + u @ B.T + 0.01 * rng.standard_normal((N, 2))


def task(start, K=20):
    """Return a control within limits as a problem, its states and inputs."""
    import cvxpy as cp

    x, u = cp.Variable((K + 1, 2)), cp.Variable((K, 1))
    limits = [x[0] == start, x[1:] == x[:-1] @ A.T + u @ B.T, cp.abs(u) <= 1.0]
    return cp.Problem(cp.Minimize(cp.sum_squares(x) + 0.1 * cp.sum_squares(u)), limits), x, u


@cell(IT, "model", "yes", WRITTEN + ": least squares, for example")
def _model():
    import cvxpy as cp

    x, u, following = measured()
    fit_A, fit_B = cp.Variable((2, 2)), cp.Variable((2, 1))
    cp.Problem(cp.Minimize(cp.sum_squares(x @ fit_A.T + u @ fit_B.T - following))).solve()
    assert np.linalg.norm(fit_A.value - A) < 0.02


no(IT, "region", r"confiden|credib|bootstrap")
no(IT, "posterior", r"posterior|nuts|mcmc|hamiltonian")


@cell(IT, "fused", "yes", WRITTEN + ": weights that add up to 1")
def _fused():
    import cvxpy as cp

    x, u, following = measured()
    off = np.array([x @ (A + d).T + u @ B.T - following for d in (0.0, 0.2, -0.3)])
    w = cp.Variable(3, nonneg=True)
    squares = cp.sum_squares(off.reshape(3, -1).T @ w)
    cp.Problem(cp.Minimize(squares), [cp.sum(w) == 1]).solve()
    assert np.allclose(w.value @ [0.0, 0.2, -0.3], 0.0, atol=0.02)


no(IT, "update", r"recursive|rls|partial_fit|^update$|model_?stream")
no(IT, "stop", r"stop_rule|sequential|anytime")


@cell(IT, "filter", "yes", WRITTEN + ": smoothing; no filter")
def _filter():
    import cvxpy as cp

    readings, x = np.array([0.3, 0.9, 1.2, 2.2]), cp.Variable(4)
    steps = np.eye(4) - np.eye(4, k=-1)
    cost = cp.sum_squares(steps @ x) + cp.sum_squares(readings - x)
    cp.Problem(cp.Minimize(cost)).solve()
    assert np.allclose(x.value, np.linalg.solve(steps.T @ steps + np.eye(4), readings), atol=1e-5)


@cell(IT, "limits", "yes", WRITTEN + "; limits hold up to the tolerance of the solver")
def _limits():
    problem, _, u = task([1.0, 0.0])
    problem.solve()
    assert problem.status == "optimal"
    assert abs(u.value).max() <= 1.0 + 1e-4


def looped():
    """Return the inputs of three calls of a feedback, and the problem."""
    import cvxpy as cp

    start, seen = cp.Parameter(2), []
    problem, _, u = task(start)
    state = np.array([1.0, 0.0])
    for _ in range(3):
        start.value = state
        problem.solve()
        seen.append(u.value[0, 0])
        state = A @ state + B @ u.value[0]
    return seen, problem


@cell(
    IT,
    "feedback",
    "partly",
    "a problem with a `Parameter` for the state is compiled once; the loop around it is yours",
)
def _feedback():
    seen, problem = looped()
    assert problem.is_dpp()
    assert abs(seen[0] + 1.0) < 1e-4


@cell(IT, "log", "partly", "`status` and `solver_stats` of the last call; the log is yours")
def _log():
    _, problem = looped()
    assert problem.solver_stats.solve_time > 0.0
    assert problem.status == "optimal"


@cell(
    IT,
    "gap",
    "partly",
    "dual values, and what the solver says of its gap (OSQP)",
)
def _gap():
    import cvxpy as cp

    x, limit = cp.Variable(), 2.0
    problem = cp.Problem(cp.Minimize(cp.square(x)), [x >= limit])
    problem.solve(solver="OSQP")
    assert problem.solver_stats.extra_stats.info.duality_gap < 1e-3
    y = problem.constraints[0].dual_value  # least x^2 - y (x - 2) is -y^2 / 4 + 2 y
    assert abs(problem.value - (limit * y - y**2 / 4)) < 1e-5
    assert not [name for name in dir(problem) + dir(problem.solver_stats) if "gap" in name]


no(IT, "tube", r"tube|confiden|error_?bar|error_?band")


@cell(
    IT,
    "fleet",
    "partly",
    "the largest miss of given units can be minimized, " + WRITTEN + "; no risk of a fresh one",
)
def _fleet():
    import cvxpy as cp

    rng, u = np.random.default_rng(2), cp.Variable(10)
    misses = []
    for _ in range(20):
        own = A + 0.01 * rng.standard_normal((2, 2))
        powers = [np.linalg.matrix_power(own, k) for k in range(11)]
        reach = np.column_stack([(powers[9 - k] @ B)[:, 0] for k in range(10)])
        misses.append(cp.norm(powers[10] @ [1.0, 0.0] + reach @ u))
    problem = cp.Problem(cp.Minimize(cp.maximum(*misses)), [cp.abs(u) <= 5.0])
    assert problem.solve() < 1.0


def inequality(*rows):
    """Return the constraint that a symmetric block matrix is not positive."""
    import cvxpy as cp

    block = cp.bmat(rows)
    return (block + block.T) / 2 << 0


@cell(IT, "gains", "yes", WRITTEN + ": linear matrix inequalities")
def _gains():
    import cvxpy as cp

    # The Riccati solution is the largest P with the matrix below positive, for Q = I, R = 1.
    P = cp.Variable((2, 2), symmetric=True)
    block = cp.bmat([[A.T @ P @ A - P + np.eye(2), A.T @ P @ B], [B.T @ P @ A, B.T @ P @ B + 1.0]])
    cp.Problem(cp.Maximize(cp.trace(P)), [(block + block.T) / 2 >> 0]).solve()
    gain = np.linalg.solve(B.T @ P.value @ B + 1.0, B.T @ P.value @ A)
    assert abs(np.linalg.eigvals(A - B @ gain)).max() < 1.0


@cell(IT, "robust", "yes", WRITTEN + ": linear matrix inequalities")
def _robust():
    import cvxpy as cp

    # Bounded real lemma for 1 / (s + 1), of H-infinity norm 1.
    p, bound = cp.Variable((1, 1), PSD=True), cp.Variable((1, 1))
    one, zero = np.eye(1), np.zeros((1, 1))
    lemma = inequality([-2 * p, p, one], [p, -bound, zero], [one, zero, -bound])
    cp.Problem(cp.Minimize(bound), [lemma]).solve(solver="CLARABEL")
    assert abs(bound.value[0, 0] - 1.0) < 1e-4


@cell(IT, "convex", "yes")
def _convex():
    import cvxpy as cp

    x = cp.Variable(3)
    cost = cp.norm1(x - 1.0) + cp.log_sum_exp(x) + cp.quad_over_lin(x, 2.0)
    problem = cp.Problem(cp.Minimize(cost), [cp.norm(x) <= 1.0, cp.entr(x[0]) >= 0.1])
    problem.solve()
    assert problem.status == "optimal"


@cell(IT, "integers", "yes")
def _integers():
    import cvxpy as cp

    on = cp.Variable(3, boolean=True)
    problem = cp.Problem(cp.Maximize([3.0, 2.0, 1.0] @ on), [[2.0, 2.0, 1.0] @ on <= 3.0])
    assert abs(problem.solve() - 4.0) < 1e-6


no(IT, "discrete", r"discreti|sample_system|c2d")
no(IT, "continuous", r"solve_ivp|simulate|odeint")
no(IT, "transfer", r"transfer_function|zpk|state_space")
no(IT, "frequency", r"bode|nyquist|locus|margin")
no(IT, "nonlinear", r"simulate|nlsys")
no(IT, "random", r"simulate|ensemble")


@cell(IT, "sparse", "yes")
def _sparse():
    import cvxpy as cp
    from scipy.sparse import eye_array

    x = cp.Variable(5000)
    problem = cp.Problem(cp.Minimize(cp.sum(x)), [eye_array(5000, format="csr") @ x >= 1.0])
    assert abs(problem.solve() - 5000.0) < 1e-2


no(IT, "draws", r"^rng$|seed", verdict="-")
no(IT, "studies", r"executor|dask|replicate")
no(IT, "killed", r"checkpoint|resume|save_state|load_state")


@cell(
    IT, "partial", "partly", "`verbose=True` prints the iterations of the solver; nothing is kept"
)
def _partial():
    code = (
        "import cvxpy as cp; x = cp.Variable(); cp.Problem(cp.Minimize(x**2)).solve(verbose=True)"
    )
    asked = [sys.executable, "-W", "ignore", "-c", code]
    said = subprocess.run(asked, capture_output=True, check=True, text=True)
    assert "iter" in said.stdout + said.stderr


@cell(
    IT,
    "pickle",
    "partly",
    "problems can until they are solved; then they keep a solver that cannot",
)
def _pickle():
    problem, *_ = task([1.0, 0.0])
    assert abs(pickle.loads(pickle.dumps(problem)).solve() - problem.solve()) < 1e-6
    try:
        pickle.dumps(problem)
    except TypeError:
        return
    raise AssertionError("a solved problem was pickled")


@cell(IT, "names", "partly", "of whole variables, not of their entries")
def _names():
    import cvxpy as cp

    assert cp.Variable(2, name="state").name() == "state"
    assert str(cp.Variable(2, name="state")[0]) == "state[0]"


@cell(IT, "matched", "no", "the numbers of a table are taken in their order, its names are lost")
def _matched():
    import cvxpy as cp
    import pandas as pd

    assert list(cp.Constant(pd.Series({"speed": 0.0, "position": 1.0})).value) == [0.0, 1.0]


no(IT, "units", r"^units?$|_units?$")
no(IT, "tables", r"pandas|xarray|to_frame")


@cell(IT, "types", "partly", "py.typed is there; a part of the functions has annotations")
def _types():
    assert is_typed(IT)
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
