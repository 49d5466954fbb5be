"""Every public computation against the NumPy twin, on awkward shapes, dtypes and memory orders.

One fixture, `problem`, carries a system and its states in the layout under test; each test states
one computation. Draws are taken from the ensemble itself (their own test is test_streams.py), so a
difference here is a difference in arithmetic. Known differences: ALSE for matrices is iterative in
the package and exact in the twin, so its objective is compared within the stated tolerance.
"""

from __future__ import annotations

import hashlib
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

import stochens_rs as se
from stochens_rs import reference as twin
from stochens_rs.fusion import Alse
from stochens_rs.fusion.fusing import METHODS

Array = NDArray[np.float64]
TOL = 1e-9  # the default of `fuse`


class Problem(NamedTuple):
    """`given` holds A, B, x0, xf as the user passes them; the fields are float64 copies."""

    A: Array
    B: Array
    x0: Array
    xf: Array
    N: int
    given: dict[str, NDArray[Any]]


def _integers(seed: int, *shape: int) -> NDArray[np.int64]:
    return np.random.default_rng(seed).integers(-5, 6, size=shape)


def _case(name: str) -> tuple[NDArray[np.int64], ...]:
    """A (n, n), B (n, m), x0, xf in small integers, and N as an array with no axes."""
    n, m, N = {
        "scalar": (1, 1, 5),
        "one state, three inputs": (1, 3, 6),
        "more inputs than states": (3, 5, 9),
        "one input": (4, 1, 20),
        "one sample": (3, 2, 1),
        "plain": (6, 4, 80),
        "positive": (4, 4, 30),
    }.get(name, (4, 3, 25))
    A, B = _integers(1, n, n), _integers(2, n, m)
    x0, xf = _integers(3, n), _integers(4, n)
    if name == "scalar":
        A[...], B[...], x0[...], xf[...] = -3, 2, 4, 1
    if name == "dependent columns":
        B[:, 2] = -2 * B[:, 0]
    if name == "zero columns":
        A[:, 1], A[2, :], B[:, 0] = 0, 0, 0
    if name == "zero xf":
        xf[:] = 0
    if name == "zero x0":
        x0[:] = 0
    if name == "zero B":
        B[:] = 0
    if name == "all zero":
        A[:], B[:], x0[:], xf[:] = 0, 0, 0, 0
    if name == "positive":
        A, B, x0, xf = abs(A) + 1, abs(B) + 1, abs(x0) + 1, abs(xf) + 1
    return A, B, x0, xf, np.array(N)


CASES = [
    "scalar",
    "one state, three inputs",
    "more inputs than states",
    "one input",
    "one sample",
    "plain",
    "positive",
    "dependent columns",
    "zero columns",
    "zero xf",
    "zero x0",
    "zero B",
    "all zero",
]


def _layout(values: NDArray[np.int64], layout: str) -> NDArray[Any]:
    """The same numbers (times a factor) in the types that a user may pass."""
    if layout == "int64-C":
        return values.copy()
    if layout == "float32-F":
        return np.asfortranarray((values * 0.125).astype(np.float32))
    real = values * 0.3  # not dyadic: sums do round
    if layout == "float64-C":
        return np.ascontiguousarray(real)
    if layout == "float64-F":
        return np.asfortranarray(real)
    wide = np.full(tuple(2 * k for k in real.shape), np.nan)  # float64-strided
    view = wide[tuple(slice(None, None, 2) for _ in real.shape)]
    view[...] = real
    return view


LAYOUTS = ["float64-C", "float64-F", "float64-strided", "float32-F", "int64-C"]


# every case in one layout, every layout in the three cases with most structure
PARAMS = [f"{case}|float64-C" for case in CASES] + [
    f"{case}|{layout}"
    for case in ("more inputs than states", "zero columns", "plain")
    for layout in LAYOUTS[1:]
]


@pytest.fixture(params=PARAMS)
def problem(request: pytest.FixtureRequest) -> Problem:
    name, layout = request.param.split("|")
    *values, N = _case(name)
    given = dict(zip(["A", "B", "x0", "xf"], (_layout(v, layout) for v in values), strict=True))
    exact = {k: np.array(v, dtype=np.float64, order="C") for k, v in given.items()}
    return Problem(**exact, N=int(N), given=given)


def scale_of(target: Array, samples: Array) -> float:
    """The unit of tolerances: ||E*||^2, or that of a sample if E* = 0."""
    size = float(np.sum(target**2))
    return size if size > 0 else float(np.max(np.sum(samples.reshape(len(samples), -1) ** 2, 1)))


def ensembles(p: Problem) -> dict[str, Any]:
    return {
        name: se.sample(p.given[name], p.N, rng=seed)
        for seed, name in enumerate(("x0", "xf", "A"), start=1)
    }


# --- ensembles ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "axis"), [("x0", "columns"), ("A", "columns"), ("A", "rows"), ("B", "rows")]
)
def test_ensemble(problem: Problem, name: str, axis: str) -> None:
    target: Array = getattr(problem, name)
    ens = se.sample(problem.given[name], problem.N, rng=9, axis=axis)
    atoms = twin.sampling.atoms(target, axis)
    lines = twin.sampling.to_lines(target, axis)
    assert ens.shape == target.shape
    assert ens.indices.shape == (problem.N, lines.shape[1])
    assert_allclose(ens.atoms, atoms, rtol=1e-14)
    gamma = np.abs(lines).sum(axis=0).max()
    assert_allclose(np.max(ens.gamma), gamma, rtol=1e-14)
    samples = twin.sampling.dense(ens.indices, ens.atoms, axis)
    assert np.array_equal(ens.dense(), samples)
    assert np.array_equal(ens.counts(), twin.sampling.counts(ens.indices, target, axis))
    y = np.random.default_rng(0).normal(size=problem.N)
    expected = twin.sampling.combine(ens.indices, ens.atoms, y, axis)
    slack = 1e-14 * problem.N * (gamma + 1.0) * np.abs(y).max()
    assert_allclose(ens.combine(y), expected, atol=slack)
    assert_allclose(np.tensordot(y, samples, axes=1), expected, atol=slack)
    dense = se.Ensemble.from_samples(samples)
    assert_allclose(dense.combine(y), expected, atol=slack)
    again = se.Ensemble.from_indices(ens.indices, problem.given[name], axis=axis)
    assert np.array_equal(again.dense(), samples)


# --- fusing ---------------------------------------------------------------------------------------


def check_feasible(y: Array, weight_set: str) -> None:
    assert np.all(y >= 0)
    total = y.sum()
    assert total <= 1 + 1e-12
    if weight_set == "simplex":
        assert total >= 1 - 1e-12


def check_alse(fit: Any, samples: Array, target: Array, weight_set: str) -> None:
    """Feasible, consistent, within the tolerance of the exact minimum, and with the correct gap."""
    exact = twin.fusing.alse_dense(samples, target, weight_set)
    unit = scale_of(target, samples)
    check_feasible(fit.weights, weight_set)
    assert fit.status == "optimal"
    assert_allclose(
        fit.estimate, np.tensordot(fit.weights, samples, axes=1), atol=1e-12 * unit**0.5
    )
    assert exact.gap <= 1e-12 * unit  # or the twin has not solved it
    assert fit.error**2 >= exact.error**2 - 1e-12 * unit
    assert fit.error**2 - exact.error**2 <= fit.gap + 1e-12 * unit
    assert fit.gap <= TOL * unit
    honest = twin.fusing.frank_wolfe_gap(samples, fit.weights, target, weight_set)
    assert_allclose(fit.gap, honest, atol=1e-12 * unit)


def check_fit(fit: Any, samples: Array, target: Array, method: str, weight_set: str) -> None:
    unit = scale_of(target, samples) ** 0.5
    assert fit.method == method
    assert fit.estimate.shape == target.shape
    assert_allclose(fit.error, np.linalg.norm(fit.estimate - target), atol=1e-13 * unit)
    if method == "alse":
        check_alse(fit, samples, target, weight_set)
        return
    expected = twin.fusing.METHODS[method](samples, target)
    check_feasible(fit.weights, "simplex")
    # the safeguard may tie: where F = U_n up to rounding, any step will do
    if method != "slse-safeguarded":
        assert_allclose(fit.weights, expected.weights, atol=1e-9)
    assert_allclose(fit.estimate, np.tensordot(fit.weights, samples, axes=1), atol=1e-12 * unit)
    assert_allclose(fit.estimate, expected.estimate, atol=1e-10 * unit)


@pytest.mark.parametrize(
    ("method", "weight_set"), [*((m, "simplex") for m in METHODS), ("alse", "subsimplex")]
)
def test_fuse(problem: Problem, method: str, weight_set: str) -> None:
    for name in ("x0", "xf", "A"):
        target: Array = getattr(problem, name)
        ens = se.sample(problem.given[name], problem.N, rng=2)
        samples = twin.sampling.dense(ens.indices, ens.atoms)
        how = Alse(weight_set) if method == "alse" else method
        shifted = target * 0.7 + 0.4 * np.cos(np.arange(target.size)).reshape(target.shape)
        for goal, given in ((target, problem.given[name]), (shifted, shifted)):
            fit = se.fuse(ens, how, target=given)
            check_fit(fit, samples, goal, method, weight_set)
            # a combination on the simplex keeps the zeros and the signs of what was sampled
            assert np.all(fit.estimate[target == 0] == 0)
            assert np.all(fit.estimate * np.sign(target) >= 0)
            from_dense = se.fuse(se.Ensemble.from_samples(samples), how, target=given)
            check_fit(from_dense, samples, goal, method, weight_set)


@pytest.mark.parametrize("weight_set", ["simplex", "subsimplex"])
def test_alse_of_a_vector_is_the_closed_form(problem: Problem, weight_set: str) -> None:
    for name in ("x0", "xf"):
        target: Array = getattr(problem, name)
        ens = se.sample(problem.given[name], problem.N, rng=2)
        unit = float(np.abs(target).sum()) + 1.0
        for goal in (target, 0.6 * target, -target, np.ones_like(target)):
            fit = se.fuse(ens, Alse(weight_set), target=goal)
            exact = twin.fusing.alse_singleton(ens.indices, ens.atoms, goal, weight_set)
            assert_allclose(fit.weights, exact.weights, atol=1e-13)
            assert_allclose(fit.estimate, exact.estimate, atol=1e-13 * unit)
            assert_allclose(fit.error, exact.error, atol=1e-13 * unit)


@pytest.mark.parametrize("method", METHODS)
def test_fuse_path(problem: Problem, method: str) -> None:
    sizes = np.unique([1, 2, 3, 10, problem.N // 2, problem.N])
    sizes = sizes[(sizes >= 1) & (sizes <= problem.N)]
    for name in ("x0", "A"):
        target: Array = getattr(problem, name)
        ens = se.sample(problem.given[name], problem.N, rng=4)
        samples = twin.sampling.dense(ens.indices, ens.atoms)
        unit = scale_of(target, samples)
        expected = twin.fusing.fuse_path(samples, sizes, method, target=target)
        for source in (ens, se.Ensemble.from_samples(samples)):
            path = se.fuse_path(source, sizes, method, target=problem.given[name], estimates=True)
            assert path.sizes.tolist() == sizes.tolist()
            assert path.method == method
            assert len(path.statuses) == len(sizes)
            distances = [np.linalg.norm(e - target) for e in path.estimates]
            assert_allclose(path.errors, distances, atol=1e-12 * unit**0.5)
            if method == "alse":
                assert_allclose(path.errors**2, expected**2, atol=(TOL + 1e-12) * unit)
            else:
                assert_allclose(path.errors, expected, atol=1e-10 * unit**0.5)


# --- controls -------------------------------------------------------------------------------------


def size_of(x: Array) -> float:
    return float(np.max(np.abs(x), initial=0.0)) + 1.0


def test_realization_controls(problem: Problem) -> None:
    e = ensembles(problem)
    u = se.realization_controls((e["A"], problem.given["B"]), e["x0"], e["xf"])
    d = {k: twin.sampling.dense(v.indices, v.atoms) for k, v in e.items()}
    expected = twin.controls.realization_controls(d["A"], problem.B, d["x0"], d["xf"])
    for s in (0, problem.N - 1):
        y = d["xf"][s] - d["A"][s] @ d["x0"][s]
        assert_allclose(
            expected[s], twin.controls.pinv(problem.B) @ y, atol=1e-12 * size_of(expected)
        )
    assert u.shape == (problem.N, problem.B.shape[1])
    assert_allclose(u, expected, atol=1e-12 * size_of(expected))
    dense = {k: se.Ensemble.from_samples(v) for k, v in d.items()}
    v = se.realization_controls((dense["A"], problem.given["B"]), dense["x0"], dense["xf"])
    assert_allclose(v, expected, atol=1e-12 * size_of(expected))


@pytest.mark.parametrize("fusion", ["product", "diagonal"])
def test_control_from_ensembles(problem: Problem, fusion: str) -> None:
    e = ensembles(problem)
    plan = se.control((e["A"], problem.given["B"]), e["x0"], e["xf"], fusion=fusion)
    d = {k: twin.sampling.dense(v.indices, v.atoms) for k, v in e.items()}
    expected = twin.controls.control(d["A"], problem.B, d["x0"], d["xf"], fusion=fusion)
    assert plan.fusion == fusion
    assert plan.u.shape == (1, problem.B.shape[1])
    assert_allclose(plan.u[0], expected, atol=1e-12 * size_of(expected))


def check_product(plan: Any, A: Array, B: Array, x0: Array, xf: Array) -> None:
    expected = twin.controls.control(A, B, x0, xf)
    assert_allclose(plan.u[0], expected, atol=1e-11 * size_of(expected))
    state = A @ x0 + B @ expected
    assert_allclose(plan.predicted_states[-1], state, atol=1e-11 * size_of(state))
    reach = twin.controls.reachability(A, B, x0, xf)
    unit = size_of(xf - A @ x0)
    assert_allclose(plan.reachability.residual, reach.residual, atol=1e-11 * unit)
    assert plan.reachability.rank == reach.rank
    if np.linalg.norm(xf - A @ x0) > 1e-9 * unit:
        assert_allclose(plan.reachability.relative, reach.relative, atol=1e-9)


def test_control_from_arrays_and_fits(problem: Problem) -> None:
    g = problem.given
    plan = se.control((g["A"], g["B"]), g["x0"], g["xf"])
    check_product(plan, problem.A, problem.B, problem.x0, problem.xf)
    fits = {k: se.fuse(v, "slse-safeguarded", target=g[k]) for k, v in ensembles(problem).items()}
    plan = se.control((fits["A"], g["B"]), fits["x0"], fits["xf"])
    A, x0, xf = (fits[k].estimate for k in ("A", "x0", "xf"))
    check_product(plan, A, problem.B, x0, xf)


def test_plan_error(problem: Problem) -> None:
    g, e = problem.given, ensembles(problem)
    for fusion in ("product", "diagonal"):
        plan = se.control((e["A"], g["B"]), e["x0"], e["xf"], fusion=fusion)
        got = plan.error(se.System(g["A"], g["B"]), g["x0"], g["xf"])
        want = twin.controls.plan_error(problem.A, problem.B, problem.x0, problem.xf, plan.u[0])
        unit = size_of(plan.u) * size_of(problem.B) + size_of(problem.xf)
        for field in ("control", "state", "residual"):
            assert_allclose(getattr(got, field), getattr(want, field), atol=1e-11 * unit)
        for field in ("control_relative", "state_relative"):
            if want.control > 1e-9 and np.isfinite(getattr(want, field)):
                assert_allclose(getattr(got, field), getattr(want, field), rtol=1e-7)
        # Pythagoras: what is missed in range(B) and what no control can reach are orthogonal
        x1 = problem.A @ problem.x0 + problem.B @ plan.u[0]
        missed = np.sum((x1 - problem.xf) ** 2)
        assert_allclose(got.state**2 + got.residual**2, missed, atol=1e-11 * unit**2)


@pytest.mark.parametrize("fusion", ["product", "diagonal"])
def test_steer(problem: Problem, fusion: str) -> None:
    """sample + fuse + control, with the children "x0", "xf" and "A" of the key of the seed."""
    root = hashlib.sha256(b"stochens key v1\0int\0" + b"12").digest()
    samples = {}
    for name in ("x0", "xf", "A"):
        key = hashlib.sha256(b"stochens child v1\0" + root + name.encode()).digest()
        target = getattr(problem, name)
        indices = twin.sampling.sample_indices(target, problem.N, key=key)
        samples[name] = twin.sampling.dense(indices, twin.sampling.atoms(target))
    expected = twin.controls.control(
        samples["A"], problem.B, samples["x0"], samples["xf"], fusion=fusion
    )
    g = problem.given
    plan = se.steer(se.System(g["A"], g["B"]), g["x0"], g["xf"], problem.N, fusion=fusion, rng=12)
    assert plan.fusion == fusion
    assert_allclose(plan.u[0], expected, atol=1e-12 * size_of(expected))
